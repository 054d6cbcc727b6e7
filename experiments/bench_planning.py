"""Time planning beside other solvers of the same rows and beside the paper.

    python experiments/bench_planning.py [--quick] [--out results/benchmarks]

`make bench` writes planning.csv, planning.md and planning.svg (and .png) in a few minutes; `--quick` is for the tests.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import contenders
import numpy as np
from bench_figure import Record
from bench_rate import control_rate
from bench_report import HELP, NOTHING, PLAN, write_report
from figure_3 import PAPER_FIGURE_3
from timing import interleaved, machine_facts, spread

from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.errors import RobustOptError
from robustopt.limits import TimeScalingProblem
from robustopt.path import build_path
from robustopt.robot import load_robot
from robustopt.solvers import Plan, Status, build_rows, solve
from robustopt.solvers.batch import BatchPlanner
from robustopt.solvers.plan import duration_of
from robustopt.solvers.reachability import solve_reachability

ROOT = Path(__file__).resolve().parents[1]
TWO_BLOCKS, SIDE_BY_SIDE = "waiter_two_blocks", "waiter_side_by_side"
PACKAGES = ("numpy", "numba", "casadi", "highspy", "mujoco", "toppra", "copp-py")

FRICTION_ACCELERATION = "uncertainty={friction: [0.4, 0.6], joint_acceleration: {deviation: 0.3}}"
ALL_FIVE = """uncertainty={friction: [0.4, 0.6], joint_acceleration: {deviation: 0.3}, contact_points: 0.002,
  center_of_mass: {lower: [0.003, 0.003, 0.01], upper: [0.003, 0.003, 0.01]},
  mass: {lower: [0.45, 0.55], upper: [0.45, 0.55]}}"""
CASES = {"none": "uncertainty={}", "friction, acceleration": FRICTION_ACCELERATION, "all five": ALL_FIVE}

BATCHES: dict[str, dict[str, tuple[float, float]]] = {
    "friction": {"contact.friction": (0.2, 1.0)},
    "friction, height of a centre of mass": {
        "contact.friction": (0.2, 1.0),
        "objects.upper.center_of_mass.2": (-0.02, 0.02),
    },
    "friction, intervals of centre of mass, acceleration": {
        "contact.friction": (0.2, 1.0),
        "uncertainty.center_of_mass.upper.2": (0.0, 0.02),
        "uncertainty.joint_acceleration.deviation": (0.0, 0.3),
    },
}
"""Ranges of the parameters that differ from setting to setting of a batch."""

REFERENCE = 1000
"""Largest N for which a whole plan is repeated in full; larger problems are repeated less often."""


@dataclass(frozen=True)
class Size:
    """The extent of the benchmark: numbers of collocation points and repetitions of each part.

    Attributes:
        growth: Grids whose time per point is compared with the first; they are so fine that fixed costs hardly count.
        growth_turn: Time for which each of them is repeated in turn [s].
        from_source: Number of cold starts with nothing compiled.
        commands: Number of runs of each whole process.
        rate: Arguments of `control_rate`.
    """

    rows: tuple[int, ...] = (100, 200, 500, 1000, 2000, 5000)
    whole: tuple[int, ...] = (100, 200, 500, 1000, 2000, 5000)
    split: tuple[int, ...] = (50, 100, 200, 500, 1000, 2000)
    grids: tuple[int, ...] = (50, 100, 200, 500, 1000, 2000, 5000)
    repetitions: int = 21
    growth: tuple[int, ...] = (1000, 2000, 5000)
    growth_repetitions: int = 7
    growth_turn: float = 0.5
    split_repetitions: int = 3
    settings: int = 1000
    batch_repetitions: int = 5
    cold: int = 5
    from_source: int = 2
    commands: int = 5
    rate: tuple[int, tuple[int, ...], int] = (100, (200, 1000), 1000)
    configs: tuple[str, ...] = tuple(sorted(path.stem for path in (ROOT / "configs").glob("waiter_*.yaml")))


QUICK = Size(
    rows=(20, 40), whole=(20, 40), split=(20,), grids=(20, 40, 80), repetitions=2, growth=(20, 40),
    growth_repetitions=2, growth_turn=0.02, split_repetitions=1, settings=8, batch_repetitions=2, cold=1, from_source=0,
    commands=1, rate=(2, (20, 40), 4), configs=(TWO_BLOCKS, SIDE_BY_SIDE),
)  # fmt: skip


def configured(name: str, points: int, *overrides: str) -> Config:
    return load_config(ROOT / "configs" / f"{name}.yaml", [f"solver.collocation_points={points}", *overrides])


def task(name: str, *overrides: str) -> Callable[[int], TimeScalingProblem]:
    """Return a function from N to the problem of a configuration; robot and path do not depend on N and are shared."""
    config = configured(name, 200, *overrides)
    robot = load_robot(config)
    path = build_path(config, robot)
    return lambda points: build_rows(configured(name, points, *overrides), robot, path)


def solved(problem: TimeScalingProblem, method: str = "reachability") -> Plan:
    plan = solve(problem, method)
    if plan.status is not Status.SOLVED:
        raise SystemExit(f"{problem.config.name}, {len(problem.s)} grid points, {method}: {plan.message}")
    return plan


def solver_stage(size: Size) -> Iterator[Record]:
    """Give the same rows to every solver; ratios are medians over rounds in which the solvers take turns."""
    for name in (TWO_BLOCKS, SIDE_BY_SIDE):
        build = task(name)
        for points in size.rows:
            problem = build(points)
            rows = contenders.rows_of(problem)
            calls = {solver: prepare(rows) for solver, prepare in contenders.CONTENDERS.items()}
            durations = {solver: duration_of(problem.ds, call()) for solver, call in calls.items()}
            durations[contenders.STAGE] = solve_reachability(problem).duration
            seconds = interleaved({contenders.STAGE: partial(solve_reachability, problem), **calls}, size.repetitions)
            for solver, times in seconds.items():
                yield {
                    "part": "solver stage",
                    "config": name,
                    "solver": solver,
                    "N": points,
                    "rows": rows.a.shape[1],
                    **spread(times),
                    "times_passes": float(np.median(times / seconds[contenders.OURS])),
                    "times_stage": float(np.median(times / seconds[contenders.STAGE])),
                    "duration": durations[solver],
                    "longer": durations[solver] / durations[contenders.OURS] - 1,
                }


def cold_start(size: Size) -> Iterator[Record]:
    """Time the first call in a fresh process, the solvers in turns; ours also with nothing compiled."""
    points = size.rows[1]
    runs: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.npz"
        contenders.rows_of(task(TWO_BLOCKS)(points)).save(file)
        for _ in range(size.cold):
            for solver in contenders.CONTENDERS:
                runs.setdefault(solver, []).append(_fresh(solver, file, {}))
        for turn in range(size.from_source):
            run = _fresh(contenders.OURS, file, {"NUMBA_CACHE_DIR": str(Path(folder) / f"empty{turn}")})
            runs.setdefault(f"{contenders.OURS}, nothing compiled", []).append(run)
    for solver, measured in runs.items():
        yield {
            "part": "cold start",
            "config": TWO_BLOCKS,
            "solver": solver,
            "N": points,
            **spread(np.array([run["first"] for run in measured])),
            "import_seconds": float(np.median([run["import"] for run in measured])),
            "second_seconds": float(np.median([run["second"] for run in measured])),
        }


def _fresh(solver: str, file: Path, environment: dict[str, str]) -> dict[str, float]:
    command = [sys.executable, contenders.__file__, solver, str(file)]
    run = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment})
    return dict(json.loads(run.stdout))


def whole_plan(size: Size) -> Iterator[Record]:
    """Time the way from the configuration to the plan, without robot and path, and these two by themselves."""
    config = configured(TWO_BLOCKS, 200)
    robot = load_robot(config)
    path = build_path(config, robot)
    steps: dict[str, Callable[[], object]] = {
        "robot": partial(load_robot, config),
        "path": partial(build_path, config, robot),
    }
    for step, times in interleaved(steps, size.repetitions).items():
        yield {"part": "whole plan", "config": TWO_BLOCKS, "solver": step, **spread(times)}

    def plan(config: Config) -> Plan:
        return solved(build_rows(config, robot, path))

    for points in size.whole:
        configs = {case: configured(TWO_BLOCKS, points, override) for case, override in CASES.items()}
        durations = {case: plan(config).duration for case, config in configs.items()}
        calls = {case: partial(plan, config) for case, config in configs.items()}
        for case, times in interleaved(calls, max(size.repetitions * REFERENCE // max(points, REFERENCE), 2)).items():
            yield {
                "part": "whole plan",
                "config": TWO_BLOCKS,
                "uncertainty": case,
                "solver": contenders.PLAN,
                "N": points,
                **spread(times),
                "duration": durations[case],
            }
    yield from _growth(plan, size)


def _growth(plan: Callable[[Config], Plan], size: Size) -> Iterator[Record]:
    """Compare the time per collocation point with the first grid; the grids take turns of equal length."""
    configs = {(case, points): configured(TWO_BLOCKS, points, CASES[case]) for case in CASES for points in size.growth}
    calls = {key: partial(plan, config) for key, config in configs.items()}
    seconds = interleaved(calls, size.growth_repetitions, size.growth_turn)
    first = size.growth[0]
    for (case, points), times in seconds.items():
        yield {
            "part": "growth",
            "config": TWO_BLOCKS,
            "uncertainty": case,
            "solver": contenders.PLAN,
            "N": points,
            **spread(times),
            "per_point": float(np.median(times / points / (seconds[case, first] / first))),
        }


def batches(size: Size) -> Iterator[Record]:
    """Time the durations of many settings, N = 200, on one thread and on all cores, with empty caches."""
    config = configured(TWO_BLOCKS, 200)
    cores = BatchPlanner(config).workers
    slowest = list(BATCHES.values())[-1]
    BatchPlanner(config).plan_durations(_drawn(slowest, size.settings))  # begins the worker processes
    for beliefs, ranges in BATCHES.items():
        settings = _drawn(ranges, size.settings)
        planners = {workers: BatchPlanner(config, workers) for workers in sorted({1, cores})}
        calls = {workers: partial(planner.plan_durations, settings) for workers, planner in planners.items()}
        for workers, times in interleaved(calls, size.batch_repetitions).items():
            yield {
                "part": "batch",
                "config": TWO_BLOCKS,
                "uncertainty": beliefs,
                "solver": contenders.PLAN,
                "N": 200,
                "settings": size.settings,
                "workers": workers,
                **spread(times),
            }


def _drawn(ranges: dict[str, tuple[float, float]], count: int) -> list[dict[str, float]]:
    """Draw settings, each value from its range."""
    low, high = zip(*ranges.values(), strict=True)
    drawn = np.random.default_rng(0).uniform(low, high, (count, len(ranges))).tolist()
    return [dict(zip(ranges, values, strict=True)) for values in drawn]


def papers_split(size: Size) -> Iterator[Record]:
    """Time Ipopt with inner linear programs over the contact forces, beside the paper's computing times."""
    builds = {case: task(TWO_BLOCKS, CASES[case]) for case in ("none", "all five")}
    problems = {(case, points): build(points) for case, build in builds.items() for points in size.split}
    calls = {key: partial(solved, problem, "ipopt") for key, problem in problems.items()}
    seconds = interleaved(calls, size.split_repetitions)
    for (case, points), problem in problems.items():
        plan, fastest = solved(problem, "ipopt"), solved(problem)
        record: Record = {
            "part": "paper's split",
            "config": TWO_BLOCKS,
            "uncertainty": case,
            "solver": contenders.IPOPT,
            "N": points,
            **spread(seconds[case, points]),
            "duration": plan.duration,
            "longer": plan.duration / fastest.duration - 1,
            "rounds": int(plan.statistics["rounds"]),
            "inner_programs": int(plan.statistics["inner_programs"]),
            "inner_seconds": plan.statistics["inner_seconds"],
        }
        yield {**record, "paper_seconds": PAPER_FIGURE_3[points]} if points in PAPER_FIGURE_3 else record


def discretisation(size: Size) -> Iterator[Record]:
    """Compare the duration with the one on the finest grid, for every waiter configuration."""
    for name in size.configs:
        try:
            build = task(name)
        except RobustOptError as error:
            print(f"left out: {name}: {error}", file=sys.stderr)
            continue
        durations = {points: solved(build(points)).duration for points in size.grids}
        for points, duration in durations.items():
            excess = duration / durations[size.grids[-1]] - 1
            yield {
                "part": "discretisation",
                "config": name,
                "solver": "reachability",
                "N": points,
                "duration": duration,
                "excess": excess,
            }


def at_control_rate(size: Size) -> Iterator[Record]:
    """Time new paths with the same settings, and the public call beside the passes."""
    yield from control_rate(*size.rate)


def command_line(size: Size) -> Iterator[Record]:
    """Time whole processes, beside one that does nothing, from the start of the interpreter to its end."""
    robustopt = str(Path(sys.executable).with_name("robustopt"))
    config = str(ROOT / "configs" / f"{TWO_BLOCKS}.yaml")
    with tempfile.TemporaryDirectory() as folder:
        commands = {
            NOTHING: [sys.executable, "-c", "pass"],
            HELP: [robustopt, "--help"],
            PLAN: [robustopt, "plan", config, "--no-figures"],
        }
        calls = {
            name: partial(subprocess.run, command, check=True, stdout=subprocess.DEVNULL, cwd=folder)
            for name, command in commands.items()
        }
        for name, times in interleaved(calls, size.commands).items():
            yield {"part": "command line", "config": TWO_BLOCKS, "solver": name, **spread(times)}


def main() -> None:
    parser = argparse.ArgumentParser(description="Computing times of planning: CSV, Markdown and a figure.")
    parser.add_argument("--quick", action="store_true", help="small and few: to see that it runs")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    arguments = parser.parse_args()
    size = QUICK if arguments.quick else Size()
    began, machine = time.perf_counter(), machine_facts(PACKAGES)
    records: list[Record] = []
    parts = (solver_stage, cold_start, whole_plan, at_control_rate, command_line, batches, papers_split, discretisation)
    for part in parts:
        records += part(size)
        print(f"{time.perf_counter() - began:6.1f} s  {part.__name__}", flush=True)
    for path in write_report(records, machine, arguments.out):
        print(path)


if __name__ == "__main__":
    main()
