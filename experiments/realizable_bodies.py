"""Try thousands of bodies that can exist against the plan of every shipped task with objects.

    python experiments/realizable_bodies.py [--configs waiter_heavy ...] [--bodies N] [--points N] [--out FOLDER]

Writes realizable_bodies.csv and .md: for the intervals of the task, and for wide intervals of all centres of mass, the
largest share of a limit that any body uses at any grid point. It takes some ten minutes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from learned import ROOT
from point_bodies import (
    Oracle,
    Points,
    Shape,
    directed,
    drawn_in,
    extreme,
    oracles,
    shape_of,
    shared_oracle,
    torque_oracle,
    uncertain,
    uniform,
)

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.config.load import load_config, with_values
from robustopt.errors import RobustOptError
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.tables import Column, Table, csv_text, markdown_text

Record = dict[str, Any]

WIDE = 0.5
"""Wide intervals reach so far from the centre of mass to the surface of each object."""

STEPS = 7
"""Bisections for the widest intervals for which there is a plan."""

PER_EXTREME = 4
"""Number of bodies whose masses are drawn in, and of uniform ones, per body of masses at corners."""

SHARED_ROWS = 40
"""Rows per instant for objects that share their contacts."""

FIRST = 200
"""Bodies for which all rows are evaluated; the others need only the rows that they may use more."""

VALUES = 1 << 24
"""Largest number of values in memory together."""

COLUMNS = (
    Column("config", "task"),
    Column("intervals", "intervals of centres of mass"),
    Column("objects", "objects of unknown inertia"),
    Column("bodies", "bodies"),
    Column("cases", "bodies x grid points x rows", ".2g"),
    Column("duration", "duration [s]", ".3f"),
    Column("limit", "most used limit"),
    Column("used", "used by the worst body [%]", ".4f"),
    Column("violations", "bodies that violate the plan"),
)

ABOVE = """# Bodies that can exist

Written by `python experiments/realizable_bodies.py` with N = {points} collocation points.
"""

BELOW = """
- Each body is a set of masses at points of the shape, with its centre of mass in the interval, and requires the sum of
  the forces that its points need (`point_bodies.py`): neither the sets of inertias nor the rows of the bodies come from
  the package. A tenth of the bodies has masses at corners, found by linear programs with random objectives, a tenth
  by linear programs that aim at the rows nearest to their limits. Four tenths have such masses drawn in to planes,
  lines or points; four tenths are uniform boxes or cylinders. The inertia of all other bodies is the configured one.
- Masses are at a random end of their interval, and so is the acceleration error at every grid point (two draws). The
  rows of contacts hold for the worst friction, forces and contact points in their intervals. Objects that share
  their contacts (`waiter_bridge`) are checked with {shared} rows per grid point that the certificate's programs find.
- The used share of a contact row is the distance from what rest requires, as a part of the distance to the limit; that
  of a joint is its torque, as a part of its limit. The hands, feet and joint torques of `humanoid_tray` are left to the
  certificate. A body violates a plan if it uses more than 100.01 % of a limit.
- "Wide" intervals reach half the way from the nominal centre of mass to the surface, for all objects at once. If there
  is no such plan, the widest intervals that have one are used. "{own}" are those of the shipped task; without an
  interval of a centre of mass, its inertia is known and there is nothing to try.
"""

OWN, TOLERANCE = "own", 1e-4


def widened(config: Config, share: float) -> Config:
    """Return a configuration whose centres of mass lie anywhere within a share of the way to the surface."""
    reaches = {}
    for name in config.objects:
        shape = shape_of(config, name)
        room = shape.half - np.abs(shape.center)
        if shape.round:
            room[:2] = (shape.half[0] - np.hypot(*shape.center[:2])) / np.sqrt(2.0)
        reaches[name] = np.round(share * room, 6).tolist()
    return with_values(config, {"uncertainty.center_of_mass": reaches})


def planned(config: Config) -> Plan | None:
    """Return the plan of a configuration, None if there is none."""
    try:
        plan = solve(build_problem(config), "reachability")
    except RobustOptError:
        return None
    return plan if plan.status is Status.SOLVED else None


def widest(config: Config) -> tuple[float, Plan | None]:
    """Return the share of wide intervals, or the largest one that has a plan, and the plan."""
    low, best, high = 0.0, None, WIDE
    plan = planned(widened(config, WIDE))
    if plan is not None:
        return WIDE, plan
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        plan = planned(widened(config, middle))
        low, best, high = (low, best, middle) if plan is None else (middle, plan, high)
    return low, best


# Bodies --------------------------------------------------------------------------------------------------


def random_moments(shape: Shape, count: int, rng: np.random.Generator) -> Iterator[Points]:
    """Yield `count` bodies of masses at corners, and for each of them some that are drawn in and some uniform ones."""
    for _ in range(count):
        body = extreme(shape, rng.normal(size=len(shape.places)))
        yield body
        for _ in range(PER_EXTREME):
            yield drawn_in(body, rng)
            center = shape.center + rng.uniform(-1.0, 1.0, size=3) * shape.reach
            yield uniform(shape, center, rng.uniform(size=3))


def bodies_of(config: Config, found: list[Oracle], names: list[str], count: int, rng: np.random.Generator) -> Array:
    """Return the moments of `count` bodies for each object, times a random end of its mass, (count, 10 objects)."""
    columns = []
    for name in names:
        own = [oracle for oracle in found if name in oracle.names]
        aimed = [body for it in own for body in directed(it, name, it.of_others([name]), count // (10 * len(own)))]
        aimed += random_moments(shape_of(config, name), (count - len(aimed)) // (1 + 2 * PER_EXTREME) + 1, rng)
        moments = np.array([body.moments for body in aimed[:count]])
        item = config.objects[name]
        low, high = config.uncertainty.mass.get(name, (item.mass, item.mass))
        columns.append(rng.permutation(moments) * rng.choice([low, high], size=(count, 1)))
    return np.hstack(columns)


# Rows ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Affine:
    """Values of R rows for bodies with moments z: slope @ z + constant, (R, d) and (R,)."""

    slope: Array
    constant: Array

    @classmethod
    def of(cls, oracle: Oracle, names: list[str]) -> Affine:
        """Return the values of all rows of an oracle; bodies that do not load its limit have no slope."""
        shape = len(oracle.motions), oracle.constant.shape[-1], 10
        slopes = [oracle.per_moment(name) if name in oracle.names else np.zeros(shape) for name in names]
        return cls(np.concatenate(slopes, axis=2).reshape(-1, 10 * len(names)), oracle.of_others(names).ravel())

    def __call__(self, z: Array, rows: Any = slice(None)) -> Array:
        return np.asarray(self.slope[rows] @ z.T + self.constant[rows, None])

    def bounds(self, z: Array) -> tuple[Array, Array]:
        """Return a lower and an upper bound of the values of each row for all bodies z."""
        low, high = z.min(axis=0), z.max(axis=0)
        middle = self.slope @ (0.5 * (low + high)) + self.constant
        radius = np.abs(self.slope) @ (0.5 * (high - low))
        return middle - radius, middle + radius


def used(oracle: Oracle, names: list[str], z: Array) -> tuple[Array, int]:
    """Return a lower bound of the largest share of a row that each body uses, (bodies,), and the number of cases.

    It is the largest share of each body if this is the largest of all.
    """
    rows = Affine.of(oracle, names)
    rest = Affine.of(oracle.at_rest, names) if oracle.still else None
    if rest is None:
        rest = Affine(np.zeros_like(rows.slope), np.full_like(rows.constant, -1.0))

    def shares(z: Array, chosen: Any) -> Array:
        room = -rest(z, chosen)
        return np.asarray(np.where(room > 0.0, 1.0 + rows(z, chosen) / np.maximum(room, 1e-300), np.inf))

    everywhere = np.arange(len(rows.constant))
    size = max(1, VALUES // FIRST)
    first = [shares(z[:FIRST], part).max(axis=0) for part in np.split(everywhere, everywhere[::size][1:])]
    most = np.full(len(z), -np.inf)
    most[:FIRST] = np.max(first, axis=0)
    upper, (least, largest) = rows.bounds(z)[1], (-end for end in rest.bounds(z)[::-1])
    within = np.where(upper < 0.0, upper / np.maximum(largest, 1e-300), upper / np.maximum(least, 1e-300))
    close = np.flatnonzero((1.0 + within > min(most.max(), 1.0)) | (least <= 0.0))
    size = max(1, VALUES // len(z))
    for begin in range(0, len(close), size):
        most = np.maximum(most, shares(z, close[begin : begin + size]).max(axis=0))
    return most, len(z) * len(everywhere)


# Records -------------------------------------------------------------------------------------------------


def limits_of(plan: Plan, rng: np.random.Generator) -> list[Oracle]:
    """Return the rows of all limits that the objects of a plan load."""
    found = list(oracles(plan, 2, rng))
    if any(len(family.system.objects) > 1 for family in plan.problem.limits.contacts):
        found.append(shared_oracle(plan, 0, SHARED_ROWS, rng))
    return found if plan.problem.robot.base else [*found, torque_oracle(plan, rng)]


def record(name: str, intervals: str, plan: Plan | None, count: int) -> Record:
    """Return the line of a plan."""
    line: Record = {"config": name, "intervals": intervals}
    if plan is None:
        return line
    config, rng = plan.problem.config, np.random.default_rng(0)
    names = uncertain(config, list(config.objects))
    line |= {"objects": ", ".join(names) or "none", "duration": plan.duration, "bodies": 0}
    if not names:
        return line
    found = limits_of(plan, rng)
    z = bodies_of(config, found, names, count, rng)
    shares: Mapping[str, tuple[Array, int]] = {it.name: used(it, names, z) for it in found}
    limit = max(shares, key=lambda key: shares[key][0].max())
    most = np.max([own for own, _ in shares.values()], axis=0)
    return line | {
        "bodies": count,
        "cases": float(sum(cases for _, cases in shares.values())),
        "limit": limit,
        "used": 100.0 * float(most.max()),
        "violations": int(np.count_nonzero(most > 1.0 + TOLERANCE)),
    }


def lines(name: str, points: int, count: int) -> Iterator[Record]:
    """Yield the lines of a shipped task; those of a walking robot have a grid of their own."""
    config = load_config(ROOT / "configs" / f"{name}.yaml")
    if not config.objects:
        return
    if config.path.steps is None:
        config = with_values(config, {"solver.collocation_points": points})
    yield record(name, OWN, planned(config), count)
    share, plan = widest(config)
    yield record(name, f"wide, {share:.3g}" if plan is not None else "wide: none", plan, count)


def main() -> None:
    shipped = sorted(path.stem for path in (ROOT / "configs").glob("*.yaml"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--configs", nargs="+", default=shipped, choices=shipped, metavar="NAME", help="tasks")
    parser.add_argument("--bodies", type=int, default=10_000, help="number of bodies per plan")
    parser.add_argument("--points", type=int, default=100, help="number of collocation points")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder that is written to")
    chosen, found = parser.parse_args(), []
    for name in chosen.configs:
        began = time.perf_counter()
        for line in lines(name, chosen.points, chosen.bodies):
            found.append(line)
            print(line, f"{time.perf_counter() - began:.0f} s", flush=True)
    table = Table(COLUMNS, tuple(found))
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "realizable_bodies.csv").write_text(csv_text(table), encoding="utf-8")
    text = ABOVE.format(points=chosen.points) + "\n" + markdown_text(table) + BELOW.format(shared=SHARED_ROWS, own=OWN)
    (chosen.out / "realizable_bodies.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
