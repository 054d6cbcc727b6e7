"""Time-optimal, robust path timing for robots under frictional contact.

    import robustopt as ro

    config = ro.load_config("configs/waiter_two_blocks.yaml", overrides=["contact.friction=0.3"])
    problem = ro.build_problem(config)
    plan = ro.solve(problem)
    certificate = ro.certify(plan)
    executions = ro.execute(plan, trials=100)
    learned = ro.learn(config)

Names are imported on first use, so that importing the package is quick. Type checkers see them all.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robustopt.certificate import Certificate as Certificate
    from robustopt.certificate import Margin as Margin
    from robustopt.certificate import Worst as Worst
    from robustopt.certificate.certify import certify as certify
    from robustopt.config import Config as Config
    from robustopt.config.load import load_config as load_config
    from robustopt.config.load import with_values as with_values
    from robustopt.errors import ConfigError as ConfigError
    from robustopt.errors import ConfigProblem as ConfigProblem
    from robustopt.errors import Infeasible as Infeasible
    from robustopt.errors import PathError as PathError
    from robustopt.errors import RobotError as RobotError
    from robustopt.errors import RobustOptError as RobustOptError
    from robustopt.errors import RunFolderError as RunFolderError
    from robustopt.errors import RunInUse as RunInUse
    from robustopt.errors import SimulationFailed as SimulationFailed
    from robustopt.errors import SolverFailed as SolverFailed
    from robustopt.evidence import Failure as Failure
    from robustopt.evidence import Peak as Peak
    from robustopt.exports.write import Exported as Exported
    from robustopt.learning.outcomes import Executed as Executed
    from robustopt.limits import TimeScalingProblem as TimeScalingProblem
    from robustopt.path.collision import Collision as Collision
    from robustopt.runs.campaign import Judgement as Judgement
    from robustopt.runs.campaign import Learned as Learned
    from robustopt.runs.campaign import learn as learn
    from robustopt.runs.executors import Executor as Executor
    from robustopt.runs.export_run import export as export
    from robustopt.runs.journal import Execution as Execution
    from robustopt.runs.journal import Journal as Journal
    from robustopt.simulation import Executions as Executions
    from robustopt.simulation import Feedback as Feedback
    from robustopt.simulation import ObjectOutcome as ObjectOutcome
    from robustopt.simulation import Status as _TrialStatus
    from robustopt.simulation import TrialOutcome as TrialOutcome
    from robustopt.simulation import Workers as Workers
    from robustopt.simulation.execute import execute as execute
    from robustopt.solvers import Plan as Plan
    from robustopt.solvers import Status as Status
    from robustopt.solvers import build_problem as build_problem
    from robustopt.solvers.batch import BatchPlanner as BatchPlanner
    from robustopt.solvers.batch import solve_batch as solve_batch
    from robustopt.solvers.diagnosis import Diagnosis as Diagnosis
    from robustopt.solvers.diagnosis import Remedy as Remedy
    from robustopt.solvers.diagnosis import diagnose as diagnose
    from robustopt.solvers.planner import Planner as Planner
    from robustopt.solvers.replan import Replanned as Replanned
    from robustopt.solvers.replan import replan as replan
    from robustopt.solvers.solve import solve as solve
    from robustopt.solvers.trajectory import Samples as Samples
    from robustopt.solvers.trajectory import Trajectory as Trajectory

    TrialStatus = _TrialStatus

__version__ = "0.2.0.dev0"

_NAMES = {
    "robustopt.certificate": ("Certificate", "Margin", "Worst"),
    "robustopt.certificate.certify": ("certify",),
    "robustopt.config": ("Config",),
    "robustopt.config.load": ("load_config", "with_values"),
    "robustopt.errors": (
        "ConfigError", "ConfigProblem", "Infeasible", "PathError", "RobotError", "RobustOptError", "RunFolderError",
        "RunInUse", "SimulationFailed", "SolverFailed",
    ),
    "robustopt.evidence": ("Failure", "Peak"),
    "robustopt.exports.write": ("Exported",),
    "robustopt.learning.outcomes": ("Executed",),
    "robustopt.limits": ("TimeScalingProblem",),
    "robustopt.path.collision": ("Collision",),
    "robustopt.runs.campaign": ("Judgement", "Learned", "learn"),
    "robustopt.runs.executors": ("Executor",),
    "robustopt.runs.export_run": ("export",),
    "robustopt.runs.journal": ("Execution", "Journal"),
    "robustopt.simulation": (
        "Executions", "Feedback", "ObjectOutcome", "Status as TrialStatus", "TrialOutcome", "Workers",
    ),
    "robustopt.simulation.execute": ("execute",),
    "robustopt.solvers": ("Plan", "Status", "build_problem"),
    "robustopt.solvers.batch": ("BatchPlanner", "solve_batch"),
    "robustopt.solvers.diagnosis": ("Diagnosis", "Remedy", "diagnose"),
    "robustopt.solvers.planner": ("Planner",),
    "robustopt.solvers.replan": ("Replanned", "replan"),
    "robustopt.solvers.solve": ("solve",),
    "robustopt.solvers.trajectory": ("Samples", "Trajectory"),
}  # fmt: skip
"""The names above by their modules."""

_HOMES = {name.split(" as ")[-1]: (module, name.split(" as ")[0]) for module in _NAMES for name in _NAMES[module]}

__all__ = ["__version__", *_HOMES]

if not TYPE_CHECKING:  # type checkers would take any misspelt name for one of these

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module 'robustopt' has no attribute {name!r}")
        module, attribute = _HOMES[name]
        return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
