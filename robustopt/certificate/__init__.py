"""Check plans independently of the solver that made them.

`contact_points`, `force_closure` and `twist` say how far a wrench is from the limits of contacts; `bodies`, `systems`
and `world` hold the bodies, contacts and intervals; `motion`, `loads` and `balance` turn a plan into the wrenches that
it requires; `joints`, `shared_torque`, `places`, `worst` and `samples` find the worst utilisation of each limit,
collected in a `tally`; `certify` puts them together.
"""

from robustopt.certificate.certify import LEVELS, Certificate, Level, Margin, Worst, certify

__all__ = ["LEVELS", "Certificate", "Level", "Margin", "Worst", "certify"]
