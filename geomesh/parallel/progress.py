"""Progress of long work: callbacks, and a progress bar on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

# A callback. It gets the completed fraction (0..1) and a message. It can raise to cancel.
Progress = Callable[[float, str], None]


def silent(fraction: float, message: str) -> None:
    """Ignore progress."""


def part_of(progress: Progress, start: float, stop: float) -> Progress:
    """Return a callback that maps 0..1 to `start`..`stop` and calls `progress`."""

    def report(fraction: float, message: str) -> None:
        progress(start + fraction * (stop - start), message)

    return report


@contextmanager
def reporting(progress: bool | Progress) -> Iterator[Progress]:
    """Yield the callback: the caller's own, a progress bar (True), or one that does nothing."""
    if callable(progress):
        yield progress
    elif progress:
        with bar() as report:
            yield report
    else:
        yield silent


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
