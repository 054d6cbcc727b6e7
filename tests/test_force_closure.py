"""Force closure on exact Coulomb cones: closed forms, a linear program with many edges, degenerate patches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from robustopt.certificate.contact_points import (
    Contacts,
    Face,
    even_pressure,
    inner_direction,
    simply_held,
    single_block,
)
from robustopt.certificate.force_closure import GAP, ROUGH_GAP, Gauge, gauge, seen_from

SQUARE = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
PENTAGON = np.array([[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi * np.arange(5) / 5])
DISC = np.array([[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi * np.arange(16) / 16])
WEIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
EDGES = 256


def gauge_from_rest(contacts: Contacts, rest: np.ndarray, move: np.ndarray) -> Gauge:
    """The gauge, seen from an even pressure where the contacts cannot hold `rest`."""
    even = even_pressure(contacts, rest.shape[1])
    held = gauge(contacts, even, rest - even).value <= 1.0 + GAP
    return gauge(contacts, *seen_from(contacts, held, rest, move))


def solved(contacts: Contacts, rest: np.ndarray, move: np.ndarray) -> float:
    return float(gauge_from_rest(contacts, rest[:, None], move[:, None]).value[0])


def generators(contacts: Contacts, edges: int = EDGES) -> np.ndarray:
    """Rows of the edges of an inner approximation of every friction cone, (rows, n edges)."""
    angle = 2 * np.pi * np.arange(edges) / edges
    columns = []
    for face in contacts.faces:
        for i in range(face.first, face.last):
            point, mu = contacts.point[:, i, 0], contacts.mu[i, 0]
            force = np.stack([mu * np.cos(angle), mu * np.sin(angle), np.ones(edges)])
            force = force if face.axes is None else face.axes @ force
            wrench = np.concatenate([force, np.cross(point, force, axisb=0, axisc=0)])
            column = np.zeros((contacts.rows, edges))
            column[6 * face.above : 6 * face.above + 6] = wrench
            if face.below >= 0:
                column[6 * face.below : 6 * face.below + 6] = -wrench
            if face.closing >= 0:
                column[contacts.closing(face)] = 1.0
            columns.append(column)
    return np.concatenate(columns, axis=1)


def by_linear_program(contacts: Contacts, rest: np.ndarray, move: np.ndarray) -> float:
    """The gauge on cones with 256 edges: never below the exact one, and above it by their gap at most."""
    columns = np.column_stack([generators(contacts), -rest])
    cost = np.append(np.zeros(columns.shape[1] - 1), 1.0)
    result = linprog(cost, A_eq=columns, b_eq=move, method="highs")
    return float(result.x[-1]) if result.status == 0 else np.inf


def bridge(mu: float = 0.5) -> Contacts:
    """A plank (block 2) on two posts (blocks 0 and 1) on the ground."""
    x, z = np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0])
    left, right = 0.5 * SQUARE - x, 0.5 * SQUARE + x
    points = np.concatenate([left, right, left + z, right + z])
    faces = (Face(0, 4, 0, -1), Face(4, 8, 1, -1), Face(8, 12, 2, 0), Face(12, 16, 2, 1))
    return Contacts(faces, points.T[:, :, None].copy(), np.full((16, 1), mu), inner_direction(faces, [mu] * 4))


# Closed forms ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [SQUARE, PENTAGON, DISC])
@pytest.mark.parametrize("mu", [1e-3, 0.3, 1.0, 50.0])
@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 4])
def test_pure_slip_is_the_friction_ratio(points: np.ndarray, mu: float, angle: float) -> None:
    push = 0.7 * mu * np.array([np.cos(angle), np.sin(angle), 0.0, 0.0, 0.0, 0.0])
    accuracy = 3e-8 if mu > 0.01 else ROUGH_GAP
    assert solved(single_block(points, mu), WEIGHT, push) == pytest.approx(0.7, abs=accuracy)


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8), (0.7, 0.7)])
def test_pure_tipping_is_the_way_of_the_center_of_pressure_to_the_edge(direction: tuple[float, float]) -> None:
    x, y = 0.8 * np.array(direction)
    move = np.array([0.0, 0.0, 0.0, y, -x, 0.0])
    assert solved(single_block(SQUARE, 0.5), WEIGHT, move) == pytest.approx(max(abs(x), abs(y)), abs=3e-8)


def test_tipping_from_a_center_of_pressure_that_is_off_the_middle() -> None:
    rest = np.array([0.0, 0.0, 1.0, 0.0, -0.4, 0.0])
    assert solved(single_block(SQUARE, 0.5), rest, np.array([0, 0, 0, 0, -0.3, 0.0])) == pytest.approx(0.5, abs=3e-8)
    assert solved(single_block(SQUARE, 0.5), rest, np.array([0, 0, 0, 0, 0.7, 0.0])) == pytest.approx(0.5, abs=3e-8)


def test_pure_twist_is_carried_by_all_corners_at_their_distance() -> None:
    move = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.25])
    assert solved(single_block(SQUARE, 0.5), WEIGHT, move) == pytest.approx(0.25 / (0.5 * np.sqrt(2)), abs=3e-8)


def test_less_weight_counts_where_the_gauge_is_seen_from() -> None:
    move = np.array([0.3, 0.0, -0.2, 0.0, 0.0, 0.0])
    assert solved(single_block(SQUARE, 0.5), WEIGHT, move) == pytest.approx(0.3 / 0.5 + 0.2, abs=3e-8)


def test_a_pull_upwards_beyond_the_weight_is_beyond_the_limit() -> None:
    move = np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])
    assert solved(single_block(SQUARE, 0.5), WEIGHT, move) == pytest.approx(1.5, abs=1e-7)


def test_what_motion_presses_down_uses_nothing() -> None:
    move = np.array([0.1, 0.0, 1.0, 0.1, 0.0, 0.0])
    assert solved(single_block(SQUARE, 0.5), WEIGHT, move) == pytest.approx(0.0, abs=3e-8)


def test_a_bridge_whose_parts_slide_together() -> None:
    """The same friction everywhere and wide posts: everything slides at once, at the friction ratio."""
    weights = np.array([1.0, 1.0, 0.5])
    rest, move = np.zeros(18), np.zeros(18)
    heights = np.array([1e-6, 1e-6, 2.0])
    rest[2::6] = weights
    rest[3::6], rest[4::6] = 0.0, -np.array([-3.0, 3.0, 0.0]) * weights
    move[1::6] = 0.3 * weights
    move[3::6] = -heights * move[1::6]
    move[5::6] = np.array([-3.0, 3.0, 0.0]) * move[1::6]
    assert solved(bridge(0.5), rest, move) == pytest.approx(0.6, abs=1e-7)


def pads(mu: float = 0.5, half: float = 1.0, tall: float = 0.5) -> Contacts:
    """A block between two square pads that close along x: the driven finger presses towards -x."""
    flat = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * tall
    faces, points = [], []
    for k, side in enumerate((1.0, -1.0)):
        axes = np.column_stack([[0.0, 0.0, 1.0], np.cross([-side, 0.0, 0.0], [0.0, 0.0, 1.0]), [-side, 0.0, 0.0]])
        points.append(np.array([side * half, 0.0, 0.0]) + flat @ axes[:, :2].T)
        faces.append(Face(4 * k, 4 * k + 4, 0, -1, axes, 0 if k == 0 else -1))
    point = np.concatenate(points).T[:, :, None].copy()
    return Contacts(tuple(faces), point, np.full((8, 1), mu), inner_direction(faces, [mu, mu]))


def gripped(force: float, move: Sequence[float], weight: float = 1.0, mu: float = 0.5) -> float:
    """The gauge of a block of a weight between pads with a closing force, for the wrench that the motion adds."""
    rest = np.array([0.0, 0.0, weight, 0.0, 0.0, 0.0, force])
    return solved(pads(mu), rest, np.array([*move, 0.0]))


@pytest.mark.parametrize("mu", [0.3, 0.8])
def test_a_grip_lifts_with_the_friction_of_both_pads(mu: float) -> None:
    at_limit = 2.0 * mu * 4.0 - 1.0
    assert gripped(4.0, [0.0, 0.0, 0.999 * at_limit, 0.0, 0.0, 0.0], mu=mu) < 1.0
    assert gripped(4.0, [0.0, 0.0, at_limit, 0.0, 0.0, 0.0], mu=mu) == pytest.approx(1.0, abs=1e-7)
    assert gripped(4.0, [0.0, 0.0, 1.001 * at_limit, 0.0, 0.0, 0.0], mu=mu) > 1.0


def test_a_grip_holds_a_level_acceleration_across_its_axis() -> None:
    at_limit = np.sqrt((2 * 0.5 * 4.0) ** 2 - 1.0)
    assert gripped(4.0, [0.0, at_limit, 0.0, 0.0, 0.0, 0.0]) == pytest.approx(1.0, abs=1e-7)


def test_a_grip_opens_away_from_the_driven_finger_only() -> None:
    """Towards the other finger the driven one has its closing force alone; towards itself the rigid one pushes."""
    assert gripped(4.0, [3.0, 0.0, 0.0, 0.0, 0.0, 0.0], weight=0.0) < 1.0
    assert gripped(4.0, [4.0, 0.0, 0.0, 0.0, 0.0, 0.0], weight=0.0) == pytest.approx(0.0, abs=1e-7)
    assert gripped(4.0, [-4.0, 0.0, 0.0, 0.0, 0.0, 0.0], weight=0.0) == pytest.approx(1.0, abs=1e-7)


def test_random_grips_against_a_linear_program() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        contacts = pads(rng.uniform(0.2, 0.9), rng.uniform(0.5, 2.0))
        rest = np.array([*rng.uniform(-0.2, 0.2, 3), 0.0, 0.0, 0.0, 1.0])
        move = np.array([*rng.normal(size=6) * 0.3, 0.0])
        exact, outer = solved(contacts, rest, move), by_linear_program(contacts, rest, move)
        assert exact <= outer + 2e-8 * (1 + outer)
        assert outer <= exact * (1 + LOOSE) + LOOSE


# Oracle ---------------------------------------------------------------------------------------------------

LOOSE = 1.0 / np.cos(np.pi / EDGES) - 1.0
"""How much an inner approximation with this many edges is short of the cone."""


@pytest.mark.parametrize("points", [SQUARE, PENTAGON])
def test_random_wrenches_against_a_linear_program(points: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        contacts = single_block(points, rng.uniform(0.1, 1.0))
        rest = np.array([0.0, 0.0, 1.0, *rng.uniform(-0.3, 0.3, 2), 0.0])
        move = rng.normal(size=6) * [0.3, 0.3, 0.3, 0.5, 0.5, 0.3]
        exact, outer = solved(contacts, rest, move), by_linear_program(contacts, rest, move)
        assert exact <= outer + 2e-8 * (1 + outer)
        assert outer <= exact * (1 + LOOSE) + LOOSE


def test_random_bridges_against_a_linear_program() -> None:
    rng = np.random.default_rng(2)
    rest = np.zeros(18)
    rest[2::6] = [1.0, 1.0, 0.5]
    rest[4::6] = [3.0, -3.0, 0.0]
    for _ in range(10):
        contacts = bridge(rng.uniform(0.2, 0.8))
        move = rng.normal(size=18) * 0.05
        exact, outer = solved(contacts, rest, move), by_linear_program(contacts, rest, move)
        assert exact <= outer + 2e-8 * (1 + outer)
        assert outer <= exact * (1 + LOOSE) + LOOSE


def bracket(contacts: Contacts, move: np.ndarray) -> Gauge:
    return gauge(contacts, WEIGHT[:, None], move[:, None])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([SQUARE, PENTAGON, DISC]), st.floats(0.02, 3.0))
def test_the_bracket_is_tight_and_its_direction_separates(seed: int, points: np.ndarray, mu: float) -> None:
    rng = np.random.default_rng(seed)
    contacts = single_block(points, mu)
    solution = bracket(contacts, rng.normal(size=6) * [0.4 * mu, 0.4 * mu, 0.3, 0.5, 0.5, 0.3 * mu])
    value, y = solution.value[0], solution.y[:, 0]
    assert abs(value - solution.lower[0]) <= 2 * GAP * (1 + value)
    assert (y @ generators(contacts)).min() >= -1e-12 * np.abs(y).max()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([SQUARE, PENTAGON, DISC]))
def test_simple_forces_are_a_proof(seed: int, points: np.ndarray) -> None:
    """What is simply held is inside the cone, also with displaced points; near the middle nearly everything is."""
    rng = np.random.default_rng(seed)
    moved = points + rng.uniform(-0.05, 0.05, points.shape) * [1.0, 1.0, 0.0]
    contacts = single_block(moved, 0.4)
    wrench = (WEIGHT + rng.normal(size=6) * [0.15, 0.15, 0.2, 0.4, 0.4, 0.1])[:, None]
    even = even_pressure(contacts, 1)
    if simply_held(contacts, wrench)[0]:
        assert gauge(contacts, even, wrench - even).value[0] <= 1.0 + 1e-7
    assert simply_held(contacts, even + 0.1 * (wrench - even))[0]


def test_it_does_not_matter_which_programs_are_solved_together() -> None:
    rng = np.random.default_rng(3)
    moves = rng.normal(size=(6, 1500)) * np.array([0.3, 0.3, 0.3, 0.5, 0.5, 0.3])[:, None]
    rest = np.repeat(WEIGHT[:, None], 1500, axis=1)
    contacts = single_block(SQUARE, 0.5)
    together = gauge(contacts, rest, moves).value
    alone = [gauge(contacts, rest[:, [k]], moves[:, [k]]).value[0] for k in range(0, 1500, 100)]
    np.testing.assert_allclose(together[::100], alone, rtol=0, atol=3e-8)


# Edges ----------------------------------------------------------------------------------------------------


def test_a_line_carries_moments_about_itself_up_to_its_ends_and_none_across() -> None:
    line = single_block(np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 0.5)
    assert solved(line, WEIGHT, np.array([0.0, 0.0, 0.0, 0.0, -0.8, 0.0])) == pytest.approx(0.8, abs=1e-6)
    assert solved(line, WEIGHT, np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])) == pytest.approx(np.sqrt(0.2), abs=1e-6)
    assert solved(line, WEIGHT, np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])) == np.inf


def test_a_point_carries_forces_only() -> None:
    point = single_block(np.zeros((1, 3)), 0.5)
    assert solved(point, WEIGHT, np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])) == pytest.approx(0.6, abs=1e-6)
    assert solved(point, WEIGHT, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])) == np.inf


def test_at_the_limit_exactly() -> None:
    contacts = single_block(SQUARE, 0.5)
    assert solved(contacts, WEIGHT, np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])) == pytest.approx(1.0, abs=3e-8)
    corner = np.array([0.0, 0.0, 0.0, 1.0, -1.0, 0.0])
    assert solved(contacts, WEIGHT, corner) == pytest.approx(1.0, abs=1e-6)


def test_a_start_that_slides_is_seen_from_an_even_pressure() -> None:
    """On a tilted tray that is too steep the value is above 1 at standstill, and below where the motion helps."""
    contacts = single_block(SQUARE, 0.5)
    steep = np.array([0.6, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert solved(contacts, steep, np.zeros(6)) == pytest.approx(1.2, abs=1e-7)
    assert solved(contacts, steep, np.array([-0.3, 0.0, 0.0, 0.0, 0.0, 0.0])) == pytest.approx(0.6, abs=1e-7)


def test_what_does_not_press_down_is_never_held() -> None:
    upside_down = -WEIGHT
    assert solved(single_block(SQUARE, 0.5), upside_down, np.zeros(6)) > 1.0


def test_any_value_that_is_good_enough_will_do() -> None:
    contacts = single_block(SQUARE, 0.5)
    move = np.array([0.3, 0.0, 0.0, 0.0, 0.1, 0.05])
    exact = solved(contacts, WEIGHT, move)
    quick = gauge(contacts, WEIGHT[:, None], move[:, None], 0.9).value[0]
    assert exact - 1e-8 <= quick <= 0.9
    unmet = gauge(contacts, WEIGHT[:, None], move[:, None], 0.9 * exact).value[0]
    assert unmet == pytest.approx(exact, abs=3e-8)
