"""Learners of several parameters on the tasks of tables 3 and 4, executed in MuJoCo, beside the same methods as in
bench_learners.py.

    python experiments/bench_learners_real.py [--methods NAME ...] [--quick] [--resume] [--out results/benchmarks]

Writes learners_real.csv (every run), learners_real.md and learners_real.svg. Runs that learners_real.csv holds already
are kept with --resume. Same seeds, same figures.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_learners import MARKS, executions_to, read_runs, states, unit_cube, write_runs
from learned import ROOT, bench
from learner_contenders import OURS, contenders
from learner_figure import write_figure
from real_problems import FINE, RESOLUTION, TASKS, RealProblem, Task, optimum

from robustopt.tables import Column, Table, Value, markdown_text

BUDGET = 40
"""Executions of every run."""

BRUTE_FORCE = "brute force"
"""Method of the line of the true optimum."""

SLOW = ("optuna GP",)
"""Methods that take long to propose."""

PLANS = 1000
"""Number of nodes of the guide, as by default; they come from the table of f*, which is as coarse or finer."""


def true_optimum(task: Task, world: RealProblem) -> dict[str, Value]:
    """Return the line of brute force: the duration of the fastest plan that succeeds, and the executions."""
    before = world.executions
    best = optimum(world.cost, world.execute, task.k, task.columns)
    return line(task, BRUTE_FORCE, 0, [world.duration(best)], None) | {"executions": world.executions - before}


def one_run(task: Task, world: RealProblem, method: str, seed: int) -> dict[str, Value]:
    """Return the duration of the incumbent, or of b, after every execution of one run, and the proven gap."""
    warnings.simplefilter("ignore")  # Optuna announces that constraints and multivariate sampling are experimental
    make = contenders()[method]
    settings = {} if make in OURS else {"seed": seed}
    learner = make(parameters=unit_cube(task.k), cost=world.cost, budget=BUDGET, plans=PLANS, **settings)
    durations, gap = [], None
    for state in states(learner, lambda point, _: world.execute(point)):
        best = learner.best(state)
        point = None if best is None else np.array([value for _, value in best.trial.belief.parameters])
        durations.append(world.longest if point is None else world.duration(point))
        gap = state.rows[-1].gap
    return line(task, method, seed, durations, gap)


def line(task: Task, method: str, seed: int, durations: list[float], gap: float | None) -> dict[str, Value]:
    """Return a line of the CSV; after the end of a run its incumbent stays."""
    at = {f"after_{n}": durations[min(n, len(durations)) - 1] for n in range(1, BUDGET + 1)}
    return {"task": task.name, "method": method, "seed": seed, "executions": len(durations), "gap": gap, **at}


# Summary --------------------------------------------------------------------------------------------------

COLUMNS = (
    Column("task", "task"),
    Column("method", "method"),
    Column("runs", "runs"),
    *(Column(f"regret_{n}", f"regret after {n} [%]", ".1f") for n in (5, 10, 20, 40)),
    Column("to_5_percent", "executions to 5 %", "g"),
    Column("found", "runs that got there [%]", ".0f"),
    Column("ratio", "of random search", ".2f"),
    Column("executions", "executions to the end", "g"),
    Column("gap", "proven gap [%]", ".1f"),
)

OPTIMA = (
    Column("task", "task"),
    Column("optimum", "true optimum [s]", ".3f"),
    Column("executions", "executions of brute force"),
)

ABOVE = """# Learning several parameters: the waiter and the humanoid

Written by `make bench-learners`. The tasks of [Table 3](../tables/table_3.md) and [Table 4](../tables/table_4.md),
every plan executed in MuJoCo. Learned are

{words}.

"""

BELOW = """
- Medians over runs. Regret: duration of the incumbent over the true optimum, minus 1; before the first success the
  plan of b counts, or if b has no plan, the slowest plan of the table of f*. "Executions to 5 %": from then to the
  end of the run the regret is at most 5 %. All methods have {budget} executions. An empty cell: the median run does
  not get there.
- One execution decides: nothing is random in these worlds, for which the waiter's tray is not pushed as it is in
  Table 3. So the learners have one run each, and the seeds of the other methods are of their own choices.
- The methods choose by f* interpolated (log-linearly) between the nodes of a table of plans: {nodes}, in the order of
  the tasks. The plan itself is executed, and the regret is from its own duration.
- The true optimum is by brute force: columns along the last parameter ({columns}), then {fine} times as dense around
  the best. In each the slowest plan that would be {resolution:g} % faster than the best so far is executed, and the
  column is bisected if it succeeds. Regret can be negative by the {resolution:g} %, and by plans between columns.
- "Proven gap": incumbent over lower bound at the end of the run, minus 1; a run ends when it is at most 1 %, when no
  undecided plan is worth a test, or with the budget.
{gp}
True optima:

"""

WITHOUT_GP = "- Optuna's GP sampler runs only if torch is installed, which it needs; these runs were made without it.\n"


def summary(runs: Sequence[dict[str, Value]]) -> list[dict[str, Value]]:
    """Return one record per task and method."""
    records: list[dict[str, Value]] = []
    for task in dict.fromkeys(run["task"] for run in runs):
        here = [run for run in runs if run["task"] == task]
        best = next(run["after_1"] for run in here if run["method"] == BRUTE_FORCE)
        counts: dict[Value, float] = {}
        for method in dict.fromkeys(run["method"] for run in here if run["method"] != BRUTE_FORCE):
            mine = [run for run in here if run["method"] == method]
            regrets = np.array([[run[f"after_{n}"] for n in range(1, BUDGET + 1)] for run in mine]) / best - 1
            found = [executions_to(row) or np.inf for row in regrets.tolist()]
            middle, counts[method] = np.median(regrets, axis=0), float(np.median(found))
            gaps = [np.inf if run["gap"] is None else run["gap"] for run in mine]
            ours = any(learner.name == method for learner in OURS)
            records.append({
                "task": task, "method": method, "runs": len(mine),
                **{f"regret_{n}": 100 * float(middle[n - 1]) for n in MARKS},
                "to_5_percent": counts[method] if np.isfinite(counts[method]) else None,
                "found": 100 * float(np.mean(np.isfinite(found))),
                "executions": float(np.median([run["executions"] for run in mine])),
                "gap": 100 * float(np.median(gaps)) if ours and np.isfinite(np.median(gaps)) else None,
            })  # fmt: skip
        for record in records:
            if record["task"] == task and np.isfinite(counts.get("random", np.inf)):
                mine = counts[record["method"]]
                record["ratio"] = mine / counts["random"] if np.isfinite(mine) else None
    return records


def write_report(runs: Sequence[dict[str, Value]], tasks: Sequence[Task], folder: Path) -> list[Path]:
    """Write learners_real.md and learners_real.svg from the runs, for the tasks that have some."""
    records = summary(runs)
    shown = dict.fromkeys(str(record["task"]) for record in records)
    tasks = [task for task in tasks if task.name in shown]
    missing = not any(record["method"] in SLOW for record in records)
    gp = WITHOUT_GP if missing else ""
    below = BELOW.format(
        budget=BUDGET, resolution=100 * RESOLUTION, fine=FINE, gp=gp,
        nodes=", ".join(" x ".join([str(task.nodes)] * task.k) for task in tasks),
        columns=", ".join(" x ".join([str(task.columns)] * (task.k - 1)) for task in tasks),
    )  # fmt: skip
    optima = [run | {"optimum": run["after_1"]} for run in runs if run["method"] == BRUTE_FORCE]
    page = folder / "learners_real.md"
    tables = markdown_text(Table(COLUMNS, tuple(records))), markdown_text(Table(OPTIMA, tuple(optima)))
    above = ABOVE.format(words=";\n".join(f"- {task.words}" for task in tasks))
    page.write_text(above + tables[0] + below + tables[1], encoding="utf-8")
    panels = [(name, [record for record in records if record["task"] == name]) for name in shown]
    return [page, *write_figure([panels], MARKS, folder, "learners_real")]


def missing_runs(task: Task, methods: Sequence[str], runs: Sequence[dict[str, Value]]) -> list[tuple[str, int]]:
    """Return the methods and seeds of a task that are missing; ours are not random, so they have one seed."""
    done = {(run["method"], run["seed"]) for run in runs if run["task"] == task.name}
    ours = [learner.name for learner in OURS]
    seeds = {method: 1 if method in ours else task.seeds[method in SLOW] for method in methods}
    wanted = [(BRUTE_FORCE, 0), *((method, seed) for method in methods for seed in range(seeds[method]))]
    return [one for one in wanted if one not in done]


def main() -> None:
    parser = argparse.ArgumentParser(description="Learners of several parameters on the waiter and the humanoid.")
    parser.add_argument("--methods", nargs="*", default=list(contenders()))
    parser.add_argument("--quick", action="store_true", help="the waiter alone, coarse, one run of each method")
    parser.add_argument("--workers", type=int, default=1, help="processes that plan")
    parser.add_argument("--resume", action="store_true", help="keep the runs that learners_real.csv holds")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    arguments = parser.parse_args()
    coarse = replace(TASKS[0], name=f"{TASKS[0].name}, coarse", nodes=5, columns=5, seeds=(1, 1))
    tasks = [coarse] if arguments.quick else list(TASKS)
    names = [task.name for task in (*TASKS, coarse)]
    place = bench("learners", arguments.out, arguments.workers, say=lambda text: print(text, flush=True))
    path = arguments.out / "learners_real.csv"
    runs = read_runs(path) if arguments.resume else []
    order = {name: number for number, name in enumerate((BRUTE_FORCE, *contenders()))}
    for task in tasks:
        todo = missing_runs(task, arguments.methods, runs)
        world = RealProblem(task, place) if todo else None
        for method, seed in todo:
            assert world is not None
            new = true_optimum(task, world) if method == BRUTE_FORCE else one_run(task, world, method, seed)
            runs.append(new)
            runs.sort(key=lambda run: (names.index(str(run["task"])), order[str(run["method"])], run["seed"]))
            write_runs(runs, path)
            place.say(f"{task.name}: {method}, seed {seed}: {new['executions']} executions, {new['after_40']:.4f} s")
    for file in (path, *write_report(runs, tasks, arguments.out)):
        print(file)


if __name__ == "__main__":
    main()
