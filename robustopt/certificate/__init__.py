"""Certificate: checks a plan independently of the solver that made it.

`contact_points` and `force_closure` say how far a wrench is from the exact friction cones; `scene` holds what is
carried and how uncertain it is; `motion` and `loads` turn a plan into the wrenches it needs; `joints`, `contacts` and
`draws` find the worst utilisation of each limit, collected in a `tally`; `certify` puts them together.
"""

from robustopt.certificate.certify import LEVELS, Certificate, Level, Margin, Worst, certify
from robustopt.certificate.interfaces import interface_utilisation

__all__ = ["LEVELS", "Certificate", "Level", "Margin", "Worst", "certify", "interface_utilisation"]
