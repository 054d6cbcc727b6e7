"""Style of the figures, and reproducible writing: the same run gives the same files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib.style
from matplotlib.figure import Figure

from robustopt.arrays import Flags
from robustopt.files import written
from robustopt.solvers.trajectory import NO_LIMIT, PAUSE

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, INDIGO, WINE = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#332288", "#882255",
)  # fmt: skip
LIMIT_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, INDIGO, WINE)
"""Colours that people with a colour vision deficiency can tell apart (Okabe and Ito; the last two by Paul Tol)."""

CONTACT_COLOURS = {"left_foot": BLUE, "right_foot": VERMILLION, "left_hand": GREEN, "right_hand": PURPLE}
"""Colours of the contacts with the environment."""

INK, DARK_GREY, GREY, PALE = "#222222", "#666666", "#b3b3b3", "#ececec"
OTHER = "other limits"

STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "figure.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "butt",
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "robustopt",
    "savefig.dpi": 160,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the style of this package; the user's own settings neither matter nor change."""
    with matplotlib.style.context(["default", STYLE]):
        yield


def limit_colours(shares: Mapping[str, float]) -> dict[str, str]:
    """Return the colour of every limit; the limits with the largest shares have their own, the rest share one.

    Args:
        shares: share of the duration by limit, largest first.

    Returns:
        Colour by limit, `OTHER` included.
    """
    names = [name for name in shares if name not in (NO_LIMIT, PAUSE)]
    own = dict(zip(names, LIMIT_COLOURS, strict=False))
    return {**own, **dict.fromkeys(names[len(own) :], GREY), OTHER: GREY, NO_LIMIT: DARK_GREY, PAUSE: DARK_GREY}


def joint_unit(unit: str, hinges: Flags) -> str:
    """Return the unit of a quantity of several joints: "rad/s" for hinges, "m/s" for slides, "rad/s, m/s" for both.

    Args:
        unit: the unit for a hinge.
        hinges: whether each joint is a hinge, shape (n,).

    Returns:
        The unit, or both.
    """
    sliding = "N" if unit == "N m" else unit.replace("rad", "m")
    return unit if hinges.all() else f"{unit}, {sliding}" if hinges.any() else sliding


def percent(share: float) -> str:
    """Format a share in [0, 1] as `41 %` or `under 1 %`."""
    rounded = f"{100 * share:.0f} %"
    return "under 1 %" if share > 0 and rounded == "0 %" else rounded


def save(figure: Figure, folder: Path, name: str, formats: Iterable[str] = ("svg", "png")) -> list[Path]:
    """Write a figure in each format, without date or random identifiers, and return the files.

    The layout of the first format stays for the others: it takes longer than drawing.
    """
    paths = [folder / f"{name}.{suffix}" for suffix in formats]
    for path in paths:
        metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
        with written(path) as beside:
            figure.savefig(beside, metadata=metadata)
        figure.set_layout_engine("none")
    return paths
