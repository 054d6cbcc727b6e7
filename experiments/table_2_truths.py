"""Write Table 2 for actual frictions on and off the bisection's grid, beside the fastest plan by brute force.

python experiments/table_2_truths.py [--out results/tables]
"""

from __future__ import annotations

from pathlib import Path

from learned import Bench, learned, success, task
from reproduce import run_alone
from scan import Grid, fastest

from robustopt.learning.moments import ErrorInterval
from robustopt.runs.learning_summary import row_record
from robustopt.tables import Column, Table, write_table

TRUTHS = (0.5, 0.37, 0.61)
TRIALS = 100

COLUMNS = (
    Column("truth", "true mu", "g", r"true $\mu$"),
    Column("what", "plan"),
    Column("iterations", "iterations"),
    Column("executions", "executions"),
    Column("friction", "mu", "g", r"$\mu$"),
    Column("error", "+- error [rad/s^2]", ".2f"),
    Column("duration", "time [s]", ".3f"),
    Column("fresh", "100 fresh trials, successes [%]"),
    Column("fastest", "fastest by brute force [s]", ".3f"),
    Column("slower", "slower than that [%]", ".1f"),
)

ABOVE = """# Table 2 for other actual frictions

Written by `make reproduce-all`. ILROBS(K = 1), delta = 0.05, one block, 2 N, from mu = 1, for actual frictions on
(0.5) and off (0.37, 0.61) the grid that halving visits. "executed": the last plan that succeeded 7 times in a row;
"returned": (mu_low, U, Delta), which was not executed as such.
"""

BELOW = """
- Brute force: the fastest plan on a grid of mu (steps of {step:.0f} %, about half of that in duration) and K = {K}
  with the learned U and Delta that succeeds as often as the learned plan in {trials} trials, none of which judges
  learned plans.
- Beyond the paper, which has one actual friction. delta alone is worth up to 6 % of the duration near mu = 0.4.
"""


def write(out: Path, place: Bench) -> list[Path]:
    """Learn for every truth, scan, and write the table."""
    lines = []
    for truth in TRUTHS:
        config = task((f"execution.truth.friction={truth}",))
        found = learned(config, f"truth-{truth:g}", place)
        best, returned = found.best, found.returned
        if best is None or returned is None:
            raise SystemExit(f"actual friction {truth:g}: no plan succeeded")
        error = returned.trial.belief.error or ErrorInterval()
        grid = Grid(ErrorInterval(error.mean, error.deviation, 1.0), 0.6 * truth, min(1.0, 1.6 * truth))
        for what, row in (("executed", best), ("returned", returned)):
            record = row_record(found, row)
            rate = record.success_rate
            quickest = fastest(config, grid.beliefs, [rate], TRIALS, f"scan-{truth:g}", place)[0]
            lines.append(
                {
                    **record.model_dump(), "truth": truth, "what": what, "iterations": found.rows[-1].iteration,
                    "executions": found.state.executed, "error": max(record.planned_half_width, default=0.0),
                    "fresh": success(record), "fastest": quickest.duration,
                    "slower": 100 * (record.duration / quickest.duration - 1),
                }
            )  # fmt: skip
    caption = "ILROBS(K = 1) for other actual frictions, and the fastest plans that brute force finds."
    below = BELOW.format(step=100 * (Grid.ratio - 1), K=", ".join(f"{K:g}" for K in Grid.K_values), trials=TRIALS)
    return write_table(Table(COLUMNS, tuple(lines), caption), out, "table_2_truths", ABOVE, below)


if __name__ == "__main__":
    run_alone("table_2_truths", write)
