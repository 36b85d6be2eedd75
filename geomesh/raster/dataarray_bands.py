"""What a DataArray says about its bands: labels, names, and scale and offset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import SourceError, one_line
from geomesh.raster.band_names import BandText
from geomesh.raster.band_texts import known_texts, number_text, time_text
from geomesh.raster.scaling import PLAIN, Scaling

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
    labels = _labels(source, dimension)
    stored = source.attrs.get("long_name", ())
    if labels.dtype.kind in "UO":
        names = tuple(map(str, labels))
    else:
        listed = (stored,) * (len(labels) == 1) if isinstance(stored, str) else tuple(stored)
        numbered = labels.dtype.kind in "iu" and labels.min() >= 1 and labels.max() <= len(listed)
        if not numbered:
            return (None,) * len(labels), _label_texts(source, labels)
        names = tuple(listed[label - 1] for label in labels)
    return names, tuple(BandText(known_texts((name,))) for name in names)


def _labels(source: DataArray, dimension: Any) -> NDArray[Any]:
    """Return the coordinates of the bands; by default 1, 2, ..."""
    key = "band" if dimension is None else dimension
    if key in source.coords:  # coords.get() would number bands without labels from 0
        return np.atleast_1d(source.coords[key].values)
    return np.arange(1, 2 if dimension is None else source.sizes[dimension] + 1)


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


def read_scalings(name: str, source: DataArray, dimension: Any) -> tuple[Scaling, ...]:
    """Return the scale and offset of each band.

    They are attributes of stored values. Of scaled values, xarray and rioxarray keep them
    elsewhere, as an encoding.
    """
    labels, columns = _labels(source, dimension), []
    for single, several, plain in zip(
        ("scale_factor", "add_offset"), ("scales", "offsets"), PLAIN, strict=True
    ):
        try:
            given = np.asarray(source.attrs.get(several, ()), np.float64).ravel()
            if single in source.attrs:
                given = np.full(len(labels), float(source.attrs[single]))
            elif given.size and labels.dtype.kind in "iu" and labels.min() >= 1:
                given = given[labels - 1]
        except (TypeError, ValueError, IndexError) as error:
            raise SourceError(
                f"{name} has an invalid scale or offset ({one_line(error)}); correct or remove "
                f"its attributes {single} and {several}"
            ) from error
        columns.append(given.tolist() if len(given) == len(labels) else [plain] * len(labels))
    return tuple(zip(*columns, strict=True))
