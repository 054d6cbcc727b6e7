"""Convex polygons and the placement of objects, against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robustopt.config import Config
from robustopt.errors import ConfigError
from robustopt.geometry import (
    apart,
    area,
    clip,
    contains,
    convex_hull,
    erode,
    prism,
    rectangle,
    regular_polygon,
    rotation_rpy,
)
from robustopt.scene.patches import patches
from robustopt.scene.placement import placements, standing_order

UNIT = rectangle(np.zeros(2), np.array([1.0, 1.0]))
lengths = st.floats(0.1, 2.0)
shifts = st.floats(-1.5, 1.5)
angles = st.floats(-np.pi, np.pi)


def scene(objects: dict, **sections) -> Config:
    return Config.model_validate(
        {
            "name": "scene",
            "robot": {"model": "tx90l"},
            "tray": {"size": [0.3, 0.3, 0.01], "mass": 1.0},
            "path": {},
            "objects": objects,
            **sections,
        }
    )


def box(size=(0.08, 0.08, 0.12), **keys) -> dict:
    return {"shape": "box", "size": list(size), "mass": 0.5, **keys}


def test_rectangle_is_counter_clockwise_with_its_area():
    assert area(rectangle(np.array([3.0, -1.0]), np.array([0.2, 0.5]), yaw=0.7)) == pytest.approx(0.1)


def test_regular_polygon_has_the_area_of_its_triangles():
    assert area(regular_polygon(np.zeros(2), 2.0, 7, yaw=0.3)) == pytest.approx(0.5 * 7 * 4.0 * np.sin(2 * np.pi / 7))


def test_clip_of_shifted_squares_is_the_common_rectangle():
    common = clip(UNIT, UNIT + np.array([0.25, -0.5]))
    assert area(common) == pytest.approx(0.75 * 0.5)
    assert common.min(axis=0) == pytest.approx([-0.25, -0.5])
    assert common.max(axis=0) == pytest.approx([0.5, 0.0])


def test_clip_of_a_square_and_itself_turned_by_45_degrees_is_an_octagon():
    octagon = clip(UNIT, rectangle(np.zeros(2), np.array([1.0, 1.0]), np.pi / 4))
    assert len(octagon) == 8
    assert area(octagon) == pytest.approx(2.0 * (np.sqrt(2.0) - 1.0))  # a regular octagon of inradius 1/2


def test_clip_keeps_equal_faces_as_they_are():
    assert clip(UNIT, UNIT.copy()) == pytest.approx(UNIT)


@pytest.mark.parametrize("shift", [[1.0, 0.0], [1.0, 1.0], [2.0, 0.3]])
def test_faces_that_only_touch_do_not_overlap(shift):
    assert clip(UNIT, UNIT + np.array(shift)).shape == (0, 2)


@given(lengths, lengths, angles, shifts, shifts)
def test_clip_has_the_same_area_both_ways_and_its_corners_are_in_both(a, b, yaw, dx, dy):
    other = rectangle(np.array([dx, dy]), np.array([a, b]), yaw)
    common = clip(UNIT, other)
    assert area(common) == pytest.approx(area(clip(other, UNIT)), abs=1e-8)
    assert all(contains(UNIT, p, 1e-8) and contains(other, p, 1e-8) for p in common)


@given(shifts, shifts, angles)
def test_clip_agrees_with_points_drawn_at_random(dx, dy, yaw):
    other = regular_polygon(np.array([dx, dy]), 0.8, 6, yaw)
    common = clip(UNIT, other)
    for p in np.random.default_rng(0).uniform(-0.6, 0.6, (50, 2)):
        if contains(UNIT, p, -1e-6) and contains(other, p, -1e-6):
            assert contains(common, p)
        if len(common) and contains(common, p, -1e-6):
            assert contains(UNIT, p)
            assert contains(other, p)


def test_erosion_of_a_rectangle_takes_the_distance_from_every_side():
    rest = erode(rectangle(np.zeros(2), np.array([0.3, 0.2]), 0.4), 0.02, yaw=0.4)
    assert rest == pytest.approx(rectangle(np.zeros(2), np.array([0.26, 0.16]), 0.4))


def test_erosion_by_half_the_size_leaves_nothing():
    assert erode(UNIT, 0.5).shape == (0, 2)
    assert erode(UNIT, 0.6).shape == (0, 2)


@given(st.floats(0.01, 0.3), angles, st.integers(0, 2**32 - 1))
def test_eroded_polygon_is_inside_the_hull_wherever_the_corners_are(distance, yaw, seed):
    polygon = regular_polygon(np.array([0.2, 0.1]), 0.8, 5)
    rest = erode(polygon, distance, yaw)
    c, s = np.cos(yaw), np.sin(yaw)
    moved = np.random.default_rng(seed).choice([-distance, distance], (5, 2)) @ np.array([[c, -s], [s, c]]).T
    assert all(contains(convex_hull(polygon + moved), p, 1e-8) for p in rest)


def test_hull_drops_points_inside_and_on_edges():
    points = np.vstack([UNIT, [[0.0, 0.0], [0.5, 0.0], [0.1, -0.2]]])
    hull = convex_hull(points)
    assert len(hull) == 4
    assert area(hull) == pytest.approx(1.0)


def test_object_turns_and_moves_with_what_it_stands_on():
    config = scene({"upper": box(on="lower", at=[0.02, 0.0]), "lower": box(at=[0.1, 0.0], yaw=np.pi / 2)})
    placed = placements(config)
    assert list(placed) == ["lower", "upper"]
    assert placed["upper"].position == pytest.approx([0.1, 0.02, 0.005 + 0.12 + 0.06])
    assert placed["upper"].yaw == pytest.approx(np.pi / 2)
    assert placed["lower"].half_height == pytest.approx(0.06)


def test_patches_of_a_stack_are_the_overlaps_of_faces():
    config = scene({"lower": box(), "upper": box(on="lower", at=[0.03, 0.0])})
    lower, upper = patches(config)
    assert (lower.object, lower.support, lower.origin[2]) == ("lower", "tray", pytest.approx(0.005))
    assert area(lower.polygon) == pytest.approx(0.08**2)
    assert (upper.object, upper.support, upper.origin[2]) == ("upper", "lower", pytest.approx(0.125))
    assert area(upper.polygon) == pytest.approx(0.05 * 0.08)


def test_round_face_is_a_polygon_inside_the_disc():
    config = scene(
        {"can": {"shape": "cylinder", "radius": 0.05, "height": 0.1, "mass": 0.3}}, contact={"patch_points": 6}
    )
    (patch,) = patches(config)
    assert np.linalg.norm(patch.polygon, axis=1) == pytest.approx(0.05)
    assert len(patch.polygon) == 6


def test_bridge_has_two_patches_in_the_tray_frame():
    config = scene(
        {
            "left": box(at=[0.0, 0.08], yaw=0.2),
            "right": box(at=[0.0, -0.08]),
            "plank": box(size=(0.06, 0.24, 0.02), on=["left", "right"], at=[0.0, 0.01]),
        }
    )
    on_left, on_right = [patch for patch in patches(config) if patch.object == "plank"]
    assert (on_left.support, on_right.support) == ("left", "right")
    assert on_left.turn == pytest.approx(0.2)
    assert area(on_right.polygon) == pytest.approx(0.06 * (-0.04 + 0.11))
    assert placements(config)["plank"].position == pytest.approx([0.0, 0.01, 0.005 + 0.12 + 0.01])


def test_objects_that_stand_on_each_other_have_no_order():
    config = scene({"a": box(on="b"), "b": box(on="a"), "c": box()})
    with pytest.raises(ConfigError, match="a, b: their supports lead neither to the tray nor to a held object"):
        standing_order(config.objects)


@pytest.mark.parametrize(
    ("rpy", "reach"),
    [
        ((0.0, 0.0, 0.0), 0.5),
        ((0.0, 0.0, np.pi / 4), np.sqrt(0.5)),  # an edge points at the face
        ((0.0, np.pi / 4, np.arctan(np.sqrt(0.5))), None),
    ],
)
def test_a_turned_cube_is_apart_from_another_beyond_its_reach_along_x(rpy, reach):
    corners = prism(UNIT, 0.5) @ rotation_rpy(rpy).T
    reach = corners[:, 0].max() if reach is None else reach
    for gap, expected in ((1e-6, True), (-1e-6, False)):
        assert apart(prism(UNIT, 0.5), corners + np.array([0.5 + reach + gap, 0.0, 0.0])) is expected
        assert apart(corners + np.array([0.5 + reach + gap, 0.0, 0.0]), prism(UNIT, 0.5)) is expected


def test_crossed_edges_separate_what_no_face_separates():
    first = prism(UNIT, 0.5) @ rotation_rpy((np.pi / 4, 0.0, 0.0)).T  # an edge along x on top
    second = prism(UNIT, 0.5) @ rotation_rpy((0.0, np.pi / 4, 0.0)).T  # an edge along y below
    assert apart(first, second + np.array([0.0, 0.0, np.sqrt(2.0) + 1e-6]))
    assert not apart(first, second + np.array([0.0, 0.0, np.sqrt(2.0) - 1e-6]))
