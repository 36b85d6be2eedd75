"""Parameters of the algorithm DEM to TIN, and values of them that cannot work."""

from __future__ import annotations

import math

from qgis.core import (
    QgsProcessing,
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingParameterBand,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterVectorDestination,
    QgsRaster,
    QgsRasterLayer,
)

from .refinement_parameters import LABELS, LARGEST_FLOOR, breaklines_layer
from .values import is_given

_TIPS = {
    "BAND": "The band that has the heights. If not set: the first",
    "TOLERANCE": (
        "No valid pixel of the DEM is farther from the TIN than this. In the DEM's unit, before "
        "the Z factor. If not set: a hundredth of the range of heights, which the log tells"
    ),
    "NODES": (
        "If so many nodes are not enough for the tolerance, you get the best TIN of so many, and "
        "the log tells its largest error. If not set: as many as the tolerance needs"
    ),
    "BREAKLINES": (
        "Lines or polygons, such as streams, ridges and roads, that become edges of the TIN. They "
        "get their heights from the DEM"
    ),
    "BOUNDARY": "Polygons. The TIN covers the pixels of the DEM inside. If not set: all of it",
    "MIN_ANGLE": "No triangle has a smaller angle. 0 to 25",
    "Z_FACTOR": (
        "Heights of the TIN are those of the DEM times this factor, such as 0.3048 for a DEM in "
        "feet and a TIN in metres"
    ),
    "OUTPUT": "A native mesh layer of QGIS, in a UGRID file (.nc)",
    "VECTORS": (
        "A GeoPackage with the whole TIN. Export TIN, Contours of a TIN and Volume of a TIN read it"
    ),
}


def tin_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return all parameters, in the order of the dialog."""
    number = QgsProcessingParameterNumber
    kinds = QgsProcessing.SourceType
    whole, real = number.Type.Integer, number.Type.Double
    factor = number("Z_FACTOR", "Z factor", real, 1)
    factor.setFlags(factor.flags() | QgsProcessingParameterDefinition.Flag.FlagAdvanced)
    tolerance = number("TOLERANCE", "Tolerance (largest height error)", real, None, True)
    # A text, so that the module is only loaded for a dialog.
    module = f"{__package__}.tolerance_widget.ToleranceWidget"
    tolerance.setMetadata({"widget_wrapper": {"class": module}})
    parameters = [
        QgsProcessingParameterRasterLayer("INPUT", "DEM"),
        # Optional, because a script would have to give it: a band has no default value there.
        QgsProcessingParameterBand("BAND", "Band of heights", 1, "INPUT", True),
        tolerance,
        number("NODES", "Most nodes", whole, None, True, 1),
        breaklines_layer(),
        QgsProcessingParameterFeatureSource(
            "BOUNDARY", "Boundary", [kinds.TypeVectorPolygon], None, True
        ),
        number("MIN_ANGLE", LABELS["MIN_ANGLE"], real, 10, False, 0, LARGEST_FLOOR),
        factor,
        QgsProcessingParameterFileDestination("OUTPUT", "TIN", "UGRID mesh (*.nc)"),
        QgsProcessingParameterVectorDestination(
            "VECTORS", "Triangles and nodes", kinds.TypeVectorPolygon, None, True, True
        ),
    ]
    for parameter in parameters:
        parameter.setHelp(_TIPS.get(parameter.name(), parameter.help()))
    return parameters


def find_tin_fault(
    algorithm: QgsProcessingAlgorithm, parameters: dict, context: QgsProcessingContext
) -> str:
    """Return which value cannot work, and why, or an empty text."""
    number = algorithm.parameterAsDouble
    if is_given(parameters, "TOLERANCE", context):
        tolerance = number(parameters, "TOLERANCE", context)
        if not 0 < tolerance < math.inf:
            return f"Tolerance is {tolerance:g}: give a height above 0, or none."
    factor = number(parameters, "Z_FACTOR", context)
    if not math.isfinite(factor) or factor == 0:
        return f"Z factor is {factor:g}: give a number that is not 0."
    layer = algorithm.parameterAsRasterLayer(parameters, "INPUT", context)
    return _find_band_fault(layer, algorithm.parameterAsInt(parameters, "BAND", context))


def _find_band_fault(layer: QgsRasterLayer, band: int) -> str:
    if not 1 <= band <= layer.bandCount():
        return f"{layer.name()} has no band {band}: choose one of {layer.bandCount()}."
    palette = QgsRaster.ColorInterpretation.PaletteIndex
    if layer.dataProvider().colorInterpretation(band) == palette:
        return f"Band {band} of {layer.name()} has classes, which are no heights: choose another."
    return ""
