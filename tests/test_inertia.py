"""Bodies that can exist: every distribution of the mass within a shape keeps the rows of a plan for `realizable`.

The oracle knows only masses at points and Newton's law: a body is a set of points with weights, and what it requires is
the sum of the forces that its points need. Worst bodies come from linear programs over the places of the masses.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import mechanics
import numpy as np
import pytest
from scenes import BOX, CONFIGS, duration, plan_of, scene, waiter
from scipy.optimize import linprog

import robustopt as ro
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import ConfigError
from robustopt.limits.bodies import Body
from robustopt.limits.contact_limit import ContactLimit
from robustopt.limits.uncertainty import bodies
from robustopt.scene.placement import placements
from robustopt.solvers import Plan
from robustopt.solvers.plan import interval_ends

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


# Bodies of points ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shape:
    """The places of the masses of an object, and the interval of its centre of mass, axes of the object."""

    places: np.ndarray
    half: np.ndarray
    center: np.ndarray
    reach: np.ndarray


def shape_of(config: Config, name: str) -> Shape:
    """Three places along each edge of a box; two levels of rim, and the axis, of a cylinder at three heights."""
    item = config.objects[name]
    if item.size is not None:
        half = np.array(item.size) / 2
        places = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
    else:
        half = np.array([item.radius, item.radius, item.height / 2])
        angles = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
        disc = np.vstack([np.stack([np.cos(angles), np.sin(angles)], axis=1), [[0.0, 0.0]]])
        places = np.array([[*p, z] for p in disc for z in (-1.0, 0.0, 1.0)])
    reach = config.uncertainty.center_of_mass.get(name, (0.0, 0.0, 0.0))
    return Shape(places * half, half, np.array(item.center_of_mass), np.array(reach))


@dataclass(frozen=True)
class Points:
    """A body of unit mass: weights (k,) and places (k, 3) of its masses, axes of the object."""

    weights: np.ndarray
    places: np.ndarray

    @property
    def center(self) -> np.ndarray:
        return self.weights @ self.places


def extreme(shape: Shape, value: np.ndarray) -> Points:
    """The body with the largest sum of values of its places, centre of mass in the interval."""
    rows = np.vstack([shape.places.T, -shape.places.T])
    ends = np.r_[shape.center + shape.reach, shape.reach - shape.center]
    found = linprog(-value, rows, ends, np.ones((1, len(value))), [1.0])
    assert found.status == 0
    return Points(found.x, shape.places)


def random_bodies(shape: Shape, count: int, rng: np.random.Generator) -> Iterator[Points]:
    """Masses at random extreme places, some of them drawn in along axes, and uniform boxes about a centre of mass."""
    for k in range(count):
        body = extreme(shape, rng.normal(size=len(shape.places)))
        c = body.center
        if k % 3 == 1:
            body = Points(body.weights, c + rng.choice([0.0, 0.5, 1.0], size=3) * (body.places - c))
        if k % 3 == 2 and len(shape.places) == 27:
            body = uniform(c, rng.uniform(size=3) * (shape.half - np.abs(c)))
        yield body


def uniform(center: np.ndarray, half: np.ndarray) -> Points:
    """The masses of Gauss' rule with two points per axis, which has the second moments of a uniform box."""
    return Points(np.full(8, 1 / 8), center + np.array(list(product((-1.0, 1.0), repeat=3))) * half / np.sqrt(3))


def usual(config: Config, name: str) -> Points:
    """A body with the configured centre of mass and inertia, whose products are zero."""
    item = config.objects[name]
    inertia = mechanics.inertia(config, name) / item.mass
    squares = 0.5 * np.trace(inertia) - np.diag(inertia)
    return uniform(np.array(item.center_of_mass), np.sqrt(3 * squares))


# Required wrenches ---------------------------------------------------------------------------------------


def wrenches(
    config: Config, name: str, places: np.ndarray, motions: Sequence[mechanics.Motion], about: np.ndarray
) -> np.ndarray:
    """What unit masses at places (k, 3) in an object need, moments about a point, (M, k, 6)."""
    place = placements(config)[name]
    r = place.position + places @ place.rotation.T
    linear, alpha, omega = np.array([(m.linear, m.angular, m.omega) for m in motions]).transpose(1, 0, 2)[:, :, None]
    force = linear + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
    return np.concatenate([force, np.cross(r - about, force)], axis=2)


@dataclass(frozen=True)
class Oracle:
    """The rows of a contact limit at M instants, for bodies of points."""

    config: Config
    family: ContactLimit
    motions: Sequence[mechanics.Motion]

    @property
    def names(self) -> tuple[str, ...]:
        return self.family.system.loads[0]

    def values(self, name: str, places: np.ndarray) -> np.ndarray:
        """Values of the rows per unit mass at places in an object, (M, F, k)."""
        facets = self.family.system.facets[:, :6] / self.family.weight
        found = wrenches(self.config, name, places, self.motions, self.family.system.points[0])
        return np.asarray(facets @ np.swapaxes(found, 1, 2))

    def largest(self, name: str, values: np.ndarray) -> np.ndarray:
        """The values (M, F) of a body of unit mass at its worse end of the interval of mass."""
        item = self.config.objects[name]
        low, high = self.config.uncertainty.mass.get(name, (item.mass, item.mass))
        return np.maximum(low * values, high * values)

    def of_others(self, without: str) -> np.ndarray:
        """Values of the rows for all loads but one, with their usual bodies, and of the forces that press."""
        facets, given = self.family.system.facets[:, 6:] / self.family.weight, self.config.objects
        total = np.zeros((len(self.motions), len(facets)))
        for column, name in enumerate(self.family.system.pressed):
            force = given[name].held_by.tool.force
            total += facets[:, column] * (force[0] if isinstance(force, tuple) else force)
        for name in set(self.names) - {without}:
            body = usual(self.config, name)
            total += self.largest(name, self.values(name, body.places) @ body.weights)
        return total


def oracles(plan: Plan, draws: int, rng: np.random.Generator) -> Iterator[Oracle]:
    """The rows of every contact at both ends of every interval, with random ends of the acceleration errors."""
    problem = plan.problem
    u, x, points = interval_ends(plan)
    error = mechanics.nominal(problem).error
    given = problem.config.uncertainty.joint_acceleration
    radius = np.zeros(problem.robot.n) if given is None else given.K * np.broadcast_to(given.deviation, len(error))
    motions = [
        mechanics.tray_motion(problem, *values, error + rng.choice([-1.0, 1.0], size=len(error)) * radius)
        for values in zip(points, u, x, strict=True)
        for _ in range(draws if radius.any() else 1)
    ]
    for family in problem.limits.contacts:
        yield Oracle(problem.config, family, motions)


def worst_of(plan: Plan, count: int, programs: int, rng: np.random.Generator) -> tuple[float, int]:
    """The largest value of a row that any body reaches, and the number of bodies that were tried at all instants."""
    worst, tried = -np.inf, 0
    for oracle in oracles(plan, 2, rng):
        for name in oracle.names:
            if oracle.config.inertia_of(name) != "realizable":
                continue
            shape, others = shape_of(oracle.config, name), oracle.of_others(name)
            per_place = oracle.values(name, shape.places)
            for body in random_bodies(shape, count, rng):
                own = per_place if body.places is shape.places else oracle.values(name, body.places)
                worst = max(worst, float((oracle.largest(name, own @ body.weights) + others).max()))
                tried += 1
            likely = np.argsort(-(per_place.max(axis=2) + others), axis=None)[: 3 * programs : 3]
            for m, f in zip(*np.unravel_index(likely, others.shape), strict=True):
                body = extreme(shape, per_place[m, f])
                worst = max(worst, float((oracle.largest(name, per_place @ body.weights) + others).max()))
                tried += 1
    return worst, tried


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


def test_a_plan_for_factors_holds_at_both_ends_and_is_no_slower() -> None:
    plan = plan_of(tall(0.5, NARROW, *TURN, inertia="[0.4, 1.5]"))
    for low, high in ((0.4, 0.4), (1.5, 1.5)):
        ends = with_values(plan.problem.config, {"uncertainty.inertia.block": [low, high]})
        assert ro.certify(plan, config=ends).passed
        assert duration(ends) <= plan.duration * (1 + 1e-9)
    assert plan.duration <= planned("turn").duration * (1 + 1e-9)


@pytest.fixture
def experiments(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scripts that search for worst bodies can be imported."""
    monkeypatch.syspath_prepend(str(CONFIGS.parent / "experiments"))


@pytest.mark.slow
@pytest.mark.usefixtures("experiments")
@pytest.mark.parametrize(("task", "loss"), [("two_blocks", 1.0), ("one_block", 1.0)])
def test_plans_for_realizable_bodies_are_nearly_as_fast_as_possible(task: str, loss: float) -> None:
    """Loss of duration in per cent against the fastest timing for all worst bodies that a search finds."""
    record = importlib.import_module("bound_tightness").record
    assert record(task, ("center_of_mass",), 25, "realizable")["loss"] <= loss


@pytest.mark.usefixtures("experiments")
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
