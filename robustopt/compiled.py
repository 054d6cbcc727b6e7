"""Functions that numba compiles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba as nb


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function without the interpreter's lock, and keep the result on the disk for the next process.

    Where neither the folder of the package nor a cache folder of the user can be written to, as in some containers,
    each process compiles anew. options: of numba.njit
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return nb.njit(cache=True, nogil=True, **options)(function)
        except RuntimeError:  # no place to keep it
            return nb.njit(nogil=True, **options)(function)

    return decorate
