"""Write the paper's Table 1: bisection on the friction coefficient for two blocks (Alg. 1), here in simulation.

python experiments/table_1.py [--out results/tables]
"""

from __future__ import annotations

from pathlib import Path

from learned import TWO_BLOCKS, Bench, learned, records, success, task
from reproduce import run_alone

from robustopt.runs.records import Iteration
from robustopt.tables import Column, Table, write_table

PAPER = (
    {"friction": 1.0, "duration": 3.229, "result": "F"},
    {"friction": 0.5, "duration": 3.232, "result": "F"},
    {"friction": 0.25, "duration": 3.704, "result": "F"},
    {"friction": 0.125, "duration": 5.237, "result": "S", "sped_up": "S"},
    {"friction": 0.1875, "duration": 4.276, "result": "S", "sped_up": "F"},
)
"""The paper's Table 1, row by row; duration: "execution time of optimized path" [s]."""

COLUMNS = (
    Column("iteration", "iter"),
    Column("friction", "mu", "g", r"$\mu$"),
    Column("duration", "time [s]", ".3f"),
    Column("result", "result"),
    Column("sped_up", "speed-up"),
    Column("friction_high", "mu_upp", "g", r"$\mu_{upp}$"),
    Column("friction_low", "mu_low", "g", r"$\mu_{low}$"),
    Column("fresh", "100 fresh trials, successes [%]"),
    Column("paper_friction", "paper: mu", "g", r"paper: $\mu$"),
    Column("paper_duration", "paper: time [s]", ".3f"),
    Column("paper_result", "paper: result"),
    Column("paper_sped_up", "paper: speed-up"),
)

ABOVE = """# Table 1: bisection on the coefficient of friction, two blocks

Written by `make reproduce-tables`. S: success, F: failure; speed-up: the same path 5 % faster.
"""

BELOW = """
- Rules (Alg. 1): start at mu = 1; a failure lowers mu_upp to mu, a success raises mu_low to mu and the path is
  executed 5 % faster; if that fails the plan is near-optimal and the search ends; else mu = (mu_low + mu_upp) / 2.
- Ours: {plans} plans and {executions} executions; it ends because {end}
- Paper: columns "paper", from an execution on hardware; they are copied from there, everything else comes from the
  run.
- Differences: the paper's robot is real, its actual friction was about 1 by tilting the plate, and the learned 0.1875
  is "a proxy for all other un-modeled uncertainties". Ours is simulated with an actual friction of {truth:g}, a PID
  controller with gravity compensation and no disturbance. So the only unmodelled effect is the controller's tracking
  error, and the learned coefficient of friction is larger. Path, blocks and cones are as in
  [durations](durations.md).
- The decisions follow the same rules in the same order: two failures at 1 and 0.5, then halving between a failure
  and a success, and an end by the sped-up execution.
"""

TRUTH = 0.5


def write(out: Path, place: Bench) -> list[Path]:
    """Run the bisection and write the table."""
    overrides = (
        "uncertainty={}",
        f"execution.truth.friction={TRUTH}",
        "learning={algorithm: bisection, epsilon: 0.05}",
    )
    found = learned(task(overrides, TWO_BLOCKS), "two-blocks", place)
    lines = [_line(record) for record in records(found)]
    for line, paper in zip(lines, PAPER, strict=False):
        line.update({f"paper_{key}": value for key, value in paper.items()})
    lines += [{f"paper_{key}": value for key, value in paper.items()} for paper in PAPER[len(lines) :]]
    caption = "Bisection on the coefficient of friction for a stack of two blocks (Alg. 1), beside the paper's Table 1."
    end = found.state.end.sentence if found.state.end else ""
    below = BELOW.format(
        plans=len(found.rows), executions=found.state.executed, end=end[:1].lower() + end[1:], truth=TRUTH
    )
    return write_table(Table(COLUMNS, tuple(lines), caption), out, "table_1", ABOVE, below)


def _line(record: Iteration) -> dict:
    letters = {True: "S", False: "F", None: ""}
    result = {"success": "S", "failure": "F"}.get(record.result, record.result)
    changed = {"result": result, "sped_up": letters[record.sped_up], "fresh": success(record)}
    return {**record.model_dump(), **changed}


if __name__ == "__main__":
    run_alone("table_1", write)
