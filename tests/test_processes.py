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

from robustopt import processes
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


def squares(number: int = 2) -> list[int]:
    return list(in_processes(square, [(k,) for k in NUMBERS], number, SimulationFailed))


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


def test_workers_end_without_a_word_in_a_small_container():
    """No `ps`, no `pgrep`, and what Python warns of is an error."""
    code = (
        "from robustopt.errors import SimulationFailed; from robustopt.processes import end_processes, in_processes; "
        "print(list(in_processes(abs, [(-1,), (2,)], 2, SimulationFailed))); end_processes()"
    )
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-W", "error", "-c", code],
        env={**os.environ, "PATH": ""}, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("[1, 2]\n", "")


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_ended_workers_leave_no_open_pipe():
    before = open_files()
    for _ in range(3):
        squares()
        assert open_files() > before
        end_processes()
    assert open_files() == before


def _who(_number: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def pids() -> set[int]:
    return set(in_processes(_who, [(k,) for k in range(20)], 2, SimulationFailed))


def test_workers_stay_for_the_next_call_and_are_ended_when_none_comes(monkeypatch):
    first = pids()
    monkeypatch.setattr(processes, "IDLE", 0.5)
    assert pids() == first
    assert begun(2)
    deadline = time.monotonic() + 30
    while any(map(command_of, first)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(first) == 2
    assert not any(map(command_of, first))
    assert not begun(2)
    assert pids().isdisjoint(first)


def test_workers_that_were_killed_while_they_waited_are_replaced(monkeypatch):
    """It is no failure of the next call."""
    monkeypatch.setattr(processes, "RETRIES", 0)
    squares()
    for pid in pids():
        os.kill(pid, signal.SIGKILL)
    time.sleep(0.2)
    assert not begun(2)
    assert squares() == [k**2 for k in NUMBERS]


class Unlucky(Exception):
    """An exception that cannot be pickled."""

    def __init__(self) -> None:
        super().__init__(threading.Lock())


def _raises(number: int) -> object:
    if number == 1:
        raise SimulationFailed("number 1")
    if number == 2:
        raise Unlucky
    if number == 3:
        return threading.Lock()
    if number == 4:
        sys.exit("number 4")
    return number


@pytest.mark.parametrize(
    ("number", "kind", "message"),
    [
        (1, SimulationFailed, "number 1"),
        (2, RuntimeError, "Unlucky"),
        (3, TypeError, "cannot pickle"),
        (4, SystemExit, "number 4"),
    ],
)
def test_an_error_in_a_worker_is_raised_here(number, kind, message):
    with pytest.raises(kind, match=message) as raised:
        list(in_processes(_raises, [(0,), (number,)], 2, SimulationFailed))
    assert number == 2 or any("In a worker process" in note for note in raised.value.__notes__)
    assert not begun(2)


def _noisy(number: int) -> tuple[int, str]:
    print("not a result", flush=True)
    os.write(1, b"nor this\n")
    return number, sys.stdin.read()


def test_tasks_that_print_and_read_do_not_disturb_the_results(capfd):
    assert list(in_processes(_noisy, [(k,) for k in range(4)], 2, SimulationFailed)) == [(k, "") for k in range(4)]
    assert capfd.readouterr().out == ""


def _nested(number: int) -> int:
    return sum(in_processes(square, [(k,) for k in range(number)], 2, SimulationFailed))


def test_a_task_may_have_workers_of_its_own():
    found = list(in_processes(_nested, [(k,) for k in (3, 4)], 2, SimulationFailed))
    assert found == [5, 14]


SCRIPT = """
from dataclasses import dataclass
from robustopt.errors import SimulationFailed
from robustopt.processes import in_processes

@dataclass(frozen=True)
class Pair:
    a: int

def swapped(pair):
    return Pair(-pair.a)

print(list(in_processes(swapped, [(Pair(k),) for k in range(3)], 2, SimulationFailed)) == [Pair(0), Pair(-1), Pair(-2)])
"""


def test_a_script_may_give_functions_and_classes_of_its_own(tmp_path):
    """Without `if __name__ == "__main__"`."""
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("True\n", "")


FORKED = """
import os, time
from robustopt.errors import SimulationFailed
from robustopt.processes import in_processes

results = in_processes(time.sleep, [(0.01,)] * 3 + [(600,)] * 9, 2, SimulationFailed)
next(results)
if os.fork() == 0:
    os.close(1)
    time.sleep(20)
    os._exit(0)
print(os.getpid(), flush=True)
time.sleep(600)
"""


def test_workers_end_with_their_parent_although_its_forked_child_lives(tmp_path):
    """The child has copies of the pipes, which it closes."""
    (tmp_path / "forked.py").write_text(FORKED, encoding="utf-8")
    with subprocess.Popen([sys.executable, "forked.py"], cwd=tmp_path, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        workers = [pid for pid in children_of(process.pid) if "robustopt.worker" in command_of(pid)]
        process.kill()
    deadline = time.monotonic() + 10
    while any(map(command_of, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(workers) == 2
    assert not any(map(command_of, workers))


def children_of(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def command_of(pid: int) -> str:
    """Return the command line of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""
