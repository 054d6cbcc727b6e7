"""Time calls side by side on a machine with other load, and describe the machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from importlib import metadata
from math import ceil
from pathlib import Path
from typing import TypeVar

import numpy as np

Array = np.ndarray
Key = TypeVar("Key")

SHORTEST = 2e-3
"""Time of a turn for which the clock and cold caches hardly count [s]."""

LONG = 0.5
"""A longer call is warm after one round [s]."""


def interleaved(
    calls: Mapping[Key, Callable[[], object]], repetitions: int, shortest: float = SHORTEST
) -> dict[Key, Array]:
    """Return the seconds per call, (repetitions,) each; the calls take turns, A B C A B C, after a warm-up.

    A call shorter than `shortest` [s] is repeated for that time before the next has its turn, and the time is divided.
    """
    once = {name: _seconds(call, 1) for name, call in calls.items()}
    once = {name: _seconds(calls[name], 1) if seconds < LONG else seconds for name, seconds in once.items()}
    counts = {name: ceil(shortest / max(seconds, 1e-9)) for name, seconds in once.items()}
    rounds = [{name: _seconds(call, counts[name]) for name, call in calls.items()} for _ in range(repetitions)]
    return {name: np.array([times[name] for times in rounds]) for name in calls}


def _seconds(call: Callable[[], object], count: int) -> float:
    began = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - began) / count


def spread(seconds: Array) -> dict[str, float | int]:
    """Return median and quartiles of repeated measurements, as entries of a record."""
    low, middle, high = np.quantile(seconds, [0.25, 0.5, 0.75]).tolist()
    return {"seconds": middle, "lower_quartile": low, "upper_quartile": high, "repetitions": len(seconds)}


def machine_facts(packages: tuple[str, ...]) -> str:
    """Describe processor, cores, versions and load of the machine in one paragraph."""
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in packages)
    system = f"{_processor()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "as many as OpenBLAS takes")
    busy = f"load average when the measurements began: {os.getloadavg()[0]:.1f}"
    return f"Machine: {system}; {versions}. Threads for linear algebra: {threads}; {busy}."


def _processor() -> str:
    facts = Path("/proc/cpuinfo")
    lines = facts.read_text(encoding="utf-8").splitlines() if facts.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
