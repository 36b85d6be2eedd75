"""Test a geomesh by making a mesh, because its version does not show that it works. No Qt."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from . import DEFAULT_PRESET, OPTIONS
from .environment import EnvironmentProblem, Installation
from .runner import RunError, run

if TYPE_CHECKING:
    from collections.abc import Callable

# The first test of an installation compiles what the default preset needs, so that the user's
# first mesh does not wait for it. This takes 15 s on two cores.
TESTING = "Meshing a test image. The first time, this takes up to a minute ..."

_TOLD = ("--preset", DEFAULT_PRESET, "--progress", "jsonl", "--until-eof")


def self_test(
    installation: Installation,
    *,
    progress: Callable[[float, str], None] = lambda _fraction, _message: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> str:
    """Make a mesh of a tiny raster, and return the version of geomesh.

    Parameters
    ----------
    installation : Installation
    progress : callable
        Receives a fraction (0..1, which never decreases) and what is done.
    cancelled : callable
        Returns whether to stop.

    Raises
    ------
    Cancelled
        If the test was cancelled.
    EnvironmentProblem
        If there is no mesh, or if geomesh cannot use coordinate reference systems.
    """
    warnings: list[str] = []
    said = ""

    def report(fraction: float, message: str) -> None:
        nonlocal said
        if message != said:  # the log of the user has a line for each report
            said = message
            progress(fraction, f"Test image: {message}")

    progress(0.0, TESTING)
    with tempfile.TemporaryDirectory(prefix="geomesh-test-") as folder:
        raster = write_test_raster(Path(folder))
        mesh = raster.with_name("mesh.gpkg")
        try:
            run(
                [*installation.command, "mesh", str(raster), "-o", str(mesh), *_TOLD],
                progress=report,
                warn=warnings.append,
                cancelled=cancelled,
                places=[mesh.parent],
            )
        except RunError as error:
            raise EnvironmentProblem(
                f"{installation.command[0]} cannot mesh a test image: {error.message}",
                error.details,
            ) from error
        if not mesh.is_file():
            raise EnvironmentProblem(
                f"{installation.command[0]} meshed a test image but wrote no file; choose or "
                f"install another geomesh in {OPTIONS}"
            )
    lost = [warning for warning in warnings if "CRS" in warning]
    if lost:
        raise EnvironmentProblem(
            f"{installation.command[0]} does not understand coordinate systems ({lost[0]}); "
            f"install another geomesh in {OPTIONS}",
            tuple(warnings),
        )
    return installation.version


def write_test_raster(folder: Path) -> Path:
    """Write a georeferenced image of 48 x 48 pixels that contains features."""
    size = 48

    def pixel(row: int, col: int) -> int:
        in_disc = (row % 12 - 6) ** 2 + (col % 12 - 6) ** 2 < 14
        return 40 + 30 * ((row // 12 + 2 * col // 12) % 6) if in_disc else 20 + row

    header = f"ncols {size}\nnrows {size}\nxllcorner -35\nyllcorner -8\ncellsize 0.001\n"
    rows = (" ".join(str(pixel(row, col)) for col in range(size)) for row in range(size))
    path = folder / "test.asc"
    path.write_text(header + "\n".join(rows) + "\n", encoding="ascii")
    path.with_suffix(".prj").write_text(
        'GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",SPHEROID["WGS_1984",6378137.0,298.257223563]],'
        'PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]]',
        encoding="ascii",
    )
    return path
