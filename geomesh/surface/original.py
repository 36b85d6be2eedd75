"""Open the raster from which a mesh was made: the same bands, and the part that was used."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import BandError, GeoreferenceError, MeshFileError
from geomesh.raster.crs import crs_label, horizontal, same_crs
from geomesh.raster.grid import LATTICE, Grid, Window
from geomesh.raster.open import Source, open_scene
from geomesh.raster.pixel_mask import PixelMask

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pyproj import CRS

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import Alpha
    from geomesh.raster.scene import Scene


def open_original(
    mesh: TriangleMesh,
    source: Source,
    *,
    bidx: Sequence[int] | None = None,
    alpha: Alpha | None = None,
    crs: Any = None,
) -> Scene:
    """Return the part of a raster that a mesh covers, opened as when the mesh was made.

    The bands, the nodata value, the use of alpha and of scale and offset, and the area of
    interest come from the mesh's provenance.

    Parameters
    ----------
    mesh : TriangleMesh
    source : str, PathLike, rasterio dataset, or (array, transform, crs)
        The raster from which the mesh was made, or another raster with the same pixels,
        such as other bands; it may be larger than the mesh.
    bidx : sequence of int, optional
        1-based bands to use instead of the bands from which the mesh was made.
    alpha : {"mask", "data"}, optional
        As in `geomesh.mesh_raster`. Default: as when the mesh was made.
    crs : str, int or pyproj.CRS, optional
        Replaces the CRS of the file, as when the mesh was made.

    Raises
    ------
    SourceError, BandError
        If the raster cannot be opened, or does not have the bands.
    GeoreferenceError
        If the raster does not have the pixels of the mesh.
    """
    made_from = mesh.provenance.source if mesh.provenance is not None else None
    bands = list(bidx) if bidx is not None else None
    if bands is None and made_from is not None:
        # With a palette, the three colours come from one band: use its number once.
        bands = list(dict.fromkeys(band.index for band in made_from.bands))
    values: dict[str, Any] = {}
    if made_from is not None:
        values = {name: getattr(made_from, name) for name in ("nodata", "alpha", "unscale")}
    if alpha is not None:
        values["alpha"] = alpha
    try:
        scene = open_scene(source, bidx=bands, crs=crs, **values)
    except BandError as error:
        if bidx is not None:
            raise
        numbers = ",".join(map(str, bands or ()))
        raise BandError(
            f"{error}; the mesh was made from bands {numbers}: choose others with `bidx`"
        ) from error
    window = _find(mesh.grid, scene)
    area = None
    if made_from is not None and made_from.area is not None:
        # The area is in pixels of the source of the mesh. In this raster, the part that the
        # mesh covers may have another position.
        col, row = made_from.window[:2]
        try:
            area = PixelMask.from_text(made_from.area).move(window.col - col, window.row - row)
        except ValueError as error:
            raise MeshFileError(
                "the mesh has an area of interest that cannot be read; make the mesh again"
            ) from error
    return scene.crop(window, area)


def _find(grid: Grid, scene: Scene) -> Window:
    """Return the window of a scene that has the pixels of a mesh's grid."""
    if not _same_plane(grid.crs, scene.grid.crs):
        raise GeoreferenceError(
            f"the mesh is in {crs_label(grid.crs)} and {scene.name} in "
            f"{crs_label(scene.grid.crs)}: use the raster from which the "
            "mesh was made, or give the CRS that was used then with `crs`"
        )
    corners = np.array([(0, 0), (grid.width, 0), (grid.width, grid.height), (0, grid.height)])
    there = scene.grid.to_pixel(grid.to_map(corners))
    col, row = np.rint(there[0]).astype(int).tolist()
    window = Window(col, row, grid.width, grid.height)
    # Nodes lie on a lattice: smaller differences do not matter to the mesh.
    meets = np.abs(there - corners - (col, row)).max() < 1 / LATTICE
    if not meets or window.clip(scene.grid.extent) != window:
        raise GeoreferenceError(
            f"the pixels of the mesh ({_lattice(grid)}) are not among those of {scene.name} "
            f"({_lattice(scene.grid)}): use the raster from which the mesh was made"
        )
    return window


def _same_plane(one: CRS | None, other: CRS | None) -> bool:
    """Return whether x and y mean the same; heights and a datum shift do not matter here."""
    if one is None or other is None:
        return one is other
    return same_crs(horizontal(one), horizontal(other))


def _lattice(grid: Grid) -> str:
    a, b, c, d, e, f = grid.transform[:6]
    turned = f" turned by {b:g}, {d:g}" if b or d else ""
    return f"{grid.width} x {grid.height} of {a:g}, {e:g}{turned} from {c:.10g}, {f:.10g}"
