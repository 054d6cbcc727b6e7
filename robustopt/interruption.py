"""Interruptions of a command: remembered, because libraries swallow them or turn them into something else."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager

INTERRUPTED = 130
"""Exit code of a command that was interrupted."""

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask a process to stop: Ctrl-C, kill, and the end of a terminal."""

interruptions: list[int] = []
"""Signals that asked this process to stop."""


class Kept(int):
    """Exit code of a command that was interrupted and has said itself what it kept."""


def on_interrupt(signal_number: int, _frame: object) -> None:
    """Handler of the signals that ask a process to stop."""
    interruptions.append(signal_number)
    raise KeyboardInterrupt


def listen() -> None:
    """Let this process remember interruptions, and say nothing of what they break in callbacks and threads.

    A killed pool of workers, for instance, may miss tasks that were just given to it.
    """
    for number in STOPS:
        if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, on_interrupt)
    sys.unraisablehook = _on_unraisable
    threading.excepthook = _on_thread_error


def _on_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


def _on_thread_error(error: threading.ExceptHookArgs) -> None:
    if not interruptions:
        threading.__excepthook__(error)


def stop_if_interrupted() -> None:
    """Stop where a library has swallowed the KeyboardInterrupt of Ctrl-C."""
    if interruptions:
        raise KeyboardInterrupt


@contextmanager
def held() -> Generator[list[int], None, None]:
    """Let interruptions wait until the end of this block; yields the signals that came, as they come.

    For what must not be left half done, and for libraries that do not bear an exception in their midst.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    handlers = {number: signal.getsignal(number) for number in STOPS}
    unheard = (signal.SIG_IGN, None)  # None: not of Python, which cannot restore it
    heard = [number for number in STOPS if handlers[number] not in unheard]
    try:
        for number in heard:
            signal.signal(number, lambda number, _frame: came.append(number))
        yield came
    finally:
        for number in reversed(heard):  # Ctrl-C last, which may end this loop
            signal.signal(number, handlers[number])
        for signal_number in came:
            signal.raise_signal(signal_number)
