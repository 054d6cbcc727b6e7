"""Certificate of parts that cups or a gripper hold: closed forms, programs as oracles, and plans that must fail."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import CONFIGS, FIXTURES
from scipy.optimize import linprog
from test_certificate import G, LinePath, seen, there_and_stop

from robustopt.certificate import Certificate, certify
from robustopt.certificate.balance import balance, required, required_by_base
from robustopt.certificate.contact_points import Contacts, Face
from robustopt.certificate.force_closure import GAP
from robustopt.certificate.loads import body_loads
from robustopt.certificate.motion import CARRIER
from robustopt.certificate.systems import System
from robustopt.certificate.twist import Hold, elastic_pressure, pad_pressure, twist_gauge
from robustopt.certificate.world import World
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.limits.names import LimitKind
from robustopt.solvers import Plan, build_problem, solve

FLAT = 0.002
"""Height of a part whose centre of mass is so near to the cup that it slides before it peels [m]."""
DOWN = [np.pi, 0.0, 0.0]
"""Turn of a tool frame with z downwards."""
SIDEWAYS = [0.0, np.pi / 2, 0.0]
"""Turn of a tool frame with z along the x axis of the gantry."""
CONTACT = {LimitKind.CONTACT, LimitKind.GRIP, LimitKind.BALANCE}


def held(part: dict[str, Any], others: dict[str, Any] | None = None, **sections: Any) -> Config:
    """A part on the tool of a gantry that nothing but its contacts limits."""
    strong = {"all": {"acceleration": 1e3, "velocity": 1e3, "torque": 1e5}}
    data = {
        "name": "held",
        "robot": {"model": "gantry.xml", "tool": "tool", "collision": {"check": False}, "limits": strong},
        "objects": {"part": part, **(others or {})},
        "path": {"joints": sections.pop("joints", [[0.0] * 4, [1.0] * 4])},
        "solver": {"method": "reachability", "collocation_points": 60},
        **sections,
    }
    return with_values(Config.model_validate({**data, "folder": FIXTURES}), {})


def hung(size: list[float], rpy: list[float] = DOWN, **suction: Any) -> dict[str, Any]:
    """A part of 1 kg that a cup of 30 mm radius and 30 N holds by its top."""
    given: dict[str, Any] = {"cups": [{"at": [0.0, 0.0], "radius": 0.03}], "force": 30.0, "pose": {"rpy": rpy}}
    return {"shape": "box", "size": size, "mass": 1.0, "held_by": {"suction": given | suction}}


def gripped(**grip: Any) -> dict[str, Any]:
    """A part of 1 kg that two pads close on along y with 40 N; the driven finger is on the side of -y."""
    given: dict[str, Any] = {"pad": [0.03, 0.03], "axis": "y", "force": 40.0, "pose": {"rpy": DOWN}}
    return {"shape": "box", "size": [0.1, 0.06, 0.08], "mass": 1.0, "held_by": {"grip": given | grip}}


def accelerated(config: Config, way: list[float], acceleration: float) -> Certificate:
    """The certificate of a motion there and back along a unit vector in x, y and z."""
    return certify(there_and_stop(config, acceleration, LinePath([*way, 0.0])))


def contact_margin(certificate: Certificate) -> float:
    return min(found.on_grid for name, found in certificate.margins.items() if name.kind in CONTACT)


def requires_exactly(config: Config, way: list[float], limit: float, kind: str, accuracy: float = 1e-6) -> None:
    """A part holds up to this acceleration along a way, and fails by the named kind of limit beyond it."""
    assert contact_margin(accelerated(config, way, (1.0 - accuracy) * limit)) > 0.0
    assert contact_margin(accelerated(config, way, (1.0 + accuracy) * limit)) < 0.0
    failed = accelerated(config, way, (1.0 + max(0.001, 2.0 * accuracy)) * limit)
    assert not failed.passed
    assert failed.worst.limit.kind == kind
    assert failed.worst.limit.subject == "part"


# Suction --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pressure", ["free", "fixed"])
@pytest.mark.parametrize("way", [[1.0, 0.0, 0.0], [0.6, -0.8, 0.0]])
def test_a_hanging_part_slips_at_the_friction_of_what_the_vacuum_leaves(pressure: str, way: list[float]) -> None:
    config = held(hung([0.1, 0.1, FLAT], pressure=pressure), contact={"friction": 0.5})
    requires_exactly(config, way, 0.5 * (30.0 - G), "slip")


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_a_hanging_part_is_pulled_off_by_the_vacuum_less_its_weight(pressure: str) -> None:
    requires_exactly(held(hung([0.1, 0.1, 0.1], pressure=pressure)), [0.0, 0.0, 1.0], 30.0 - G, "peel")


@pytest.mark.parametrize("pressure", ["free", "fixed"])
@pytest.mark.parametrize(("angle", "arm"), [(0.0, 1.0), (np.pi / 8, np.cos(np.pi / 8))])
def test_a_long_part_peels_over_a_point_or_a_flat_of_the_lip(pressure: str, angle: float, arm: float) -> None:
    config = held(hung([0.1, 0.1, 0.2], pressure=pressure), contact={"friction": 2.0})
    limit = (30.0 - G) * 0.03 * arm / 0.1
    requires_exactly(config, [np.cos(angle), np.sin(angle), 0.0], limit, "peel")


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_a_cup_at_the_side_of_a_part_carries_its_weight_by_friction(pressure: str) -> None:
    config = held(hung([0.1, 0.08, FLAT], SIDEWAYS, pressure=pressure), contact={"friction": 0.5})
    requires_exactly(config, [0.0, 0.0, 1.0], 0.5 * 30.0 - G, "slip")
    requires_exactly(config, [0.0, 1.0, 0.0], np.sqrt((0.5 * 30.0) ** 2 - G**2), "slip")
    requires_exactly(config, [-1.0, 0.0, 0.0], 30.0 - G / 0.5, "slip", 1e-5)


def test_a_cup_at_the_side_peels_if_the_weight_has_an_arm() -> None:
    """F r = m g h, with 60 mm from the lip to the centre of mass and a lip point straight below its centre."""
    weak = 1.0 * G * 0.06 / 0.03
    for force, holds in ((1.001 * weak, True), (0.999 * weak, False)):
        part = hung([0.1, 0.1, 0.12], SIDEWAYS, force=force)
        found = accelerated(held(part, contact={"friction": 2.0}), [0.0, 0.0, 1.0], 1e-6)
        assert found.passed == holds
        if not holds:
            assert found.worst.limit.kind == "peel"


def test_the_weakest_vacuum_and_the_least_friction_count() -> None:
    config = held(hung([0.1, 0.1, FLAT], force=[30.0, 40.0]), uncertainty={"friction": [0.5, 0.9]})
    requires_exactly(config, [1.0, 0.0, 0.0], 0.5 * (30.0 - G), "slip")
    worst = accelerated(config, [1.0, 0.0, 0.0], 11.0).worst
    assert worst.parameters == {"friction": {"part": 0.5}, "force": {"part": 30.0}}


def test_a_cup_that_cannot_carry_its_part_fails_at_rest() -> None:
    found = accelerated(held(hung([0.1, 0.1, 0.1], force=9.0)), [1.0, 0.0, 0.0], 1e-3)
    assert not found.passed
    assert found.worst.limit == "peel of part off cup"


def test_a_stack_on_a_held_part_loads_its_cup() -> None:
    """A cup below a part carries both objects; on top the upper one slides by itself."""
    part = hung([0.1, 0.1, 0.02], [0.0, 0.0, 0.0], face="bottom")
    top = {"shape": "box", "size": [0.08, 0.08, FLAT], "mass": 2.0, "on": "part"}
    config = held(part, {"top": top}, contact={"friction": {"part": 0.3, "top": 0.4}})
    margins = accelerated(config, [0.6, 0.8, 0.0], 2.0).margins
    assert margins["contact of top on part"].on_grid == pytest.approx(1 - 2.0 / (0.4 * G), abs=1e-6)
    assert margins["contact of part on cup"].on_grid == pytest.approx(1 - 3 * 2.0 / (0.3 * (30.0 + 3 * G)), abs=1e-6)


# Grip -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_a_grip_lifts_by_the_friction_of_both_pads(pressure: str) -> None:
    config = held(gripped(pressure=pressure), contact={"friction": 0.6})
    requires_exactly(config, [0.0, 0.0, 1.0], 2 * 0.6 * 40.0 - G, "grip")


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_a_grip_holds_a_level_acceleration_across_its_axis(pressure: str) -> None:
    config = held(gripped(pressure=pressure), contact={"friction": 0.6})
    requires_exactly(config, [1.0, 0.0, 0.0], np.sqrt((2 * 0.6 * 40.0) ** 2 - G**2), "grip")


@pytest.mark.parametrize("finger", [0.0, 0.25])
def test_away_from_the_driven_finger_the_closing_force_drives_part_and_finger(finger: float) -> None:
    config = held(gripped(finger_mass=finger), contact={"friction": 0.9}, gravity=[0.0, 0.0, -1e-6])
    for acceleration, holds in ((0.999, True), (1.001, False)):
        plan = there_and_stop(config, acceleration * 40.0 / (1.0 + finger), LinePath([0.0, 1.0, 0.0, 0.0]))
        assert certify(plan).passed == holds


def test_towards_the_driven_finger_there_is_no_limit() -> None:
    """The rigid finger pushes, and the driven one has its closing force to carry the weight."""
    config = held(gripped(), contact={"friction": 0.9})
    world, moving, at = seen(config, there_and_stop(config, 228.0, LinePath([0.0, 1.0, 0.0, 0.0])))
    value = balance(world, world.systems[0], moving, world.nominal.repeated(len(at.s)), GAP).value
    towards = moving.frames[CARRIER].linear[1] < 0.0
    assert value[towards].max() < 1.0
    assert value[~towards & (at.free > 0.0)].min() > 1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_weight_of_a_finger_counts_if_the_pads_close_upright(side: float) -> None:
    """Above the part the driven finger presses with its weight too; below it, the closing force carries that first."""
    part = gripped(axis="x", finger_mass=2.0, pose={"rpy": [0.0, -side * np.pi / 2, 0.0]})
    config = held(part, contact={"friction": 0.5})
    driven = 40.0 + side * 2.0 * G
    limit = 0.5 * (driven + driven + side * G)
    assert accelerated(config, [0.0, 1.0, 0.0], 0.999 * limit).passed
    assert not accelerated(config, [0.0, 1.0, 0.0], 1.001 * limit).passed


def test_both_ends_of_the_closing_force_are_looked_at() -> None:
    found = accelerated(held(gripped(force=[30.0, 50.0]), contact={"friction": 0.6}), [0.0, 0.0, 1.0], 26.2)
    assert not found.passed
    assert found.worst.parameters["force"] == {"part_pad1": 30.0}


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_small_pads_share_by_lever_if_the_centre_of_mass_is_off_along_the_axis(pressure: str) -> None:
    """The nearer pad, 20 mm from the centre of mass, carries two thirds of the weight."""
    part = gripped(pressure=pressure, pad=[1e-4, 1e-4]) | {"center_of_mass": [0.0, 0.01, 0.0]}
    config = held(part, contact={"friction": 0.6})
    requires_exactly(config, [0.0, 0.0, 1.0], 0.6 * 40.0 * 3 / 2 - G, "grip", 0.01)


# Twist ----------------------------------------------------------------------------------------------------


def lip(mu: float = 0.5, points: int = 8) -> Hold:
    angle = 2 * np.pi * np.arange(points) / points
    plane = np.stack([np.cos(angle), np.sin(angle)])[:, :, None]
    friction = np.full((points, 1), mu)
    return Hold((Face(0, points, 0),), plane, friction, elastic_pressure(plane), np.eye(6), np.cos(np.pi / 16))


def pads() -> Hold:
    corners = np.array([[1.0, 0.4], [-1.0, 0.4], [-1.0, -0.4], [1.0, -0.4]]).T
    plane = np.concatenate([corners, corners], axis=1)[:, :, None]
    faces = Face(0, 4, 0, closing=0), Face(4, 8, 0)
    return Hold(faces, plane, np.repeat([[0.5], [0.3]], 4, axis=0), pad_pressure(4, 4), np.eye(6), 1.0)


def resisted(normals: np.ndarray, hold: Hold, effort: np.ndarray, edges: int = 512) -> bool:
    """Whether friction at given normal forces makes a twist, by a linear program over polygons inside the discs."""
    angle = 2 * np.pi * np.arange(edges) / edges
    x, y = hold.plane[:, :, 0, None]
    push = hold.mu * normals[:, None] * np.cos(angle), hold.mu * normals[:, None] * np.sin(angle)
    columns = np.stack([push[0], push[1], x * push[1] - y * push[0]]).reshape(3, -1)
    each = np.repeat(np.eye(len(normals)), edges, axis=1)
    found = linprog(
        np.zeros(columns.shape[1]), A_eq=columns, b_eq=effort[[0, 1, 5]], A_ub=each, b_ub=np.ones(len(normals)),
        method="highs",
    )  # fmt: skip
    return bool(found.status == 0)


def test_pure_twist_slip_and_pull_of_a_lip() -> None:
    rest, move = np.zeros((7, 3)), np.zeros((7, 3))
    rest[2], move[0, 0], move[5, 1], move[2, 2] = 2.0, 0.6, 0.6, -0.6
    value, _ = twist_gauge(lip(), rest, move)
    np.testing.assert_allclose(value, [0.6, 0.6, 0.3], atol=1e-12)


@pytest.mark.parametrize("own", [lip(), pads()], ids=["lip", "pads"])
def test_random_twists_against_a_linear_program(own: Hold) -> None:
    """At 0.2 % more and less than the gauge the program says yes and no."""
    rng = np.random.default_rng(0)
    for _ in range(25):
        rest, move = np.zeros(7), np.array([*rng.normal(size=6) * [0.5, 0.5, 0.1, 0.1, 0.1, 0.5], 0.0])
        rest[2 if own.faces[0].closing < 0 else 6] = 1.0
        value, rates = twist_gauge(own, rest[:, None], move[:, None])
        for factor, possible in ((1.002, True), (0.998, False)):
            effort = factor * value[0] * rest + move
            normals = own.normals(effort[:, None])[:, 0]
            assert (normals > 0.0).all()
            assert resisted(normals, own, effort) == possible
        at_limit = value[0] * rest + move
        cut = own.cut(rates, own.strength(at_limit[:, None]))[:, 0]
        assert abs(cut @ at_limit) < 1e-12
        assert cut @ rest > 0.0


def test_elastic_normals_balance_the_effort() -> None:
    rng = np.random.default_rng(1)
    own, effort = lip(), rng.normal(size=(7, 5))
    normals, (x, y) = own.normals(effort), own.plane
    np.testing.assert_allclose(normals.sum(axis=0), effort[2], atol=1e-12)
    np.testing.assert_allclose((normals * y).sum(axis=0), effort[3], atol=1e-12)
    np.testing.assert_allclose(-(normals * x).sum(axis=0), effort[4], atol=1e-12)


@pytest.mark.parametrize("offset", [0.005, 0.01, 0.02])
@pytest.mark.parametrize("tool", ["cup", "grip"])
def test_prescribed_pressure_allows_less_if_the_load_twists(tool: str, offset: float) -> None:
    """Less than pressure that may be chosen, but with the centre of mass off by 20 mm at most 45 % less."""
    limits = {}
    for pressure in ("free", "fixed"):
        if tool == "cup":
            part, way = hung([0.1, 0.1, FLAT], pressure=pressure), [1.0, 0.0, 0.0]
            part["center_of_mass"] = [0.0, offset, 0.0]
        else:
            part, way = gripped(pressure=pressure), [0.0, 0.0, 1.0]
            part["center_of_mass"] = [offset, 0.0, 0.0]
        limits[pressure] = largest(held(part, contact={"friction": 0.8}), way)
    assert 0.55 * limits["free"] < limits["fixed"] < 0.999 * limits["free"]


def largest(config: Config, way: list[float]) -> float:
    """The largest acceleration along a way that the first system holds."""
    world, moving, at = seen(config, there_and_stop(config, 1.0, LinePath([*way, 0.0])))
    there = moving.at(np.flatnonzero(at.free > 0.0)[:1])
    low, high = 0.0, 200.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        frames = {name: replace(frame, linear=middle * frame.linear) for name, frame in there.frames.items()}
        values = world.nominal.repeated(1)
        holds = balance(world, world.systems[0], replace(there, frames=frames), values, GAP).value[0] <= 1.0
        low, high = (middle, high) if holds else (low, middle)
    return low


# Several cups ---------------------------------------------------------------------------------------------


def two_cups(pressure: str, center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    """A part below two cups of 20 N that are 100 mm apart along x."""
    cups = [{"at": [side * 0.05, 0.0], "radius": 0.02} for side in (-1.0, 1.0)]
    return hung([0.2, 0.1, 0.1], cups=cups, force=20.0, pressure=pressure) | {"center_of_mass": list(center_of_mass)}


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_two_cups_slip_and_pull_off_with_both_vacuums(pressure: str) -> None:
    config = held(two_cups(pressure), contact={"friction": 0.3})
    for way, limit in (([0.0, 0.0, 1.0], 40.0 - G), ([1.0, 0.0, 0.0], 0.3 * (40.0 - G))):
        assert contact_margin(accelerated(config, way, 0.9999 * limit)) > 0.0
        failed = accelerated(config, way, 1.0001 * limit)
        assert failed.margins["contact of part on cups"].on_grid < 0.0


def test_two_cups_peel_across_the_line_between_them_over_their_lips() -> None:
    config = held(two_cups("fixed"), contact={"friction": 2.0})
    limit = (40.0 - G) * 0.02 / 0.05
    assert contact_margin(accelerated(config, [0.0, 1.0, 0.0], 0.999 * limit)) > 0.0
    assert contact_margin(accelerated(config, [0.0, 1.0, 0.0], 1.001 * limit)) < 0.0


@pytest.mark.parametrize("pressure", ["free", "fixed"])
def test_two_cups_against_a_linear_program(pressure: str) -> None:
    """Forces of 64 edges at all lip points; with prescribed pressure the twist for 1200 rates of motion."""
    config = held(two_cups(pressure, (0.02, 0.03, 0.0)), contact={"friction": 0.5})
    world, moving, at = seen(config, there_and_stop(config, 6.0, LinePath([0.3, 0.9, 0.2, 1.5])))
    system, values = world.systems[0], world.nominal.repeated(len(at.s))
    exact = balance(world, system, moving, values, GAP).value
    rest, move = required(world, system, moving, body_loads(world, moving, values), values)
    for t in (0, 7, 19):
        assert exact[t] == pytest.approx(by_program(system, world, rest[:, t], move[:, t]), rel=6e-3)


def by_program(system: System, world: World, rest: np.ndarray, move: np.ndarray) -> float:
    """Gauge of two cups, by a linear program; lips of 8 points."""
    contacts = system.contact_points(world.nominal.friction[:, None], world.nominal.shift[..., None])
    angle = 2 * np.pi * np.arange(64) / 64
    force = np.stack([np.ones(64), np.cos(angle), np.sin(angle)])
    forces = np.repeat(force[:, :, None], 8, axis=2)[..., None]
    matrix = np.column_stack([*(contacts.wrenches(face, forces).reshape(6, -1) for face in system.faces), -rest])
    above = bounds = None
    if system.hold is not None:
        above, bounds = np.zeros((1200, matrix.shape[1])), np.zeros(1200)
        above[:, :-1] = -(twist_cuts(contacts).T @ matrix[:, :-1])
    cost = np.append(np.zeros(matrix.shape[1] - 1), 1.0)
    return float(linprog(cost, A_ub=above, b_ub=bounds, A_eq=matrix, b_eq=move, method="highs").x[-1])


def twist_cuts(contacts: Contacts) -> np.ndarray:
    """Slack of the twist per wrench (6, 1200) for random rates of motion, with elastic lips in the plane z = 0."""
    rates = np.random.default_rng(0).normal(size=(3, 1200))
    points, mu = contacts.point[..., 0], contacts.mu[:, 0]
    assert np.all(points[2] == 0.0)
    lever = np.stack([np.ones(16), points[1], -points[0]])
    normals = lever.T @ np.linalg.inv(lever @ lever.T)
    speeds = np.hypot(rates[0] - points[1][:, None] * rates[2], rates[1] + points[0][:, None] * rates[2])
    cuts = np.zeros((6, 1200))
    cuts[[2, 3, 4]] = normals.T @ (mu[:, None] * speeds)
    cuts[[0, 1, 5]] -= rates
    return cuts


# Plans ----------------------------------------------------------------------------------------------------

TWISTED = (0.01, 0.015, 0.0)
"""Centre of mass that makes level accelerations twist the contact [m]."""

BINDING = {
    "free cup": hung([0.1, 0.1, 0.04], pressure="free"),
    "fixed cup": hung([0.1, 0.1, 0.04]),
    "free grip": gripped(pressure="free"),
    "fixed grip": gripped(),
    "free cups": two_cups("free"),
    "fixed cups": two_cups("fixed"),
}
WAY = [[0.0, 0.0, 0.0, 0.0], [0.6, 0.5, 0.2, 0.4]]


@pytest.mark.parametrize("law", BINDING)
def test_a_plan_passes_and_one_per_cent_more_of_x_fails(law: str) -> None:
    part = BINDING[law] | {"center_of_mass": list(TWISTED)}
    config = held(part, joints=WAY, contact={"friction": 0.5, "cone_edges": 32, "patch_points": 4})
    plan = solve(build_problem(config))
    assert certify(plan).passed
    faster = certify(replace(plan, x=1.01 * plan.x, u=1.01 * plan.u))
    assert not faster.passed
    assert faster.worst.on_grid
    assert faster.worst.limit.subject == "part"


def test_a_plan_for_more_force_fails_if_there_may_be_less() -> None:
    config = held(BINDING["fixed cup"], joints=WAY)
    weaker = with_values(config, {"objects.part.held_by.suction.force": [25.0, 35.0]})
    found = certify(solve(build_problem(config)), config=weaker)
    assert not found.passed
    assert found.worst.parameters["force"] == {"part": 25.0}


# Hands ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def with_tray() -> Plan:
    config = load_config(CONFIGS / "humanoid_tray.yaml", ["solver.collocation_points=60"])
    return solve(build_problem(config))


def test_hands_that_hold_a_tray_are_looked_at(with_tray: Plan) -> None:
    margins = certify(with_tray).margins
    hands = {name: found.on_grid for name, found in margins.items() if name.kind == LimitKind.GRIP}
    assert set(hands) == {"grip of tray by left hand", "grip of tray by right hand"}
    assert min(found.on_grid for found in margins.values()) > -1e-6
    assert margins["contact of both feet"].on_grid < 0.01


@pytest.mark.parametrize(
    ("key", "enough", "wrong"), [("contact.friction.tray", 0.12, 0.07), ("tray.hands.squeeze", 28.0, 31.0)]
)
@pytest.mark.slow
def test_hands_slip_with_little_friction_or_a_large_internal_force(
    with_tray: Plan, key: str, enough: float, wrong: float
) -> None:
    """25 N at friction 0.6 hold 30 N across, and half of the weight of 0.8 kg at a friction of 0.08."""
    for value, holds in ((enough, True), (wrong, False)):
        found = certify(with_tray, config=with_values(with_tray.problem.config, {key: value}))
        hands = [margin.on_grid for name, margin in found.margins.items() if name.kind == LimitKind.GRIP]
        assert (min(hands) > 0.0) == holds
        assert holds or not found.passed


def test_a_humanoid_with_a_tray_stands_with_the_weight_of_all(with_tray: Plan) -> None:
    problem = with_tray.problem
    world, moving, at = seen(problem.config, with_tray)
    still = np.flatnonzero(at.free == 0.0)
    there, values = moving.at(still), world.nominal.repeated(len(still))
    force = required_by_base(world, there, body_loads(world, there, values), 0.0 * values.error)
    np.testing.assert_allclose(force[2], (problem.robot.mass + 0.8) * G, rtol=1e-9)
    np.testing.assert_allclose(force[:2], 0.0, atol=1e-9)
