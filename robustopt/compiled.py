"""Compilation of numerical kernels by numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba as nb

DEFAULTS = {"fastmath": False, "error_model": "python", "forceinline": False, "_nrt": True}
"""Options that numba would take over from the function that is being compiled when it first meets a call of another:
the numbers would depend on which is compiled first."""


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function without the interpreter's lock and keeps the result on the disk.

    If neither the package's folder nor the user's cache folder can be written, as in some containers, each process
    compiles the function again.

    Args:
        **options: options of `numba.njit`.

    Returns:
        The decorator.
    """
    options = {**DEFAULTS, **options}

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return nb.njit(cache=True, nogil=True, no_cfunc_wrapper=True, **options)(function)
        except RuntimeError:  # no folder for the cache
            return nb.njit(nogil=True, **options)(function)

    return decorate


def compiled_inner(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function for compiled callers, without counting references to arrays.

    Counting costs more than short arithmetic, most of all if arrays come in tuples or threads share them. The callers
    hold the arrays, so a function that neither makes nor returns any need not count.

    Args:
        **options: options of `numba.njit`.

    Returns:
        The decorator.
    """
    return nb.njit(
        nogil=True, **{**DEFAULTS, "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, **options}
    )


def merged(function: Callable[..., Any]) -> Any:
    """Return a function whose code becomes part of each compiled caller, and has the options of the caller.

    A compiled function passes all stages of compilation again within its caller, and in the caller's caller, and so on.
    This one passes them only within functions that are compiled themselves: it suits what is called at one place.

    Args:
        function: the function.
    """
    return nb.njit(inline="always")(function)
