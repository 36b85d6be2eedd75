"""Base classes of the algorithms: they run a geomesh command and report its progress."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from qgis.core import (
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProcessingParameterEnum,
)
from qgis.PyQt.QtGui import QIcon

from .. import settings
from ..engine import DEFAULT_PRESET, OPTIONS, environment, runner
from ..files import find_format_fault, find_output_fault
from ..inputs import RasterInput, describe_raster

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

# Models and scripts know a preset by its place here, so new ones are put at the end.
PRESETS = {
    "features": "features: the nodes are features of the image",
    "paper": "paper: the published system, at 256 × 256 pixels",
    "adaptive": "adaptive: the nodes that show the raster best",
}

_FOLDER = Path(__file__).parents[1]

# The names of geomesh's options, and the names in the dialog.
_WORDS = {
    "--set edge_distance=null or --set min_spacing=1": "a minimum distance between nodes of 1",
    "--set sobel=true": "Sobel (advanced)",
    "--bounds": "the extent",
    "--mask": "the mask",
    "override the nodata value with --nodata": "set another nodata value",
    "--nodata": "the nodata value",
    "use --alpha data": 'switch on "Use alpha bands as data" (advanced)',
    "use it as data with --alpha data": 'switch on "Use alpha bands as data" (advanced)',
    "--unscale applies them": 'switch on "Apply scale and offset" (advanced) to apply them',
    "leave --unscale out": 'switch off "Apply scale and offset" (advanced)',
    "--bidx": "the bands",
    "--gray": "Gray image",
    "give another with --crs": "set another one on the layer",
    "--breaklines": "Breaklines",
    "--keep-features": "Keep feature nodes (advanced)",
    "--max-error": "the largest error",
    "--min-angle": "the smallest angle",
    "--nodes": "the node budget",
    "--rmse": "the root mean square error",
    "--time-limit": "the time limit",
}


def preset_parameter() -> QgsProcessingParameterEnum:
    """Return the parameter PRESET."""
    default = list(PRESETS).index(DEFAULT_PRESET)
    return QgsProcessingParameterEnum("PRESET", "Preset", list(PRESETS.values()), False, default)


def in_the_dialogs_words(text: str, own: Mapping[str, str] | None = None) -> str:
    """Return a message of geomesh with its options replaced by the names in the dialog.

    Parameters
    ----------
    text : str
    own : mapping of str to str, optional
        Options that one dialog calls by another name than the others do.
    """
    for option, words in {**_WORDS, **(own or {})}.items():
        text = text.replace(option, words)
    return text


def tell_certificate(figures: dict, about: dict, feedback: QgsProcessingFeedback) -> None:
    """Write the size of a mesh and the facts of its certificate to the log."""
    feedback.pushInfo(f"{figures['nodes']:,} nodes, {figures['triangles']:,} triangles, certified")
    for fact in about.get("certificate", {}).get("facts", []):
        feedback.pushInfo(f"{fact['name']}: {fact['detail']}")


class GeomeshAlgorithm(QgsProcessingAlgorithm):
    """An algorithm that runs in the environment of geomesh, never in the Python of QGIS."""

    NAME = ""
    TITLE = ""
    GROUP = ""
    TAGS: Sequence[str] = ()
    SUMMARY = ""
    HELP = ""
    WORDS: ClassVar[Mapping[str, str]] = {}  # what only this dialog calls an option of geomesh

    def createInstance(self) -> GeomeshAlgorithm:
        """Return a new instance. Each run has its own."""
        return type(self)()

    def name(self) -> str:
        """Return the name of the algorithm, used by programs."""
        return self.NAME

    def displayName(self) -> str:
        """Return the name of the algorithm, shown to the user."""
        return self.TITLE

    def group(self) -> str:
        """Return the name of the group in the toolbox."""
        return self.GROUP

    def groupId(self) -> str:
        """Return the identifier of the group, used by programs."""
        return self.GROUP.lower()

    def tags(self) -> list[str]:
        """Return keywords for the search in the toolbox."""
        return list(self.TAGS)

    def icon(self) -> QIcon:
        """Return the icon."""
        return QIcon(str(_FOLDER / "icon.svg"))

    def svgIconPath(self) -> str:
        """Return the path of the icon as a vector file."""
        return str(_FOLDER / "icon.svg")

    def shortDescription(self) -> str:
        """Return a description of one sentence."""
        return self.SUMMARY

    def shortHelpString(self) -> str:
        """Return the help text, with a picture. It is shown beside the parameters."""
        picture = (_FOLDER / "images" / f"{self.NAME}.png").as_uri()
        help_text = " ".join(self.HELP.split())  # Processing keeps the line breaks of the source
        return f'<p>{self.SUMMARY}</p><p><img src="{picture}"/></p>{help_text}'

    def checkParameterValues(self, parameters: dict, context: QgsProcessingContext) -> tuple:
        """Check that geomesh is available and that the values are valid."""
        passed, reason = super().checkParameterValues(parameters, context)
        if not passed:
            return False, reason
        try:
            settings.installation()
        except environment.EnvironmentProblem as problem:
            return False, str(problem)
        reason = self.find_fault(parameters, context)
        return not reason, reason

    def find_fault(self, parameters: dict, context: QgsProcessingContext) -> str:
        """Return why the values are not valid, or an empty text."""
        return ""

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Check the values: for batches and steps of models nothing checked them before."""
        reason = self.find_fault(parameters, context)
        if reason:
            raise QgsProcessingException(reason)
        return True

    def find_mesh_output_fault(
        self, parameters: dict, context: QgsProcessingContext, read: Sequence[str]
    ) -> str:
        """Return why the mesh cannot be written to OUTPUT, or an empty text."""
        # This uses a new context. In the context of the run it would add a layer to load.
        path = self.parameterAsOutputLayer(parameters, "OUTPUT", QgsProcessingContext())
        return find_format_fault(path) or find_output_fault(path, context.project(), read)

    def find_mesh_layer_fault(
        self, name: str, parameters: dict, context: QgsProcessingContext, read: Sequence[str]
    ) -> str:
        """Return why the mesh layer of a parameter cannot be written, or an empty text."""
        path = self.parameterAsFileOutput(parameters, name, QgsProcessingContext())
        if path and not path.lower().endswith(".nc"):
            return f"{path} does not end in .nc: a mesh layer is a UGRID file (.nc)."
        return self.find_file_output_fault(name, parameters, context, read)

    def find_file_output_fault(
        self, name: str, parameters: dict, context: QgsProcessingContext, read: Sequence[str]
    ) -> str:
        """Return why the output file of a parameter cannot be written, or an empty text."""
        path = self.parameterAsFileOutput(parameters, name, QgsProcessingContext())
        return find_output_fault(path, context.project(), read) if path else ""

    def run_geomesh(
        self,
        arguments: Sequence[str],
        feedback: QgsProcessingFeedback,
        output: str | None,
        span: tuple[float, float] = (0, 1),
    ) -> dict:
        """Run a command and return its figures.

        Parameters
        ----------
        arguments : sequence of str
            Name of the command, its options and its input.
        feedback : QgsProcessingFeedback
            Receives progress and warnings. It also tells whether the user cancelled.
        output : str or None
            File that the command writes. It replaces an older file. None: it writes none.
        span : (float, float)
            Part of the whole run that this command takes, from 0 to 1.

        Raises
        ------
        QgsProcessingException
            If the command fails or is cancelled. `output` is then unchanged.
        """
        start, end = span
        said = ""

        def progress(fraction: float, message: str) -> None:
            nonlocal said
            feedback.setProgress(100 * (start + fraction * (end - start)))
            if message != said:
                said = message
                feedback.setProgressText(message)

        name, *rest = arguments
        target = ["-o", output, "--overwrite"] if output else []
        spell = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
        try:
            program = settings.installation().command
            feedback.pushCommandInfo(spell([*program, name, *target, *rest]))
            command = [*program, name, "--progress", "jsonl", "--until-eof", *target, *rest]
            outcome = runner.run(
                command,
                progress=progress,
                warn=lambda text: feedback.pushWarning(in_the_dialogs_words(text, self.WORDS)),
                cancelled=feedback.isCanceled,
                places=[Path(output).parent] if output else [],
            )
        except environment.EnvironmentProblem as problem:
            raise QgsProcessingException(str(problem)) from problem
        except runner.RunError as error:
            text = in_the_dialogs_words(str(error), self.WORDS)
            if error.code == "missing-extra":
                text += f", or press Reinstall in {OPTIONS}"
            raise QgsProcessingException(text) from error
        except runner.Cancelled as stop:
            left = f"{output} was not written." if output else "there is no result."
            raise QgsProcessingException(f"Cancelled: {left}") from stop
        return outcome.figures


class RasterAlgorithm(GeomeshAlgorithm):
    """An algorithm that reads the raster layer INPUT, cropped to EXTENT."""

    raster: RasterInput

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Read the properties of the layer here, because the algorithm runs in another thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        self.raster = describe_raster(self.parameterAsRasterLayer(parameters, "INPUT", context))
        return True

    def extent_options(self, parameters: dict, context: QgsProcessingContext) -> list[str]:
        """Return the geomesh option for EXTENT, in the CRS of the raster."""
        box = self.parameterAsExtent(parameters, "EXTENT", context, self.raster.crs)
        if box.isNull():
            return []
        corners = (box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum())
        return ["--bounds", *map(repr, corners)]
