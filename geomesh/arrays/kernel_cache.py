"""Machine code of kernels on disk: found again as long as nothing that it was made of changed.

numba's own cache goes by the time of a kernel's file: it misses a change in a kernel or a
constant of another file. Here the name of a file holds a digest of the byte code of the
kernel and of all kernels that it calls, and of the constants that these use, so other code
has another file: a stale one cannot be loaded, whoever else writes at the same time.
"""

from __future__ import annotations

import hashlib
import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any

from numba import config
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache

from geomesh.errors import GeomeshWarning, one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_told: list[str] = []


def open_cache(function: Callable[..., Any], signature: Any) -> KernelCache | NoCache:
    """Return the cache of a kernel; one that keeps nothing if no folder can be written to."""
    try:
        return KernelCache(function, signature)
    except (RuntimeError, OSError) as error:
        return NoCache(one_line(error))


class NoCache(NullCache):
    """The cache of a kernel that cannot be kept.

    Parameters
    ----------
    reason : str
        Why not.
    """

    def __init__(self, reason: str) -> None:
        self._reason = reason
        self.before_compiling: Callable[[], None] = lambda: None

    def load_overload(self, sig: Any, target_context: Any) -> None:  # noqa: ARG002
        """Find nothing."""
        _warn_once(self._reason)
        self.before_compiling()


class KernelCache(FunctionCache):
    """The cache of a kernel.

    Parameters
    ----------
    function : callable
    signature : numba signature
    """

    def __init__(self, function: Callable[..., Any], signature: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._signature = signature
        # Other Pythons have other byte code, and files of their own.
        tag = sys.implementation.cache_tag
        self._stem = f"{function.__module__}.{function.__name__}-{tag}"
        self._is_open = False
        self.before_compiling: Callable[[], None] = lambda: None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code, or None if it has to be compiled."""
        self._open()
        try:
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # a file that another program damaged
            found = None
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
        if found is None:
            self.before_compiling()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the machine code, and remove that of older code of the kernel."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            _warn_once(one_line(error))
            return
        current = f"{self._base}."
        for path in Path(self._cache_path).glob(f"{self._stem}-*"):
            if not path.name.startswith(current) and path.suffix in (".nbi", ".nbc"):
                with suppress(OSError):
                    path.unlink()

    def _open(self) -> None:
        # Not when the kernel is made: those that it calls may stand below it in its module.
        if not self._is_open:
            digest = digest_of(self._py_func, self._signature)
            self._base = f"{self._stem}-{digest}"
            self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
                self._cache_path, self._base, digest
            )
            self._is_open = True


def digest_of(function: Callable[..., Any], signature: Any) -> str:
    """Return a digest of all that the machine code of a kernel is made of."""
    checked = getattr(config, "BOUNDSCHECK", None)  # NUMBA_BOUNDSCHECK makes other code
    parts = [str(signature), f"bounds checked: {checked}", *_parts(function, set())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


def _parts(function: Callable[..., Any], seen: set[CodeType]) -> Iterator[str]:
    """Yield the byte code of a function, its constants, and those of all that it names."""
    code = function.__code__
    if code in seen:
        return
    seen.add(code)
    yield from _code(code)
    for name in code.co_names:
        if name not in function.__globals__:
            continue
        value = function.__globals__[name]
        called = getattr(value, "py_func", None)
        if called is not None:
            yield name
            yield from _parts(called, seen)
        elif isinstance(value, ModuleType) or callable(value):
            yield f"{name}: {getattr(value, '__name__', '')} {getattr(value, '__version__', '')}"
        else:
            yield f"{name}: {value!r}"


def _code(code: CodeType) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code(constant)
        else:
            yield repr(constant)


def _warn_once(reason: str) -> None:
    if not _told:
        _told.append(reason)
        folder = os.environ.get("NUMBA_CACHE_DIR")
        way = f"NUMBA_CACHE_DIR is {folder}" if folder else "set NUMBA_CACHE_DIR to one that can"
        warnings.warn(
            f"compiled code cannot be kept ({reason}), so every run compiles it again: no folder "
            f"for it can be written to; {way}",
            GeomeshWarning,
            stacklevel=2,
        )
