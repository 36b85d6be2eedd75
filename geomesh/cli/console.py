"""What a command tells while it works: to people on standard error, or to programs as JSON lines.

The JSON lines protocol, on standard output, one object a line with `event`:

- ``start``: ``protocol`` (this version), ``pid`` of the process, ``command``, ``source``,
  ``unfinished`` (how the names of folders begin in which this process writes outputs: whoever
  kills it can remove them from the folders of the outputs)
- ``progress``: ``fraction`` (0..1), ``message``
- ``log``: ``level`` ("warning"), ``message``
- ``error``: ``code`` (of `geomesh.errors`, or "interrupted"), ``message``
- ``result``: ``outputs`` (paths), ``figures`` (numbers)
"""

from __future__ import annotations

import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any, Protocol

import click

from geomesh.errors import GeomeshError, GeomeshWarning

PROTOCOL = 1

# How the library's messages name a parameter, and perhaps a value for it.
_PARAMETER = re.compile(r"`(?P<name>[a-z_]+)(?:=(?P<value>[^`]*))?`")

Report = Callable[[float, str], None]


class Console(Protocol):
    """How a command reports."""

    def start(self, command: str, source: str) -> None:
        """Work on a source begins."""

    def progress(self) -> AbstractContextManager[Report]:
        """Return the callable that long work reports to."""

    def warn(self, message: str) -> None:
        """Say something that the user should know."""

    def error(self, code: str, message: str) -> None:
        """Say in one line what went wrong."""

    def interrupted(self) -> None:
        """Say that the work was stopped."""

    def result(self, outputs: Sequence[str], figures: Mapping[str, Any], text: str) -> None:
        """Say what was made: paths and numbers, or the line of text that tells them."""


class People:
    """Messages and a progress bar on standard error; what was made on standard output."""

    def __init__(self, *, bar: bool, quiet: bool = False) -> None:
        self._bar = bar
        self._quiet = quiet
        self._is_interrupted = False

    def start(self, command: str, source: str) -> None:
        """Say nothing: the bar and the result do."""

    @contextmanager
    def progress(self) -> Iterator[Report]:
        """Show a bar, if asked for."""
        if self._bar:
            from geomesh.parallel.progress import bar

            with bar() as report:
                yield report
        else:
            yield lambda _fraction, _message: None

    def warn(self, message: str) -> None:
        """Print a warning."""
        click.echo(f"Warning: {message}", err=True)

    def error(self, code: str, message: str) -> None:  # noqa: ARG002
        """Print an error."""
        click.echo(f"Error: {message}", err=True)

    def interrupted(self) -> None:
        """Say it once, on a line of its own, below a bar."""
        if self._is_interrupted:
            return
        self._is_interrupted = True
        click.echo("Interrupted: what was being written was left as it was.", err=True)

    def result(self, outputs: Sequence[str], figures: Mapping[str, Any], text: str) -> None:  # noqa: ARG002
        """Print the text, unless a JSON document follows."""
        if not self._quiet:
            click.echo(text)


class JsonLines:
    """One JSON object a line on standard output."""

    def __init__(self) -> None:
        self._is_interrupted = False

    def _tell(self, event: str, **values: Any) -> None:
        click.echo(json.dumps({"event": event, **values}, ensure_ascii=True))

    def start(self, command: str, source: str) -> None:
        """Tell the protocol's version too, which process this is, and where it writes."""
        from geomesh.io.atomic import leftovers_prefix

        pid = os.getpid()
        process = {"pid": pid, "unfinished": leftovers_prefix(pid)}
        self._tell("start", protocol=PROTOCOL, **process, command=command, source=source)

    @contextmanager
    def progress(self) -> Iterator[Report]:
        """Tell whole percents, each once."""
        last = -1

        def report(fraction: float, message: str) -> None:
            nonlocal last
            percent = int(fraction * 100)
            if percent != last:
                last = percent
                self._tell("progress", fraction=percent / 100, message=message)

        yield report

    def warn(self, message: str) -> None:
        """Tell a warning."""
        self._tell("log", level="warning", message=message)

    def error(self, code: str, message: str) -> None:
        """Tell an error."""
        self._tell("error", code=code, message=message)

    def interrupted(self) -> None:
        """Tell it once, as an error."""
        if self._is_interrupted:
            return
        self._is_interrupted = True
        self.error("interrupted", "what was being written was left as it was")

    def result(self, outputs: Sequence[str], figures: Mapping[str, Any], text: str) -> None:  # noqa: ARG002
        """Tell what was made."""
        self._tell("result", outputs=list(outputs), figures=dict(figures))


def open_console(style: str | None, *, quiet: bool = False) -> Console:
    """Return the console for a `--progress` style; `quiet` leaves out the text of results."""
    if style == "jsonl" and quiet:
        raise click.UsageError("--progress jsonl and --json both write to stdout: choose one")
    if style is None:
        style = "bar" if sys.stderr.isatty() else "none"
    return JsonLines() if style == "jsonl" else People(bar=style == "bar", quiet=quiet)


def spell(message: str) -> str:
    """Return a message of the library with options of the command in place of parameters.

    The library writes `` `bounds` `` or `` `overwrite=True` ``; people who use the command know
    these as --bounds and --overwrite, and parameters of the recipe as --set.
    """
    context = click.get_current_context(silent=True)
    options = {
        parameter.name: parameter
        for parameter in (context.command.params if context is not None else ())
        if isinstance(parameter, click.Option)
    }

    def option(match: re.Match[str]) -> str:
        name, value = match["name"], match["value"]
        if name in options:
            known = max(options[name].opts, key=len)
            return known if value is None or options[name].is_flag else f"{known} {value}"
        if "settings" in options and value is not None:
            # As JSON has it.
            plain = {"None": "null", "True": "true", "False": "false"}.get(value, value)
            return f"--set {name}={plain}"
        return match[0]

    return _PARAMETER.sub(option, message)


@contextmanager
def interruptible(console: Console) -> Iterator[None]:
    """Say that the work was stopped, if it is."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        with suppress(OSError):  # whoever listened may have gone
            console.interrupted()
        raise


@contextmanager
def guarded(console: Console, debug: bool, about: str = "") -> Iterator[list[str]]:
    """Turn errors into one line (kept in the list that is yielded) and warnings into messages.

    `about` is put before warnings, to tell which of several rasters they are about.
    """
    failures: list[str] = []

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        if issubclass(category, GeomeshWarning) or debug:
            console.warn(f"{about}{spell(str(message))}")

    with interruptible(console), warnings.catch_warnings():
        warnings.simplefilter("always", GeomeshWarning)
        warnings.showwarning = show
        try:
            yield failures
        except GeomeshError as error:
            failures.append(spell(str(error)))
            console.error(error.code, failures[-1])
            if debug:
                raise
        except MemoryError:
            failures.append("not enough memory")
            console.error("memory", "not enough memory: choose a smaller part with --bounds")
        except Exception as error:
            if debug:
                raise
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"
            failures.append(text)
            console.error(
                "internal", f"{text} (a defect of geomesh; run `geomesh --debug ...` and report it)"
            )
