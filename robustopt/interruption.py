"""Interruptions of a command: remembered, because libraries swallow them or turn them into something else."""

from __future__ import annotations

INTERRUPTED = 130
"""Exit code of a command that was interrupted."""

interruptions: list[int] = []
"""Signals that asked this process to stop."""


class Kept(int):
    """Exit code of a command that was interrupted and has said itself what it kept."""


def on_interrupt(signal_number: int, _frame: object) -> None:
    """Handler of the signals that ask a process to stop."""
    interruptions.append(signal_number)
    raise KeyboardInterrupt


def stop_if_interrupted() -> None:
    """Stop where a library has swallowed the KeyboardInterrupt of Ctrl-C, as CasADi does."""
    if interruptions:
        raise KeyboardInterrupt
