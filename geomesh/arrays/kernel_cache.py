"""Cache the machine code of kernels on disk, until their source code changes.

numba's own cache compares the time of the kernel's file only. It misses a change of a kernel
or a constant in another file. Here the file name contains a digest of the byte code of the
kernel, of all kernels that it calls, and of their constants. So changed code has another file
name, and outdated code is never loaded, even if several processes write at the same time.
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

_warned: list[str] = []


def open_cache(function: Callable[..., Any], signature: Any) -> KernelCache | NoCache:
    """Return the cache of a kernel, or a `NoCache` if no folder is writable."""
    try:
        return KernelCache(function, signature)
    except (RuntimeError, OSError) as error:
        return NoCache(one_line(error))


class NoCache(NullCache):
    """A cache that stores nothing.

    Parameters
    ----------
    reason : str
        Why the code cannot be stored.
    """

    def __init__(self, reason: str) -> None:
        self._reason = reason
        self.before_compiling: Callable[[], None] = lambda: None

    def load_overload(self, sig: Any, target_context: Any) -> None:  # noqa: ARG002
        """Return None: the kernel must be compiled. Warn once."""
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
        # Other versions of Python have different byte code, so they have their own files.
        tag = sys.implementation.cache_tag
        self._stem = f"{function.__module__}.{function.__name__}-{tag}"
        self._is_open = False
        self.before_compiling: Callable[[], None] = lambda: None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code, or None if the kernel must be compiled."""
        self._open()
        try:
            code = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # the file is damaged
            code = None
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
        if code is None:
            self.before_compiling()
        return code

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code, and remove the files of older versions of the kernel."""
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
        # Not in __init__: kernels that this one calls may be defined later in its module.
        if not self._is_open:
            digest = digest_of(self._py_func, self._signature)
            self._base = f"{self._stem}-{digest}"
            self._cache_file = IndexDataCacheFile(  # type: ignore[no-untyped-call]
                self._cache_path, self._base, digest
            )
            self._is_open = True


def digest_of(function: Callable[..., Any], signature: Any) -> str:
    """Return a digest of everything that the machine code of a kernel depends on."""
    checked = getattr(config, "BOUNDSCHECK", None)  # NUMBA_BOUNDSCHECK changes the machine code
    parts = [str(signature), f"bounds checked: {checked}", *_parts(function, set())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


def _parts(function: Callable[..., Any], seen: set[CodeType]) -> Iterator[str]:
    """Yield the byte code and constants of a function and of everything that it uses."""
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
    if not _warned:
        _warned.append(reason)
        folder = os.environ.get("NUMBA_CACHE_DIR")
        hint = (
            f"make NUMBA_CACHE_DIR ({folder}) writable, or set it to another folder"
            if folder
            else "set NUMBA_CACHE_DIR to a writable folder"
        )
        warnings.warn(
            f"compiled code cannot be stored ({reason}), so every run compiles it again; {hint}",
            GeomeshWarning,
            stacklevel=2,
        )
