"""Views of results: tables, figures and pages, which are made by modules above the results themselves.

A result is a value of a low layer, and its views need pandas, matplotlib and half of the package. So the methods of
results name their view, and this module imports it on first use: it is the only one that refers to a layer above.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


def view(name: str, *arguments: Any) -> Any:
    """Call a function by its full name, e.g. `robustopt.frames.plan_frame`.

    Args:
        name: module and function.
        arguments: of the function.

    Returns:
        The result of the function.
    """
    module, _, function = name.rpartition(".")
    return getattr(import_module(module), function)(*arguments)
