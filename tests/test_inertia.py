"""Bodies that can exist: every distribution of the mass within a shape keeps the rows of a plan for `realizable`.

The oracle of `point_bodies` knows only masses at points and Newton's law.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from point_bodies import Shape, extreme, oracles, random_bodies, shape_of, worst_of
from realizable_bodies import bodies_of, used
from scenes import BOX, CONFIGS, duration, plan_of, scene, waiter

import robustopt as ro
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError
from robustopt.limits.bodies import Body
from robustopt.limits.uncertainty import bodies
from robustopt.scene.placement import placements
from robustopt.solvers import Plan

POSES = "[{position: [0.7, -0.1, 0.3], yaw: -0.8}, {position: [0.7, 0.1, 0.3], yaw: 0.8}]"
TURN = (f"path.tray_poses={POSES}", "robot.joint_friction=false", "solver.collocation_points=40")
"""0.2 m with a turn of 1.6 rad; viscous torque of the wrist would bind before the block."""

TOLERANCE = 1e-4
"""Violation that is accepted, as a part of the weight: the oracle takes finite differences."""


def tall(mu: float, reach: Sequence[float], *overrides: str, inertia: str = "realizable") -> Config:
    """A tall block on the tray of the one-block task, with an interval of its centre of mass alone."""
    return waiter(
        "one_block",
        "solver.method=reachability",
        "solver.collocation_points=20",
        "objects.block={shape: box, size: [0.15, 0.15, 0.56], mass: 1.0, on: tray}",
        "robot.collision.check=false",
        f"contact.friction={mu}",
        f"uncertainty={{center_of_mass: {{block: {list(reach)}}}, inertia: {{block: {inertia}}}}}",
        *overrides,
    )


WIDE, NARROW = (0.06, 0.06, 0.2), (0.03, 0.03, 0.1)

FEW = ("solver.method=reachability", "solver.collocation_points=20")

TASKS = {
    "wide": lambda: tall(0.2, WIDE),
    "narrow": lambda: tall(0.5, NARROW),
    "turn": lambda: tall(0.5, NARROW, *TURN),
    "side_by_side": lambda: waiter("side_by_side", *FEW),
    "pick_suction": lambda: load_config(CONFIGS / "pick_suction.yaml", list(FEW)),
}


@cache
def planned(task: str) -> Plan:
    return plan_of(TASKS[task]())


# Plans ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_no_realizable_body_violates_a_plan(task: str) -> None:
    worst, tried = worst_of(planned(task), 60, 40, np.random.default_rng(0))
    assert tried >= 100
    assert -0.05 < worst <= TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_none_of_thousands_of_realizable_bodies_violates_a_plan(task: str) -> None:
    worst, tried = worst_of(planned(task), 4000, 2000, np.random.default_rng(1))
    assert tried >= 6000
    assert worst <= TOLERANCE


@pytest.mark.parametrize(
    ("task", "least"), [("wide", 0.005), pytest.param("narrow", 0.02, marks=pytest.mark.slow), ("turn", 0.02)]
)
def test_a_plan_for_known_inertia_is_violated_by_a_realizable_body(task: str, least: float) -> None:
    """The same bodies find plans wrong that take the inertia as known, and so does the certificate if it is told."""
    told = planned(task).problem.config
    plan = plan_of(with_values(told, {"uncertainty.inertia.block": [1, 1]}))
    rng = np.random.default_rng(2)
    worst = -np.inf
    shape = shape_of(told, "block")
    for oracle in oracles(plan, 1, rng):
        values = oracle.values("block", shape.places)
        likely = np.argsort(-values.max(axis=2), axis=None)[:40]
        for m, f in zip(*np.unravel_index(likely, values.shape[:2]), strict=True):
            worst = max(worst, float((values @ extreme(shape, values[m, f]).weights).max()))
    assert worst > least
    assert ro.certify(plan).passed
    assert not ro.certify(plan, config=told).passed
    assert ro.certify(planned(task)).passed


@pytest.mark.parametrize(("inertia", "violated"), [([1, 1], True), ("realizable", False)])
def test_the_bodies_of_the_experiment_violate_a_plan_for_known_inertia(inertia: Any, violated: bool) -> None:
    """The share of a limit that bodies use exceeds 1 for a plan that takes their inertia as known, and for no other."""
    plan = plan_of(with_values(planned("wide").problem.config, {"uncertainty.inertia.block": inertia}))
    found, rng = list(oracles(plan, 1, np.random.default_rng(5))), np.random.default_rng(6)
    shares, _ = used(found[0], ["block"], bodies_of(plan.problem.config, found, ["block"], 400, rng))
    assert shares.max() > 0.97
    assert (shares.max() > 1.002) == violated
    assert violated or shares.max() <= 1.0 + TOLERANCE


def test_a_plan_for_factors_holds_at_both_ends_and_is_no_slower() -> None:
    plan = plan_of(tall(0.5, NARROW, *TURN, inertia="[0.4, 1.5]"))
    for low, high in ((0.4, 0.4), (1.5, 1.5)):
        ends = with_values(plan.problem.config, {"uncertainty.inertia.block": [low, high]})
        assert ro.certify(plan, config=ends).passed
        assert duration(ends) <= plan.duration * (1 + 1e-9)
    assert plan.duration <= planned("turn").duration * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "loss"), [("two_blocks", 1.0), ("one_block", 1.0)])
def test_plans_for_realizable_bodies_are_nearly_as_fast_as_possible(task: str, loss: float) -> None:
    """Loss of duration in per cent against the fastest timing for all worst bodies that a search finds."""
    record = importlib.import_module("bound_tightness").record
    assert record(task, ("center_of_mass",), 25, "realizable")["loss"] <= loss


@pytest.mark.parametrize("kind", ["box", "turned box, off centre", "can, off centre"])
def test_the_search_for_worst_bodies_is_as_good_as_linear_programs(kind: str) -> None:
    """Random rows at displaced centres of mass, against masses anywhere on a fine grid in the shape."""
    item, reach = SETS[kind]
    config = scene(objects={"thing": item}, uncertainty={"center_of_mass": {"thing": list(reach)}})
    search = importlib.import_module("worst_bodies").shape_of(config, "thing")
    rng, shape = np.random.default_rng(4), shape_of(config, "thing")
    levels = np.linspace(-1.0, 1.0, 9)
    if search.round:
        angles = np.arange(32) * np.pi / 16
        disc = [[r * np.cos(angle), r * np.sin(angle)] for r in (0.0, 0.5, 1.0) for angle in angles]
        grid = np.array([[x, y, z] for x, y in disc for z in levels])
    else:
        grid = np.array(list(product(levels, repeat=3)))
    for _ in range(20):
        root = rng.normal(size=(3, 3)) / shape.half
        G = root @ np.diag(rng.choice([-1.0, 1.0], size=3)) @ root.T
        G = (G + G.T) / 2
        move = rng.uniform(-1.0, 1.0, size=3) * shape.reach
        fixed = Shape(grid * shape.half, shape.half, shape.center + move, np.zeros(3))
        values = np.einsum("ki,ij,kj->k", fixed.places - fixed.center, G, fixed.places - fixed.center)
        best, found = values @ extreme(fixed, values).weights, np.sum(G * search.worst(G[None], move[None])[0])
        assert abs(found - best) <= 0.05 * np.abs(values).max()


# Sets ----------------------------------------------------------------------------------------------------

CAN = {"shape": "cylinder", "radius": 0.04, "height": 0.2, "mass": 0.5}

SETS = {
    "box": (BOX, (0.02, 0.01, 0.03)),
    "turned box, off centre": (
        BOX | {"size": [0.2, 0.1, 0.3], "yaw": 0.4, "center_of_mass": [0.05, -0.02, 0.08]},
        (0.03, 0.03, 0.06),
    ),
    "box, to its surface": (BOX | {"center_of_mass": [0.02, 0.0, -0.03]}, (0.02, 0.05, 0.02)),
    "can": (CAN, (0.02, 0.01, 0.05)),
    "can, off centre": (CAN | {"center_of_mass": [0.01, -0.02, 0.03], "yaw": 1.0}, (0.01, 0.004, 0.07)),
}


def second_moments(body: Body, phi: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """T in units of the reaches of a body, from the ten parameters per unit of mass and its displacement."""
    rest = phi - body.psi - zeta @ body.linear
    T, *_ = np.linalg.lstsq(body.moments.T, rest, rcond=None)
    np.testing.assert_allclose(T @ body.moments, rest, atol=1e-12)
    return T + body.usual


@pytest.mark.parametrize("kind", SETS)
def test_the_set_of_a_realizable_body_holds_all_bodies_that_can_exist(kind: str) -> None:
    item, reach = SETS[kind]
    config = scene(objects={"thing": item}, uncertainty={"center_of_mass": {"thing": list(reach)}})
    body, place = bodies(config)["thing"], placements(config)["thing"]
    rng, shape, found = np.random.default_rng(3), shape_of(config, "thing"), []
    for points in random_bodies(shape, 120, rng):
        r = place.position + points.places @ place.rotation.T
        inertia = np.einsum("k,kij->ij", points.weights, (r**2).sum(axis=1)[:, None, None] * np.eye(3) - outer(r))
        phi = np.r_[1.0, points.weights @ r, [inertia[i, j] for i, j in ORDER]]
        found.append(second_moments(body, phi, (points.center - shape.center) / shape.reach))
    T = np.array(found)
    assert (T[:, :3] >= -1e-9).all()
    assert (T[:, :3] <= 1 + 1e-9).all()
    for column, (a, b) in enumerate(ORDER[3:], 3):
        assert (np.abs(T[:, column]) <= (T[:, a] + T[:, b]) / 2 + 1e-9).all()
    if body.round:
        assert (T[:, 0] + T[:, 1] <= 1 + 1e-9).all()
    assert T[:, :3].max() > 0.8  # the set is not much larger than it has to be


ORDER = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def outer(r: np.ndarray) -> np.ndarray:
    return r[:, :, None] * r[:, None, :]


# Configuration -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("uncertainty", "key", "message"),
    [
        ({"inertia": {"crate": [1, 1]}}, "uncertainty.inertia.crate", "nothing is called crate; expected one of tray"),
        ({"inertia": {"link3": "realizable"}}, "uncertainty.inertia.link3", "nothing is called link3; expected one of"),
        ({"inertia": {"box": [2, 1]}}, "uncertainty.inertia.box", "expected the lowest value first"),
        (
            {"center_of_mass": {"box": [0.01, 0.06, 0.0]}},
            "uncertainty.center_of_mass.box",
            "can be 0.01 m outside of box, .* or `uncertainty.inertia: {box: \\[1, 1\\]}`",
        ),
        (
            {"center_of_mass": {"can": [0.03, 0.04, 0.0]}},
            "uncertainty.center_of_mass.can",
            "can be 0.01 m outside of can",
        ),
        (
            {"center_of_mass": {"tray": [0.0, 0.0, 0.006]}},
            "uncertainty.center_of_mass.tray",
            "can be 0.001 m outside of tray",
        ),
    ],
)
def test_mistakes_are_named(uncertainty: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        scene(objects={"box": BOX, "can": CAN | {"at": [0.2, 0.0]}}, uncertainty=uncertainty)
    assert f"{key}:" in str(caught.value)


def test_a_centre_of_mass_outside_of_the_shape_is_allowed_with_known_inertia() -> None:
    given = {"center_of_mass": {"box": [0.01, 0.06, 0.0]}, "inertia": {"box": [1, 1]}}
    assert scene(objects={"box": BOX}, uncertainty=given).inertia_of("box") == (1, 1)
    touching = scene(objects={"box": BOX}, uncertainty={"center_of_mass": {"box": [0.05, 0.05, 0.05]}})
    assert touching.inertia_of("box") == "realizable"


def test_an_explicitly_realizable_body_must_have_its_centre_of_mass_inside() -> None:
    box = BOX | {"center_of_mass": [0.0, 0.0, 0.07]}
    assert scene(objects={"box": box}).inertia_of("box") == (1, 1)
    with pytest.raises(ConfigError, match=r"uncertainty\.inertia\.box.*can be 0.02 m outside of box"):
        scene(objects={"box": box}, uncertainty={"inertia": {"box": "realizable"}})
