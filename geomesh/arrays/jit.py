"""Compile kernels with numba: one signature each, cached on disk, without the interpreter lock.

A kernel is a small loop over arrays. It has one signature, which says which arrays it reads
and which it writes. So it is compiled only once. Sorting, searching and allocation are done
by numpy, outside of kernels. Inside a kernel numba would compile them too, which takes longer
than to compile the kernel itself.
"""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import numba
import numpy as np
from numba.core import types

from geomesh.arrays.kernel_cache import open_cache

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Function = TypeVar("Function", bound=Callable[..., Any])

boolean, uint8, uint32 = types.boolean, types.uint8, types.uint32
int32, int64, float64, void = types.int32, types.int64, types.float64, types.void

# Division follows IEEE 754, as in numpy. A test for zero would slow down the loops. Kernels do not
# allocate, so they need no code that counts references.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}

# Wrappers that nobody calls would take a fifth of the time of compiling.
_FROM_PYTHON: dict[str, Any] = {"no_cfunc_wrapper": True}
_INSIDE: dict[str, Any] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": True}

# Seconds between two kernels that are compiled ahead. Locks are not fair: without a pause, a thread
# that needs one of them now would wait until all are compiled.
_PAUSE = 0.001

_lock = threading.RLock()
_kernels: list[Kernel] = []


def reads(dtype: Any, dimensions: int) -> types.Array:
    """Return the type of a contiguous array that a kernel reads."""
    return types.Array(dtype, dimensions, "C", readonly=True)


def writes(dtype: Any, dimensions: int) -> types.Array:
    """Return the type of a contiguous array that a kernel writes."""
    return types.Array(dtype, dimensions, "C")


def named(kind: type, *fields: Any) -> Any:
    """Return the type of a NamedTuple whose fields have the given types."""
    typed: Any = types
    if len(set(fields)) == 1:  # numba has a type of its own for these
        return typed.NamedUniTuple(fields[0], len(fields), kind)
    return typed.NamedTuple(fields, kind)


class Kernel:
    """A compiled function with one signature. The first call loads or compiles it.

    Parameters
    ----------
    function : callable
    signature : numba signature
    """

    def __init__(self, function: Callable[..., Any], signature: Any) -> None:
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        self._signature = signature
        self._dispatcher: Any = numba.njit(**_OPTIONS, **_FROM_PYTHON)(function)
        # numba has no public way to set a cache.
        self._dispatcher._cache = self._cache = open_cache(function, signature)  # noqa: SLF001
        self._is_ready = False

    def __call__(self, *arguments: Any) -> Any:
        """Run the compiled code. Raise TypeError if the arguments do not fit the signature."""
        if not self._is_ready:
            self.prepare(lambda: None)
        return self._dispatcher(*arguments)

    def prepare(self, begin: Callable[[], None]) -> None:
        """Load the machine code, or call `begin` and compile it."""
        with _lock:
            if not self._is_ready:
                self._cache.before_compiling = begin
                with _uncollected():
                    self._dispatcher.compile(self._signature)
                self._dispatcher.disable_compile()  # for other signatures
                self._is_ready = True


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the garbage collector from running: it would take a fifteenth of the time to compile."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def kernel(signature: Any) -> Callable[[Function], Function]:
    """Return a decorator that turns a function into a `Kernel`.

    Parameters
    ----------
    signature : numba signature
        For example ``int64(reads(float64, 2), writes(int32, 1))``.
    """

    def decorate(function: Function) -> Function:
        compiled = Kernel(function, signature)
        _kernels.append(compiled)
        return compiled  # type: ignore[return-value]

    return decorate


def inner(function: Function) -> Function:
    """Compile a function that only kernels call. It becomes part of each of them.

    Python must not call it: the function as it was written is its `py_func`.
    """
    compiled: Any = numba.njit(**_OPTIONS, **_INSIDE)(function)
    resolve = compiled.get_call_template
    unliteral: Any = types.unliteral

    def resolve_once(arguments: Any, keywords: Any) -> Any:
        # Else numba would compile the function again for each constant that it is called with.
        plain = {name: unliteral(kind) for name, kind in keywords.items()}
        return resolve(tuple(map(unliteral, arguments)), plain)

    compiled.get_call_template = resolve_once
    inside: Function = compiled
    return inside


def prepare_kernels(begin: Callable[[], None]) -> None:
    """Load or compile all kernels imported so far, so that later steps need not wait.

    Parameters
    ----------
    begin : callable
        Called once, before the first kernel that must be compiled.
    """
    compiling: list[bool] = []

    def first() -> None:
        if not compiling:
            compiling.append(True)
            begin()

    for each in tuple(_kernels):
        each.prepare(first)
        if compiling:
            time.sleep(_PAUSE)


def contiguous(array: ArrayLike, dtype: Any) -> NDArray[Any]:
    """Return a contiguous array of `dtype` for a kernel. Copy it only if necessary."""
    return np.ascontiguousarray(array, dtype=dtype)
