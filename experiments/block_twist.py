"""Measure when blocks slide that a load pushes and twists at once, beside the thresholds of both pressure models.

    python experiments/block_twist.py [--out results/benchmarks]

Writes block_twist.csv and .md in five minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import linprog

from robustopt.arrays import Array
from robustopt.config import Config
from robustopt.config.load import load_config
from robustopt.limits.bodies import inertia_matrix
from robustopt.limits.systems import TWIST, object_systems
from robustopt.robot.preparation import CARRIER_SITE
from robustopt.scene.placement import placements
from robustopt.simulation.objects import standing
from robustopt.simulation.parameters import BodyParameters, Parameters
from robustopt.simulation.physics import physics_of, set_options
from robustopt.simulation.simulation import Workspace, simulate
from robustopt.simulation.world import add_load, place_load, positions_of
from robustopt.tables import Column, Table, csv_text, markdown_text

ROOT = Path(__file__).resolve().parents[1]

G, MASS, TIMESTEP = 9.81, 0.5, 0.001
APPROACH, HOLD = 0.4, 1.0
"""Time over which a load is approached, and for which it is held [s]."""

SLIDE = 1e-3
"""Movement of a corner from which a block counts as sliding [m]: after 1 s at 0.1 % above the threshold."""

COARSE, FINE = np.linspace(0.80, 1.06, 14), np.linspace(0.0, 0.0175, 8)
"""Loads that are tried, per threshold of free pressure: all of the first, then those above the last that held."""

RATIOS = (1, 2, 3, 5)
"""Long edge of the base per short edge; the long edge has 0.2 m."""

CENTERS = ((0.0, 0.0), (0.3, 0.0), (0.0, 0.3), (0.3, 0.3))
"""Centres of mass, per half edge of the base."""

WAYS = (0.0, 45.0, 60.0, 90.0)
"""Directions of the force, from the long edge [degrees]."""

TWISTS = (0.0, 0.05, 0.1, 0.2, 0.5, 1.0, np.inf)
"""Moments about the normal through the centre of mass, per force and distance of a corner from the base's centre."""

REST, TALL, DRIVEN = "low", "tall", "low, driven"

COLUMNS = (
    Column("kind", "block"),
    Column("twist", "twist"),
    Column("cases", "cases"),
    Column("free_mean", "simulated / planned, free: mean", ".3f"),
    *(Column(f"free_{ratio}", f"lowest at 1:{ratio}", ".3f") for ratio in RATIOS),
    Column("fixed_mean", "simulated / planned, fixed: mean", ".3f"),
    Column("fixed_least", "lowest", ".3f"),
    Column("fixed_most", "highest", ".3f"),
)

TEXT = """# Blocks that are pushed and twisted

Written by `python experiments/block_twist.py`.

{table}
- Boxes on a tray, bases of 0.2 m times 0.2 m to 0.04 m, friction 0.5 and 0.3, centre of mass up to 0.3 of half an edge
  off the centre along x, y or both. A force along 0, 45, 60 or 90 degrees to the long edge and a moment about the
  normal, both at the centre of mass, grow together in the simulated world of `robustopt execute`, until a corner has
  moved by 1 mm within a second. "Twist" is the moment per force and distance of a corner from the centre of the base;
  "alone" is a moment without a force. The loads are those of a tray that accelerates and turns: m a and I alpha. The
  blocks of the rows "{driven}" stand on a tray that does so, are 1 m long, and have their mass at the corners. The
  others stand on a tray at rest, because the same load then acts for as long as needed.
- The figures are the simulated threshold per threshold of the planner's contact model with 64 edges per friction cone,
  in steps of 0.25 %. A force alone has the planned threshold wherever the centre of mass is ({force:.3f} at least), and
  a twist alone nearly so (at least {alone:.3f} at rest, {driven_alone:.3f} driven). Free pressure is optimistic if both
  act at once: in the worst case the block yields at {worst:.3f} of the planned load, at a twist of {worst_twist:g}. Up
  to a twist of 0.1 it yields at {small:.3f} or more. With fixed pressure the lowest of all figures is {fixed:.3f}.
- The centre of mass of "{tall}" blocks is so high that friction moves the centre of pressure by 0.3 of half the short
  edge.
- MuJoCo's contacts are the corners, as in the plan, so the table says nothing about faces that touch all over. Uniform
  pressure on a square resists 0.54 of the twist alone that its corners resist; neither model covers that.
"""


@dataclass(frozen=True)
class Case:
    """A block and a load.

    Attributes:
        kind: kind of the block.
        ratio: long edge of its base per short edge.
        center: centre of mass per half edge.
        friction: coefficient of friction.
        way: direction of the force [degrees].
        twist: see `TWISTS`.
    """

    kind: str
    ratio: int
    center: tuple[float, float]
    friction: float
    way: float
    twist: float

    @property
    def size(self) -> Array:
        """Return the edges of the block, (3,) [m]."""
        long = 1.0 if self.kind == DRIVEN else 0.2
        short = long / self.ratio
        return np.array([long, short, 0.3 * short / self.friction if self.kind == TALL else 0.05 * short])

    @property
    def load(self) -> tuple[Array, float]:
        """Return force (3,) and moment about the normal that the support must exert at the centre of mass [N, N m]."""
        angle, reach = np.radians(self.way), 0.5 * float(np.hypot(*self.size[:2]))
        force, moment = (0.0, 1.0) if np.isinf(self.twist) else np.array([1.0, self.twist]) / np.hypot(1.0, self.twist)
        return force * np.array([np.cos(angle), np.sin(angle), 0.0]), float(moment * reach)

    def config(self, pressure: str) -> Config:
        """Return a configuration with the block; its robot and path play no part."""
        size, center = self.size, [*(0.5 * self.size[:2] * self.center).tolist(), 0.0]
        block: dict[str, Any] = {"shape": "box", "size": size.tolist(), "mass": MASS, "center_of_mass": center}
        if self.kind == DRIVEN:
            x, y, z = (0.5 * size) ** 2
            inertia = MASS * np.array([y + z, x + z, x + y])
            block |= {"inertia": inertia.tolist(), "at": [-center[0], -center[1]]}
        words = ", ".join(f"{key}: {value}" for key, value in (block | {"pressure": pressure}).items())
        return load_config(
            ROOT / "configs" / "waiter_one_block.yaml",
            ["tray.size=[3, 3, 0.01]", f"objects={{block: {{{words}}}}}", "uncertainty={}",
             f"contact={{friction: {self.friction}, cone_edges: 64}}"],
        )  # fmt: skip


def cases() -> Iterator[Case]:
    """Yield all cases; without a force its direction does not matter."""
    for twist in TWISTS:
        for way in WAYS if np.isfinite(twist) else WAYS[:1]:
            for ratio in RATIOS:
                for center in CENTERS:
                    yield Case(REST, ratio, center, 0.5, way, twist)
                yield Case(REST, ratio, CENTERS[3], 0.3, way, twist)
            for ratio in (1, 3):
                yield Case(TALL, ratio, CENTERS[0], 0.3, way, twist)
                if twist in (0.0, 0.2, 1.0, np.inf) and way < 60.0:
                    yield from (Case(DRIVEN, ratio, center, 0.3, way, twist) for center in CENTERS[::3])


# Planned --------------------------------------------------------------------------------------------------


def planned(case: Case, pressure: str) -> float:
    """Return the largest factor on the load that the planner's contact model permits."""
    config = case.config(pressure)
    (system,) = object_systems(config, {"block": case.friction}, {})
    arm = placements(config)["block"].position + config.objects["block"].center_of_mass
    force, moment = case.load
    rest, load = (np.r_[f, np.cross(arm, f)] for f in (np.array([0.0, 0.0, MASS * G]), force))
    load[5] += moment
    columns = np.column_stack([system.generators, -load])
    scale = 1.0 / np.abs(columns).max(axis=1)
    cost = np.zeros(columns.shape[1])
    cost[-1] = -1.0
    found = linprog(cost, A_eq=columns * scale[:, None], b_eq=rest * scale, method="highs")
    twist = system.facets[system.kinds == TWIST]
    rate = twist @ load
    grows = rate > 0.0
    return float(np.min(-(twist @ rest)[grows] / rate[grows], initial=found.x[-1]))


# Simulated ------------------------------------------------------------------------------------------------


def tray(config: Config, driven: bool) -> mujoco.MjModel:
    """Return a tray with the block: at rest, or on two slides and a hinge that are too heavy to feel the block."""
    spec, body = mujoco.MjSpec(), config.objects["block"]
    set_options(spec, physics_of(0, False), TIMESTEP)
    table = spec.worldbody.add_body(name="table", mass=1e6, inertia=[1e6, 1e6, 1e6], explicitinertial=True)
    table.add_site(name=CARRIER_SITE)
    for name, axis in zip("xy", np.eye(3), strict=False) if driven else ():
        table.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    if driven:
        table.add_joint(name="yaw", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
    assert config.tray is not None
    own = BodyParameters(MASS, np.array(body.center_of_mass), inertia_matrix(body))
    plate = BodyParameters(config.tray.mass, np.zeros(3), inertia_matrix(config.tray))
    friction = {"block": float(config.contact.friction)}  # type: ignore[arg-type]
    add_load(spec, config, Parameters(friction, {"block": own, "tray": plate}, {}), (), 0.0)
    return spec.compile()


def slides(case: Case, levels: Array) -> Array:
    """Return whether the block slides at multiples of its load, (k,)."""
    config, driven = case.config("free"), case.kind == DRIVEN
    model = tray(config, driven)
    t = TIMESTEP * np.arange(round((APPROACH + HOLD) / TIMESTEP))
    rising = np.where(t < APPROACH, 0.5 - 0.5 * np.cos(np.pi * t / APPROACH), 1.0)
    amount = levels[:, None] * rising
    force, moment = case.load
    control = np.zeros((len(levels), len(t), model.nu + 6 * model.nbody))
    inputs = control.reshape(len(levels), len(t), model.nbody, 6)
    if driven:
        table = model.body("table").id
        spin = amount * moment / inertia_matrix(config.objects["block"])[2, 2]
        angle = np.cumsum(np.cumsum(spin, axis=1), axis=1) * TIMESTEP**2
        c, s = np.cos(angle), np.sin(angle)
        total = model.body_subtreemass[table]
        inputs[:, :, table, 0] = total / MASS * amount * (c * force[0] - s * force[1])
        inputs[:, :, table, 1] = total / MASS * amount * (s * force[0] + c * force[1])
        inputs[:, :, table, 5] = spin * (1e6 + model.body("robustopt_carrier").inertia[2])
    else:
        inputs[:, :, model.body("robustopt_block").id] = amount[:, :, None] * -np.r_[force, 0.0, 0.0, moment]
    start = np.zeros((len(levels), model.nq))
    for qpos in start:
        place_load(config, qpos, positions_of(config, model), np.zeros(3), np.eye(3))
    record = simulate([model], start, control, 2, Workspace())
    assert not record.diverged.any()
    (interface,) = standing(config, model)
    moved = [interface.motion(None, record, i).slip.max() for i in range(len(levels))]  # type: ignore[arg-type]
    return np.array(moved) > SLIDE


def simulated(case: Case, plan: float) -> float:
    """Return the largest load that the block bears, per planned one; at most the last of `COARSE`."""
    held = np.append(COARSE[:1] - 0.02, COARSE)[int(np.argmax(np.append(slides(case, plan * COARSE), True)))]
    return float((held + FINE)[int(np.argmax(np.append(slides(case, plan * (held + FINE[1:])), True)))])


# Table ----------------------------------------------------------------------------------------------------


def lines(found: dict[Case, tuple[float, float]]) -> Iterator[dict[str, Any]]:
    """Yield the line of each kind of block and each twist."""
    for kind in (REST, TALL, DRIVEN):
        for twist in TWISTS:
            own = {case: ratios for case, ratios in found.items() if (case.kind, case.twist) == (kind, twist)}
            if not own:
                continue
            free, fixed = np.array(list(own.values())).T
            lowest = {r: min([free for case, (free, _) in own.items() if case.ratio == r], default=nan) for r in RATIOS}
            yield {
                "kind": kind, "twist": f"{twist:g}" if np.isfinite(twist) else "alone", "cases": len(own),
                "free_mean": free.mean(), **{f"free_{ratio}": value for ratio, value in lowest.items()},
                "fixed_mean": fixed.mean(), "fixed_least": fixed.min(), "fixed_most": fixed.max(),
            }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks", help="folder that is written to")
    chosen = parser.parse_args()
    found: dict[Case, tuple[float, float]] = {}
    for case in cases():
        free, fixed = (planned(case, pressure) for pressure in ("free", "fixed"))
        ratio = simulated(case, free)
        found[case] = ratio, ratio * free / fixed
        print(case, *np.round(found[case], 4), flush=True)
    table = Table(COLUMNS, tuple(lines(found)))
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "block_twist.csv").write_text(csv_text(table), encoding="utf-8")
    worst = min(found, key=lambda case: found[case][0])
    free = {case: ratios[0] for case, ratios in found.items()}
    text = TEXT.format(
        table=markdown_text(table), driven=DRIVEN, tall=TALL, worst=free[worst], worst_twist=worst.twist,
        force=min(value for case, value in free.items() if case.twist == 0.0),
        alone=min(value for case, value in free.items() if np.isinf(case.twist) and case.kind != DRIVEN),
        driven_alone=min(value for case, value in free.items() if np.isinf(case.twist) and case.kind == DRIVEN),
        small=min(value for case, value in free.items() if case.twist <= 0.1),
        fixed=min(ratios[1] for ratios in found.values()),
    )  # fmt: skip
    (chosen.out / "block_twist.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
