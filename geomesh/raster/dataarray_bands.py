"""What a DataArray says about its bands: their labels, and the names in its attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.raster.band_names import BandText
from geomesh.raster.band_texts import known_texts, number_text, time_text

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from xarray import DataArray


def describe_bands(
    source: DataArray, dimension: Any
) -> tuple[tuple[str | None, ...], tuple[BandText, ...]]:
    """Return the description of each band, its label or that in the file, and its BandText.

    rioxarray numbers the bands of a file from 1 and keeps all descriptions. So the number
    of a band gives its description, even after some bands were selected. A band with neither
    is named after the array and its label, such as a wavelength or a time.
    """
    count = 1 if dimension is None else source.sizes[dimension]
    key = "band" if dimension is None else dimension
    labels = np.arange(1, count + 1)
    if key in source.coords:  # coords.get() would number bands without labels from 0
        labels = np.atleast_1d(source.coords[key].values)
    stored = source.attrs.get("long_name", ())
    if labels.dtype.kind in "UO":
        names = tuple(map(str, labels))
    else:
        listed = (stored,) * (count == 1) if isinstance(stored, str) else tuple(stored)
        numbered = labels.dtype.kind in "iu" and labels.min() >= 1 and labels.max() <= len(listed)
        if not numbered:
            return (None,) * count, _label_texts(source, labels)
        names = tuple(listed[label - 1] for label in labels)
    return names, tuple(BandText(known_texts((name,))) for name in names)


def _label_texts(source: DataArray, labels: NDArray[Any]) -> tuple[BandText, ...]:
    stored = (source.attrs.get(key) for key in ("long_name", "standard_name"))
    texts = known_texts([each for each in (*stored, source.name) if isinstance(each, str)])
    details = [
        time_text(label) if labels.dtype.kind == "M" else number_text(str(label))
        for label in labels
    ]
    if not texts:
        return tuple(BandText((f"b{detail}",)) for detail in details)
    if details == ["1"]:
        return (BandText(texts),)
    return tuple(
        BandText(texts, (detail,))
        if len(details) > 1
        else BandText(tuple(f"{text} {detail}" for text in texts))
        for detail in details
    )
