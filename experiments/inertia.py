"""Execute plans for boxes whose centre of mass and inertia are unknown, beside plans that know or ignore them.

    python experiments/inertia.py [--heights 0.3 ...] [--points N] [--out results/benchmarks]

Writes inertia.csv and .md from records of the executions, which are kept in results/runs, one file per height and goal:
the same source continues after an interruption. It takes some ten minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from learned import ROOT, bench

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.simulation import Status as Outcome
from robustopt.simulation import execute
from robustopt.solvers import Plan, Status
from robustopt.solvers.batch import BatchPlanner
from robustopt.tables import Column, Table, csv_text, markdown_text

Record = dict[str, Any]

HEIGHTS = (0.3, 0.4, 0.5, 0.6)
"""Heights of the boxes [m]."""

SIDE, MASS, FRICTION = 0.15, 1.0, 0.2
"""Edge of the base [m], mass [kg], and friction of the boxes, known and true."""

REACH, MARGIN = 0.06, 0.08
"""Largest displacement of the centre of mass along x and y, and its least distance from the top and the bottom [m]."""

CENTERS, CORNERS = 15, 4
"""Number of centres of mass per height; the first ones are the upper corners of the interval, the others uniform."""

SCALES = (1.0, 0.5, 0.1)
"""Inertia as parts of that of the same mass at the corners of the box, no axis correlated with another: the largest."""

KNOWN = "contact_points: 0.002, joint_acceleration: {deviation: 0.03}"
"""Other intervals, the same for all plans; with an error of 0.1 rad/s^2 the tallest box has no robust plan."""

GOALS = {
    "sweep": "[{position: [0.75, -0.5, 0.75], yaw: -0.588}, {position: [0.75, 0.5, 0.75], yaw: 0.588}]",
    "turn": "[{position: [0.7, -0.1, 0.3], yaw: -0.8}, {position: [0.7, 0.1, 0.3], yaw: 0.8}]",
    "rise": "[{position: [0.7, -0.3, 0.3], yaw: -1.0}, {position: [0.75, 0.0, 0.5], yaw: 0.6}, "
    "{position: [0.7, 0.3, 0.3], yaw: -0.4}]",
}
"""Poses of the tray: the paper's sweep; 0.2 m with a turn of 1.6 rad; over an obstacle, turning there and back."""

WRIST = 2.0
"""Largest speed of joint 4, whose viscous friction takes all of its torque at 2.5 rad/s [rad/s]."""

CONTROLLERS = ("gravity", "computed_torque")
"""Values of `execution.controller.feedforward`; the first one is the default."""

IGNORANT, KNOWING, ROBUST = "nominal", "known centre", "robust"

COLUMNS = (
    Column("feedforward", "feedforward"),
    Column("height", "height [m]", ".1f"),
    Column("plan", "plan"),
    Column("plans", "plans"),
    Column("executions", "executions"),
    Column("failures", "failures"),
    Column("tipped", "tipped"),
    Column("slid", "slid"),
    Column("other", "other"),
    Column("duration", "mean duration [s]", ".3f"),
    Column("slowest", "longest [s]", ".3f"),
    Column("error", "acceleration error, worst joint, median rms [rad/s^2]", ".3f"),
)

ABOVE = """# Boxes whose centre of mass and inertia are unknown

Written by `python experiments/inertia.py` with N = {points} collocation points.
"""

BELOW = """
- Boxes of 0.15 x 0.15 m, 1 kg, friction 0.2, on the tray of `waiter_one_block`. Their centre of mass lies within
  (0.06, 0.06, h/2 - 0.08) m of the centre of the box: {centers} of them per height, the first {corners} at the upper
  corners of the interval, the others uniform (seed 0). Each comes with three inertias: 1, 0.5 and 0.1 of that of masses
  at the corners of the box with this centre of mass. Three goals, so 135 executions per height and kind of plan, in
  MuJoCo with `execution.truth.center_of_mass` and `execution.truth.inertia`.
- Goals: the paper's sweep; 0.2 m with a turn of 1.6 rad; a rise of 0.2 m with a turn of 1.6 rad, and back down with one
  of -1 rad. No tray leans: with the centre of mass at 0.06 m of 0.075 m, a box of 0.6 m tips over at rest from 0.03 rad
  on. Joint 4 may turn at {wrist} rad/s, 0.8 of the speed at which its viscous friction takes all of its torque.
- "{ignorant}" assumes the centre of the box and uniform density. "{knowing}" knows the centre of mass, one plan for
  each, and assumes the inertia of uniform density. "{robust}" has the interval of the centre of mass and
  `uncertainty.inertia` at its default, `realizable`: one plan per goal. All have the same further intervals: 2 mm on
  the contact points, 0.03 rad/s^2 on the joint acceleration.
- Feedforward is `execution.controller.feedforward`: compensation of gravity (the default), or also the torque of the
  planned motion with the nominal box. The acceleration error of the worst joint exceeds the interval that the plans
  assume, as the last column shows, with the former much more than with the latter. The robust plans that fail tip one
  box, with its centre of mass at an upper corner of the interval, where the tray slows down at the end of its descent,
  and only with the default. At 0.5 m and the largest inertia it tips with half the time step and with friction 1 as
  well, but not at 0.97 of the speed. So the cause is the error of the controller, not the bounds on the box.
"""


def task(height: float, goal: str, points: int, robust: bool = False) -> Config:
    """Return the configuration of a box and a goal, with or without an interval of the centre of mass."""
    reach = f"center_of_mass: {{block: {[REACH, REACH, _reach(height)]}}}, " if robust else ""
    overrides = [
        "solver.method=reachability",
        f"solver.collocation_points={points}",
        f"objects.block.size={[SIDE, SIDE, height]}",
        f"objects.block.mass={MASS}",
        f"contact.friction={FRICTION}",
        f"path.tray_poses={GOALS[goal]}",
        "path.blend=0.1",
        f"robot.limits={{joint4: {{velocity: {WRIST}}}}}",
        f"uncertainty={{{reach}{KNOWN}}}",
        "execution={trials: 1}",
    ]
    return load_config(ROOT / "configs" / "waiter_one_block.yaml", overrides)


def _reach(height: float) -> float:
    return round(height / 2 - MARGIN, 9)


def centers(height: float) -> Array:
    """Return the centres of mass of the boxes of a height, (CENTERS, 3) [m]."""
    reach = np.array([REACH, REACH, _reach(height)])
    upper = [[x, y, 1.0] for x, y in product((-1.0, 1.0), repeat=2)]
    others = np.random.default_rng(0).uniform(-1.0, 1.0, (CENTERS - CORNERS, 3))
    return np.vstack([upper[:CORNERS], others]) * reach


def largest_inertia(height: float, center: Array) -> Array:
    """Return the inertia about the centre of mass of masses at the corners of the box, (3,) [kg m^2]."""
    squares = np.array([SIDE / 2, SIDE / 2, height / 2]) ** 2 - center**2
    return np.asarray(MASS * (squares.sum() - squares))


def planned(config: Config, settings: Sequence[Mapping[str, Sequence[float]]] = ({},)) -> list[Plan]:
    """Return the plan of each setting, which must exist."""
    plans = BatchPlanner(config, workers=1).plans(settings)
    for plan in plans:
        if plan.status is not Status.SOLVED:
            raise SystemExit(plan.message)
    return plans


def executions(height: float, goal: str, feedforward: str, points: int) -> Iterator[Record]:
    """Yield a record of each execution of a height, a goal and a controller."""
    places, usual = centers(height), task(height, goal, points)
    settings = [{}, *({"objects.block.center_of_mass": tuple(center.tolist())} for center in places)]
    ignorant, *knowing = planned(usual, settings)
    (robust,) = planned(task(height, goal, points, robust=True))
    for number, center in enumerate(places):
        for kind, plan in {IGNORANT: ignorant, KNOWING: knowing[number], ROBUST: robust}.items():
            for scale in SCALES:
                inertia = scale * largest_inertia(height, center)
                world = {"center_of_mass": {"block": center.tolist()}, "inertia": {"block": inertia.tolist()}}
                yield {
                    "height": height,
                    "goal": goal,
                    "plan": kind,
                    "center": number,
                    "scale": scale,
                    **_outcome(plan, world, feedforward),
                }


def _outcome(plan: Plan, world: Mapping[str, Any], feedforward: str) -> Record:
    """Return the outcome of a plan in a world."""
    execution = {"execution.truth": world, "execution.controller": {"feedforward": feedforward}}
    found = execute(plan, with_values(plan.problem.config, execution))
    (trial,) = found.outcomes
    block = trial.objects["block"]
    feedback = found.feedback
    return {
        "status": trial.status.value,
        "duration": plan.duration,
        "time": None if np.isnan(trial.time) else trial.time,
        "tilt": block.tilt,
        "slip": block.slip,
        "error": None if feedback is None else float(np.max(feedback.deviation)),
    }


def records(height: float, goal: str, feedforward: str, points: int, work: Path) -> list[Record]:
    """Return the records of a height, a goal and a controller, which are read if they exist."""
    file = work / f"{height}_{goal}_{feedforward}_{points}.json"
    if not file.is_file():
        found = list(executions(height, goal, feedforward, points))
        work.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_text("".join(json.dumps(record) + "\n" for record in found), encoding="utf-8")
        part.replace(file)
    lines = file.read_text(encoding="utf-8").splitlines()
    return [{"feedforward": feedforward, **json.loads(text)} for text in lines]


def lines(found: Sequence[Record]) -> Iterator[Record]:
    """Yield the line of each controller, height and kind of plan."""
    keys = ("feedforward", "height", "plan")
    for values in dict.fromkeys(tuple(record[key] for key in keys) for record in found):
        here = [record for record in found if tuple(record[key] for key in keys) == values]
        fine = [record for record in here if record["status"] == Outcome.SUCCESS.value]
        status = [record["status"] for record in here]
        tipped, slid = status.count(Outcome.TIPPED.value), status.count(Outcome.SLID.value)
        failures, durations = len(here) - len(fine), [record["duration"] for record in here]
        errors = [record["error"] for record in here if record["error"] is not None]
        yield {
            **dict(zip(keys, values, strict=True)),
            "plans": len({(record["goal"], record["center"] if values[-1] == KNOWING else 0) for record in here}),
            "executions": len(here),
            "failures": failures,
            "tipped": tipped,
            "slid": slid,
            "other": failures - tipped - slid,
            "duration": float(np.mean(durations)),
            "slowest": max(durations),
            "error": float(np.median(errors)),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--heights", type=float, nargs="+", default=HEIGHTS, help="heights of the boxes [m]")
    parser.add_argument("--points", type=int, default=200, help="number of collocation points")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder that is written to")
    chosen = parser.parse_args()
    work, found = bench("inertia", chosen.out).work, []
    for feedforward, height, goal in product(CONTROLLERS, chosen.heights, GOALS):
        found += records(height, goal, feedforward, chosen.points, work)
        print(f"{feedforward}, {height} m, {goal}: {len(found)} executions", flush=True)
    table = Table(COLUMNS, tuple(lines(found)))
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "inertia.csv").write_text(csv_text(table), encoding="utf-8")
    below = BELOW.format(
        centers=CENTERS, corners=CORNERS, ignorant=IGNORANT, knowing=KNOWING, robust=ROBUST, wrist=WRIST
    )
    text = ABOVE.format(points=chosen.points) + "\n" + markdown_text(table) + below
    (chosen.out / "inertia.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
