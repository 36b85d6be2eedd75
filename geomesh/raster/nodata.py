"""Nodata values: which stored values of a band are the number that a user or a file gives."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from geomesh.errors import BandError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

Number: TypeAlias = "int | float"

# Tools print numbers of this size or more, and their inverses, with few digits, and nothing is
# measured there: they only mark what is missing. So all values that print alike are equal.
_MARKER = 1e30

# Fewest digits by which a marker is recognised: R prints -3.4e+38.
_FEWEST_DIGITS = 2

# Largest relative difference of equal values, in units of the rounding error of their type.
# GDAL uses the same to compare pixels with a nodata value.
_ROUNDINGS = 4


def parse_nodata(value: Any) -> Number:
    """Return a nodata value as an exact int, or as a float.

    Parameters
    ----------
    value : number or str
        A text is what a tool printed. One that is rounded up beyond the largest float64, such
        as ``-1.79769313486232e+308``, is the largest or the lowest float64.

    Raises
    ------
    BandError
        If it is not a number.
    """
    try:
        if isinstance(value, str):
            text = value.strip()
            if text.lstrip("+-").isdecimal():
                return int(text)
            number = float(text)
            if math.isinf(number) and "inf" not in text.lower():
                number = math.copysign(float(np.finfo(np.float64).max), number)
        elif isinstance(value, int | np.integer):
            return int(value)
        else:
            number = float(value)
    except (TypeError, ValueError) as error:
        raise BandError(f"nodata is {value!r}: give a number such as -9999, or nan") from error
    return math.nan if math.isnan(number) else number  # one object, equal to itself in tuples


def stored_range(dtype: np.dtype[Any], value: Number) -> tuple[Any, Any] | None:
    """Return the least and the largest value of a type that equal a nodata value.

    Integers are equal if they are the same. Floats may differ by rounding, because files and
    tools keep and print them with fewer digits.

    Parameters
    ----------
    dtype : numpy.dtype
        Data type of the stored pixels.
    value : int or float

    Returns
    -------
    (scalar, scalar) or None
        Of the data type; None if no pixel of it can have the value, or the value is NaN.
    """
    if dtype.kind != "f":
        whole = isinstance(value, int) or value.is_integer()
        limits = np.iinfo(dtype)
        if not whole or not limits.min <= value <= limits.max:
            return None
        return dtype.type(int(value)), dtype.type(int(value))
    try:
        size = abs(float(value))
    except OverflowError:  # an int beyond the largest float64
        return None
    found = None if math.isnan(size) else _range_of_size(dtype, size)
    if found is None:
        return None
    low, high = found
    return (-high, -low) if value < 0 else (low, high)


def _range_of_size(dtype: np.dtype[Any], size: float) -> tuple[Any, Any] | None:
    """Return the range of a value of 0 or more in a type of floats: see `stored_range`."""
    info = np.finfo(dtype)
    largest = float(info.max)
    if math.isinf(size):
        # Python reads a printed limit of float64 as infinite, if it was rounded up.
        return (info.max, info.max) if dtype.itemsize == np.float64().itemsize else None
    low, high = size, size
    if dtype.itemsize > np.float16().itemsize:
        rounding = _ROUNDINGS * max(float(info.eps), float(np.finfo(np.float64).eps)) * size
        low, high = size - rounding, size + rounding
        if size >= _MARKER or 0 < size <= 1 / _MARKER:
            least, most = _printed_alike(size)
            low, high = min(low, least), max(high, most)
    if low > largest:
        return None
    nearest = dtype.type(min(size, largest))
    if nearest == 0 < size:
        return None
    least, most = dtype.type(low), dtype.type(min(high, largest))
    if float(least) < low:
        least = np.nextafter(least, dtype.type(np.inf))
    if float(most) > high:
        most = np.nextafter(most, dtype.type(0))
    return min(least, nearest), max(most, nearest)


def _printed_alike(size: float) -> tuple[float, float]:
    """Return the limits of the numbers that round to the digits of `size`, which is above 0."""
    exact = Decimal(repr(size)).normalize()
    _, digits, exponent = exact.as_tuple()
    assert isinstance(exponent, int)
    half = Decimal(5).scaleb(exponent - 1 + min(len(digits) - _FEWEST_DIGITS, 0))
    # Below a power of ten, the numbers of as many digits are ten times as dense.
    below = half / 10 if digits == (1,) else half
    return float(exact - below), float(exact + half)


def is_nodata(values: NDArray[Any], value: Number) -> NDArray[np.bool_]:
    """Return where stored values equal a nodata value; nowhere if it is NaN."""
    found = stored_range(values.dtype, value)
    if found is None:
        return np.zeros(values.shape, np.bool_)
    low, high = found
    equal: NDArray[np.bool_] = values == low if low == high else (values >= low) & (values <= high)
    return equal


def stored_value(dtype: np.dtype[Any], value: Number) -> Number | None:
    """Return the value of a type that is nearest to a nodata value and equals it, or None."""
    found = stored_range(dtype, value)
    if found is None:
        return None
    low, high = found
    stored: Number = min(max(dtype.type(low), _nearest(dtype, value)), dtype.type(high)).item()
    return stored


def _nearest(dtype: np.dtype[Any], value: Number) -> Any:
    if dtype.kind != "f":
        return dtype.type(int(value))
    largest = float(np.finfo(dtype).max)
    return dtype.type(min(max(float(value), -largest), largest))


def note_on_nodata(
    name: str, dtypes: Sequence[np.dtype[Any]], value: Number | None
) -> tuple[str, ...]:
    """Return a note if a nodata value was given that no band of a raster can have.

    NaN means that there is no nodata value, and infinite pixels are never valid.
    """
    if value is None or not math.isfinite(value):
        return ()
    if any(stored_range(dtype, value) is not None for dtype in dtypes):
        return ()
    types = " or ".join(sorted({str(dtype) for dtype in dtypes}))
    return (
        f"no pixel of {name} can have the nodata value {value}, because its values are of type "
        f"{types}; so `nodata` hides none",
    )
