"""Write a page to a file, atomically; or show it in a notebook."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import OutputError
from geomesh.io.html import check_html, write_html
from geomesh.parallel.progress import silent
from geomesh.view.web_map.image import read_image
from geomesh.view.web_map.page import MapOptions, build_page, require_fit

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.raster.open import Source


def write_map(
    meshes: Sequence[TriangleMesh],
    path: str | PathLike[str],
    options: MapOptions,
    *,
    names: Sequence[str] | None = None,
    embed: Source | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Path:
    """Write one or two meshes as a page; the file is complete or does not exist.

    Parameters
    ----------
    meshes : sequence of one or two TriangleMesh
    path : path-like
    options : MapOptions
    names : sequence of str, optional
        What the meshes are called. Default: as the rasters from which they were made.
    embed : path, rasterio dataset, xarray.DataArray, or (array, transform, crs), optional
        A raster for the right side of a swipe.
    overwrite : bool
        Replace an existing file, as the last step.
    progress : callable(fraction, message), optional

    Raises
    ------
    OutputError
        If the file cannot be written, there are too many triangles, or a column does not exist.
    GeoreferenceError
        If the meshes, or the mesh and the raster, are not in CRSs that fit together.
    """
    check_html(path, overwrite=overwrite)
    text = page_of(meshes, options, names=names, embed=embed, progress=progress)
    progress(0.9, "Writing")
    target = write_html(text, path, overwrite=overwrite)
    progress(1.0, "Done")
    return target


def page_of(
    meshes: Sequence[TriangleMesh],
    options: MapOptions,
    *,
    names: Sequence[str] | None = None,
    embed: Source | None = None,
    progress: Progress = silent,
) -> str:
    """Return the page; see `write_map`."""
    require_fit(meshes)
    if embed is not None and len(meshes) > 1:
        raise OutputError(
            "two meshes and a raster do not fit on one swipe: give one mesh with `embed`, or two "
            "meshes without"
        )
    image = None
    if embed is not None:
        progress(0.0, "Reading the raster")
        image = read_image(meshes[0], embed)
    progress(0.2, "Packing the mesh")
    return build_page(meshes, names or [name_of(mesh) for mesh in meshes], options, image)


def name_of(mesh: TriangleMesh) -> str:
    """Return the name of the raster from which a mesh was made."""
    name = "" if mesh.provenance is None else mesh.provenance.source.name
    return Path(name).name or "mesh"


@dataclass(frozen=True)
class NotebookMap:
    """A page that a notebook shows below a cell.

    Parameters
    ----------
    page : str
    height : int
        Of the map in the notebook, in pixels.
    """

    page: str
    height: int = 520

    def _repr_html_(self) -> str:
        # Without an origin of its own: the page cannot reach the notebook, nor it the page.
        return (
            f'<iframe srcdoc="{escape(self.page)}" sandbox="allow-scripts" title="Map of the mesh" '
            f'style="width:100%;height:{self.height}px;border:0" loading="lazy"></iframe>'
        )

    def __repr__(self) -> str:
        return f"<NotebookMap: {len(self.page) / 1e6:.1f} MB>"
