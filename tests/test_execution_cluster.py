"""Trials on a Dask cluster: a real scheduler and two workers on this machine, one of which is killed."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from scenes import FLAT, plan_of, scene

from robustopt import cli
from robustopt.execution import Workers, execute


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler, and its two workers."""
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
        yield address, workers
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


def test_a_cluster_that_loses_a_worker_changes_no_number(cluster):
    address, workers = cluster
    truth = {"friction": 0.5, "variation": {"friction": 0.1}}
    config = scene(objects={"body": FLAT}, contact={"friction": 0.45}, execution={"truth": truth})
    plan = plan_of(config)

    def kill_one(done: int, total: int, successes: int) -> None:
        if done == 25:
            workers[0].kill()

    outcomes = execute(config, plan, trials=150, workers=Workers(scheduler=address), progress=kill_one).outcomes
    assert workers[0].wait(10) != 0
    assert workers[1].poll() is None
    assert len(outcomes) == 150
    assert list(map(repr, outcomes)) == list(map(repr, execute(config, plan, trials=150).outcomes))


def test_a_scheduler_that_is_not_there_is_named(capsys, tmp_path, monkeypatch):
    from robustopt.execution import monte_carlo

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(monte_carlo, "CONNECT", 1)
    task = Path(__file__).parents[1] / "configs" / "waiter_one_block.yaml"
    small = ["solver.method=reachability", "solver.collocation_points=60"]
    assert cli.run(["execute", str(task), *small, "--backend", "dask", "--scheduler", "tcp://127.0.0.1:9"]) == 5
    assert "The Dask scheduler tcp://127.0.0.1:9 cannot be reached" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert cli.run(["execute", str(task), "--backend", "dask"]) == 2
    assert "--backend dask and --scheduler tcp://HOST:PORT go together" in capsys.readouterr().err
