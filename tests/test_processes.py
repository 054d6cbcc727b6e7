"""Worker processes where several calls, threads and processes use them at once, and where they die at a bad moment."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from robustopt.errors import SimulationFailed
from robustopt.processes import THREAD, begun, end_processes, in_processes

NUMBERS = list(range(12))


@pytest.fixture(autouse=True)
def ended():
    """No workers of other tests, and none left."""
    end_processes()
    yield
    end_processes()


def square(number: int) -> int:
    time.sleep(0.02)
    return number**2


def squares(processes: int = 2) -> list[int]:
    return list(in_processes(square, [(k,) for k in NUMBERS], processes, SimulationFailed))


def abandon(tasks: list[tuple[int, bytes]]) -> None:
    results = in_processes(_first, tasks, 2, SimulationFailed)
    next(results)
    results.close()


def _first(number: int, _data: bytes) -> int:
    return number


def test_threads_that_ask_for_other_numbers_of_workers_do_not_disturb_one_another():
    with ThreadPoolExecutor(3) as threads:
        found = list(threads.map(squares, (2, 3, 2)))
    assert found == [[k**2 for k in NUMBERS]] * 3


def test_a_call_that_is_abandoned_disturbs_no_other():
    results = in_processes(square, [(k,) for k in NUMBERS], 2, SimulationFailed)
    found = [next(results)]
    abandon([(k, b"") for k in NUMBERS])
    assert found + list(results) == [k**2 for k in NUMBERS]
    assert begun(2)


def test_large_tasks_that_are_abandoned_leave_no_thread():
    """The pipe to the workers is full when they are killed."""
    threads = set(threading.enumerate())
    abandon([(k, bytes(2_000_000)) for k in NUMBERS])
    assert set(threading.enumerate()) <= threads


def _dies_in_its_result(number: int, died: Path) -> tuple[int, bytes]:
    """Kills this worker when half of its result is in the pipe, the first time."""
    if number != 3 or died.exists():
        return number, b""
    died.touch()

    write = os.write

    def write_half(pipe: int, data: memoryview) -> int:
        if len(data) > 1000:
            write(pipe, data[: len(data) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        return write(pipe, data)

    os.write = write_half
    return number, bytes(30_000)


def test_a_worker_that_is_killed_while_it_writes_a_result_is_noticed(tmp_path):
    tasks = [(k, tmp_path / "died") for k in NUMBERS]
    found = list(in_processes(_dies_in_its_result, tasks, 2, SimulationFailed))
    assert [number for number, _ in found] == NUMBERS
    assert (tmp_path / "died").exists()


def test_an_interruption_ends_what_waits_for_such_a_worker(tmp_path):
    results = in_processes(_dies_in_its_result, [(k, tmp_path / "died") for k in NUMBERS], 2, SimulationFailed)
    next(results)
    while not (tmp_path / "died").exists():
        time.sleep(0.05)
    time.sleep(0.2)
    threads = [thread for thread in threading.enumerate() if thread.name == THREAD]
    results.close()
    assert threads
    assert not any(thread.is_alive() for thread in threads)


CHILD = """
import multiprocessing, os, sys
from robustopt.errors import SimulationFailed
from robustopt.processes import in_processes

def work(number):
    return list(in_processes(abs, [(-k,) for k in range(number)], 2, SimulationFailed)), os.getpid()

if __name__ == "__main__":
    context = multiprocessing.get_context(sys.argv[1])
    print(work(4)[0])
    queue = context.Queue()
    child = context.Process(target=lambda: queue.put(work(4)[0])) if sys.argv[1] == "fork" else None
    if child is not None:
        child.start()
        print(queue.get(timeout=60))
        child.join()
    with context.Pool(1) as pool:
        print(pool.map_async(work, [4]).get(timeout=60)[0][0])
    print(work(4)[0])
"""


@pytest.mark.parametrize(("method", "times"), [("fork", 4), ("spawn", 3)])
def test_children_of_a_process_that_has_workers_do_not_use_them(tmp_path, method, times):
    (tmp_path / "child.py").write_text(CHILD, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "child.py", method], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert (done.stdout, done.stderr) == ("[0, 1, 2, 3]\n" * times, "")


def test_workers_end_without_a_word_where_there_is_no_pgrep():
    """As in a small container."""
    code = (
        "from robustopt.errors import SimulationFailed; from robustopt.processes import end_processes, in_processes; "
        "print(list(in_processes(abs, [(-1,), (2,)], 2, SimulationFailed))); end_processes()"
    )
    environment = {**os.environ, "PATH": ""}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("[1, 2]\n", "")
