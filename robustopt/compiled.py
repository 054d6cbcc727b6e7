"""Compilation of numerical kernels by numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba as nb


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function without the interpreter's lock and keeps the result on the disk.

    If neither the package's folder nor the user's cache folder can be written, as in some containers, each process
    compiles the function again.

    Args:
        **options: options of `numba.njit`.

    Returns:
        The decorator.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return nb.njit(cache=True, nogil=True, **options)(function)
        except RuntimeError:  # no folder for the cache
            return nb.njit(nogil=True, **options)(function)

    return decorate
