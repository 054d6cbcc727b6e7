"""Batches of plans against single plans: the same bits, whatever the number of workers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import robustopt as ro
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError, SolverFailed
from robustopt.processes import end_processes, in_processes
from robustopt.solvers import Plan, Status, batch, build_problem, solve
from robustopt.solvers.batch import BatchPlanner, with_setting

CONFIGS = Path(__file__).parents[1] / "configs"
HEIGHT, DEVIATION = "objects.upper.center_of_mass.2", "uncertainty.joint_acceleration.deviation"
CUP_FORCE = "objects.carton.held_by.suction.force"

SETTINGS: dict[str, list[dict[str, Any]]] = {
    "waiter_two_blocks": [
        {},
        {"contact.friction": 0.3},
        {"contact.friction.upper": 0.2, "contact.friction.lower": 0.6},
        {"contact.friction": 0.4, HEIGHT: 0.02},
        {"uncertainty.center_of_mass.upper.2": 0.01, "uncertainty.center_of_mass.upper.0": 0.003, DEVIATION: 0.3},
        {"uncertainty.friction.upper.0": 0.25, "uncertainty.mass.upper": [0.4, 0.6]},
        {"uncertainty.contact_points.lower": 0.004, "tray.mass": 2.0},
        {DEVIATION: 50.0},  # no plan
        {"contact.friction": 0.05},
    ],
    "waiter_side_by_side": [
        {},
        {"uncertainty.friction.bottle.0": 0.2},
        {"uncertainty.mass.bottle.1": 1.0, "objects.lid.center_of_mass": [0.01, 0.0, 0.0]},
    ],
    "waiter_one_block": [{"uncertainty.friction.0": mu, DEVIATION: d} for mu in (0.2, 0.5) for d in (0.0, 0.5)],
    "waiter_heavy": [{}, {"contact.friction": 0.3}],
    "waiter_bridge": [{}, {"contact.friction": 0.4}],
    "pick_suction": [{}, {CUP_FORCE: 19.0}, {CUP_FORCE: [16.0, 18.0]}, {CUP_FORCE: 5.0}],  # the last has no plan
    "pick_gripper": [{}, {"objects.casting.held_by.grip.force": 28.0}],
}


@cache
def config_of(name: str, *overrides: str) -> Config:
    return load_config(CONFIGS / f"{name}.yaml", ["solver.collocation_points=40", "execution=null", *overrides])


def single(config: Config, setting: dict[str, Any]) -> Plan:
    return solve(build_problem(with_setting(config, setting)), "reachability")


def shared_settings(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that grows by the number of settings each time that processes share some."""
    counts: list[int] = []

    def counted(function: Any, parts: Any, *others: Any) -> Any:
        counts.append(sum(len(part[1]) for part in parts))
        return in_processes(function, parts, *others)

    monkeypatch.setattr(batch, "in_processes", counted)
    return counts


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_plans_of_a_batch_are_the_single_plans_bit_for_bit(name: str) -> None:
    config, settings = config_of(name), SETTINGS[name]
    for plan, setting in zip(ro.solve_batch(config, settings), settings, strict=True):
        alone = single(config, setting)
        assert plan.status is alone.status
        assert plan.duration == alone.duration
        assert plan.x.tobytes() == alone.x.tobytes()
        assert plan.problem.row_names == alone.problem.row_names
        assert plan.active == alone.active


@pytest.mark.parametrize(
    ("name", "key", "forces"),
    [
        ("pick_suction", CUP_FORCE, ([16.0, 18.0], 20.0, 5.0)),
        ("pick_gripper", "objects.casting.held_by.grip.force", ([23.0, 25.0], 30.0, 5.0)),
    ],
)
def test_forces_of_tools_vary_as_in_single_builds(name: str, key: str, forces: tuple[Any, ...]) -> None:
    durations = BatchPlanner(config_of(name)).durations([{key: force} for force in forces])
    alone = [ro.solve(ro.build_problem(config_of(name, f"{key}={force}"))).duration for force in forces]
    assert durations.tolist() == alone
    assert durations[0] > durations[1]
    assert np.isinf(durations[2])


def test_a_setting_is_written_out_in_the_configuration() -> None:
    config = config_of("waiter_two_blocks")
    same = {
        "contact.friction.upper": (0.3, {"contact.friction": {"default": 0.5, "upper": 0.3}}),
        "uncertainty.friction.upper.0": (0.3, {"uncertainty.friction": {"upper": [0.3, 0.5]}}),
        "uncertainty.friction.0": (0.3, {"uncertainty.friction": [0.3, 0.5]}),
        "uncertainty.mass.upper.1": (0.6, {"uncertainty.mass": {"upper": [0.5, 0.6]}}),
        "uncertainty.center_of_mass.upper.1": (0.01, {"uncertainty.center_of_mass": {"upper": [0.0, 0.01, 0.0]}}),
        DEVIATION: (0.2, {"uncertainty.joint_acceleration": {"deviation": 0.2}}),
        HEIGHT: (0.01, {"objects.upper.center_of_mass": [0.0, 0.0, 0.01]}),
    }
    for key, (value, written) in same.items():
        assert with_setting(config, {key: value}) == with_values(config, written)


def test_the_order_of_the_settings_does_not_matter() -> None:
    config, rng = config_of("waiter_two_blocks"), np.random.default_rng(0)
    settings = [{"contact.friction": mu, HEIGHT: h} for mu, h in rng.uniform([0.1, -0.02], [1.0, 0.02], (24, 2))]
    first = BatchPlanner(config).durations(settings)
    second = BatchPlanner(config).durations(settings[::-1])[::-1]
    assert first.tobytes() == second.tobytes()


def test_processes_plan_what_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bits; and what is wrong with a setting is said as it is here."""
    monkeypatch.setattr(batch, "ALONE", (0.0, 0.0))
    monkeypatch.setattr(batch, "STARTED", (0.0, 0.0))
    monkeypatch.setattr(batch, "cores", lambda: 2)
    config, rng = config_of("waiter_two_blocks"), np.random.default_rng(1)
    settings = [{"contact.friction": mu, HEIGHT: h} for mu, h in rng.uniform([0.1, -0.02], [1.0, 0.02], (40, 2))]
    alone, shared = BatchPlanner(config, workers=1), BatchPlanner(config, workers=2)
    by_processes = shared_settings(monkeypatch)
    assert shared.durations(settings).tobytes() == alone.durations(settings).tobytes()
    assert by_processes == [38]
    with pytest.raises(ConfigError, match="found -1") as error:
        shared.durations([*settings[:3], {"contact.friction": -1.0}])
    assert [problem.key for problem in error.value.problems] == ["contact.friction"]


def test_processes_that_are_there_share_what_is_not_worth_starting_them(monkeypatch: pytest.MonkeyPatch) -> None:
    config, settings = config_of("waiter_two_blocks"), [{"contact.friction": mu} for mu in np.linspace(0.2, 0.4, 20)]
    monkeypatch.setattr(batch, "cores", lambda: 2)
    monkeypatch.setattr(batch, "ALONE", (0.0, 1e9))
    monkeypatch.setattr(batch, "STARTED", (0.0, 0.0))
    planner = BatchPlanner(config, workers=2)
    shared = shared_settings(monkeypatch)
    end_processes()
    alone = planner.plan_durations(settings)
    assert shared == []
    list(in_processes(abs, [(1,), (2,)], 2, SolverFailed))
    assert planner.plan_durations(settings).tobytes() == alone.tobytes()
    assert shared == [18]


def test_what_is_worse_for_the_robot_never_shortens_the_plan() -> None:
    """Monotone in the settings to 1e-6, also where the forward pass is polished."""
    planner = BatchPlanner(config_of("waiter_two_blocks"))
    for key, values in (
        ("contact.friction", np.linspace(1.0, 0.1, 40)),
        (DEVIATION, np.linspace(0.0, 1.0, 40)),
        ("uncertainty.center_of_mass.upper.0", np.linspace(0.0, 0.02, 20)),
    ):
        durations = planner.durations([{key: float(value)} for value in values])
        assert np.isfinite(durations).all()
        assert (np.diff(durations) >= -1e-6 * durations[1:]).all()


def test_no_plan_is_an_infinite_duration() -> None:
    planner = BatchPlanner(config_of("waiter_two_blocks"))
    settings = [{DEVIATION: 50.0}, {}]
    assert np.isinf(planner.durations(settings)).tolist() == [True, False]
    assert [plan.status for plan in planner.plans(settings)] == [Status.INFEASIBLE, Status.SOLVED]


def test_a_setting_is_planned_once(monkeypatch: pytest.MonkeyPatch) -> None:
    planner, planned = BatchPlanner(config_of("waiter_two_blocks"), workers=1), []
    monkeypatch.setattr(planner, "_plan", lambda setting: planned.append(setting) or single(planner.config, setting))
    again = {"contact.friction": 0.3}
    durations = planner.durations([again, {"contact.friction": 0.4}, dict(again)])
    assert durations[0] == durations[2] == planner.durations([again])[0]
    assert len(planned) == 2
    assert planner.durations([]).shape == (0,)


@pytest.mark.parametrize(
    ("setting", "key", "words"),
    [
        ({"robot.base.position": [0.0, 0.0, 0.0]}, "robot.base.position", "cannot vary within a batch"),
        ({"solver.collocation_points": 50}, "solver.collocation_points", "cannot vary within a batch"),
        ({"contact.fricton": 0.3}, "contact.fricton", "did you mean contact.friction?"),
        ({"objects.middle.mass": 0.3}, "objects.middle.mass", "expected one of lower, upper"),
        ({"objects.upper.size": [0.1, 0.1, 0.1]}, "objects.upper.size", "cannot vary within a batch"),
        ({"contact.friction": -0.3}, "contact.friction", "found -0.3"),
        ({"contact.friction.middle": 0.3}, "contact.friction.middle", "nothing is called middle"),
        ({"uncertainty.friction": [0.6, 0.7]}, "uncertainty.friction", "does not contain contact.friction"),
        ({HEIGHT: float("nan")}, "objects.upper.center_of_mass[2]", "found nan"),
        ({"objects.upper.held_by.suction.face": 1.0}, "objects.upper.held_by.suction.face", "cannot vary within"),
        ({"contact": 0.3}, "contact", "cannot vary within a batch"),
    ],
)
def test_bad_settings_say_what_is_wrong(setting: dict[str, Any], key: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words.replace("?", r"\?")) as error:
        BatchPlanner(config_of("waiter_two_blocks")).durations([{}, setting])
    assert error.value.problems[0].key == key


def test_a_solver_that_stops_is_no_missing_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a learner would take the setting for infeasible, and its lower bound would pass over it."""

    def stopped(problem: Any, method: str) -> Plan:
        return replace(solve(problem, method), status=Status.ITERATION_LIMIT, message="too long", duration=np.inf)

    monkeypatch.setattr("robustopt.solvers.batch.solve", stopped)
    with pytest.raises(SolverFailed, match=r"no plan for contact\.friction = 0\.3: too long"):
        BatchPlanner(config_of("waiter_two_blocks")).durations([{"contact.friction": 0.3}])
