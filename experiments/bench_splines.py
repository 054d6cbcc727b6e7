"""Time random splines of seven joints, with and without jerk limits, beside copp-py.

    python experiments/bench_splines.py [--paths 100] [--out results/benchmarks]

Writes splines.csv and splines.md in a few minutes.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import copp_py
import numpy as np
from copp_py.interpolation import s_to_t_topp3
from copp_py.solver import topp2_ra, topp3_socp

from robustopt.certificate import certify
from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.limits.grid import numbered_grid
from robustopt.path import Path as JointPath
from robustopt.path import build_path
from robustopt.robot import JointLimits, load_robot
from robustopt.solvers import Plan, Status, solve
from robustopt.solvers.build import build_rows
from robustopt.solvers.plan import duration_of
from robustopt.solvers.trajectory import Trajectory
from robustopt.tables import Column, Table, csv_text, markdown_text

ROOT = Path(__file__).resolve().parents[1]

JOINTS, WAYPOINTS, REACH, INTERVALS = 7, 50, 0.5, 1000
"""Numbers of joints and of waypoints, largest joint position [rad], and number of grid intervals."""

LIMITS = {"velocity": 1.0, "acceleration": 5.0, "jerk": 50.0}
"""Limits of the joints, each times a random factor within SPREAD of 1 [rad/s, rad/s^2, rad/s^3]."""

SPREAD = 0.1

BETWEEN = np.linspace(0.0, 1.0, 12)[1:-1]
"""Places between neighbouring grid points at which limits are checked, as parts of an interval."""

COLUMNS = (
    Column("limits", "limits"),
    Column("solver", "solver"),
    Column("rows", "rows [ms]", ".2f"),
    Column("solution", "solution [ms]", ".2f"),
    Column("duration", "duration [s]", ".3f"),
    Column("longer", "longer than the shortest [%]", ".3f"),
    Column("excess", "beyond a limit between grid points [%]", ".1f"),
    Column("certificates", "certificates passed", ".0f"),
)

TEXT = """# Random splines beside copp-py

Written by `python experiments/bench_splines.py`.

{table}
- {paths} cubic splines through {waypoints} random waypoints of {joints} joints within {reach:g} rad; velocity,
  acceleration and jerk limits of 1 rad/s, 5 rad/s² and 50 rad/s³, each within 10 %; {intervals} intervals. All solvers
  have the same path, and all times are medians of the CPU time in one process, one spline after the other.
- "Rows" is the time from the path to the rows of the program, with the derivatives of the path; "solution" is the call
  of the solver.
- "Duration" is the median. copp-py's is by its own integration of its timing. "Longer" is the median of the excess over
  the shorter of the two durations of a spline.
- "Beyond a limit" is the largest excess of any limit at ten places between neighbouring grid points on any spline; a
  certificate accepts 1 %. copp-py's first and last interval, where it applies no jerk limit, do not count.
"""

ARM = """<mujoco model="arm"><compiler angle="radian" autolimits="true"/><worldbody>{links}</worldbody></mujoco>"""
LINK = """<body name="link{k}" pos="0 0 0.1"><joint name="joint{k}" type="hinge" axis="{axis}" range="-9 9"/>
<inertial pos="0 0 0.05" mass="1" diaginertia="0.01 0.01 0.01"/>{next}</body>"""


def main() -> None:
    """Time all splines, and write the table."""
    parser = argparse.ArgumentParser(description="Times random splines with and without jerk limits beside copp-py.")
    parser.add_argument("--paths", type=int, default=100, help="number of splines")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder for the table")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        write_arm(Path(folder) / "arm.xml")
        found = [compare(configuration(Path(folder), number)) for number in range(-1, arguments.paths)][1:]
    table = Table(COLUMNS, tuple(record(found, limits, solver) for limits in found[0] for solver in found[0][limits]))
    (arguments.out / "splines.csv").write_text(csv_text(table), encoding="utf-8")
    text = TEXT.format(
        table=markdown_text(table), paths=len(found), waypoints=WAYPOINTS, joints=JOINTS, reach=REACH,
        intervals=INTERVALS,
    )  # fmt: skip
    (arguments.out / "splines.md").write_text(text, encoding="utf-8")


def write_arm(file: Path) -> None:
    """Write the model of an arm whose joints turn about z and y in turn."""
    links = '<site name="tool"/>'
    for k in range(JOINTS, 0, -1):
        links = LINK.format(k=k, axis="0 0 1" if k % 2 else "0 1 0", next=links)
    file.write_text(ARM.format(links=links), encoding="utf-8")


def configuration(folder: Path, number: int) -> Config:
    """Return the configuration of one spline; its number is the seed, and -1 is a spline to warm up."""
    rng = np.random.default_rng(number + 1)
    waypoints = rng.uniform(-REACH, REACH, (WAYPOINTS, JOINTS))
    factors = rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, (JOINTS, len(LIMITS)))
    limits = {
        f"joint{j + 1}": {kind: float(factor * LIMITS[kind]) for kind, factor in zip(LIMITS, factors[j], strict=True)}
        | {"torque": np.inf}
        for j in range(JOINTS)
    }
    data: dict[str, Any] = {
        "name": "splines",
        "folder": folder,
        "robot": {"model": "arm.xml", "tool": "tool", "collision": {"check": False}, "limits": limits},
        "objects": {},
        "path": {"joints": waypoints.tolist()},
        "solver": {"method": "reachability", "collocation_points": INTERVALS},
    }
    return with_values(Config.model_validate(data), {})


def compare(config: Config) -> dict[str, dict[str, dict[str, float]]]:
    """Return figures of one spline by the limits and the solver."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for kinds in (("velocity", "acceleration"), tuple(LIMITS)):
        jerk = "jerk" in kinds
        own = config if jerk else without_jerk(config)
        robot = load_robot(own)
        path = build_path(own, robot)
        rows, problem = timed(lambda: build_rows(own, robot, path))  # noqa: B023
        solution, plan = timed(lambda: solve(problem))  # noqa: B023
        assert plan.status is Status.SOLVED, plan.message
        ours = {"rows": rows, "solution": solution, "duration": plan.duration, "excess": our_excess(plan, jerk)}
        ours["certificates"] = float(certify(plan).passed)
        s = numbered_grid(path, INTERVALS).s
        found[", ".join(kinds)] = {"robustopt": ours, "copp-py": copp(s, path, robot.limits, jerk)}
    print({limits: {name: one["duration"] for name, one in both.items()} for limits, both in found.items()}, flush=True)
    return found


def without_jerk(config: Config) -> Config:
    """Return a configuration whose jerk is not limited."""
    return with_values(config, {f"robot.limits.joint{j + 1}.jerk": np.inf for j in range(JOINTS)})


def copp(s: np.ndarray, path: JointPath, limits: JointLimits, jerk: bool) -> dict[str, float]:
    """Return the figures of copp-py: TOPP2-RA, and with jerk limits TOPP3-SOCP about its timing."""
    arm = copp_py.Robot.point_mass(JOINTS)
    count = len(s)

    def rows() -> topp2_ra.Problem:
        derivatives = [path(s, order) for order in range(4)]
        arm.append_s(s)
        arm.set_q(*derivatives[:3], 0, dddq=derivatives[3])
        arm.add_velocity_limits(limits.velocity, -limits.velocity, start_idx_s=0, length=count)
        arm.add_acceleration_limits(limits.acceleration, -limits.acceleration, start_idx_s=0, length=count)
        return topp2_ra.Problem(arm.constraints, (0, count - 1), (0.0, 0.0))

    building, problem = timed(rows)
    solution, found = timed(lambda: topp2_ra.solve(problem))
    a = np.asarray(found)
    if not jerk:
        b = np.diff(a) / (2.0 * np.diff(s))
        excess = between(s, a, b, b, path, limits, jerk)
        return {"rows": building, "solution": solution, "duration": duration_of(np.diff(s), a), "excess": excess}
    arm.add_jerk_limits(limits.jerk, -limits.jerk, start_idx_s=0, length=count)
    more, profile = timed(lambda: topp3_socp.solve(topp3_socp.Problem(arm.constraints, a)))
    a, b = np.asarray(profile.a), np.asarray(profile.b)
    excess = between(s, a, b[:-1], b[1:], path, limits, jerk)
    duration = float(s_to_t_topp3(s, profile)[0])
    return {"rows": building, "solution": solution + more, "duration": duration, "excess": excess}


def our_excess(plan: Plan, jerk: bool) -> float:
    """Return the largest excess of a plan over its limits between grid points, as a fraction of the limit."""
    trajectory = Trajectory.from_plan(plan)
    interval = np.repeat(np.arange(len(trajectory.sdd)), len(BETWEEN))
    step = np.diff(trajectory.times)[interval]
    at = trajectory.sample(trajectory.times[interval] + np.tile(BETWEEN, len(trajectory.sdd)) * step)
    rate = trajectory.sddd[interval]
    return largest(plan.problem.path, plan.problem.robot.limits, at.s, at.sd, at.sdd, rate, jerk)


def between(
    s: np.ndarray, a: np.ndarray, b: np.ndarray, b_end: np.ndarray, path: JointPath, limits: JointLimits, jerk: bool
) -> float:
    """Return the largest excess between grid points of a timing a = sd^2 whose b = sdd is linear on each interval."""
    ds, part = np.diff(s)[:, None], BETWEEN[None, :]
    sdd = b[:, None] + part * (b_end - b)[:, None]
    speed = np.sqrt(np.maximum(a[:-1, None] + 2.0 * ds * part * (b[:, None] + sdd) / 2.0, 0.0))
    rate = (b_end - b)[:, None] / ds * speed
    inner = slice(1, -1) if jerk else slice(None)
    at = [values[inner].ravel() for values in (s[:-1, None] + part * ds, speed, sdd, rate)]
    return largest(path, limits, *at, jerk)


def largest(
    path: JointPath, limits: JointLimits, s: np.ndarray, sd: np.ndarray, sdd: np.ndarray, sddd: np.ndarray, jerk: bool
) -> float:
    """Return the largest excess of the joints over their limits, as a fraction of the limit."""
    q1, q2, q3 = (path(s, order) for order in (1, 2, 3))
    sd, sdd, sddd = sd[:, None], sdd[:, None], sddd[:, None]
    used = [np.abs(q1 * sd) / limits.velocity, np.abs(q1 * sdd + q2 * sd**2) / limits.acceleration]
    if jerk:
        used.append(np.abs(q3 * sd**3 + 3.0 * q2 * sd * sdd + q1 * sddd) / limits.jerk)
    return float(max(values.max() for values in used)) - 1.0


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the CPU time of a call [s] and its result."""
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def record(found: list[dict[str, dict[str, dict[str, float]]]], limits: str, solver: str) -> dict[str, object]:
    """Return the row of the table of a solver."""
    own = [one[limits][solver] for one in found]
    shortest = np.array([min(other["duration"] for other in one[limits].values()) for one in found])
    duration = np.array([one["duration"] for one in own])
    passed = [one.get("certificates", np.nan) for one in own]
    return {
        "limits": limits,
        "solver": solver,
        "rows": 1e3 * float(np.median([one["rows"] for one in own])),
        "solution": 1e3 * float(np.median([one["solution"] for one in own])),
        "duration": float(np.median(duration)),
        "longer": 100.0 * float(np.median(duration / shortest - 1.0)),
        "excess": 100.0 * max(0.0, *(one["excess"] for one in own)),
        "certificates": None if np.isnan(passed).any() else float(np.sum(passed)),
    }


if __name__ == "__main__":
    main()
