"""Scale and offset of bands: what was measured is scale * stored value + offset."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import BandError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

# Scale and offset of a band.
Scaling = tuple[float, float]

PLAIN: Scaling = (1.0, 0.0)

# Bands whose scale and offset a message names.
_MOST_TOLD = 3

# The type of scaled values. Narrower ones could not tell neighbouring stored values apart.
SCALED = np.dtype(np.float64)


def choose_scalings(
    name: str, scalings: Sequence[Scaling], indexes: Sequence[int], *, unscale: bool
) -> tuple[tuple[Scaling, ...], tuple[str, ...]]:
    """Return the scale and offset to apply to each chosen band, and notes for the user.

    Parameters
    ----------
    name : str
        Name of the raster in messages.
    scalings : sequence of (float, float)
        Scale and offset of every band of the raster.
    indexes : sequence of int
        The chosen bands; the first is 1.
    unscale : bool
        Whether to apply them.

    Returns
    -------
    scalings : tuple of (float, float)
        One for each chosen band; empty if the stored values are used.
    notes : tuple of str

    Raises
    ------
    BandError
        If a scale or an offset cannot be applied.
    """
    chosen = [scalings[index - 1] for index in indexes]
    scaled = [index for index, pair in zip(indexes, chosen, strict=True) if pair != PLAIN]
    if not scaled:
        return (), ()
    told = ", ".join(_describe(scalings, index) for index in scaled[:_MOST_TOLD])
    more = ", ..." if len(scaled) > _MOST_TOLD else ""
    about = f"{name} has a scale or an offset ({told}{more})"
    is_usable = all(_is_usable(scalings[index - 1]) for index in scaled)
    if not unscale:
        way = "; `unscale=True` applies them" if is_usable else ""
        return (), (f"{about}, but the stored values are used{way}",)
    if not is_usable:
        raise BandError(f"{about} that cannot be applied: leave `unscale=True` out")
    return tuple(chosen), ()


def _is_usable(scaling: Scaling) -> bool:
    scale, offset = scaling
    return scale != 0 and math.isfinite(scale) and math.isfinite(offset)


def _describe(scalings: Sequence[Scaling], index: int) -> str:
    scale, offset = scalings[index - 1]
    return f"{scale:.10g} and {offset:.10g} in band {index}"


def apply_scalings(
    stored: NDArray[Any] | Sequence[NDArray[Any]], scalings: Sequence[Scaling]
) -> NDArray[np.float64]:
    """Return bands (B, h, w) of scaled values; those beyond the largest float64 are infinite."""
    bands = np.empty((len(stored), *stored[0].shape), SCALED)
    with np.errstate(over="ignore", invalid="ignore"):
        for k, (scale, offset) in enumerate(scalings):
            np.multiply(stored[k], scale, out=bands[k], dtype=SCALED)
            bands[k] += offset
    return bands
