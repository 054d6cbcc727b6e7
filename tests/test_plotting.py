"""Figures: the curve of largest speed against closed forms and a linear program, and files that do not change."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from scenes import FLAT, plan_of, scene
from scipy.optimize import linprog

from robustopt.config import AccelerationError
from robustopt.config.load import load_config
from robustopt.limits.uncertainty import acceleration_error
from robustopt.plotting import contacts_figure, house_style, phase_plane, shares_figure, write_figures
from robustopt.plotting.joints import joint_figures, joint_quantities
from robustopt.plotting.style import DARK_GREY, LIMIT_COLOURS, OTHER, limit_colours, percent
from robustopt.plotting.utilisation import contact_utilisation
from robustopt.plotting.velocity_limit import largest_x, velocity_limits
from robustopt.solvers import build_problem, solve
from robustopt.solvers.trajectory import NO_LIMIT, Trajectory, binding_shares


class WavePath:
    """Joint k moves as k-th sine with its own amplitude: q_k = A_k sin((k + 1) s + k)."""

    def __init__(self, n):
        self.k = np.arange(n)
        self.amplitude = 1.0 / (1.0 + 0.4 * self.k)

    def evaluate(self, s, piece, order=0):
        rate = self.k + 1.0
        angle = s[:, None] * rate + self.k + 0.4 * piece[:, None]
        value = (np.sin(angle), np.cos(angle), -np.sin(angle))[order]
        return self.amplitude * rate**order * value


class Arm:
    """Joints of inertia 1 under a torque of 5 N m, and a load that adds up to 2 N m either way."""

    def __init__(self, n):
        self.n, self.base, self.motors, self.contacts = n, 0, slice(0, None), {}
        self.joint_names = tuple(f"joint{k + 1}" for k in range(n))
        self.hinges, self.points = np.ones(n, dtype=bool), ()
        self.limits = SimpleNamespace(
            lower=np.full(n, -2.0), upper=np.full(n, 3.0), velocity=np.full(n, 3.0), acceleration=np.full(n, 8.0),
            jerk=np.full(n, np.inf), torque=np.full(n, 20.0),
        )  # fmt: skip


class Problem:
    """Joint velocity and acceleration limits along `WavePath`, with a stop half way."""

    def __init__(self, n, intervals, error):
        half = np.linspace(0.0, 0.5, intervals // 2 + 1)
        self.s, self.piece = np.concatenate([half, 0.5 + half]), np.repeat([0, 1], half.size)
        self.path, self.robot, self.pauses = WavePath(n), Arm(n), np.zeros(self.s.size - 1)
        self.q1, self.q2 = (self.path.evaluate(self.s, self.piece, order=order) for order in (1, 2))
        self.a, self.b = np.hstack([self.q1, -self.q1]), np.hstack([self.q2, -self.q2])
        self.c = np.full_like(self.a, -8.0)
        self.row_names = tuple(f"joint{k + 1} acceleration" for k in range(n)) * 2
        self.feasible = np.ones(self.s.size, dtype=bool)
        self.rest = np.isin(np.arange(self.s.size), [0, half.size - 1, half.size, self.s.size - 1])
        beliefs = SimpleNamespace(joint_acceleration=error, base_acceleration=0.0)
        self.config = SimpleNamespace(name="wave", objects={}, uncertainty=beliefs)
        x_max = np.min((3.0 / np.maximum(np.abs(self.q1), 1e-9)) ** 2, axis=1)
        self.facets = ()
        uncertainty = SimpleNamespace(error=acceleration_error(self.config, n, 0))
        self.limits = SimpleNamespace(x_max=x_max, torque=self, contacts=(), uncertainty=uncertainty)
        self.viscous = np.zeros(1)

    def with_reference(self, reference):
        return self

    def torques(self, u, x):
        return self.q1 * u[:, None] + self.q2 * x[:, None] + 5.0

    def sides(self, u, x, points):
        nominal = self.q1[points] * u[:, None] + self.q2[points] * x[:, None] + 5.0
        return (np.hstack([nominal, -nominal]) + 2.0) / 20.0 - 1.0


def fastest_plan(n=3, intervals=60, error=None):
    """The run of `Problem` with the largest sum of x, and the limits that bind on it."""
    problem = Problem(n, intervals, error)
    a, b, c, s = problem.a, problem.b, problem.c, problem.s
    x = _largest_x(s, a, b, c, problem.limits.x_max)
    u = np.divide(np.diff(x), 2 * np.diff(s), out=np.zeros(s.size - 1), where=np.diff(s) > 0)
    starts, ends = (a[k] * u[:, None] + b[k] * x[k, None] + c[k] for k in (slice(None, -1), slice(1, None)))
    binds = np.maximum(starts, ends) > -1e-6
    active = tuple(tuple(sorted({problem.row_names[k] for k in np.flatnonzero(row)})) for row in binds)
    plan = SimpleNamespace(s=s, piece=problem.piece, x=x, u=u, active=active, message="", problem=problem, steady=True)
    plan.duration = Trajectory.from_plan(plan).duration
    return plan


def no_plan():
    """A problem that has no solution for s from 0.2 to 0.3."""
    plan = fastest_plan(2, 40)
    plan.problem.feasible = (plan.s < 0.19) | (plan.s > 0.31)
    plan.x, plan.u, plan.active, plan.duration, plan.stuck = np.empty(0), np.empty(0), (), np.inf, -1
    return plan


def _largest_x(s, a, b, c, x_max):
    rows, bounds = [], []
    for i in np.flatnonzero(np.diff(s) > 0):
        for j in (i, i + 1):
            block = np.zeros((a.shape[1], s.size))
            block[:, i] -= a[j] / (2 * (s[i + 1] - s[i]))
            block[:, i + 1] += a[j] / (2 * (s[i + 1] - s[i]))
            block[:, j] += b[j]
            rows.append(block)
            bounds.append(-c[j])
    rest = np.isin(np.arange(s.size), [0, s.size // 2 - 1, s.size // 2, s.size - 1])
    limits = [(0, 0 if r else top) for r, top in zip(rest, x_max, strict=True)]
    return linprog(-np.ones(s.size), np.vstack(rows), np.concatenate(bounds), bounds=limits).x


class Rows:
    """Rows a u + b x + c <= 0 of a problem without contacts and without viscous friction."""

    def __init__(self, a, b, c, x_max, feasible=None):
        self.a, self.b, self.c, self.facets = a, b, c, ()
        self.feasible = np.ones(len(a), dtype=bool) if feasible is None else feasible
        self.limits = SimpleNamespace(x_max=x_max, contacts=(), torque=SimpleNamespace(viscous=np.zeros(1)))

    def with_reference(self, reference):
        assert reference.shape == self.limits.x_max.shape
        return self


def limits_of(rows, x_max=np.inf):
    """Smallest and largest x at one grid point with `rows` (a, b, c)."""
    a, b, c = np.array(rows, dtype=float).reshape(-1, 3).T[:, None, :]
    low, high = velocity_limits(Rows(a, b, c, np.array([x_max])))
    return low[0] ** 2, high[0] ** 2


def one_point(rows, x_max=np.inf):
    """Largest x at one grid point with `rows` (a, b, c)."""
    return limits_of(rows, x_max)[1]


# maximum-velocity curve, closed forms ---------------------------------------------------------------------------------


def test_block_on_a_circle_slides_at_mu_g_r():
    """|u| <= mu g and |x r| <= mu g on a circle of radius r: x = mu g / r."""
    mu_g, r = 0.5 * 9.81, 0.8
    rows = [(1, 0, -mu_g), (-1, 0, -mu_g), (0, r, -mu_g), (0, -r, -mu_g)]
    assert one_point(rows) == pytest.approx(mu_g / r, rel=1e-14)


def test_speed_ends_where_the_bounds_of_u_cross():
    """u <= 3 - 2x and u >= x - 3 cross at x = 2."""
    assert one_point([(1, 2, -3), (-1, 1, -3)]) == pytest.approx(2.0, rel=1e-14)


def test_velocity_limit_holds_where_it_is_the_lower_one():
    assert one_point([(1, 2, -3), (-1, 1, -3)], x_max=1.5) == pytest.approx(1.5, rel=1e-15)


def test_rows_that_bound_u_from_one_side_only_leave_the_speed_to_x_max():
    assert one_point([(1, 2, -3), (2, 5, -3)], x_max=7.0) == pytest.approx(7.0, rel=1e-15)
    assert one_point([], x_max=7.0) == pytest.approx(7.0, rel=1e-15)


def test_unlimited_speed_is_infinite():
    assert one_point([(1, 0, -3), (-1, 0, -3)]) == np.inf


@pytest.mark.parametrize(
    "rows",
    [
        [(1, 0, 3), (-1, 0, 3)],  # u <= -3 and u >= 3
        [(1, 1, 3), (-1, 0, 0)],  # u <= -3 - x and u >= 0
        [(0, 0, 1)],  # 1 <= 0
        [(0, 1, 1)],  # x <= -1
        [(0, -1, 9)],  # x >= 9 against x_max = 8
    ],
)
def test_no_speed_is_nan(rows):
    assert np.isnan(one_point(rows, x_max=8.0))


def test_speed_without_standstill_is_found():
    """u >= 1 - x and u <= -1 + x need x >= 1: the tray must move to hold the block."""
    assert limits_of([(-1, -1, 1), (1, -1, 1)], x_max=4.0) == pytest.approx((1.0, 4.0), rel=1e-14)
    assert np.isnan(limits_of([(-1, -1, 1), (1, -1, 1)], x_max=0.5)).all()


def test_robot_may_stand_still_where_no_row_forbids_it():
    assert limits_of([(1, 2, -3), (-1, 1, -3)]) == pytest.approx((0.0, 2.0), rel=1e-14)


def test_point_without_rows_that_hold_has_no_speed():
    feasible = np.array([True, False])
    problem = Rows(np.zeros((2, 1)), np.ones((2, 1)), np.full((2, 1), -4.0), np.full(2, 9.0), feasible)
    np.testing.assert_array_equal(velocity_limits(problem), [[0.0, np.nan], [2.0, np.nan]])


def test_viscous_torque_is_exact_on_the_curve():
    """u >= x and u + D sqrt(x) <= T: x + D sqrt(x) = T at the largest x, wherever the torque was linearised before."""
    d, torque = 3.0, 4.0

    class Viscous(Rows):
        def with_reference(self, reference):
            root = np.sqrt(reference)[:, None]
            slope, offset = np.where(np.isnan(root), [0.0, 0.0], np.hstack([0.5 / root, 0.5 * root])).T
            a, b = np.array([[1.0, -1.0]]), np.array([[d * slope[0], 1.0]])
            return Rows(a, b, np.array([[d * offset[0] - torque, 0.0]]), self.limits.x_max)

    problem = Viscous(np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((1, 0)), np.array([100.0]))
    problem.limits.torque.viscous = np.ones(1)
    low, high = velocity_limits(problem)
    assert high[0] == pytest.approx((-d + np.sqrt(d**2 + 4 * torque)) / 2, rel=1e-6)
    assert low[0] == 0.0


# maximum-velocity curve, oracle ---------------------------------------------------------------------------------------


def test_curve_agrees_with_a_linear_program_on_random_rows():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(60, 12)), rng.normal(size=(60, 12))
    a[rng.random(a.shape) < 0.2] = 0.0
    b[rng.random(b.shape) < 0.2] = 0.0
    c = -rng.random((60, 12)) + 0.3 * (rng.random((60, 1)) < 0.3)
    lowest = rng.uniform(-3.0, 0.0, size=60)
    highest = rng.uniform(0.1, 5.0, size=60)
    found = largest_x(a, b, c, lowest, highest)
    expected = np.full(60, np.nan)
    for k in range(60):
        result = linprog([0, -1], np.stack([a[k], b[k]], axis=1), -c[k], bounds=[(None, None), (lowest[k], highest[k])])
        assert result.status in (0, 2)
        expected[k] = result.x[1] if result.status == 0 else np.nan
    assert 5 < np.isnan(expected).sum() < 55
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


# what the figures show ------------------------------------------------------------------------------------------------


def test_plan_stays_below_the_curve():
    plan = fastest_plan()
    assert np.all(np.sqrt(plan.x) <= velocity_limits(plan.problem)[1] * (1 + 1e-9))


def test_phase_plane_shows_curve_profile_and_limits():
    plan = fastest_plan()
    shares = binding_shares(plan)
    figure = phase_plane(plan, "wave")
    plane, strip = figure.axes
    (curve,) = plane.get_lines()
    np.testing.assert_array_equal(curve.get_ydata(), velocity_limits(plan.problem)[1])
    (profile,) = (item for item in plane.collections if isinstance(item, LineCollection))
    ends = np.array([segment[-1] for segment in profile.get_segments()])
    np.testing.assert_allclose(ends, np.stack([plan.s[1:], np.sqrt(plan.x[1:])], axis=1), atol=1e-12)
    assert plane.get_ylim()[1] > np.sqrt(plan.x.max())
    labels = [label.get_text() for label in strip.get_yticklabels()]
    assert labels == [f"{name}, {percent(share)}" for name, share in shares.items()]


def test_profile_has_the_colour_of_the_limit_with_the_largest_share():
    plan = fastest_plan(1, 12)
    names = ("first", "second")
    plan.active = (("first",),) * 8 + (("second", "first"),) * 2 + (("second",),) * 2 + ((),)
    colours = limit_colours(binding_shares(plan))
    (profile,) = (c for c in phase_plane(plan, "").axes[0].collections if isinstance(c, LineCollection))
    drawn = [to_hex(colour) for colour in profile.get_colors()]
    assert drawn == [colours["first"]] * 10 + [colours["second"]] * 2 + [colours[NO_LIMIT]]
    assert len({colours[name] for name in (*names, NO_LIMIT, OTHER)}) == 4


def test_rare_limits_share_one_colour_and_one_strip():
    plan = fastest_plan(1, 24)
    plan.active = tuple((f"limit {k % 11:02d}",) for k in range(len(plan.u)))
    shares = binding_shares(plan)
    assert len(set(limit_colours(shares).values())) == len(LIMIT_COLOURS) + 2
    labels = [label.get_text() for label in phase_plane(plan, "").axes[1].get_yticklabels()]
    others = sum(list(shares.values())[len(LIMIT_COLOURS) :])
    assert len(labels) == len(LIMIT_COLOURS) + 1
    assert labels[-1] == f"{OTHER}, {percent(others)}"


def test_phase_plane_of_no_plan_shows_where_no_speed_is_admissible():
    plan = no_plan()
    (plane,) = phase_plane(plan, "").axes
    labels = [text.get_text() for text in plane.get_legend().get_texts()]
    assert labels == ["maximum velocity", "no speed is admissible"]
    area = plane.collections[-1].get_paths()[0].get_extents()
    assert (area.x0, area.x1) == pytest.approx((0.175, 0.325))


def test_phase_plane_of_no_plan_shows_stops_where_it_may_not_stand_still():
    """A row x >= 1 at the last grid point, where the robot must stop."""
    plan = no_plan()
    problem, size = plan.problem, plan.s.size
    problem.a, problem.b = np.hstack([problem.a, np.zeros((size, 1))]), np.hstack([problem.b, np.zeros((size, 1))])
    problem.c = np.hstack([problem.c, np.full((size, 1), -1.0)])
    problem.b[-1, -1], problem.c[-1, -1], plan.stuck = -1.0, 1.0, size - 1
    (plane,) = phase_plane(plan, "").axes
    lines = {line.get_label(): line.get_xydata() for line in plane.get_lines()}
    assert set(lines) == {"maximum velocity", "minimum velocity", "must stop, cannot stand still", "conflict at s = 1"}
    np.testing.assert_array_equal(lines["must stop, cannot stand still"], [[1.0, 0.0]])
    assert lines["minimum velocity"][-1] == pytest.approx([1.0, 1.0])
    assert lines["conflict at s = 1"][0, 0] == 1.0


def test_joint_quantities_are_the_trajectory_just_inside_each_interval():
    plan = fastest_plan()
    trajectory = Trajectory.from_plan(plan)
    times, (position, velocity, acceleration, torque) = joint_quantities(plan)
    inside = times + np.tile([1e-9, -1e-9], times.size // 2)
    samples = trajectory.sample(inside)
    np.testing.assert_allclose(position.value, samples.q, atol=1e-7)
    np.testing.assert_allclose(velocity.value, samples.qd, atol=1e-6)
    np.testing.assert_allclose(acceleration.value, samples.qdd, atol=1e-5)
    np.testing.assert_allclose(torque.value, samples.qdd + 5.0, atol=1e-5)
    assert np.abs(acceleration.value).max() == pytest.approx(8.0, rel=1e-6)


def test_robust_limits_are_shrunk_by_what_is_uncertain():
    plan = fastest_plan(error=AccelerationError(mean=0.5, deviation=1.0, K=2.0))
    _, (position, _, acceleration, torque) = joint_quantities(plan)
    assert position.shrunk_limits(0) == []
    lower, upper = acceleration.shrunk_limits(1)
    np.testing.assert_allclose([lower[0], upper[0]], [-8 - 0.5 + 2, 8 - 0.5 - 2])
    np.testing.assert_allclose(
        torque.shrunk_limits(2), np.stack([np.full(lower.size, -18.0), np.full(lower.size, 18.0)])
    )


def test_no_robust_limit_is_drawn_where_nothing_is_uncertain():
    _, quantities = joint_quantities(fastest_plan())
    assert quantities[2].shrunk_limits(0) == []


def test_binding_parts_of_a_joint_are_marked():
    plan = fastest_plan()
    figure = joint_figures(plan, "wave")[0]
    accelerations = figure.axes[6:9]
    for joint, axes in enumerate(accelerations):
        binding = sum(f"joint{joint + 1} acceleration" in active for active in plan.active)
        (marked,) = axes.collections
        assert len(marked.get_segments()) == binding
    assert sum(len(axes.collections[0].get_segments()) for axes in accelerations) > 50


@pytest.mark.parametrize(
    ("robot", "units"),
    [
        ("two_slides", ["m", "m/s", "m/s²", "N"]),
        ("tilting_slide", ["rad, m", "rad/s, m/s", "rad/s², m/s²", "N m, N"]),
    ],
)
def test_joints_that_slide_have_units_of_their_own(robot, units):
    config = scene(robot, objects={"box": FLAT}, path={"joints": [[0.0, 0.0], [0.3, 0.3]]})
    (figure,) = joint_figures(plan_of(config), "sliding")
    rows = [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()]
    assert [row[row.index("[") + 1 : -1] for row in rows] == units


def test_many_joints_take_several_figures():
    figures = joint_figures(fastest_plan(9, 20), "wave")
    assert [len(figure.axes) for figure in figures] == [28, 8]


def test_bars_have_the_length_of_the_shares():
    shares = {"slip of a on tray": 0.6, NO_LIMIT: 0.395, "joint1 velocity": 0.005}
    (axes,) = shares_figure(shares, "").axes
    assert [bar.get_width() for bar in axes.patches] == list(shares.values())
    assert [label.get_text() for label in axes.get_yticklabels()] == list(shares)
    assert [text.get_text() for text in axes.texts] == ["60 %", "40 %", "under 1 %"]


def test_bars_beyond_the_twelfth_are_one():
    shares = {f"limit {k}": 1 / 20 for k in range(20)}
    (axes,) = shares_figure(shares, "").axes
    assert [label.get_text() for label in axes.get_yticklabels()][-1] == "8 more"
    assert sum(bar.get_width() for bar in axes.patches) == pytest.approx(1.0)


# files ----------------------------------------------------------------------------------------------------------------


def test_same_run_gives_the_same_files(tmp_path):
    plan = fastest_plan(2, 20)
    first, second = (write_figures(plan, plan.problem.config, tmp_path / folder) for folder in ("a", "b"))
    names = ["binding", "joints", "phase_plane"]
    assert sorted(path.name for path in first) == sorted(
        f"{name}.{suffix}" for name in names for suffix in ("svg", "png")
    )
    for a, b in zip(first, second, strict=True):
        assert a.read_bytes() == b.read_bytes()
        assert a.read_bytes()[:4] == (b"\x89PNG" if a.suffix == ".png" else b"<?xm")
    assert "<dc:date>" not in (tmp_path / "a" / "phase_plane.svg").read_text()


def test_no_plan_has_a_phase_plane_only(tmp_path):
    plan = no_plan()
    paths = write_figures(plan, plan.problem.config, tmp_path)
    assert [path.name for path in paths] == ["phase_plane.svg", "phase_plane.png"]


def test_users_settings_neither_matter_nor_change():
    with matplotlib.rc_context({"font.size": 31.0}):
        with house_style():
            assert matplotlib.rcParams["font.size"] == 9
            assert matplotlib.rcParams["lines.dashed_pattern"] == matplotlib.rcParamsDefault["lines.dashed_pattern"]
        assert matplotlib.rcParams["font.size"] == 31.0


def test_plotting_leaves_pyplot_alone():
    code = "import sys, robustopt.plotting; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


# a real plan ----------------------------------------------------------------------------------------------------------

WEAK = "robot.limits={all: {torque: 210}, joint5: {torque: 8.8}}"
UNCERTAIN = "uncertainty={contact_points: 0.002, joint_acceleration: {mean: 0.1, deviation: 0.3}}"


@pytest.fixture(scope="module")
def waiter():
    """The two-block waiter with a weak arm by both methods: their rows differ, the limits do not."""
    file = Path(__file__).parents[1] / "configs" / "waiter_two_blocks.yaml"
    problem = build_problem(load_config(file, overrides=["solver.collocation_points=60", WEAK, UNCERTAIN]))
    return {method: solve(problem, method) for method in ("reachability", "ipopt")}


def test_curve_of_a_real_plan_does_not_depend_on_the_method(waiter):
    curves = [velocity_limits(plan.problem)[1] for plan in waiter.values()]
    np.testing.assert_allclose(*curves, rtol=1e-3)
    for curve, plan in zip(curves, waiter.values(), strict=True):
        assert np.all(np.sqrt(plan.x) <= curve * (1 + 1e-4))


def test_no_speed_is_admissible_where_the_curves_would_cross():
    """A weak joint: the exact viscous torque takes the maximum velocity below the minimum velocity."""
    file = Path(__file__).parents[1] / "configs" / "waiter_two_blocks.yaml"
    weak = ["solver.collocation_points=60", "robot.limits={joint2: {torque: 20}}"]
    low, high = velocity_limits(build_problem(load_config(file, overrides=weak)))
    assert np.array_equal(np.isnan(low), np.isnan(high))
    some = ~np.isnan(low)
    assert some.any()
    assert np.all(low[some] <= high[some])


def test_torque_that_binds_touches_its_robust_limit(waiter):
    plan = waiter["reachability"]
    quantities = {quantity.name: quantity for quantity in joint_quantities(plan)[1]}
    assert any("joint5 torque" in active for active in plan.active)
    torque = quantities["torque"]
    lower, upper = torque.shrunk_limits(4)
    assert np.all(upper < 8.8)
    assert np.max(torque.value[:, 4] - upper) == pytest.approx(0.0, abs=1e-3 * 8.8)
    assert np.min(torque.value[:, 4] - lower) > 0.0


def test_acceleration_stays_within_its_robust_limits(waiter):
    plan = waiter["reachability"]
    acceleration = joint_quantities(plan)[1][2]
    for joint in range(6):
        lower, upper = acceleration.shrunk_limits(joint)
        assert np.all((acceleration.value[:, joint] >= lower - 1e-6) & (acceleration.value[:, joint] <= upper + 1e-6))


def test_contact_utilisation_is_that_of_closed_forms():
    """At level acceleration a block slips at mu g, and tips at g half / height of its centre of mass."""
    plan = plan_of(scene("slide", objects={"box": FLAT}, contact={"friction": 0.3}))
    (group,) = contact_utilisation(plan)
    a = np.abs(plan.u) / 9.81
    assert list(group) == ["slip of box on tray", "tipping of box over tray"]
    np.testing.assert_allclose(group["slip of box on tray"], a / 0.3, atol=1e-9)
    np.testing.assert_allclose(group["tipping of box over tray"], a * 0.01 / 0.1, atol=1e-9)
    assert group["slip of box on tray"].max() == pytest.approx(1.0)


@pytest.mark.parametrize(
    "name", ["waiter_two_blocks", "waiter_bridge", "pick_suction", "pick_gripper", "humanoid_step"]
)
def test_contact_limits_that_bind_touch_all_of_their_limit(name):
    file = Path(__file__).parents[1] / "configs" / f"{name}.yaml"
    plan = solve(build_problem(load_config(file, overrides=["solver.collocation_points=40"])))
    used = {limit: part for group in contact_utilisation(plan) for limit, part in group.items()}
    binding = {limit for active in plan.active for limit in active} & used.keys()
    assert binding
    for limit, part in used.items():
        assert np.nanmax(part) <= 1 + 1e-4
        if limit in binding:
            assert np.nanmax(part) == pytest.approx(1.0, abs=2e-4)


KINDS = (("slip", "on"), ("tipping", "over"))


def test_contacts_figure_names_the_limits_in_the_colours_of_the_other_figures(waiter):
    plan = waiter["reachability"]
    with house_style():
        figure = contacts_figure(plan, "waiter")
    colours = limit_colours(binding_shares(plan))
    lines = [line for axes in figure.axes for line in axes.get_lines()[1:]]
    drawn = {line.get_label().rsplit(", up to", 1)[0]: line.get_color() for line in lines}
    lower, upper = "lower {} tray", "upper {} lower"
    assert list(drawn) == [f"{kind} of {pair.format(word)}" for pair in (lower, upper) for kind, word in KINDS]
    for limit, colour in drawn.items():
        assert colour == colours.get(limit, DARK_GREY)


def test_real_plan_is_drawn(waiter, tmp_path):
    plan = waiter["ipopt"]
    paths = write_figures(plan, plan.problem.config, tmp_path)
    assert [path.name for path in paths] == [
        f"{name}.{suffix}" for name in ("phase_plane", "joints", "contacts", "binding") for suffix in ("svg", "png")
    ]
