"""Arguments and options that commands share, and the values that options can have."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Method(StrEnum):
    """Solvers."""

    ipopt = "ipopt"
    reachability = "reachability"


class Backend(StrEnum):
    """Schedulers of trials."""

    processes = "processes"
    dask = "dask"


class ExecutorName(StrEnum):
    """Executors of a learner's plans."""

    simulation = "simulation"
    manual = "manual"


class Effort(StrEnum):
    """Efforts of a certificate."""

    quick = "quick"
    full = "full"


class FormatName(StrEnum):
    """Formats of exported motions."""

    csv = "csv"
    ros = "ros"
    moveit = "moveit"
    urscript = "urscript"
    npz = "npz"


ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="YAML file of the task; see docs/configuration.md")]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help="set keys to other values, e.g. contact.friction=0.3 'uncertainty={}'"),
]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="run folder of robustopt")]
Out = Annotated[
    Path | None,
    typer.Option(help="write into this folder, new or empty; default: results/NAME/TIME", show_default=False),
]
Seed = Annotated[int | None, typer.Option(help="set the seed of all random numbers", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object instead of text, also for errors")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]
Workers = Annotated[int, typer.Option(min=1, help="number of worker processes; each runs cores / N simulation threads")]
