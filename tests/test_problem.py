"""The time-scaling problem: its grid, its rows and their names."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import FLAT, WAITERS, G, bang_bang, residual, scene, waiter

from robustopt.limits import TimeScalingProblem
from robustopt.limits.grid import _apportion, gridpoints
from robustopt.path import build_path
from robustopt.robot import load_robot
from robustopt.solvers import build_problem, build_rows, solve


@cache
def problem_of(name: str, *overrides: str) -> TimeScalingProblem:
    return build_problem(waiter(name, "solver.collocation_points=40", *overrides))


class Pieces:
    """A path of which only the boundaries of its pieces are known."""

    def __init__(self, breaks: np.ndarray) -> None:
        self.breaks = breaks


# Grid ----------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    lengths=st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6),
    intervals=st.integers(20, 500),
)
def test_grid_points_cover_every_piece_and_double_the_stops(lengths: list[float], intervals: int) -> None:
    breaks = np.r_[0.0, np.cumsum(lengths)] / np.sum(lengths)
    breaks[-1] = 1.0
    s, piece = gridpoints(Pieces(breaks), intervals)  # type: ignore[arg-type]
    K = len(lengths)
    shares = np.array(lengths) / np.sum(lengths) * intervals
    if shares.min() >= 2:
        assert len(s) == intervals + K
    assert s[0] == 0.0
    assert s[-1] == 1.0
    assert (np.diff(piece) >= 0).all()
    for k in range(K):
        own = s[piece == k]
        assert own[0] == breaks[k]
        assert own[-1] == breaks[k + 1]
        assert len(own) >= 3
        steps = np.diff(own)
        assert (steps > 0).all()
        np.testing.assert_allclose(
            steps, steps[::-1], rtol=1e-9, atol=1e-15
        )  # as fine when braking as when speeding up
        assert steps[0] <= steps[len(steps) // 2] + 1e-12
    np.testing.assert_array_equal(np.flatnonzero(np.diff(s) == 0), np.flatnonzero(np.diff(piece)))


def test_the_robot_rests_at_both_ends_and_at_stops() -> None:
    problem = problem_of("two_blocks")
    stops = np.flatnonzero(problem.ds == 0)
    assert len(stops) == 2
    np.testing.assert_array_equal(np.flatnonzero(problem.rest), np.sort(np.r_[0, stops, stops + 1, len(problem.s) - 1]))
    assert (problem.x_max[problem.rest] == 0).all()
    assert (problem.x_max[~problem.rest] > 0).all()


def test_shapes_and_names_fit_together() -> None:
    for name in WAITERS:
        problem = problem_of(name)
        P, m = problem.a.shape
        assert problem.b.shape == problem.c.shape == (P, m)
        assert len(problem.row_names) == m
        assert len(problem.x_max_names) == len(problem.s) == len(problem.piece) == P
        assert set(problem.row_names) <= set(problem.limits.names)
        assert all(bound.endswith(" velocity") for bound in problem.x_max_names)
        assert not any(row.endswith(" velocity") for row in problem.row_names)


def test_names_are_in_the_words_of_the_configuration() -> None:
    found = problem_of("side_by_side").limits.names
    assert "joint2 velocity" in found
    assert "joint2 acceleration" in found
    assert "joint2 torque" in found
    assert "slip of lid on crate" in found
    assert "tipping of bottle over tray" in found
    assert "balance of plank on left and right" in problem_of("bridge").limits.names
    assert len(set(found)) == len(found)


# Rows ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WAITERS)
def test_rows_are_fractions_of_their_limits(name: str) -> None:
    """At rest without error joint acceleration rows are -1; padding is -1 with neither u nor x."""
    problem = problem_of(name, "uncertainty={}")
    padding = (problem.a == 0) & (problem.b == 0)
    assert (problem.c[padding] == -1.0).all()
    acceleration = [row.endswith("acceleration") for row in problem.row_names]
    np.testing.assert_allclose(problem.c[:, acceleration], -1.0)
    assert (problem.c <= 0).all()  # the arm can stand still anywhere on these paths


def test_rows_of_a_slide_are_the_closed_form() -> None:
    """|u| L <= A; |u| L <= mu g; M |u| L + c <= F: all in fractions of the limit, x <= (V / L)^2."""
    length, mu = 0.7, 0.4
    limits = {"velocity": 3.0, "acceleration": 2.0, "torque": 5.0, "dry_friction": 0.5}
    config = scene(
        objects={"block": FLAT}, length=length, contact={"friction": mu}, robot_keys={"limits": {"x": limits}},
        solver={"collocation_points": 10},
    )  # fmt: skip
    limits_of = build_problem(config).limits
    np.testing.assert_allclose(limits_of.x_max, (3.0 / length) ** 2)
    acceleration = limits_of.track.acceleration(limits_of.uncertainty.error)
    np.testing.assert_allclose(acceleration[3], [[length / 2, 0, -1], [-length / 2, 0, -1]], atol=1e-12)
    torque, base = limits_of.torque, limits_of.torque.base[3]
    load = torque.load_rows[3] @ torque.loads.middle()[3]
    expected = np.array([[3.5 * length, 0, 0.5 - 5.0], [-3.5 * length, 0, -0.5 - 5.0]]) / 5.0
    np.testing.assert_allclose(load + base, expected, atol=1e-12)
    problem = build_problem(config)
    assert min(2.0, mu * G) > 5.5 / 3.5  # torque is the smallest both ways, so no other row is left
    assert set(problem.row_names) == {"x torque"}
    braking, speeding = sorted(problem.c[3] / np.abs(problem.a[3]) * length)
    assert speeding == pytest.approx(-(5.0 - 0.5) / 3.5)
    assert braking == pytest.approx(-(5.0 + 0.5) / 3.5)


def test_velocity_bound_is_of_the_joint_that_is_fastest_for_its_limit() -> None:
    config = scene(
        "two_slides",
        joints=[[0.0, 0.0], [0.6, 0.8]],
        robot_keys={"limits": {"x": {"velocity": 1.0}, "y": {"velocity": 2.0}}},
    )
    problem = build_problem(config)
    assert set(problem.x_max_names) == {"x velocity"}
    np.testing.assert_allclose(problem.limits.x_max, (1.0 / 0.6) ** 2)


def test_a_joint_that_does_not_move_bounds_nothing() -> None:
    config = scene("two_slides", joints=[[0.0, 0.0], [1.0, 0.0]], robot_keys={"limits": {"y": {"velocity": 1e-3}}})
    np.testing.assert_allclose(build_problem(config).limits.x_max, 100.0**2)


@pytest.mark.parametrize("name", WAITERS)
def test_no_row_is_redundant(name: str) -> None:
    """Each row that is not padding touches the feasible polygon of its grid point along an edge."""
    problem = problem_of(name)
    for i in range(0, len(problem.s), 7):
        rows = np.column_stack([problem.a[i], problem.b[i], problem.c[i]])
        rows = rows[np.any(rows[:, :2] != 0, axis=1)]
        bounds = np.array([[0.0, -1.0, 0.0], [0.0, 1.0 / problem.limits.x_max[i], -1.0]])
        every = np.vstack([rows, bounds])
        corners = []
        for j in range(len(every)):
            for k in range(j):
                matrix = every[[j, k], :2]
                if abs(np.linalg.det(matrix)) > 1e-14 * np.linalg.norm(matrix[0]) * np.linalg.norm(matrix[1]):
                    point = np.linalg.solve(matrix, -every[[j, k], 2])
                    if (every @ np.r_[point, 1.0]).max() <= 1e-7:
                        corners.append(point)
        touching = np.abs(np.column_stack([corners, np.ones(len(corners))]) @ rows.T) <= 1e-7
        assert (touching.sum(axis=0) >= 2).all()


def test_limits_can_be_dropped_by_name() -> None:
    problem = problem_of("two_blocks")
    names = [name for name in problem.limits.names if name.startswith("slip")]
    alone = problem.only(names)
    assert set(alone.row_names) <= set(names)
    np.testing.assert_array_equal(alone.x_max, problem.x_max)
    assert problem.only([]).a.shape[1] == 0
    again = alone.only(problem.limits.names)
    np.testing.assert_allclose(again.c, problem.c)
    np.testing.assert_allclose(again.a, problem.a)


def test_a_tangent_about_a_reference_is_exact_there_and_never_below_where_friction_hurts() -> None:
    config = scene(
        robot_keys={"limits": {"x": {"torque": 10.0, "viscous_friction": 6.0}}}, solver={"collocation_points": 10}
    )
    problem = build_problem(config)
    x_r = 0.5
    torque = problem.limits.torque
    exact = lambda x: torque.viscous[4] * np.sqrt(x)  # noqa: E731
    base = torque.base_at(np.full(len(problem.s), x_r), problem.limits.x_max)[4] - torque.base[4]
    tangent = lambda x: base[:, 1] * x + base[:, 2]  # noqa: E731
    np.testing.assert_allclose(tangent(x_r), exact(x_r))
    for x in (0.01, 0.2, 1.0, 4.0):
        assert tangent(x)[0] > exact(x)[0] > 0  # against the motion
        assert tangent(x)[1] < exact(x)[1] < 0  # with the motion: not sound by itself, checked after solving
    chord = torque.base_at(np.full(len(problem.s), np.nan), problem.limits.x_max)[4] - torque.base[4]
    np.testing.assert_allclose(chord[:, 1] * problem.limits.x_max[4], exact(problem.limits.x_max[4]))
    np.testing.assert_allclose(chord[:, 2], 0.0)


def test_rows_can_be_built_again_on_the_same_robot_and_path() -> None:
    config = waiter("one_block", "solver.collocation_points=40")
    robot = load_robot(config)
    first, second = build_problem(config), build_rows(config, robot, build_path(config, robot))
    np.testing.assert_allclose(first.a, second.a)
    np.testing.assert_allclose(first.c, second.c)
    assert first.row_names == second.row_names


def test_the_slowest_timing_satisfies_all_rows() -> None:
    """With c <= 0 everywhere, standing still and creeping are feasible: rows hold at u = 0 and tiny x."""
    for name in WAITERS:
        problem = problem_of(name)
        x = np.full(len(problem.s), 1e-9)
        assert residual(problem, x, np.zeros(len(x) - 1)) <= 1e-6


# Extremes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [10, 5000])
def test_grids_of_any_size_give_the_same_rows_where_they_meet(points: int) -> None:
    config = waiter("one_block", f"solver.collocation_points={points}")
    coarse, fine = problem_of("one_block"), build_problem(config)
    first, second = (problem.limits.track.acceleration(problem.limits.uncertainty.error) for problem in (coarse, fine))
    for end in (0, -1):
        np.testing.assert_allclose(first[end], second[end], atol=1e-9)
        np.testing.assert_allclose(coarse.limits.torque.base[end], fine.limits.torque.base[end], atol=1e-6)


def test_seven_joints_carry_a_tray() -> None:
    """Tray and arm alone, on a curved path in the joints: both solvers find one plan."""
    config = scene(
        "seven_joints",
        joints=[
            [0.0, 0.4, 0.0, -1.2, 0.0, 0.8, 0.0],
            [0.3, 0.8, 0.4, -1.5, 0.3, 0.5, 0.2],
            [0.5, 0.6, 0.2, -1.0, 0.3, 0.7, 0.4],
        ],
        tray={"size": [0.2, 0.2, 0.01], "mass": 2.0},
        uncertainty={"joint_acceleration": {"deviation": 0.1}, "mass": {"tray": [1.5, 2.5]}},
    )
    problem = build_problem(config)
    assert problem.robot.n == 7
    assert len(problem.limits.names) == 3 * 7
    fast, exact = solve(problem, "reachability"), solve(problem, "ipopt")
    assert fast.duration == pytest.approx(exact.duration, rel=1e-4)
    assert residual(fast.problem, fast.x, fast.u) <= 1e-8


@pytest.mark.parametrize("mass", [1e-6, 1e4])
def test_a_tiny_object_at_the_rim_of_a_huge_tray_is_carried_like_any_other(mass: float) -> None:
    tiny = {"shape": "box", "size": [0.005, 0.005, 0.001], "mass": mass, "at": [1.4, -1.3], "yaw": 0.3}
    config = scene(objects={"tiny": tiny, "wide": FLAT}, tray={"size": [3.0, 3.0, 0.01]}, contact={"friction": 0.2})
    plan = solve(build_problem(config), "reachability")
    assert plan.duration == pytest.approx(bang_bang(1.0, 0.2 * G), rel=1e-9)


@pytest.mark.parametrize("lengths", [[1.0, 1.0, 1.0], [1.0, 1e-6, 1e-6, 3.0], [1e-9, 1.0], [0.3, 0.07, 0.06, 0.5]])
@pytest.mark.parametrize("total", [10, 17, 200])
def test_pieces_of_very_unequal_lengths_share_exactly_the_intervals_there_are(lengths: list[float], total: int) -> None:
    counts = _apportion(np.array(lengths), total)
    assert sum(counts) == total
    assert min(counts) >= 2
    ideal = np.array(lengths) / sum(lengths) * total
    long = ideal > 4
    assert (np.abs(np.array(counts) - ideal)[long] <= 2 * len(lengths)).all()


def test_more_pieces_than_half_the_intervals_still_get_two_each() -> None:
    assert _apportion(np.ones(7), 10) == [2] * 7
