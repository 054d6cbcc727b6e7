"""Random configurations and model files: robustopt errors alone, each soon and in little memory; see `fuzz`."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of memory and time as on Linux")


@pytest.mark.parametrize(
    ("seed", "last"),
    [(0, 100), pytest.param(1, 2000, marks=pytest.mark.slow)],
)
def test_random_input_is_accepted_or_answered_with_an_error_of_robustopt(seed, last):
    command = [sys.executable, str(Path(__file__).with_name("fuzz.py")), str(seed), "0", str(last)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=last * 2.0, stdin=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    last_case = done.stderr.rsplit("case ", 1)[-1]
    assert done.returncode == 0, f"code {done.returncode} after case {last_case} of seed {seed}\n{done.stdout[-8000:]}"
    assert all(kind in done.stdout for kind in ("accepted", "ConfigError", "RobotError"))
