"""Count the executions until a learner of one friction has a plan close to the best: one bit of each, or all it shows.

    python experiments/physics.py [--truths N] [--out results/benchmarks]

Writes physics.csv and .md.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from learned import task

from robustopt.config import Config
from robustopt.config.load import with_values
from robustopt.learning.learner import Belief
from robustopt.runs.beliefs import Planner
from robustopt.runs.campaign import Learned, learn
from robustopt.runs.executors import Simulated
from robustopt.tables import Column, Table, csv_text, markdown_text

ROOT = Path(__file__).resolve().parents[1]

LOADS = {
    "block of 0.5 kg": "objects.block.mass=0.5",
    "block of 3 kg": "objects.block.mass=3",
    "flat block": "objects.block.size=[0.1, 0.1, 0.06]",
    "without pushes": "execution.disturbance.force_deviation=[0, 0, 0]",
}
"""Overrides of the paper's one-block task, whose block is 0.08 x 0.08 x 0.12 m and whose tray is pushed with 2 N."""

LEARNERS = ("physics", "bnb-informed", "bisection")

FRICTIONS, LEAST = (0.1, 0.65), 0.05
"""Interval of the truths, and the conservative end of the search, which starts at 1."""

CLOSE = (0.05, 0.02)
"""Excess of duration over the best plan that is counted to."""

FINE, TIMES = 1.003, 3
"""The best plan is that of the largest friction, on a grid with this ratio, that succeeds so many times in a row."""

FRESH = 3_000_000_000
"""Number of the first execution that finds the best plan."""

BUDGET = 25
"""Largest number of executions; a plan that is never close enough counts as one more."""


@dataclass(frozen=True)
class Count:
    """Executions up to each of `CLOSE`, executions in all, and the excess of the result over the best plan."""

    close: tuple[int, ...]
    executions: int
    excess: float


def config_of(load: str, truth: float, algorithm: str, seed: int) -> Config:
    """Return the task of a learner."""
    parameters = [{"key": "contact.friction", "optimistic": 1.0, "conservative": LEAST}]
    several = {"parameters": parameters, "budget": BUDGET, "executions_per_plan": 1}
    settings = {"algorithm": algorithm, "trials": 0, **({"delta": 0.01} if algorithm == "bisection" else several)}
    return with_values(
        task((LOADS[load], "solver.method=reachability")),
        {"execution.truth.friction": truth, "seed": seed, "learning": settings},
    )


def best(config: Config, truth: float) -> float:
    """Return the duration of the best plan, by bisection on the grid [s]."""
    planner, executor = Planner(config, certified=False), Simulated(config)

    def duration(step: int) -> float | None:
        planned = planner.plan(Belief(friction=min(truth * FINE**step, 1.0)))
        done = executor.run(planned, range(FRESH, FRESH + TIMES), 1.0)
        return planned.plan.duration if all(item.outcome.success for item in done) else None

    low, high, found = -100, 80, np.inf
    while high - low > 1:
        middle = (low + high) // 2
        value = duration(middle)
        low, high = (middle, high) if value is not None else (low, middle)
        found = found if value is None else min(found, value)
    return float(found)


def count(found: Learned, duration: float) -> Count:
    """Return how many executions a learner took."""
    done, close, shortest = 0, [BUDGET + 1] * len(CLOSE), np.inf
    for row in found.rows:
        done += row.trial.executions
        if row.trial.successes and row.trial.duration is not None:
            shortest = min(shortest, row.trial.duration)
        for i, share in enumerate(CLOSE):
            if shortest <= (1.0 + share) * duration:
                close[i] = min(close[i], done)
    return Count(tuple(close), done, shortest / duration - 1.0)


COLUMNS = (
    Column("load", "load"),
    Column("learner", "learner"),
    Column("five", "executions to 5 %, median", "g"),
    Column("two", "to 2 %, median", "g"),
    Column("most", "to 2 %, 90 % of the truths within", "g"),
    Column("executions", "in all, median", "g"),
    Column("excess", "result slower than the best plan, median [%]", ".2f"),
)

ABOVE = """# One friction, learned from all that an execution shows

Written by `python experiments/physics.py`. The paper's one-block task in MuJoCo for {truths} actual frictions, drawn
from [{low:g}, {high:g}] evenly in their logarithm, and {loads} loads. The search begins between 1 and {least:g}.
"""

BELOW = """
- `physics` learns from the kind and the time of failures, `bnb-informed` and `bisection` (Alg. 1, delta = 0.01) from
  success and failure alone. With one parameter `bnb-informed` halves the interval in the logarithm of the friction.
- The best plan is the fastest one, for frictions {step:.1f} % apart, that succeeds {times} times in a row. Executions
  are counted up to the first plan that succeeds and is slower than this one by no more than 5 % or 2 %. Pushes make
  single executions vary by about a percent of friction, so that a learner which asks for one success can be faster.
"""


def line(load: str, learner: str, counts: list[Count]) -> dict[str, float | str]:
    """Return the line of a learner."""
    close = np.array([item.close for item in counts])
    return {
        "load": load, "learner": learner, "five": float(np.median(close[:, 0])), "two": float(np.median(close[:, 1])),
        "most": float(np.quantile(close[:, 1], 0.9, method="inverted_cdf")),
        "executions": float(np.median([item.executions for item in counts])),
        "excess": 100.0 * float(np.median([item.excess for item in counts])),
    }  # fmt: skip


def main() -> None:
    """Run all and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    given = parser.parse_args()
    truths = np.exp(np.random.default_rng(7).uniform(*np.log(FRICTIONS), given.truths)).tolist()
    lines, every = [], {learner: list[Count]() for learner in LEARNERS}
    for load in LOADS:
        durations = [best(config_of(load, truth, "bisection", 0), truth) for truth in truths]
        for learner in LEARNERS:
            counts = []
            for seed, (truth, duration) in enumerate(zip(truths, durations, strict=True), 1):
                counts.append(count(learn(config_of(load, truth, learner, seed)), duration))
                print(f"{load}, {learner}, {truth:.3f}: {counts[-1]}", flush=True)
            lines.append(line(load, learner, counts))
            every[learner] += counts
    lines += [line("all", learner, counts) for learner, counts in every.items()]
    table = Table(COLUMNS, tuple(lines))
    above = ABOVE.format(truths=given.truths, low=FRICTIONS[0], high=FRICTIONS[1], loads=len(LOADS), least=LEAST)
    below = BELOW.format(step=100 * (FINE - 1), times=TIMES)
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "physics.csv").write_text(csv_text(table))
    (given.out / "physics.md").write_text(f"{above}\n{markdown_text(table)}{below}")


if __name__ == "__main__":
    main()
