"""Trajectories against closed forms: the double integrator, constant speed, stops, and exports that read back."""

from __future__ import annotations

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest

from robustopt.errors import ConfigError, Infeasible, SolverFailed
from robustopt.exports.messages import joint_trajectory
from robustopt.exports.tables import write_plan_csv, write_trajectory_csv
from robustopt.solvers.trajectory import (
    Trajectory,
    binding_shares,
    interval_durations,
    sample_times,
)


class LinePath:
    """One joint per number in `lengths`: q = length s + offset of the piece, so q' jumps from piece to piece."""

    def __init__(self, lengths):
        self.lengths = np.atleast_2d(lengths)  # (pieces, joints)

    def evaluate(self, s, piece, order=0):
        slope = self.lengths[piece]
        return (s[:, None] * slope, slope, np.zeros_like(slope))[order]


class WavePath:
    """Two joints on a smooth curve: q = (sin 3s, s^2 + 2s)."""

    def evaluate(self, s, piece, order=0):
        zero, one = np.zeros_like(s), np.ones_like(s)
        return (
            np.stack([np.sin(3 * s), s**2 + 2 * s], axis=1),
            np.stack([3 * np.cos(3 * s), 2 * s + 2], axis=1),
            np.stack([-9 * np.sin(3 * s), 2 * one + zero], axis=1),
        )[order]


def make_plan(s, x, path, piece=None, active=None):
    s, x = np.asarray(s, dtype=float), np.asarray(x, dtype=float)
    piece = np.zeros(s.size, dtype=int) if piece is None else np.asarray(piece)
    u = np.divide(np.diff(x), 2 * np.diff(s), out=np.zeros(s.size - 1), where=np.diff(s) > 0)
    n = path.evaluate(s, piece).shape[1]
    robot = SimpleNamespace(joint_names=tuple(f"joint{k + 1}" for k in range(n)), n=n)
    active = tuple(() for _ in u) if active is None else active
    problem = SimpleNamespace(path=path, robot=robot, pauses=np.zeros(s.size - 1))
    return SimpleNamespace(s=s, x=x, u=u, piece=piece, active=active, message="", problem=problem, steady=True)


def bang_bang_plan(acceleration=4.0, intervals=10):
    """Double integrator over one unit of length: x = 2 a s up to the middle, then 2 a (1 - s)."""
    s = np.linspace(0, 1, intervals + 1)
    return make_plan(s, 2 * acceleration * np.minimum(s, 1 - s), LinePath([1.0]))


def two_sweeps_plan(path=None):
    """Out and back with a stop at s = 1/2, a doubled grid point, each half bang-bang."""
    half = np.linspace(0, 0.5, 9)
    s = np.concatenate([half, 0.5 + half])
    x = np.tile(2 * 3.0 * np.minimum(half, 0.5 - half), 2)
    piece = np.repeat([0, 1], half.size)
    return make_plan(s, x, path or LinePath([[2.0], [-2.0]]), piece)


def wave_plan():
    s = np.linspace(0, 1, 41) ** 1.3
    return make_plan(s, 0.5 + np.sin(7 * s) ** 2 - 0.3 * s, WavePath())


# closed forms ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", [0.5, 4.0, 90.0])
def test_bang_bang_takes_the_double_integrators_time(acceleration):
    trajectory = Trajectory.from_plan(bang_bang_plan(acceleration))
    assert trajectory.duration == pytest.approx(2 * np.sqrt(1 / acceleration), rel=1e-14)


def test_bang_bang_position_is_the_double_integrators_at_every_time():
    trajectory = Trajectory.from_plan(bang_bang_plan(4.0))
    t = np.linspace(0, 1, 333)
    samples = trajectory.sample(t)
    first = t < 0.5
    np.testing.assert_allclose(samples.s, np.where(first, 2 * t**2, 1 - 2 * (1 - t) ** 2), atol=1e-14)
    np.testing.assert_allclose(samples.sd, np.where(first, 4 * t, 4 * (1 - t)), atol=1e-13)
    np.testing.assert_allclose(samples.sdd, np.where(first, 4, -4), rtol=1e-12)
    np.testing.assert_array_equal(samples.t, t)


def test_constant_speed():
    s = np.array([0.0, 0.1, 0.4, 1.0])
    trajectory = Trajectory.from_plan(make_plan(s, np.full(4, 0.25), LinePath([3.0, -1.0])))
    assert trajectory.duration == pytest.approx(2.0, rel=1e-15)
    t = np.linspace(0, 2, 17)
    samples = trajectory.sample(t)
    np.testing.assert_allclose(samples.s, t / 2, atol=1e-15)
    np.testing.assert_allclose(samples.qd, np.tile([1.5, -0.5], (17, 1)), atol=1e-15)
    np.testing.assert_array_equal(samples.qdd, 0)


@pytest.mark.parametrize("change", [1e-9, -1e-9, 1e-15, 0.0])
def test_nearly_constant_speed_loses_no_accuracy(change):
    trajectory = Trajectory.from_plan(make_plan([0.0, 1.0], [1.0, 1.0 + change], LinePath([1.0])))
    assert trajectory.duration == pytest.approx(1 - change / 4, rel=1e-15)
    assert trajectory.sample(0.5).s[0] == pytest.approx(0.5 + change / 16, rel=1e-15)
    assert trajectory.sample(trajectory.duration).s[0] == 1.0


def test_start_from_rest_on_one_interval():
    """x = 2 u s over [0, 1]: s = u t^2 / 2."""
    trajectory = Trajectory.from_plan(make_plan([0.0, 1.0], [0.0, 6.0], LinePath([1.0])))
    assert trajectory.duration == pytest.approx(np.sqrt(2 / 3), rel=1e-15)
    t = np.linspace(0, trajectory.duration, 50)
    np.testing.assert_allclose(trajectory.sample(t).s, 1.5 * t**2, atol=1e-15)


def test_stop_takes_no_time_and_changes_the_branch():
    trajectory = Trajectory.from_plan(two_sweeps_plan())
    half = 2 * np.sqrt(0.5 / 3.0)
    assert trajectory.duration == pytest.approx(2 * half, rel=1e-14)
    samples = trajectory.sample(np.array([half - 0.01, half, half + 0.01]))
    np.testing.assert_allclose(samples.s, [0.5 - 1.5 * 0.01**2, 0.5, 0.5 + 1.5 * 0.01**2], atol=1e-14)
    np.testing.assert_allclose(samples.sd, [0.03, 0, 0.03], atol=1e-12)
    np.testing.assert_allclose(samples.qd[:, 0], [0.06, 0, -0.06], atol=1e-12)
    np.testing.assert_allclose(samples.qdd[:, 0], [-6, -6, -6], rtol=1e-9)


def test_stop_doubled_by_rounding_only_takes_no_time():
    plan = two_sweeps_plan()
    exact = Trajectory.from_plan(plan).duration
    plan.s = plan.s.copy()
    plan.s[9] += 1e-16
    plan.x = plan.x + 1e-18
    assert Trajectory.from_plan(plan).duration == pytest.approx(exact, rel=1e-7)


def test_negative_rounding_of_x_at_rest_is_rest():
    plan = bang_bang_plan()
    plan.x = plan.x.copy()
    plan.x[[0, -1]] = -1e-17
    assert Trajectory.from_plan(plan).duration == pytest.approx(1.0, rel=1e-14)


def test_interval_durations_are_those_of_uniform_acceleration():
    np.testing.assert_allclose(
        interval_durations(np.array([0, 1.0, 1.0, 3.0]), np.array([0, 2.0, 2.0, 2.0])), [1, 0, 1]
    )


# properties -----------------------------------------------------------------------------------------------------------


def test_grid_times_give_the_grid_back():
    plan = wave_plan()
    trajectory = Trajectory.from_plan(plan)
    samples = trajectory.sample(trajectory.times)
    np.testing.assert_allclose(samples.s, plan.s, atol=1e-15)
    np.testing.assert_allclose(samples.sd, np.sqrt(plan.x), rtol=1e-12)
    np.testing.assert_allclose(samples.sdd[:-1], plan.u, rtol=1e-9)


def test_duration_is_the_trapezoidal_sum():
    plan = wave_plan()
    sd = np.sqrt(plan.x)
    expected = np.sum(2 * np.diff(plan.s) / (sd[:-1] + sd[1:]))
    assert Trajectory.from_plan(plan).duration == pytest.approx(expected, rel=1e-14)


def test_joint_rates_are_the_derivatives_of_position():
    trajectory = Trajectory.from_plan(wave_plan())
    middles = 0.5 * (trajectory.times[:-1] + trajectory.times[1:])
    h = 1e-5
    before, now, after = (trajectory.sample(middles + step) for step in (-h, 0.0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), now.qd, atol=1e-8)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * h), now.qdd, atol=1e-7)


@pytest.mark.parametrize("speed", [0.5, 1.0, 1.05])
def test_speed_scales_time_uniformly(speed):
    plan = two_sweeps_plan()
    nominal, run = Trajectory.from_plan(plan), Trajectory.from_plan(plan, speed=speed)
    assert run.duration == pytest.approx(nominal.duration / speed, rel=1e-14)
    t = np.linspace(0.013, run.duration - 0.017, 101)
    a, b = nominal.sample(t * speed), run.sample(t)
    np.testing.assert_allclose(b.q, a.q, atol=1e-13)
    np.testing.assert_allclose(b.qd, a.qd * speed, atol=1e-12)
    np.testing.assert_allclose(b.qdd, a.qdd * speed**2, rtol=1e-9)


def test_robot_holds_before_the_start_and_after_the_end():
    trajectory = Trajectory.from_plan(make_plan([0.0, 1.0], [1.0, 1.0], LinePath([2.0])))
    samples = trajectory.sample(np.array([-0.5, 0.0, 1.0, 7.0]))
    np.testing.assert_array_equal(samples.q[:, 0], [0, 0, 2, 2])
    np.testing.assert_array_equal(samples.qd[:, 0], [0, 2, 2, 0])
    np.testing.assert_array_equal(samples.t, [-0.5, 0.0, 1.0, 7.0])


def test_gridpoint_states_brake_before_a_stop_and_start_after_it():
    samples = Trajectory.from_plan(two_sweeps_plan()).at_gridpoints()
    assert samples.t[8] == samples.t[9]
    np.testing.assert_array_equal(samples.sd[[0, 8, 9, 17]], 0)
    np.testing.assert_allclose(samples.sdd[[0, 8, 9, 17]], [3, -3, 3, -3], rtol=1e-12)


def test_trajectory_is_read_only():
    trajectory = Trajectory.from_plan(bang_bang_plan())
    with pytest.raises(ValueError, match="read-only"):
        trajectory.sd[0] = 1.0


# misuse ---------------------------------------------------------------------------------------------------------------


def test_empty_plan_has_no_trajectory():
    plan = bang_bang_plan()
    plan.x, plan.message = np.empty(0), "slip of box on tray at s = 0.3"
    with pytest.raises(Infeasible, match=r"slip of box on tray at s = 0\.3"):
        Trajectory.from_plan(plan)


def test_plan_that_never_moves_on_is_an_error():
    with pytest.raises(SolverFailed, match=r"rests at s = 0\.5 and at s = 0\.75"):
        Trajectory.from_plan(make_plan([0, 0.5, 0.75, 1], [1, 0, 0, 1], LinePath([1.0])))


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf])
def test_speed_must_be_positive(speed):
    with pytest.raises(ConfigError, match=r"speed: .*expected a number above 0"):
        Trajectory.from_plan(bang_bang_plan(), speed=speed)


# sample times ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("duration", "period", "expected"),
    [
        (1.0, 0.25, [0, 0.25, 0.5, 0.75, 1.0]),
        (1.0, 0.4, [0, 0.4, 0.8, 1.0]),
        (0.3, 0.1, [0, 0.1, 0.2, 0.3]),
        (1.0 + 1e-9, 0.5, [0, 0.5, 1.0 + 1e-9]),
        (1.0 - 1e-9, 0.5, [0, 0.5, 1.0 - 1e-9]),
        (0.1, 1.0, [0, 0.1]),
        (0.0001, 1.0, [0, 0.0001]),
    ],
)
def test_sample_times_end_exactly_at_the_end(duration, period, expected):
    times = sample_times(duration, period)
    np.testing.assert_allclose(times, expected, rtol=1e-15)
    assert times[-1] == duration


@pytest.mark.parametrize("period", [0.0, -0.001, np.nan, np.inf])
def test_period_must_be_positive(period):
    with pytest.raises(ConfigError, match=r"period: .*expected a number above 0"):
        sample_times(1.0, period)


def test_period_far_too_short_is_an_error_rather_than_a_full_memory():
    with pytest.raises(ConfigError, match="more than 1,000,000 samples"):
        sample_times(1.0, 1e-12)


# binding shares -------------------------------------------------------------------------------------------------------


def test_shares_divide_each_intervals_time_equally():
    """Four intervals of a quarter of the time each at constant speed."""
    active = (("slip", "tipping"), ("slip",), (), ("joint2 velocity",))
    plan = make_plan(np.linspace(0, 1, 5), np.ones(5), LinePath([1.0]), active=active)
    shares = binding_shares(plan)
    assert shares == pytest.approx({"slip": 0.375, "joint2 velocity": 0.25, "no limit": 0.25, "tipping": 0.125})
    assert list(shares) == ["slip", "joint2 velocity", "no limit", "tipping"]


def test_shares_are_of_time_and_not_of_length():
    """The first half of the length at speed 1, the second at speed 3 (after an interval of no length)."""
    active = (("slow",), ("stop",), ("fast",))
    plan = make_plan([0, 0.5, 0.5, 1], [1, 1, 9, 9], LinePath([1.0]), active=active)
    assert binding_shares(plan) == pytest.approx({"slow": 0.75, "fast": 0.25})


def test_shares_sum_to_one():
    names = ("a", "b", "c")
    rng = np.random.default_rng(0)
    active = tuple(tuple(n for n in names if rng.random() < 0.4) for _ in range(40))
    plan = wave_plan()
    plan.active = active
    shares = binding_shares(plan)
    assert sum(shares.values()) == pytest.approx(1.0, rel=1e-14)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)


# exports --------------------------------------------------------------------------------------------------------------


def message_of(plan, period):
    return joint_trajectory(Trajectory.from_plan(plan).every(period), plan.problem.robot.joint_names)


def read_csv(path):
    with open(path, newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


def test_plan_csv_reads_back_to_the_same_numbers(tmp_path):
    plan = wave_plan()
    write_plan_csv(plan, tmp_path / "plan.csv")
    header, table = read_csv(tmp_path / "plan.csv")
    assert header == [
        *("t", "s", "sd", "sdd"),
        *("q_joint1", "q_joint2", "qd_joint1", "qd_joint2", "qdd_joint1", "qdd_joint2"),
    ]
    samples = Trajectory.from_plan(plan).at_gridpoints()
    np.testing.assert_array_equal(table[:, 1], plan.s)
    np.testing.assert_array_equal(table[:, 0], samples.t)
    np.testing.assert_array_equal(table[:, 4:], np.hstack([samples.q, samples.qd, samples.qdd]))


def test_csv_has_no_negative_zeros(tmp_path):
    write_plan_csv(two_sweeps_plan(LinePath([[-2.0, 1.0], [2.0, 1.0]])), tmp_path / "plan.csv")
    assert "-0.0," not in (tmp_path / "plan.csv").read_text()


def test_trajectory_csv_has_the_controller_period(tmp_path):
    write_trajectory_csv(bang_bang_plan(4.0), 0.3, tmp_path / "trajectory.csv")
    _, table = read_csv(tmp_path / "trajectory.csv")
    np.testing.assert_allclose(table[:, 0], [0, 0.3, 0.6, 0.9, 1.0], rtol=1e-14)
    np.testing.assert_allclose(table[:, 1], [0, 0.18, 0.68, 0.98, 1.0], atol=1e-14)
    np.testing.assert_array_equal(table[[0, -1], 2], 0)
    np.testing.assert_allclose(table[:, 4], table[:, 1])


def test_joint_trajectory_has_the_shape_of_the_ros_message():
    message = json.loads(json.dumps(message_of(two_sweeps_plan(), 0.001)))
    assert set(message) == {"header", "joint_names", "points"}
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert message["joint_names"] == ["joint1"]
    assert set(message["points"][0]) == {"positions", "velocities", "accelerations", "time_from_start"}
    assert message["points"][0]["time_from_start"] == {"sec": 0, "nanosec": 0}
    assert message["points"][-1]["positions"] == pytest.approx([-2.0])
    assert len(message["points"]) == int(np.ceil(4 * np.sqrt(0.5 / 3.0) / 0.001)) + 1


def test_joint_trajectory_times_increase_and_carry_into_seconds():
    plan = make_plan([0.0, 1.0], [0.16, 0.16], LinePath([1.0]))
    times = [point["time_from_start"] for point in message_of(plan, 0.1)["points"]]
    nanoseconds = [time["sec"] * 10**9 + time["nanosec"] for time in times]
    assert nanoseconds == [100_000_000 * k for k in range(26)]
    assert all(0 <= time["nanosec"] < 10**9 for time in times)
    assert times[10] == {"sec": 1, "nanosec": 0}
