"""Files of a motion in one of several formats, by the name of the format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from robustopt.errors import ConfigError, RunFolderError
from robustopt.exports.cycles import Motion, at_jerk_steps, whole_cycles
from robustopt.exports.messages import joint_trajectory, robot_trajectory, write_message
from robustopt.exports.quintics import largest_jerk
from robustopt.exports.tables import write_csv
from robustopt.exports.urscript import STEP, program
from robustopt.files import reason, write_text, written
from robustopt.solvers import Plan

Format = Literal["csv", "ros", "moveit", "urscript", "npz"]

NAMES: Mapping[Format, tuple[str, str]] = {
    "csv": ("trajectory", ".csv"),
    "ros": ("joint_trajectory", ".json"),
    "moveit": ("robot_trajectory", ".json"),
    "urscript": ("trajectory", ".script"),
    "npz": ("trajectory", ".npz"),
}
"""First part and suffix of the names of files, between which the period stands."""

JERK_TOLERANCE = 0.01
"""Part of its limit by which the jerk between samples may exceed it without a remedy: what a certificate accepts."""


@dataclass(frozen=True)
class Exported:
    """An exported motion.

    Attributes:
        file: name of the file.
        format: format of the file.
        period: time between samples, where the jerk steps the longest one [s].
        at_jerk_steps: whether there is a sample at every step of the jerk.
        samples: number of samples.
        planned: duration of the plan [s].
        duration: duration of the motion in the file [s].
        jerk: largest jerk of polynomials of fifth degree between the samples, as a share of its limit; None without
            jerk limits, or if the file has positions alone.
        notes: remarks on differences from the plan.
    """

    file: Path
    format: Format
    period: float
    at_jerk_steps: bool
    samples: int
    planned: float
    duration: float
    jerk: float | None
    notes: tuple[str, ...]


def export_plan(plan: Plan, format: Format, period: float | None, out: Path | str | None, folder: Path) -> Exported:
    """Write a plan at every control cycle; see `robustopt.export`.

    Args:
        plan: a plan with a timing.
        format: format of the file.
        period: time between samples [s]; default: `output.period`.
        out: name of the file; default: a name in `folder` with the period in it.
        folder: folder of the file, unless `out` is given.

    Raises:
        Infeasible: the plan has no timing.
        ConfigError: the format is unknown or does not suit the robot, or the period is not positive or too short.
        RunFolderError: the file cannot be written.
    """
    if format not in get_args(Format):
        raise ConfigError(f"found {format!r}; expected one of {', '.join(get_args(Format))}", key="format")
    motion = _motion(plan, format, period)
    stem, suffix = NAMES[format]
    between = "jerk_steps" if motion.at_jerk_steps else f"{motion.period:.6g}s"
    file = folder / f"{stem}_{between}{suffix}" if out is None else Path(out)
    notes, jerk = motion.notes, None
    if format == "urscript":
        notes += _suits_universal_robots(plan, motion.period)
    elif not plan.steady:
        jerk, said = _jerk(plan, motion)
        notes += (said,)
    try:
        _WRITERS[format](motion, file)
    except OSError as error:
        raise RunFolderError(f"{file}: cannot be written: {error.strerror or reason(error)}") from error
    samples, at_steps = len(motion.samples.t), motion.at_jerk_steps
    return Exported(file, format, motion.period, at_steps, samples, motion.planned, motion.duration, jerk, notes)


def _motion(plan: Plan, format: Format, period: float | None) -> Motion:
    """Return the motion of a file: at the steps of the jerk if the format has times and no period is given."""
    usual = plan.problem.config.output.period
    if period is None and format in ("ros", "moveit") and not plan.steady:
        return at_jerk_steps(plan, usual)
    return whole_cycles(plan, usual if period is None else period)


def _jerk(plan: Plan, motion: Motion) -> tuple[float, str]:
    """Return the largest jerk of polynomials of fifth degree between samples, as a share of its limit and in words."""
    robot = plan.problem.robot
    shares = largest_jerk(motion.samples) / robot.limits.jerk
    worst = int(np.argmax(shares))
    jerk = float(shares[worst])
    said = (
        f"polynomials of fifth degree between the samples, as in ROS controllers, reach {100 * jerk:.1f} % of the jerk "
        f"limit of {robot.joint_names[worst]}"
    )
    if jerk > 1.0 + JERK_TOLERANCE:
        said += "; the formats ros and moveit without a period have a sample at every step of the jerk"
    return jerk, said


def _suits_universal_robots(plan: Plan, period: float) -> tuple[str, ...]:
    """Return a note if the controllers have no cycles of a period; raise an error for another kind of robot."""
    robot = plan.problem.robot
    if robot.n != 6 or not robot.hinges.all() or robot.base:
        joints = ", ".join(robot.joint_names)
        message = f"urscript is for arms with six revolute joints; the robot has {joints}"
        raise ConfigError(f"{message}; expected csv, ros, moveit or npz", key="format")
    if abs(period / STEP - round(period / STEP)) > 1e-6:
        return (f"the controllers have cycles of {1000 * STEP:g} ms; expected a period that is a multiple of it",)
    return ()


def _write_csv(motion: Motion, path: Path) -> None:
    write_csv(motion.samples, motion.joint_names, path)


def _write_ros(motion: Motion, path: Path) -> None:
    write_message(joint_trajectory(motion.samples, motion.joint_names), path)


def _write_moveit(motion: Motion, path: Path) -> None:
    write_message(robot_trajectory(motion.samples, motion.joint_names), path)


def _write_urscript(motion: Motion, path: Path) -> None:
    write_text(path, program(motion))


def _write_npz(motion: Motion, path: Path) -> None:
    s = motion.samples
    with written(path) as beside, beside.open("wb") as file:
        np.savez(file, t=s.t, q=s.q, qd=s.qd, qdd=s.qdd, joint_names=np.array(motion.joint_names))


_WRITERS: Mapping[Format, Callable[[Motion, Path], None]] = {
    "csv": _write_csv,
    "ros": _write_ros,
    "moveit": _write_moveit,
    "urscript": _write_urscript,
    "npz": _write_npz,
}
