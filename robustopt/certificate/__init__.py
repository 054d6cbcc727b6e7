"""Check plans independently of the solver that made them.

`task` reads robot, path and joint limits from a configuration. `contact_points`, `force_closure` and `twist` compute
how close a wrench is to the limits of contacts, with the compiled kernels of `cone_program` and `twist_search`.
`bodies`, `systems` and `world` describe the bodies, contacts and intervals. `motion`, `loads` and `balance` turn a plan
into the wrenches that it requires. `joints`, `shared_torque`, `places`, `worst` and `samples` find the worst
utilisation of each limit, and a `tally` collects them. `certify` combines all of these.
"""

from robustopt.certificate.certify import LEVELS, Certificate, Level, Margin, Worst, certify

__all__ = ["LEVELS", "Certificate", "Level", "Margin", "Worst", "certify"]
