"""Worker processes of this machine, by loky: results in their order; what a worker had that died is done again."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.util import Finalize
from typing import Any, TypeVar

from robustopt.errors import RobustOptError
from robustopt.interruption import STOPS, held

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

UNSEEN = 3.0
"""A worker that is dead for so long was not seen to die [s]."""

ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Threads of libraries of linear algebra: one in each worker, unless the environment says otherwise."""

_pools: list[_Pool] = []
"""All workers of this process, and after a fork those of its parent, which are not to be touched."""
_waiting: list[_Pool] = []
"""Those that no call has; lists, whose steps are whole, need no lock, which a fork could copy while it is held."""


class _Pool:
    """Worker processes, which belong to one call at a time, and to the process that began them."""

    def __init__(self, size: int) -> None:
        from loky import ProcessPoolExecutor

        warnings.filterwarnings("ignore", category=UserWarning, module="loky")  # of workers that it replaces
        env = {name: os.environ.get(name, "1") for name in ALGEBRA}
        self.size, self.owner, self.last_task = size, os.getpid(), time.monotonic()
        self._executor = ProcessPoolExecutor(size, timeout=IDLE, env=env, initializer=_end_with, initargs=(self.owner,))
        self._tasks, self._results = (getattr(self._executor, f"_{name}_queue", None) for name in ("call", "result"))
        self._lost: float | None = None
        self._at_exit = Finalize(None, self.end, exitpriority=0)  # a child of `multiprocessing` waits for its children
        _pools.append(self)

    def submit(self, call: Callable[..., T], task: tuple[Any, ...]) -> Future[T]:
        """Give a task to the workers, which are begun where there are not as many as asked for."""
        self.last_task = time.monotonic()
        with _deaf_children():
            return self._executor.submit(call, *task)

    def require_alive(self) -> None:
        """Break off where a worker is dead and loky does not see it.

        A worker that is killed while it writes a result leaves half of it in the pipe, and loky waits for the rest.
        """
        if all(worker.is_alive() for worker in self._workers()):
            self._lost = None
        elif self._lost is None:
            self._lost = time.monotonic()
        elif time.monotonic() - self._lost > UNSEEN:
            self._break_off()

    def end(self) -> None:
        """End the workers, whatever they are doing."""
        with held():
            if self.owner != os.getpid():
                return
            try:
                _pools.remove(self)
            except ValueError:  # ended already, maybe by another thread
                return
            self._at_exit.cancel()
            manager = getattr(self._executor, "_executor_manager_thread", None)
            self._executor.shutdown(wait=False, kill_workers=True)
            if manager is not None:
                manager.join(UNSEEN)
                if manager.is_alive():
                    self._break_off()
                manager.join()
            feeder = getattr(self._tasks, "_thread", None)
            if self._tasks is not None and feeder is not None:
                self._tasks._reader.close()  # it may be writing a task that nobody is left to read
                feeder.join(1.0)  # loky tells it to end, but does not wait until it has freed its locks

    def _workers(self) -> list[Any]:
        return list((getattr(self._executor, "_processes", None) or {}).values())

    def _break_off(self) -> None:
        """With all ends closed that it is written to, the pipe of the results ends, also for a thread that reads it."""
        from loky.backend.utils import kill_process_tree

        for worker in self._workers():
            kill_process_tree(worker)
        if self._results is not None:
            writer, self._results._writer = self._results._writer, self._results._reader  # which that thread closes
            writer.close()


def begun(processes: int) -> bool:
    """Whether this process has as many worker processes that wait for tasks, and need no time to start."""
    asked, since = (processes, os.getpid()), time.monotonic() - IDLE
    return any((pool.size, pool.owner) == asked and pool.last_task > since for pool in _waiting)


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    call: Callable[..., T], tasks: Sequence[tuple[Any, ...]], processes: int, failed: type[RobustOptError]
) -> Generator[T, None, None]:
    """What `call` returns for the arguments of each task. The workers stay for the next tasks of this process.

    Calls that are under way at once, in several threads or within one another, have workers of their own. A worker of
    `multiprocessing.Pool`, which may have no processes of its own, does the tasks itself.

    Raises `failed` where workers died again and again.
    """
    if multiprocessing.current_process().daemon:
        for task in tasks:
            yield call(*task)
        return
    from loky import BrokenProcessPool

    done = 0
    for attempt in range(RETRIES + 1):
        pool = None
        try:
            with held():
                pool = _take(processes)
            for result in in_order(partial(_give, pool, call), tasks[done:], AHEAD * processes):
                done += 1
                yield result
        except BrokenProcessPool as error:
            _end(pool)
            if attempt == RETRIES:
                raise failed(
                    f"Worker processes died {attempt + 1} times, for instance because the memory ran out; "
                    f"{done} of {len(tasks)} parts of the work were done. Fewer workers need less memory."
                ) from error
        except BaseException:
            _end(pool)
            raise
        else:
            _waiting.append(pool)
            return


def _take(processes: int) -> _Pool:
    """Workers that wait for tasks, or new ones; those that wait and are not as many as asked for are ended."""
    owner = os.getpid()
    while True:
        try:
            pool = _waiting.pop()
        except IndexError:
            return _Pool(processes)
        if pool.size == processes and pool.owner == owner:
            return pool
        pool.end()


def _end(pool: _Pool | None) -> None:
    if pool is not None:
        pool.end()


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


def _result(pool: _Pool, future: Future[T]) -> T:
    """An interruption waits until the library is not in the midst of something."""
    while True:
        with held():
            wait([future], HEARD)
            if future.done():
                return future.result()
            pool.require_alive()


def _give(pool: _Pool, call: Callable[..., T], task: tuple[Any, ...]) -> Callable[[], T]:
    """Give a task to workers; what it returns waits for the result."""
    with held():
        return partial(_result, pool, pool.submit(call, task))


def _end_with(parent: int) -> None:
    """End this worker soon after the process that began it is killed, which cannot end it then."""

    def watch() -> None:
        if sys.platform == "win32":  # where the number of a parent outlives it
            begun_by = multiprocessing.parent_process()
            assert begun_by is not None
            begun_by.join()
        while sys.platform != "win32" and os.getppid() == parent:
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
    """End the workers of this process, if it has any, whatever they are doing."""
    with held():
        _waiting.clear()
        for pool in list(_pools):
            pool.end()
