"""What the algorithms have in common: they run a command of geomesh and tell how it goes."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from qgis.core import (
    QgsProcessingAlgorithm,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeedback,
)
from qgis.PyQt.QtGui import QIcon

from .. import settings
from ..engine import environment, runner
from ..files import find_format_fault, find_output_fault
from ..inputs import RasterInput, describe_raster

if TYPE_CHECKING:
    from collections.abc import Sequence

PRESETS = {
    "features": "features: at the raster's own resolution",
    "paper": "paper: the published system, at 256 × 256 pixels",
}

_FOLDER = Path(__file__).parents[1]

# What geomesh calls its options, and what the dialog calls them.
_WORDS = {
    "--set edge_distance=null or --set min_spacing=1": "a minimum distance between nodes of 1",
    "--set sobel=true": "Sobel (advanced)",
    "--bounds": "the extent",
    "--mask": "the mask",
    "override the nodata value with --nodata": "set another nodata value",
    "--nodata": "the nodata value",
    "--bidx": "the bands",
    "--gray": "Gray image",
    "give another with --crs": "set another one on the layer",
}


def in_the_dialogs_words(text: str) -> str:
    """Return a message of geomesh with the dialog's names for its options."""
    for option, words in _WORDS.items():
        text = text.replace(option, words)
    return text


class GeomeshAlgorithm(QgsProcessingAlgorithm):
    """An algorithm that runs in the environment of geomesh, never in QGIS's own Python."""

    NAME = ""
    TITLE = ""
    GROUP = ""
    TAGS: Sequence[str] = ()
    SUMMARY = ""
    HELP = ""

    def createInstance(self) -> GeomeshAlgorithm:
        """Return a new one: every run has its own."""
        return type(self)()

    def name(self) -> str:
        """Return the name for programs."""
        return self.NAME

    def displayName(self) -> str:
        """Return the name for people."""
        return self.TITLE

    def group(self) -> str:
        """Return the heading in the toolbox."""
        return self.GROUP

    def groupId(self) -> str:
        """Return the heading for programs."""
        return self.GROUP.lower()

    def tags(self) -> list[str]:
        """Return words by which the toolbox finds it."""
        return list(self.TAGS)

    def icon(self) -> QIcon:
        """Return the picture beside the name."""
        return QIcon(str(_FOLDER / "icon.svg"))

    def svgIconPath(self) -> str:
        """Return the picture as a vector file."""
        return str(_FOLDER / "icon.svg")

    def shortDescription(self) -> str:
        """Return one sentence."""
        return self.SUMMARY

    def shortHelpString(self) -> str:
        """Return the help beside the parameters, with its picture."""
        picture = (_FOLDER / "images" / f"{self.NAME}.png").as_uri()
        help_text = " ".join(self.HELP.split())  # Processing would break the lines of the source
        return f'<p>{self.SUMMARY}</p><p><img src="{picture}"/></p>{help_text}'

    def checkParameterValues(self, parameters: dict, context: QgsProcessingContext) -> tuple:
        """Refuse to start without geomesh, or with values that cannot work."""
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
        """Return why the values cannot work, or an empty text."""
        return ""

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Refuse what cannot work: batches and steps of models were not checked before."""
        reason = self.find_fault(parameters, context)
        if reason:
            raise QgsProcessingException(reason)
        return True

    def find_mesh_output_fault(
        self, parameters: dict, context: QgsProcessingContext, read: Sequence[str]
    ) -> str:
        """Return why the mesh cannot go where OUTPUT says, or an empty text."""
        # In a context of its own: the run's would take it for a layer to load.
        path = self.parameterAsOutputLayer(parameters, "OUTPUT", QgsProcessingContext())
        return find_format_fault(path) or find_output_fault(path, context.project(), read)

    def find_file_output_fault(
        self, name: str, parameters: dict, context: QgsProcessingContext, read: Sequence[str]
    ) -> str:
        """Return why the file that a parameter names cannot be written, or an empty text."""
        path = self.parameterAsFileOutput(parameters, name, QgsProcessingContext())
        return find_output_fault(path, context.project(), read) if path else ""

    def run_geomesh(
        self,
        arguments: Sequence[str],
        feedback: QgsProcessingFeedback,
        output: str,
        span: tuple[float, float] = (0, 1),
    ) -> dict:
        """Run a command and return its figures.

        Parameters
        ----------
        arguments : sequence of str
            Name of the command, its options and its input.
        feedback : QgsProcessingFeedback
            Is told of progress and warnings; asked whether to stop.
        output : str
            File that the command writes; an older one is replaced.
        span : (float, float)
            Part of the whole run that this command is, from 0 to 1.

        Raises
        ------
        QgsProcessingException
            If it fails or was cancelled; `output` is as it was before.
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
        target = ["-o", output, "--overwrite"]
        spell = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
        try:
            program = settings.installation().command
            feedback.pushCommandInfo(spell([*program, name, *target, *rest]))
            command = [*program, name, "--progress", "jsonl", "--until-eof", *target, *rest]
            outcome = runner.run(
                command,
                progress=progress,
                warn=lambda text: feedback.pushWarning(in_the_dialogs_words(text)),
                cancelled=feedback.isCanceled,
                places=[Path(output).parent],
            )
        except environment.EnvironmentProblem as problem:
            raise QgsProcessingException(str(problem)) from problem
        except runner.RunError as error:
            raise QgsProcessingException(in_the_dialogs_words(str(error))) from error
        except runner.Cancelled as stop:
            raise QgsProcessingException(f"Cancelled: {output} was not written.") from stop
        return outcome.figures


class RasterAlgorithm(GeomeshAlgorithm):
    """One that reads the raster layer INPUT, cropped to EXTENT."""

    raster: RasterInput

    def prepareAlgorithm(
        self, parameters: dict, context: QgsProcessingContext, feedback: QgsProcessingFeedback
    ) -> bool:
        """Ask the layer what is needed: later this runs in another thread."""
        super().prepareAlgorithm(parameters, context, feedback)
        self.raster = describe_raster(self.parameterAsRasterLayer(parameters, "INPUT", context))
        return True

    def extent_options(self, parameters: dict, context: QgsProcessingContext) -> list[str]:
        """Return geomesh's option for EXTENT, in the CRS of the raster."""
        box = self.parameterAsExtent(parameters, "EXTENT", context, self.raster.crs)
        if box.isNull():
            return []
        corners = (box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum())
        return ["--bounds", *map(repr, corners)]
