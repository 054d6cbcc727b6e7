"""Report of `bench_planning.py`: all records as CSV, goals and measurements in Markdown, and the figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from bench_figure import Record, write_figure
from bench_rate import CERTIFICATE, JOINTS, MANY, POSES, PUBLIC
from contenders import COPP, TOPPRA

from robustopt.tables import Column, Table, csv_text, markdown_text

Goal = dict[str, str | bool]

GOAL_POINTS = (200, 1000, 2000)

NOTHING, HELP, PLAN = "python -c pass", "robustopt --help", "robustopt plan configs/waiter_two_blocks.yaml --no-figures"
"""Commands that are timed as whole processes."""

SAME = 1e-8
"""Relative difference below which durations count as equal: rows hold to 1e-9 of their limits."""

NOISE = 0.1
"""Scatter of the time per collocation point: the medians of a linear one may grow by this part."""

KEYS = (
    "part", "config", "uncertainty", "solver", "N", "rows", "seconds", "lower_quartile", "upper_quartile",
    "repetitions", "times_passes", "times_stage", "per_point", "duration", "longer", "excess", "import_seconds",
    "second_seconds", "rounds", "inner_programs", "inner_seconds", "paper_seconds", "settings", "workers", "late",
)  # fmt: skip

INTRODUCTION = """# Planning: computing times

Written by `make bench`. Every time is the median of repeated measurements, and every ratio the median of the ratios
within one round: the contenders take turns (A B C A B C ...), so that whatever else the machine does slows all of them.
"""

SOLVER_STAGE = """## Solver stage: the same rows

The rows of `build_problem`, redundant ones removed, without padding; the contenders satisfy them at both ends of every
interval. Where the path has stops, toppra and copp-py solve piece by piece, and the times are added. Constructing their
problems is not counted. "passes" is the backward and the forward pass of `reachability`, which give what the contenders
give; "all" is `solve_reachability`, which also bounds the distance to the optimum and polishes where the forward pass
is not optimal. Warm; a call shorter than 2 ms is repeated for that long.
"""

COLD_START = """## Cold: the first call in a fresh process

Import of the solver with construction of its problem, the first call and the second; two blocks. The compiled code of
`reachability` is kept on disk after its first use ever; the last line has nothing kept.
"""

WHOLE_PLAN = """## Whole plan in process

From the config object to the plan by `reachability`: grid, dynamics, rows (16 cone edges), solve; two blocks. Apart:
the robot and its path by inverse kinematics, which do not depend on N, and the certificate.
"""

GROWTH = """How the time grows: the same calls, the grids taking turns of half a second, or of one call where it is
longer. "Per point" is the time per collocation point against that on the first grid: linear growth is 1.
"""

CONTROL_RATE = """## Control rate

One block on a tray, warm, one core. `Planner.plan` plans another path with the same settings each time: 15 joint
waypoints, or two tray poses with inverse kinematics. "95 %" is the time within which so many calls are. Collision check
and certificate are calls of their own. `ro.solve` has the rows already; "passes" are its compiled kernel. "All
together" is `Planner.durations` for many joint paths.
"""

COMMAND_LINE = """## Command line

Whole processes, from the start of the interpreter to its end, everything compiled and the files in memory; planning
includes the certificate and the run folder.
"""

BATCH = """## Batches

Durations of two blocks, N = 200, for settings of the beliefs drawn at random: `BatchPlanner`, with nothing remembered
from setting to setting but robot, path and dynamics. The same plans, one by one, bit for bit. The worker processes have
been begun by an earlier batch, as in a learner: beginning them takes about two seconds, once.
"""

PAPERS_SPLIT = """## The paper's split

Ipopt outside, one linear program over the contact forces per grid point inside, until all of them are feasible; two
blocks. The paper's figures are read off its figure 3: about 10 s at N = 200, and over 40 s at N = 2000, on a laptop of
2.9 GHz with SNOPT and GLPK, with its own path and an unknown set of intervals: beside ours, not the same task.
"""

DISCRETISATION = """## Discretisation

Duration at N against that on the finest grid, minus 1 [%], by `reachability`, with the uncertainty of each config.
"""


def write_report(records: Sequence[Record], machine: str, folder: Path) -> list[Path]:
    """Write planning.csv, planning.md, planning.svg and planning.png, and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    table = Table(tuple(Column(key, key) for key in KEYS), tuple(records))
    sections = {
        f"{INTRODUCTION}\n{machine}\n\n## Goals\n": goals(records),
        f"![computing time](planning.svg)\n\n{SOLVER_STAGE}": _solver_stage(records),
        COLD_START: _cold_start(records),
        WHOLE_PLAN: _whole_plan(records),
        GROWTH: _growth(records),
        CONTROL_RATE: _control_rate(records),
        COMMAND_LINE: _command_line(records),
        BATCH: _batches(records),
        PAPERS_SPLIT: _papers_split(records),
        DISCRETISATION: _discretisation(records),
    }
    page = "\n".join(f"{text}\n{markdown_text(table)}" for text, table in sections.items())
    (folder / "planning.csv").write_text(csv_text(table), encoding="utf-8")
    (folder / "planning.md").write_text(page, encoding="utf-8")
    return [folder / "planning.csv", folder / "planning.md", *write_figure(records, folder)]


def select(records: Iterable[Record], part: str, **entries: object) -> list[Record]:
    """Return the records of a part with these entries; a tuple stands for any of its values."""
    wanted = {key: value if isinstance(value, tuple) else (value,) for key, value in entries.items()}
    return [r for r in records if r["part"] == part and all(r.get(key) in value for key, value in wanted.items())]


def goals(records: Sequence[Record]) -> Table:
    """List the goals and their results; a goal without measurements is left out."""
    lines = [*_stage_goals(records), *_plan_goals(records), *_rate_goals(records)]
    columns = tuple(Column(key, key) for key in ("what", "goal", "measured", "reached"))
    return Table(columns, tuple(line for line in lines if line["measured"]))


def _goal(what: str, limit: float, values: list[float], form: str = ".1f", tolerance: float = 0.0) -> Goal:
    """State a goal: the largest value stays at or below a limit."""
    worst = max(values, default=0.0)
    measured = format(worst, form) if values else ""
    return {"what": what, "goal": f"at most {limit:g}", "measured": measured, "reached": worst <= limit + tolerance}


def _stage_goals(records: Sequence[Record]) -> Iterator[Goal]:
    for solver, factor in ((TOPPRA, 20), (COPP, 3)):
        theirs = select(records, "solver stage", N=GOAL_POINTS, solver=solver)
        if theirs:
            passes, everything = (min(float(r[key]) for r in theirs) for key in ("times_passes", "times_stage"))
            yield {
                "what": f"{solver}: its time over that of the passes (of all), least at N = 200, 1000, 2000",
                "goal": f"at least {factor}",
                "measured": f"{passes:.1f} ({everything:.1f})",
                "reached": passes >= factor,
            }
    theirs = select(records, "solver stage", N=GOAL_POINTS, solver=(TOPPRA, COPP))
    yield _goal(
        "duration against theirs, relative excess", SAME, [1 / (1 + float(r["longer"])) - 1 for r in theirs], ".0e"
    )


def _plan_goals(records: Sequence[Record]) -> Iterator[Goal]:
    for case, limit in (("friction, acceleration", 15), ("all five", 60)):
        seconds = [1e3 * float(r["seconds"]) for r in select(records, "whole plan", uncertainty=case, N=200)]
        yield _goal(f"whole plan, N = 200, intervals: {case} [ms]", limit, seconds)
    growth = [float(r["per_point"]) for r in select(records, "growth", N=(2000, 5000))]
    yield _goal("whole plan: time per point at N = 2000 and 5000 against N = 1000", 1, growth, ".2f", NOISE)
    for command, limit in ((HELP, 0.4), (PLAN, 4)):
        seconds = [float(r["seconds"]) for r in select(records, "command line", solver=command)]
        yield _goal(f"`{command}` [s]", limit, seconds, ".2f")
    every = select(records, "batch", settings=1000)
    cores = max((int(r["workers"]) for r in every), default=1)
    seconds = [float(r["seconds"]) for r in every if r["workers"] == cores]
    yield _goal(f"1,000 settings of two blocks, N = 200, {cores} processes, slowest kind [s]", 2, seconds, ".2f")
    for points, limit in ((200, 2), (2000, 20)):
        seconds = [float(r["seconds"]) for r in select(records, "paper's split", N=points)]
        yield _goal(f"ipopt with inner programs, N = {points} [s]", limit, seconds, ".2f")
    excess = [100 * float(r["excess"]) for r in select(records, "discretisation", N=200)]
    yield _goal("duration at N = 200 above that on the finest grid, worst config [%]", 0.3, excess, ".3f")


def _scaled(records: Iterable[Record], factor: float, *keys: str) -> tuple[Record, ...]:
    return tuple({**r, **{key: factor * float(r[key]) for key in keys if key in r}} for r in records)


def _solver_stage(records: Sequence[Record]) -> Table:
    columns = (
        Column("config", "config"), Column("N", "N"), Column("rows", "rows per point"), Column("solver", "solver"),
        Column("seconds", "time [ms]", ".3f"), Column("times_passes", "times passes", ".2f"),
        Column("times_stage", "times all", ".2f"), Column("duration", "duration [s]", ".6f"),
        Column("longer", "longer than passes", ".1e"),
    )  # fmt: skip
    return Table(columns, _scaled(select(records, "solver stage"), 1e3, "seconds"))


def _cold_start(records: Sequence[Record]) -> Table:
    columns = (
        Column("solver", "solver"), Column("N", "N"), Column("import_seconds", "import [ms]", ".0f"),
        Column("seconds", "first call [ms]", ".2f"), Column("second_seconds", "second call [ms]", ".3f"),
    )  # fmt: skip
    return Table(columns, _scaled(select(records, "cold start"), 1e3, "import_seconds", "seconds", "second_seconds"))


def _whole_plan(records: Sequence[Record]) -> Table:
    columns = (
        Column("solver", "step"), Column("uncertainty", "intervals"), Column("N", "N"),
        Column("seconds", "time [ms]", ".1f"), Column("lower_quartile", "lower quartile", ".1f"),
        Column("upper_quartile", "upper quartile", ".1f"), Column("duration", "duration [s]", ".4f"),
    )  # fmt: skip
    return Table(columns, _scaled(select(records, "whole plan"), 1e3, "seconds", "lower_quartile", "upper_quartile"))


def _growth(records: Sequence[Record]) -> Table:
    columns = (
        Column("uncertainty", "intervals"), Column("N", "N"), Column("seconds", "time [ms]", ".1f"),
        Column("per_point", "per point", ".2f"),
    )  # fmt: skip
    return Table(columns, _scaled(select(records, "growth"), 1e3, "seconds"))


def _command_line(records: Sequence[Record]) -> Table:
    columns = (
        Column("solver", "command"), Column("seconds", "time [s]", ".2f"),
        Column("lower_quartile", "lower quartile", ".2f"), Column("upper_quartile", "upper quartile", ".2f"),
    )  # fmt: skip
    return Table(columns, tuple(select(records, "command line")))


def _rate_goals(records: Sequence[Record]) -> Iterator[Goal]:
    def measured(name: str, key: str, factor: float = 1e3) -> list[float]:
        found = select(records, "control rate", solver=name, N=GOAL_POINTS)
        return [factor * float(record[key]) for record in found]

    yield _goal(f"{JOINTS}, N = 200 [ms]", 12, measured(JOINTS, "seconds"))
    yield _goal(f"{JOINTS}, N = 200, 95 % [ms]", 20, measured(JOINTS, "late"))
    yield _goal(f"{POSES}, N = 200 [ms]", 25, measured(POSES, "seconds"))
    yield _goal(f"{CERTIFICATE}, N = 200 [ms]", 60, measured(CERTIFICATE, "seconds"))
    yield _goal(f"{PUBLIC} over its passes, N = 200, 1000", 3, measured(PUBLIC, "times_passes", 1.0))
    several = select(records, "control rate", solver=MANY, settings=1000, workers=2)
    yield _goal("1,000 joint paths, N = 200, 2 processes [s]", 10, [float(record["seconds"]) for record in several])


def _control_rate(records: Sequence[Record]) -> Table:
    columns = (
        Column("solver", "call"), Column("N", "N"), Column("ms", "time [ms]", ".2f"),
        Column("late_ms", "95 % [ms]", ".2f"), Column("times_passes", "times passes", ".2f"),
        Column("settings", "paths"), Column("workers", "processes"),
    )  # fmt: skip
    return Table(columns, tuple(
        {**record, "ms": 1e3 * float(record["seconds"]), "late_ms": 1e3 * float(record["late"])}
        for record in select(records, "control rate")
    ))  # fmt: skip


def _batches(records: Sequence[Record]) -> Table:
    columns = (
        Column("uncertainty", "beliefs"), Column("settings", "settings"), Column("workers", "processes"),
        Column("seconds", "time [s]", ".2f"), Column("lower_quartile", "lower quartile", ".2f"),
        Column("upper_quartile", "upper quartile", ".2f"),
    )  # fmt: skip
    return Table(columns, tuple(select(records, "batch")))


def _papers_split(records: Sequence[Record]) -> Table:
    columns = (
        Column("uncertainty", "intervals"), Column("N", "N"), Column("seconds", "time [s]", ".2f"),
        Column("paper_seconds", "paper, about [s]", ".0f"), Column("rounds", "rounds"),
        Column("inner_programs", "inner programs"), Column("inner_seconds", "of it in inner programs [s]", ".2f"),
        Column("duration", "duration [s]", ".6f"), Column("longer", "longer than reachability", ".1e"),
    )  # fmt: skip
    return Table(columns, tuple(select(records, "paper's split")))


def _discretisation(records: Sequence[Record]) -> Table:
    """Make a table with one line per configuration and one column per N."""
    measured = select(records, "discretisation")
    points = sorted({int(r["N"]) for r in measured})
    lines: dict[str, dict[str, float | int | str]] = {}
    for r in measured:
        line = lines.setdefault(str(r["config"]), {"config": str(r["config"])})
        line[f"N{r['N']}"] = 100 * float(r["excess"])
        line["duration"] = float(r["duration"])
    columns = (
        Column("config", "config"), *(Column(f"N{n}", str(n), ".3f") for n in points[:-1]),
        Column("duration", f"duration at {points[-1]} [s]", ".4f"),
    )  # fmt: skip
    return Table(columns, tuple(lines.values()))
