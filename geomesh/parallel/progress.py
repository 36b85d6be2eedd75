"""Progress of long work, for people: a bar on standard error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from geomesh.parallel.tiles import Progress


@contextmanager
def reporting(progress: bool | Progress) -> Iterator[Progress]:
    """Yield the callable to report to: the caller's own, a bar (True), or nothing (False)."""
    if callable(progress):
        yield progress
    elif progress:
        with bar() as report:
            yield report
    else:
        yield lambda _fraction, _message: None


@contextmanager
def bar() -> Iterator[Progress]:
    """Show a progress bar with a time estimate on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with RichProgress(*columns, console=Console(stderr=True, force_jupyter=False)) as display:
        task = display.add_task("Reading", total=1.0)

        def report(fraction: float, message: str) -> None:
            display.update(task, completed=fraction, description=message)

        yield report
