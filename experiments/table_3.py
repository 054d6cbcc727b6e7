"""Table 3 (ours): two parameters of the waiter task learned together, by three branch-and-bound algorithms.

python experiments/table_3.py [--out results/tables]
"""

from __future__ import annotations

from pathlib import Path

from learned import TWO_BLOCKS, Bench
from reproduce import run_alone
from several import Problem, brute_force, columns, line, runs

from robustopt.learning.parameters import Parameter
from robustopt.tables import Table, write_table

FRICTION, HEIGHT = 0.35, 0.02

WAITER = Problem(
    name="friction, height",
    path=TWO_BLOCKS,
    overrides=(
        "uncertainty={}",
        "solver.method=reachability",
        f"execution.truth={{friction: {FRICTION}, center_of_mass: {{upper: [0, 0, {HEIGHT}]}}}}",
    ),
    parameters=(
        Parameter("contact.friction", 1.0, 0.1),
        Parameter("objects.upper.center_of_mass.2", -0.03, 0.05),
    ),
    budget=80,
    side=17,
    executions_per_plan=4,
)

ABOVE = """# Table 3: two parameters of the waiter task

Written by `make reproduce-tables`. Two blocks; learned are the coefficient of friction of both contacts and the
height of the upper block's centre of mass over its middle [m], from success or failure alone. Their actual values
are {friction:g} and {height:g}.
"""

BELOW = """
- Beyond the paper: its section 7 learns friction and centre of mass of the waiter task by three algorithms whose
  text we do not have; these three are ours, see [learning](../../docs/learning.md).
- The tray is pushed by 2 N as in Table 2, so outcomes near the boundary are random: a plan counts as a success if 4
  executions in a row succeed, and `bnb-informed` requires a success rate of 3/4.
- "lower bound": least duration of the region that no failure rules out; "gap": of the best plan to it. "fastest on
  the grid": of {side} x {side} plans over the box, each executed 4 times from the fastest on until one succeeds.
- Learned values are proxies: unmodelled effects, such as the controller's tracking error, are made up for by less
  friction or a higher centre of mass than the actual ones.
"""


def write(out: Path, place: Bench) -> list[Path]:
    """Run the learners and brute force, and write the table."""
    quickest = brute_force(WAITER, place)
    lines = tuple(line(WAITER, name, found, quickest) for name, found in runs(WAITER, place).items())
    caption = "Friction and height of a centre of mass learned together, two blocks."
    above, below = ABOVE.format(friction=FRICTION, height=HEIGHT), BELOW.format(side=WAITER.side)
    return write_table(Table(columns([WAITER]), lines, caption), out, "table_3", above, below)


if __name__ == "__main__":
    run_alone("table_3", write)
