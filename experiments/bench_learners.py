"""Learners of several parameters on synthetic monotone problems, beside random search, a grid and Optuna's samplers.

    python experiments/bench_learners.py [--seeds N] [--methods NAME ...] [--resume] [--out results/benchmarks]

Writes learners.csv (every run), learners.md and learners.svg: `make bench-learners`. Runs that learners.csv holds
already are kept with --resume. Same seeds, same figures, whatever the number of workers.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from learner_contenders import OURS, contenders
from learner_figure import Panel, write_figure
from monotone_problems import HELD_OUT, Array, Problem, problem

from robustopt.confidence import paper_executions, phi
from robustopt.errors import RobustOptError
from robustopt.learning.branch_and_bound import BranchAndBound, BranchState
from robustopt.learning.learner import Executed, Planned
from robustopt.learning.parameters import Parameter
from robustopt.processes import cores, in_processes
from robustopt.tables import Column, Table, Value, markdown_text

ROOT = Path(__file__).resolve().parents[1]

MARKS = (1, 2, 3, 5, 7, 10, 14, 20, 28, 40)
"""Executions after which the regret is recorded."""

CLOSE = 0.05
"""Regret that counts as found."""

LENIENT = 0.1
"""Largest deficit of an incumbent's actual success rate; with a larger one, b counts as the incumbent."""

FEW = {"optuna GP": 3}
"""Largest number of seeds of methods that take long to propose."""

K = 1.0
"""K of the noisy world: N_e(K) executions in a row, success rate Phi(K)."""


@dataclass(frozen=True)
class World:
    """A world: noise is the standard deviation of the margin, budgets are those of `bnb-informed` and of the others."""

    name: str
    noise: float
    executions_per_plan: int
    budgets: tuple[int, int]


WORLDS = (World("quiet", 0.0, 1, (60, 100)), World("noisy", 0.05, paper_executions(K), (80, 120)))
DIMENSIONS = (2, 3, 4)


def one_run(world: World, k: int, method: str, seed: int) -> dict[str, Value]:
    """Return the regret after every execution of one run, and the proven gap."""
    warnings.simplefilter("ignore")  # Optuna announces that constraints and multivariate sampling are experimental
    rate = phi(K) if world.noise else 0.5
    task = problem(k, seed, HELD_OUT, world.noise, rate)
    make = contenders()[method]
    informed = make is OURS[0]
    settings = {} if make in OURS else {"seed": seed}
    learner = make(
        parameters=unit_cube(k),
        cost=task.cost,
        budget=world.budgets[0 if informed else 1],
        executions_per_plan=world.executions_per_plan,
        **settings,
    )
    regrets, gap, attained = [], None, None
    state = learner.initial()
    for state in states(learner, lambda point, number: task.execute(point, seed, number)):
        regrets.append(regret(learner, state, task, rate))
        if len(regrets) <= MARKS[-1] and state.rows:
            gap, attained = state.rows[-1].gap, incumbent_rate(learner, state, task)
        if len(regrets) >= MARKS[-1] and regrets[-1] <= CLOSE:
            break
    regrets = regrets or [regret(learner, state, task, rate)]
    at = {f"regret_{n}": regrets[min(n, len(regrets)) - 1] for n in MARKS}
    return {"world": world.name, "k": k, "method": method, "seed": seed, "shape": task.name,
            "to_5_percent": executions_to(regrets), "executions": len(regrets), "gap_40": gap, "rate_40": attained,
            **at}  # fmt: skip


def states(learner: BranchAndBound, execute: Callable[[Array, int], bool]) -> Iterator[BranchState]:
    """Yield the state of a learner over the unit cube after every execution of a point (k,) with a number."""
    state = learner.initial()
    while (request := learner.ask(state)) is not None:
        if request.executions == 0:
            state = learner.tell(state, Planned(1.0))
            continue
        point = np.array([value for _, value in request.belief.parameters])
        state = learner.tell(state, Executed(execute(point, request.first)))
        yield state


def unit_cube(k: int) -> tuple[Parameter, ...]:
    return tuple(Parameter(str(axis), 0.0, 1.0) for axis in range(k))


def executions_to(regrets: Sequence[float]) -> int | None:
    """Return the number of executions from which the regret stays at most `CLOSE`; None without one."""
    wrong = [i for i, value in enumerate(regrets) if value > CLOSE]
    return None if wrong and wrong[-1] == len(regrets) - 1 else (wrong[-1] + 2 if wrong else 1)


def incumbent_rate(learner: BranchAndBound, state: BranchState, task: Problem) -> float | None:
    """Return the actual success rate of the incumbent; None without one."""
    best = learner.best(state)
    return None if best is None else float(task.success_rate(np.array([v for _, v in best.trial.belief.parameters]))[0])


def regret(learner: BranchAndBound, state: BranchState, task: Problem, rate: float) -> float:
    """Return the cost of the incumbent, or of b without a good one, over the optimum, minus 1."""
    best = learner.best(state)
    point = np.ones(task.k) if best is None else np.array([value for _, value in best.trial.belief.parameters])
    if task.noise and task.success_rate(point)[0] < rate - LENIENT:
        point = np.ones(task.k)
    return float(task.cost(point[None])[0] / task.optimum - 1)


# Summary --------------------------------------------------------------------------------------------------

COLUMNS = (
    Column("world", "world"),
    Column("k", "parameters"),
    Column("method", "method"),
    Column("runs", "runs"),
    *(Column(f"regret_{n}", f"regret after {n} [%]", ".1f") for n in (5, 10, 20, 40)),
    Column("to_5_percent", "executions to 5 %", "g"),
    Column("found", "runs that got there [%]", ".0f"),
    Column("ratio", "of random search", ".2f"),
    Column("short", "incumbents under the rate [%]", ".0f"),
    Column("gap_40", "proven gap [%]", ".0f"),
)

BELOW = """
- Medians over seeds. Regret: cost of the incumbent over the true optimum, minus 1; before the first success the
  incumbent is b, which succeeds by assumption. "Executions to 5 %": from then to the end of the run the regret is at
  most 5 %; a run that does not get there counts as more than its budget ({budgets}). An empty
  cell: the median run does not.
- Problems: `experiments/monotone_problems.py`, the shapes {shapes}, on which no constant of a learner was chosen. The
  true optimum is found by brute force on the boundary.
- Noisy: the margin of an execution has a standard deviation of {noise:g} (parameters lie in [0, 1]); the required
  success rate is {rate:.3f}, which the other methods test by {executions} successes in a row. Every execution
  counts. An incumbent whose actual rate is more than {lenient:g} below that counts as b.
- Random search, the grid and Optuna's samplers never execute a point that monotony decides or that costs more than
  the incumbent. Optuna's samplers get the inferences from monotony at no cost, and success as a constraint.
{gp}- "Incumbents under the rate": of the incumbents after 40 executions, the share whose actual success rate is
under the required one, by however little; without noise there is none.
- "Proven gap": incumbent over lower bound after 40 executions, minus 1. In the noisy world the bound of
  `bnb-informed` holds by its model, the others by their verdicts.
"""


def summary(runs: Sequence[dict[str, Value]]) -> list[dict[str, Value]]:
    """Return one record per world, number of parameters and method."""
    records: list[dict[str, Value]] = []
    for world, k in product(WORLDS, DIMENSIONS):
        here = [run for run in runs if run["world"] == world.name and run["k"] == k]
        counts = {}
        for method in dict.fromkeys(run["method"] for run in here):
            mine = [run for run in here if run["method"] == method]
            found = [np.inf if run["to_5_percent"] is None else run["to_5_percent"] for run in mine]
            counts[method] = float(np.median(found))
            rates = [run["rate_40"] for run in mine if run["rate_40"] is not None] if world.noise else []
            gaps = [np.inf if run["gap_40"] is None else run["gap_40"] for run in mine]
            ours = any(learner.name == method for learner in OURS)
            records.append({
                "world": world.name, "k": k, "method": method, "runs": len(mine),
                **{f"regret_{n}": 100 * float(np.median([run[f"regret_{n}"] for run in mine])) for n in MARKS},
                "to_5_percent": counts[method] if np.isfinite(counts[method]) else None,
                "found": 100 * float(np.mean(np.isfinite(found))),
                "short": 100 * float(np.mean(np.array(rates) < phi(K))) if rates else None,
                "gap_40": 100 * float(np.median(gaps)) if ours and np.isfinite(np.median(gaps)) else None,
            })  # fmt: skip
        for record in records:
            if (record["world"], record["k"]) == (world.name, k) and np.isfinite(counts.get("random", np.inf)):
                mine = counts[str(record["method"])]
                record["ratio"] = mine / counts["random"] if np.isfinite(mine) else None
    return records


# Files ----------------------------------------------------------------------------------------------------


WORDS = ("world", "method", "shape", "task")
WHOLE = ("k", "seed", "to_5_percent", "executions")


def read_runs(path: Path) -> list[dict[str, Value]]:
    """Read the runs of an earlier call."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        {key: text if key in WORDS else None if text == "" else int(text) if key in WHOLE else float(text)
         for key, text in row.items()}
        for row in rows
    ]  # fmt: skip


def write_runs(runs: Sequence[dict[str, Value]], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(runs[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in run.items()} for run in runs)


def write_report(runs: Sequence[dict[str, Value]], folder: Path) -> list[Path]:
    """Write learners.md and learners.svg from the runs."""
    missing = {run["method"] for run in runs} >= {"optuna GP"}
    gp = "" if missing else "- Optuna's GP sampler is run where torch is installed, which it needs; it was not here.\n"
    below = BELOW.format(
        budgets=", ".join(f"{w.name} {w.budgets[0]} for `bnb-informed`, {w.budgets[1]} for others" for w in WORLDS),
        shapes=", ".join(f"`{shape.__name__}`" for shape in HELD_OUT), noise=WORLDS[1].noise, rate=phi(K),
        executions=WORLDS[1].executions_per_plan, lenient=LENIENT, gp=gp,
    )  # fmt: skip
    records = summary(runs)
    text = "# Learning several parameters: synthetic problems\n\nWritten by `make bench-learners`.\n\n"
    page = folder / "learners.md"
    page.write_text(text + markdown_text(Table(COLUMNS, tuple(records))) + below, encoding="utf-8")
    return [page, *write_figure(panels(records), MARKS, folder, "learners")]


def panels(records: Sequence[dict[str, Value]]) -> list[list[Panel]]:
    """Return the panels of the figure: a row per world, a column per number of parameters."""
    return [
        [(f"{k} parameters, {world.name}", [r for r in records if (r["world"], r["k"]) == (world.name, k)])
         for k in dict.fromkeys(record["k"] for record in records)]
        for world in WORLDS
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="Learners of several parameters on synthetic monotone problems.")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--methods", nargs="*", default=list(contenders()))
    parser.add_argument("--dimensions", nargs="*", type=int, default=list(DIMENSIONS))
    parser.add_argument("--workers", type=int, default=cores())
    parser.add_argument("--resume", action="store_true", help="keep the runs that learners.csv holds")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    arguments = parser.parse_args()
    path = arguments.out / "learners.csv"
    runs = read_runs(path) if arguments.resume else []
    done = {(run["world"], run["k"], run["method"], run["seed"]) for run in runs}
    tasks = [
        (world, k, method, seed)
        for world, k, method, seed in product(WORLDS, arguments.dimensions, arguments.methods, range(arguments.seeds))
        if seed < FEW.get(method, arguments.seeds) and (world.name, k, method, seed) not in done
    ]
    names, order = list(contenders()), [world.name for world in WORLDS]

    def place(run: dict[str, Value]) -> tuple[int, int, int, int]:
        return order.index(run["world"]), run["k"], names.index(run["method"]), run["seed"]

    for number, run in enumerate(in_processes(one_run, tasks, arguments.workers, RobustOptError), 1):
        runs.append(run)
        if number % 50 == 0 or number == len(tasks):
            runs.sort(key=place)
            write_runs(runs, path)
            print(f"{number} of {len(tasks)} runs", flush=True)
    for file in (path, *write_report(runs, arguments.out)):
        print(file)


if __name__ == "__main__":
    main()
