"""How this process gets its memory from the system, where that is the GNU C library."""

from __future__ import annotations

import ctypes
import platform
from contextlib import suppress

# Parameters of mallopt, of the GNU C library.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8


def keep_freed_memory() -> None:
    """Let what was freed be used again, instead of being returned and asked for anew.

    Every tile takes and frees the same hundreds of megabytes. By default the C library
    hands most of them back, and the system clears them again: on a scene of 36 megapixels
    that was half a million to two million page faults and up to a quarter of the time.
    One arena for all threads, so that what one of them freed the others can use. For the
    process of a command only: in a program of others that is not ours to decide.
    """
    library = _gnu_library()
    if library is not None:
        library.mallopt(_MMAP_THRESHOLD, 1 << 30)
        library.mallopt(_TRIM_THRESHOLD, (1 << 31) - 1)
        library.mallopt(_ARENA_MAX, 1)


def trim_memory() -> None:
    """Return to the system what is free now, after the work that needs the most."""
    library = _gnu_library()
    if library is not None:
        library.malloc_trim(0)


def _gnu_library() -> ctypes.CDLL | None:
    with suppress(OSError):
        return ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None
    return None
