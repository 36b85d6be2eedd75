"""Draw a comparison: the distribution of the measures over the images, for each method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geomesh.errors import extra_required

with extra_required("matplotlib", "evaluate"):
    from matplotlib import rc_context
    from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from geomesh.evaluate.comparison import Comparison

Values = NDArray[np.float64]

_KI = r"$K_i\,/\,\sqrt{A/N}$"
_ANGLE = "smallest angle, mean (°)"
_PSNR = "PSNR gain over random (dB)"
_PLANES = {
    "256x256": "256 × 256 pixels, as many nodes as “paper” finds",
    "native": "native resolution, as many nodes as “features” finds",
}
_PRESETS = ("paper", "features", "adaptive")
_REFERENCE = "random"

# With more images than this, the points would hide the boxes.
_MOST_POINTS = 40

_INK = "#222222"
_RULE = "#e2e2e2"
_PRESET_COLOR = "#2a6f97"
_BASELINE_COLOR = "#8d8d8d"
_STYLE: dict[Any, Any] = {"font.size": 8, "axes.linewidth": 0.6, "axes.titlesize": 8.5}
_WIDTH = 7.2  # inches: both columns of a page


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw a row of panels for each plane: normalised Ki, smallest angle and PSNR.

    A box contains the middle half of the images and has a line at the median. Whiskers reach
    to the 5th and the 95th percentile. Up to 40 images are also drawn as points. PSNR is the
    difference to random nodes on the same image, because images differ much more than
    methods. A plane without figures is not drawn.
    """
    filled = {average.plane for average in comparison.overall() if average.images}
    planes = {plane: methods for plane, methods in comparison.methods.items() if plane in filled}
    heights = [len(methods) + 2.2 for methods in planes.values()]
    with rc_context(_STYLE):
        size = (_WIDTH, 0.21 * sum(heights) + 0.2)
        figure = Figure(figsize=size, layout="constrained", facecolor="white")
        rows = figure.subplots(len(planes), 3, squeeze=False, height_ratios=heights)
        for letter, (plane, methods), axes in zip("ab", planes.items(), rows, strict=False):
            columns = [_measures(comparison, plane, method) for method in methods]
            for ax, label in zip(axes, (_KI, _ANGLE, _PSNR), strict=True):
                _draw_panel(ax, methods, [column[label] for column in columns])
                ax.set_xlabel(label)
            axes[2].axvline(0, color=_INK, linewidth=0.6, zorder=1)
            for ax in axes[1:]:
                ax.tick_params(labelleft=False)
            count = max(len(column[_KI]) for column in columns)
            images = f"{count} image{'s' if count != 1 else ''}"
            axes[0].set_title(f"({letter}) {_PLANES[plane]}, {images}", loc="left", color=_INK)
    return figure


def _measures(comparison: Comparison, plane: str, method: str) -> dict[str, Values]:
    """Return the values to draw for a method: one for each image and panel."""
    reference = {r.image: r.figures.psnr_whole for r in comparison.of(plane, _REFERENCE)}
    records = comparison.of(plane, method)
    gains = [r.figures.psnr_whole - reference.get(r.image, np.nan) for r in records]
    return {
        _KI: _finite([r.figures.ki_normalised for r in records]),
        _ANGLE: _finite([r.figures.angle_mean for r in records]),
        _PSNR: _finite(gains),
    }


def _finite(values: list[float]) -> Values:
    array = np.array(values, np.float64)
    return array[np.isfinite(array)]


def _draw_panel(ax: Axes, methods: tuple[str, ...], columns: list[Values]) -> None:
    for place, (method, values) in enumerate(zip(methods, columns, strict=True)):
        color = _PRESET_COLOR if method in _PRESETS else _BASELINE_COLOR
        line = {"color": color, "linewidth": 0.8}
        style: dict[str, Any] = {
            "boxprops": {**line, "facecolor": "white"},
            "whiskerprops": line,
            "capprops": line,
            "medianprops": {"color": color, "linewidth": 1.8},
        }
        if len(values) > 1:
            ax.boxplot(
                [values],
                positions=[place],
                orientation="horizontal",
                widths=0.62,
                whis=(5, 95),
                showfliers=False,
                patch_artist=True,
                manage_ticks=False,
                **style,
            )
        if len(values) <= _MOST_POINTS:
            spread = 0.18 * np.sin(2.4 * np.arange(len(values)))  # so that equal points differ
            size = 2.2 if len(values) > 1 else 4
            ax.plot(values, place + spread, "o", ms=size, mfc=color, mec="white", mew=0.3, zorder=3)
    ax.set_yticks(range(len(methods)), methods)
    ax.set_ylim(len(methods) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.tick_params(axis="x", length=2.5, width=0.6)
    ax.grid(axis="x", color=_RULE, linewidth=0.5)
    ax.set_axisbelow(True)
    ax.spines[["top", "right", "left"]].set_visible(False)
