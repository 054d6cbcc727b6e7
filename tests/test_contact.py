"""Friction cones, wrench cones and contact systems against counts, linear programs and enumeration."""

from __future__ import annotations

import itertools
from typing import Any

import mechanics
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import G, bang_bang, plan_of, scene, waiter
from scipy.optimize import linprog

from robustopt.geometry import erode, rectangle, regular_polygon, rotation
from robustopt.limits.bodies import _skews
from robustopt.limits.cones import about_point, friction_edges, patch_facets, wrench_generators
from robustopt.limits.formulas import evaluate
from robustopt.limits.polygons import evaluate as exact_values
from robustopt.limits.polygons import facet_family
from robustopt.limits.systems import ContactSystem, carried, object_systems
from robustopt.solvers import build_problem
from robustopt.solvers.force_program import ForceProgram, missing_rows
from robustopt.solvers.plan import interval_ends
from robustopt.solvers.trajectory import binding_shares

SQUARE = rectangle(np.zeros(2), np.array([0.1, 0.1]))
PATCHES = {
    "square": SQUARE,
    "strip": rectangle(np.zeros(2), np.array([0.3, 0.001]), yaw=0.4),
    "triangle": regular_polygon(np.zeros(2), 0.05, 3, yaw=0.2),
    "octagon": regular_polygon(np.zeros(2), 0.03, 8),
    "skewed": np.array([[-0.02, -0.01], [0.04, -0.02], [0.05, 0.03], [-0.01, 0.02]]),
}


def flat(polygon: np.ndarray) -> np.ndarray:
    return np.column_stack([polygon, np.zeros(len(polygon))])


def reach(generators: np.ndarray, start: np.ndarray, direction: np.ndarray) -> float:
    """How far a ray from inside a cone of generators stays in it, by linear programming."""
    k = generators.shape[1]
    scale = 1.0 / np.abs(generators).max(axis=1)
    answer = linprog(
        np.r_[np.zeros(k), -1.0],
        A_eq=np.column_stack([generators, -direction]) * scale[:, None],
        b_eq=start * scale,
        bounds=[(0, None)] * (k + 1),
        method="highs",
    )
    return float(answer.x[-1]) if answer.status == 0 else np.inf


def lacking(generators: np.ndarray, reference: np.ndarray, wrench: np.ndarray) -> float:
    """The smallest t for which wrench + t reference lies in a cone of generators, by linear programming."""
    k = generators.shape[1]
    scale = 1.0 / np.abs(generators).max(axis=1)
    answer = linprog(
        np.r_[np.zeros(k), 1.0],
        A_eq=np.column_stack([generators, -reference]) * scale[:, None],
        b_eq=wrench * scale,
        bounds=[(0, None)] * k + [(None, None)],
        method="highs",
    )
    assert answer.status == 0
    return float(answer.x[-1])


def reach_by_facets(facets: np.ndarray, start: np.ndarray, direction: np.ndarray) -> float:
    rate = facets @ direction
    leaving = rate > 0
    return float(np.min(-(facets @ start)[leaving] / rate[leaving])) if leaving.any() else np.inf


# Friction cones and facets -------------------------------------------------------------------------------


def test_friction_edges_lie_on_the_cone_and_start_along_x() -> None:
    edges = friction_edges(0.3, 16)
    np.testing.assert_allclose(np.linalg.norm(edges[:, :2], axis=1), 0.3)
    np.testing.assert_allclose(edges[0], [0.3, 0.0, 1.0])
    np.testing.assert_allclose(edges[:, :2].sum(axis=0), 0.0, atol=1e-15)


def test_wrenches_move_between_points() -> None:
    rng = np.random.default_rng(0)
    force, arm, point = rng.normal(size=(3, 3))
    np.testing.assert_allclose(_skews(arm) @ force, np.cross(arm, force))
    about_origin = np.r_[force, np.cross(arm, force)]
    np.testing.assert_allclose(about_point(point) @ about_origin, np.r_[force, np.cross(arm - point, force)])


@pytest.mark.parametrize(("edges", "count"), [(8, 108), (16, 588)])
def test_a_square_patch_has_the_facets_a_double_description_code_finds(edges: int, count: int) -> None:
    """Facets of the cone of four corners, as a double-description code counts them."""
    assert len(patch_facets(SQUARE, 0.5, edges)) == count
    assert len(patch_facets(rectangle(np.zeros(2), np.array([0.3, 0.3])), 0.1, edges)) == count


def test_a_patch_whose_sides_are_along_the_friction_edges_has_the_known_sixteen_facets() -> None:
    """Caron, Pham and Nakamura (ICRA 2015) give 16 for a pyramid with its faces along the sides of the rectangle,
    which is a patch turned by 45 degrees here; with the edges along the sides there are 26."""
    assert len(patch_facets(SQUARE @ rotation(np.pi / 4).T, 0.5, 4)) == 16
    assert len(patch_facets(SQUARE, 0.5, 4)) == 26


def test_the_sixteen_facets_are_the_closed_form() -> None:
    """Caron, Pham and Nakamura (ICRA 2015), for half sides X, Y and the pyramid |f_x|, |f_y| <= m f_z, moments about
    the centre: friction, tipping, and torsion between tau_min and tau_max. Here in axes turned by 45 degrees."""
    X, mu = 0.05, 0.4
    m = mu / np.sqrt(2)
    turn = np.kron(
        np.eye(2),
        np.array([[np.cos(np.pi / 4), -np.sin(np.pi / 4), 0], [np.sin(np.pi / 4), np.cos(np.pi / 4), 0], [0, 0, 1]]),
    )
    facets = patch_facets(SQUARE @ rotation(np.pi / 4).T, mu, 4) @ turn
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(2000):
        w = np.r_[rng.uniform(-m, m, 2), 1.0, rng.uniform(-X, X, 2), rng.uniform(-2 * m * X, 2 * m * X)] * 1.1
        fx, fy, fz, tx, ty, tz = w
        holds = max(abs(fx), abs(fy)) <= m * fz and max(abs(tx), abs(ty)) <= X * fz
        lowest = -m * 2 * X * fz + abs(X * fx - m * tx) + abs(X * fy - m * ty)
        highest = m * 2 * X * fz - abs(X * fx + m * tx) - abs(X * fy + m * ty)
        holds = holds and lowest <= tz <= highest
        inside += holds
        assert (facets @ w).max() <= 0 if holds else (facets @ w).max() >= 0
    assert 200 < inside < 1800


@pytest.mark.parametrize("edges", [3, 4, 5, 8, 16])
@pytest.mark.parametrize("shape", PATCHES)
def test_facets_bound_the_cone_of_the_generators(shape: str, edges: int) -> None:
    """No generator is outside any facet, each facet is spanned by generators, and rays leave both cones together."""
    polygon, mu = PATCHES[shape] - PATCHES[shape].mean(axis=0), 0.6
    facets = patch_facets(polygon, mu, edges)
    generators = wrench_generators(flat(polygon), mu, edges)
    scale = np.array([mu, mu, 1.0, *2 * [np.abs(polygon).max()], mu * np.abs(polygon).max()])
    normals = facets * scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    products = normals @ (generators / scale[:, None])
    assert products.max() <= 1e-10
    assert ((np.abs(products) <= 1e-8).sum(axis=1) >= 5).all()
    assert len(facets) == len(np.unique(np.round(normals, 6), axis=0))
    np.testing.assert_allclose(facets[:, 2], -1.0)
    rng = np.random.default_rng(edges)
    start = generators.mean(axis=1)
    for _ in range(15):
        direction = rng.normal(size=6) * scale
        assert reach_by_facets(facets, start, direction) == pytest.approx(reach(generators, start, direction), rel=1e-6)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(mu=st.floats(1e-3, 10.0), size=st.floats(1e-3, 10.0))
def test_facets_scale_with_friction_and_size(mu: float, size: float) -> None:
    facets = patch_facets(SQUARE / 0.05 * size, mu, 8)
    unit = patch_facets(SQUARE / 0.05, 1.0, 8)
    np.testing.assert_allclose(facets * np.array([mu, mu, 1.0, size, size, mu * size]), unit, rtol=1e-9, atol=1e-9)


def test_more_friction_and_a_larger_patch_never_shrink_the_cone() -> None:
    small = wrench_generators(flat(SQUARE), 0.3, 16)
    assert (patch_facets(SQUARE, 0.4, 16) @ small).max() <= 1e-12
    assert (patch_facets(1.3 * SQUARE, 0.3, 16) @ small).max() <= 1e-12
    assert (patch_facets(SQUARE, 0.25, 16) @ small).max() > 0


def test_displaced_contact_points_still_transmit_what_the_eroded_patch_does() -> None:
    """Each corner anywhere in its square: the cone of the eroded patch lies in the cone of the displaced corners."""
    shift, yaw, rng = 0.004, 0.3, np.random.default_rng(3)
    for polygon in PATCHES.values():
        if np.abs(polygon).min(axis=0).min() < 2 * shift and len(erode(polygon, shift, yaw)) == 0:
            continue
        inner = wrench_generators(flat(erode(polygon, shift, yaw)), 0.5, 4)
        for _ in range(5):
            moves = shift * rng.choice([-1.0, 1.0, 0.3], size=polygon.shape) @ rotation(yaw).T
            outer = wrench_generators(flat(polygon + moves), 0.5, 4)
            start = outer.mean(axis=1)
            for wrench in inner.T:
                assert reach(outer, start, wrench - start) >= 1 - 1e-9


# Contact systems -----------------------------------------------------------------------------------------


def systems(objects: dict[str, Any], **sections: Any) -> dict[tuple[str, ...], ContactSystem]:
    config = scene(objects=objects, **sections)
    friction = dict.fromkeys(objects, 0.5)
    return {system.objects: system for system in object_systems(config, friction, {})}


def box(
    on: Any = "tray",
    at: tuple[float, float] = (0.0, 0.0),
    size: tuple[float, float, float] = (0.1, 0.1, 0.1),
    **more: Any,
) -> dict[str, Any]:
    return {
        "shape": "box",
        "size": list(size),
        "mass": 0.5,
        "on": list(on) if isinstance(on, tuple) else on,
        "at": list(at),
        **more,
    }


POSTS = {"left": box(at=(-0.1, 0.0)), "right": box(at=(0.1, 0.0))}
PLANK = box(("left", "right"), size=(0.3, 0.1, 0.02))


def test_every_object_of_a_stack_is_a_system_of_its_own() -> None:
    found = systems({"a": box(), "b": box("a"), "c": box("b"), "beside": box(at=(0.2, 0.2))})
    assert {key: system.loads for key, system in found.items()} == {
        ("a",): (("a", "b", "c"),),
        ("b",): (("b", "c"),),
        ("c",): (("c",),),
        ("beside",): (("beside",),),
    }
    assert found[("b",)].names == ("slip of b on a", "tipping of b over a")
    assert all(system.complete for system in found.values())


def test_two_objects_on_one_load_it_together() -> None:
    found = systems(
        {"base": box(size=(0.3, 0.1, 0.1)), "x": box("base", at=(-0.08, 0.0)), "y": box("base", at=(0.08, 0.0))}
    )
    assert found[("base",)].loads == (("base", "x", "y"),)


def test_a_bridge_and_its_supports_are_one_system() -> None:
    found = systems({**POSTS, "plank": PLANK})
    assert set(found) == {("left", "right", "plank")}
    system = found[("left", "right", "plank")]
    assert system.loads == (("left",), ("right",), ("plank",))
    assert not system.complete
    assert system.names == ("balance of plank on left and right",)
    assert system.generators.shape == (18, 4 * 4 * 16)  # four interfaces of four corners and 16 edges


def test_what_carries_a_whole_bridge_is_determinate() -> None:
    objects = {
        "base": box(size=(0.4, 0.2, 0.02)),
        "left": box("base", at=(-0.1, 0.0)),
        "right": box("base", at=(0.1, 0.0)),
        "plank": PLANK,
    }
    found = systems(objects)
    assert set(found) == {("base",), ("left", "right", "plank")}
    assert found[("base",)].loads == (("base", "left", "right", "plank"),)
    assert found[("base",)].complete


def test_objects_on_a_bridge_or_on_its_support_load_it() -> None:
    objects = {
        **POSTS,
        "left": box(at=(-0.1, 0.0), size=(0.1, 0.3, 0.1)),
        "plank": PLANK,
        "cup": box("plank", size=(0.04, 0.04, 0.1)),
        "lid": box("cup", size=(0.04, 0.04, 0.01)),
        "aside": box("left", at=(0.0, 0.1), size=(0.04, 0.04, 0.04)),
    }
    found = systems(objects)
    assert set(found) == {("left", "right", "plank"), ("cup",), ("lid",), ("aside",)}
    assert found[("left", "right", "plank")].loads == (("left", "aside"), ("right",), ("plank", "cup", "lid"))
    assert found[("cup",)].loads == (("cup", "lid"),)


def test_a_post_that_is_a_stack_belongs_to_the_bridge_whole() -> None:
    objects = {
        "foot": box(at=(-0.1, 0.0), size=(0.1, 0.1, 0.04)),
        "left": box("foot", size=(0.1, 0.1, 0.06)),
        "right": box(at=(0.1, 0.0)),
        "plank": PLANK,
    }
    found = systems(objects)
    assert set(found) == {("foot", "left", "right", "plank")}
    assert found[("foot", "left", "right", "plank")].loads == (("foot",), ("left",), ("right",), ("plank",))


def test_a_bridge_of_bridges_is_one_system() -> None:
    objects = {
        **{
            f"post{k}": box(at=(x, y), size=(0.04, 0.04, 0.1))
            for k, (x, y) in enumerate(itertools.product((-0.1, 0.1), (-0.1, 0.1)))
        },
        "front": box(("post0", "post2"), at=(0.0, -0.1), size=(0.3, 0.04, 0.02)),
        "back": box(("post1", "post3"), at=(0.0, 0.1), size=(0.3, 0.04, 0.02)),
        "roof": box(("front", "back"), size=(0.1, 0.3, 0.02)),
    }
    found = systems(objects)
    (group,) = found
    assert set(group) == set(objects)
    balances = ("front on post0 and post2", "back on post1 and post3", "roof on front and back")
    assert found[group].names == (" and ".join(f"balance of {balance}" for balance in balances),)


def test_separate_bridges_are_separate_systems() -> None:
    objects = {
        "a": box(at=(-0.1, -0.2)), "b": box(at=(0.1, -0.2)), "c": box(at=(-0.1, 0.2)), "d": box(at=(0.1, 0.2)),
        "first": box(("a", "b"), at=(0.0, -0.2), size=(0.3, 0.1, 0.02)),
        "second": box(("c", "d"), at=(0.0, 0.2), size=(0.3, 0.1, 0.02)),
    }  # fmt: skip
    assert set(systems(objects)) == {("a", "b", "first"), ("c", "d", "second")}


def test_carried_lists_all_above_in_the_order_of_the_file() -> None:
    config = scene(objects={"plank": PLANK, "cup": box("plank", size=(0.05, 0.05, 0.05)), **POSTS})
    assert carried(config, "left") == ("plank", "cup", "left")
    assert carried(config, "cup") == ("cup",)


def test_newton_holds_inside_a_system() -> None:
    """What the plank's supports exert on it they bear themselves: each interface adds up to nothing in the sum."""
    objects = {**POSTS, "plank": PLANK}
    system = systems(objects)[("left", "right", "plank")]
    total = system.generators.reshape(3, 6, -1).sum(axis=0)
    between = np.abs(system.generators[12:]).max(axis=0) > 0
    np.testing.assert_allclose(total[:, between], 0.0, atol=1e-15)
    assert (total[2, ~between] == 1.0).all()


def test_moments_about_another_point_describe_the_same_cone() -> None:
    system = systems({"a": box(at=(0.1, 0.05))})[("a",)]
    moved = system.about([np.array([0.3, -0.2, 0.4])])
    transform = about_point(np.array([0.3, -0.2, 0.4]))
    np.testing.assert_allclose(moved.generators, transform @ system.generators)
    assert moved.complete
    assert system.complete
    np.testing.assert_allclose(moved.facets @ transform, system.facets, atol=1e-12)
    assert (moved.facets @ moved.generators).max() <= 1e-10


def test_facets_are_named_after_what_would_happen() -> None:
    system = systems({"a": box(size=(0.1, 0.1, 0.2))})[("a",)]
    assert system.complete
    bottom = np.array([0.0, 0.0, 0.005])
    pushed = {
        "slip": np.r_[0.6, 0.0, 1.0, np.cross(bottom, [0.6, 0.0, 1.0])],
        "tipping": np.r_[0.0, 0.0, 1.0, 0.06, 0.0, 0.0],
        "torsion": np.r_[0.0, 0.0, 1.0, 0.0, 0.0, 0.06],
    }
    kinds = {what: int(system.kind_of(system.facets[[np.argmax(system.facets @ w)]])[0]) for what, w in pushed.items()}
    assert kinds == {"slip": 0, "tipping": 1, "torsion": 0}


# Inner programs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bridge", "two_blocks"])
def test_inner_programs_agree_with_another_linear_program(name: str) -> None:
    problem = build_problem(waiter(name, "solver.collocation_points=20", "contact.cone_edges=6"))
    rng = np.random.default_rng(0)
    for family in problem.limits.contacts:
        program = ForceProgram(family)
        generators, reference = family.system.generators, family.system.interior * family.weight
        missing = []
        for _ in range(25):
            u, x, point = rng.normal(scale=2.0), rng.uniform(0, 2), rng.integers(len(problem.s))
            wrench = family.wrench(np.array([point]), np.array([u]), np.array([x]))[0]
            t, dual = program.solve(wrench)
            assert t == pytest.approx(lacking(generators, reference, wrench), abs=1e-7)
            assert (dual @ generators * family.weight).max() <= 1e-7  # a valid row for every wrench of the cone
            assert dual @ reference == pytest.approx(-1.0, abs=1e-7)
            assert dual @ wrench == pytest.approx(t, abs=1e-9)
            missing.append(t > 0)
        assert 0 < sum(missing) < 25


def test_missing_rows_are_found_where_facets_are_violated_and_only_there() -> None:
    """The search for the worst parameters from the middle of the box alone, against all facets at their worst."""
    problem = build_problem(waiter("side_by_side", "solver.collocation_points=20", "contact.cone_edges=8"))
    rng = np.random.default_rng(1)
    points = rng.integers(len(problem.s), size=15)
    u, x = rng.normal(scale=6.0, size=15), rng.uniform(0, 3, 15)
    none, no_terms = np.zeros((0, 0, 3)), np.zeros((0, 0, 0))
    for family, facets in zip(problem.limits.contacts, problem.facets, strict=True):
        program, bare = ForceProgram(family), family.with_facets(facets[:0])
        worst = evaluate(facets, family.loads.at(points), none, no_terms, u, x).max(axis=1)
        assert (worst > 1e-3).any()
        for k in range(15):
            (rows, _), violation, _ = missing_rows(bare, program, points[[k]], u[[k]], x[[k]])
            assert (len(rows) > 0) == (worst[k] > 1e-7)
            assert (violation > 1e-7) == (worst[k] > 1e-7)
            assert len(rows) == 0 or (rows @ family.system.generators).max() <= 1e-6 * np.abs(rows).max()


@pytest.mark.parametrize("method", ["reachability", pytest.param("ipopt", marks=pytest.mark.slow)])
def test_a_bridge_with_intervals_holds_at_random_corners_of_the_box(method: str) -> None:
    """The search for the worst parameters of a system without facets, against draws by Newton and Euler."""
    uncertain = (
        "uncertainty={friction: {default: [0.4, 0.6], plank: [0.3, 0.5]}, mass: {plank: [0.3, 0.7], left: [0.3, 0.5]}, "
        "center_of_mass: {plank: [0.01, 0.03, 0.005], right: [0.005, 0.005, 0.02]}, contact_points: 0.003, "
        "joint_acceleration: {deviation: 0.3}}"
    )
    plan = plan_of(waiter("bridge", "solver.collocation_points=20", uncertain), method)
    problem, rng = plan.problem, np.random.default_rng(0)
    u, x, points = interval_ends(plan)
    (family,) = problem.limits.contacts
    reference, worst = family.system.interior * family.weight, -np.inf
    for draw in mechanics.random_draws(problem, 120, rng):
        k = rng.integers(len(points))
        motion = mechanics.tray_motion(problem, points[k], u[k], x[k], draw.error)
        parts = zip(family.system.loads, family.system.points, strict=True)
        wrench = [mechanics.required_wrench(problem.config, names, draw, motion, about) for names, about in parts]
        worst = max(worst, lacking(family.system.generators, reference, np.concatenate(wrench)))
    assert -0.2 < worst <= 1e-6


@pytest.mark.parametrize("method", ["reachability", pytest.param("ipopt", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["two_blocks", pytest.param("side_by_side", marks=pytest.mark.slow)])
def test_facets_and_inner_programs_lead_to_the_same_plan(
    name: str, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With five kinds of intervals: all facets at their worst at once, or the worst parameters searched per program."""
    names = {"two_blocks": ("lower", "upper"), "side_by_side": ("crate", "bottle")}[name]
    uncertain = (
        "uncertainty={contact_points: 0.002, joint_acceleration: {deviation: 0.2}, friction: [0.3, 0.5], "
        f"mass: {{{names[0]}: [0.4, 1.3]}}, center_of_mass: {{{names[1]}: [0.003, 0.003, 0.01]}}}}"
    )
    config = waiter(name, "solver.collocation_points=40", "contact.friction=0.4", uncertain)
    by_facets = plan_of(config, "reachability")
    assert all(family.system.complete for family in by_facets.problem.limits.contacts)
    monkeypatch.setattr("robustopt.limits.cones.MOST_GENERATORS", 0)
    by_programs = plan_of(config, method)
    assert all(not family.system.complete for family in by_programs.problem.limits.contacts)
    assert by_programs.statistics["inner_programs"] > 0
    assert by_programs.duration == pytest.approx(by_facets.duration, rel=1e-6)


@pytest.mark.parametrize(("points", "edges"), [(16, 16), (32, 16), (8, 64)])
def test_patches_of_many_corners_tip_like_others(points: int, edges: int) -> None:
    """More generators than facets are made for: the first corner is along x, a radius from the centre."""
    can = {"shape": "cylinder", "radius": 0.03, "height": 0.4, "mass": 1.0}
    contact = {"friction": 2.0, "patch_points": points, "cone_edges": edges}
    plan = plan_of(scene(objects={"can": can}, contact=contact))
    assert not plan.problem.limits.contacts[0].system.complete
    assert plan.duration == pytest.approx(bang_bang(1.0, G * 0.03 / 0.2), rel=1e-7)


def test_turning_over_one_corner_is_tipping_and_pivoting_about_it_is_slip() -> None:
    """Rows as the power of a motion: about a horizontal line through a corner, and with a turn about the vertical."""
    can = {"shape": "cylinder", "radius": 0.03, "height": 0.1, "mass": 1.0}
    system = systems({"can": can})[("can",)]
    corner = np.array([0.03, 0.0, 0.005])
    tipping = np.r_[-np.cross([0.0, 1.0, 0.0], corner), [0.0, 1.0, 0.0]]
    powers = (tipping @ system.generators).reshape(8, 16)
    assert np.abs(powers[0]).max() <= 1e-15  # the corner stays
    assert powers[1:].min() > 0 or powers[1:].max() < 0  # and all others move one way
    assert system.complete
    kinds = system.kind_of(np.vstack([tipping, system.facets]))
    assert kinds[0] == 1
    assert kinds[1:].sum() == 8  # over each side of the octagon
    flat = np.abs(system.facets @ system.generators).reshape(-1, 8, 16) <= 1e-9
    pivoting = flat.all(axis=2).sum(axis=1) == 1
    assert pivoting.any()
    assert not kinds[1:][pivoting].any()


WIDE = (
    "uncertainty={contact_points: 0.002176, joint_acceleration: {deviation: 0.5711566}, friction: [0.244, 0.305], "
    "mass: {crate: [0.8606, 1.7291], bottle: [0.66544, 1.15271]}, "
    "center_of_mass: {crate: [0.006116, 0.0046, 0.00908], bottle: [0.0083, 0.001774, 0.029]}}"
)


@pytest.mark.parametrize("with_facets", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_no_facet_is_overlooked_where_another_dual_and_its_worst_parameters_agree(
    with_facets: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alternating between duals and parameters from one start left a facet violated by 7 % of the weight here."""
    config = waiter("side_by_side", "solver.collocation_points=40", "contact.friction=0.305", WIDE)
    families = build_problem(config).limits.contacts
    if not with_facets:
        monkeypatch.setattr("robustopt.limits.cones.MOST_GENERATORS", 0)
    plan = plan_of(config, "ipopt")
    u, x, points = interval_ends(plan)
    for family in families:
        assert family.system.complete
        rows = family.system.facets / family.weight
        assert exact_values(facet_family(rows, family.loads, np.arange(len(rows))), points, u, x).max() <= 1e-6


def test_like_facets_are_neighbours() -> None:
    """Blocks of 16 reach far less around than as many facets at random, which is all that their order is for."""
    facets = patch_facets(SQUARE / 0.05, 1.0, 16)
    reach = [
        np.mean([np.ptp(rows[k : k + 16], axis=0).sum() for k in range(0, len(rows), 16)])
        for rows in (facets, facets[np.random.default_rng(0).permutation(len(facets))])
    ]
    assert reach[0] < 0.5 * reach[1]


@pytest.mark.parametrize(
    "uncertainty", [{}, {"contact_points": 0.002}, {"center_of_mass": {"mug": [0.002, 0.002, 0.01]}}]
)
@pytest.mark.parametrize("points", [8, 16])
@pytest.mark.parametrize("method", ["reachability", "ipopt"])
def test_a_cylinder_that_tips_over_a_point_of_its_rim_tips(method: str, points: int, uncertainty: dict) -> None:
    """It may also turn about the point, which bounds it as much: friction was named, although it does not matter."""
    mug = {"shape": "cylinder", "radius": 0.03, "height": 0.16, "mass": 0.5}
    durations = []
    for mu in (0.9, 5.0):
        config = scene(
            objects={"mug": mug}, contact={"friction": mu, "patch_points": points}, uncertainty=uncertainty,
            solver={"collocation_points": 40}, robot_keys={"limits": {"x": {"acceleration": 50.0}}},
        )  # fmt: skip
        plan = plan_of(config, method)
        durations.append(plan.duration)
        assert binding_shares(plan) == {"tipping of mug over tray": pytest.approx(1.0)}
    assert durations[0] == pytest.approx(durations[1], rel=1e-6)
    if not uncertainty:
        assert durations[0] == pytest.approx(bang_bang(1.0, G * 0.03 / 0.08), rel=1e-6)
