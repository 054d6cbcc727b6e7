"""Standard output has what robustopt prints and nothing else, whatever its libraries print."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

CONFIGS = Path(__file__).parents[1] / "configs"
BRIDGE, BLOCK = str(CONFIGS / "waiter_bridge.yaml"), str(CONFIGS / "waiter_one_block.yaml")
SMALL = ["solver.collocation_points=60", "--no-figures"]

NOISY = '''
"""Makes functions print as libraries do: through Python, through C, and to the descriptor."""

import ctypes, os

def make_noisy(module, name):
    original = getattr(module, name)
    def noisy(*arguments, **keywords):
        print("noise of Python")
        libc = ctypes.CDLL(None)
        libc.puts(b"noise of C")
        libc.fflush(None)
        os.write(1, b"noise of the system\\n")
        return original(*arguments, **keywords)
    setattr(module, name, noisy)

if os.environ.pop("NOISY", None):  # some imports start processes of their own
    from robustopt.simulation import monte_carlo
    from robustopt.solvers import build, force_program, ipopt

    os.environ["NOISY"] = "yes"  # for the workers
    make_noisy(build, "build_track")
    make_noisy(force_program, "LinearProgram")
    make_noisy(ipopt, "_minimise")
    make_noisy(monte_carlo, "simulate_trials")
'''
"""`sitecustomize.py`, which Python runs at the start of every process, workers included."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a plan by each method."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "sitecustomize.py").write_text(NOISY)
    for method in ("ipopt", "reachability"):
        code, out, err = command(["plan", BRIDGE, *SMALL, "--method", method, "--json", "--out", method], folder)
        assert (code, err) == (0, "")
        assert json.loads(out)["method"] == method
    return folder


def command(arguments: list[str], folder: Path) -> tuple[int, str, str]:
    """Run a command whose libraries print; return its exit code, standard output and standard error."""
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {"PYTHONPATH": path, "NOISY": "yes"}
    start = [sys.executable, "-m", "robustopt", *arguments]
    done = subprocess.run(start, cwd=folder, env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan", BRIDGE, *SMALL, "--dry-run"],
        ["plan", BRIDGE, *SMALL, "gravity=[5, 0, -9]"],
        ["plan", BRIDGE, *SMALL, "objects.plank.mass=heavy"],
        ["execute", "ipopt", "--trials", "2", "--no-figures"],
        ["execute", "reachability", "--trials", "4", "--workers", "2", "execution.variation.friction=0.01"],
        ["execute", BLOCK, *SMALL, "--trials", "2"],
        pytest.param(["learn", BLOCK, *SMALL, "learning.iterations=2"], marks=pytest.mark.slow),
        ["validate", BRIDGE],
        ["report", "ipopt"],
        ["runs", "."],
        ["--nonsense"],
    ],
    ids=lambda arguments: " ".join(Path(word).stem for word in arguments[:2]),
)
def test_json_of_every_command_is_one_object(arguments: list[str], folder: Path) -> None:
    code, out, err = command([*arguments, "--json"], folder)
    data = json.loads(out)
    assert isinstance(data, dict)
    assert ("error" in data) == (code != 0)
    assert "noise of C" not in err


@pytest.mark.parametrize("arguments", [["plan", BRIDGE, *SMALL], ["execute", "ipopt", "--trials", "2", "--no-figures"]])
def test_quiet_prints_nothing(arguments: list[str], folder: Path) -> None:
    assert command([*arguments, "--quiet"], folder) == (0, "", "")


def test_a_library_call_prints_nothing(tmp_path: Path) -> None:
    """HiGHS 1.16 prints two lines when the first program is made."""
    program = (
        "import robustopt as ro\n"
        f"plan = ro.solve(ro.build_problem(ro.load_config({BRIDGE!r}, ['solver.collocation_points=20'])))\n"
        "assert plan.statistics['inner_programs'] > 0"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
