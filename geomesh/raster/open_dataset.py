"""Open a file, or a dataset that the caller opened, as a Scene."""

from __future__ import annotations

import os
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import SourceError, one_line
from geomesh.raster.alpha import note_on_alpha
from geomesh.raster.bands import class_band, dataset_bands, palette
from geomesh.raster.gdal import GDAL_ERRORS, BorrowedDataset, open_raster, opening_error
from geomesh.raster.georeference import georeference
from geomesh.raster.nodata import note_on_nodata
from geomesh.raster.scaling import PLAIN, SCALED, choose_scalings
from geomesh.raster.scene import Scene
from geomesh.raster.side_files import find_contradiction
from geomesh.raster.tiff import check_blocks

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rasterio

    from geomesh.raster.reading import Reading


def open_file(path: str, name: str | None, reading: Reading) -> Scene:
    """Return the scene of a file; by default, its path is its name."""
    with _described(name or path):
        return _file_scene(path, name or path, reading)


def open_dataset(dataset: Any, name: str | None, reading: Reading) -> Scene:
    """Return the scene of an open rasterio dataset or WarpedVRT."""
    if dataset.closed:
        raise SourceError(f"{dataset.name} is closed; give an open dataset, or its path")
    name = name or dataset.name
    with _described(name):
        on_opening = _note_on_opening(name, dataset)
        scene = _dataset_scene(name, BorrowedDataset(dataset), dataset, reading)
        return replace(scene, notes=(*on_opening, *_note_on_side_file(dataset), *scene.notes))


@contextmanager
def _described(name: str) -> Iterator[None]:
    """Raise SourceError if GDAL opens a dataset but cannot describe it."""
    try:
        yield
    except GDAL_ERRORS as error:
        raise SourceError(
            f"{name} is damaged: its bands or its georeference cannot be read (GDAL: "
            f"{one_line(error)}); download or export it again"
        ) from error


def _file_scene(path: str, name: str, reading: Reading) -> Scene:
    # Absolute, because workers in other processes may have another working folder.
    absolute = os.path.abspath(path) if os.path.exists(path) else path  # noqa: PTH100, PTH110
    with open_raster(path) as dataset:
        on_opening = _note_on_opening(name, dataset)
        contradiction = find_contradiction(dataset)
        if contradiction is None:
            scene = _dataset_scene(name, absolute, dataset, reading)
            return replace(scene, notes=(*on_opening, *scene.notes))
    with open_raster(path, side_files=False) as dataset:
        opening_error(dataset)
        scene = _dataset_scene(name, absolute, dataset, reading)
    note = f"{name}: {contradiction}; the side file is not used"
    return replace(scene, side_files=False, notes=(note, *scene.notes))


def _note_on_opening(name: str, dataset: Any) -> tuple[str, ...]:
    """Return a note if GDAL reported an error and opened the dataset nevertheless."""
    error = opening_error(dataset)
    if error is None:
        return ()
    return (
        f"{name}: GDAL reports an error in this file ({error}); check the georeference and the "
        "values",
    )


def _note_on_side_file(dataset: Any) -> tuple[str, ...]:
    """Return a note if a dataset that the caller opened follows a side file, not the file."""
    with suppress(SourceError):  # its name may be nothing that can be opened
        contradiction = find_contradiction(getattr(dataset, "src_dataset", dataset))
        if contradiction is not None:
            return (f"{dataset.name}: {contradiction}; to use the file itself, give its path",)
    return ()


def _dataset_scene(
    name: str,
    source: str | BorrowedDataset,
    dataset: rasterio.DatasetReader,
    reading: Reading,
) -> Scene:
    if dataset.count == 0:
        raise SourceError(
            f"{name} contains no bands of its own; name one of its subdatasets: "
            f"{', '.join(dataset.subdatasets[:3]) or 'none found'}"
        )
    if dataset.driver == "GTiff":
        check_blocks(name, dataset)
    bands, dtype = dataset_bands(name, dataset, reading.bidx, reading.alpha)
    indexes = [band.index for band in bands]
    # The values of a palette are classes, which cannot be scaled.
    own = [PLAIN] * dataset.count
    if palette(dataset) is None:
        own = list(zip(dataset.scales, dataset.offsets, strict=True))
    scalings, on_scale = choose_scalings(name, own, indexes, unscale=reading.unscale)
    types = [np.dtype(dataset.dtypes[index - 1]) for index in indexes]
    on_nodata = note_on_nodata(name, types, reading.nodata)
    on_alpha = note_on_alpha(name, dataset, reading.alpha)
    grid, notes = georeference(name, dataset, reading.crs)
    return Scene(
        name,
        grid,
        grid.extent,
        bands,
        SCALED if scalings else dtype,
        source,
        (dataset.width, dataset.height),
        class_band=class_band(dataset),
        nodata=reading.nodata,
        alpha=reading.alpha,
        unscale=reading.unscale,
        scalings=scalings,
        notes=(*notes, *on_nodata, *on_alpha, *on_scale),
    )
