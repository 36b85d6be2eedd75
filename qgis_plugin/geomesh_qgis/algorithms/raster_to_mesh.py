"""The algorithm Raster to mesh, the main one."""

from __future__ import annotations

import tempfile
from pathlib import Path

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingFeedback,
    QgsProcessingOutputNumber,
    QgsProcessingOutputVectorLayer,
)

from ..files import is_geopackage, is_same_file, layer_files
from ..inputs import find_raster_fault, raster_options
from ..provenance import read_document
from ..results import (
    LAYERS,
    dress_mesh_layer,
    dress_vector_layer,
    layer_uri,
    load_when_done,
    open_triangles,
)
from ..surface import find_channels
from .base import PRESETS, RasterAlgorithm, tell_certificate
from .mesh_parameters import DOMAINS, mesh_options, mesh_parameters
from .recipe_parameters import find_recipe_fault
from .refinement_faults import Around, find_refinement_fault
from .refinement_parameters import read_wanted
from .shapes import find_breaklines_fault
from .values import find_number_fault, is_given


class RasterToMesh(RasterAlgorithm):
    """Converts a raster layer to a mesh: vector layers and, optionally, a mesh layer."""

    NAME = "rastertomesh"
    TITLE = "Raster to mesh"
    GROUP = "Create"
    TAGS = ("triangles", "triangulation", "Delaunay", "TIN", "vectorize", "SIFT", "Canny", "image")
    SUMMARY = (
        "Turns a raster into a triangle mesh. The nodes are those that show the raster best, or "
        "features of the image."
    )
    HELP = """
<p>You can press <b>Run</b> without changing anything. The mesh then covers all valid pixels, and
has 1 % as many nodes, at least twice those of its outline. The layer <i>triangles</i> shows the
mean colour of the image and has exact statistics of every band. A GeoPackage also contains the
nodes, the edges and all parameters, so that the mesh can be made again. Each mesh is checked before
it is written.</p>
<p><b>Preset</b>: <i>adaptive</i> moves, adds and removes nodes until the mesh shows the raster
as well as it can. <i>features</i> connects SIFT keypoints on Canny edges by a Delaunay
triangulation. <i>paper</i> follows the published system exactly, at 256 × 256 pixels.<br/>
<b>Goal</b> (adaptive): a <i>number of nodes</i>; or an error, which is reached with as few nodes as
possible. <i>Largest error</i>: no valid pixel is farther from the mesh. <i>Root mean square
error</i>: on average. Set it in <b>error to reach</b>, in the raster's units.<br/>
<b>Node budget</b>: adaptive has exactly so many nodes, or at most so many if its goal is an error.
The other presets keep the strongest features, spread evenly.<br/>
<b>Surface</b> (adaptive): <i>linear</i> has values at the nodes; the mesh layer shows it smoothly.
<i>constant</i> has one value for each triangle, as the layer <i>triangles</i> shows it.<br/>
<b>Mask</b>: polygons. Pixels outside are ignored.<br/>
<b>Breaklines</b>: lines or polygons that become edges of the mesh.<br/>
<b>Mesh layer</b>: also writes the mesh as a native QGIS mesh layer (UGRID).</p>
<p>Parameters that are not set have the value of the preset. Lengths are in pixels.</p>
"""

    def initAlgorithm(self, config: dict | None = None) -> None:
        """Define the parameters and the outputs."""
        for parameter in mesh_parameters():
            self.addParameter(parameter)
        points = QgsProcessing.SourceType.TypeVectorPoint
        lines = QgsProcessing.SourceType.TypeVectorLine
        for output in (
            QgsProcessingOutputVectorLayer("NODES_LAYER", "Nodes", points),
            QgsProcessingOutputVectorLayer("EDGES_LAYER", "Edges", lines),
            QgsProcessingOutputNumber("NODE_COUNT", "Number of nodes"),
            QgsProcessingOutputNumber("TRIANGLE_COUNT", "Number of triangles"),
        ):
            self.addOutput(output)

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        raster = self.parameterAsRasterLayer(parameters, "INPUT", context)
        read = [
            *layer_files(raster),
            *layer_files(self.parameterAsVectorLayer(parameters, "MASK", context)),
            *layer_files(self.parameterAsVectorLayer(parameters, "BREAKLINES", context)),
            self.parameterAsFile(parameters, "RECIPE", context),
        ]
        return (
            find_raster_fault(raster)
            or self.find_mesh_output_fault(parameters, context, read)
            or self._find_mesh_layer_fault(parameters, context, read)
            or find_number_fault(self, parameters)
            or find_recipe_fault(self, parameters, context)
            or find_breaklines_fault(self, parameters, context)
            or find_refinement_fault(
                read_wanted(self, parameters, context), self._around(parameters, context)
            )
        )

    def _around(self, parameters: dict, context: QgsProcessingContext) -> Around:
        """Return the values that those of the preset adaptive have to fit."""
        preset = list(PRESETS)[self.parameterAsEnum(parameters, "PRESET", context)]
        has_area = is_given(parameters, "DOMAIN", context)
        area = self.parameterAsEnum(parameters, "DOMAIN", context)
        return Around(
            preset="" if is_given(parameters, "RECIPE", context) else preset,
            bands=len(self.parameterAsInts(parameters, "BANDS", context)),
            is_resized=is_given(parameters, "RESIZE", context),
            is_hull=has_area and DOMAINS[area] == "hull",
            has_breaklines=is_given(parameters, "BREAKLINES", context),
        )

    def _find_mesh_layer_fault(
        self, parameters: dict, context: QgsProcessingContext, read: list[str]
    ) -> str:
        fault = self.find_mesh_layer_fault("MESH", parameters, context, read)
        mesh = self.parameterAsFileOutput(parameters, "MESH", QgsProcessingContext())
        if fault or not mesh:
            return fault
        output = self.parameterAsOutputLayer(parameters, "OUTPUT", QgsProcessingContext())
        if not is_geopackage(output) and is_same_file(str(Path(output).with_suffix("")), mesh[:-3]):
            # QGIS saves the styles of both files under this name.
            return (
                f"{output} and {mesh} would share one style file: choose another name for one "
                "of them."
            )
        return ""

    def processAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> dict:
        """Mesh the raster, style the layers and let QGIS load them."""
        output = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        mesh_layer = self.parameterAsFileOutput(parameters, "MESH", context)
        chosen = [LAYERS[i] for i in self.parameterAsEnums(parameters, "LAYERS", context)]
        whole = is_geopackage(output)
        if not whole:
            chosen = ["triangles"]
        uris = {layer: layer_uri(output, layer) for layer in (LAYERS if whole else chosen)}
        with tempfile.TemporaryDirectory(prefix="geomesh-") as name:
            folder = Path(name)
            stored = output if whole else str(folder / "mesh.gpkg")
            options = mesh_options(self, parameters, context, folder, feedback)
            source = raster_options(self.raster, folder, feedback)
            share = 1 - 0.1 * (not whole) - 0.1 * bool(mesh_layer)
            figures = self.run_geomesh(["mesh", *options, *source], feedback, stored, (0, share))
            if not whole:
                self.run_geomesh(["convert", "--", stored], feedback, output, (share, share + 0.1))
            for layer, uri in uris.items():
                dress_vector_layer(uri, layer)
            about = read_document(stored)
            channels = ()
            if mesh_layer:
                self.run_geomesh(["convert", "--", stored], feedback, mesh_layer, (0.9, 1))
                channels = find_channels(open_triangles(stored), about)
                dress_mesh_layer(mesh_layer, channels)
        loaded = {layer: uris[layer] for layer in chosen}
        if mesh_layer:
            loaded = {"mesh": mesh_layer, **loaded}
        load_when_done(
            context,
            output,
            loaded,
            title=self.raster.name,
            unnamed=self.parameterDefinition("OUTPUT").description(),
            about=about,
            channels=channels,
        )
        tell_certificate(figures, about, feedback)
        results = {
            "OUTPUT": uris["triangles"],
            "NODE_COUNT": figures["nodes"],
            "TRIANGLE_COUNT": figures["triangles"],
        }
        if whole:
            results |= {"NODES_LAYER": uris["nodes"], "EDGES_LAYER": uris["edges"]}
        if mesh_layer:
            results["MESH"] = mesh_layer
        return results
