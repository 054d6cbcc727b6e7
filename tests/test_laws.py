"""Plans with suction cups and grippers: closed forms, several cups, uncertain forces, and remedies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from held import PLATE, cup, cups, edge_wrenches, friction_edges, grip, holding
from scenes import G, bang_bang
from scipy.optimize import linprog

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.solvers.diagnosis import diagnose

FINE = 64
"""Edges of friction cones with which closed forms for a round cone hold within 0.12 %."""

ANY = 1000.0
"""Acceleration limit of the slides, for directions in which nothing else bounds the part [m/s^2]."""


def plan_of(config: Config, method: str | None = None) -> Plan:
    plan = solve(build_problem(config), method)
    assert plan.status is Status.SOLVED, plan.message
    return plan


def level(*direction: float) -> list[list[float]]:
    return [[0.0, 0.0, 0.0], list(direction)]


def acceleration(plan: Plan) -> float:
    """Acceleration of a plan along a straight path that speeds up and brakes alike [m/s^2]."""
    length = float(np.linalg.norm(plan.problem.path(np.array([1.0])) - plan.problem.path(np.array([0.0]))))
    assert np.abs(plan.u).max() == pytest.approx(np.abs(plan.u).min(), rel=1e-6)
    return 4.0 * length / plan.duration**2


def binding(plan: Plan) -> set[str]:
    return {name for names in plan.active for name in names}


# Suction --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4])
@pytest.mark.parametrize(("mu", "mass"), [(0.2, 1.0), (0.5, 2.0), (1.0, 0.05)])
def test_a_cup_carries_a_plate_as_far_as_friction_does(mu: float, mass: float, angle: float) -> None:
    """a = mu (F - m g) / m, in any direction; a part below the lips cannot peel and does not twist."""
    F = 30.0
    path = level(np.cos(angle), np.sin(angle), 0.0)
    part = {"size": [0.3, 0.3, 1e-4], "mass": mass}
    plan = plan_of(holding(cup(force=F), path, mu=mu, edges=FINE, **part))
    assert acceleration(plan) == pytest.approx(mu * (F - mass * G) / mass, rel=2e-3)
    coarse = plan_of(holding(cup(force=F), path, mu=mu, **part))
    assert acceleration(coarse) <= acceleration(plan) * (1 + 1e-9)


def test_a_slip_without_twist_is_named_slip() -> None:
    assert binding(plan_of(holding(cup(), level(1, 0, 0), size=[0.3, 0.3, 1e-4]))) == {"slip of part on cup"}


def test_a_cup_lifts_a_part_with_what_weight_leaves_of_the_vacuum() -> None:
    """Upwards a = F / m - g; braking presses the part against the lip, which has no limit."""
    plan = plan_of(holding(cup(force=30.0), level(0, 0, 1), edges=FINE))
    assert plan.u[0] == pytest.approx(30.0 - G, rel=1e-9)
    assert plan.duration == pytest.approx(bang_bang(1.0, 30.0 - G, ANY), rel=0.01)  # it brakes within one interval
    assert "peel of part off cup" in binding(plan_of(holding(cup(force=30.0), level(0, 0, 1))))


@pytest.mark.parametrize(
    ("points", "angle", "share"), [(8, 0.0, 1.0), (8, np.pi / 8, np.cos(np.pi / 8)), (4, 0.0, 1.0)]
)
@pytest.mark.parametrize("pressure", ["fixed", "free"])
def test_a_long_part_peels_off_over_a_point_of_the_lip_or_over_a_flat(
    points: int, angle: float, share: float, pressure: str
) -> None:
    """m a h = (F - m g) r towards a point of the lip, r cos(pi/n) towards the flat between two."""
    F, R, h = 30.0, 0.03, 0.1
    path = level(np.cos(angle), np.sin(angle), 0.0)
    plan = plan_of(holding(cup(R, F, pressure=pressure), path, mu=2.0, points=points, size=[0.1, 0.1, 2 * h]))
    assert acceleration(plan) == pytest.approx((F - G) * R * share / h, rel=1e-9)
    assert "peel of part off cup" in binding(plan)


@pytest.mark.parametrize("mu", [0.3, 0.5])
def test_a_cup_at_the_side_holds_a_part_by_friction(mu: float) -> None:
    """At rest F = m g / mu and F = m g h / r; less is infeasible, a little more is not."""
    R, h = 0.03, 0.02
    aside = {"pose": {"rpy": [0.0, np.pi / 2, 0.0]}, "face": "front", "pressure": "free"}
    needed = G * max(1.0 / mu, h / R)
    for share, status in ((0.99, Status.INFEASIBLE), (1.02, Status.SOLVED)):
        config = holding(cup(R, share * needed, **aside), level(0, 0, 1), mu=mu, edges=FINE, size=[2 * h, 0.2, 0.2])
        assert solve(build_problem(config)).status is status


def test_a_twisted_cup_yields_to_what_elastic_normals_resist() -> None:
    """A centre of mass off the axis: across the offset less than the best normals resist, by at most a quarter."""
    offset = {"center_of_mass": [0.02, 0.0, 0.0], "size": [0.3, 0.3, 1e-4]}
    free, fixed = (
        acceleration(plan_of(holding(cup(pressure=p), level(0, 1, 0), mu=0.3, **offset))) for p in ("free", "fixed")
    )
    assert 0.75 * free < fixed < 0.98 * free
    along = [
        acceleration(plan_of(holding(cup(pressure=p), level(1, 0, 0), mu=0.3, **offset))) for p in ("free", "fixed")
    ]
    assert along[0] == pytest.approx(along[1], rel=1e-9)
    plan = plan_of(holding(cup(), level(0, 1, 0), mu=0.3, **offset))
    assert binding(plan) == {"twist of part on cup"}


# Grip -----------------------------------------------------------------------------------------------------

BLOCK = {"size": [0.06, 0.1, 0.1]}
CLOSING, MU = 40.0, 0.8


def test_a_grip_lifts_with_the_friction_of_both_pads() -> None:
    """m (g + a) = 2 mu F upwards, and as much more downwards as gravity helps."""
    most = 2 * MU * CLOSING
    plan = plan_of(holding(grip(), level(0, 0, 1), mu=MU, edges=FINE, **BLOCK))
    assert (plan.u[0], -plan.u[-1]) == pytest.approx((most - G, most + G), rel=2e-3)


def test_a_grip_accelerates_across_with_what_weight_leaves_of_friction() -> None:
    plan = plan_of(holding(grip(), level(0, 1, 0), mu=MU, edges=FINE, **BLOCK))
    assert acceleration(plan) == pytest.approx(np.sqrt((2 * MU * CLOSING) ** 2 - G**2), rel=2e-3)
    assert binding(plan) == {"grip of part"}


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("finger", [0.0, 0.1])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_grip_unloads_its_rigid_pad_and_is_never_pushed_off_it(axis: str, finger: float, way: float) -> None:
    """Away from the driven finger a = F / (m + m_finger); towards it no limit. Friction bears the weight anyway."""
    size = [0.06, 0.06, 0.1]
    # the tool points down with its y axis against the world's: its driven finger is on the side of +x, or of -y
    driven = 1.0 if axis == "x" else -1.0
    path = level(way, 0, 0) if axis == "x" else level(0, way, 0)
    plan = plan_of(holding(grip(axis=axis, finger_mass=finger), path, mu=3.0, edges=FINE, size=size))
    speeding, braking = plan.u[0], -plan.u[-1]
    unloading = braking if way == driven else speeding
    held = speeding if way == driven else braking
    assert unloading == pytest.approx(CLOSING / (1.0 + finger), rel=1e-9)
    assert held == pytest.approx(ANY, rel=1e-9)


def test_a_weak_grip_drops_a_part_before_it_unloads() -> None:
    """m g = 2 mu F - mu m a: the friction that is left of both pads carries the weight, a = (2 F - m g / mu) / m."""
    plan = plan_of(holding(grip(force=8.0), level(-1, 0, 0), mu=MU, edges=FINE, **BLOCK))
    assert plan.u[0] == pytest.approx(2 * 8.0 - G / MU, rel=2e-3)


@pytest.mark.parametrize("off", [0.0, 0.004, -0.01])
def test_pads_share_the_weight_of_a_part_by_lever(off: float) -> None:
    """A centre of mass off along the closing axis, pads without height: m (g + a) (1 + |c| / b) = 2 mu F."""
    part = {"size": [0.06, 0.1, 0.1], "center_of_mass": [off, 0.0, 0.0]}
    share = 1.0 + abs(off) / 0.03
    most = 2 * MU * CLOSING / share
    for pressure in ("free", "fixed"):
        plan = plan_of(
            holding(grip((0.02, 1e-5), depth=0.05, pressure=pressure), level(0, 0, 1), mu=MU, edges=FINE, **part)
        )
        assert (plan.u[0], -plan.u[-1]) == pytest.approx((most - G, most + G), rel=2e-3)


@pytest.mark.parametrize(("off", "free", "fixed"), [(0.005, 54.19, 48.20), (0.01, 54.19, 38.73), (0.02, 35.44, 24.52)])
def test_a_twisted_grip_lifts_with_what_uniform_pads_resist(off: float, free: float, fixed: float) -> None:
    """The acceleration for normal forces that a program chooses, and for a quarter of the force at each corner."""
    for pressure, expected in (("free", free), ("fixed", fixed)):
        config = holding(
            grip(pressure=pressure),
            level(0, 0, 1),
            mu=MU,
            edges=FINE,
            size=[0.06, 0.2, 0.1],
            center_of_mass=[0, off, 0],
        )
        assert plan_of(config).u[0] == pytest.approx(expected, rel=1e-3)


# Several cups ---------------------------------------------------------------------------------------------

ROW = ((-0.05, 0.0, 0.02), (0.05, 0.0, 0.02))


def test_every_cup_has_the_force_of_its_own_vacuum() -> None:
    """Level mu (2 F - m g) / m, upwards 2 F / m - g: the force is for each cup, and none can use another's vacuum."""
    flat = {"size": [0.3, 0.3, 1e-4]}
    assert acceleration(plan_of(holding(cups(*ROW), level(0, 1, 0), **flat))) == pytest.approx(
        0.5 * (60.0 - G), rel=2e-3
    )
    lift = plan_of(holding(cups(*ROW), level(0, 0, 1), **flat))
    assert lift.u[0] == pytest.approx(60.0 - G, rel=1e-7)
    aside = plan_of(holding(cups(*ROW), level(0, 0, 1), center_of_mass=[0.05, 0, 0], **flat))
    # it hangs right below the second cup; the first pulls as far as the far point of its lip presses back
    assert aside.u[0] == pytest.approx(30.0 + 30.0 * (1.0 - 0.1 / 0.12) - G, rel=1e-6)


LIP = 0.02 * np.column_stack([np.cos(np.pi * np.arange(8) / 4), np.sin(np.pi * np.arange(8) / 4)])
"""Contact points of a cup about its centre (8, 2)."""


def twist_rows(lips: np.ndarray, mu: float, edges: int) -> np.ndarray:
    """Rows over the total forces along all friction edges of some lips, from rotations about many places and slips.

    lips: contact points (n, 2); the normals are those of least squares over all of them
    """
    rng, count = np.random.default_rng(0), 2000
    centres = np.vstack([lips, 0.03 * rng.normal(size=(count, 2)) * 3 ** rng.normal(size=(count, 1))])
    lever = np.column_stack([np.ones(len(lips)), lips[:, 1], -lips[:, 0]])
    local = edge_wrenches(np.column_stack([lips, np.zeros(len(lips))]), np.eye(3), mu, edges)
    normals = lever @ np.linalg.inv(lever.T @ lever) @ local[[2, 3, 4]]
    rows = []
    for y in np.column_stack([centres[:, 1], -centres[:, 0], np.ones(len(centres))]):
        velocity = y[:2] + np.column_stack([-lips[:, 1], lips[:, 0]])
        rows.append(y @ local[[0, 1, 5]] - (velocity @ friction_edges(mu, edges).T).max(axis=1) @ normals)
        rows.append(-y @ local[[0, 1, 5]] - (-velocity @ friction_edges(mu, edges).T).max(axis=1) @ normals)
    return np.array(rows) / 0.05


def stretches(plan: Plan, pressure: str) -> list[float]:
    """Largest factor on the first and the last acceleration of a plan with the two cups of `ROW`, by programs.

    They know the plate, the lips, and that the plate moves without turning; with prescribed pressure the twist is
    bounded by definition, for thousands of motions.
    """
    part, contact = plan.problem.config.objects["part"], plan.problem.config.contact
    assert part.size is not None
    mu, edges, down = float(contact.friction), contact.cone_edges, np.diag([1.0, -1.0, -1.0])  # type: ignore[arg-type]
    lips = np.vstack([LIP + np.array([x, 0.0]) for x, _, _ in ROW])
    cone = edge_wrenches(np.column_stack([lips, np.zeros(len(lips))]), np.eye(3), mu, edges)
    vacuum = np.sum([[0.0, 0.0, -30.0, 0.0, 30.0 * x, 0.0] for x, _, _ in ROW], axis=0)
    arm = np.array([*part.center_of_mass[:2], 0.0]) @ down + [0.0, 0.0, 0.5 * part.size[2]]
    bounds = twist_rows(lips, mu, edges) if pressure == "fixed" else np.zeros((1, cone.shape[1]))
    found = []
    for s, u in ((0.0, plan.u[0]), (1.0, plan.u[-1])):
        per_stretch, weight = (
            np.r_[force, np.cross(arm, force)]
            for force in (down @ plan.problem.path(np.array([s]), 1)[0] * u, np.array([0.0, 0.0, -G]))
        )
        answer = linprog(
            np.r_[np.zeros(bounds.shape[1]), -1.0],
            A_eq=np.column_stack([cone, -per_stretch]),
            b_eq=weight - vacuum,
            A_ub=np.column_stack([bounds, np.zeros(len(bounds))]),
            b_ub=np.zeros(len(bounds)),
            bounds=[(0, None)] * (bounds.shape[1] + 1),
            method="highs",
        )
        assert answer.status == 0, answer.message
        found.append(float(answer.x[-1]))
    return found


@pytest.mark.parametrize("pressure", ["fixed", "free"])
@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.3, 1.0, 0.0), (0.2, 0.5, 0.3)])
def test_a_plan_with_two_cups_is_possible_and_hardly_more_is(pressure: str, direction: tuple[float, ...]) -> None:
    """A program for the forces at all points of both lips, with one elastic pressure, finds the same limit."""
    part = {"size": [0.3, 0.3, 0.06], "center_of_mass": [0.01, 0.02, 0.0]}
    config = holding(cups(*ROW, pressure=pressure), level(*direction), mu=0.4, **part)
    for method in ("reachability", "ipopt"):
        found = stretches(plan_of(config, method), pressure)
        tolerance = {"fixed": 4e-3, "free": 1e-6}[pressure]
        assert min(found) > 1.0 - 1e-6
        assert max(found) < 1.0 + tolerance


def test_both_solvers_find_the_same_plan_of_held_parts() -> None:
    for held_by, part in ((cups(*ROW), {}), (cup(), {"center_of_mass": [0.01, 0.01, 0.0]}), (grip(), BLOCK)):
        config = holding(held_by, [[0, 0, 0], [0.5, 0.2, 0.3], [1.0, -0.2, 0.1]], mu=0.4, **part)
        fast, exact = plan_of(config, "reachability"), plan_of(config, "ipopt")
        assert fast.duration == pytest.approx(exact.duration, rel=1e-4)


def test_a_part_on_a_held_part_loads_its_cup() -> None:
    """From below: m a = mu (F + m g) for the part below with what it carries, and mu g for that by itself."""
    below = {"suction": {**cup(0.05, 10.0)["suction"], "face": "bottom", "pose": {"rpy": [np.pi, 0, 0]}}}
    above = {"above": {"shape": "box", "size": [0.1, 0.1, 1e-4], "mass": 1.0, "on": "part"}}
    for mu, expected in (
        ({"part": 0.1, "above": 0.5}, 0.1 * (10.0 + 2 * G) / 2.0),
        ({"part": 0.9, "above": 0.2}, 0.2 * G),
    ):
        plan = plan_of(holding(below, mu=mu, edges=FINE, size=[0.3, 0.3, 1e-4], objects=above))
        assert acceleration(plan) == pytest.approx(expected, rel=2e-3)


# Uncertain quantities -------------------------------------------------------------------------------------

HOLDS = [
    (cup(force=[25.0, 40.0]), {"center_of_mass": [0.01, 0.01, 0.0]}, (1.0, 0.4, 0.0)),
    (cup(force=[25.0, 40.0], pressure="free"), {"size": [0.1, 0.1, 0.2]}, (1.0, 0.4, 0.5)),
    (cups(*ROW, force=[25.0, 40.0]), {}, (1.0, 0.4, 0.5)),
    (grip(force=[25.0, 40.0]), {**BLOCK, "center_of_mass": [0.0, 0.01, 0.0]}, (0.2, 0.4, 1.0)),
    (grip(force=[25.0, 40.0], finger_mass=0.1), BLOCK, (-1.0, 0.1, 0.1)),
]


@pytest.mark.parametrize(("held_by", "part", "direction"), HOLDS)
def test_a_plan_for_an_interval_of_the_force_is_that_for_its_worse_end(
    held_by: dict[str, Any], part: dict[str, Any], direction: tuple[float, ...]
) -> None:
    """With several cups the forces differ within the interval, which is worse than the lower end of all."""
    config = holding(held_by, level(*direction), **part)
    kind = next(iter(held_by))
    key = f"objects.part.held_by.{kind}.force"
    ends = [plan_of(with_values(config, {key: force})).duration for force in (25.0, 40.0)]
    several = len(held_by[kind].get("cups", ())) > 1
    assert plan_of(config).duration / ends[0] == pytest.approx(1.0, rel=1e-9) or several
    assert 1.0 - 1e-9 < plan_of(config).duration / ends[0] < 1.2
    assert ends[1] < ends[0]


def test_the_other_intervals_count_for_held_parts_too() -> None:
    """Each makes a plan slower, and the plan for it is no faster than that for any value inside."""
    part = {"size": [0.3, 0.3, 0.1], "center_of_mass": [0.02, 0.02, 0.0]}
    config = holding(cups(*ROW), level(1.0, 0.4, 0.5), mu=0.4, **part)
    free = plan_of(config).duration
    for key, value in {
        "uncertainty.friction": {"part_cup2": [0.3, 0.5]},
        "uncertainty.mass": {"part": [0.8, 1.3]},
        "uncertainty.center_of_mass": {"part": [0.01, 0.01, 0.02]},
        "uncertainty.contact_points": {"part": 0.008},
        "uncertainty.joint_acceleration": {"deviation": 1.0},
    }.items():
        robust = plan_of(with_values(config, {key: value})).duration
        assert robust > 1.005 * free, key
    heavy = plan_of(with_values(config, {"objects.part.mass": 1.3})).duration
    assert plan_of(with_values(config, {"uncertainty.mass": {"part": [0.8, 1.3]}})).duration >= heavy * (1 - 1e-9)


def test_an_acceleration_error_takes_its_part_of_the_margin() -> None:
    """Across the vacuum and along it: m (a + e) = mu (F - m (g + e)), by e in x and in z alike."""
    e, mu = 2.0, 0.5
    error = {"uncertainty": {"joint_acceleration": {"deviation": e, "K": 1.0}}}
    plan = plan_of(holding(cup(), level(1, 0, 0), mu=mu, edges=FINE, size=[0.3, 0.3, 1e-4], sections=error))
    across = mu * (30.0 - G - e)
    assert acceleration(plan) == pytest.approx(np.sqrt(across**2 - e**2) - e, rel=3e-3)


# Infeasible -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("held_by", "needed", "conflict"),
    [
        (cup(force=8.0), G, "peel of part off cup"),
        (grip(force=4.0), G / (2 * 0.5), "grip of part"),
        (cups(*ROW, force=4.0), G / 2, "peel of part off cups"),
    ],
)
def test_too_little_force_asks_for_the_force_that_is_enough(
    held_by: dict[str, Any], needed: float, conflict: str
) -> None:
    config = holding(held_by, level(0, 1, 0), size=[0.06, 0.3, 0.1] if "grip" in held_by else PLATE)
    plan = solve(build_problem(config))
    assert plan.status is Status.INFEASIBLE
    diagnosis = diagnose(plan)
    assert diagnosis.standstill
    assert diagnosis.conflicts == ((conflict,),)
    key = f"objects.part.held_by.{next(iter(held_by))}.force"
    (remedy,) = [remedy for remedy in diagnosis.remedies if remedy.key == key]
    assert remedy.enough
    assert remedy.needed == pytest.approx(needed, rel=2e-3)
    plan_of(with_values(config, {key: remedy.needed}))


def test_an_interval_of_too_little_force_is_raised_at_its_lower_end() -> None:
    config = holding(cup(force=[8.0, 12.0]), level(0, 1, 0))
    remedies = {remedy.key: remedy for remedy in diagnose(solve(build_problem(config))).remedies}
    remedy = remedies["objects.part.held_by.suction.force"]
    assert remedy.found == 8.0
    assert remedy.needed == pytest.approx(G, rel=2e-3)
    plan_of(with_values(config, {"objects.part.held_by.suction.force": [remedy.needed, 12.0]}))
