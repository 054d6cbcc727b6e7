"""The public names: quick to import, typed for mypy and pyright, and results that show themselves."""

import ast
import importlib.util
import json
import re
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from learning_tasks import Threshold, remember_plans, task
from matplotlib.figure import Figure
from scenes import CONFIGS

import robustopt as ro
from robustopt.solvers.trajectory import Trajectory

ROOT = Path(__file__).parent.parent

CLIENT = """
from pathlib import Path

import robustopt as ro


def run(file: Path) -> float:
    try:
        config = ro.load_config(file, overrides=["contact.friction=0.3"])
        config = ro.load_config({"name": "task"})
    except (ro.RobotError, ro.PathError):
        raise
    except ro.ConfigError as error:
        raise SystemExit(error.problems[0].key) from error
    problem: ro.TimeScalingProblem = ro.build_problem(config)
    plan = ro.solve(problem)
    if plan.status is ro.Status.INFEASIBLE:
        remedies: tuple[ro.Remedy, ...] = ro.diagnose(plan).remedies
        raise ro.Infeasible(remedies[0].key)
    certificate: ro.Certificate = ro.certify(plan)
    executions: ro.Executions = ro.execute(plan, trials=10)
    statuses: list[ro.TrialStatus] = [outcome.status for outcome in executions.outcomes]
    learned: ro.Learned = ro.learn(config)
    frames = [plan.to_frame(), executions.to_frame(), learned.to_frame()]
    figures = [plan.plot(), executions.plot(), learned.plot()]
    files: list[Path] = plan.export("folder")
    exported: ro.Exported = ro.export(plan, format="csv", period=0.008)
    files += [exported.file, ro.export("run", format="npz").file]
    print(certificate.worst.limit, statuses, frames[0].columns, figures[0].axes, files, ro.__version__)
    ro.solve(problem, methd="ipopt")  # wrong
    ro.solve(config)  # wrong
    ro.slove(problem)  # wrong
    ro.load_config(3)  # wrong
    ro.execute(plan, trials="many")  # wrong
    ro.certify(plan, sed=3)  # wrong
    ro.learn(config, worker=2)  # wrong
    plan.export()  # wrong
    ro.export(plan, format="xml")  # wrong
    number: int = plan.message  # wrong
    print(number, plan.duratoin)  # wrong
    try:
        return ro.Trajectory.from_plan(plan).duration
    except ro.Infeasable:  # wrong
        return 0.0
"""


@pytest.fixture
def client(tmp_path) -> Path:
    path = tmp_path / "client.py"
    path.write_text(CLIENT)
    return path


def wrong_lines() -> set[int]:
    return {i for i, line in enumerate(CLIENT.splitlines(), 1) if line.endswith("# wrong")}


def test_mypy_accepts_a_client_and_finds_its_mistakes(client):
    client.write_text(CLIENT + "\n\nreveal_type(ro.solve)\n")
    command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), str(client)]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout
    found = re.findall(r"client\.py:(\d+): error: ", output)
    assert {int(line) for line in found} == wrong_lines(), output
    assert re.search(
        r'Revealed type is "def \(problem: .*TimeScalingProblem.* -> robustopt\.solvers\.plan\.Plan"', output
    )


def test_pyright_accepts_a_client_and_finds_its_mistakes(client):
    if importlib.util.find_spec("basedpyright") is None:
        pytest.skip("needs basedpyright, which is pyright as a package: pip install robustopt[test]")
    settings = {"typeCheckingMode": "standard", "extraPaths": [str(ROOT)]}
    (client.parent / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "basedpyright", "--outputjson", "--pythonpath", sys.executable, client.name]
    output = subprocess.run(command, cwd=client.parent, capture_output=True, text=True).stdout
    found = [item for item in json.loads(output)["generalDiagnostics"] if item["severity"] == "error"]
    assert {item["range"]["start"]["line"] + 1 for item in found} == wrong_lines(), found


def test_checkers_and_python_see_the_same_names():
    tree = ast.parse((ROOT / "robustopt" / "__init__.py").read_text())
    (checked,) = (node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    homes = {
        alias.asname.lstrip("_"): (node.module, alias.name)
        for node in checked.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert homes == ro._HOMES
    for name in ro.__all__:
        assert getattr(ro, name) is not None
        assert name in dir(ro)
    with pytest.raises(AttributeError, match="has no attribute 'slove'"):
        _ = ro.slove


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, robustopt; robustopt.ConfigError; print(sorted(m for m in sys.modules if '.' not in m))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for module in ("casadi", "mujoco", "numba", "numpy", "pandas", "matplotlib", "scipy", "pydantic"):
        assert f"'{module}'" not in loaded


# Views of results -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def config() -> ro.Config:
    small = ["solver.method=reachability", "solver.collocation_points=60", "uncertainty={}"]
    return ro.load_config(CONFIGS / "waiter_one_block.yaml", [*small, "output.period=0.01"])


@pytest.fixture(scope="module")
def plan(config) -> ro.Plan:
    return ro.solve(ro.build_problem(config))


def test_a_plan_is_exported_as_a_run_folder_has_it(plan, tmp_path):
    files = plan.export(tmp_path / "new" / "folder")
    assert [file.name for file in files] == ["plan.csv", "trajectory.csv", "joint_trajectory.json"]
    numbers = np.loadtxt(files[0], delimiter=",", skiprows=1)
    assert numbers[-1, 0] == pytest.approx(plan.duration, abs=1e-12)
    samples = Trajectory.from_plan(plan).every(0.01)
    assert np.array_equal(np.loadtxt(files[1], delimiter=",", skiprows=1)[:, 0], samples.t)
    assert json.loads(files[2].read_text())["joint_names"] == list(plan.problem.robot.joint_names)
    (sampled,) = (file for file in plan.export(tmp_path, period=0.1) if file.name == "trajectory.csv")
    assert len(sampled.read_text().splitlines()) < 0.2 * len(files[1].read_text().splitlines())


def test_the_table_of_a_plan_is_its_file(plan, tmp_path):
    frame = plan.to_frame()
    (file, *_) = plan.export(tmp_path)
    assert file.read_text() == frame.to_csv(index=False, lineterminator="\n")
    assert list(frame.columns[:5]) == ["t", "s", "sd", "sdd", "q_joint1"]


def test_an_infeasible_plan_has_no_table_and_says_so(config, tmp_path):
    tilted = ro.with_values(config, {"contact.friction": 0.05, "gravity": [3.0, 0.0, -9.81]})
    plan = ro.solve(ro.build_problem(tilted))
    for view in (plan.to_frame, lambda: plan.export(tmp_path / "new")):
        with pytest.raises(ro.Infeasible, match="There is no trajectory"):
            view()
    assert not (tmp_path / "new").exists()
    assert "No timing of the path satisfies the limits" in plan._repr_html_()
    assert isinstance(plan.plot(), Figure)


def test_results_draw_figures_and_pages(config, plan, monkeypatch):
    executions = ro.execute(plan, trials=3)
    remember_plans(monkeypatch)
    learned = ro.learn(task("bisection", trials=5), Threshold())
    for result, rows, text in (
        (plan, len(plan.s), f"{plan.duration:.4f} s, planned by reachability"),
        (executions, 3, "0 of 3 trials succeeded"),
        (learned, len(learned.rows), "A plan of "),
    ):
        assert len(result.to_frame()) == rows
        figure = result.plot()
        assert isinstance(figure, Figure)
        figure.savefig(BytesIO(), format="svg")
        page = result._repr_html_()
        assert text in page
        assert page.count("<table") == 1
    frame = learned.to_frame()
    assert list(frame["friction"]) == [row.trial.belief.friction for row in learned.rows]
    assert list(executions.to_frame()["slip_block"]) == [o.objects["block"].slip for o in executions.outcomes]
