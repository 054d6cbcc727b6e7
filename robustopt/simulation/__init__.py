"""Execution of plans in simulation: Monte Carlo trials in a world that the planner does not know.

`execute` builds the world of `execution.truth` in MuJoCo, runs a joint controller along the planned trajectory under
random disturbances, and judges every object, contact and joint in every trial.
"""

from robustopt.simulation.execute import Executions, execute
from robustopt.simulation.feedback import Feedback
from robustopt.simulation.monte_carlo import Workers
from robustopt.simulation.outcome import ObjectOutcome, Status, TrialOutcome
from robustopt.simulation.trace import Trace, trace

__all__ = ["Executions", "Feedback", "ObjectOutcome", "Status", "Trace", "TrialOutcome", "Workers", "execute", "trace"]
