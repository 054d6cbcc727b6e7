"""Execution of plans in simulation: Monte Carlo trials in a world that the planner does not know.

`execute` builds the world of `execution.truth` in MuJoCo, has a joint controller follow the planned trajectory under
random disturbances, and says what became of every object in every trial.
"""

from robustopt.simulation.execute import Executions, execute
from robustopt.simulation.feedback import Feedback
from robustopt.simulation.monte_carlo import Workers
from robustopt.simulation.outcome import ObjectOutcome, Status, TrialOutcome

__all__ = ["Executions", "Feedback", "ObjectOutcome", "Status", "TrialOutcome", "Workers", "execute"]
