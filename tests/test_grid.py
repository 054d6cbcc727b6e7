"""Grids that follow the path: waypoints are grid points, and duration and violations are as accurate as estimated."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import toppra
from scenes import BOX, CONFIGS, FIXTURES, bang_bang, scene, waiter
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.learning.learner import Belief
from robustopt.limits.grid import Grid, first_grid, numbered_grid
from robustopt.runs.beliefs import Planner
from robustopt.runs.plan_run import plan_task, summary
from robustopt.solvers import Plan, Status, build_problem, refine, solve
from robustopt.solvers.batch import BatchPlanner
from robustopt.solvers.diagnosis import diagnose

AUTO = {"solver": {"collocation_points": "auto"}}
CASES: dict[str, Any] = json.loads((FIXTURES / "waypoints.json").read_text(encoding="utf-8"))
"""Waypoints with limits of speed and acceleration from public threads and test suites about time parameterization."""

SLOW_WAITERS = ("side_by_side", "bridge")

CLOSED_FORMS = {
    "suite_small_joint_3": 4.0 * np.sqrt(1e-7 / 1000.0),  # to 1e-7 rad and back with 1000 rad/s^2
    "totg_test1": 2.0 * np.sqrt(1.0 / 0.00249),
}
"""Durations [s] of cases that are too small or too slow for toppra's tolerances."""


def planned(folder: Path, case: dict[str, Any], **solver: Any) -> Plan:
    """Plan of a robot of slides without gravity or load."""
    n = len(case["vlim"])
    link = '<body><joint name="j{}" type="slide" axis="1 0 0" actuatorfrcrange="-1e12 1e12"/>'
    link += '<inertial pos="0 0 0" mass="0.1" diaginertia="1e-3 1e-3 1e-3"/>'
    body = "".join(link.format(k) for k in range(n)) + '<site name="flange"/>' + n * "</body>"
    (folder / "slides.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    limits = {f"j{k}": {"velocity": case["vlim"][k], "acceleration": case["alim"][k]} for k in range(n)}
    data = {
        "name": "slides", "gravity": [0, 0, 0], "tray": {"size": [0.1, 0.1, 0.01], "mass": 1e-3}, "solver": solver,
        "robot": {"model": "slides.xml", "limits": limits, "collision": {"check": False}},
        "path": {"joints": case["waypoints"]}, "folder": folder,
    }  # fmt: skip
    return solve(build_problem(with_values(Config.model_validate(data), {})))


def toppra_duration(case: dict[str, Any], s: np.ndarray) -> float:
    """Duration of toppra's timing on the same spline [s]; speeds are scaled to suit its tolerances."""
    w, v, a = (np.array(case[key], dtype=float) for key in ("waypoints", "vlim", "alim"))
    chord = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(w, axis=0), axis=1))]
    path = toppra.SplineInterpolator(chord / chord[-1], w)
    scale = 300.0 if a.max() < 0.01 else 1.0
    both = DiscretizationType.Interpolation
    rows = [
        JointVelocityConstraint(scale * np.c_[-v, v]),
        JointAccelerationConstraint(scale**2 * np.c_[-a, a], discretization_scheme=both),
    ]
    _, sd, _ = TOPPRA(rows, path, gridpoints=s, solver_wrapper="seidel").compute_parameterization(0, 0)
    return float(scale * np.sum(2 * np.diff(s) / (sd[1:] + sd[:-1]))) if sd is not None else np.nan


def finer(s: np.ndarray, parts: int = 8) -> np.ndarray:
    return Grid(s, np.zeros(len(s), dtype=int)).split(parts).s


# Waypoints ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
@pytest.mark.parametrize("name", CASES)
def test_waypoints_of_public_threads(tmp_path: Path, name: str, method: str) -> None:
    plan = planned(tmp_path, CASES[name], method=method)
    assert plan.status is Status.SOLVED
    assert certify(plan).passed
    assert plan.problem.limits.track.grid.accuracy.enough
    if name in CLOSED_FORMS:
        assert 1.0 - 1e-9 <= plan.duration / CLOSED_FORMS[name] <= 1.001
        return
    same, fine = (plan.duration / toppra_duration(CASES[name], s) for s in (plan.s, finer(plan.s)))
    assert np.isnan(same) or 0.9997 <= same <= 1.00001
    assert np.isnan(fine) or 0.9997 <= fine <= 1.001


def random_waypoints(count: int, seed: int) -> dict[str, Any]:
    waypoints = np.random.default_rng(seed).normal(size=(count, 7)).tolist()
    return {"waypoints": waypoints, "vlim": [2.175] * 4 + [2.61] * 3, "alim": [15, 7.5, 10, 12.5, 15, 20, 20]}


@pytest.mark.parametrize(
    ("count", "seed"),
    [pytest.param(n, k, marks=pytest.mark.slow if k > 1 else ()) for n in (6, 15) for k in range(8)],
)
def test_random_waypoints(tmp_path: Path, count: int, seed: int) -> None:
    """On 200 intervals with the waypoints between them, certificates fail by 3 to 9 %."""
    case = random_waypoints(count, seed)
    plan = planned(tmp_path, case, method="reachability")
    assert certify(plan).passed
    assert set(plan.problem.path.waypoints) <= set(plan.s)
    fine = toppra_duration(case, finer(plan.s, 4))
    assert 0.9997 <= plan.duration / fine <= 1.001


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
def test_a_joint_that_turns_round(tmp_path: Path, method: str) -> None:
    positions = [0.0, 0.1, 0.2, 0.3, 0.4, 0.399, 0.3, 0.2, 0.1, 0.0]
    case = {"waypoints": [[q] for q in positions], "vlim": [0.5], "alim": [0.2]}
    plan = planned(tmp_path, case, method=method)
    assert certify(plan).passed
    there, back = bang_bang(0.4, 0.2), bang_bang(0.4, 0.2)
    assert there + back <= 1.001 * plan.duration


def test_a_straight_line_needs_few_points(tmp_path: Path) -> None:
    plan = planned(tmp_path, {"waypoints": [[0.0, 0.0], [1.0, 2.0]], "vlim": [9, 9], "alim": [1, 1]}, method="ipopt")
    assert plan.problem.limits.track.grid.intervals < 60
    assert plan.duration == pytest.approx(bang_bang(2.0, 1.0), rel=1e-6)


# Grids ----------------------------------------------------------------------------------------------------


class Line:
    """A path of which a grid needs breaks and kinks alone."""

    def __init__(self, breaks: list[float], kinks: list[float]) -> None:
        self.breaks, self.kinks = np.array(breaks), np.array(kinks)

    def piece_at(self, s: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(self.breaks, s, side="right") - 1, 0, len(self.breaks) - 2)


@pytest.mark.parametrize("kinks", [[], [0.5], [1e-4, 0.1, 0.100001, 0.7], list(np.linspace(0, 1, 500)[1:-1])])
@pytest.mark.parametrize("breaks", [[0.0, 1.0], [0.0, 0.31, 1.0]])
def test_the_first_grid_contains_kinks_and_stops(breaks: list[float], kinks: list[float]) -> None:
    grid = first_grid(Line(breaks, kinks))  # type: ignore[arg-type]
    assert set(kinks) <= set(grid.s)
    assert (np.diff(grid.s) >= 0).all()
    assert grid.s[:-1][np.diff(grid.s) == 0].tolist() == breaks[1:-1]
    assert grid.s[[0, -1]].tolist() == [0.0, 1.0]
    for k, piece in enumerate(pairwise(breaks)):
        assert (grid.s[grid.piece == k][[0, -1]] == piece).all()
    assert grid.intervals >= 48


def test_a_given_number_of_intervals_is_kept() -> None:
    grid = numbered_grid(Line([0.0, 1.0], [0.123, 0.124, 0.8]), 40)  # type: ignore[arg-type]
    assert len(grid.s) == 41
    assert {0.123, 0.124, 0.8} <= set(grid.s)
    crowd = numbered_grid(Line([0.0, 1.0], list(np.linspace(0, 1, 100)[1:-1])), 40)  # type: ignore[arg-type]
    np.testing.assert_array_equal(crowd.s, numbered_grid(Line([0.0, 1.0], []), 40).s)  # type: ignore[arg-type]


def test_splitting_keeps_points_and_stops() -> None:
    grid = Grid(np.array([0.0, 0.5, 0.5, 1.0]), np.array([0, 0, 1, 1]))
    split = grid.split(np.array([2, 3, 4]))
    assert split.s.tolist() == [0.0, 0.25, 0.5, 0.5, 0.625, 0.75, 0.875, 1.0]
    assert split.piece.tolist() == [0, 0, 0, 1, 1, 1, 1, 1]


@pytest.mark.parametrize(
    "name", ["one_block", "two_blocks", "heavy", *(pytest.param(n, marks=pytest.mark.slow) for n in SLOW_WAITERS)]
)
def test_the_estimate_is_true(name: str) -> None:
    config = waiter(name, "solver.collocation_points=auto", "solver.method=reachability")
    problem = build_problem(config)
    grid = problem.limits.track.grid
    limit = 2 * duration(config, 3000) - duration(config, 1500)  # the loss is proportional to the spacing
    found = solve(problem)
    assert found.duration / limit - 1.0 <= 1.2e-3
    assert grid.accuracy is not None
    assert grid.accuracy.error <= 1e-3
    assert certify(found).passed
    assert grid.intervals < 1100


def duration(config: Config, points: int) -> float:
    return solve(build_problem(with_values(config, {"solver.collocation_points": points}))).duration


@pytest.mark.slow
@pytest.mark.parametrize("name", ["humanoid_step", "humanoid_rail", "humanoid_tray", "pick_suction", "pick_gripper"])
def test_other_tasks_find_their_grid(name: str) -> None:
    config = load_config(CONFIGS / f"{name}.yaml", ["solver.collocation_points=auto", "solver.method=reachability"])
    problem = build_problem(config)
    assert problem.limits.track.grid.accuracy.enough
    assert set(problem.path.switches) <= set(problem.s)
    assert certify(solve(problem)).passed


# One grid for a task --------------------------------------------------------------------------------------


def test_plan_batch_and_learner_share_the_grid() -> None:
    config = scene(objects={"box": BOX}, contact={"friction": 0.4}, uncertainty={"friction": [0.3, 0.5]}, **AUTO)
    s = build_problem(config).s
    planner = BatchPlanner(config)
    for setting in ({}, {"contact.friction.box": 0.45}):
        np.testing.assert_array_equal(planner.plans([setting])[0].s, s)
    beliefs = Planner(config)
    for friction in (None, 0.7):
        np.testing.assert_array_equal(beliefs.plan(Belief(friction=friction)).plan.s, s)
    np.testing.assert_array_equal(beliefs._track(4).s[::4], s)


def test_the_cost_does_not_change_the_grid() -> None:
    config = scene(joints=[[0.0], [1.0], [0.4]], **AUTO)
    smooth = with_values(config, {"solver": {"method": "ipopt", "cost": "smoothness", "weight": 1.0}})
    np.testing.assert_array_equal(build_problem(config).s, build_problem(smooth).s)


def test_an_infeasible_task_is_diagnosed_on_a_fine_grid() -> None:
    config = scene(objects={"box": BOX}, tray={"pose": {"rpy": [0.0, 0.6, 0.0]}}, contact={"friction": 0.3}, **AUTO)
    plan = solve(build_problem(config))
    assert plan.status is Status.INFEASIBLE
    assert plan.problem.limits.track.grid.intervals > 300
    assert diagnose(plan).conflicts == (("slip of box on tray",),)
    grid = summary(plan_task(config)).grid
    assert grid is not None
    assert (grid.error, grid.enough) == (None, False)


def test_the_bound_of_the_search_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refine, "MOST_INTERVALS", 150)
    config = waiter("heavy", "solver.collocation_points=auto", "solver.method=reachability")
    found = summary(plan_task(config))
    assert found.grid is not None
    assert found.grid.error > 1e-3
    assert found.message.endswith("The search for a finer grid ended at its bound.")
    assert found.size.collocation_points <= 150


def test_summaries_say_the_estimate(run: Any, tmp_path: Path) -> None:
    auto = (CONFIGS / "waiter_one_block.yaml", "solver.collocation_points=auto", "solver.method=reachability")
    code, out, _ = run("plan", *auto, "--no-figures", "--out", "auto")
    assert code == 0
    assert "above that of ever finer grids (estimate)" in out
    stored = json.loads((tmp_path / "auto" / "summary.json").read_text(encoding="utf-8"))
    assert 0.0 < stored["grid"]["error"] <= 1e-3
    code, out, _ = run("execute", "auto", "--trials", 1, "--json")
    assert code == 0
    assert json.loads(out)["size"] == stored["size"]
    code, out, _ = run("plan", *auto, "solver.collocation_points=60", "--no-figures", "--json", "--out", "number")
    assert json.loads(out)["grid"] is None
