"""A picture of one raster as all methods show it, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from benchmarks.fidelity_tables import ADAPTIVE, PAPER, Record
from benchmarks.peers import PEERS
from benchmarks.superpixels import SLIC

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from benchmarks.scoring import Raster
    from geomesh.arrays.types import Floats, Mask, Points, Triangles

# Most pixels on a side of the part that is drawn, and inches on a side of a panel.
_SIDE = 192
_INCHES = 3.2

_METHODS = (ADAPTIVE, "greedy insertion", "Yang error diffusion", "regular grid", "random", PAPER)
_EDGE = {ADAPTIVE: "#c2255c"}


class Panel(NamedTuple):
    """What to draw of one method.

    Attributes
    ----------
    record : Record
    image : float64 (B, H, W)
    mesh : (points, triangles) or None
    """

    record: Record
    image: Floats
    mesh: tuple[Points, Triangles] | None


def draw(raster: Raster, panels: list[Panel], path: Path) -> None:
    """Draw a part of the raster as each method shows it, and the edges of the meshes.

    The rows are the linear model, its triangles, and the constant model. In the first column are
    the original, the whole raster, and the superpixels.
    """
    assert set(_METHODS) == {ADAPTIVE, PAPER, *PEERS}
    by_name = {(panel.record.model, panel.record.method): panel for panel in panels}
    methods = [name for name in _METHODS if ("linear", name) in by_name]
    rows, cols = busiest(raster)
    ratio = (rows.stop - rows.start) / (cols.stop - cols.start)
    columns = 1 + len(methods)
    size = (columns * _INCHES, 3 * (_INCHES * ratio + 0.45) + 0.6)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(3, columns, squeeze=False)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
        axis.set_xlim(cols.start, cols.stop)
        axis.set_ylim(rows.stop, rows.start)
    original = _colors(raster, raster.bands)
    _show(axes[0, 0], original, "original")
    _show_whole(axes[1, 0], original, (rows, cols))
    _show_panel(axes[2, 0], raster, by_name.get(("constant", SLIC)))
    for k, name in enumerate(methods, 1):
        linear = by_name["linear", name]
        _show_panel(axes[0, k], raster, linear)
        _show_edges(axes[1, k], linear, original)
        _show_panel(axes[2, k], raster, by_name.get(("constant", name)))
    names = "linear model", "its triangles", "constant model"
    for axis, text in zip(axes[:, 0], names, strict=True):
        axis.set_ylabel(text, fontsize=13, fontweight="bold")
    count = panels[0].record.wanted
    figure.suptitle(
        f"{raster.name}: {count:,} nodes, {panels[0].record.label} of the valid pixels; "
        "PSNR over all valid pixels, least-squares values",
        fontsize=15,
    )
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": None})


def busiest(raster: Raster) -> tuple[slice, slice]:
    """Return the rows and columns of the part with the most variation among valid pixels."""
    gray, valid = raster.guides["gray"], raster.valid
    height, width = valid.shape
    side = min(_SIDE, height, width)
    steps = np.hypot(*np.gradient(gray)) * valid
    # Square roots, because a few bright lines are not yet a busy part.
    total = np.pad(np.sqrt(steps).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    sums = total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    row, col = np.unravel_index(np.argmax(sums), sums.shape)
    return slice(int(row), int(row) + side), slice(int(col), int(col) + side)


def _show(axis: Axes, picture: NDArray[np.float64], title: str) -> None:
    height, width = picture.shape[:2]
    limits = axis.get_xlim(), axis.get_ylim()
    axis.imshow(picture, extent=(0, width, height, 0), interpolation="nearest")
    axis.set_xlim(limits[0])
    axis.set_ylim(limits[1])
    axis.set_title(title, fontsize=12)


def _show_panel(axis: Axes, raster: Raster, panel: Panel | None) -> None:
    if panel is None:
        axis.set_axis_off()
        return
    record = panel.record
    title = f"{record.method}\n{record.decibels:.2f} dB"
    if record.nodes != record.wanted or record.label == PAPER:
        title += f", {record.nodes:,} {'vertices' if record.method == SLIC else 'nodes'}"
    _show(axis, _colors(raster, panel.image), title)
    if record.method == ADAPTIVE:
        axis.title.set_fontweight("bold")
        for spine in axis.spines.values():
            spine.set_edgecolor(_EDGE[ADAPTIVE])
            spine.set_linewidth(2.5)


def _show_whole(axis: Axes, original: NDArray[np.float64], part: tuple[slice, slice]) -> None:
    rows, cols = part
    height, width = original.shape[:2]
    axis.set_xlim(0, width)
    axis.set_ylim(height, 0)
    _show(axis, original, "the whole raster, and the part shown")
    corner, side = (cols.start, rows.start), rows.stop - rows.start
    axis.add_patch(Rectangle(corner, side, side, fill=False, edgecolor="white", linewidth=3.5))
    axis.add_patch(Rectangle(corner, side, side, fill=False, edgecolor="black", linewidth=1.5))


def _show_edges(axis: Axes, panel: Panel, original: NDArray[np.float64]) -> None:
    assert panel.mesh is not None
    points, triangles = panel.mesh
    _show(axis, 0.45 + 0.55 * original, f"{len(triangles):,} triangles")
    axis.triplot(
        *points.T, triangles, linewidth=0.6, color=_EDGE.get(panel.record.method, "#1c3f94")
    )


def _colors(raster: Raster, bands: Floats) -> NDArray[np.float64]:
    """Return colours (H, W, 3) from 0 to 1; invalid pixels are white.

    Three bands are stretched by the 1st and 99th percentile of the raster's valid pixels. One
    band is drawn as a shaded relief.
    """
    valid: Mask = raster.valid & ~np.isnan(bands).any(axis=0)
    shown = np.where(valid, bands, 0.0)[list(raster.scene.display)]
    if len(raster.bands) == 1:
        return _relief(raster, np.where(valid, bands[0], np.median(raster.bands[0][raster.valid])))
    limits = np.percentile(raster.bands[:, raster.valid], (1, 99), axis=1)
    low, high = (edge[list(raster.scene.display), None, None] for edge in limits)
    colors = np.clip((shown - low) / np.maximum(high - low, 1e-12), 0, 1)
    return np.where(valid[..., None], np.moveaxis(colors, 0, -1), 1.0)


def _relief(raster: Raster, heights: Floats) -> NDArray[np.float64]:
    from matplotlib import colormaps

    low, high = np.percentile(raster.bands[0][raster.valid], (1, 99))
    steepest = np.percentile(np.hypot(*np.gradient(raster.bands[0]))[raster.valid], 90)
    tinted = colormaps["gist_earth"](0.15 + 0.75 * np.clip((heights - low) / (high - low), 0, 1))
    light = LightSource(azdeg=315, altdeg=40).hillshade(heights, vert_exag=1 / max(steepest, 1e-12))
    colors = tinted[..., :3] * (0.35 + 0.65 * light[..., None])
    return np.where(raster.valid[..., None], colors, 1.0)
