"""The command line."""

from __future__ import annotations

import sys
from collections.abc import Sequence

NOTHING_KEPT = "interrupted; no incomplete files are left"
"""What is said of a command that was interrupted before it kept anything."""


def main() -> None:
    """Run the command line and end the process, also if it is interrupted while its modules are imported."""
    try:
        from robustopt.cli import app
    except KeyboardInterrupt:
        print(f"error: {NOTHING_KEPT}", file=sys.stderr)
        sys.exit(130)
    app.main()


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code; see `robustopt.cli.app.run`."""
    from robustopt.cli import app

    return app.run(arguments)


__all__ = ["main", "run"]
