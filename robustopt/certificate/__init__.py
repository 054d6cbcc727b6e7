"""Certificate: checks a plan independently of the solver that made it."""
