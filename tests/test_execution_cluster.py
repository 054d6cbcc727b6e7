"""Trials on a Dask cluster: a real scheduler and two workers on this machine, one of which is killed."""

import socket
import subprocess
import sys
import threading
import time
from contextlib import nullcontext
from pathlib import Path

import pytest
from scenes import FIXTURES, FLAT, scene

from robustopt import cli
from robustopt.cli import commands
from robustopt.config.load import dump
from robustopt.errors import SimulationFailed
from robustopt.runs.store import read_summary
from robustopt.simulation import cluster as cluster_module
from robustopt.simulation import monte_carlo
from robustopt.simulation.cluster import on_cluster


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler, its two workers, and the process of the scheduler."""
    file = tmp_path / "scheduler.json"
    common = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    dask = [sys.executable, "-m", "dask"]
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    processes = [subprocess.Popen([*dask, *scheduler], **common)]
    try:
        address = _address(file)
        worker = ["worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
        workers = [subprocess.Popen([*dask, *worker], **common) for _ in range(2)]
        processes += workers
        _wait_for_workers(address, 2)
        yield address, workers, processes[0]
    finally:
        for process in processes[::-1]:
            process.kill()
            process.wait()


def _address(file: Path) -> str:
    import json

    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError):
            time.sleep(0.1)
    raise AssertionError("the scheduler did not start")


def _wait_for_workers(address: str, count: int) -> None:
    from distributed import Client

    with Client(address, timeout=60) as client:
        client.wait_for_workers(count, timeout=60)


@pytest.mark.slow
def test_workers_and_a_cluster_that_loses_one_change_no_byte(cluster, tmp_path, monkeypatch):
    """The command with one process, with two, and on a cluster of which a worker is killed on the way."""
    address, workers, _ = cluster
    truth = {"friction": 0.5, "variation": {"friction": 0.1}}
    config = scene(
        objects={"body": FLAT}, contact={"friction": 0.45}, execution={"truth": truth},
        robot_keys={"model": str(FIXTURES / "slide.xml")},
    )  # fmt: skip
    (tmp_path / "task.yaml").write_text(dump(config))
    monkeypatch.setattr(monte_carlo, "cores", lambda: 2)

    def kill_one(done: int, total: int, successes: int) -> None:
        if done == 25:
            workers[0].kill()

    def executions(name: str, *options: str) -> bytes:
        command = ["execute", str(tmp_path / "task.yaml"), "--trials", "150", "--no-figures", "--quiet"]
        assert cli.run([*command, *options, "--out", str(tmp_path / name)]) == 0
        return (tmp_path / name / "executions.csv").read_bytes()

    one, two = executions("one"), executions("two", "--workers", "2")
    monkeypatch.setattr(commands, "trials_bar", lambda silent: nullcontext(kill_one))
    by_dask = executions("cluster", "--backend", "dask", "--scheduler", address)
    assert workers[0].wait(10) != 0
    assert workers[1].poll() is None
    assert one.count(b"\n") == 151
    assert one == two == by_dask
    feedback = [read_summary(tmp_path / name).executions.feedback for name in ("one", "two", "cluster")]
    assert feedback[0] == feedback[1] == feedback[2]


def test_a_scheduler_that_is_not_there_is_named(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cluster_module, "CONNECT", 1)
    task = Path(__file__).parents[1] / "configs" / "waiter_one_block.yaml"
    small = ["solver.method=reachability", "solver.collocation_points=60"]
    assert cli.run(["execute", str(task), *small, "--backend", "dask", "--scheduler", "tcp://127.0.0.1:9"]) == 5
    assert "The Dask scheduler tcp://127.0.0.1:9 cannot be reached" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert cli.run(["execute", str(task), "--backend", "dask"]) == 2
    assert "--backend dask and --scheduler tcp://HOST:PORT go together" in capsys.readouterr().err


@pytest.mark.parametrize("answer", [b"", None, b"HTTP/1.1 400 Bad Request\r\n\r\n"], ids=["closes", "silent", "web"])
def test_an_address_that_is_no_scheduler_is_told_soon(monkeypatch, answer):
    monkeypatch.setattr(cluster_module, "CONNECT", 1)
    with socket.create_server(("127.0.0.1", 0)) as server:
        callers = []

        def serve() -> None:
            while True:
                try:
                    caller, _ = server.accept()
                except OSError:
                    return
                callers.append(caller)
                if answer is not None:
                    caller.sendall(answer)
                    caller.shutdown(socket.SHUT_RDWR)

        threading.Thread(target=serve, daemon=True).start()
        start = time.monotonic()
        with pytest.raises(SimulationFailed, match="cannot be reached"):
            list(on_cluster(len, [("abc",)], f"tcp://127.0.0.1:{server.getsockname()[1]}"))
        assert time.monotonic() - start < 15
        for caller in callers:
            caller.close()


@pytest.mark.slow
def test_a_scheduler_that_dies_is_a_failure(cluster):
    address, _, scheduler = cluster
    results = on_cluster(time.sleep, [(1.0,)] * 100, address)
    assert next(results) is None
    scheduler.kill()
    start = time.monotonic()
    with pytest.raises(SimulationFailed, match="The Dask cluster died"):
        list(results)
    assert time.monotonic() - start < 30
