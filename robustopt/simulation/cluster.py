"""Tasks on a Dask cluster. Whatever goes wrong with the cluster is a `SimulationFailed`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from robustopt.errors import ConfigError, SimulationFailed
from robustopt.processes import AHEAD, in_order

T = TypeVar("T")

CONNECT = 10
"""Longest time to wait for a Dask scheduler and its workers [s]."""


def on_cluster(call: Callable[..., T], tasks: Sequence[tuple[Any, ...]], scheduler: str) -> Generator[T, None, None]:
    """Yield the result of a function for the arguments of each task, in their order, one thread each.

    Dask gives the tasks of a lost worker to another.

    Args:
        call: the function.
        tasks: the arguments of each task.
        scheduler: address of the Dask scheduler.

    Yields:
        The results.

    Raises:
        ConfigError: the package `distributed` is not installed.
        SimulationFailed: the address is not that of a scheduler with workers, or the cluster died.
    """
    try:
        from distributed import Client, KilledWorker
        from distributed.comm import CommClosedError
    except ImportError:
        raise ConfigError("a Dask cluster needs the package `distributed`: pip install 'robustopt[dask]'") from None
    with _failures(f"The Dask scheduler {scheduler} cannot be reached", Exception):
        with ThreadPoolExecutor(1) as thread:  # a notebook has an event loop of its own in this thread
            kind = thread.submit(asyncio.run, _identity(scheduler)).result()
        if kind != "Scheduler":
            raise ConnectionError(f"it is a {kind}")
        client = Client(scheduler, timeout=CONNECT)
    with client:
        with _failures(f"The Dask scheduler {scheduler} has no workers; expected at least one", TimeoutError, OSError):
            client.wait_for_workers(1, timeout=CONNECT)
            ahead = AHEAD * sum(client.nthreads().values())
        with _failures(
            "The Dask cluster died, or its workers repeatedly", KilledWorker, CancelledError, CommClosedError
        ):
            yield from in_order(lambda task: client.submit(call, *task, pure=False).result, tasks, ahead)


async def _identity(scheduler: str) -> str:
    """Ask the server at an address for its kind; a Client would wait for an answer without an end."""
    from distributed.comm import connect

    async with asyncio.timeout(CONNECT):
        comm = await connect(scheduler, timeout=CONNECT)
        await comm.write({"op": "identity", "reply": True})
        answer = await comm.read()
        await comm.close()
    return str(answer.get("type")) if isinstance(answer, dict) else "stranger"


@contextmanager
def _failures(message: str, *kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of some kinds into a SimulationFailed."""
    try:
        yield
    except kinds as error:
        raise SimulationFailed(f"{message}: {str(error) or type(error).__name__}") from error
