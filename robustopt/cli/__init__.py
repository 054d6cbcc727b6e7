"""The command line."""

from robustopt.cli.app import main, run

__all__ = ["main", "run"]
