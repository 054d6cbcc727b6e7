"""Time the execution of plans beside a bare `mujoco.rollout` of the same model and controls.

    python experiments/bench_execution.py [--quick] [--out results/benchmarks]

`make bench-execution` writes execution.md. It takes a minute or two, and several more for the memory of many trials.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout
from timing import interleaved, machine_facts

from robustopt.config.load import load_config
from robustopt.processes import cores
from robustopt.simulation import execute
from robustopt.simulation.execute import prepare
from robustopt.simulation.monte_carlo import CHUNK, run_trials, simulate_trials
from robustopt.simulation.simulation import CONTROL, Workspace
from robustopt.solvers import Plan, solve

ROOT = Path(__file__).resolve().parents[1]
OVERRIDES = (
    "contact.friction=0.25",
    "solver.method=reachability",
    "execution.truth.friction=0.5",
    "execution.disturbance.force_deviation=[2, 2, 0]",
)
MEMORY = "import sys; sys.path.insert(0, sys.argv[1]); import bench_execution as b; b.print_memory(int(sys.argv[2]))"


def two_blocks() -> Plan:
    """Return the plan of the two-block task."""
    return plan_of("waiter_two_blocks", OVERRIDES)


def plan_of(name: str, overrides: Sequence[str] = ()) -> Plan:
    """Return the plan of a shipped task."""
    from robustopt.solvers import build_problem

    return solve(build_problem(load_config(ROOT / "configs" / f"{name}.yaml", overrides)))


def side_by_side(plan: Plan, repetitions: int) -> tuple[int, dict[str, np.ndarray]]:
    """Return the steps in a chunk of trials, and the seconds per chunk of a bare rollout and of the executor."""
    job = prepare(plan)
    planned = job.planned
    trials, workspace, threads = range(CHUNK), Workspace(), cores()
    prepared, record = simulate_trials(job, trials, threads, workspace)
    model = job.world.model(prepared.parameters[0])
    shape = (CHUNK, len(planned.t), model.nu + 6 * model.nbody)
    control = workspace.array("control", shape).copy()
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    data.qpos[:], data.qvel[:] = record.start_qpos[0], record.start_qvel[0]
    start = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, start, kind)
    starts, data_of_thread = np.tile(start, (CHUNK, 1)), [mujoco.MjData(model) for _ in range(threads)]
    with rollout.Rollout(nthread=threads) as bare:
        calls = {
            "bare rollout": lambda: bare.rollout(model, data_of_thread, starts, control, control_spec=CONTROL),
            "executor": lambda: run_trials(job, trials, threads, workspace),
        }
        return CHUNK * len(planned.t), interleaved(calls, repetitions)


def print_memory(trials: int) -> None:
    """Print the peak memory of this process after a number of trials [MB]."""
    plan = two_blocks()
    execute(plan, trials=trials)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)


def memory(trials: int) -> int:
    """Return the peak memory of a process that runs a number of trials [MB]."""
    command = [sys.executable, "-c", MEMORY, str(Path(__file__).parent), str(trials)]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def report(quick: bool) -> str:
    """All measurements as a page."""
    facts = machine_facts(("mujoco", "numpy"))
    plan = two_blocks()
    steps, seconds = side_by_side(plan, 2 if quick else 9)
    best = {name: steps / times.min() for name, times in seconds.items()}
    middle = {name: steps / np.median(times) for name, times in seconds.items()}
    trials = 25 if quick else 100
    whole = interleaved({"all": lambda: execute(plan, trials=trials)}, 1 if quick else 3)["all"]
    stepping = plan_of("humanoid_step")
    walk = interleaved({"walk": lambda: execute(stepping, trials=1)}, 2 if quick else 9)
    counts = (25, 50) if quick else (100, 2000)
    sizes = [memory(count) for count in counts]
    lines = [
        "# Execution",
        "",
        f"Two blocks, {steps // CHUNK} time steps of 1 ms per trial, chunks of {CHUNK} trials on {cores()} threads.",
        facts,
        "",
        "| | steps per second, median | best |",
        "|---|---|---|",
        *(f"| {name} | {middle[name]:,.0f} | {best[name]:,.0f} |" for name in seconds),
        f"| executor / bare rollout | {middle['executor'] / middle['bare rollout']:.2f} "
        f"| {best['executor'] / best['bare rollout']:.2f} |",
        "",
        f"{trials} trials, plan at hand: {np.median(whole):.1f} s (best {whole.min():.1f} s).",
        f"One trial of the humanoid's two steps, plan at hand: {np.median(walk['walk']):.2f} s (best "
        f"{walk['walk'].min():.2f} s).",
        f"Largest memory: {sizes[0]} MB with {counts[0]:,} trials, {sizes[1]} MB with {counts[1]:,}.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few repetitions and trials")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    text = report(options.quick)
    (options.out / "execution.md").write_text(text, encoding="utf-8")
    print(text, end="")


if __name__ == "__main__":
    main()
