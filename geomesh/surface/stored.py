"""Stored values: the surface in the columns of a mesh, and the choice of a surface to show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from geomesh.errors import BandError
from geomesh.mesh.refinement import surface_values
from geomesh.parameters import MODELS
from geomesh.surface.fit import Surface, fit_surface
from geomesh.surface.paint import FITS, check

if TYPE_CHECKING:
    from collections.abc import Sequence

    from geomesh.mesh.refinement import Refinement
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.parameters import Model
    from geomesh.raster.scene import Scene

# What to show: values that are fitted to the raster, or those that the mesh has.
Shown = Literal["least_squares", "sampled", "stored"]
SHOWN: tuple[Shown, ...] = (*FITS, "stored")


class Choice(NamedTuple):
    """The model of a surface, and how its values are found."""

    model: Model
    fit: Shown


def choose(
    mesh: TriangleMesh, model: str | None, fit: str | None, bidx: Sequence[int] | None = None
) -> Choice:
    """Return what to show of a mesh; None stands for its default.

    Parameters
    ----------
    mesh : TriangleMesh
    model : {"linear", "constant"}, optional
        Default: the model for which the mesh was refined, else linear.
    fit : {"least_squares", "sampled", "stored"}, optional
        Default: stored if the mesh was refined for this model and `bidx` is not given, else
        least_squares.
    bidx : sequence of int, optional
        Other bands than those from which the mesh was made.

    Raises
    ------
    ValueError
        If the model or the fit is unknown.
    """
    refinement = _refinement(mesh)
    if model is None:
        model = MODELS[0] if refinement is None else refinement.model
    if fit is None:
        is_stored = refinement is not None and refinement.model == model and bidx is None
        fit = "stored" if is_stored else FITS[0]
    check(model=model)
    if fit not in SHOWN:
        raise ValueError(f"fit is {fit!r}: choose {' or '.join(SHOWN)}")
    return Choice(model, fit)  # type: ignore[arg-type]


def find_surface(
    mesh: TriangleMesh,
    scene: Scene,
    *,
    model: str | None,
    fit: str | None,
    bidx: Sequence[int] | None,
    workers: Workers,
    progress: Progress,
) -> Surface:
    """Return the surface of a mesh for the bands of a scene.

    Parameters
    ----------
    mesh : TriangleMesh
    scene : Scene
        As `geomesh.surface.original.open_original` returns it.
    model, fit, bidx
        As in `choose`.
    workers : Workers
    progress : callable(fraction, message)

    Raises
    ------
    MeshFileError
        If values are to be those of the mesh, and it has none for the model.
    BandError
        If these are of another number of bands than the scene has.
    """
    model, fit = choose(mesh, model, fit, bidx)
    if fit != "stored":
        return fit_surface(
            *(mesh.nodes, mesh.triangles, scene),
            model=model,
            fit=fit,
            workers=workers,
            progress=progress,
        )
    names = _stored_bands(mesh, scene, bidx)
    if len(names) != len(scene.bands):
        raise BandError(
            f"the mesh has values of {len(names)} bands and {scene.name} has {len(scene.bands)}: "
            "use the raster from which the mesh was made, or choose another `fit`"
        )
    table = mesh.node_table if model == "linear" else mesh.triangle_table
    return Surface(mesh.nodes, mesh.triangles, surface_values(table, names, model), model)


def _stored_bands(mesh: TriangleMesh, scene: Scene, bidx: Sequence[int] | None) -> tuple[str, ...]:
    """Return the names that the bands of a scene have in the columns of the mesh."""
    refinement = _refinement(mesh)
    if bidx is None and refinement is not None:
        return tuple(band.name for band in refinement.bands)
    return tuple(band.name for band in scene.bands)


def _refinement(mesh: TriangleMesh) -> Refinement | None:
    return None if mesh.provenance is None else mesh.provenance.refinement
