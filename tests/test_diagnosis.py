"""Why a problem has no solution: conflicts and remedies against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from held import cups, holding
from scenes import FLAT, WAITERS, G, plan_of, scene, waiter

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.errors import ConfigError
from robustopt.limits import TimeScalingProblem
from robustopt.solvers import Status, build_problem, solve
from robustopt.solvers.diagnosis import Diagnosis, Remedy, diagnose

TALL = {"shape": "box", "size": [0.06, 0.2, 0.30], "mass": 1.0}
STEP = 0.005
"""A value is found to 1/4096 of the way to the most generous one: 0.2 % of a friction that grows a hundredfold."""


def tilted(angle: float, objects: dict[str, Any], **sections: Any) -> Config:
    return scene(objects=objects, gravity=[G * np.sin(angle), 0.0, -G * np.cos(angle)], **sections)


def diagnosed(config: Config, method: str | None = None) -> Diagnosis:
    plan = plan_of(config, method)
    assert plan.status is Status.INFEASIBLE
    return diagnose(plan)


def remedy(diagnosis: Diagnosis, key: str) -> Remedy:
    return next(item for item in diagnosis.remedies if item.key == key)


def solvable(config: Config, **values: Any) -> bool:
    changes = {key.replace("__", "."): value for key, value in values.items()}
    return plan_of(with_values(config, changes)).status is Status.SOLVED


# Standing still ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.15, 0.4])
@pytest.mark.parametrize("method", ["reachability", "ipopt"])
def test_a_block_on_a_tilted_tray_needs_friction_tan_of_the_angle(angle: float, method: str) -> None:
    config = tilted(angle, {"block": FLAT}, contact={"friction": 0.1})
    found = diagnosed(config, method)
    assert found.standstill
    assert found.point == 0
    assert found.s == 0.0
    assert found.conflicts == (("slip of block on tray",),)
    (change,) = found.remedies
    assert change.key == "contact.friction"
    assert change.enough
    assert change.found == 0.1
    assert change.needed == pytest.approx(np.tan(angle), rel=STEP)
    assert change.needed >= np.tan(angle)
    assert found.sentence == (
        "At s = 0 (at joints[0]) the robot cannot stand still. Limits in conflict: slip of block on tray."
    )
    assert change.sentence == f"contact.friction: at least {change.needed:.4g} instead of 0.1 (enough by itself)"


def test_a_remedy_works_and_one_per_cent_less_does_not() -> None:
    config = tilted(0.2, {"block": FLAT}, contact={"friction": 0.1})
    needed = diagnosed(config).remedies[0].needed
    assert solvable(config, contact__friction=needed)
    assert not solvable(config, contact__friction=0.99 * needed)


def test_force_programs_are_solved_only_for_limits_that_count() -> None:
    """A diagnosis once added rows of limits that it had left out, round after round: minutes for two cups."""
    weak = cups((-0.04, 0.0, 0.02), (0.04, 0.0, 0.02), force=4.0)
    config = holding(
        weak, mu={"part_cup1": 0.4, "part_cup2": 0.5}, sections={"uncertainty": {"mass": {"part": [0.9, 1.1]}}}
    )
    problem = build_problem(config)
    contacts = {name for limit in problem.limits.contacts for name in limit.names}
    plan = solve(problem.only([name for name in problem.limits.names if name not in contacts]))
    assert plan.status is Status.SOLVED
    assert plan.statistics["inner_programs"] == 0


def test_an_interval_of_friction_is_raised_at_its_lower_end() -> None:
    config = tilted(0.2, {"block": FLAT}, contact={"friction": 0.3}, uncertainty={"friction": [0.1, 0.5]})
    change = remedy(diagnosed(config), "uncertainty.friction")
    assert change.found == 0.1
    assert change.needed == pytest.approx(np.tan(0.2), rel=STEP)
    assert solvable(config, uncertainty__friction=[change.needed, 0.5])
    assert not solvable(config, uncertainty__friction=[0.99 * change.needed, 0.5])


def test_only_the_interface_that_slips_is_asked_for_more_friction() -> None:
    objects = {"rough": FLAT | {"at": [-0.2, 0.0]}, "smooth": FLAT | {"at": [0.2, 0.0]}}
    config = tilted(0.2, objects, contact={"friction": {"rough": 0.5, "smooth": 0.1}})
    found = diagnosed(config)
    assert found.conflicts == (("slip of smooth on tray",),)
    assert [item.key for item in found.remedies] == ["contact.friction.smooth"]


@pytest.mark.parametrize("margin", [0.0, 1.0])
def test_a_lift_that_is_too_weak_needs_the_weight_as_torque(margin: float) -> None:
    config = scene(
        "lift",
        objects={"block": FLAT},
        robot_keys={"limits": {"z": {"torque": 20.0}}},
        uncertainty={"joint_acceleration": {"deviation": margin}},
    )
    found = diagnosed(config)
    assert found.standstill
    assert found.conflicts == (("z torque",),)
    change = remedy(found, "robot.limits.z.torque")
    assert change.found == 20.0
    assert change.needed == pytest.approx(3.5 * (G + margin), rel=STEP)
    assert solvable(config, robot__limits__z__torque=change.needed)
    assert not solvable(config, robot__limits__z__torque=0.99 * change.needed)


def test_an_uncertain_mass_is_narrowed_to_what_the_motor_holds() -> None:
    """2 kg and 1 kg that are certain; 35 N hold 0.568 kg more, of 0.5 kg that may be up to 0.7 kg."""
    robot = {"limits": {"z": {"torque": 35.0}}}
    config = scene("lift", objects={"block": FLAT}, robot_keys=robot, uncertainty={"mass": {"block": [0.4, 0.7]}})
    change = remedy(diagnosed(config), "uncertainty.mass.block, width")
    share = (35.0 / G - 3.5) / 0.2
    assert change.found == pytest.approx(0.3)
    assert change.needed == pytest.approx(0.3 * share, rel=STEP)
    assert solvable(config, uncertainty__mass__block=[0.4, 0.5 + 0.199 * share])
    assert not solvable(config, uncertainty__mass__block=[0.4, 0.5 + 0.202 * share])


def test_an_acceleration_error_beyond_the_limit_asks_for_less_of_it_or_more_limit() -> None:
    config = scene(
        robot_keys={"limits": {"x": {"acceleration": 1.0}}},
        uncertainty={"joint_acceleration": {"deviation": 0.75, "K": 2.0}},
    )
    found = diagnosed(config)
    assert found.conflicts == (("x acceleration",),)
    assert remedy(found, "robot.limits.x.acceleration").needed == pytest.approx(1.5, rel=STEP)
    fewer = remedy(found, "uncertainty.joint_acceleration.K")
    assert fewer.needed == pytest.approx(1.0 / 0.75, rel=STEP)
    assert fewer.sentence.startswith("uncertainty.joint_acceleration.K: at most 1.33")
    assert solvable(config, uncertainty__joint_acceleration__K=fewer.needed)
    assert not solvable(config, uncertainty__joint_acceleration__K=1.01 * fewer.needed)


def test_tipping_is_not_cured_by_friction() -> None:
    """30 mm from the edge, 150 mm high: it stands up to atan(0.2)."""
    found = diagnosed(tilted(0.25, {"tall": TALL}, contact={"friction": 1.0}))
    assert found.conflicts == (("tipping of tall over tray",),)
    assert found.remedies == ()


def test_an_uncertain_centre_of_mass_or_patch_is_narrowed_to_what_stands() -> None:
    angle = 0.15
    room = 0.03 - 0.15 * np.tan(angle)
    center = tilted(
        angle, {"tall": TALL}, contact={"friction": 1.0}, uncertainty={"center_of_mass": {"tall": [0.012, 0.0, 0.0]}}
    )
    assert remedy(diagnosed(center), "uncertainty.center_of_mass.tall, largest").needed == pytest.approx(room, rel=STEP)
    assert solvable(center, uncertainty__center_of_mass__tall=[0.995 * room, 0.0, 0.0])
    points = tilted(angle, {"tall": TALL}, contact={"friction": 1.0}, uncertainty={"contact_points": 0.012})
    assert remedy(diagnosed(points), "uncertainty.contact_points").needed == pytest.approx(room, rel=STEP)
    assert solvable(points, uncertainty__contact_points=0.995 * room)


def test_two_conflicts_get_a_remedy_each_where_there_is_one() -> None:
    objects = {"tall": TALL | {"at": [-0.2, 0.0]}, "flat": FLAT | {"at": [0.2, 0.0]}}
    found = diagnosed(tilted(0.25, objects, contact={"friction": {"tall": 1.0, "flat": 0.1}}))
    assert set(found.conflicts) == {("slip of flat on tray",), ("tipping of tall over tray",)}
    (change,) = found.remedies
    assert change.key == "contact.friction.flat"
    assert not change.enough
    assert change.limits == ("slip of flat on tray",)
    assert change.needed == pytest.approx(np.tan(0.25), rel=STEP)
    assert change.sentence.endswith("(resolves slip of flat on tray only)")


# On the way ----------------------------------------------------------------------------------------------


def rocking(tilt: float, **sections: Any) -> Config:
    """A tray that tilts on its way and is level at both ends."""
    return scene(
        "tilting_slide",
        objects={"block": FLAT},
        joints=[[0.0, 0.0], [0.5, tilt], [1.0, 0.0]],
        tray={"size": [0.3, 0.3, 0.01]},
        **{"contact": {"friction": 0.3}, **sections},
    )


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
def test_a_conflict_on_the_way_is_found_where_it_is(method: str) -> None:
    config = rocking(0.5)
    found = diagnosed(config, method)
    assert not found.standstill
    assert 0.0 < found.s < 1.0
    assert found.place.startswith("between joints[")
    assert "no combination of speed and acceleration is possible" in found.sentence
    assert found.conflicts == (("slip of block on tray",),)
    needed = remedy(found, "contact.friction").needed
    assert 0.3 < needed < np.tan(0.5)  # speeding up down the slope helps
    assert solvable(config, contact__friction=needed)
    assert not solvable(config, contact__friction=0.99 * needed)


def test_a_start_that_can_rest_but_leads_nowhere_is_said_to_be_one() -> None:
    """It used to be called a robot that cannot stand still."""
    found = diagnosed(rocking(-0.5))
    assert found.s == 0.0
    assert not found.standstill
    assert "no timing that starts from rest reaches the end" in found.sentence


def test_limits_that_conflict_only_together_are_named_together() -> None:
    """Leaning back by more than friction holds, the block needs an acceleration that the joint cannot give."""
    config = rocking(0.5, robot_keys={"limits": {"x": {"acceleration": 0.05}}}, contact={"friction": 0.45})
    found = diagnosed(config)
    assert found.conflicts == (("x acceleration", "slip of block on tray"),)
    for change in found.remedies:
        assert change.enough
        assert change.needed > change.found
    stronger = remedy(found, "robot.limits.x.acceleration")
    assert solvable(config, robot__limits__x__acceleration=stronger.needed)
    assert not solvable(config, robot__limits__x__acceleration=0.98 * stronger.needed)


def test_each_conflict_is_irreducible() -> None:
    """Without any one of its limits a conflict has a solution."""
    for config in (
        rocking(0.5),
        rocking(0.5, contact={"friction": 0.45}, robot_keys={"limits": {"x": {"acceleration": 0.05}}}),
    ):
        plan = plan_of(config)
        for conflict in diagnose(plan).conflicts:
            assert solve(plan.problem.only(conflict), "reachability").status is Status.INFEASIBLE
            for name in conflict:
                rest = [other for other in conflict if other != name]
                assert solve(plan.problem.only(rest), "reachability").status is Status.SOLVED


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
@pytest.mark.parametrize("pull", [4.0, 5.0])
def test_a_bridge_that_slips_is_said_to_be_unable_to_stand(pull: float, method: str) -> None:
    """It has no facets that a first look could see it by; its rows come from the inner programs."""
    config = waiter("bridge", "solver.collocation_points=20", f"gravity=[{pull}, 0, -9.0]")
    found = diagnosed(config, method)
    assert found.standstill
    assert found.s == 0.0
    assert found.conflicts == (("balance of plank on left and right",),)


def test_a_bridge_that_slips_is_cured_by_friction_where_it_slips() -> None:
    """The plank at 0.4, its posts at 0.5, gravity at atan(4 / 9)."""
    config = waiter("bridge", "solver.collocation_points=20", "gravity=[4.0, 0, -9.0]")
    (change,) = diagnosed(config, "reachability").remedies
    assert change.key == "contact.friction.plank"
    assert 4.0 / 9.0 <= change.needed < 0.47  # the pyramid of friction takes up to 2 % and standing level is not asked
    assert solvable(config, contact__friction__plank=change.needed)
    assert not solvable(config, contact__friction__plank=0.99 * change.needed)


@pytest.mark.parametrize("name", WAITERS)
def test_plans_that_exist_have_no_conflict(name: str) -> None:
    plan = solve(build_problem(waiter(name, "solver.collocation_points=20")), "reachability")
    with pytest.raises(ValueError, match="only an infeasible plan"):
        diagnose(plan)


# What is printed is true ---------------------------------------------------------------------------------


def changed(config: Config, sentence: str) -> Config:
    """The configuration after the changes of a remedy, read from its text alone."""
    data = config.model_dump()
    for change in sentence.rsplit(" (", 1)[0].split(" and "):
        key, rest = change.split(": ")
        key, _, note = key.partition(", ")
        _, _, value, _, _, before = rest.split()
        *path, last = key.split(".")
        section: Any = data
        for name in path:
            section = section.setdefault(name, {})
        factor, given = float(value) / float(before), section.get(last)
        if note == "width":
            low, high = given
            mass = data["objects"][last]["mass"]
            section[last] = [mass - factor * (mass - low), mass + factor * (high - mass)]
        elif note:
            scaled = float(value) / max(given.values() if isinstance(given, dict) else given)
            section[last] = (
                {name: scaled * one for name, one in given.items()}
                if isinstance(given, dict)
                else [scaled * one for one in given]
            )
        elif isinstance(given, tuple):
            section[last] = [float(value), max(float(value), given[1])]
        else:
            section[last] = float(value)
    return Config.model_validate({**data, "folder": config.folder})


BOX = {"shape": "box", "size": [0.1, 0.1, 0.1], "mass": 0.5}
CENTRE = {"center_of_mass": {"box": [0.045, 0.0, 0.0]}}
WEAK = cups((-0.04, 0.0, 0.02), (0.04, 0.0, 0.02), force=2.0)
LIFT = {"limits": {"z": {"torque": 35.0}}}
INFEASIBLE = {
    "friction": lambda: tilted(0.2, {"box": BOX}, contact={"friction": 0.1}),
    "interval of friction": lambda: tilted(
        0.31, {"box": BOX}, contact={"friction": 0.2}, uncertainty={"friction": [0.1, 0.5]}
    ),
    "two frictions": lambda: tilted(
        0.2,
        {"a": BOX | {"at": [-0.2, 0.0]}, "b": BOX | {"at": [0.2, 0.0]}},
        contact={"friction": {"a": 0.1, "b": 0.15}},
    ),
    "centre": lambda: tilted(0.3, {"box": BOX}, contact={"friction": 1.0}, uncertainty=CENTRE),
    "points": lambda: tilted(0.3, {"box": BOX}, contact={"friction": 1.0}, uncertainty={"contact_points": 0.04}),
    "friction and centre": lambda: tilted(0.3, {"box": BOX}, contact={"friction": 0.2}, uncertainty=CENTRE),
    "friction and centre both ways": lambda: tilted(
        0.3, {"box": BOX}, contact={"friction": 0.2}, uncertainty={"center_of_mass": {"box": [0.045, 0.045, 0.0]}}
    ),
    "acceleration": lambda: scene(
        robot_keys={"limits": {"x": {"acceleration": 1.0}}},
        uncertainty={"joint_acceleration": {"deviation": 0.75, "K": 2.0}},
    ),
    "torque": lambda: scene("lift", objects={"block": FLAT}, robot_keys={"limits": {"z": {"torque": 20.0}}}),
    "mass": lambda: scene(
        "lift", objects={"block": FLAT}, robot_keys=LIFT, uncertainty={"mass": {"block": [0.4, 0.7]}}
    ),
    "on the way": lambda: rocking(0.5),
    "together": lambda: rocking(
        0.5, robot_keys={"limits": {"x": {"acceleration": 0.05}}}, contact={"friction": 0.45}
    ),
    "cups": lambda: holding(WEAK, mu=0.4),
}  # fmt: skip


@pytest.mark.parametrize("method", ["reachability", "ipopt"])
@pytest.mark.parametrize("name", INFEASIBLE)
def test_what_a_diagnosis_says_is_true(name: str, method: str) -> None:
    """Each remedy, applied with the digits that are shown, makes the task feasible; each conflict is irreducible."""
    config = with_values(INFEASIBLE[name](), {"solver.method": method, "solver.collocation_points": 30})
    plan = plan_of(config)
    found = diagnose(plan)
    assert found.remedies
    for item in found.remedies:
        assert item.enough
        assert plan_of(changed(config, item.sentence)).status is Status.SOLVED, item.sentence
    for conflict in found.conflicts:
        assert solve(plan.problem.only(conflict), "reachability").status is Status.INFEASIBLE
        for limit in conflict:
            assert has_solution(plan.problem.only([other for other in conflict if other != limit]))


def has_solution(problem: TimeScalingProblem) -> bool:
    try:
        return solve(problem, "reachability").status is Status.SOLVED
    except ConfigError:  # nothing bounds the speed
        return True


def test_two_changes_that_are_needed_together_are_named_together() -> None:
    """Friction of 2.049 was asked for, which the slipping of the box with its centre at the edge needs."""
    (item,) = diagnosed(INFEASIBLE["friction and centre"]()).remedies
    assert item.sentence == (
        "contact.friction: at least 0.3094 instead of 0.2 and "
        "uncertainty.center_of_mass.box, largest: at most 0.03453 instead of 0.045 (enough together)"
    )
    assert 0.3093 < np.tan(0.3) < 0.3094
    assert 0.03453 < 0.05 - 0.05 * np.tan(0.3) < 0.03454


def test_conflicts_elsewhere_on_the_path_are_said_to_be_there() -> None:
    """A gripper at the start and a shoulder at the end were both said to be in conflict at the start."""
    found = diagnosed(
        scene(
            "tilting_slide",
            objects={"mid": FLAT | {"at": [-0.2, 0.0]}, "slick": FLAT | {"at": [0.2, 0.0]}},
            joints=[[0.0, 0.15], [0.5, 0.4]],
            contact={"friction": {"slick": 0.1, "mid": 0.3}},
        )
    )
    assert found.conflicts == (("slip of slick on tray",), ("slip of mid on tray",))
    assert found.sentence == (
        "At s = 0 (at joints[0]) the robot cannot stand still. "
        "Limits in conflict: slip of slick on tray; slip of mid on tray at s = 1 (at joints[1])."
    )
    (item,) = found.remedies
    assert item.sentence == (
        "contact.friction.mid: at least 0.4228 instead of 0.3 and "
        "contact.friction.slick: at least 0.4228 instead of 0.1 (enough together)"
    )
