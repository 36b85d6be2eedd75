"""Histograms as SVG inside a page: sharp in print, in the colours of the page."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from geomesh.view.report.markup import Markup, el
from geomesh.view.report.spelling import spell

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.view.report.content import Histogram

# Size of a chart, and of the frame of its bars: left, top, right, bottom.
_WIDTH, _HEIGHT = 340, 200
_LEFT, _TOP, _RIGHT, _BOTTOM = 46, 34, 332, 162

# Space between bars, and the least height of one that is not empty.
_GAP = 1.0
_LEAST = 0.8

# Label of the axis of x, and how wide a letter is.
_LETTER = 5.6


def chart(histogram: Histogram) -> Markup:
    """Return a histogram as an SVG element. Each bar has its numbers as a tooltip."""
    parts = [*_grid(histogram), *_bars(histogram), *_ticks(histogram), *_lines(histogram)]
    about = f"Histogram: {histogram.title}, median {spell(histogram.median)} {histogram.unit}"
    return el(
        "svg",
        *parts,
        class_="chart",
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        role="img",
        aria_label=about.strip(),
    )


def _x(histogram: Histogram, value: float) -> float:
    low, high = histogram.edges[0], histogram.edges[-1]
    if histogram.logarithmic:
        low, high, value = math.log(low), math.log(high), math.log(value)
    return _LEFT + (value - low) / (high - low) * (_RIGHT - _LEFT)


def _y(count: float, highest: float) -> float:
    return _BOTTOM - count / highest * (_BOTTOM - _TOP)


def _highest(histogram: Histogram) -> float:
    return max(*histogram.counts, 1) * 1.02


def _grid(histogram: Histogram) -> Iterator[Markup]:
    highest = _highest(histogram)
    for tick in nice_ticks(0, max(*histogram.counts, 1), 3):
        if tick != int(tick):
            continue
        y = round(_y(tick, highest), 1)
        yield el("line", class_="grid", x1=_LEFT, x2=_RIGHT, y1=y, y2=y)
        yield el("text", f"{int(tick):,}", class_="tick", x=_LEFT - 5, y=y + 3.5, text_anchor="end")


def _bars(histogram: Histogram) -> Iterator[Markup]:
    highest, unit = _highest(histogram), f" {histogram.unit}" if histogram.unit else ""
    pairs = zip(histogram.edges[:-1], histogram.edges[1:], histogram.counts, strict=True)
    for low, high, count in pairs:
        if not count:
            continue
        left, right = _x(histogram, low), _x(histogram, high)
        height = max(_BOTTOM - _y(count, highest), _LEAST)
        title = f"{spell(low)} to {spell(high)}{unit}: {count:,} triangles"
        yield el(
            "rect",
            el("title", title),
            class_="bar",
            x=round(left + _GAP / 2, 2),
            y=round(_BOTTOM - height, 2),
            width=round(max(right - left - _GAP, 0.5), 2),
            height=round(height, 2),
        )


def _ticks(histogram: Histogram) -> Iterator[Markup]:
    yield el("line", class_="axis", x1=_LEFT, x2=_RIGHT, y1=_BOTTOM, y2=_BOTTOM)
    low, high = histogram.edges[0], histogram.edges[-1]
    ticks = log_ticks(low, high) if histogram.logarithmic else nice_ticks(low, high, 5)
    last = -math.inf
    for tick in ticks:
        x, label = _x(histogram, tick), spell(tick)
        half = len(label) * _LETTER / 2
        yield el("line", class_="axis", x1=round(x, 1), x2=round(x, 1), y1=_BOTTOM, y2=_BOTTOM + 4)
        if x - half < last + _LETTER or x + half > _WIDTH:
            continue  # it would touch its neighbour
        last = x + half
        yield el("text", label, class_="tick", x=round(x, 1), y=_BOTTOM + 16, text_anchor="middle")
    unit = histogram.unit + (", logarithmic" if histogram.logarithmic else "")
    middle = (_LEFT + _RIGHT) / 2
    if unit:
        yield el("text", unit, class_="tick", x=middle, y=_BOTTOM + 32, text_anchor="middle")


def _lines(histogram: Histogram) -> Iterator[Markup]:
    """Yield the lines of the median and of a limit, with their labels above the bars."""
    found = []
    if math.isfinite(histogram.median):
        found.append(("median", "median", histogram.median))
    if histogram.limit is not None and math.isfinite(histogram.limit[0]):
        found.append(("limit", histogram.limit[1], histogram.limit[0]))
    for k, (kind, label, value) in enumerate(found):
        if not histogram.edges[0] <= value <= histogram.edges[-1]:
            continue
        x, top = round(_x(histogram, value), 1), _TOP - 6 - 13 * k
        yield el("line", class_=kind, x1=x, x2=x, y1=top - 2, y2=_BOTTOM)
        on_left = x > (_LEFT + _RIGHT) / 2
        yield el(
            "text",
            f"{label} {spell(value)}",
            class_=f"tick {kind}-label",
            x=x - 4 if on_left else x + 4,
            y=top + 4,
            text_anchor="end" if on_left else "start",
        )


def nice_ticks(low: float, high: float, most: int) -> list[float]:
    """Return at most about `most` round numbers from `low` to `high`, evenly spaced."""
    if not high > low:
        return [low]
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step = next(step * k for k in (1, 2, 5, 10) if (high - low) / (step * k) <= most)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [float(f"{k * step:.10g}") for k in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Return powers of ten from `low` to `high`; if there are few, also twice and five times."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    tens = [10.0**k for k in range(first, last + 1)]
    inside = [ten for ten in tens if low <= ten <= high]
    if len(inside) > 2:
        return inside
    return [k * ten for ten in tens for k in (1, 2, 5) if low <= k * ten <= high]


def chart_block(histogram: Histogram) -> Markup:
    """Return a histogram with its title, and what it leaves out."""
    left_out = histogram.left_out
    note = f"{left_out:,} triangles without a value are left out." if left_out else ""
    title = el("figcaption", el("strong", histogram.title), *([el("small", note)] if note else []))
    return el("figure", title, chart(histogram))
