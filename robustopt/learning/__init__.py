"""Learners: they choose the nominal friction and error intervals to plan with from the outcomes of executions.

`learner` is the contract. Learners of friction and acceleration errors: `bisection` (paper, Alg. 1),
`acceleration_interval` (paper, page 8), `ilrobs` (paper, Alg. 2) and `calibrated` (ours). Learners of several
parameters: `branch_and_bound` and `informed` (problem: paper, section 7.1; algorithms: ours). `sequential` and `earned`
hold the statistics, `from_config` makes the learner that a configuration names.
"""

from robustopt.learning.from_config import BRANCH_AND_BOUND, LEARNERS, learner_of
from robustopt.learning.learner import Learner, Row, State, Trial, tell_all
from robustopt.learning.moments import ErrorInterval, Moments
from robustopt.learning.outcomes import Belief, End, Executed, Outcome, Planned, Request, Result
from robustopt.learning.parameters import Cost, Parameter

__all__ = [
    "BRANCH_AND_BOUND",
    "LEARNERS",
    "Belief",
    "Cost",
    "End",
    "ErrorInterval",
    "Executed",
    "Learner",
    "Moments",
    "Outcome",
    "Parameter",
    "Planned",
    "Request",
    "Result",
    "Row",
    "State",
    "Trial",
    "learner_of",
    "tell_all",
]
