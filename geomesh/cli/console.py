"""The messages of a command: text on standard error for people, or JSON lines for programs.

The JSON lines go to standard output. Each line is one object. Its `event` is one of these:

- ``start``: ``protocol`` (version of the protocol), ``pid`` of the process, ``command``,
  ``source``, ``unfinished`` (the first part of the names of the temporary folders in which this
  process writes outputs. A program that kills the process can remove these folders. They are
  in the folders of the outputs.)
- ``progress``: ``fraction`` (0..1), ``message``
- ``log``: ``level`` ("warning"), ``message``
- ``error``: ``code`` (from `geomesh.errors`, or "interrupted"), ``message``
- ``result``: ``outputs`` (paths), ``figures`` (numbers)

A console never fails, whoever reads it: see `geomesh.cli.streams`.
"""

from __future__ import annotations

import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol

import click

from geomesh.cli.streams import echo, is_output_lost, printable
from geomesh.errors import GeomeshError, GeomeshWarning

PROTOCOL = 1

# A parameter in a message of the library, with or without a value.
_PARAMETER = re.compile(r"`(?P<name>[a-z_]+)(?:=(?P<value>[^`]*))?`")

# Quotation marks of a text in Python.
_QUOTES = "\"'"

Report = Callable[[float, str], None]


class Console(Protocol):
    """The output of a command."""

    def start(self, command: str, source: str) -> None:
        """Report that the work on a source begins."""

    def progress(self) -> AbstractContextManager[Report]:
        """Return a context that yields the progress callback."""

    def warn(self, message: str) -> None:
        """Report a warning."""

    def error(self, code: str, message: str) -> None:
        """Report an error of one line."""

    def interrupted(self) -> None:
        """Report that the work was interrupted."""

    def result(self, outputs: Sequence[str], figures: Mapping[str, Any], *lines: str) -> None:
        """Report the result: paths and numbers for programs, or lines of text for people."""


class People:
    """Text for people: messages and progress on standard error, results on standard output."""

    def __init__(self, *, bar: bool, quiet: bool = False) -> None:
        self._bar = bar
        self._quiet = quiet
        self._is_interrupted = False

    def start(self, command: str, source: str) -> None:
        """Print nothing: the progress bar and the result are enough."""

    @contextmanager
    def progress(self) -> Iterator[Report]:
        """Show a progress bar, if it is enabled."""
        if self._bar:
            from geomesh.parallel.progress import bar

            with bar() as report:
                yield report
        else:
            yield lambda _fraction, _message: None

    def warn(self, message: str) -> None:
        """Print a warning."""
        echo(printable(f"Warning: {message}"), err=True)

    def error(self, code: str, message: str) -> None:  # noqa: ARG002
        """Print an error."""
        echo(printable(f"Error: {message}"), err=True)

    def interrupted(self) -> None:
        """Print it once, on its own line below the progress bar."""
        if self._is_interrupted:
            return
        self._is_interrupted = True
        echo("Interrupted: the unfinished output was not written.", err=True)

    def result(self, outputs: Sequence[str], figures: Mapping[str, Any], *lines: str) -> None:  # noqa: ARG002
        """Print the lines. If `quiet`, print nothing, because a JSON document follows."""
        for line in () if self._quiet else lines:
            echo(printable(line))


class JsonLines:
    """JSON lines for programs: one object per line on standard output."""

    def __init__(self) -> None:
        self._is_interrupted = False

    def _print(self, event: str, **values: Any) -> None:
        echo(json.dumps({"event": event, **values}, ensure_ascii=True))

    def start(self, command: str, source: str) -> None:
        """Print `start`, with the process id and the names of temporary folders."""
        from geomesh.io.atomic import leftovers_prefix

        pid = os.getpid()
        process = {"pid": pid, "unfinished": leftovers_prefix(pid)}
        self._print("start", protocol=PROTOCOL, **process, command=command, source=source)

    @contextmanager
    def progress(self) -> Iterator[Report]:
        """Print `progress` when the whole percentage has changed."""
        last = -1

        def report(fraction: float, message: str) -> None:
            nonlocal last
            percent = int(fraction * 100)
            if percent != last:
                last = percent
                self._print("progress", fraction=percent / 100, message=message)

        yield report

    def warn(self, message: str) -> None:
        """Print a warning as `log`."""
        self._print("log", level="warning", message=message)

    def error(self, code: str, message: str) -> None:
        """Print an `error`."""
        self._print("error", code=code, message=message)

    def interrupted(self) -> None:
        """Print it once, as an `error`."""
        if self._is_interrupted:
            return
        self._is_interrupted = True
        self.error("interrupted", "interrupted: the unfinished output was not written")

    def result(self, outputs: Sequence[str], figures: Mapping[str, Any], *lines: str) -> None:  # noqa: ARG002
        """Print the `result`."""
        self._print("result", outputs=list(outputs), figures=dict(figures))


def open_console(style: str | None, *, quiet: bool = False) -> Console:
    """Return the console for a `--progress` style. If `quiet`, it prints no results as text."""
    if style == "jsonl" and quiet:
        raise click.UsageError("--progress jsonl and --json both write to stdout: choose one")
    if style is None:
        style = "bar" if sys.stderr.isatty() else "none"
    return JsonLines() if style == "jsonl" else People(bar=style == "bar", quiet=quiet)


def spell(message: str) -> str:
    """Return a message of the library with its parameters replaced by options of the command.

    The library writes `` `bounds` `` or `` `overwrite=True` ``. In the command these are
    --bounds and --overwrite. Parameters of the recipe become --set.
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
            if value is None or options[name].is_flag:
                return known
            return f"{known} {value.strip(_QUOTES)}"
        if "settings" in options and value is not None:
            # Write the value as JSON.
            plain = {"None": "null", "True": "true", "False": "false"}.get(value, value)
            return f"--set {name}={plain}"
        return match[0]

    return _PARAMETER.sub(option, message)


@contextmanager
def interruptible(console: Console) -> Iterator[None]:
    """Report if the block is interrupted."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        console.interrupted()
        raise


@contextmanager
def guarded(console: Console, debug: bool, about: str = "") -> Iterator[list[str]]:
    """Report errors and warnings in the block as messages of one line.

    Parameters
    ----------
    console : Console
    debug : bool
        Raise errors again, and report the warnings of other libraries too.
    about : str
        Name of the raster, to be put before warnings that do not name it.

    Yields
    ------
    list of str
        Empty. An error adds its message.
    """
    failures: list[str] = []

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        if issubclass(category, GeomeshWarning) or debug:
            text = spell(str(message))
            named = not about or text.startswith(about)
            console.warn(text if named else f"{about}: {text}")

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
            part = spell("`bounds`")
            way_out = f": choose a smaller part with {part}" if part.startswith("--") else ""
            console.error("memory", f"not enough memory{way_out}")
        except Exception as error:
            if debug:
                raise
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"
            failures.append(text)
            console.error(
                "internal", f"{text} (a defect of geomesh; run `geomesh --debug ...` and report it)"
            )


def exit_code(failures: object, *, printed: bool) -> int:
    """Return the exit code of a command: 1 if something failed, else 0.

    `printed` says that the result itself is what was printed on standard output. Then a result
    that was lost there, as on a full disk, is a failure too.
    """
    return 1 if failures or (printed and is_output_lost()) else 0
