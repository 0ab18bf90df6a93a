"""Progress on a terminal, and in a log file where there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


@contextmanager
def progress(console: Console) -> Iterator[Callable[[str, float], None]]:
    """Yield ``tell(stage, share)``: a bar on a terminal, a line a stage elsewhere (logs, CI)."""
    if not console.is_terminal:
        said = ""

        def line(stage: str, share: float) -> None:
            nonlocal said
            if stage != said:
                said = stage
                console.print(f"{share:4.0%} {stage}", highlight=False, markup=False, soft_wrap=True)

        yield line
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading the logs", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)
