"""Plans a task, certifies the plan, and writes both into a run folder."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from robustopt.certificate import Certificate, certify
from robustopt.config import Config
from robustopt.config.margin import without_margin
from robustopt.limits import TimeScalingProblem
from robustopt.runs.origin import write_origin
from robustopt.runs.records import CertificateRecord, DiagnosisRecord, GridRecord, ProblemSize, RunStatus, Summary
from robustopt.runs.store import SUMMARY, write_record
from robustopt.scene.patches import patches
from robustopt.solvers import Plan, Status, build_problem, solve
from robustopt.solvers.diagnosis import Diagnosis, diagnose
from robustopt.solvers.trajectory import binding_shares

Effort = Literal["quick", "full"]

PLAN, FIGURES = "plan.csv", "figures"


@dataclass(frozen=True)
class PlanResult:
    """Plan of a configuration with its certificate, or with the diagnosis of an infeasible problem.

    Attributes:
        certificate: None without a plan.
        diagnosis: None unless the problem is infeasible.
        seconds: computing time of each step [s].
    """

    config: Config
    plan: Plan
    certificate: Certificate | None
    diagnosis: Diagnosis | None
    seconds: Mapping[str, float]

    @property
    def certified(self) -> bool:
        """Whether there is a plan, and it passed its certificate."""
        return self.certificate is not None and self.certificate.passed

    @property
    def status(self) -> RunStatus:
        """How planning ended; a plan that failed its certificate is not solved."""
        failed = self.plan.status is Status.SOLVED and not self.certified
        return RunStatus.CERTIFICATE_FAILED if failed else RunStatus(self.plan.status.value)


def plan_task(config: Config, certify_with: Effort = "quick") -> PlanResult:
    """Plan a task and certify the plan; an infeasible problem and a failed certificate are outcomes, not errors.

    Args:
        config: the task.
        certify_with: effort of the certificate.

    Raises:
        ConfigError: the configuration, its robot or its path cannot be used.
    """
    times = [time.perf_counter()]
    problem = build_problem(config)
    times.append(time.perf_counter())
    plan = solve(problem)
    times.append(time.perf_counter())
    certificate = certify(plan, certify_with, config.seed) if plan.status is Status.SOLVED else None
    diagnosis = diagnose(plan) if plan.status is Status.INFEASIBLE else None
    times.append(time.perf_counter())
    steps = ("build_problem", "solve", "certify" if certificate else "diagnose")
    seconds = dict(zip(steps, np.diff(times).tolist(), strict=True))
    return PlanResult(config, plan, certificate, diagnosis, seconds)


# Summary --------------------------------------------------------------------------------------------------


def problem_size(problem: TimeScalingProblem) -> ProblemSize:
    """Return the size of a problem: grid, rows before and after redundant ones are removed, contacts.

    Args:
        problem: the problem.
    """
    systems = [family.system for family in problem.limits.contacts]
    facets = sum(len(system.facets) for system in systems)
    rows = 2 * problem.robot.n + len(problem.limits.torque.limited) + facets
    return ProblemSize(
        collocation_points=problem.limits.track.grid.intervals,
        grid_points=len(problem.s),
        pieces=int(problem.piece[-1]) + 1,
        rows=rows * len(problem.s),
        rows_after_pruning=int(np.count_nonzero((problem.a != 0) | (problem.b != 0))),
        joints=problem.robot.n,
        objects=len(problem.config.objects),
        contacts=len(problem.config.environment_contacts) + len(patches(problem.config)),
        contact_systems=len(systems),
        friction_edges=sum(system.generators.shape[1] for system in systems),
    )


def summary(result: PlanResult) -> Summary:
    """Return the summary of a plan.

    Args:
        result: the plan and its certificate.
    """
    plan, certificate, diagnosis = result.plan, result.certificate, result.diagnosis
    accuracy = plan.problem.limits.track.grid.accuracy
    message = plan.message if diagnosis is None else f"{plan.message} {diagnosis.sentence}"
    if accuracy is not None and certificate is not None and not accuracy.enough:
        message += f" {accuracy.sentence}"
    if certificate is not None and not certificate.passed:
        message = certificate.sentence
    elif certificate is not None:
        message += _comparison(plan.duration, plan.problem.path.recorded)
    return Summary(
        kind="plan",
        name=result.config.name,
        status=result.status,
        message=message,
        without_margin=(without_margin(result.config) or None) if result.certified else None,
        method=plan.method,
        duration=plan.duration if certificate is not None else None,
        binding=binding_shares(plan) if certificate is not None else {},
        certificate=_certificate(certificate, plan) if certificate is not None else None,
        diagnosis=DiagnosisRecord.model_validate(diagnosis) if diagnosis is not None else None,
        size=problem_size(plan.problem),
        grid=GridRecord.model_validate(accuracy) if accuracy is not None else None,
        recorded=plan.problem.path.recorded,
        notes=(*plan.problem.robot.notes, *plan.problem.path.notes),
        statistics=dict(plan.statistics),
        seconds=dict(result.seconds),
    )


def _comparison(planned: float, recorded: float | None) -> str:
    """Return a sentence about the duration of a plan and of its recording; empty without one."""
    if not recorded:
        return ""
    faster = f"{recorded / planned:.2f} times as fast" if recorded >= planned else "which is slower"
    return f" Recorded duration {recorded:.4f} s, planned {planned:.4f} s: {faster}."


def _certificate(certificate: Certificate, plan: Plan) -> CertificateRecord:
    record = CertificateRecord.model_validate(certificate)
    place = plan.problem.path.label(certificate.worst.s)
    return record.model_copy(update={"worst": record.worst.model_copy(update={"place": place})})


# Files ----------------------------------------------------------------------------------------------------


def write_run(result: PlanResult, folder: Path, arguments: Sequence[str]) -> Summary:
    """Write the data of a run into a folder and return its summary; `report` writes figures and page.

    A plan that failed its certificate is not written: a controller could run its files.

    Args:
        result: the plan and its certificate.
        folder: folder of the run.
        arguments: arguments of the command, for the record of its origin.
    """
    write_origin(folder, result.config, arguments)
    if result.certified:
        result.plan.export(folder, result.config.output.period)
    data = summary(result)
    write_record(folder / SUMMARY, data)
    return data
