"""The one way in which geomesh compiles: typed, cached, without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile `function` with numba: without the interpreter's lock, kept on disk if possible.

    Division follows IEEE 754 (numpy's way), so that no test for zero slows a loop.
    numba notices a change in the file of a kernel, not in the files of the kernels
    that it calls: after an edit there, clear ``__pycache__``.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        compiled: Function = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package nor the user's cache folder is writable
        compiled = numba.njit(**options)(function)
    return compiled


def plain_bands(bands: NDArray[Any]) -> NDArray[Any]:
    """Return bands of any dtype, contiguous, in a type that kernels can be compiled for."""
    if bands.dtype.kind not in "iuf" or bands.dtype.itemsize > 8 or bands.dtype == np.float16:
        bands = bands.astype(np.float64)
    return np.ascontiguousarray(bands, dtype=bands.dtype.newbyteorder("="))


def load_compiler() -> None:
    """Load what numba needs before any first kernel, which takes about half a second.

    Meant for a thread beside one that reads a file; the first kernel would load it otherwise.
    """
    _no_work()


@kernel
def _no_work() -> None:
    pass
