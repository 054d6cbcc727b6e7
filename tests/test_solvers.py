"""Solvers: one contract, the same proven optimum, and what changes of a task do to it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_solvers import copp_duration, shortest_possible, toppra_duration
from scenes import BOX, FLAT, WAITERS, bang_bang, duration, plan_of, residual, scene, waiter

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.limits import TimeScalingProblem
from robustopt.limits.polygons import evaluate, facet_family
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.solvers.plan import duration_of, interval_ends, outcome, timing
from robustopt.solvers.reachability import passes, solve_reachability

METHODS = ("reachability", "ipopt")
AGREEMENT = 1e-4
"""Relative difference of durations that the solvers may have on the same rows."""

RESIDUAL = 1e-8
"""Fraction of a limit by which a row of a plan may be violated."""


@cache
def problem_of(name: str, points: int, *overrides: str) -> TimeScalingProblem:
    return build_problem(waiter(name, f"solver.collocation_points={points}", *overrides))


@cache
def solved(name: str, points: int, method: str, *overrides: str) -> Plan:
    plan = solve(problem_of(name, points, *overrides), method)
    assert plan.status is Status.SOLVED, plan.message
    return plan


# Contract ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", WAITERS)
def test_a_plan_keeps_the_contract(name: str, method: str) -> None:
    problem, plan = problem_of(name, 60), solved(name, 60, method)
    P = len(problem.s)
    assert plan.method == method
    assert plan.message == outcome(Status.SOLVED, plan.problem)
    assert plan.x.shape == plan.s.shape == plan.piece.shape == (P,)
    assert plan.u.shape == (P - 1,)
    assert not plan.x.flags.writeable
    assert not plan.u.flags.writeable
    assert (plan.x >= 0).all()
    assert (plan.x <= problem.x_max * (1 + 1e-12)).all()
    assert (plan.x[problem.rest] == 0).all()
    assert (plan.x[~problem.rest] > 0).all()
    np.testing.assert_allclose(plan.x[1:], plan.x[:-1] + 2 * problem.ds * plan.u, atol=1e-12)
    assert (plan.u[problem.ds == 0] == 0).all()
    assert residual(plan.problem, plan.x, plan.u) <= RESIDUAL
    root, moving = np.sqrt(plan.x), problem.ds > 0
    assert plan.duration == pytest.approx(np.sum(2 * problem.ds[moving] / (root[:-1] + root[1:])[moving]), rel=1e-12)
    assert plan.stuck == -1


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", WAITERS)
def test_the_fastest_plan_is_at_a_limit_and_names_it(name: str, method: str) -> None:
    """All but the intervals in which the limit changes, three to a piece on these paths."""
    problem, plan = problem_of(name, 60), solved(name, 60, method)
    known = set(problem.limits.names)
    assert len(plan.active) == len(plan.u)
    for names in plan.active:
        assert set(names) <= known
        assert len(set(names)) == len(names)
    assert all(not names for names, ds in zip(plan.active, problem.ds, strict=True) if ds == 0)
    idle = sum(not names for names, ds in zip(plan.active, problem.ds, strict=True) if ds > 0)
    assert idle <= 3 * (problem.piece[-1] + 1)


@pytest.mark.parametrize("name", WAITERS)
def test_contact_holds_on_all_facets_for_the_worst_parameters(name: str) -> None:
    """Ipopt starts without contact rows and asks for them by inner programs: it must end inside all facets."""
    for method in METHODS:
        plan = solved(name, 60, method)
        u, x, points = interval_ends(plan)
        for family in plan.problem.limits.contacts:
            if family.system.complete:
                rows = family.system.facets / family.weight
                values = evaluate(facet_family(rows, family.loads, np.arange(len(rows))), points, u, x)
                assert values.max() <= 1e-6


@pytest.mark.parametrize("name", WAITERS)
def test_torque_holds_exactly_with_its_viscous_part(name: str) -> None:
    for method in METHODS:
        plan = solved(name, 60, method)
        assert not plan.problem.torque_exceeds(1e-6, *interval_ends(plan))


def test_solving_twice_gives_the_same_plan() -> None:
    problem = problem_of("heavy", 60)
    for method in METHODS:
        first, second = solve(problem, method), solve(problem, method)
        np.testing.assert_array_equal(first.x, second.x)


def test_the_configuration_chooses_the_method() -> None:
    assert solve(problem_of("one_block", 60)).method == "ipopt"
    assert solve(problem_of("one_block", 60, "solver.method=reachability")).method == "reachability"


def test_a_robot_that_stands_takes_for_ever_whatever_the_sign_of_its_zero() -> None:
    for still in (0.0, -0.0):
        assert timing(np.array([1.0]), np.full(2, still))[0] == np.inf


@pytest.mark.parametrize("method", METHODS)
def test_an_infeasible_problem_has_a_status_and_no_timing(method: str) -> None:
    plan = plan_of(scene(objects={"block": FLAT}, contact={"friction": 0.1}, gravity=[2.0, 0.0, -9.0]), method)
    assert plan.status is Status.INFEASIBLE
    assert plan.message == Status.INFEASIBLE.sentence
    assert len(plan.x) == len(plan.u) == len(plan.active) == 0
    assert plan.duration == np.inf
    assert plan.stuck == 0


def test_reachability_refuses_other_costs_than_time() -> None:
    config = scene(objects={"block": FLAT}, solver={"method": "reachability"})
    costly = config.model_copy(
        update={"solver": config.solver.model_copy(update={"cost": "effort", "weight": 1.0, "method": "ipopt"})}
    )
    plan = solve(build_problem(costly), "reachability")
    assert plan.status is Status.FAILED
    assert "minimises time only" in plan.message
    assert solve(build_problem(costly), "ipopt").status is Status.SOLVED


@pytest.mark.parametrize("status", Status)
def test_every_status_has_a_sentence(status: Status) -> None:
    assert status.sentence.endswith(".")


# One optimum ---------------------------------------------------------------------------------------------

FINER = [pytest.param(n, marks=[] if n < 500 else pytest.mark.slow) for n in (50, 200, 500, 1000)]


@pytest.mark.parametrize("points", FINER)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == "side_by_side" else ()) for name in WAITERS]
)
def test_both_solvers_and_toppra_have_one_optimum(name: str, points: int) -> None:
    """At 50 intervals greedy passes are up to 0.07 % slower than the optimum; from 200 on all agree."""
    fast, exact = solved(name, points, "reachability"), solved(name, points, "ipopt")
    assert exact.duration == pytest.approx(fast.duration, rel=AGREEMENT)
    greedy = toppra_duration(fast.problem)
    assert greedy == pytest.approx(fast.duration, rel=AGREEMENT if points >= 200 else 1e-3)
    assert fast.duration <= greedy * (1 + 1e-9)
    assert fast.duration <= copp_duration(fast.problem) * (1 + 1e-8)


@pytest.mark.parametrize("points", [50, 200])
@pytest.mark.parametrize("name", WAITERS)
def test_the_optimum_is_proven_by_linear_programming(name: str, points: int) -> None:
    """No timing of the rows is faster than the tangent of the convex duration allows; the plan's own gap is honest."""
    plan = solved(name, points, "reachability")
    gap = 1 - shortest_possible(plan.problem, plan.x) / plan.duration
    assert -1e-9 <= gap <= 5e-5
    assert gap <= plan.statistics["optimality_gap"] + 1e-8 <= 5e-5 + 1e-8


def random_problem(seed: int, coupled: bool) -> TimeScalingProblem:
    """A problem of the slide whose rows are replaced by random ones; coupled ones forbid low speeds in places."""
    problem = build_problem(scene(objects={}, solver={"collocation_points": 12}))
    rng = np.random.default_rng(seed)
    P, m = len(problem.s), 6
    a, b = rng.normal(size=(P, m)), rng.normal(size=(P, m)) * (3.0 if coupled else 0.3)
    a[:, 0], a[:, 1], b[:, :2] = 1.0, -1.0, 0.0
    c = -rng.uniform(0.5, 1.5, (P, m))
    return replace(problem, a=a, b=b, c=c, row_names=("x acceleration",) * m, x_max=np.where(problem.rest, 0.0, 2.0))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 100_000), coupled=st.booleans())
def test_reachability_finds_the_proven_optimum_of_random_rows(seed: int, coupled: bool) -> None:
    """Rows with strong velocity terms make the next speed fall with the present one: greedy passes fail there."""
    plan = solve_reachability(random_problem(seed, coupled))
    assert plan.status is Status.SOLVED  # x = u = 0 satisfies all rows
    assert residual(plan.problem, plan.x, plan.u) <= RESIDUAL
    gap = 1 - shortest_possible(plan.problem, plan.x) / plan.duration
    assert gap <= 5.1e-5
    assert gap <= plan.statistics["optimality_gap"] + 1e-7


def test_greedy_passes_alone_would_not_be_optimal() -> None:
    """The previous test would be empty if greedy passes were always optimal."""
    losses = []
    for seed in range(40):
        problem = random_problem(seed, coupled=True)
        x = passes(problem.a, problem.b, problem.c, problem.x_max, problem.ds)[0]
        losses.append(1 - shortest_possible(problem, x) / duration_of(problem.ds, x))
    assert max(losses) > 1e-3


# Grids ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", WAITERS)
def test_two_hundred_intervals_are_within_three_per_mille_of_five_thousand(name: str) -> None:
    coarse, fine = solved(name, 200, "reachability"), solved(name, 5000, "reachability")
    assert coarse.duration == pytest.approx(fine.duration, rel=3e-3)


@pytest.mark.parametrize("name", WAITERS)
def test_the_coarsest_grid_is_solved_as_well(name: str) -> None:
    for method in METHODS:
        plan = solved(name, 10, method)
        assert plan.duration == pytest.approx(solved(name, 200, method).duration, rel=0.1)
        assert residual(plan.problem, plan.x, plan.u) <= RESIDUAL


# Physics of the waiter -----------------------------------------------------------------------------------


def waiter_duration(mu: float) -> float:
    return solved("two_blocks", 200, "reachability", f"contact.friction={mu}", "uncertainty={}").duration


def test_two_blocks_slow_down_like_one_over_root_mu() -> None:
    assert waiter_duration(0.125) / waiter_duration(0.1875) == pytest.approx(np.sqrt(0.1875 / 0.125), rel=2e-3)
    assert waiter_duration(0.1875) / waiter_duration(0.25) == pytest.approx(np.sqrt(0.25 / 0.1875), rel=2e-3)


def test_two_blocks_hardly_gain_from_more_friction_than_tipping_allows() -> None:
    assert 0.995 < waiter_duration(1.0) / waiter_duration(0.5) <= 1.0 + 1e-9


def test_torque_binds_for_the_heavy_load_and_joint_friction_costs_time() -> None:
    with_friction, without = (
        solved("heavy", 200, "reachability", *overrides) for overrides in ((), ("robot.joint_friction=false",))
    )
    binding = {name for names in with_friction.active for name in names}
    assert any(name.endswith("torque") for name in binding)
    assert with_friction.duration > 1.02 * without.duration
    assert with_friction.statistics["relinearisations"] >= 1


def test_torque_still_binds_without_joint_friction() -> None:
    plan = solved("heavy", 200, "reachability", "robot.joint_friction=false")
    assert any(name.endswith("torque") for names in plan.active for name in names)


# Other costs ---------------------------------------------------------------------------------------------


def penalty(plan: Plan, cost: str) -> float:
    """Integral over time of the sum of squared relative torques or accelerations, mean of both ends of intervals."""
    problem, moving = plan.problem, np.flatnonzero(plan.problem.ds > 0)
    root = np.sqrt(plan.x)
    dt = 2 * problem.ds[moving] / (root[moving] + root[moving + 1])
    total = 0.0
    for end in (0, 1):
        at = moving + end
        if cost == "smoothness":
            motion = problem.limits.motion
            rate = motion.q1[at] * plan.u[moving, None] + motion.q2[at] * plan.x[at, None]
            values = rate / problem.robot.limits.acceleration
        else:
            u = np.zeros(len(problem.s))
            u[at] = plan.u[moving]
            values = problem.torques(u, np.array(plan.x))[at] / problem.robot.limits.torque
        total += 0.5 * float(np.sum(dt * np.sum(values**2, axis=1)))
    return total


def weighted(name: str, cost: str, weight: float) -> Plan:
    config = waiter(name, "solver.collocation_points=60")
    solver = config.solver.model_copy(update={"cost": cost, "weight": weight})
    plan = plan_of(config.model_copy(update={"solver": solver}), "ipopt")
    assert plan.status is Status.SOLVED, plan.message
    return plan


@pytest.mark.parametrize("cost", ["effort", "smoothness"])
def test_a_vanishing_weight_is_minimum_time(cost: str) -> None:
    fastest = solved("one_block", 60, "ipopt").duration
    assert weighted("one_block", cost, 0.0).duration == pytest.approx(fastest, rel=1e-9)
    assert weighted("one_block", cost, 1e-6).duration == pytest.approx(fastest, rel=1e-6)


@pytest.mark.parametrize("cost", ["effort", "smoothness"])
@pytest.mark.parametrize("name", ["two_blocks", "heavy"])
def test_a_growing_weight_trades_duration_for_the_penalty(name: str, cost: str) -> None:
    plans = [weighted(name, cost, weight) for weight in (0.0, 0.1, 1.0, 10.0, 100.0)]
    durations = np.array([plan.duration for plan in plans])
    penalties = np.array([penalty(plan, cost) for plan in plans])
    assert (np.diff(durations) >= -1e-6 * durations[:-1]).all()
    assert (np.diff(penalties) <= 1e-6 * penalties[:-1]).all()
    if cost == "smoothness":
        assert durations[-1] > 2 * durations[0]
        assert penalties[-1] < penalties[0] / 4
    assert residual(plans[-1].problem, plans[-1].x, plans[-1].u) <= RESIDUAL


def test_smoothness_of_a_slide_is_the_closed_form() -> None:
    """Least T + w times the integral of (a / A)^2: a falls linearly, a cubic in time, T^4 = 36 w L^2 / A^2."""
    weight, limit, length = 50.0, 10.0, 1.0
    exact = (36 * weight * length**2 / limit**2) ** 0.25
    config = scene(
        objects={},
        robot_keys={"limits": {"x": {"acceleration": limit}}},
        solver={"method": "ipopt", "cost": "smoothness", "weight": weight, "collocation_points": 400},
    )
    plan = plan_of(config)
    assert plan.duration == pytest.approx(exact, rel=2e-3)
    assert np.abs(plan.u).max() < limit / length  # the limit itself is far away: the penalty decides


# Properties ----------------------------------------------------------------------------------------------

STACK: dict[str, Any] = {
    "lower": {"shape": "box", "size": [0.08, 0.08, 0.10], "mass": 0.5, "at": [0.05, 0.0]},
    "upper": {"shape": "cylinder", "radius": 0.03, "height": 0.16, "mass": 0.3, "on": "lower", "at": [0.005, 0.0]},
    "beside": BOX | {"at": [-0.15, 0.1], "center_of_mass": [0.01, -0.005, 0.0]},
}
CURVE = [[0.0, 0.0], [0.4, 0.1], [0.7, 0.5], [1.0, 0.3]]


def curved(objects: dict[str, Any] | None = None, **sections: Any) -> Config:
    """A stack and a box, carried along a curve in the plane."""
    keys = {"limits": {"x": {"acceleration": 6.0, "velocity": 1.5}, "y": {"acceleration": 6.0, "torque": 12.0}}}
    return scene(
        "two_slides",
        objects=STACK if objects is None else objects,
        joints=CURVE,
        robot_keys=keys,
        solver={"collocation_points": 40},
        **{"contact": {"friction": 0.35, "cone_edges": 8}, **sections},
    )


def uncertain(width: float) -> dict[str, Any]:
    return {
        "friction": [0.35 * (1 - 0.5 * width), 0.35 * (1 + 0.5 * width)],
        "contact_points": 0.004 * width,
        "center_of_mass": {"upper": [0.003 * width, 0.003 * width, 0.01 * width], "beside": [0.01 * width, 0.0, 0.0]},
        "mass": {"upper": [0.3 - 0.1 * width, 0.3 + 0.1 * width], "tray": [1.0 - 0.2 * width, 1.0 + 0.2 * width]},
        "joint_acceleration": {"deviation": 0.4 * width},
    }


KINDS = tuple(uncertain(1.0))


@cache
def nominal_duration() -> float:
    return duration(curved())


def test_intervals_of_no_width_are_the_nominal_task() -> None:
    assert duration(curved(uncertainty=uncertain(0.0))) == pytest.approx(nominal_duration(), rel=1e-9)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    kinds=st.sets(st.sampled_from(KINDS), min_size=1),
    widths=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)).map(sorted),
)
def test_wider_intervals_never_shorten_the_plan(kinds: set[str], widths: list[float]) -> None:
    narrow, wide = (
        duration(curved(uncertainty={kind: uncertain(width)[kind] for kind in sorted(kinds)})) for width in widths
    )
    assert nominal_duration() <= narrow * (1 + AGREEMENT)
    assert narrow <= wide * (1 + AGREEMENT)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_uncertainty_costs_time(kind: str) -> None:
    assert duration(curved(uncertainty={kind: uncertain(1.0)[kind]})) > (1 + 1e-4) * nominal_duration()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(mu=st.tuples(st.floats(0.05, 2.0), st.floats(0.05, 2.0)).map(sorted))
def test_more_friction_never_lengthens_the_plan(mu: list[float]) -> None:
    slippery, rough = (duration(curved(contact={"friction": value, "cone_edges": 8})) for value in mu)
    assert rough <= slippery * (1 + AGREEMENT)


@pytest.mark.parametrize("order", [("upper", "lower", "beside"), ("beside", "upper", "lower")])
def test_the_order_of_the_objects_does_not_matter(order: tuple[str, ...]) -> None:
    shuffled = curved(objects={name: STACK[name] for name in order}, uncertainty=uncertain(0.5))
    assert duration(shuffled) == pytest.approx(duration(curved(uncertainty=uncertain(0.5))), rel=1e-9)


def test_the_order_of_the_objects_of_a_bridge_does_not_matter() -> None:
    config = waiter("bridge", "solver.collocation_points=40")
    first = duration(config, "reachability")
    for order in (("plank", "right", "left"), ("right", "plank", "left")):
        shuffled = config.model_copy(update={"objects": {name: config.objects[name] for name in order}})
        assert duration(shuffled, "reachability") == pytest.approx(first, rel=1e-7)


@pytest.mark.parametrize("scale", [0.1, 3.0])
def test_lengths_in_another_unit_scale_the_duration(scale: float) -> None:
    """All lengths and gravity times k, with limits alike: the same durations."""
    objects = {
        "block": {
            "shape": "box",
            "size": [0.06 * scale, 0.2 * scale, 0.3 * scale],
            "mass": 1.0,
            "at": [0.02 * scale, 0.0],
        },
        "flat": {
            "shape": "box",
            "size": [0.1 * scale, 0.1 * scale, 0.02 * scale],
            "mass": 0.5,
            "at": [-0.1 * scale, 0.0],
        },
    }
    config = scene(
        objects=objects,
        length=scale,
        gravity=[0.0, 0.0, -9.81 * scale],
        tray={"size": [0.6 * scale, 0.6 * scale, 0.01 * scale]},
        contact={"friction": 0.25},
        robot_keys={"limits": {"x": {"velocity": 1.2 * scale, "acceleration": 1.9 * scale}}},
        uncertainty={"joint_acceleration": {"deviation": 0.1 * scale}, "contact_points": 0.001 * scale},
    )
    reference = with_values(
        config,
        {
            "objects.block.size": [0.06, 0.2, 0.3],
            "objects.block.at": [0.02, 0.0],
            "objects.flat.size": [0.1, 0.1, 0.02],
            "objects.flat.at": [-0.1, 0.0],
            "path.joints": [[0.0], [1.0]],
            "gravity": [0.0, 0.0, -9.81],
            "tray.size": [0.6, 0.6, 0.01],
            "robot.limits.x": {"velocity": 1.2, "acceleration": 1.9},
            "uncertainty": {"joint_acceleration": {"deviation": 0.1}, "contact_points": 0.001},
        },
    )
    assert duration(config) == pytest.approx(duration(reference), rel=1e-9)


@pytest.mark.parametrize("pace", [1e-3, 0.2, 50.0])
@pytest.mark.parametrize("method", METHODS)
def test_time_in_another_unit_scales_the_duration(method: str, pace: float) -> None:
    """Velocity times p, acceleration and gravity times p^2, friction of the joint times p: durations divided by p."""
    config, reference = (
        scene(
            objects={"block": FLAT},
            gravity=[0.0, 0.0, -9.81 * p**2],
            contact={"friction": 0.25},
            robot_keys={
                "limits": {
                    "x": {
                        "velocity": 0.8 * p,
                        "acceleration": 1.9 * p**2,
                        "torque": 7.0 * p**2,
                        "dry_friction": 1.0 * p**2,
                        "viscous_friction": 2.0 * p,
                    }
                }
            },
        )
        for p in (pace, 1.0)
    )
    assert duration(config, method) * pace == pytest.approx(duration(reference, method), rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_masses_of_all_bodies_scale_out_unless_torque_binds(method: str) -> None:
    heavy = {name: item | {"mass": 1e3 * item["mass"]} for name, item in STACK.items()}
    strong = {"limits": {"all": {"torque": 1e9}, "x": {"acceleration": 6.0, "velocity": 1.5}}}
    plain, scaled = (
        duration(
            scene("two_slides", objects=objects, joints=CURVE, robot_keys=strong, contact={"cone_edges": 8}), method
        )
        for objects in (STACK, heavy)
    )
    assert scaled == pytest.approx(plain, rel=1e-6)


# Regressions ---------------------------------------------------------------------------------------------


def test_ipopt_is_not_kept_from_slow_plans_by_fast_velocity_limits() -> None:
    """A lower bound of x relative to x_max put the first grid point out of reach: limit of 100 m/s, 2000 points."""
    robot = {"limits": {"x": {"torque": 10.0, "dry_friction": 3.0, "viscous_friction": 20.0}}}
    config = scene(robot_keys=robot, solver={"method": "ipopt", "collocation_points": 2000})
    assert plan_of(config).status is Status.SOLVED


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("length", "acceleration"), [(1e-6, 10.0), (1e-3, 1e-3), (100.0, 50.0), (1.0, 1e-9)])
def test_no_scale_of_the_path_or_the_robot_spoils_the_accuracy(length: float, acceleration: float, method: str) -> None:
    """Ipopt's absolute tolerances made a path of a micrometre 2e-5 too slow and met a very slow arm with NaN."""
    config = scene(length=length, robot_keys={"limits": {"x": {"acceleration": acceleration}}})
    assert duration(config, method) == pytest.approx(bang_bang(length, acceleration), rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_robot_that_cannot_leave_rest_is_infeasible(method: str) -> None:
    """It used to be solved with x = 0 everywhere, in infinite time."""
    plan = plan_of(scene(objects={"block": FLAT}, gravity=[0.0, 0.0, 0.0]), method)
    assert plan.status is Status.INFEASIBLE
    assert plan.stuck >= 0


def test_a_greedy_pass_that_comes_to_rest_too_early_is_polished() -> None:
    """Strong velocity terms let the largest speed be followed by none: a timing in infinite time."""
    problem = build_problem(scene(objects={}, solver={"collocation_points": 10}))
    stopped = 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        P, m = len(problem.s), 8
        a, b = rng.normal(size=(P, m)), 30 * rng.normal(size=(P, m))
        a[:, 0], a[:, 1], b[:, :2] = 1.0, -1.0, 0.0
        c = -rng.uniform(0.05, 1.5, (P, m))
        names = ("x acceleration",) * m
        rows = replace(problem, a=a, b=b, c=c, row_names=names, x_max=np.where(problem.rest, 0.0, 2.0))
        stopped += not np.isfinite(duration_of(problem.ds, passes(a, b, c, rows.x_max, problem.ds)[0]))
        plan = solve_reachability(rows)
        assert plan.status is Status.SOLVED
        assert np.isfinite(plan.duration)
    assert stopped > 0


@pytest.mark.parametrize("points", [99, 100])
@pytest.mark.parametrize("method", METHODS)
def test_a_joint_path_that_turns_around_at_a_grid_point_is_planned(method: str, points: int) -> None:
    """There q' = 0, which bounds neither sd nor sdd; with an even number of intervals it divided by zero."""
    config = scene(
        objects={"block": FLAT},
        joints=[[0.0], [1.0], [0.0]],
        contact={"friction": 0.3},
        solver={"collocation_points": points},
    )
    assert duration(config, method) == pytest.approx(2 * bang_bang(1.0, 0.3 * 9.81), rel=6e-3)
