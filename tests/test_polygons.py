"""Feasible polygons against brute force: dense samples of (u, x), and every corner of the parameter box."""

from __future__ import annotations

import importlib
import sys
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import mechanics
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import waiter

from robustopt.limits import TimeScalingProblem
from robustopt.limits.cones import patch_facets
from robustopt.limits.formulas import evaluate
from robustopt.limits.polygons import (
    ALONG_PATH,
    MAX_VERTICES,
    NO_NAME,
    ROOM,
    Family,
    Polygons,
    RequiredWrench,
    cut,
    cut_affine,
    edge_rows,
    facet_family,
    start,
)
from robustopt.limits.polygons import evaluate as polygons_evaluate
from robustopt.limits.uncertainty import uncertainty_of
from robustopt.scene.patches import patches
from robustopt.solvers import build_problem

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
KINDS = ("friction", "joint_acceleration", "contact_points", "center_of_mass", "mass")
NONE, NO_TERMS = np.zeros((0, 0, 3)), np.zeros((0, 0, 0))


def rectangles(count: int, u_bound: float = 2.0, x_max: float = 3.0) -> Polygons:
    return start(np.full(count, u_bound), np.full(count, x_max), np.zeros(count, dtype=np.int64))


def inside(polygons: Polygons, i: int, u: np.ndarray, x: np.ndarray) -> np.ndarray:
    """How far points lie inside a polygon by its vertices alone, negative outside."""
    vertices = polygons.vertices[i, : polygons.sizes[i]]
    if not len(vertices):
        return np.full(u.shape, -np.inf)
    after = np.roll(vertices, -1, axis=0)
    edge = after - vertices
    length = np.linalg.norm(edge, axis=1)
    keep = length > 1e-9
    left = edge[keep, 0] * (x[:, None] - vertices[keep, 1]) - edge[keep, 1] * (u[:, None] - vertices[keep, 0])
    return np.asarray((left / length[keep]).min(axis=1))


def random_loads(
    rng: np.random.Generator, points: int, groups: int, terms: int, constant: int, bodies: int, errors: int = 0
) -> RequiredWrench:
    """Required wrenches that hold at (0, small x): a weight along the last axis, all else small beside it.

    With acceleration errors, the first groups * errors constants are theirs.
    """
    d = 6
    constant += groups * errors
    constant_group = rng.integers(groups, size=constant)
    constant_group[: groups * errors] = np.repeat(np.arange(groups), errors)
    nominal = rng.normal(size=(points, d, groups, 3))
    nominal[:, :, :, 2] *= 0.1
    nominal[:, 5, :, 2] += 3.0
    return RequiredWrench(
        nominal=nominal,
        terms=0.2 * rng.normal(size=(points, d, terms, 3)),
        group=rng.integers(groups, size=terms),
        moments=0.05 * rng.normal(size=(points, d, 6 * bodies, 3)),
        moment_group=rng.integers(groups, size=bodies),
        usual=0.3 * rng.random(6 * bodies),
        round=rng.random(bodies) < 0.5,
        constant=0.1 * rng.normal(size=(points, d, constant)),
        constant_group=constant_group,
        products=0.05 * rng.normal(size=(points, d, terms + 6 * bodies, errors)),
        lowest=rng.uniform(0.5, 1.0, groups),
        highest=rng.uniform(1.0, 1.5, groups),
    )


# Cutting -------------------------------------------------------------------------------------------------


def test_a_polygon_starts_as_its_rectangle() -> None:
    polygons = start(np.array([2.0]), np.array([3.0]), np.array([4]))
    np.testing.assert_allclose(polygons.vertices[0, :4], [[-2, 0], [2, 0], [2, 3], [-2, 3]])
    assert polygons.names[0, :4].tolist() == [NO_NAME, NO_NAME, 4, NO_NAME]
    for k in range(4):
        ends = polygons.vertices[0, [k, (k + 1) % 4]]
        np.testing.assert_allclose(ends @ polygons.rows[0, k, :2] + polygons.rows[0, k, 2], 0.0)


def test_affine_cuts_keep_what_satisfies_all_rows() -> None:
    rng = np.random.default_rng(0)
    polygons, rows = rectangles(30), rng.normal(size=(30, 12, 3))
    rows[:, :, 2] -= 1.0
    polygons = cut_affine(polygons, rows, np.arange(12) + 1)
    u, x = rng.uniform(-2, 2, 4000), rng.uniform(0, 3, 4000)
    for i in range(30):
        values = rows[i] @ np.stack([u, x, np.ones_like(u)])
        holds = values.max(axis=0) <= 0
        depth = inside(polygons, i, u, x)
        assert (holds == (depth >= 0))[np.abs(depth) > 1e-9].all()
        assert holds.any() == (polygons.sizes[i] > 0)


def test_an_empty_polygon_stays_empty() -> None:
    polygons = rectangles(2)
    rows = np.array([[[0.0, 0.0, 1.0], [1.0, 0.0, -1.0]], [[0.0, 1.0, -1.0], [1.0, 0.0, -1.0]]])
    polygons = cut_affine(polygons, rows, np.array([1, 2]))
    assert polygons.sizes.tolist() == [0, 4]
    polygons = cut_affine(polygons, np.array([[[1.0, 0.0, -0.5]]] * 2), np.array([3]))
    assert polygons.sizes.tolist() == [0, 4]


def test_cutting_leaves_the_polygons_it_was_given() -> None:
    polygons = rectangles(1)
    half = cut_affine(polygons, np.array([[[1.0, 0.0, 0.0]]]), np.array([1]))
    assert polygons.vertices[0, 1, 0] == 2.0
    assert half.sizes[0] == 4
    assert half.vertices[0, : half.sizes[0], 0].max() == 0.0


def test_polygons_get_as_much_room_as_they_need() -> None:
    """Tangents of a circle: a polygon of as many edges as rows, beyond the room that is there at first."""
    angle = np.linspace(0, 2 * np.pi, 2 * ROOM, endpoint=False)
    rows = np.stack([np.cos(angle), np.sin(angle), -1.0 - np.sin(angle) * 1.5], axis=1)[None]
    assert cut_affine(rectangles(1), rows, np.arange(2 * ROOM)).sizes.tolist() == [2 * ROOM]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    groups=st.integers(1, 3),
    terms=st.integers(0, 4),
    constant=st.integers(0, 3),
    bodies=st.integers(0, 2),
    own=st.booleans(),
)
def test_family_cuts_keep_what_holds_for_the_worst_parameters(
    seed: int, groups: int, terms: int, constant: int, bodies: int, own: bool
) -> None:
    """Inside the polygon exactly where the row family, written out in numpy, holds."""
    rng = np.random.default_rng(seed)
    points, F = 4, 25
    loads = random_loads(rng, points, groups, terms, constant, bodies)
    B = rng.normal(size=(points, F, 6) if own else (F, 6))
    B[..., 5] = -1.0
    base = 0.2 * rng.normal(size=(points, F, 3)) if own else NONE
    base_terms = 0.05 * rng.normal(size=(points, F, constant)) if own else NO_TERMS
    polygons = rectangles(points)
    polygons = cut(polygons, Family(B if own else B[None], loads, base, base_terms, np.arange(F) + 1))
    u, x = rng.uniform(-2, 2, 500), rng.uniform(0, 3, 500)
    for i in range(points):
        at = np.full(500, i)
        values = evaluate(
            B[at] if own else B, loads.at(at), base[at] if own else NONE, base_terms[at] if own else NO_TERMS, u, x
        )
        holds = values.max(axis=1) <= 0
        depth = inside(polygons, i, u, x)
        assert (holds == (depth >= 0))[np.abs(depth) > 1e-7].all()


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), groups=st.integers(1, 2), terms=st.integers(0, 3), constant=st.integers(0, 2))
def test_family_cuts_are_exact_against_every_corner_of_the_box(
    seed: int, groups: int, terms: int, constant: int
) -> None:
    """Masses, interval terms and errors enter linearly, each group by itself: their corners decide, and all count."""
    rng = np.random.default_rng(seed)
    F = 12
    loads = random_loads(rng, 1, groups, terms, constant, 0)
    B = rng.normal(size=(F, 6))
    B[:, 5] = -1.0
    polygons = rectangles(1)
    polygons = cut(polygons, facet_family(B, loads, np.arange(F) + 1))
    u, x = rng.uniform(-2, 2, 400), rng.uniform(0, 3, 400)
    point = np.stack([u, x, np.ones_like(u)])
    worst = np.full(400, -np.inf)
    for masses in product(*zip(loads.lowest, loads.highest, strict=True)):
        for signs in product((-1.0, 1.0), repeat=terms + constant):
            load = np.zeros((6, 400))
            for g in range(groups):
                part = loads.nominal[0, :, g] @ point
                part += np.einsum("dnk,km,n->dm", loads.terms[0], point, np.where(loads.group == g, signs[:terms], 0.0))
                part += (loads.constant[0] @ np.where(loads.constant_group == g, signs[terms:], 0.0))[:, None]
                load += masses[g] * part
            worst = np.maximum(worst, (B @ load).max(axis=0))
    depth = inside(polygons, 0, u, x)
    assert ((worst <= 0) == (depth >= 0))[np.abs(depth) > 1e-7].all()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), groups=st.integers(1, 2), terms=st.integers(0, 2), bodies=st.integers(0, 1))
def test_rows_are_exact_if_everything_depends_on_the_acceleration_error(
    seed: int, groups: int, terms: int, bodies: int
) -> None:
    """Every corner of the error and of the terms and masses, and the extreme second moments, written out in numpy."""
    rng, errors = np.random.default_rng(seed), 3
    loads = random_loads(rng, 1, groups, terms, 1, bodies, errors)
    B = rng.normal(size=(8, 6))
    B[:, 5] = -1.0
    family = facet_family(B, loads, np.arange(8) + 1)
    u, x = rng.uniform(-2, 2, 40), rng.uniform(0, 3, 40)
    found = polygons_evaluate(family, np.zeros(40, dtype=np.int64), u, x)
    point = np.stack([u, x, np.ones(40)])
    largest = np.full((40, 8), -np.inf)
    for error in product((-1.0, 1.0), repeat=errors):
        total = np.zeros((40, 8))
        for g in range(groups):
            part = loads.nominal[0, :, g] @ point
            part += (loads.constant[0, :, g * errors : (g + 1) * errors] @ np.array(error))[:, None]
            value = (B @ part).T
            for k in np.flatnonzero(loads.group == g):
                value += np.abs(B @ (loads.terms[0, :, k] @ point + (loads.products[0, :, k] @ error)[:, None])).T
            value += sum(np.abs(B @ loads.constant[0, :, -1]) for _ in range(1) if loads.constant_group[-1] == g)
            for m in np.flatnonzero(loads.moment_group == g):
                six = range(6 * m, 6 * m + 6)
                y = [
                    B @ (loads.moments[0, :, q] @ point + (loads.products[0, :, terms + q] @ error)[:, None])
                    for q in six
                ]
                value += largest_moment(np.array(y), loads.usual[6 * m : 6 * m + 6], bool(loads.round[m])).T
            total += np.where(value > 0, loads.highest[g], loads.lowest[g]) * value
        largest = np.maximum(largest, total)
    np.testing.assert_allclose(found, largest, rtol=1e-9, atol=1e-9)
    bound = evaluate(B, loads.at(np.zeros(40, dtype=np.int64)), NONE, NO_TERMS, u, x)
    assert (bound >= found - 1e-9).all()
    # Polygons are cut a little deeper than the rows, by a share of their terms.
    polygons = cut(rectangles(1), family)
    depth, worst = inside(polygons, 0, u, x), largest.max(axis=1)
    assert (worst[depth >= 0] <= 1e-9).all()
    assert (worst[depth < -1e-3] > -0.02).all()


def largest_moment(y: np.ndarray, usual: np.ndarray, is_round: bool) -> np.ndarray:
    """Largest y T over the vertices of the set of second moments, less y times the usual ones."""
    found = []
    for squares in product((0.0, 1.0), repeat=3):
        if is_round and squares[0] + squares[1] > 1.0:
            continue
        pairs = [0.5 * (squares[a] + squares[b]) for a, b in ((0, 1), (0, 2), (1, 2))]
        for signs in product((-1.0, 1.0), repeat=3):
            T = np.r_[squares, np.array(signs) * pairs]
            found.append(np.tensordot(T - usual, y, axes=1))
    return np.asarray(np.max(found, axis=0))


@pytest.mark.parametrize(("terms", "constant", "bodies"), [(0, 0, 0), (2, 3, 2)])
def test_neither_order_nor_blocks_of_facets_change_a_polygon(terms: int, constant: int, bodies: int) -> None:
    """All facets of a friction cone at once, in their order and at random, and in parts of less than a block."""
    rng = np.random.default_rng(3)
    loads = random_loads(rng, 12, 2, terms, constant, bodies)
    loads = loads._replace(**{n: np.roll(getattr(loads, n), 3, axis=1) for n in ALONG_PATH})
    facets = patch_facets(np.array([[-0.6, -0.4], [0.6, -0.4], [0.6, 0.4], [-0.6, 0.4]]), 0.5, 16)
    shuffled = facets[rng.permutation(len(facets))]
    whole = [cut(rectangles(12), facet_family(B, loads, np.arange(len(B)) + 1)) for B in (facets, shuffled)]
    parts = rectangles(12)
    for k in range(0, len(facets), 10):
        part = facets[k : k + 10]
        parts = cut(parts, facet_family(part, loads, np.arange(len(part)) + 1))
    u, x = rng.uniform(-2, 2, 500), rng.uniform(0, 3, 500)
    assert max(polygons.sizes.max() for polygons in whole) > 4
    for i in range(12):
        first, *others = (inside(polygons, i, u, x) for polygons in (*whole, parts))
        for depth in others:
            np.testing.assert_allclose(depth[first > 0], first[first > 0], atol=1e-8)
            assert (depth[first <= 0] <= 1e-8).all()


def test_the_edges_of_a_polygon_are_the_rows_that_are_not_redundant() -> None:
    rng = np.random.default_rng(5)
    loads = random_loads(rng, 5, 2, 3, 2, 2)
    B = rng.normal(size=(40, 6))
    B[:, 5] = -1.0
    polygons = rectangles(5)
    polygons = cut(polygons, facet_family(B, loads, np.arange(40) + 1))
    for i in range(5):
        n = polygons.sizes[i]
        assert 3 <= n <= MAX_VERTICES
        for k in range(n):
            ends = polygons.vertices[i, [k, (k + 1) % n]]
            np.testing.assert_allclose(ends @ polygons.rows[i, k, :2] + polygons.rows[i, k, 2], 0.0, atol=1e-9)
            if polygons.names[i, k] > 0:  # the affine piece is the family's value in the middle of its edge
                u, x = ends.mean(axis=0)
                value = evaluate(
                    B[[polygons.names[i, k] - 1]], loads.at(np.array([i])), NONE, NO_TERMS, u[None], x[None]
                )
                assert abs(value[0, 0]) <= 1e-9


def test_a_polygon_of_one_point_keeps_the_rows_that_make_it_one() -> None:
    point = np.array([[[1.0, 0, 0], [-1, 0, 0], [0, 1, -0.5], [0, -1, 0.5]]])
    polygons = cut_affine(rectangles(1), point, np.array([1, 2, 3, 4]))
    rows, names = edge_rows(polygons, 1, 5)
    np.testing.assert_allclose(polygons.vertices[0, : polygons.sizes[0]], [[0, 0.5]] * polygons.sizes[0], atol=1e-12)
    others = np.array([[0.1, 0.5], [-0.1, 0.5], [0, 0.6], [0, 0.4]])
    values = rows[0, :, :2] @ others.T + rows[0, :, 2:]
    assert sorted(names) == [1, 2, 3, 4]
    assert (values.max(axis=0) >= 0.1 - 1e-12).all()


# Problems ------------------------------------------------------------------------------------------------

SMALL_BOX = (
    "uncertainty={friction: [0.3, 0.6], mass: {upper: [0.4, 0.7], lower: [0.5, 0.6]}, "
    "joint_acceleration: {mean: 0.05, deviation: [0.4, 0, 0.3, 0, 0.5, 0]}}"
)
FULL_BOX = (
    "uncertainty={friction: [0.3, 0.6], mass: {upper: [0.4, 0.7]}, contact_points: 0.003, "
    "center_of_mass: {upper: [0.004, 0.004, 0.01], lower: [0.004, 0.004, 0.01]}, joint_acceleration: {deviation: 0.3}}"
)
FEW = ("solver.collocation_points=12", "contact.cone_edges=6")


@cache
def robust_problem(uncertainty: str) -> TimeScalingProblem:
    return build_problem(waiter("two_blocks", *FEW, uncertainty))


def worst_contact(
    problem: TimeScalingProblem, point: int, u: float, x: float, draws: list[mechanics.Draw], moves: list[np.ndarray]
) -> float:
    """Largest facet value of any interface over draws and displacements of its corners, as a fraction of the weight."""
    config, worst = problem.config, -np.inf
    lowest = uncertainty_of(config, problem.robot.n, problem.robot.base).worst_friction
    for draw, move in zip(draws, moves, strict=True):
        motion = mechanics.tray_motion(problem, point, u, x, draw.error)
        for patch in patches(config):
            corners = patch.polygon + move
            centre = np.append(corners.mean(axis=0), patch.origin[2])
            facets = patch_facets(corners - centre[:2], lowest[patch.object], config.contact.cone_edges)
            names = [patch.object] if patch.object == "upper" else ["lower", "upper"]
            wrench = mechanics.required_wrench(config, names, draw, motion, centre)
            worst = max(worst, float((facets @ wrench).max()) / (len(names) * 0.5 * 9.81))
    return worst


def contact_depth(problem: TimeScalingProblem, point: int, u: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Largest contact row of a grid point at (u, x)."""
    named = [name.startswith(("slip", "tipping")) for name in problem.row_names]
    a, b, c = (rows[point, named] for rows in (problem.a, problem.b, problem.c))
    return np.asarray((a * u[:, None] + b * x[:, None] + c).max(axis=1))


def test_contact_rows_of_a_problem_are_exact_for_masses_and_acceleration_errors() -> None:
    """Every corner by Newton and Euler. Errors common to bodies of uncertain mass are counted per body: within 2 %."""
    problem = robust_problem(SMALL_BOX).only(
        [name for name in robust_problem(SMALL_BOX).limits.names if name.startswith(("slip", "tipping"))]
    )
    draws = list(mechanics.corners(problem))
    assert len(draws) == 32
    rng, on_both_sides = np.random.default_rng(0), [0, 0]
    for point in (2, 7):
        u, x = rng.uniform(-1.2, 1.2, 12), rng.uniform(0, 0.3, 12)
        rows = contact_depth(problem, point, u, x)
        for k in range(12):
            worst = worst_contact(problem, point, u[k], x[k], draws, [np.zeros(2)] * len(draws))
            if abs(worst) > 0.02:
                assert (rows[k] <= 0) == (worst <= 0), (worst, rows[k])
                on_both_sides[int(worst > 0)] += 1
            assert worst <= 1e-6 or rows[k] > 0
    assert min(on_both_sides) >= 5


def test_rows_of_a_problem_hold_for_every_draw_inside_them() -> None:
    """All five kinds of uncertainty: what the rows allow, no draw of the parameters forbids."""
    problem = robust_problem(FULL_BOX)
    rng, tried = np.random.default_rng(1), 0
    for point in (2, 5, 7):
        u, x = rng.uniform(-0.8, 0.8, 25), rng.uniform(0, 0.2, 25)
        values = problem.a[point] * u[:, None] + problem.b[point] * x[:, None] + problem.c[point]
        for k in np.flatnonzero(values.max(axis=1) <= 0):
            draws = list(mechanics.random_draws(problem, 6, rng))
            moves = [0.003 * rng.choice([-1.0, -0.5, 1.0], size=(4, 2)) for _ in draws]
            assert worst_contact(problem, point, u[k], x[k], draws, moves) <= 1e-6
            tried += 1
    assert tried >= 10


# Tightness -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def experiment() -> Any:
    """The script that measures how tight the bounds are."""
    sys.path.insert(0, str(EXPERIMENTS))
    try:
        yield importlib.import_module("bound_tightness")
    finally:
        sys.path.remove(str(EXPERIMENTS))


@pytest.mark.parametrize(
    ("task", "kinds", "loss"),
    [
        ("two_blocks", ("friction",), 1e-3),
        ("two_blocks", ("joint_acceleration",), 1e-3),
        ("two_blocks", ("mass",), 1e-3),
        ("two_blocks", ("center_of_mass",), 0.1),
        ("two_blocks", ("contact_points",), 0.1),
        ("heavy", ("joint_acceleration",), 1e-3),
        ("heavy", ("center_of_mass", "mass"), 0.1),
        pytest.param("heavy", ("joint_acceleration", "center_of_mass", "mass"), 0.5, marks=pytest.mark.slow),
        pytest.param("side_by_side", ("contact_points",), 0.1, marks=pytest.mark.slow),
        pytest.param("side_by_side", ("center_of_mass",), 0.1, marks=pytest.mark.slow),
        pytest.param("side_by_side", ("joint_acceleration", "mass"), 0.1, marks=pytest.mark.slow),
        pytest.param("two_blocks", KINDS, 3.0, marks=pytest.mark.slow),
        pytest.param("side_by_side", KINDS, 3.0, marks=pytest.mark.slow),
    ],
)
def test_bounds_cost_little_more_than_the_worst_parameters_found(
    experiment: Any, task: str, kinds: tuple[str, ...], loss: float
) -> None:
    """Loss of duration in per cent against the fastest timing for all worst cases that a search finds.

    Acceleration error times displacement of a centre of mass is bounded term by term, which costs most.
    """
    found = experiment.record(task, kinds, 25)
    assert found["rows"] > 0
    assert -1e-6 <= found["loss"] <= loss


def test_the_search_for_the_worst_parameters_is_as_good_as_enumeration(experiment: Any) -> None:
    """Masses and errors of two joints: all corners of the box against the search, at random points of the path."""
    worst = importlib.import_module("worst_parameters")
    problem = robust_problem(SMALL_BOX)
    rng = np.random.default_rng(0)
    box = worst.box_of(problem.config, problem.robot.n)
    corners = np.array(list(product(*[(-1.0, 1.0) if free else (0.0,) for free in box.free])))
    assert len(corners) == 32
    points, u, x = np.array([2, 5, 7]), rng.uniform(-1.0, 1.0, 3), rng.uniform(0.0, 0.2, 3)
    for item in worst.interfaces(problem, box, rng):
        found, facet, z = worst.worst_draws(problem, box, item, points, u, x, rng)
        for k in range(3):
            at = np.full(len(corners), points[k])
            rates = worst.coefficients(problem, box, item, at, corners)
            every = rates @ np.array([u[k], x[k], 1.0]) @ item.facets.T
            assert found[k] == pytest.approx(every.max(), rel=1e-9)
            own = worst.coefficients(problem, box, item, points[[k]], z[[k]])[0] @ np.array([u[k], x[k], 1.0])
            assert item.facets[facet[k]] @ own == pytest.approx(found[k], rel=1e-9)


def test_the_wrenches_of_the_search_are_those_of_newton_and_euler(experiment: Any) -> None:
    worst = importlib.import_module("worst_parameters")
    problem = robust_problem(FULL_BOX)
    rng = np.random.default_rng(1)
    box = worst.box_of(problem.config, problem.robot.n)
    for item, names in zip(worst.interfaces(problem, box, rng), (["lower", "upper"], ["upper"]), strict=True):
        z = np.where(box.free, rng.uniform(-1.0, 1.0, box.size), 0.0)
        n = len(box.names)
        shift = {name: z[n + 3 * k : n + 3 * k + 3] * [0.004, 0.004, 0.01] for k, name in enumerate(box.names) if k}
        upper = 0.55 + 0.15 * z[box.names.index("upper")]
        draw = mechanics.Draw({"upper": upper / 0.5}, shift, box.error(z[None])[0])
        motion = mechanics.tray_motion(problem, 4, 0.7, 0.1, draw.error)
        expected = mechanics.required_wrench(problem.config, names, draw, motion, np.zeros(3))
        found = worst.coefficients(problem, box, item, np.array([4]), z[None])[0] @ np.array([0.7, 0.1, 1.0])
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
