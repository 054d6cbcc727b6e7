"""Worker processes on this machine: results come in the order of the tasks; tasks of killed workers are repeated.

A worker is a Python process that runs `robustopt.worker`. It has two pipes of its own, and a thread of this process
sends it one task after the other. A pipe closes with the process at its other end. So this process notices at once
that a worker was killed, even in the middle of a result, and a worker ends at once with this process, even if that is
killed.
Scripts need no `if __name__ == "__main__"`, because a worker does not run the main script again.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

from robustopt import worker
from robustopt.errors import RobustOptError
from robustopt.interruption import STOPS, held

T = TypeVar("T")
Task = TypeVar("Task")

RETRIES = 3
"""How often the tasks of workers that died are given to new workers."""

AHEAD = 2
"""Tasks per process that are given away in advance: one is being done, the next is ready when it ends."""

IDLE = 300.0
"""Time after which unused workers are ended [s]."""

HEARD = 0.1
"""Longest uninterrupted wait for a result [s]; on Windows, Ctrl-C interrupts no wait without a time limit."""

ALGEBRA = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Numbers of threads of linear algebra libraries: 1 in each worker, unless the environment sets them."""

START = "import sys; sys.path[:] = sys.argv[1:]; from robustopt.worker import work; work()"
"""Program of a worker; its arguments are the entries of `sys.path`."""

THREAD = "robustopt worker"
"""Name of the threads that send tasks to workers."""

_pools: list[_Pool] = []
"""All workers of this process; after a fork, also the workers of its parent, which belong to the parent alone."""
_waiting: list[_Pool] = []
"""Unused workers. Operations on lists are atomic, so no lock is needed, which a fork could copy while it is held."""
_starting = threading.Lock()
"""Held while workers are started: a fork by another thread would give their pipes to a child that keeps them open."""


class _WorkerDied(Exception):
    """A worker process ended before it gave its result."""


class _Worker:
    """A worker process, the pipes to and from it, and the thread that sends it tasks."""

    def __init__(self, tasks: SimpleQueue[tuple[bytes, Future[bytes]] | None]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", START, *map(str, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,  # a forked child must not inherit unwritten bytes
            env={**dict.fromkeys(ALGEBRA, "1"), **os.environ},
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # on Windows, it receives no Ctrl-C
        )
        self._thread = threading.Thread(target=self._serve, args=(tasks,), name=THREAD, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def _serve(self, tasks: SimpleQueue[tuple[bytes, Future[bytes]] | None]) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        to_worker, from_worker = self._process.stdin.fileno(), self._process.stdout.fileno()
        while (given := tasks.get()) is not None:
            message, future = given
            try:
                worker.send(to_worker, message)
                future.set_result(worker.receive(from_worker))
            except (OSError, EOFError):
                future.set_exception(_WorkerDied())
                return
            except Exception as error:  # such as a result that does not fit into the memory
                future.set_exception(error)
                return

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()

    def wait(self) -> None:
        """Wait until a killed process, and its thread, have ended."""
        self._process.wait()
        self._thread.join()
        self.close()

    def close(self) -> None:
        """Close this process's ends of the pipes."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


class _Pool:
    """Worker processes that serve one call at a time; they belong to the process that started them."""

    def __init__(self, size: int) -> None:
        self.size, self.owner = size, os.getpid()
        self.workers: list[_Worker] = []
        self._tasks: SimpleQueue[tuple[bytes, Future[bytes]] | None] = SimpleQueue()
        self._idle: threading.Timer | None = None
        _pools.append(self)
        try:
            with _starting, _deaf_children():
                for _ in range(size):
                    self.workers.append(_Worker(self._tasks))
        except BaseException:
            self.end()
            raise

    def serves(self, processes: int) -> bool:
        """Return whether this process can use these workers for a call with so many processes."""
        return self.size == processes and self.owner == os.getpid() and all(w.alive for w in self.workers)

    def submit(self, message: bytes) -> Future[bytes]:
        """Give a pickled task to the workers."""
        future: Future[bytes] = Future()
        self._tasks.put((message, future))
        return future

    def rest(self) -> None:
        """Keep the workers for the next call, but end them after the time `IDLE`."""
        self._idle = threading.Timer(IDLE, self._end_if_waiting)
        self._idle.daemon = True
        self._idle.start()
        _waiting.append(self)

    def stop_resting(self) -> None:
        """Keep the workers for as long as they are used."""
        if self._idle is not None:
            self._idle.cancel()

    def _end_if_waiting(self) -> None:
        try:
            _waiting.remove(self)
        except ValueError:  # a call has just taken these workers
            return
        self.end()

    def end(self) -> None:
        """End the workers, even in the middle of a task."""
        with held():
            if self.owner != os.getpid():
                return
            try:
                _pools.remove(self)
            except ValueError:  # ended already, perhaps by another thread
                return
            self.stop_resting()
            for one in self.workers:
                one.kill()
                self._tasks.put(None)
            for one in self.workers:
                one.wait()


def begun(processes: int) -> bool:
    """Return whether so many worker processes are waiting for tasks, so that a call need not start them.

    Args:
        processes: number of worker processes.

    Returns:
        Whether `in_processes` with this number starts at once.
    """
    return any(pool.serves(processes) for pool in list(_waiting))


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    call: Callable[..., T], tasks: Sequence[tuple[Any, ...]], processes: int, failed: type[RobustOptError]
) -> Generator[T, None, None]:
    """Yield the result of a function for the arguments of each task, in their order.

    The workers stay for the next call of this process. Calls that are under way at once, in several threads or within
    one another, have workers of their own.

    Args:
        call: the function; it and its arguments are pickled.
        tasks: the arguments of each task.
        processes: number of worker processes.
        failed: class of the error if workers die repeatedly.

    Yields:
        The results.

    Raises:
        RobustOptError: workers died more than `RETRIES` times; its class is `failed`.
    """
    done = 0
    for attempt in range(RETRIES + 1):
        pool = None
        try:
            with held():
                pool = _take(processes)
            for result in in_order(partial(_give, pool, call), tasks[done:], AHEAD * processes):
                done += 1
                yield result
        except _WorkerDied:
            _end(pool)
            if attempt == RETRIES:
                raise failed(
                    f"Worker processes died {attempt + 1} times, for instance because the memory ran out; "
                    f"{done} of {len(tasks)} parts of the work were done. Fewer workers need less memory."
                ) from None
        except BaseException:
            _end(pool)
            raise
        else:
            with held():
                pool.rest()
            return


def _take(processes: int) -> _Pool:
    """Take unused workers, or start new ones; end unused workers that do not serve this call."""
    while True:
        try:
            pool = _waiting.pop()
        except IndexError:
            return _Pool(processes)
        if pool.serves(processes):
            pool.stop_resting()
            return pool
        pool.end()


def _end(pool: _Pool | None) -> None:
    if pool is not None:
        pool.end()


def in_order(give: Callable[[Task], Callable[[], T]], tasks: Iterable[Task], ahead: int) -> Generator[T, None, None]:
    """Yield the results of tasks in their order.

    Args:
        give: begins a task and returns a function that waits for its result.
        tasks: the tasks.
        ahead: number of tasks that are given away in advance.

    Yields:
        The results.
    """
    given: deque[Callable[[], T]] = deque()
    for task in tasks:
        given.append(give(task))
        if len(given) == ahead:
            yield given.popleft()()
    while given:
        yield given.popleft()()


def _give(pool: _Pool, call: Callable[..., T], task: tuple[Any, ...]) -> Callable[[], T]:
    """Give a task to workers; return a function that waits for its result."""
    from cloudpickle import dumps  # it also pickles functions and classes of a script or a notebook

    return partial(_result, pool.submit(dumps((call, task))))


def _result(future: Future[bytes]) -> Any:
    while not future.done():
        wait([future], HEARD)
    succeeded, result = pickle.loads(future.result())
    if not succeeded:
        raise result
    return result


@contextmanager
def _deaf_children() -> Generator[None, None, None]:
    """Shield processes started in this block from Ctrl-C and the end of a terminal, which reach all its processes."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [n for n in STOPS if n != signal.SIGTERM])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def end_processes() -> None:
    """End all workers of this process, even in the middle of a task."""
    with held():
        _waiting.clear()
        for pool in list(_pools):
            pool.end()


def _forget_parents_workers() -> None:
    """Close the pipes that a fork has copied, so that the workers still notice the end of their parent."""
    _starting.release()
    for pool in _pools:
        for one in pool.workers:
            one.close()


atexit.register(end_processes)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_starting.acquire, after_in_parent=_starting.release, after_in_child=_forget_parents_workers
    )
