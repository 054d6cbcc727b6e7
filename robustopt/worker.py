"""The program of a worker process: it reads tasks from its standard input and writes results to its standard output.

A message is its length and so many bytes. A pipe closes with the process at its other end.
"""

from __future__ import annotations

import os
import pickle
import struct
import sys
import threading
import traceback
from queue import SimpleQueue

LENGTH = struct.Struct("!Q")
"""Format of the length of a message."""

PIECE = 1 << 20
"""Largest number of bytes that are read from a pipe at once."""


def send(pipe: int, message: bytes) -> None:
    """Write a message to a pipe.

    Args:
        pipe: file descriptor of the pipe.
        message: the message.

    Raises:
        OSError: the process at the other end has ended.
    """
    for data in (LENGTH.pack(len(message)), message):
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(pipe, rest) :]


def receive(pipe: int) -> bytes:
    """Read a message from a pipe.

    Args:
        pipe: file descriptor of the pipe.

    Returns:
        The message.

    Raises:
        EOFError: the process at the other end has ended, perhaps in the middle of a message.
    """
    (length,) = LENGTH.unpack(_read(pipe, LENGTH.size))
    return _read(pipe, length)


def _read(pipe: int, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        piece = os.read(pipe, min(size - len(data), PIECE))
        if not piece:
            raise EOFError
        data += piece
    return bytes(data)


def work() -> None:
    """Carry out tasks, one after the other, until the parent process ends."""
    source, sink = _take_standard_streams()
    tasks: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(source, tasks), daemon=True).start()
    while True:
        answer = _answer(tasks.get())
        try:
            send(sink, answer)
        except OSError:
            os._exit(1)


def _take_standard_streams() -> tuple[int, int]:
    """Keep the pipes for messages alone: tasks read an empty input and print to the standard error.

    Libraries in C write to descriptor 1, which becomes the null device.
    """
    pipes = os.dup(0), os.dup(1)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)
    sys.stdout = sys.stderr
    return pipes


def _listen(source: int, tasks: SimpleQueue[bytes]) -> None:
    """Put the tasks into a queue as they arrive; end this process, even in the middle of a task, with its parent."""
    while True:
        try:
            tasks.put(receive(source))
        except (EOFError, OSError):
            os._exit(1)


def _answer(task: bytes) -> bytes:
    """Carry out a pickled task, (function, arguments); return (True, its result) or (False, its exception), pickled."""
    from cloudpickle import dumps

    try:
        call, arguments = pickle.loads(task)
        return dumps((True, call(*arguments)))
    except BaseException as error:
        error.add_note(f"In a worker process:\n{traceback.format_exc()}")
        try:
            return dumps((False, error))
        except Exception:  # an exception may hold anything
            return dumps((False, RuntimeError(traceback.format_exc())))
