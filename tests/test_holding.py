"""Suction cups and grippers in the simulated world: thresholds against closed forms, outcomes, and trials."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import mujoco
import numpy as np
import pytest
from carriage import ALONG, DOWN, accelerated, carriage, fails, holding, parameters_of
from scenes import CONFIGS, FIXTURES, G, plan_of

from robustopt.config import Config, FailureConfig
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError
from robustopt.simulation import Status, execute, trace
from robustopt.simulation.controller import POSITION_VELOCITY, Gains
from robustopt.simulation.execute import prepare
from robustopt.simulation.outcome import TrialOutcome
from robustopt.simulation.parameters import actual_parameters
from robustopt.simulation.physics import ARM, WALKING, physics_of
from robustopt.simulation.world import World, place_load, positions_of

F, R = 30.0, 0.03
FINGERS = 40.0
BLOCK = {"size": [0.04, 0.08, 0.08]}
X, Y, Z = np.eye(3)


def cup(**keys: Any) -> dict[str, Any]:
    return {"suction": {"cups": [{"radius": R}], "force": F, **keys}}


def grip(**keys: Any) -> dict[str, Any]:
    return {"grip": {"pad": [0.02, 0.02], "force": FINGERS, **keys}}


def hanging(held_by: dict[str, Any], robot: str, joints: list[list[float]], part: dict[str, Any],
            contact: dict[str, Any], execution: dict[str, Any] | None = None, **objects: Any) -> Config:  # fmt: skip
    """A task of a robot of the fixtures whose tool points down and holds a part of 1 kg."""
    kind, hold = next(iter(held_by.items()))
    down = {kind: {"pose": {"rpy": [np.pi, 0.0, 0.0]}, **hold}}
    data: dict[str, Any] = {
        "name": "test",
        "robot": {"model": f"{robot}.xml", "tool": "tool", "collision": {"check": False}},
        "objects": {"part": {"shape": "box", "mass": 1.0, "held_by": down, **part}, **objects},
        "contact": contact,
        "path": {"joints": joints},
        "solver": {"method": "reachability", "collocation_points": 100},
        "execution": execution,
        "folder": FIXTURES,
    }
    return with_values(Config.model_validate(data), {})


def slanted(angle: float) -> np.ndarray:
    return np.cos(angle) * X + np.sin(angle) * Y


# Thresholds without twist ---------------------------------------------------------------------------------

TALL = {"size": [0.2, 0.2, 0.2]}
"""A part whose centre of mass is 0.1 m below the lip: it peels long before it slides."""

THRESHOLDS = {
    **{
        f"cup slides, friction {mu}, {round(np.degrees(angle))} degrees": (
            holding(cup(), friction=mu), slanted(angle), DOWN, mu * (F - G)
        )
        for mu in (0.2, 0.5, 1.0) for angle in (0.0, np.pi / 4)
    },
    "a heavy part slides": (holding(cup(force=300.0), mass=10.0), X, DOWN, 0.5 * (300.0 - 10.0 * G) / 10.0),
    "cup slides on a cylinder": (
        holding(cup(), shape="cylinder", size=None, radius=0.1, height=0.01), X, DOWN, 0.5 * (F - G)
    ),
    "cup is pulled off": (holding(cup()), Z, DOWN, F - G),
    "cup peels towards a lip point": (holding(cup(), friction=1.0, **TALL), X, DOWN, (F - G) * R / 0.1),
    "cup peels towards a flat": (
        holding(cup(), friction=1.0, **TALL), slanted(np.pi / 8), DOWN, (F - G) * R * np.cos(np.pi / 8) / 0.1
    ),
    "side cup unloads": (holding(cup(), friction=0.8), -X, ALONG, F - G / 0.8),
    "side cup slides upwards": (holding(cup(), friction=0.8), Z, ALONG, 0.8 * F - G),
    "two cups slide": (
        holding({"suction": {"cups": [{"at": [-0.05, 0], "radius": R}, {"at": [0.05, 0], "radius": R}], "force": F}}),
        Y, DOWN, 0.5 * (2 * F - G),
    ),
    "two cups are pulled off": (
        holding({"suction": {"cups": [{"at": [-0.05, 0], "radius": R}, {"at": [0.05, 0], "radius": R}], "force": F}}),
        Z, DOWN, 2 * F - G,
    ),
    "grip lifts": (holding(grip(), **BLOCK), Z, DOWN, FINGERS - G),
    "grip slides level": (holding(grip(), **BLOCK), Y, DOWN, np.sqrt(FINGERS**2 - G**2)),
    **{
        f"fixed pad opens, finger of {mass} kg": (
            holding(grip(finger_mass=mass), **BLOCK), -X, DOWN, FINGERS / (1.0 + mass)
        )
        for mass in (0.0, 0.1, 0.3)
    },
}  # fmt: skip


@pytest.mark.parametrize("case", THRESHOLDS)
def test_a_part_is_lost_or_slides_within_a_percent_of_its_closed_form(case):
    config, direction, tool, threshold = THRESHOLDS[case]
    below, above = accelerated(config, direction, threshold * np.array([0.99, 1.01]), tool)
    assert not fails(below)
    assert fails(above)


def test_a_part_held_by_a_gripper_is_not_lost_towards_the_driven_finger():
    (motion,) = accelerated(holding(grip(), **BLOCK), X, np.array([5 * FINGERS]))
    assert not fails(motion, opening=2e-5, slide=1e-4)


@pytest.mark.parametrize("case", ["cup slides, friction 0.5, 45 degrees", "side cup unloads", "grip lifts"])
def test_a_held_part_creeps_less_than_a_hundredth_of_a_millimetre_per_second(case):
    config, direction, tool, threshold = THRESHOLDS[case]
    (motion,) = accelerated(config, direction, np.array([0.9 * threshold]), tool, hold=2.0)
    assert motion.slip[-1] - motion.slip[-2000] < 2e-5


# Thresholds with twist ------------------------------------------------------------------------------------

TWO = {"suction": {"cups": [{"at": [-0.05, 0], "radius": 0.02}, {"at": [0.05, 0], "radius": 0.02}], "force": F}}

TWISTED = [
    *((TWO, {"size": [0.2, 0.2, 0.04], "center_of_mass": [off, 0.5 * off, 0.0]}, 0.5, Y) for off in (0.01, 0.04)),
    *((cup(), {"size": [0.2, 0.2, 0.04], "center_of_mass": [off, 0.0, 0.0]}, mu, d)
      for off in (0.005, 0.01, 0.02) for mu in (0.3, 0.8) for d in (Y, slanted(np.pi / 4))),
    *((grip(), BLOCK | {"center_of_mass": [0.0, off, 0.0]}, mu, d)
      for off in (0.005, 0.01, 0.02) for mu in (0.5, 0.8) for d in (Z, Y)),
]  # fmt: skip
"""Parts whose centre of mass is beside the axis of the cup or the pads, and accelerations that twist them."""


def planned_acceleration(held_by: dict[str, Any], part: dict[str, Any], mu: float, direction: np.ndarray) -> float:
    """Largest acceleration from rest along a direction that a plan makes with 64 edges per friction cone [m/s^2]."""
    robot, joint = ("lift", [0.5]) if direction[2] else ("two_slides", (0.5 * direction[:2]).tolist())
    config = hanging(held_by, robot, [[0.0] * len(joint), joint], part, {"friction": mu, "cone_edges": 64})
    plan = plan_of(with_values(config, {"robot.limits": {"all": {"acceleration": 1000.0, "velocity": 1000.0}}}))
    rising = plan.u[: max(int(np.argmax(plan.x)) - 1, 1)]
    return float((np.linalg.norm(plan.problem.path(plan.s[: len(rising)], 1), axis=1) * rising).min())


@pytest.mark.parametrize(("held_by", "part", "mu", "direction"), TWISTED)
def test_a_twisted_part_yields_no_earlier_than_planned_and_at_most_a_fifth_later(held_by, part, mu, direction):
    plan = planned_acceleration(held_by, part, mu, direction)
    below, above = accelerated(holding(held_by, friction=mu, **part), direction, plan * np.array([0.995, 1.2]))
    assert not fails(below)
    assert fails(above)


@pytest.mark.parametrize("held_by", [cup(), grip()], ids=["cup", "grip"])
@pytest.mark.parametrize("tool", [DOWN, ALONG], ids=["down", "aside"])
def test_a_part_is_held_from_the_first_step(held_by, tool):
    config = holding(held_by, **BLOCK if "grip" in held_by else {})
    model = carriage(config, tool)
    data, start = mujoco.MjData(model), positions_of(config, model)
    place_load(config, data.qpos, start, np.zeros(3), tool)
    at = start["part"]
    before = data.qpos[at : at + 3].copy()
    for _ in range(500):
        data.ctrl[2] = G
        mujoco.mj_step(model, data)
        assert data.ncon == 8
        assert np.linalg.norm(data.qpos[at : at + 3] - data.qpos[:3] - before) < 3e-5


def test_lips_and_pads_have_their_actual_friction_force_and_size():
    config = holding({"suction": {"cups": [{"at": [-0.05, 0], "radius": R}, {"at": [0.05, 0], "radius": R}],
                                  "force": [35, 45]}})  # fmt: skip
    assert parameters_of(config).force == {"part": 40.0}
    task = with_values(config, {"execution.truth": {
        "friction": {"part_cup1": 0.3, "part": 0.4}, "force": {"part": 37.0}, "contact_inset": {"part_cup2": 0.005},
    }})  # fmt: skip
    world = World(task, Gains(*np.ones((3, 2)), POSITION_VELOCITY), 0.001)
    model = world.model(actual_parameters(world.nominal, task, np.random.default_rng(0)))
    for k, (mu, radius) in enumerate([(0.3, R), (0.4, R - 0.005)]):
        lip = [i for i in range(model.ngeom) if model.geom(i).name.startswith(f"robustopt_part_cup{k + 1}_")]
        pairs = np.isin(model.pair_geom1, lip) | np.isin(model.pair_geom2, lip)
        assert len(lip) == pairs.sum() == 8
        assert model.pair_friction[pairs, :2] == pytest.approx(mu)
        assert np.hypot(*(model.geom_pos[lip, :2] - [0.1 * k - 0.05, 0.0]).T) == pytest.approx(radius)
    assert model.tendon_stiffness.reshape(2, -1)[:, 0] * 100.0 == pytest.approx(37.0)
    assert model.opt.impratio == 100.0
    for inset in ({"part": 0.04}, {"part_cup1": 0.031}):
        with pytest.raises(ConfigError, match=r"contact_inset\.part_cup1: .* leaves nothing of part_cup1"):
            world.model(replace(world.nominal, inset=inset))


def test_settings_are_those_of_the_robot_but_friction_is_stiffer_where_it_holds():
    assert (physics_of(0, False), physics_of(6, False)) == (ARM, WALKING)
    assert physics_of(6, True).impedance_ratio == 100.0


# Executions -----------------------------------------------------------------------------------------------


def gantry(held_by: dict[str, Any], *joints: list[float], mu: float = 0.3, truth: dict[str, Any] | None = None,
           **objects: Any) -> Config:  # fmt: skip
    """A task of a gantry that moves a part along straight lines of its joints x, y, z and yaw."""
    execution = {"truth": truth or {}, "controller": {"feedforward": "computed_torque"}}
    path = [[0.0, 0.0, 0.0, 0.0], *joints]
    return hanging(held_by, "gantry", path, {"size": [0.1, 0.1, 0.05]}, {"friction": mu}, execution, **objects)


ALONG_X, UP, BACK = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], [-0.5, 0.0, 0.0, 0.0]


def outcome_of(config: Config) -> TrialOutcome:
    (outcome,) = execute(plan_of(config), trials=1).outcomes
    return outcome


CASES = [
    (cup(), ALONG_X, {"truth": {"friction": 0.25}}, Status.SLID_IN_GRIP),
    (cup(), ALONG_X, {"truth": {"force": {"part": 0.8 * F}}}, Status.SLID_IN_GRIP),
    (cup(force=20.0), UP, {"truth": {"force": {"part": 0.8 * 20.0}}}, Status.LOST_GRIP),
    (grip(force=35.0), UP, {"truth": {"friction": 0.25}}, Status.SLID_IN_GRIP),
    (grip(force=8.0), BACK, {"mu": 0.9, "truth": {"force": {"part": 0.8 * 8.0}}}, Status.LOST_GRIP),
]
"""Holds, motions and worlds in which a plan fails that is right about everything else."""


@pytest.mark.parametrize(("held_by", "motion", "keys", "status"), CASES)
def test_a_plan_with_too_much_force_or_friction_fails_and_a_right_one_succeeds(held_by, motion, keys, status):
    failed = outcome_of(gantry(held_by, motion, **keys))
    assert (failed.status, failed.what) == (status, "part")
    assert failed.objects["part"].status is status
    assert outcome_of(gantry(held_by, motion, **{**keys, "truth": {}})).success


def test_trials_report_the_world_that_they_had_and_do_not_depend_on_others():
    spread = {"variation": {"friction": 0.02, "force": {"part": 2.0}, "mass": {"part": 0.02}}}
    plan = plan_of(gantry(cup(force=[35.0, 45.0]), ALONG_X, truth=spread))
    many = execute(plan, trials=8)
    assert many.success_rate == 1.0
    for name in ("friction", "force", "mass"):
        assert len({getattr(outcome, name)["part"] for outcome in many.outcomes}) == 8
    assert np.mean([outcome.force["part"] for outcome in many.outcomes]) == pytest.approx(40.0, abs=3.0)
    (alone,) = execute(plan, numbers=[5]).outcomes
    assert repr(asdict(alone)) == repr(asdict(many.outcomes[5]))


def test_the_vacuum_is_no_torque_of_the_motors():
    weak, strong = (outcome_of(gantry(cup(force=force), [0.0, 0.0, 0.2, 0.0])) for force in (20.0, 400.0))
    assert weak.success
    assert strong.success
    low = with_values(gantry(cup(force=400.0), [0.0, 0.0, 0.2, 0.0]), {"robot.limits": {"z": {"torque": 150.0}}})
    assert outcome_of(low).success, "the reaction of the vacuum on the tool, 400 N, is not of the motor"


def test_a_part_drifts_on_a_turning_tool_as_far_as_mujoco_lets_it():
    """By 0.45 time steps times the integral of its centripetal acceleration; the default threshold is above that."""
    config = gantry(cup(pose={"position": [0.5, 0.0, 0.0], "rpy": [np.pi, 0.0, 0.0]}), [0.0, 0.0, 0.0, 3.0])
    plan = plan_of(with_values(config, {"robot.limits": {"yaw": {"velocity": 2.5, "acceleration": 8.0}}}))
    planned, seen = prepare(plan).planned, trace(plan, 0)
    drift = 0.45 * 0.001 * 0.5 * (planned.qd[:, 3] ** 2).sum() * 0.001
    assert seen.objects["part"].slip[-1] == pytest.approx(drift, rel=0.1)
    assert drift > 1e-3
    assert seen.outcome.success
    assert FailureConfig().grip_slip == 0.003


def test_an_object_stands_on_a_held_part():
    above = {"shape": "box", "size": [0.05, 0.05, 0.02], "mass": 0.2, "on": "part"}
    hold = {"suction": {"cups": [{"radius": R}], "force": 60.0, "face": "bottom", "pose": {"rpy": [0.0, 0.0, 0.0]}}}
    outcome = outcome_of(gantry(hold, ALONG_X, mu=0.3, truth={"friction": {"above": 0.2, "default": 0.3}}, above=above))
    assert (outcome.status, outcome.what) == (Status.SLID, "above")
    assert outcome.objects["part"].status is Status.SUCCESS
    assert outcome_of(gantry(hold, ALONG_X, mu=0.3, truth={"friction": 0.31}, above=above)).success


def test_forces_are_those_of_held_objects():
    with pytest.raises(ConfigError, match="nothing is called other"):
        gantry(cup(), ALONG_X, truth={"force": {"other": 3.0}})


def test_two_hands_hold_a_tray_with_a_block_while_the_robot_walks():
    config = load_config(CONFIGS / "humanoid_tray.yaml", ["solver.collocation_points=120"])
    plan = plan_of(config)
    (outcome,) = execute(plan, trials=1).outcomes
    assert outcome.success
    assert list(outcome.objects) == ["block", "left_hand", "right_hand", "left_foot", "right_foot", "pelvis"]
    assert max(outcome.objects[hand].slip for hand in ("left_hand", "right_hand")) < 5e-4
    assert outcome.force == {"tray": 27.5}
    weak = with_values(config, {"execution.truth.force": {"tray": 0.2}, "execution.truth.friction": {"tray": 0.02}})
    (outcome,) = execute(plan, weak, trials=1).outcomes
    assert outcome.status in (Status.LOST_GRIP, Status.SLID_IN_GRIP)
    assert outcome.what in ("left_hand", "right_hand")
