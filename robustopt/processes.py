"""Worker processes of this machine, by joblib: results in their order; what a worker had that died is done again."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from functools import cache
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from robustopt.errors import RobustOptError
from robustopt.interruption import STOPS, held

T = TypeVar("T")

RETRIES = 3
"""How often the tasks of workers that died are given to new ones."""

ORPHANED = 0.5
"""How often a worker looks whether the process that began it still lives [s]."""


_begun = False


def begun() -> bool:
    """Whether this process has worker processes already, which then need no time to start."""
    return _begun


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    call: Callable[..., T], tasks: Sequence[tuple[Any, ...]], processes: int, failed: type[RobustOptError]
) -> Generator[T, None, None]:
    """What `call` returns for the arguments of each task. The workers stay for the next tasks of this process.

    Raises `failed` where workers died again and again.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    global _begun
    _begun = True
    done = 0
    for attempt in range(RETRIES + 1):
        parallel: Any = Parallel(n_jobs=processes, return_as="generator", pre_dispatch=processes)
        results: Generator[T, None, None] = (_ for _ in ())
        try:
            with held(), _deaf_children():
                results = parallel(delayed(_work)(os.getpid(), call, task) for task in tasks[done:])
            while done < len(tasks):
                result = next(results)
                done += 1
                yield result
            with held():
                next(results, None)  # joblib frees what it kept for these tasks
            return
        except TerminatedWorkerError as error:
            if attempt == RETRIES:
                raise failed(
                    f"Worker processes died {attempt + 1} times, for instance because the memory ran out; "
                    f"{done} of {len(tasks)} parts of the work were done. Fewer workers need less memory."
                ) from error
        except (GeneratorExit, KeyboardInterrupt):
            with held(), warnings.catch_warnings(action="ignore"):  # joblib would tell the user to ask for less
                results.close()
            end_processes()
            raise


def _work(parent: int, call: Callable[..., T], task: tuple[Any, ...]) -> T:
    """What a worker does with a task; parent: process that began the worker."""
    if os.getppid() == parent:
        _end_with(parent)
    return call(*task)


@cache
def _end_with(parent: int) -> None:
    """End this worker soon after the process that began it is killed; joblib's would wait five minutes for tasks."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(ORPHANED)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _deaf_children() -> Generator[None, None, None]:
    """Processes begun in this block do not hear what a terminal sends to all: this process ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # begun with the first worker it would let the second hear Ctrl-C again
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [n for n in STOPS if n != signal.SIGTERM])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def end_processes() -> None:
    """End the workers of this process, if it has any, and free their locks, which would else be reported as leaks."""
    if "joblib" not in sys.modules:
        return
    from joblib.externals.loky import get_reusable_executor

    global _begun
    _begun = False
    with held():
        get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)
        gc.collect()
