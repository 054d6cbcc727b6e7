"""What an interruption must not leave half done, and where it must be heard at once."""

import multiprocessing.resource_tracker
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from robustopt import interruption, processes
from robustopt.config.load import load_config
from robustopt.errors import SimulationFailed
from robustopt.interruption import held
from robustopt.limits import TimeScalingProblem
from robustopt.processes import end_processes, in_processes
from robustopt.solvers import Plan, build_problem, solve

CONFIGS = Path(__file__).parent.parent / "configs"


def _later(seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    return timer


@pytest.fixture(autouse=True)
def heard():
    """Ctrl-C raises KeyboardInterrupt, even where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def listening(monkeypatch):
    """As a command does, until the end of the test."""
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    handlers = {number: signal.getsignal(number) for number in interruption.STOPS}
    interruption.listen()
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)
    interruption.interruptions.clear()


@pytest.mark.parametrize("number", interruption.STOPS)
def test_an_interruption_waits_until_the_end_of_what_must_not_be_left_half_done(number, listening):
    done = []

    def work():
        with held() as came:
            signal.raise_signal(number)
            done.extend(came)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert signal.getsignal(number) is interruption.on_interrupt
    assert done == [number]
    assert interruption.interruptions == [number]


def test_other_threads_and_quiet_blocks_are_not_concerned():
    handler = signal.getsignal(signal.SIGINT)
    seen = []

    def work():
        with held() as came:
            seen.append((came, signal.getsignal(signal.SIGINT)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [([], handler)]
    with held() as came:
        assert signal.getsignal(signal.SIGINT) is not handler
    assert (came, signal.getsignal(signal.SIGINT)) == ([], handler)


@pytest.mark.parametrize("step", range(6))
def test_no_handler_is_left_behind_whenever_an_interruption_comes(step, monkeypatch):
    """At each step of holding three signals and of letting them go; Ctrl-C alone ends a program with an exception."""
    previous = {number: signal.getsignal(number) for number in interruption.STOPS}
    change, steps = signal.signal, 0

    def interrupted(number, handler):
        nonlocal steps
        steps += 1
        result = change(number, handler)
        if steps == step + 1:
            signal.raise_signal(signal.SIGINT)
        return result

    monkeypatch.setattr(signal, "signal", interrupted)
    with pytest.raises(KeyboardInterrupt), held():
        pass
    assert {number: signal.getsignal(number) for number in interruption.STOPS} == previous


@pytest.mark.parametrize("number", interruption.STOPS)
def test_an_interruption_while_a_command_ends_leaves_no_traceback(number):
    code = (
        "import signal, sys; from robustopt.cli import app; sys.argv = ['robustopt', '--version']; "
        f"app.end_processes = lambda: signal.raise_signal({int(number)}); app.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (-number, "")


def test_an_interruption_of_the_first_imports_is_told_in_one_line():
    code = (
        "import sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'typer': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "from robustopt.cli import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "error: interrupted; no incomplete files are left\n")


def test_a_command_calls_the_exit_functions_of_libraries_and_then_ends_at_once():
    """A library may have a temporary folder to remove; none may complain of modules that are gone."""
    code = (
        "import atexit, sys; from robustopt.cli import app\n"
        "class Late:\n"
        "    def __del__(self): print('late')\n"
        "def run(arguments):\n"
        "    atexit.register(print, 'removed'); sys.late = Late(); return 3\n"
        "app.run = run; app.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (3, "removed\n", "")


@pytest.mark.parametrize(("error", "told"), [(KeyboardInterrupt(), False), (ValueError("lost"), True)])
def test_what_cannot_be_raised_is_told_unless_it_is_an_interruption(error, told, listening, capfd):
    class Failing:
        def __del__(self):
            raise error

    failing = Failing()
    del failing
    assert ("lost" in capfd.readouterr().err) == told


@pytest.mark.parametrize("interrupted", [False, True])
def test_what_breaks_in_a_thread_is_told_unless_an_interruption_broke_it(interrupted, listening, capfd):
    def fail():
        raise ValueError("lost")

    if interrupted:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    thread = threading.Thread(target=fail)
    thread.start()
    thread.join()
    assert ("lost" in capfd.readouterr().err) != interrupted


def _deaf(_number: int) -> tuple[int, bool]:
    time.sleep(0.2)  # so that both workers get some
    return os.getpid(), signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_workers_do_not_hear_the_interruption_of_a_terminal():
    end_processes()
    told = list(in_processes(_deaf, [(k,) for k in range(8)], 2, SimulationFailed))
    assert len({pid for pid, _ in told}) == 2
    assert all(deaf for _, deaf in told)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    end_processes()
    for pid, _ in told:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_workers_serve_where_signals_cannot_be_blocked(monkeypatch):
    """As on Windows, which has no process that tracks resources of POSIX either."""
    end_processes()
    monkeypatch.delattr(signal, "pthread_sigmask")
    monkeypatch.setattr(multiprocessing.resource_tracker, "ensure_running", lambda: pytest.fail("begun"))
    assert list(in_processes(abs, [(-1,), (2,)], 2, SimulationFailed)) == [1, 2]
    end_processes()


@pytest.mark.parametrize("moment", range(6))
def test_an_interruption_while_tasks_are_given_leaves_no_worker_and_no_thread(moment, listening, monkeypatch):
    given = iter(range(100))
    give = processes._give

    def interrupted(*arguments):
        with held():
            result = give(*arguments)
            if next(given) == moment:
                signal.raise_signal(signal.SIGINT)
        return result

    threads = set(threading.enumerate())
    monkeypatch.setattr(processes, "_give", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(in_processes(abs, [(-k,) for k in range(10)], 2, SimulationFailed))
    assert not processes.begun(2)
    assert set(threading.enumerate()) <= threads


def by_ipopt(name: str, points: int) -> tuple[TimeScalingProblem, Plan, float]:
    """A problem, its plan, and how long Ipopt takes once all is compiled [s]."""
    changes = ["solver.method=ipopt", f"solver.collocation_points={points}"]
    problem = build_problem(load_config(CONFIGS / f"{name}.yaml", changes))
    solve(problem)  # compiles
    began = time.perf_counter()
    plan = solve(problem)
    return problem, plan, time.perf_counter() - began


def test_ipopt_stops_soon_and_says_nothing_of_its_own(capfd):
    problem, plan, seconds = by_ipopt("waiter_two_blocks", 2000)

    def solve_again():
        for _ in range(20):  # on a busy machine one solve may be over before the interruption comes
            solve(problem)

    timer = _later(0.3 * seconds)
    with pytest.raises(KeyboardInterrupt):
        solve_again()
    timer.join()
    assert capfd.readouterr() == ("", "")
    assert np.isfinite(plan.duration)


@pytest.mark.slow
@pytest.mark.parametrize("handler", [signal.SIG_IGN, lambda *_: None], ids=["ignored", "handled"])
def test_ipopt_goes_on_where_the_program_does_not_stop(handler):
    problem, plan, seconds = by_ipopt("waiter_one_block", 1000)
    previous = signal.signal(signal.SIGINT, handler)
    try:
        timer = _later(0.3 * seconds)
        again = solve(problem)
        timer.join()
    finally:
        signal.signal(signal.SIGINT, previous)
    assert again.status is plan.status
    assert np.array_equal(again.x, plan.x)


ORPHANS = """
import os, sys, time
from robustopt.errors import SimulationFailed
from robustopt.processes import in_processes

def work(k):
    time.sleep(0.3)
    return os.getpid()

for pid in in_processes(work, [(k,) for k in range(1000)], 2, SimulationFailed):
    print(pid, flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_workers_end_when_the_process_that_began_them_is_killed(tmp_path, number):
    (tmp_path / "work.py").write_text(ORPHANS, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "work.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    pids = {int(process.stdout.readline()) for _ in range(6)}
    process.send_signal(number)
    assert process.wait() == -number
    process.stdout.close()
    left, deadline = pids, time.monotonic() + 30
    while left and time.monotonic() < deadline:
        time.sleep(0.1)
        left = {pid for pid in left if Path(f"/proc/{pid}").exists()}
    assert pids
    assert not left
