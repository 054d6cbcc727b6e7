"""The experiments run, small: what they write is complete and finite; how fast the machine is does not matter here."""

import csv
import importlib
import json
import math
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robustopt.tables import Column, Table, csv_text, latex_text, markdown_text, write_table

ROOT = Path(__file__).parent.parent
EXPERIMENTS = ROOT / "experiments"


def run(script: str, folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-W", "error", str(EXPERIMENTS / script), *arguments, "--out", str(folder)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


class TestTables:
    TABLE = Table(
        (
            Column("mu", "friction", ".2f", r"$\mu$"),
            Column("name", "what_binds"),
            Column("fits", "fits"),
            Column("n", "N"),
        ),
        (
            {"mu": 1 / 3, "name": "slip | 50 %", "fits": True, "n": 7},
            {"mu": math.nan, "name": "a & b, c", "fits": False},
        ),
        "Friction & more",
    )

    def test_csv_has_significant_digits_and_empty_cells(self):
        assert csv_text(self.TABLE) == 'mu,name,fits,n\n0.333333,slip | 50 %,yes,7\n,"a & b, c",no,\n'

    def test_markdown_aligns_numbers_right_and_escapes_the_separator(self):
        lines = markdown_text(self.TABLE).splitlines()
        assert lines[0] == "Friction & more"
        assert lines[2:4] == ["| friction | what_binds | fits | N |", "| ---: | --- | --- | ---: |"]
        assert lines[4:] == [r"| 0.33 | slip \| 50 % | yes | 7 |", "|  | a & b, c | no |  |"]

    def test_latex_escapes_what_latex_reads_as_commands(self):
        text = latex_text(self.TABLE)
        assert r"  $\mu$ & what\_binds & fits & N \\" in text
        assert r"  0.33 & slip | 50 \% & yes & 7 \\" in text
        assert r"\caption{Friction \& more}" in text
        assert r"\begin{tabular}{rllr}" in text

    def test_three_files_are_written_into_a_new_folder(self, tmp_path):
        paths = write_table(self.TABLE, tmp_path / "new", "friction", above="# Head\n", below="\nFoot.\n")
        assert [path.name for path in paths] == ["friction.csv", "friction.md", "friction.tex"]
        text = paths[1].read_text(encoding="utf-8")
        assert text == f"# Head\n\n{markdown_text(self.TABLE)}\nFoot.\n"


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables")
    run("table_durations.py", folder, "--points", "60")
    return folder


@pytest.fixture(scope="module")
def benchmarks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("benchmarks")
    run("bench_planning.py", folder, "--quick")
    return folder


class TestDurations:
    def test_ratios_are_those_of_friction_where_it_binds_alone(self, tables):
        lines = {float(line["friction"]): line for line in read(tables / "durations.csv")}
        for friction, above in ((0.1875, 0.25), (0.125, 0.1875)):
            assert float(lines[friction]["ratio"]) == pytest.approx(math.sqrt(above / friction), rel=2e-3)
        assert 1.0 - 1e-6 <= float(lines[0.5]["ratio"]) < 1.005

    def test_both_solvers_agree(self, tables):
        for line in read(tables / "durations.csv"):
            assert float(line["ipopt"]) == pytest.approx(float(line["reachability"]), rel=1e-4)
            assert float(line["fine"]) == pytest.approx(float(line["reachability"]), rel=2e-2)

    def test_the_papers_numbers_are_in_their_own_column(self, tables):
        found = [(float(line["friction"]), float(line["paper"])) for line in read(tables / "durations.csv")]
        assert found == [(1.0, 3.229), (0.5, 3.232), (0.25, 3.704), (0.1875, 4.276), (0.125, 5.237)]

    @pytest.mark.slow
    def test_running_twice_gives_the_same_files(self, tables, tmp_path):
        run("table_durations.py", tmp_path, "--points", "60")
        assert sorted(path.name for path in tables.iterdir()) == ["durations.csv", "durations.md", "durations.tex"]
        for path in tables.iterdir():
            assert path.read_bytes() == (tmp_path / path.name).read_bytes()


@pytest.fixture(scope="module")
def learned_tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learned") / "tables"
    run("reproduce.py", folder, "--only", "table_2")
    return folder


@pytest.mark.slow
class TestLearnedTables:
    def test_iterations_are_those_of_the_algorithm(self, learned_tables):
        lines = read(learned_tables / "table_2.csv")
        assert [line["result"] for line in lines][-1] == "returned"
        tried = lines[:-1]
        assert float(tried[0]["friction"]) == 1.0
        low, high = 0.0, 1.0
        for line, following in zip(tried, lines[1:], strict=True):
            mu = float(line["friction"])
            low, high = (mu, high) if line["result"] == "S" else (low, mu)
            assert (float(line["friction_low"]), float(line["friction_high"])) == (low, high)
            assert int(line["executions"]) == (7 if line["result"] == "S" else 1) or line["result"] == "F"
            if following["result"] != "returned":
                assert float(following["friction"]) == (low + high) / 2
        assert high - low <= 0.05

    def test_what_was_learned_succeeds_at_least_as_often_as_the_papers(self, learned_tables):
        last = read(learned_tables / "table_2.csv")[-1]
        rate, interval = last["fresh"].split(" ", 1)
        assert float(rate) >= float(last["paper_success"]) == 74
        low, high = interval.strip("[]").split(", ")
        assert float(low) <= float(rate) <= float(high)

    def test_a_second_run_reads_the_first_again(self, learned_tables):
        before = {path.name: path.read_bytes() for path in learned_tables.iterdir()}
        journals = list(learned_tables.parent.rglob("journal.db"))
        changed = journals[0].stat().st_mtime_ns
        run("reproduce.py", learned_tables, "--only", "table_2")
        assert {path.name: path.read_bytes() for path in learned_tables.iterdir()} == before
        assert len(journals) == 1
        assert journals[0].stat().st_mtime_ns == changed

    @pytest.mark.slow
    def test_another_run_gives_the_same_tables(self, learned_tables, tmp_path):
        run("reproduce.py", tmp_path / "tables", "--only", "table_2", "--workers", "2")
        for path in learned_tables.iterdir():
            assert path.read_bytes() == (tmp_path / "tables" / path.name).read_bytes()


@pytest.mark.slow
class TestPlanningBenchmark:
    @pytest.fixture
    def records(self, benchmarks):
        return read(benchmarks / "planning.csv")

    def test_every_file_is_written(self, benchmarks):
        assert {path.name for path in benchmarks.iterdir()} == {
            f"planning.{kind}" for kind in ("csv", "md", "svg", "png")
        }

    def test_every_part_is_measured_for_every_solver(self, records):
        found = {(line["part"], line["solver"]) for line in records}
        stage = {"reachability, passes", "reachability, all", "toppra seidel", "copp-py topp2_ra"}
        planning = "robustopt plan configs/waiter_two_blocks.yaml --no-figures"
        assert found == {
            *(("solver stage", solver) for solver in stage),
            *(("cold start", solver) for solver in stage - {"reachability, all"}),
            *(("whole plan", step) for step in ("robot", "path", "reachability, rows and solve")),
            ("growth", "reachability, rows and solve"),
            *(("command line", command) for command in ("python -c pass", "robustopt --help", planning)),
            ("batch", "reachability, rows and solve"),
            ("paper's split", "ipopt, inner programs"),
            ("discretisation", "reachability"),
            *(("control rate", call) for call in ("new joint path", "new tray poses", "collision check")),
            *(("control rate", call) for call in ("certificate", "ro.solve", "passes", "joint paths, all together")),
        }

    def test_times_and_ratios_are_positive_and_finite(self, records):
        keys = ("seconds", "times_passes", "times_stage", "per_point", "import_seconds", "duration")
        values = np.array([float(line[key]) for line in records for key in keys if line[key]])
        assert len(values) > len(records)
        assert np.isfinite(values).all()
        assert (values > 0).all()
        for line in records:
            if line["seconds"]:
                assert float(line["lower_quartile"]) <= float(line["seconds"]) <= float(line["upper_quartile"])

    def test_solvers_find_the_same_duration_on_the_same_rows(self, records):
        stage = [line for line in records if line["part"] == "solver stage" and line["solver"] != "reachability, all"]
        assert len(stage) == 12
        for line in stage:
            assert abs(float(line["longer"])) < 1e-6

    def test_ipopt_and_reachability_agree(self, records):
        for line in records:
            if line["part"] == "paper's split":
                assert abs(float(line["longer"])) < 1e-4

    def test_finer_grids_come_closer_to_the_finest(self, records):
        for config in ("waiter_two_blocks", "waiter_side_by_side"):
            lines = [line for line in records if line["part"] == "discretisation" and line["config"] == config]
            excess = [abs(float(line["excess"])) for line in lines]
            assert excess == sorted(excess, reverse=True)
            assert excess[-1] == 0.0

    def test_the_page_names_the_machine_but_not_the_host(self, benchmarks):
        text = (benchmarks / "planning.md").read_text(encoding="utf-8")
        assert f"Python {platform.python_version()}" in text
        assert "toppra" in text
        for private in (platform.node(), str(ROOT), str(Path.home()), sys.prefix):
            assert len(private) < 3 or private not in text

    def test_goals_are_judged_only_where_they_were_measured(self, benchmarks):
        text = (benchmarks / "planning.md").read_text(encoding="utf-8")
        goals = text.split("## Goals")[1].split("![")[0]
        assert "N = 200" not in goals


def test_a_contender_reports_its_first_calls_in_a_fresh_process(tmp_path):
    s = np.linspace(0.0, 1.0, 11)
    ones = np.ones((11, 2))
    file = tmp_path / "rows.npz"
    # a double integrator |u| <= 1 without a bound on x that matters
    np.savez(
        file, s=s, piece=np.zeros(11, dtype=int), a=ones * [1.0, -1.0], b=0 * ones, c=-ones, x_max=np.full(11, 9.0)
    )
    for solver in ("reachability, passes", "toppra seidel", "copp-py topp2_ra"):
        command = [sys.executable, str(EXPERIMENTS / "contenders.py"), solver, str(file)]
        seconds = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        assert seconds.keys() == {"import", "first", "second"}
        assert min(seconds.values()) > 0


@pytest.mark.slow
def test_the_benchmark_of_learners_writes_every_run_and_its_summary(tmp_path):
    wanted = ["--dimensions", "2", "--methods", "bnb-midpoint", "random", "--workers", "1"]
    run("bench_learners.py", tmp_path, "--seeds", "1", *wanted)
    runs = read(tmp_path / "learners.csv")
    assert [(r["world"], r["method"]) for r in runs] == [
        ("quiet", "bnb-midpoint"), ("quiet", "random"), ("noisy", "bnb-midpoint"), ("noisy", "random"),
    ]  # fmt: skip
    assert all(float(r["regret_40"]) <= float(r["regret_1"]) for r in runs if r["world"] == "quiet")
    page = (tmp_path / "learners.md").read_text(encoding="utf-8")
    assert "| quiet | 2 | bnb-midpoint | 1 |" in page
    assert (tmp_path / "learners.svg").exists()
    before = (tmp_path / "learners.csv").read_bytes()
    run("bench_learners.py", tmp_path, "--seeds", "1", *wanted, "--resume")
    assert (tmp_path / "learners.csv").read_bytes() == before


@pytest.mark.slow
def test_the_benchmark_of_learners_executes_the_waiter(tmp_path):
    folder = tmp_path / "benchmarks"
    arguments = ["--quick", "--methods", "bnb-informed"]
    run("bench_learners_real.py", folder, *arguments)
    runs = read(folder / "learners_real.csv")
    assert [run["method"] for run in runs] == ["brute force", "bnb-informed"]
    for one in runs:
        incumbents = [float(one[f"after_{n}"]) for n in range(1, 41)]
        assert incumbents[0] >= incumbents[-1] > 3.0  # [s]; the most optimistic plan takes 2.99 s
    page = (folder / "learners_real.md").read_text(encoding="utf-8")
    assert "| waiter: friction, height, coarse | bnb-informed | 1 |" in page
    assert (folder / "learners_real.svg").exists()
    before = (folder / "learners_real.csv").read_bytes()
    run("bench_learners_real.py", folder, *arguments, "--resume")
    assert (folder / "learners_real.csv").read_bytes() == before


def test_every_part_is_written_once_and_after_its_runs(monkeypatch):
    monkeypatch.syspath_prepend(EXPERIMENTS)
    import reproduce

    for parts in (reproduce.PAPER, reproduce.PAPER + reproduce.BEYOND, ("figure_8", "table_1"), ("table_4",)):
        order = [work for stage, _ in reproduce.stages_of(parts, 2) for work in stage]
        assert sorted(work.part for work in order if work.group is None) == sorted(parts)
        for part in set(parts) & set(reproduce.AHEAD):
            groups = [work.group for work in order[: order.index(reproduce.Work(part))] if work.part == part]
            assert tuple(groups) == reproduce.AHEAD[part]
    import table_4

    assert sorted(reproduce.AHEAD["table_4"]) == sorted(p.name for p in (table_4.FRICTIONS, table_4.WITH_ERROR))


@pytest.mark.parametrize("file", sorted(EXPERIMENTS.glob("*.py")), ids=lambda file: file.stem)
def test_every_experiment_finds_all_that_it_imports(file):
    importlib.import_module(file.stem)


class TestRealizableBodies:
    def test_no_body_violates_a_plan(self, tmp_path):
        run("realizable_bodies.py", tmp_path, "--configs", "waiter_bridge", "--bodies", "100", "--points", "20")
        own, wide = read(tmp_path / "realizable_bodies.csv")
        assert (own["intervals"], own["objects"], own["bodies"]) == ("own", "none", "0")
        assert (wide["objects"], wide["bodies"], wide["violations"]) == ("left, right, plank", "100", "0")
        assert 90.0 < float(wide["used"]) <= 100.01
