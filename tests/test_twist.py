"""Wrenches that cups, grips and blocks transmit under free and prescribed pressure, against linear programs."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from held import FAR, cup, edge_wrenches, friction_edges, grip, holding, largest_step, step_by_rows, system_of
from scenes import plan_of, scene
from scipy.spatial.transform import Rotation

from robustopt.certificate.certify import certify
from robustopt.config import Config
from robustopt.errors import ConfigError
from robustopt.limits.systems import TWIST, object_systems
from robustopt.limits.twist import MOST_ROWS, affordable_edges, elastic_rows, grip_rows
from robustopt.solvers import build_problem

F, MU, R = 50.0, 0.7, 0.05


def lip_points(count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return R * np.column_stack([np.cos(angle), np.sin(angle)])


def with_force(wrench: np.ndarray, force: float = F) -> np.ndarray:
    return np.r_[wrench, force]


def directions(count: int, seed: int) -> np.ndarray:
    """Random wrenches (count, 6) of about 1 N and as many N times a radius, some in a single plane."""
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(count, 6)) * np.array([1.0, 1.0, 1.0, R, R, R])
    found[: count // 3] *= rng.integers(2, size=(count // 3, 6))
    return found[np.abs(found).max(axis=1) > 0]


def flat(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


# Free pressure --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("edges", [4, 16])
@pytest.mark.parametrize("points", [4, 8])
def test_the_rows_of_a_free_cup_are_the_wrenches_of_its_lip_and_its_vacuum(points: int, edges: int) -> None:
    system = system_of(holding(cup(R, F, pressure="free"), mu=MU, edges=edges, points=points))
    lip = edge_wrenches(flat(lip_points(points)), np.eye(3), MU, edges)
    vacuum = np.array([0.0, 0.0, -F, 0.0, 0.0, 0.0])
    assert system.complete
    assert not system.bounds_twist
    for step in directions(60, seed=points + edges):
        exact = largest_step(lip, -vacuum, step)
        assert step_by_rows(system.facets, with_force(np.zeros(6)), with_force(step, 0.0)) == pytest.approx(
            exact, rel=1e-9
        )


def test_a_cup_at_any_place_and_angle_has_the_same_wrenches_in_its_own_frame() -> None:
    pose = {"position": [0.3, -0.2, 0.1], "rpy": [0.4, -0.3, 0.8]}
    rows = [system_of(holding(cup(R, F, **keys), mu=MU, edges=8, points=5)).facets for keys in ({}, {"pose": pose})]
    turn, place = Rotation.from_euler("xyz", pose["rpy"]).as_matrix(), np.array(pose["position"])
    for step in directions(20, seed=1):
        force, moment = turn @ step[:3], turn @ step[3:]
        moved = np.r_[force, moment + np.cross(place, force)]
        lengths = [
            step_by_rows(own, with_force(np.zeros(6)), with_force(wrench, 0.0))
            for own, wrench in zip(rows, (step, moved), strict=True)
        ]
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-9)


# Prescribed pressure of a cup -----------------------------------------------------------------------------


def elastic(points: np.ndarray) -> np.ndarray:
    """Normal force of each point of a lip by least squares, per (normal force, m_x, m_y), (n, 3)."""
    lever = np.column_stack([np.ones(len(points)), points[:, 1], -points[:, 0]])
    return lever @ np.linalg.inv(lever.T @ lever)


def prescribed(points: np.ndarray, edges: int, mu: np.ndarray) -> np.ndarray:
    """Columns of a program: (f_x, f_y, m_z) of forces along friction edges, and the normal force of every point."""
    n = len(points)
    columns = np.zeros((3 + n, n * edges))
    for i, (point, own) in enumerate(zip(points, mu, strict=True)):
        for e, (fx, fy) in enumerate(friction_edges(own, edges)):
            columns[:3, i * edges + e] = fx, fy, point[0] * fy - point[1] * fx
            columns[3 + i, i * edges + e] = 1.0
    return columns


def supplied(normals: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Right side of such a program for a wrench with its force (7,), and normal forces per coordinate of it (n, 7)."""
    return np.r_[wrench[[0, 1, 5]], normals @ wrench]


@pytest.mark.parametrize(("points", "edges"), [(4, 16), (8, 16), (5, 7), (3, 6), (8, 64)])
def test_twist_rows_of_a_cup_are_what_elastic_normals_resist(points: int, edges: int) -> None:
    """Wherever all normal forces press: what is left beside the twist rows is the slip that the free cone bounds."""
    place = lip_points(points)
    normals = np.zeros((points, 7))
    normals[:, [2, 3, 4]] = elastic(place)
    normals[:, 6] = normals[:, 2]
    system = system_of(holding(cup(R, F), mu=MU, edges=edges, points=points))
    free = edge_wrenches(flat(place), np.eye(3), MU, edges)
    columns = prescribed(place, edges, np.full(points, MU))
    start, bounded = with_force(np.zeros(6)), 0
    twist = system.facets[system.kinds == TWIST]
    np.testing.assert_allclose(twist @ start, -F, rtol=1e-9)
    for step in directions(60, seed=points * edges):
        twisted = with_force(step * np.array([1.0, 1.0, 0.3, 0.3, 0.3, 1.0]), 0.0)
        found = min(
            step_by_rows(twist, start, twisted), largest_step(free, np.array([0, 0, F, 0, 0, 0.0]), twisted[:6])
        )
        if (normals @ (start + min(found, FAR) * twisted)).min() < 1e-9:
            continue
        exact = largest_step(columns, supplied(normals, start), supplied(normals, twisted))
        assert found == pytest.approx(exact, rel=1e-9)
        bounded += 1
    assert bounded > 20


@pytest.mark.parametrize("points", [4, 8])
def test_a_cup_of_prescribed_pressure_lies_in_the_free_one_and_meets_it_without_twist(points: int) -> None:
    free, fixed = (
        system_of(holding(cup(R, F, pressure=pressure), mu=MU, edges=16, points=points)).facets
        for pressure in ("free", "fixed")
    )
    start = with_force(np.zeros(6))

    def reach(rows: np.ndarray, *wrench: float) -> float:
        return step_by_rows(rows, start, with_force(np.array(wrench), 0.0))

    ratios = [reach(fixed, *step) / reach(free, *step) for step in directions(60, seed=points) if step[2] < 0]
    assert min(ratios) < 0.99
    assert max(ratios) <= 1 + 1e-12
    for angle in np.linspace(0.0, 2 * np.pi, 23):
        assert reach(fixed, np.cos(angle), np.sin(angle), 0, 0, 0, 0) == pytest.approx(
            reach(free, np.cos(angle), np.sin(angle), 0, 0, 0, 0), rel=1e-12
        )
    assert reach(fixed, 1, 0, 0, 0, 0, 0) == pytest.approx(MU * F)
    assert reach(fixed, 0, 0, -1, 0, 0, 0) == pytest.approx(F)
    for k in range(2 * points):
        about = np.pi * k / points  # over a point of the lip if k is even, else over the flat between two
        way = np.array([np.cos(about), np.sin(about)])
        arm = R if k % 2 == 0 else R * np.cos(np.pi / points)
        assert reach(fixed, 0, 0, 0, way[1], -way[0], 0) == pytest.approx(F * arm)


def test_a_twist_alone_is_resisted_at_the_radius_of_the_lip() -> None:
    """Every point slides across its radius: mu F r for a circle, less for a friction polygon that is not in its way."""
    rows = elastic_rows([lip_points(8)], [MU], 64, [0.0])
    step = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    assert step_by_rows(rows, with_force(np.zeros(6)), step) == pytest.approx(MU * F * R, rel=1e-3)


def test_the_sides_of_a_lip_that_is_pulled_at_do_not_resist_a_twist_more_than_the_free_lip() -> None:
    """Elastic normals below zero make the rows stricter."""
    place = lip_points(8)
    normals = elastic(place)
    assert (normals @ np.array([F, 0.0, 0.9 * F * R])).min() < 0
    free, fixed = (system_of(holding(cup(R, F, pressure=p), mu=MU)).facets for p in ("free", "fixed"))
    start = with_force(np.array([0.0, 0.0, 0.0, 0.0, 0.9 * F * R, 0.0]))
    twist = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    assert 0.0 < step_by_rows(fixed, start, twist) <= step_by_rows(free, start, twist)


# Prescribed pressure of two pads --------------------------------------------------------------------------

PADS = np.array([[0.01, 0.01], [-0.01, 0.01], [-0.01, -0.01], [0.01, -0.01]])
CLOSING = 40.0


def pad_frames(half: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Contact points (4, 3) and axes (3, 3) of the driven pad, on the side of +x, and of the fixed one."""
    frames = []
    for side in (1.0, -1.0):
        normal = np.array([-side, 0.0, 0.0])
        along = np.array([0.0, 0.0, 1.0])
        axes = np.column_stack([along, np.cross(normal, along), normal])
        points = np.array([[side * half, p, q] for p, q in PADS])
        frames.append((points, axes))
    return frames


@pytest.mark.parametrize("mu", [{"default": 0.8}, {"part_pad1": 0.5, "part_pad2": 0.9}])
def test_the_rows_of_a_free_grip_are_the_wrenches_of_two_pads_with_their_closing_force(mu: dict[str, float]) -> None:
    size = [0.06, 0.1, 0.1]
    config = holding(grip(pressure="free", depth=0.05), mu=mu, edges=8, size=size)
    each = [mu.get(name, mu.get("default", 0.0)) for name in ("part_pad1", "part_pad2")]
    (system,) = object_systems(config, dict(zip(("part_pad1", "part_pad2"), each, strict=True)), {})
    assert system.complete
    driven, fixed = (
        edge_wrenches(points, axes, own, 8) for (points, axes), own in zip(pad_frames(0.03), each, strict=True)
    )
    columns = np.vstack([np.hstack([driven, fixed]), np.repeat([1.0, 0.0], [driven.shape[1], fixed.shape[1]])])
    start = with_force(np.zeros(6), CLOSING)
    lengths = []
    for step in directions(80, seed=3):
        extended = with_force(step, 0.0)
        exact = largest_step(columns, start, extended)
        lengths.append(exact)
        assert step_by_rows(system.facets, start, extended) == pytest.approx(exact, rel=1e-9)
    assert np.isfinite(lengths).all()


def test_nothing_bounds_a_push_on_the_rigid_pad() -> None:
    system = system_of(holding(grip(), mu=0.8, size=[0.06, 0.1, 0.1]))
    start = with_force(np.zeros(6), CLOSING)
    assert step_by_rows(system.facets, start, np.array([1.0, 0, 0, 0, 0, 0, 0])) == np.inf
    assert step_by_rows(system.facets, start, np.array([-1.0, 0, 0, 0, 0, 0, 0])) == pytest.approx(CLOSING)


def grip_slip(mu: tuple[float, float], edges: int) -> np.ndarray:
    """Rows of the slip of two pads without rotation (edges, 7)."""
    slip = np.zeros((edges, 7))
    angle = 2 * np.pi * (np.arange(edges) + 0.5) / edges
    slip[:, 0], slip[:, 1] = np.cos(angle), np.sin(angle)
    slip[:, 2], slip[:, 6] = -mu[1] * np.cos(np.pi / edges), -sum(mu) * np.cos(np.pi / edges)
    return slip


@pytest.mark.parametrize(("mu", "edges"), [((0.8, 0.8), 16), ((0.8, 0.8), 64), ((0.4, 0.9), 8), ((0.6, 0.3), 5)])
def test_twist_rows_of_a_grip_are_what_uniform_pads_resist(mu: tuple[float, float], edges: int) -> None:
    """A quarter of the closing force at each corner of the driven pad, and of what the fixed one bears at each of its
    own."""
    points = np.vstack([PADS, PADS])
    normals = np.zeros((8, 7))
    normals[:, 6] = 0.25
    normals[4:, 2] = 0.25
    columns = prescribed(points, edges, np.repeat(mu, 4))
    rows = grip_rows(PADS, PADS, mu, edges, (0.0, 0.0))
    pressed = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0])
    rows = np.vstack([rows, grip_slip(mu, edges), pressed])
    start = with_force(np.zeros(6), CLOSING)
    for step in directions(60, seed=edges):
        extended = with_force(step * np.array([1.0, 1.0, 0.3, 0.0, 0.0, 0.3]), 0.0)
        exact = largest_step(columns, supplied(normals, start), supplied(normals, extended))
        assert step_by_rows(rows, start, extended) == pytest.approx(exact, rel=1e-9)


# Uncertain contact points ---------------------------------------------------------------------------------


def displacements(points: int, distance: float) -> Iterator[np.ndarray]:
    """Displacements (points, 2): all points alike, all inwards, and any corners of their squares."""
    rng = np.random.default_rng(points)
    for sign in product((-1.0, 1.0), repeat=2):
        yield np.tile(distance * np.array(sign), (points, 1))
    for _ in range(20):
        yield distance * rng.choice([-1.0, 1.0], size=(points, 2))


def test_the_twist_of_a_cup_holds_wherever_its_contact_points_are() -> None:
    place, distance = lip_points(8), 0.002
    (system,) = object_systems(holding(cup(R, F)), {"part": MU}, {"part": distance})
    start = with_force(np.zeros(6))
    looked = 0
    for step in directions(25, seed=1):
        twisted = with_force(step * np.array([1.0, 1.0, 0.3, 0.2, 0.2, 1.0]), 0.0)
        found = step_by_rows(system.facets, start, twisted)
        for moved in (place + d for d in displacements(8, distance)):
            normals = np.zeros((8, 7))
            normals[:, [2, 3, 4]] = elastic(moved)
            normals[:, 6] = normals[:, 2]
            if (normals @ (start + min(found, FAR) * twisted)).min() > 0.0:
                columns = prescribed(moved, 16, np.full(8, MU))
                exact = largest_step(columns, supplied(normals, start), supplied(normals, twisted))
                assert found <= exact * 1.005
                looked += 1
    assert looked > 200


def test_the_twist_of_a_grip_holds_wherever_its_contact_points_are() -> None:
    """The pressure is uniform, so it moves with its points: a smaller pad about the same centre is not enough."""
    distance, mu = 0.001, (0.8, 0.8)
    nominal, rows = (np.vstack([grip_rows(PADS, PADS, mu, 16, (d, d)), grip_slip(mu, 16)]) for d in (0.0, distance))
    normals = np.zeros((8, 7))
    normals[:, 6] = 0.25
    normals[4:, 2] = 0.25
    start, most = with_force(np.zeros(6), CLOSING), 0.0
    for step in directions(25, seed=2):
        twisted = with_force(step * np.array([0.3, 0.3, 0.0, 0.0, 0.0, 0.3]), 0.0)
        found, without = (step_by_rows(own, start, twisted) for own in (rows, nominal))
        for d in displacements(8, distance):
            columns = prescribed(np.vstack([PADS, PADS]) + d, 16, np.repeat(mu, 4))
            exact = largest_step(columns, supplied(normals, start), supplied(normals, twisted))
            most = max(most, without / exact)
            assert found <= exact * 1.005
    assert most > 1.02


# Cost -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "edges", "left"), [(8, 16, 16), (8, 64, 64), (16, 32, 32), (32, 64, 16), (8, 61, 30)]
)
def test_patches_of_many_points_take_friction_polygons_of_fewer_edges(points: int, edges: int, left: int) -> None:
    assert affordable_edges(points, edges) == left
    assert len(elastic_rows([lip_points(points)], [MU], edges, [0.0])) <= MOST_ROWS + 2 * points


# Prescribed pressure of a block ---------------------------------------------------------------------------

BLOCK = {"shape": "box", "size": [0.2, 0.1, 0.02], "mass": 0.5}
CORNERS = np.array([[0.1, 0.05], [-0.1, 0.05], [-0.1, -0.05], [0.1, -0.05]])


def test_twist_rows_of_a_block_are_what_elastic_normals_at_its_corners_resist() -> None:
    config = scene(objects={"block": BLOCK | {"pressure": "fixed"}}, contact={"friction": MU})
    system = object_systems(config, {"block": MU}, {})[0].about([np.array([0.0, 0.0, 0.005])])
    twist = system.facets[system.kinds == TWIST]
    columns, normals = prescribed(CORNERS, 16, np.full(4, MU)), np.zeros((4, 6))
    normals[:, [2, 3, 4]] = elastic(CORNERS)
    weight, bounded = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]), 0
    assert (system.names[TWIST], system.pressed) == ("twist of block on tray", ())
    for step in directions(60, seed=5):
        found = min(step_by_rows(twist, weight, step), largest_step(system.generators, weight, step))
        if (normals @ (weight + min(found, FAR) * step)).min() > 1e-9:
            assert found == pytest.approx(largest_step(columns, supplied(normals, weight), supplied(normals, step)))
            bounded += 1
    assert bounded > 20


def test_the_twist_of_a_block_on_a_turned_one_holds_wherever_its_corners_are() -> None:
    distance, yaw = 0.004, 0.5
    lower = BLOCK | {"size": [0.3, 0.3, 0.02], "yaw": yaw}
    upper = BLOCK | {"on": "lower", "yaw": -yaw, "pressure": "fixed"}
    config = scene(objects={"lower": lower, "upper": upper}, contact={"friction": MU})
    own = object_systems(config, {"lower": MU, "upper": MU}, {"upper": distance})[1]
    own = own.about([np.array([0.0, 0.0, 0.025])])
    weight, turn = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]), Rotation.from_euler("z", yaw).as_matrix()[:2, :2]
    for step in directions(4, seed=6):
        step = step * np.array([1.0, 1.0, 0.3, 0.2, 0.2, 1.0])
        found = step_by_rows(own.facets, weight, step)
        for moved in (CORNERS + d @ turn.T for d in displacements(4, distance)):
            normals = np.zeros((4, 6))
            normals[:, [2, 3, 4]] = elastic(moved)
            columns = prescribed(moved, 16, np.full(4, MU))
            if (normals @ (weight + min(found, FAR) * step)).min() > 0.0:
                assert found <= largest_step(columns, supplied(normals, weight), supplied(normals, step)) * 1.005


def turning(radius: float, **keys: object) -> Config:
    """A gantry that moves a block by 0.1 m while it turns about an axis at a distance."""
    joints = [[0.0, 0.0, 0.0, 0.0], [0.07, 0.07, 0.0, 0.1 / radius]]
    quick = {"limits": {"all": {"velocity": 100.0, "acceleration": 1000.0}}}
    sections = {"contact": {"friction": 0.3}, "solver": {"collocation_points": 20}}
    return scene("gantry", {"block": BLOCK | keys}, joints=joints, robot_keys=quick, **sections)


def bounds_twist(config: Config) -> bool:
    return build_problem(config).limits.contacts[0].system.bounds_twist


def test_the_pressure_of_a_block_is_prescribed_by_default_if_the_path_turns_it_nearly_in_place() -> None:
    """I / (m R r) = 0.05 for R = 0.745 m: I / m = (0.2^2 + 0.1^2) / 12 m^2, r = 0.112 m."""
    assert bounds_twist(turning(0.7))
    assert not bounds_twist(turning(0.8))
    assert not bounds_twist(turning(0.1, pressure="free"))
    assert bounds_twist(turning(10.0, pressure="fixed"))
    assert bounds_twist(turning(1.0, inertia=[0.003, 0.003, 0.003]))


def test_blocks_that_share_their_load_have_free_pressure() -> None:
    post = {"shape": "box", "size": [0.04, 0.04, 0.05], "mass": 0.2}
    objects = {
        "left": post | {"at": [-0.1, 0.0]},
        "right": post | {"at": [0.1, 0.0]},
        "plank": BLOCK | {"size": [0.3, 0.05, 0.02], "on": ["left", "right"]},
    }
    joints = [[0.0, 0.0, 0.0, 0.0], [0.05, 0.05, 0.0, 1.0]]
    (limit,) = build_problem(scene("gantry", objects, joints=joints)).limits.contacts
    assert not limit.system.bounds_twist
    objects["left"] = objects["left"] | {"pressure": "fixed"}
    with pytest.raises(ConfigError, match=r"objects\.left\.pressure: found fixed, but it and right, plank share their"):
        build_problem(scene("gantry", objects, joints=joints))


def test_a_block_that_twists_is_planned_slower_and_certified() -> None:
    free, fixed = (plan_of(turning(0.1, pressure=pressure)) for pressure in ("free", "fixed"))
    assert 1.01 < fixed.duration / free.duration < 1.05
    assert plan_of(turning(0.1)).duration == fixed.duration
    assert certify(fixed).passed
    assert certify(free).passed
    promised = certify(replace(free, problem=replace(free.problem, config=fixed.problem.config)))
    assert not promised.passed
    assert promised.worst.limit == "twist of block on tray"


@pytest.mark.parametrize(("twist", "least", "most"), [(0.0, 0.995, 1.0), (1.0, 0.92, 0.94), (np.inf, 0.995, 1.0)])
def test_a_block_in_mujoco_yields_before_free_pressure_does_if_it_is_pushed_and_twisted(
    twist: float, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "experiments"))
    block_twist = importlib.import_module("block_twist")
    case = block_twist.Case(block_twist.REST, 1, (0.0, 0.0), 0.5, 45.0, twist)
    free, fixed = (block_twist.planned(case, pressure) for pressure in ("free", "fixed"))
    assert list(block_twist.slides(case, free * np.array([least, most + 0.005]))) == [False, True]
    assert not block_twist.slides(case, np.array([0.995 * fixed]))[0]
