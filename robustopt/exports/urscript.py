"""Trajectories as URScript programs, for the controllers of Universal Robots."""

from __future__ import annotations

import re
from collections.abc import Iterable

from robustopt.exports.cycles import Motion

LOOKAHEAD, GAIN = 0.1, 300
"""Filter of `servoj`: time [s] and gain, the defaults of Universal Robots."""

NEAR = 0.02
"""Largest distance of a joint from the first position with which the program begins to move [rad] (our choice)."""

STEP = 0.002
"""Control cycle of the controllers [s]; those of the CB series have cycles of 8 ms, a multiple of it."""


def program(motion: Motion) -> str:
    """Return a program that follows a motion of six joints with one `servoj` per period.

    The program begins with a check that the arm is at the first position, and holds the last position until the filter
    of `servoj` has caught up.

    Args:
        motion: the motion.
    """
    name = re.sub(r"\W", "_", motion.name, flags=re.ASCII)
    q = [_positions(row) for row in motion.samples.q.tolist()]
    hold = max(round(LOOKAHEAD / motion.period), 1)
    lines = [
        f"# {motion.name}: {motion.duration:.6g} s, one servoj every {motion.period:.6g} s; joints: "
        f"{', '.join(motion.joint_names)}",
        f"def robustopt_{name}():",
        *_indented(_check(q[0])),
        *(f"  {_servoj(row, motion.period)}" for row in q[1:]),
        "  i = 0",
        f"  while i < {hold}:",
        f"    {_servoj(q[-1], motion.period)}",
        "    i = i + 1",
        "  end",
        "  stopj(4)",
        "end",
        f"robustopt_{name}()",
    ]
    return "\n".join(lines) + "\n"


def _check(start: str) -> list[str]:
    """Return lines that end the program unless the arm is at its first position."""
    return [
        f"start = {start}",
        "here = get_actual_joint_positions()",
        "i = 0",
        "while i < 6:",
        f"  if norm(here[i] - start[i]) > {NEAR}:",
        f'    popup("move the arm to the first position, within {NEAR} rad", title="robustopt", error=True)',
        "    halt",
        "  end",
        "  i = i + 1",
        "end",
    ]


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"  {line}" for line in lines]


def _servoj(q: str, period: float) -> str:
    return f"servoj({q}, t={period:.6g}, lookahead_time={LOOKAHEAD}, gain={GAIN})"


def _positions(q: Iterable[float]) -> str:
    return f"[{', '.join(f'{value:.9f}' for value in q)}]"
