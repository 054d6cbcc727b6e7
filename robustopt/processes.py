"""Worker processes of this machine, by loky: results in their order; what a worker had that died is done again."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any, TypeVar

from robustopt.errors import RobustOptError
from robustopt.interruption import STOPS, held

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

T = TypeVar("T")
Task = TypeVar("Task")

RETRIES = 3
"""How often the tasks of workers that died are given to new ones."""

AHEAD = 2
"""Tasks given away at once, per process: one is at work, the next is there when it ends."""

IDLE = 300.0
"""Workers without a task for so long leave [s]."""

ORPHANED = 0.5
"""How often a worker looks whether the process that began it still lives [s]."""

HEARD = 0.1
"""How often a wait for a result looks whether an interruption came [s]."""

ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Threads of libraries of linear algebra: one in each worker, unless the environment says otherwise."""

FEEDER = "QueueFeederThread"
"""Name of loky's thread that writes tasks into the pipe to the workers."""

_pool: ProcessPoolExecutor | None = None
_size = 0
"""How many workers the pool has."""
_last_task = 0.0
"""When the workers were given their last task [s]."""


def begun() -> bool:
    """Whether this process has worker processes already, which then need no time to start."""
    return _pool is not None and time.monotonic() - _last_task < IDLE


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    call: Callable[..., T], tasks: Sequence[tuple[Any, ...]], processes: int, failed: type[RobustOptError]
) -> Generator[T, None, None]:
    """What `call` returns for the arguments of each task. The workers stay for the next tasks of this process.

    Raises `failed` where workers died again and again.
    """
    from loky import BrokenProcessPool

    done = 0
    for attempt in range(RETRIES + 1):
        try:
            for result in in_order(lambda task: _give(call, task, processes), tasks[done:], AHEAD * processes):
                done += 1
                yield result
            return
        except BrokenProcessPool as error:
            end_processes()
            if attempt == RETRIES:
                raise failed(
                    f"Worker processes died {attempt + 1} times, for instance because the memory ran out; "
                    f"{done} of {len(tasks)} parts of the work were done. Fewer workers need less memory."
                ) from error
        except BaseException:
            end_processes()
            raise


def in_order(give: Callable[[Task], Callable[[], T]], tasks: Iterable[Task], ahead: int) -> Generator[T, None, None]:
    """Results of tasks in their order; give: begins a task, what it returns waits for the result; ahead: how many are
    given away at once."""
    given: deque[Callable[[], T]] = deque()
    for task in tasks:
        given.append(give(task))
        if len(given) == ahead:
            yield given.popleft()()
    while given:
        yield given.popleft()()


def _result(future: Future[T]) -> T:
    """An interruption waits until the library is not in the midst of something."""
    while True:
        with held():
            wait([future], HEARD)
            if future.done():
                return future.result()


def _give(call: Callable[..., T], task: tuple[Any, ...], processes: int) -> Callable[[], T]:
    """Give a task to the workers, which are begun where there are not as many as asked for."""
    from loky import ProcessPoolExecutor

    global _pool, _size, _last_task
    with held(), _deaf_children():
        if _pool is not None and _size != processes:
            end_processes()
        if _pool is None:
            _size = processes
            env = {name: os.environ.get(name, "1") for name in ALGEBRA}
            _pool = ProcessPoolExecutor(
                processes, timeout=IDLE, env=env, initializer=_end_with, initargs=(os.getpid(),)
            )
        _last_task = time.monotonic()
        return partial(_result, _pool.submit(call, *task))


def _end_with(parent: int) -> None:
    """End this worker soon after the process that began it is killed, which cannot end it then."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(ORPHANED)
        os._exit(1)

    if os.getppid() == parent:  # on Windows a launcher may stand between them
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
    """End the workers of this process, if it has any, whatever they are doing."""
    global _pool
    with held():
        if _pool is None:
            return
        _pool.shutdown(kill_workers=True)
        _pool = None
        for thread in threading.enumerate():
            if thread.name == FEEDER:  # loky tells it to end, but does not wait until it has freed its locks
                thread.join(1.0)
