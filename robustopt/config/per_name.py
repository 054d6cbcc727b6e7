"""Values that a configuration gives once for all contacts, or by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

V = TypeVar("V")


def value_of(given: V | Mapping[str, V] | None, names: tuple[str, ...], otherwise: V) -> V:
    """Return the value of a contact: the common value, else that of its first name that is given, else `default`.

    Args:
        given: one value for all contacts, values by name, or None.
        names: names of the contact, the most specific first.
        otherwise: the value to return if none is given.
    """
    if given is None:
        return otherwise
    if isinstance(given, Mapping):
        return next((given[name] for name in (*names, "default") if name in given), otherwise)
    return given
