"""Interruptions of a command by a signal.

They are recorded, because libraries swallow the KeyboardInterrupt or turn it into another exception.
"""

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
    """An exit code of an interrupted command that has itself told the user which results it kept."""


def on_interrupt(signal_number: int, _frame: object) -> None:
    """Record a signal that asks this process to stop, and raise KeyboardInterrupt.

    Args:
        signal_number: the signal.
        _frame: not used; Python passes it to every signal handler.

    Raises:
        KeyboardInterrupt: always.
    """
    interruptions.append(signal_number)
    raise KeyboardInterrupt


def listen() -> None:
    """Record interruptions from now on, and print no errors that they cause in callbacks and threads."""
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
    """Raise KeyboardInterrupt if this process was interrupted: a library may have swallowed the first one.

    Raises:
        KeyboardInterrupt: this process was interrupted.
    """
    if interruptions:
        raise KeyboardInterrupt


@contextmanager
def held() -> Generator[list[int], None, None]:
    """Postpone interruptions until the end of this block.

    For work that must not be left half done, and for libraries that cannot be left by an exception. Only the main
    thread receives signals, so the block changes nothing in other threads.

    Yields:
        The signals received so far; the list grows as they arrive.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    handlers = {number: signal.getsignal(number) for number in STOPS}
    unheard = (signal.SIG_IGN, None)  # None: a handler that was not set in Python, which cannot restore it
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
