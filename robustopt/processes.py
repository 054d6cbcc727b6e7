"""Worker processes of this machine, by joblib: results in their order; what a worker had that died is done again."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

from robustopt.errors import RobustOptError

T = TypeVar("T")

RETRIES = 3
"""How often the tasks of workers that died are given to new ones."""


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    call: Callable[..., T], tasks: Sequence[tuple[Any, ...]], processes: int, failed: type[RobustOptError]
) -> Generator[T, None, None]:
    """What `call` returns for the arguments of each task. The workers stay for the next tasks of this process.

    Raises `failed` where workers died again and again.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    done = 0
    for attempt in range(RETRIES + 1):
        parallel: Any = Parallel(n_jobs=processes, return_as="generator", pre_dispatch=processes)
        try:
            for result in parallel(delayed(call)(*task) for task in tasks[done:]):
                done += 1
                yield result
            return
        except TerminatedWorkerError as error:
            if attempt == RETRIES:
                raise failed(
                    f"Worker processes died {attempt + 1} times, for instance because the memory ran out; "
                    f"{done} of {len(tasks)} parts of the work were done. Fewer workers need less memory."
                ) from error
        except (GeneratorExit, KeyboardInterrupt):
            _end_processes()
            raise


def _end_processes() -> None:
    """End the worker processes of joblib and free their locks, which would else be reported as leaks at the exit."""
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)
    gc.collect()
