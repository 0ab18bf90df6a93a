"""What every stage needs from its command line."""

import argparse
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import Progress as Bars
from rich.progress import TimeElapsedColumn

from hybrid_dynamics.errors import ConfigError, InputError
from hybrid_dynamics.files import write_json
from hybrid_dynamics.models.symbolic.julia import check_julia
from hybrid_dynamics.study.config import PARAMS, load_params
from hybrid_dynamics.study.layout import DatasetFiles
from hybrid_dynamics.trajectory import Trajectory, read_trajectories
from hybrid_dynamics.types import Progress


def dataset_argument(description: str | None) -> DatasetFiles:
    """Parse ``stage.py DATASET``."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("dataset", help="name of the dataset, a key of 'dataset' in params.yaml")
    check_engine()
    return dataset_files(parser.parse_args().dataset)


def check_engine() -> None:
    """Raise where the engine of symbolic regression cannot run: known before the first stage, not after the last."""
    if PARAMS.is_file() and load_params().get("sr", {}).get("engine") == "pysr":
        check_julia()


def dataset_files(name: str) -> DatasetFiles:
    """Files of dataset ``name``; the name becomes a folder, so it must be a plain word."""
    if not name.replace("_", "").replace("-", "").isalnum():
        raise ConfigError(f"dataset {name!r}: expected letters, digits, '-' and '_'")
    return DatasetFiles(name)


def training_runs(files: DatasetFiles) -> list[Trajectory]:
    """The training runs of the features; :class:`InputError` where there are none."""
    runs = read_trajectories(files.features, split="train")
    if not runs:
        raise InputError(f"{files.features}: no run with split 'train'; give at least one in conf/dataset/")
    return runs


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Yield ``progress(share, what)``: a bar on a terminal, a line every tenth elsewhere (logs, CI)."""
    console = Console()
    if console.is_terminal:
        with Bars(*Bars.get_default_columns(), TimeElapsedColumn(), console=console) as bar:
            task = bar.add_task(title, total=1.0)
            yield lambda share, what: bar.update(task, completed=share, description=f"{title}: {what}")
        return
    shown = -1

    def line(share: float, what: str) -> None:
        nonlocal shown
        if int(10 * share) > shown:
            shown = int(10 * share)
            print(f"{title}: {share:4.0%} {what}", flush=True)

    yield line


@contextmanager
def measured(path: Path) -> Iterator[None]:
    """Write wall time [s], peak memory [MB] and end [s since the epoch] of the block to ``path``.

    No cached stage but the report reads it.
    """
    started = time.perf_counter()
    yield
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024
    wall = round(time.perf_counter() - started, 2)
    write_json(path, {"wall_s": wall, "peak_memory_mb": round(peak, 1), "finished": round(time.time(), 1)})
