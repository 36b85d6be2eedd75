"""Draw a mesh on the map with matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geomesh.errors import extra_required
from geomesh.io.picture import save_picture
from geomesh.mesh.colors import brightened, parse_colors

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.axes import Axes

    from geomesh.mesh.triangle_mesh import TriangleMesh

# Background colour, so that white triangles differ from places without triangles.
_PAPER = "#e4e4e4"


def plot_mesh(
    mesh: TriangleMesh,
    column: str = "color",
    *,
    ax: Axes | None = None,
    cmap: str = "viridis",
    edgecolor: str | None = None,
    path: str | PathLike[str] | None = None,
) -> Axes:
    """Draw the triangles of a mesh on the map; dark images are brightened.

    Parameters
    ----------
    mesh : TriangleMesh
    column : str
        The values that colour the triangles: "color" (the mean colour of the image) or any
        numeric column of ``mesh.attributes("triangles")``.
    ax : matplotlib Axes, optional
        Where to draw; by default in a new figure.
    cmap : str
        Colour map for a numeric column.
    edgecolor : str, optional
        Colour of the triangle edges; by default translucent white.
    path : path, optional
        Also save the figure to this file (.png, .pdf, .svg); an existing file is replaced.

    Returns
    -------
    matplotlib Axes
    """
    with extra_required("matplotlib", "figures"):
        from matplotlib import collections
        from matplotlib.figure import Figure
    attributes = mesh.attributes("triangles")
    if column not in attributes:
        raise ValueError(f"column is {column!r}: choose from {', '.join(attributes)}")
    west, south, east, north = mesh.grid.bounds()
    if ax is None:
        height_per_width = (north - south) / (east - west) * mesh.grid.aspect
        size = (8.0, min(max(8.0 * height_per_width, 3.0), 14.0) + 0.4)
        if path is None:
            from matplotlib import pyplot

            ax = pyplot.subplots(figsize=size, layout="constrained")[1]
        else:
            ax = Figure(figsize=size, layout="constrained").subplots()
    figure: Any = ax.figure
    corners: Any = mesh.map_nodes[mesh.triangles]
    values = attributes[column]
    style: dict[str, Any] = {"edgecolors": edgecolor or "#ffffff59", "linewidths": 0.25}
    if column == "color":
        shown = brightened(parse_colors(values)) / 255
        triangles = collections.PolyCollection(corners, facecolors=shown, **style)
    else:
        triangles = collections.PolyCollection(corners, array=values, cmap=cmap, **style)
        figure.colorbar(triangles, ax=ax, label=column, shrink=0.7)
    ax.add_collection(triangles)
    ax.set(xlim=(west, east), ylim=(north, south) if mesh.grid.y_runs_down else (south, north))
    ax.set_aspect(mesh.grid.aspect)
    ax.set_facecolor(_PAPER)
    crs = mesh.grid.crs
    unit = crs.axis_info[0].unit_name if crs and crs.axis_info else "pixel"
    ax.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    ax.ticklabel_format(style="plain", useOffset=False)
    ax.tick_params(labelsize=7)
    name = crs.name if crs else "no CRS"
    ax.set_title(
        f"{len(mesh.nodes):,} nodes, {len(mesh.triangles):,} triangles ({name})",
        fontsize=10,
        loc="left",
    )
    if path is not None:
        save_picture(figure, path, overwrite=True)
    return ax
