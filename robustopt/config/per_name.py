"""Values that a configuration gives once for all, or by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

V = TypeVar("V")


def value_of(given: V | Mapping[str, V] | None, names: tuple[str, ...], otherwise: V) -> V:
    """Return the value for a thing: the one value for all, else its own by the first of its names, else `default`.

    Args:
        given: one value, values by name, or None.
        names: names of the thing, the most specific first.
        otherwise: the value if nothing is given for it.
    """
    if given is None:
        return otherwise
    if isinstance(given, Mapping):
        return next((given[name] for name in (*names, "default") if name in given), otherwise)
    return given
