"""Write the results of the calibrated learner in a stochastic world, beside ILROBS and brute force.

python experiments/table_2_calibrated.py [--out results/tables]
"""

from __future__ import annotations

import json
from pathlib import Path

from learned import STOCHASTIC, Bench, learned, success, task
from reproduce import run_alone
from scan import Grid, fastest

from robustopt.learning.learner import Belief, Row
from robustopt.learning.moments import ErrorInterval
from robustopt.runs.campaign import Learned
from robustopt.runs.learning_summary import row_record
from robustopt.tables import Column, Table, write_table

RATES = (0.7, 0.9, 0.99)
TRIALS = 500

COLUMNS = (
    Column("rate", "p", "g"),
    Column("learner", "learner"),
    Column("executions", "executions"),
    Column("friction", "mu", ".4g", r"$\mu$"),
    Column("K", "K", "g"),
    Column("duration", "time [s]", ".3f"),
    Column("fresh", f"{TRIALS} fresh trials, successes [%]"),
    Column("meets", "does not exclude p"),
    Column("gained", "faster than ILROBS [%]", ".1f"),
    Column("fastest", "fastest by brute force [s]", ".3f"),
    Column("slower", "slower than that [%]", ".1f"),
)

ABOVE = """# Calibrated learner: the fastest plan that meets a success rate p at 95 % confidence

Written by `make reproduce-all`. One block, stochastic world: actual friction 0.5 with a standard deviation of 0.05
from trial to trial, and a random force of 20 N standard deviation on the tray. `ilrobs-calibrated` tests the plan
that ILROBS(K = 1) returned before its own search.
"""

BELOW = """
- "does not exclude p": the upper end of the exact 95 % interval of {trials} fresh trials is at least p.
- ILROBS(K = 1): the plan that it executed last with success, and the plan that it returned. It has no p; it is
  compared if its own fresh trials do not exclude p.
- Brute force: the fastest plan on a grid of mu (steps of {step:.0f} %, about half of that in duration) and K = {K},
  with the U and Delta of ILROBS, whose rate in {trials} trials of its own is at least p. It needs tens of thousands
  of executions. Its winner is the best of many in the same trials, so its rate is slightly overestimated.
- The guarantee costs executions and speed: with a confidence of 95 % *no* plan that was accepted has a rate below
  p, so the accepted plan's actual rate is above p by the difference that the executions allowed can show.
"""


def write(out: Path, place: Bench) -> list[Path]:
    """Learn for every rate, scan, and write the table."""
    ilrobs = learned(task((f"learning.trials={TRIALS}", "learning.judged=result", *STOCHASTIC)), "ilrobs", place)
    best, returned = ilrobs.best, ilrobs.returned
    if best is None or returned is None:
        raise SystemExit("ILROBS found no plan that succeeds")
    error = returned.trial.belief.error or ErrorInterval()
    grid = Grid(ErrorInterval(error.mean, error.deviation, 1.0), 0.25, 0.8)
    quickest = fastest(task(STOCHASTIC), grid.beliefs, RATES, TRIALS, "scan", place)
    lines = []
    for rate, found in zip(RATES, quickest, strict=True):
        lines += [
            _line(rate, "ilrobs, executed", ilrobs, best, best, found.duration),
            _line(rate, "ilrobs, returned", ilrobs, returned, best, found.duration),
        ]
        calibrated = learned(task(_overrides(rate, returned.trial.belief)), f"calibrated-{rate:g}", place)
        if calibrated.best is not None:
            lines.append(_line(rate, "calibrated", calibrated, calibrated.best, best, found.duration))
    caption = "The calibrated learner in a stochastic world, beside ILROBS and brute force."
    below = BELOW.format(trials=TRIALS, step=100 * (Grid.ratio - 1), K=", ".join(f"{K:g}" for K in Grid.K_values))
    return write_table(Table(COLUMNS, tuple(lines), caption), out, "table_2_calibrated", ABOVE, below)


def _overrides(rate: float, first: Belief) -> tuple[str, ...]:
    """Return the overrides of the calibrated learner for a rate, which tests a setting first."""
    error = first.error or ErrorInterval()
    mean, deviation = ([error.share * value for value in values] for values in (error.mean, error.deviation))
    belief = {"friction": first.friction, "joint_acceleration": {"mean": mean, "deviation": deviation, "K": error.K}}
    learner = {
        "algorithm": "ilrobs-calibrated", "success_rate": rate, "friction": [0.2, 1.0], "first": belief,
        "trials": TRIALS, "judged": "result",
    }  # fmt: skip
    return (f"learning={json.dumps(learner)}", *STOCHASTIC)


def _line(rate: float, name: str, found: Learned, row: Row, ilrobs: Row, quickest: float) -> dict:
    record, duration = row_record(found, row), row.trial.duration or float("nan")
    error = row.trial.belief.error or ErrorInterval()
    return {
        "rate": rate,
        "learner": name,
        "executions": found.state.executed,
        "friction": row.trial.belief.friction,
        "K": error.K if not error.is_zero else 0.0,
        "duration": duration,
        "fresh": success(record),
        "meets": record.success_high >= rate,
        "gained": 100 * ((ilrobs.trial.duration or float("nan")) / duration - 1) if name == "calibrated" else None,
        "fastest": quickest,
        "slower": 100 * (duration / quickest - 1),
    }


if __name__ == "__main__":
    run_alone("table_2_calibrated", write)
