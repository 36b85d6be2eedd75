"""Convert layers of the project to files that geomesh can read.

A child process cannot access layers. It gets the path of the raster. If the user set a CRS or a
nodata value on the layer, the file does not contain them, so the process gets them as options.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransformContext,
    QgsFeatureSink,
    QgsFields,
    QgsProcessingException,
    QgsProcessingFeatureSource,
    QgsProcessingFeedback,
    QgsProviderRegistry,
    QgsRasterBlockFeedback,
    QgsRasterDataProvider,
    QgsRasterFileWriter,
    QgsRasterLayer,
    QgsRasterPipe,
    QgsRectangle,
    QgsVectorFileWriter,
)

if TYPE_CHECKING:
    from pathlib import Path

_IN_MEMORY = ("/vsimem/", "MEM:")

# What is not part of a file name on every system, and the length that every system takes.
_NO_FILE_NAME = re.compile(r"[^\w \-.]")
_LONGEST_NAME = 60


@dataclass(frozen=True)
class RasterInput:
    """A raster layer, described by values that can be used in another thread.

    Parameters
    ----------
    name : str
        Name of the layer.
    shown : str
        Source of the layer, as shown in its properties.
    source : str
        Path for GDAL; empty if QGIS has to export the pixels.
    open_options : tuple of str
        Open options for GDAL.
    crs : QgsCoordinateReferenceSystem
        CRS of the layer. It can be different from the CRS of the file.
    options : tuple of str
        Options of geomesh for settings that only the layer has.
    notes : tuple of str
        Settings of the layer that geomesh cannot use.
    placed : bool
        Whether it has a georeference. QGIS shows a raster without one below y = 0.
    size : (int, int)
        Columns and rows.
    extent : QgsRectangle
    provider : QgsRasterDataProvider or None
        Copy of the data provider, used for the export.
    """

    name: str
    shown: str
    source: str
    open_options: tuple[str, ...]
    crs: QgsCoordinateReferenceSystem
    options: tuple[str, ...]
    notes: tuple[str, ...]
    placed: bool
    size: tuple[int, int]
    extent: QgsRectangle
    provider: Any = None


def find_raster_fault(layer: QgsRasterLayer | None) -> str:
    """Return why a layer cannot be meshed, or an empty text."""
    if layer is None or not layer.isValid():
        return "The raster cannot be read: choose another one."
    if layer.width() <= 0 or layer.height() <= 0:
        return (
            f"{layer.name()} has no pixels of its own: save it as a file first (Layer > Save As…) "
            "and mesh that file."
        )
    return ""


def describe_raster(layer: QgsRasterLayer) -> RasterInput:
    """Return what geomesh needs to know about a layer. Call it in the thread of the layer."""
    provider = layer.dataProvider()
    source, open_options = _gdal_source(layer)
    nodata = _find_nodata(provider)
    if nodata.added:
        source = ""  # only QGIS knows both nodata values
    options: list[str] = []
    notes = list(nodata.notes)
    if layer.crs().isValid() and (not source or layer.crs() != provider.crs()):
        options += ["--crs", _spell(layer.crs())]
    if provider.crs().isValid() and not layer.crs().isValid():
        notes.append("the layer has no CRS, but the file has one: the mesh has the CRS of the file")
    if nodata.value is not None and not nodata.added:
        options += ["--nodata", repr(nodata.value)]
    size = (layer.width(), layer.height())
    unplaced = QgsRectangle(0, -size[1], size[0], 0)
    return RasterInput(
        name=layer.name(),
        shown=layer.source(),
        source=source,
        open_options=open_options,
        crs=layer.crs(),
        options=tuple(options),
        notes=tuple(notes),
        placed=provider.crs().isValid() or layer.extent() != unplaced,
        size=size,
        extent=layer.extent(),
        provider=None if source else provider.clone(),
    )


def nodata_of(raster: RasterInput) -> float | None:
    """Return the nodata value that only the layer has, if there is one."""
    given = dict(zip(raster.options[::2], raster.options[1::2])).get("--nodata")
    return None if given is None else float(given)


def raster_options(raster: RasterInput, folder: Path, feedback: QgsProcessingFeedback) -> list[str]:
    """Return the options and the argument for a raster. New files are written to `folder`."""
    for note in raster.notes:
        feedback.pushWarning(note)
    path = _raster_path(raster, folder, feedback)
    named = [] if path == raster.source else ["--source-name", raster.shown]
    return [*raster.options, *named, "--", path]


def _raster_path(raster: RasterInput, folder: Path, feedback: QgsProcessingFeedback) -> str:
    if not raster.source:
        return _export(raster, folder / "raster.tif", feedback)
    in_memory = any(mark in raster.source for mark in _IN_MEMORY)
    if raster.placed and not in_memory and not raster.open_options:
        return raster.source
    from osgeo import gdal

    # Another process cannot read a raster in memory, so it is copied to a file. For the other
    # rasters, a VRT refers to the file and keeps its open options. A raster without a georeference
    # gets the position where QGIS shows it, with y upwards.
    columns, rows = raster.size
    path = str(folder / ("raster.tif" if in_memory else "raster.vrt"))
    opened = gdal.OpenEx(raster.source, gdal.OF_RASTER, open_options=list(raster.open_options))
    where = {} if raster.placed else {"outputBounds": [0, 0, columns, -rows]}
    kind = "GTiff" if in_memory else "VRT"
    made = gdal.Translate(path, opened, format=kind, **where) if opened else None
    if made is None:
        raise QgsProcessingException(f"{raster.shown} cannot be read: {gdal.GetLastErrorMsg()}")
    made.FlushCache()
    return path


def export_breaklines(
    source: QgsProcessingFeatureSource, folder: Path, feedback: QgsProcessingFeedback
) -> str:
    """Write the lines of a source to a file with the name of the layer, and return its path.

    The mesh then records which layer its breaklines come from.
    """
    within = folder / "breaklines"
    within.mkdir()
    name = _NO_FILE_NAME.sub("_", source.sourceName())[:_LONGEST_NAME].strip(" .")
    return export_shapes(source, within / f"{name or 'breaklines'}.gpkg", feedback)


def export_shapes(
    source: QgsProcessingFeatureSource, path: Path, feedback: QgsProcessingFeedback
) -> str:
    """Write the geometries of a source to a file, and return its path.

    If the user chose selected features only, only these are written. The file has the CRS of the
    source, or none.
    """
    options = QgsVectorFileWriter.SaveVectorOptions()
    options.driverName = "GPKG"
    writer = QgsVectorFileWriter.create(
        str(path),
        QgsFields(),
        source.wkbType(),
        source.sourceCrs(),
        QgsCoordinateTransformContext(),
        options,
    )
    for feature in source.getFeatures():
        if feedback.isCanceled():
            break
        feature.setAttributes([])
        if not writer.addFeature(feature, QgsFeatureSink.Flag.FastInsert):
            reason = writer.errorMessage()
            raise QgsProcessingException(f"{source.sourceName()} cannot be read: {reason}")
    del writer  # this closes the file
    return str(path)


def _gdal_source(layer: QgsRasterLayer) -> tuple[str, tuple[str, ...]]:
    """Return the path and the open options for GDAL. The path is empty if GDAL cannot open it."""
    if layer.providerType() != "gdal" or "authcfg=" in layer.source():
        return "", ()
    parts = QgsProviderRegistry.instance().decodeUri("gdal", layer.source())
    options = tuple(parts.get("openOptions") or ())
    return layer.source().partition("|option:")[0], options


@dataclass(frozen=True)
class _Nodata:
    """The nodata values that the user set on a layer.

    Attributes
    ----------
    value : float or None
        The value, if it is the same for all bands.
    added : bool
        Whether the file has a different nodata value, which is also valid.
    notes : tuple of str
        Settings that cannot be used.
    """

    value: float | None = None
    added: bool = False
    notes: tuple[str, ...] = ()


def _find_nodata(provider: QgsRasterDataProvider) -> _Nodata:
    bands = range(1, provider.bandCount() + 1)
    own = [band for band in bands if provider.sourceHasNoDataValue(band)]
    notes = []
    if any(not provider.useSourceNoDataValue(band) for band in own):
        notes.append(
            "the raster's own nodata value is switched off in the layer properties, but geomesh "
            "uses it anyway"
        )
    ranges = [provider.userNoDataValues(band) for band in bands]
    if not any(ranges):
        return _Nodata(notes=tuple(notes))
    found = {(one.min(), one.max()) for several in ranges for one in several}
    (low, high) = next(iter(found))
    if len(found) > 1 or low != high or not all(ranges):
        notes.append(
            "the additional nodata values of the layer are not one single value for all bands, so "
            "geomesh does not use them"
        )
        return _Nodata(notes=tuple(notes))
    if own and all(provider.sourceNoDataValue(band) == low for band in own):
        return _Nodata(notes=tuple(notes))
    return _Nodata(low, bool(own), tuple(notes))


def _spell(crs: QgsCoordinateReferenceSystem) -> str:
    if crs.authid().startswith("EPSG:"):
        return crs.authid()
    return crs.toWkt(QgsCoordinateReferenceSystem.WktVariant.WKT_PREFERRED)


def _export(raster: RasterInput, path: Path, feedback: QgsProcessingFeedback) -> str:
    """Write the pixels of a layer that GDAL cannot open, as QGIS reads them."""
    columns, rows = raster.size
    feedback.setProgressText(f"Exporting {raster.name}")
    stopper = QgsRasterBlockFeedback()
    feedback.canceled.connect(stopper.cancel)
    pipe = QgsRasterPipe()
    # Do not clone this clone: a second clone of a virtual raster returns wrong pixels.
    pipe.set(raster.provider)
    failure = QgsRasterFileWriter(str(path)).writeRaster(
        pipe,
        columns,
        rows,
        raster.extent,
        raster.crs,
        QgsCoordinateTransformContext(),
        stopper,
    )
    if feedback.isCanceled():
        raise QgsProcessingException("Cancelled: nothing was written.")
    if failure:
        raise QgsProcessingException(f"{raster.name} could not be exported to {path}")
    return str(path)
