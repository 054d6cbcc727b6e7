"""Table 4 (ours): parameters of a humanoid that steps, learned together by three branch-and-bound algorithms.

python experiments/table_4.py [--out results/tables]
"""

from __future__ import annotations

from pathlib import Path

from learned import ROOT, Bench
from reproduce import run_alone
from several import Problem, brute_force, columns, line, runs

from robustopt.learning.parameters import Parameter
from robustopt.tables import Table, write_table

HUMANOID = ROOT / "configs" / "humanoid_step.yaml"
TRUTH = (
    "execution.truth.friction={left_foot: 0.3, right_foot: 0.15}",
    "execution.disturbance.force_deviation=[0, 0, 0]",
)
FEET = (Parameter("contact.friction.left_foot", 0.8, 0.08), Parameter("contact.friction.right_foot", 0.8, 0.08))

FRICTIONS = Problem("frictions", HUMANOID, TRUTH, FEET, budget=20, side=9, plans=100)
WITH_ERROR = Problem(
    "frictions, error",
    HUMANOID,
    (*TRUTH, "execution.truth.center_of_mass={torso: [0.0, 0.03, 0.05]}"),
    (*FEET, Parameter("uncertainty.base_acceleration", 0.0, 0.6)),
    budget=40,
    side=5,
    plans=125,
)

ABOVE = """# Table 4: a humanoid that steps

Written by `make reproduce-tables`. Two steps of 0.2 m; learned from success or failure alone are the coefficients
of friction of both feet, and with them the bound of the base's acceleration error [m/s^2, rad/s^2]. The actual
frictions are 0.3 (left) and 0.15 (right); with three parameters the torso's centre of mass is off by 3 cm to the
left and 5 cm up, which no parameter names.
"""

BELOW = """
- Beyond the paper, whose humanoid learns a coefficient of friction per limb by three algorithms whose text we do
  not have; these three are ours, see [learning](../../docs/learning.md). Executions of one plan do not vary,
  so one decides, and one simulation stands for all fresh trials.
- "lower bound": least duration of the region that no failure rules out; "gap": of the best plan to it. "fastest on
  the grid": of {two} x {two} and {three} x {three} x {three} plans over the box, each executed once from the
  fastest on until one succeeds.
- Budgets: {budget_two} executions for two parameters, {budget_three} for three.
"""


def run(name: str, place: Bench) -> None:
    """Run brute force and the learners on one of the problems."""
    (problem,) = (problem for problem in (FRICTIONS, WITH_ERROR) if problem.name == name)
    brute_force(problem, place)
    runs(problem, place)


def write(out: Path, place: Bench) -> list[Path]:
    """Write the table of the runs; make those that are not there."""
    lines = []
    for problem in (FRICTIONS, WITH_ERROR):
        quickest = brute_force(problem, place)
        lines += [line(problem, name, found, quickest) for name, found in runs(problem, place).items()]
    caption = (
        "Friction of both feet, and a bound of the base's acceleration error, learned together; a humanoid that steps."
    )
    below = BELOW.format(
        two=FRICTIONS.side, three=WITH_ERROR.side, budget_two=FRICTIONS.budget, budget_three=WITH_ERROR.budget
    )
    table = Table(columns([FRICTIONS, WITH_ERROR]), tuple(lines), caption)
    return write_table(table, out, "table_4", ABOVE, below)


if __name__ == "__main__":
    run_alone("table_4", write)
