"""Layers of the project as files that geomesh can read.

A child process sees no layers. It gets the path of the raster, and as options what
the user has set on the layer and the file does not know: its CRS and nodata value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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


@dataclass(frozen=True)
class RasterInput:
    """A raster layer, told in values that may go to another thread.

    Parameters
    ----------
    name : str
        Of the layer.
    source : str
        What GDAL opens; empty if the layer has to be exported.
    crs : QgsCoordinateReferenceSystem
        Of the layer, which may not be the file's.
    options : tuple of str
        Options of geomesh for what only the layer knows.
    placed : bool
        Whether it has a georeference; QGIS shows a raster without one below y = 0.
    size : (int, int)
        Columns and rows.
    extent : QgsRectangle
    provider : QgsRasterDataProvider or None
        A copy to export from.
    """

    name: str
    source: str
    crs: QgsCoordinateReferenceSystem
    options: tuple[str, ...]
    placed: bool
    size: tuple[int, int]
    extent: QgsRectangle
    provider: Any = None


def describe_raster(layer: QgsRasterLayer) -> RasterInput:
    """Return what geomesh needs to know of a layer; to be called in the layer's own thread."""
    provider = layer.dataProvider()
    source = _gdal_source(layer)
    size = (layer.width(), layer.height())
    options: list[str] = []
    if layer.crs().isValid() and (not source or layer.crs() != provider.crs()):
        options += ["--crs", _spell(layer.crs())]
    nodata = _user_nodata(provider)
    if nodata is not None:
        options += ["--nodata", repr(nodata)]
    unplaced = QgsRectangle(0, -size[1], size[0], 0)
    return RasterInput(
        name=layer.name(),
        source=source,
        crs=layer.crs(),
        options=tuple(options),
        placed=provider.crs().isValid() or layer.extent() != unplaced,
        size=size,
        extent=layer.extent(),
        provider=None if source else provider.clone(),
    )


def raster_path(raster: RasterInput, folder: Path, feedback: QgsProcessingFeedback) -> str:
    """Return the path of the raster's pixels, in `folder` if they had to be exported."""
    if not raster.source:
        return _export(raster, folder / "raster.tif", feedback)
    if raster.placed:
        return raster.source
    # Seen by geomesh where QGIS shows it: with y running up, from minus its height.
    from osgeo import gdal

    columns, rows = raster.size
    path = str(folder / "raster.vrt")
    made = gdal.Translate(path, raster.source, format="VRT", outputBounds=[0, 0, columns, -rows])
    if made is None:
        raise QgsProcessingException(f"{raster.source} cannot be read: {gdal.GetLastErrorMsg()}")
    made.FlushCache()
    return path


def export_mask(
    source: QgsProcessingFeatureSource, folder: Path, feedback: QgsProcessingFeedback
) -> str:
    """Write the polygons of a source, of its selection if that was asked for, to a file."""
    path = str(folder / "mask.gpkg")
    options = QgsVectorFileWriter.SaveVectorOptions()
    options.driverName = "GPKG"
    writer = QgsVectorFileWriter.create(
        path,
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
            raise QgsProcessingException(f"the mask cannot be read: {writer.errorMessage()}")
    del writer  # closes the file
    return path


def bounds_options(extent: QgsRectangle) -> Sequence[str]:
    """Return the option that crops to an extent in the raster's CRS."""
    corners = (extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum())
    return ["--bounds", *map(repr, corners)]


def _gdal_source(layer: QgsRasterLayer) -> str:
    """Return what GDAL opens, without what QGIS adds to it; empty if it is not GDAL's."""
    if layer.providerType() != "gdal":
        return ""
    parts = QgsProviderRegistry.instance().decodeUri("gdal", layer.source())
    if parts.get("openOptions"):
        return ""  # opened otherwise, it may hold other pixels
    if "/vsimem/" in layer.source():
        return ""  # the memory of this process, where no other can look
    return layer.source().partition("|")[0]


def _user_nodata(provider: QgsRasterDataProvider) -> float | None:
    """Return the value that the user declared nodata, if it is one value for all bands."""
    values = set()
    for band in range(1, provider.bandCount() + 1):
        ranges = provider.userNoDataValues(band)
        if len(ranges) != 1 or ranges[0].min() != ranges[0].max():
            return None
        values.add(ranges[0].min())
    return values.pop() if len(values) == 1 else None


def _spell(crs: QgsCoordinateReferenceSystem) -> str:
    if crs.authid().startswith("EPSG:"):
        return crs.authid()
    return crs.toWkt(QgsCoordinateReferenceSystem.WktVariant.WKT_PREFERRED)


def _export(raster: RasterInput, path: Path, feedback: QgsProcessingFeedback) -> str:
    """Write the pixels of a layer that GDAL does not open."""
    columns, rows = raster.size
    if columns <= 0 or rows <= 0:
        raise QgsProcessingException(
            f"{raster.name} has no pixels of its own: export it first "
            "(Layer > Save As…), and mesh the file."
        )
    feedback.setProgressText(f"Exporting {raster.name}")
    stopper = QgsRasterBlockFeedback()
    feedback.canceled.connect(stopper.cancel)
    pipe = QgsRasterPipe()
    # Not a copy of the copy: that of a virtual raster reads garbage.
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
