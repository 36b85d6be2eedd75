"""Parameters of the algorithm Raster to mesh, and the options of geomesh for their values."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingParameterBand,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterVectorDestination,
)

from ..results import LAYERS
from .base import PRESETS, RasterAlgorithm, preset_parameter
from .recipe_parameters import recipe_options, recipe_parameters
from .refinement_parameters import (
    TIPS,
    advanced_parameters,
    breakline_parameters,
    goal_parameters,
    read_wanted,
    refinement_options,
)
from .shapes import shape_options
from .values import is_given

if TYPE_CHECKING:
    from pathlib import Path

DOMAINS = ("valid", "image", "hull")

_TIPS = {
    "BANDS": "Bands to use and to measure. If you choose none: all bands except alpha",
    "MIN_SPACING": (
        "For the preset features: if two features are closer than this, only the stronger one is "
        "kept. If not set: the preset's value"
    ),
    "DOMAIN": "If not set: the preset's choice",
    "EXTENT": "The part of the raster to mesh. If not set: the whole raster",
    "MASK": "Polygons. Pixels outside are ignored",
    "LAYERS": "The GeoPackage always contains all layers",
    "NODATA": "Used instead of the raster's own nodata value",
    "ALPHA_DATA": (
        "For rasters in which a band of data is tagged as alpha. Then neither such a band nor a "
        "mask hides pixels"
    ),
    "UNSCALE": "Measures the values that QGIS shows, instead of the values in the file",
    "MESH": (
        "The same mesh as a native QGIS mesh layer, in a UGRID file. It shows a linear surface "
        "smoothly"
    ),
    **TIPS,
}


def mesh_parameters() -> list[QgsProcessingParameterDefinition]:
    """Return all parameters, in the order of the dialog."""
    real = QgsProcessingParameterNumber.Type.Double
    parameters = [
        QgsProcessingParameterRasterLayer("INPUT", "Raster"),
        preset_parameter(),
        *goal_parameters(),
        QgsProcessingParameterBand("BANDS", "Bands", None, "INPUT", True, True),
        QgsProcessingParameterEnum(
            "DOMAIN",
            "Area to cover",
            ["the valid data", "the whole image", "the convex hull of the keypoints"],
            False,
            None,
            True,
        ),
        QgsProcessingParameterExtent("EXTENT", "Extent", None, True),
        QgsProcessingParameterFeatureSource(
            "MASK", "Mask", [QgsProcessing.SourceType.TypeVectorPolygon], None, True
        ),
        *breakline_parameters(),
        QgsProcessingParameterNumber(
            "MIN_SPACING", "Minimum distance between nodes (pixels)", real, None, True, 0
        ),
        QgsProcessingParameterEnum("LAYERS", "Layers to load", list(LAYERS), True, [0, 2], False),
        *_advanced_reading(),
        *advanced_parameters(),
        *recipe_parameters(),
        QgsProcessingParameterVectorDestination(
            "OUTPUT", "Triangles", QgsProcessing.SourceType.TypeVectorPolygon
        ),
        QgsProcessingParameterFileDestination(
            "MESH", "Mesh layer", "UGRID mesh (*.nc)", None, True, False
        ),
    ]
    for parameter in parameters:
        parameter.setHelp(_TIPS.get(parameter.name(), parameter.help()))
    return parameters


def _advanced_reading() -> list[QgsProcessingParameterDefinition]:
    """Return the advanced parameters that say how to read the raster."""
    real = QgsProcessingParameterNumber.Type.Double
    made = [
        QgsProcessingParameterNumber("NODATA", "Nodata value", real, None, True),
        QgsProcessingParameterBoolean("ALPHA_DATA", "Use alpha bands as data", False),
        QgsProcessingParameterBoolean("UNSCALE", "Apply scale and offset", False),
    ]
    for parameter in made:
        advanced = QgsProcessingParameterDefinition.Flag.FlagAdvanced
        parameter.setFlags(parameter.flags() | advanced)
    return made


def mesh_options(
    algorithm: RasterAlgorithm,
    parameters: dict,
    context: QgsProcessingContext,
    folder: Path,
    feedback: QgsProcessingFeedback,
) -> list[str]:
    """Return the geomesh options. Layers of masks and breaklines are exported to `folder`."""
    options = ["--preset", list(PRESETS)[algorithm.parameterAsEnum(parameters, "PRESET", context)]]
    bands = algorithm.parameterAsInts(parameters, "BANDS", context)
    if bands:
        options += ["--bidx", ",".join(map(str, bands))]
    options += refinement_options(read_wanted(algorithm, parameters, context))
    if is_given(parameters, "MIN_SPACING", context):
        value = algorithm.parameterAsDouble(parameters, "MIN_SPACING", context)
        options += ["--set", f"min_spacing={json.dumps(value)}"]
    if is_given(parameters, "DOMAIN", context):
        options += ["--domain", DOMAINS[algorithm.parameterAsEnum(parameters, "DOMAIN", context)]]
    if is_given(parameters, "NODATA", context):
        options += ["--nodata", repr(algorithm.parameterAsDouble(parameters, "NODATA", context))]
    if algorithm.parameterAsBool(parameters, "ALPHA_DATA", context):
        options += ["--alpha", "data"]
    if algorithm.parameterAsBool(parameters, "UNSCALE", context):
        options += ["--unscale"]
    options += algorithm.extent_options(parameters, context)
    options += shape_options(algorithm, parameters, context, folder, feedback, area="MASK")
    return options + recipe_options(algorithm, parameters, context)
