"""Robust time-scaling of robot paths under frictional contact.

    import robustopt as ro

    config = ro.load_config("configs/waiter_two_blocks.yaml", overrides=["contact.friction=0.3"])
    problem = ro.build_problem(config)
    plan = ro.solve(problem)
    certificate = ro.certify(config, plan)
    executions = ro.execute(config, plan, trials=100)
    learned = ro.learn(config)

Names are imported when they are first used, so that importing the package is quick.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "load_config": "robustopt.config.load",
    "Config": "robustopt.config",
    "build_problem": "robustopt.limits",
    "solve": "robustopt.solvers",
    "solve_batch": "robustopt.solvers.batch",
    "BatchPlanner": "robustopt.solvers.batch",
    "Plan": "robustopt.solvers",
    "Status": "robustopt.solvers",
    "certify": "robustopt.certificate",
    "execute": "robustopt.simulation",
    "Executions": "robustopt.simulation",
    "learn": "robustopt.runs.campaign",
    "Learned": "robustopt.runs.campaign",
    "Trajectory": "robustopt.solvers.trajectory",
    "RobustOptError": "robustopt.errors",
}

__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'robustopt' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
