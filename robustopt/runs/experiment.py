"""Joins configuration, plan and certificate into a run, and writes its data."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from robustopt.certificate import Certificate, certify
from robustopt.config import Config
from robustopt.limits import TimeScalingProblem, build_problem
from robustopt.robot.model_file import model_file
from robustopt.runs.store import SUMMARY, plain_data, write_json, write_origin
from robustopt.scene.patches import patches
from robustopt.solvers import Plan, Status, solve
from robustopt.solvers.diagnosis import Diagnosis, diagnose
from robustopt.solvers.trajectory import binding_shares, joint_trajectory, write_plan_csv, write_trajectory_csv

Effort = Literal["quick", "full"]

PLAN, FIGURES = "plan.csv", "figures"


@dataclass(frozen=True)
class PlanResult:
    """A plan of a configuration, what certifies it or why there is none, and how long each step took [s].

    certificate: None where there is no plan; diagnosis: of an infeasible problem
    """

    config: Config
    plan: Plan
    certificate: Certificate | None
    diagnosis: Diagnosis | None
    seconds: Mapping[str, float]

    @property
    def certified(self) -> bool:
        return self.certificate is not None and self.certificate.passed

    @property
    def exit_code(self) -> int:
        """0 for a plan with its certificate, 3 for an infeasible problem, 4 for any other failure."""
        if self.plan.status is Status.INFEASIBLE:
            return 3
        return 0 if self.plan.status is Status.SOLVED and self.certified else 4


def plan_task(config: Config, certify_with: Effort = "quick") -> PlanResult:
    """Plan a task and certify the plan.

    Raises ConfigError, RobotError or PathError where the configuration cannot be used; an infeasible problem and a
    failed certificate are outcomes, not errors.
    """
    times = [time.perf_counter()]
    problem = build_problem(config)
    times.append(time.perf_counter())
    plan = solve(problem)
    times.append(time.perf_counter())
    certificate = certify(config, plan, certify_with, config.seed) if plan.status is Status.SOLVED else None
    diagnosis = diagnose(plan) if plan.status is Status.INFEASIBLE else None
    times.append(time.perf_counter())
    steps = ("build_problem", "solve", "certify" if certificate else "diagnose")
    seconds = dict(zip(steps, np.diff(times).tolist(), strict=True))
    return PlanResult(config, plan, certificate, diagnosis, seconds)


def problem_size(problem: TimeScalingProblem) -> dict[str, int]:
    """How large a problem is: grid, rows before and after redundant ones are removed, contacts."""
    systems = [family.system for family in problem.limits.contacts]
    facets = sum(len(system.facets) for system in systems)
    rows = 2 * problem.robot.n + problem.limits.torque.B.shape[1] + facets
    kept = np.count_nonzero((problem.a != 0) | (problem.b != 0))
    return {
        "collocation_points": problem.config.solver.collocation_points,
        "grid_points": len(problem.s),
        "pieces": int(problem.piece[-1]) + 1,
        "rows": rows * len(problem.s),
        "rows_after_pruning": int(kept),
        "joints": problem.robot.n,
        "objects": len(problem.config.objects),
        "interfaces": len(problem.config.environment_contacts) + len(patches(problem.config)),
        "contact_systems": len(systems),
        "generators": sum(system.generators.shape[1] for system in systems),
    }


def summary(result: PlanResult) -> dict[str, Any]:
    """What a run says about its plan, as plain data."""
    plan, certificate, diagnosis = result.plan, result.certificate, result.diagnosis
    failed = certificate is not None and not certificate.passed
    message = plan.message if diagnosis is None else f"{plan.message} {diagnosis.sentence}"
    data = {
        "kind": "plan",
        "name": result.config.name,
        "status": "certificate failed" if failed else plan.status.value,
        "message": certificate.sentence if certificate is not None and failed else message,
        "method": plan.method,
        "duration": plan.duration if certificate is not None else None,
        "binding": binding_shares(plan) if certificate is not None else {},
        "certificate": _certificate(certificate, plan) if certificate is not None else None,
        "diagnosis": _diagnosis(diagnosis) if diagnosis is not None else None,
        "size": problem_size(plan.problem),
        "notes": plan.problem.robot.notes,
        "statistics": plan.statistics,
        "seconds": result.seconds,
    }
    return dict(plain_data(data))


def _certificate(certificate: Certificate, plan: Plan) -> dict[str, Any]:
    data = dict(plain_data(certificate))
    data["worst"]["place"] = plan.problem.path.label(certificate.worst.s)
    return data


def _diagnosis(diagnosis: Diagnosis) -> dict[str, Any]:
    return dict(plain_data(diagnosis)) | {"sentences": [remedy.sentence for remedy in diagnosis.remedies]}


def write_run(result: PlanResult, folder: Path, arguments: Sequence[str]) -> dict[str, Any]:
    """Write the data of a run into a folder and return its summary; figures and report are `report.write_report`."""
    write_origin(folder, result.config, model_file(result.config), arguments)
    if result.plan.status is Status.SOLVED:
        write_plan(result, folder)
    data = summary(result)
    write_json(folder / SUMMARY, data)
    return data


def write_plan(result: PlanResult, folder: Path) -> None:
    """Write a plan into a folder: at its grid points, at the controller's period, and as a ROS message."""
    plan, period = result.plan, result.config.output.period
    write_plan_csv(plan, folder / PLAN)
    write_trajectory_csv(plan, period, folder / "trajectory.csv")
    message = json.dumps(joint_trajectory(plan, period))
    (folder / "joint_trajectory.json").write_text(message + "\n", encoding="utf-8")
