"""Standard output and standard error that never fail.

Messages are not the work: a terminal that cannot show a name, a reader that has exited or a full
disk must not stop a batch or spoil a mesh. So within `unfailing_streams`, characters that the
encoding lacks are printed as escapes, and what cannot be written is dropped. A program that
wants geomesh to stop when it exits itself starts it with --until-eof.
"""

from __future__ import annotations

import errno
import io
import os
import select
import sys
import unicodedata
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from _typeshed import ReadableBuffer

# Standard input, standard output and standard error.
_DESCRIPTORS = (0, 1, 2)

# Categories of characters that end a line or control a terminal.
_BREAKING = ("Cc", "Zl", "Zp")


class _Unfailing(io.RawIOBase):
    """Pass bytes on to a stream. After the first failure, drop them.

    Parameters
    ----------
    stream : binary stream without a buffer of its own
    """

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self._stream = stream
        self.failure: OSError | None = None

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return bool(self._stream.isatty())

    def fileno(self) -> int:
        return int(self._stream.fileno())

    def write(self, data: ReadableBuffer, /) -> int:
        size = memoryview(data).nbytes
        if self.failure is None:
            try:
                return self._send(data)
            except OSError as error:
                self.failure = error
        return size

    def _send(self, data: ReadableBuffer) -> int:
        # None: the stream does not wait for its reader. Then wait here.
        while (written := self._stream.write(data)) is None:
            select.select([], [self._stream], [])
        return int(written)


class _Stream(io.TextIOWrapper):
    """Text for an `_Unfailing` stream, with an escape for each character that it cannot show."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream  # it would be closed if nothing referred to it
        # A buffer would try to write its bytes again when the interpreter exits.
        binary = stream.buffer
        self.pipe = _Unfailing(getattr(binary, "raw", binary))
        super().__init__(
            io.BufferedWriter(self.pipe),
            encoding=stream.encoding,
            errors="backslashreplace",
            line_buffering=True,
        )


@contextmanager
def unfailing_streams() -> Iterator[None]:
    """Replace sys.stdout and sys.stderr within the block by streams that never fail."""
    _occupy_descriptors()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _guarded(sys.stdout, 1), _guarded(sys.stderr, 2)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        sys.stdout, sys.stderr = before


def _occupy_descriptors() -> None:
    """Open the null device in place of standard streams that the caller has closed.

    Otherwise the next file that is opened, perhaps a mesh, would get the messages of C libraries.
    """
    for descriptor in _DESCRIPTORS:
        try:
            os.fstat(descriptor)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            os.set_inheritable(descriptor, True)


def _guarded(stream: TextIO | None, descriptor: int) -> TextIO:
    if isinstance(stream, _Stream):
        return stream
    if stream is None:
        stream = open(descriptor, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if not hasattr(stream, "buffer"):  # that of a notebook, which is text in memory
        return stream
    with suppress(OSError, ValueError):
        stream.flush()
    return _Stream(stream)


def is_output_lost() -> bool:
    """Return whether a result on standard output could not be written, as on a full disk.

    A reader that has exited, as `head` does, has what it wants: then nothing is lost.
    """
    failure = _failure()
    gone = (errno.EPIPE, errno.ECONNRESET, *((errno.EINVAL,) if os.name == "nt" else ()))
    return failure is not None and failure.errno not in gone


def tell_of_lost_output(code: int) -> None:
    """Print a line if something was lost on standard output. `code` is the exit code."""
    failure = _failure()
    if failure is not None and is_output_lost():
        kind = "Error" if code else "Warning"
        reason = (failure.strerror or str(failure)).lower()
        echo(f"{kind}: standard output could not be written: {reason}", err=True)


def _failure() -> OSError | None:
    with suppress(ValueError):
        sys.stdout.flush()
    return sys.stdout.pipe.failure if isinstance(sys.stdout, _Stream) else None


def echo(text: str, *, err: bool = False) -> None:
    """Print text on standard output or standard error, at once."""
    print(text, file=sys.stderr if err else sys.stdout, flush=True)


def printable(text: str) -> str:
    """Return text on one line, with an escape for each character that cannot be shown.

    These are control characters, such as a line break in a name, and those that the encoding of
    the terminal lacks.
    """
    encoding = getattr(sys.stderr, "encoding", None) or "utf-8"
    shown = (
        character.encode("unicode_escape").decode()
        if unicodedata.category(character) in _BREAKING
        else character
        for character in text
    )
    return "".join(shown).encode(encoding, "backslashreplace").decode(encoding)
