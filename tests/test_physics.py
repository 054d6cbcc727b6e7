"""Fastest timings against closed forms, from the configuration to the plan."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import BOX, FLAT, G, bang_bang, duration, plan_of, scene
from scipy.integrate import quad
from scipy.optimize import brentq

from robustopt.solvers import Status

TALL = {"shape": "box", "size": [0.06, 0.2, 0.30], "mass": 1.0}
"""An object that tips long before it slips: 30 mm from its edge, 150 mm high."""

EXACT = 1e-9
"""Constant acceleration with the switch at a grid point: the grid makes no error."""

SWITCH = 1e-4
"""A switch between two grid points costs at most one interval's worth of peak speed; measured below 3e-5 at N = 100."""


# Slipping ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mu", [1e-3, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("length", [1e-3, 1.0, 30.0])
def test_a_block_slips_beyond_mu_g(mu: float, length: float) -> None:
    found = duration(scene(objects={"block": FLAT}, contact={"friction": mu}, length=length))
    assert found == pytest.approx(bang_bang(length, mu * G), rel=EXACT)


def test_the_weakest_interface_of_a_stack_binds() -> None:
    objects = {"lower": FLAT, "upper": FLAT | {"on": "lower"}}
    for friction, weakest in (
        ({"lower": 0.2, "upper": 0.4}, "lower on tray"),
        ({"lower": 0.4, "upper": 0.2}, "upper on lower"),
    ):
        plan = plan_of(scene(objects=objects, contact={"friction": friction}))
        assert plan.duration == pytest.approx(bang_bang(1.0, 0.2 * G), rel=EXACT)
        assert {name for names in plan.active for name in names} == {f"slip of {weakest}"}


@pytest.mark.parametrize("mass", [1e-6, 1.0, 1e4])
@pytest.mark.parametrize("size", [0.005, 0.5])
def test_slipping_depends_neither_on_mass_nor_on_size(mass: float, size: float) -> None:
    block = {"shape": "box", "size": [size, size, 0.1 * size], "mass": mass}
    assert duration(scene(objects={"block": block}, contact={"friction": 0.3})) == pytest.approx(
        bang_bang(1.0, 0.3 * G), rel=EXACT
    )


def test_duration_is_proportional_to_one_over_root_mu_while_friction_binds() -> None:
    found = [duration(scene(objects={"block": FLAT}, contact={"friction": mu})) for mu in (0.1, 0.2, 0.4)]
    np.testing.assert_allclose(np.array(found[:-1]) / found[1:], np.sqrt(2), rtol=EXACT)


def test_the_inner_friction_pyramid_costs_its_inradius_between_two_edges() -> None:
    """Four edges along the axes leave mu / sqrt(2) along the diagonal; the exact cone would not care."""
    diagonal = [[0.0, 0.0], [1.0, 1.0]]
    for edges, share in ((4, np.cos(np.pi / 4)), (12, np.cos(np.pi / 12)), (16, 1.0)):
        found = duration(
            scene(
                "two_slides", objects={"block": FLAT}, joints=diagonal, contact={"friction": 0.3, "cone_edges": edges}
            )
        )
        assert found == pytest.approx(bang_bang(np.sqrt(2), 0.3 * G * share), rel=EXACT), edges


def test_a_block_turned_on_the_tray_has_the_same_friction() -> None:
    found = [
        duration(scene(objects={"block": FLAT | {"yaw": yaw}}, contact={"friction": 0.3})) for yaw in (0.0, 0.3, 2.0)
    ]
    np.testing.assert_allclose(found, bang_bang(1.0, 0.3 * G), rtol=EXACT)


# Tipping -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("half_width", [0.002, 0.03])
@pytest.mark.parametrize("height", [0.3, 1.0])
def test_a_block_tips_beyond_g_times_half_width_over_height_of_its_centre(half_width: float, height: float) -> None:
    block = {"shape": "box", "size": [2 * half_width, 0.3, height], "mass": 1.0}
    plan = plan_of(scene(objects={"block": block}, contact={"friction": 2.0}))
    assert plan.duration == pytest.approx(bang_bang(1.0, G * half_width / (height / 2)), rel=EXACT)
    assert all(names == ("tipping of block over tray",) for names in plan.active)


def test_a_cylinder_tips_over_the_corners_of_its_patch() -> None:
    """Eight contact points, the first one along x: tipping along x is about that point, a radius from the centre."""
    cylinder = {"shape": "cylinder", "radius": 0.03, "height": 0.4, "mass": 1.0}
    found = duration(scene(objects={"can": cylinder}, contact={"friction": 2.0, "patch_points": 8}))
    assert found == pytest.approx(bang_bang(1.0, G * 0.03 / 0.2), rel=EXACT)
    turned = duration(
        scene(objects={"can": cylinder | {"yaw": np.pi / 8}}, contact={"friction": 2.0, "patch_points": 8})
    )
    assert turned == pytest.approx(bang_bang(1.0, G * 0.03 * np.cos(np.pi / 8) / 0.2), rel=EXACT)


def test_an_offset_centre_of_mass_tips_sooner_one_way() -> None:
    """Speeding up along +x tips the block over its rear edge, 40 mm from the centre of mass, braking over its front."""
    block = TALL | {"center_of_mass": [0.01, 0.0, 0.03]}
    found = duration(scene(objects={"block": block}, contact={"friction": 2.0}))
    assert found == pytest.approx(bang_bang(1.0, G * 0.04 / 0.18, G * 0.02 / 0.18), rel=SWITCH)


def test_a_stack_tips_about_its_common_centre_of_mass() -> None:
    lower = {"shape": "box", "size": [0.08, 0.2, 0.1], "mass": 0.4}
    upper = {"shape": "box", "size": [0.08, 0.2, 0.3], "mass": 0.6, "on": "lower"}
    common = (0.4 * 0.05 + 0.6 * 0.25) / 1.0
    assert G * 0.04 / common < G * 0.04 / 0.15  # the upper one alone would tip later
    found = duration(scene(objects={"lower": lower, "upper": upper}, contact={"friction": 2.0}))
    assert found == pytest.approx(bang_bang(1.0, G * 0.04 / common), rel=EXACT)


def test_an_overhanging_block_tips_about_the_edge_of_its_support() -> None:
    """The patch is the overlap of both faces, here 10 mm shorter on one side."""
    lower = {"shape": "box", "size": [0.08, 0.2, 0.02], "mass": 5.0}
    upper = {"shape": "box", "size": [0.08, 0.2, 0.4], "mass": 0.5, "on": "lower", "at": [0.01, 0.0]}
    found = duration(scene(objects={"lower": lower, "upper": upper}, contact={"friction": 3.0}))
    assert found == pytest.approx(bang_bang(1.0, G * 0.04 / 0.2, G * 0.03 / 0.2), rel=SWITCH)


# Gravity -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.05, 0.2])
def test_on_a_tilted_tray_gravity_takes_its_share_of_the_friction(angle: float) -> None:
    down = [G * np.sin(angle), 0.0, -G * np.cos(angle)]
    found = duration(scene(objects={"block": FLAT}, contact={"friction": 0.3}, gravity=down))
    share, pull = 0.3 * G * np.cos(angle), G * np.sin(angle)
    assert found == pytest.approx(bang_bang(1.0, share + pull, share - pull), rel=2e-4)


@pytest.mark.parametrize(("length", "limits"), [(1.0, (20.0, G)), (-1.0, (G, 20.0))])
def test_a_lift_may_not_leave_the_block_behind(length: float, limits: tuple[float, float]) -> None:
    """Downwards acceleration is below g, whichever way the lift goes; upwards the joint limit holds."""
    robot = {"limits": {"z": {"acceleration": 20.0}}}
    found = duration(scene("lift", objects={"block": FLAT}, length=length, robot_keys=robot))
    assert found == pytest.approx(bang_bang(1.0, *limits), rel=SWITCH)


def test_without_gravity_nothing_holds_the_block() -> None:
    plan = plan_of(scene(objects={"block": FLAT}, gravity=[0.0, 0.0, 0.0]))
    assert plan.status is Status.INFEASIBLE


# Joint limits --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("velocity", "acceleration"), [(1.0, 2.0), (0.6, 4.0)])
def test_velocity_limit_makes_a_trapezoid(velocity: float, acceleration: float) -> None:
    robot = {"limits": {"x": {"velocity": velocity, "acceleration": acceleration}}}
    exact = 1.0 / velocity + velocity / acceleration
    error = [duration(scene(robot_keys=robot, solver={"collocation_points": n})) / exact - 1 for n in (100, 400)]
    assert 0 <= error[1] <= max(error[0] / 4, SWITCH) <= 2e-3
    plan = plan_of(scene(robot_keys=robot))
    assert {name for names in plan.active for name in names} == {"x velocity", "x acceleration"}


def test_torque_limit_accelerates_everything_that_moves() -> None:
    """2 kg of carriage, 1 kg of tray, 0.5 kg of block."""
    found = duration(
        scene(objects={"block": FLAT}, contact={"friction": 5.0}, robot_keys={"limits": {"x": {"torque": 7.0}}})
    )
    assert found == pytest.approx(bang_bang(1.0, 7.0 / 3.5), rel=EXACT)


def test_torque_limit_of_a_lift_holds_the_weight_as_well() -> None:
    robot = {"limits": {"z": {"torque": 50.0}}}
    found = duration(scene("lift", objects={"block": FLAT}, robot_keys=robot))
    assert found == pytest.approx(bang_bang(1.0, 50.0 / 3.5 - G, G), rel=SWITCH)


def friction_time(force: float, viscous: float, dry: float, length: float = 1.0, mass: float = 3.5) -> float:
    """Full force forwards, then full force backwards, with m dv/dt = +-F - dry - viscous v."""

    def leg(net: float, slope: float, speed: float) -> tuple[float, float]:
        path = quad(lambda v: mass * v / (net - slope * v), 0, speed)[0]
        return path, quad(lambda v: mass / (net - slope * v), 0, speed)[0]

    def left(speed: float) -> float:
        return leg(force - dry, viscous, speed)[0] + leg(force + dry, -viscous, speed)[0] - length

    top = (force - dry) / viscous * (1 - 1e-9) if viscous else 100.0
    speed = brentq(left, 1e-6, top, xtol=1e-14)
    return leg(force - dry, viscous, speed)[1] + leg(force + dry, -viscous, speed)[1]


@pytest.mark.parametrize(
    ("force", "viscous", "dry"), [(10.0, 0.0, 4.0), (10.0, 2.0, 1.0), (10.0, 8.0, 1.0), (10.0, 15.0, 0.0)]
)
def test_joint_friction_slows_down_and_helps_to_brake(force: float, viscous: float, dry: float) -> None:
    """With rows at both ends of an interval, a torque that changes along it costs a first-order error, never a gain."""
    robot = {"limits": {"x": {"torque": force, "viscous_friction": viscous, "dry_friction": dry}}}
    exact = friction_time(force, viscous, dry)
    error = []
    for points in (200, 1600):
        plan = plan_of(
            scene(
                objects={"block": FLAT},
                contact={"friction": 5.0},
                robot_keys=robot,
                solver={"collocation_points": points},
            )
        )
        assert plan.status is Status.SOLVED
        error.append(plan.duration / exact - 1)
    assert -1e-6 <= error[1] <= 2e-3
    assert error[1] <= max(error[0] / 5, SWITCH)
    assert friction_time(force, viscous, dry) > friction_time(force, 0.0, 0.0)


def test_switched_off_joint_friction_leaves_the_torque_alone() -> None:
    robot = {"limits": {"x": {"torque": 7.0, "viscous_friction": 5.0, "dry_friction": 2.0}}, "joint_friction": False}
    found = duration(scene(objects={"block": FLAT}, contact={"friction": 5.0}, robot_keys=robot))
    assert found == pytest.approx(bang_bang(1.0, 2.0), rel=EXACT)


# Turning -------------------------------------------------------------------------------------------------

RADIUS = 0.5


def test_friction_on_a_turntable_bears_tangential_and_centripetal_acceleration() -> None:
    """A tiny block: (alpha r)^2 + (omega^2 r)^2 <= (mu g)^2, so omega^2 = (mu g / r) sin(2 angle) up to 45 degrees."""
    mu, angle = 0.4, 3.0
    block = {"shape": "box", "size": [0.005, 0.005, 0.001], "mass": 0.1}
    fastest = mu * G / RADIUS
    rising = quad(lambda root: 2 * root / np.sqrt(fastest * np.sin(2 * root**2)), 0.0, np.sqrt(np.pi / 4))[0]
    exact = 2 * (rising + (angle / 2 - np.pi / 4) / np.sqrt(fastest))
    config = scene(
        "turntable",
        objects={"block": block},
        length=angle,
        contact={"friction": mu, "cone_edges": 32},
        solver={"collocation_points": 500},
    )
    # the pyramid with 32 edges is up to 1 - cos(pi / 32) = 0.48 % weaker, the block's own torsion takes a little
    assert exact * (1 - 1e-5) <= duration(config) <= exact * 1.005


def test_turning_in_place_is_bounded_by_the_torsion_of_the_patch() -> None:
    """Four corners of a patch at radius r, each with mu m g / 4: alpha <= mu g r / k^2, k the radius of inertia."""
    mu, edge = 0.3, 0.2
    block = {"shape": "box", "size": [edge, edge, 0.02], "mass": 1.0, "at": [-RADIUS, 0.0]}
    config = scene("turntable", objects={"block": block}, tray={"size": [1.4, 0.6, 0.01]}, contact={"friction": mu})
    gyration = (edge**2 + edge**2) / 12
    # a corner at 45 degrees pushes tangentially, along an edge of the 16-edged cone
    assert duration(config) == pytest.approx(bang_bang(1.0, mu * G * edge / np.sqrt(2) / gyration), rel=1e-6)


# Uncertain parameters ------------------------------------------------------------------------------------


def test_friction_interval_counts_with_its_lower_end() -> None:
    config = scene(objects={"block": FLAT}, contact={"friction": 0.4}, uncertainty={"friction": [0.3, 0.5]})
    assert duration(config) == pytest.approx(bang_bang(1.0, 0.3 * G), rel=EXACT)


def test_acceleration_error_takes_its_margin_from_slipping() -> None:
    error = {"mean": 0.2, "deviation": 0.5, "K": 2.0}
    config = scene(objects={"block": FLAT}, contact={"friction": 0.3}, uncertainty={"joint_acceleration": error})
    assert duration(config) == pytest.approx(bang_bang(1.0, 0.3 * G - 1.2, 0.3 * G - 0.8), rel=SWITCH)


def test_acceleration_error_takes_its_margin_from_tipping_joint_limits_and_torque() -> None:
    uncertain = {"joint_acceleration": {"deviation": 0.5}}
    assert duration(scene(objects={"block": TALL}, contact={"friction": 2.0}, uncertainty=uncertain)) == pytest.approx(
        bang_bang(1.0, G * 0.03 / 0.15 - 0.5), rel=EXACT
    )
    limited = scene(robot_keys={"limits": {"x": {"acceleration": 3.0}}}, uncertainty=uncertain)
    assert duration(limited) == pytest.approx(bang_bang(1.0, 2.5), rel=EXACT)
    weak = scene(robot_keys={"limits": {"x": {"torque": 6.0}}}, uncertainty=uncertain)
    assert duration(weak) == pytest.approx(bang_bang(1.0, 6.0 / 3.0 - 0.5), rel=EXACT)


def test_lift_with_acceleration_error_keeps_the_weight_on_the_tray() -> None:
    robot = {"limits": {"z": {"acceleration": 20.0}}}
    config = scene(
        "lift", objects={"block": FLAT}, robot_keys=robot, uncertainty={"joint_acceleration": {"deviation": 1.0}}
    )
    assert duration(config) == pytest.approx(bang_bang(1.0, 19.0, G - 1.0), rel=SWITCH)


def test_uncertain_centre_of_mass_tips_at_its_worst_corner() -> None:
    config = scene(
        objects={"block": TALL},
        contact={"friction": 2.0},
        uncertainty={"center_of_mass": {"block": [0.005, 0.01, 0.02]}},
    )
    assert duration(config) == pytest.approx(bang_bang(1.0, G * 0.025 / 0.17), rel=EXACT)


def test_displaced_contact_points_narrow_the_patch() -> None:
    config = scene(objects={"block": TALL}, contact={"friction": 2.0}, uncertainty={"contact_points": 0.004})
    assert duration(config) == pytest.approx(bang_bang(1.0, G * 0.026 / 0.15), rel=EXACT)


def test_uncertain_masses_tip_a_stack_with_the_heaviest_upper_and_lightest_lower() -> None:
    lower = {"shape": "box", "size": [0.08, 0.2, 0.1], "mass": 0.4}
    upper = {"shape": "box", "size": [0.08, 0.2, 0.3], "mass": 0.6, "on": "lower"}
    uncertain = {"mass": {"lower": [0.3, 0.5], "upper": [0.5, 0.8]}}
    config = scene(objects={"lower": lower, "upper": upper}, contact={"friction": 2.0}, uncertainty=uncertain)
    common = (0.3 * 0.05 + 0.8 * 0.25) / 1.1
    assert duration(config) == pytest.approx(bang_bang(1.0, G * 0.04 / common), rel=EXACT)


def test_uncertain_mass_counts_in_the_torque_with_its_upper_end() -> None:
    uncertain = {"mass": {"block": [0.2, 0.9], "tray": [0.5, 1.1]}}
    config = scene(
        objects={"block": FLAT},
        contact={"friction": 5.0},
        robot_keys={"limits": {"x": {"torque": 7.0}}},
        uncertainty=uncertain,
    )
    assert duration(config) == pytest.approx(bang_bang(1.0, 7.0 / 4.0), rel=EXACT)


def test_a_heavy_load_that_hangs_on_the_motor_still_brakes_in_time() -> None:
    """A lift that goes down holds back the heaviest load; what it lets fall is bounded by the contact."""
    robot = {"limits": {"z": {"torque": 50.0, "acceleration": 100.0}}}
    config = scene(
        "lift", objects={"block": FLAT}, length=-1.0, robot_keys=robot, uncertainty={"mass": {"block": [0.3, 0.8]}}
    )
    assert duration(config) == pytest.approx(bang_bang(1.0, G, 50.0 / 3.8 - G), rel=2e-4)


def test_nothing_uncertain_slows_the_other_object() -> None:
    """An error of one object's centre of mass leaves an object beside it alone."""
    objects = {"tall": TALL | {"at": [-0.2, 0.0]}, "box": BOX | {"at": [0.2, 0.0]}}
    plain = duration(scene(objects=objects, contact={"friction": 2.0}))
    config = scene(
        objects=objects, contact={"friction": 2.0}, uncertainty={"center_of_mass": {"box": [0.01, 0.01, 0.01]}}
    )
    assert duration(config) == pytest.approx(plain, rel=EXACT)
