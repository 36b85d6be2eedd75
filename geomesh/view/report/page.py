"""The page of a report: HTML that loads nothing, with all pictures inside."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any

from geomesh.view.report.charts import chart_block
from geomesh.view.report.markers import BAR_PLACE, RADIUS
from geomesh.view.report.markup import Attributes, Markup, el
from geomesh.view.report.spelling import place
from geomesh.view.report.style import STYLE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from geomesh.view.report.content import Map, Picture, Report, Statement, WorstList

# Nothing may be loaded or run: only pictures and the style that are in the page.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

# The greatest height of the map on a page, in CSS pixels: with its heading on one sheet of A4.
_HIGHEST = 780

_FIGURES = ("mean", "median", "p5", "p95", "min", "max")


def html(report: Report) -> str:
    """Return the page of a report."""
    head = el(
        "head",
        el("meta", charset="utf-8"),
        el("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        el("meta", name="viewport", content="width=device-width, initial-scale=1"),
        el("title", report.title),
        el("style", Markup(STYLE)),
    )
    body = el(
        "body",
        el("header", *_header(report)),
        el("main", *(el("section", *section) for section in _sections(report) if section)),
        el("footer", *_footer(report)),
    )
    return f"<!DOCTYPE html>\n{el('html', head, body, lang='en')}\n"


def _header(report: Report) -> Iterator[Markup]:
    yield el("h1", report.title, class_="name")
    yield el("p", report.subtitle, class_="soft name")
    held = sum(bool(each.passed) for each in report.statements)
    total = sum(each.passed is not None for each in report.statements)
    if report.passed:
        yield el("p", f"✓ Certified: all {total} checks hold", class_="badge")
    else:
        yield el("p", f"✗ Not certified: {held} of {total} checks hold", class_="badge failed")
    cells = (
        el(
            "div",
            el("dt", each.label, class_="name"),
            el("dd", each.value),
            *([el("dd", each.note, class_="note")] if each.note else []),
        )
        for each in report.figures
    )
    yield el("dl", *cells, class_="figures")


def _sections(report: Report) -> Iterator[list[Markup]]:
    """Yield the sections of the page, in order; one that is empty is left out."""
    # This is the place of an interactive map, if there is one: above the picture of the map, which
    # is for print. The policy then has to allow its script.
    yield [el("h2", "Map"), _map(report.map)]
    yield [el("h2", "Image and mesh"), *_pairs(report)]
    yield [el("h2", "How far the pixels are from the surface"), *_paragraphs(report.accuracy)]
    yield [
        el("h2", "Certificate"),
        el("p", "Each of these was checked on this mesh when the report was made."),
        el("ul", *map(_check, report.statements), class_="checks"),
    ]
    yield [el("h2", "Warnings"), _warnings(report.warnings)] if report.warnings else []
    yield [
        el("h2", "Distributions"),
        el("p", "Number of triangles by value.", class_="soft"),
        el("div", *map(chart_block, report.histograms), class_="charts"),
    ]
    yield [
        el("h2", "Worst triangles"),
        el("p", "The marks are on the map. Places are the centres of the triangles."),
        *(part for each in report.worst for part in _worst(each)),
    ]
    yield [el("h2", "Quality"), *_quality(report.quality)]
    yield [el("h2", "Raster"), _facts(report.source)]
    yield [el("h2", "Recipe"), *_settings(report)] if report.settings else []
    yield [el("h2", "How to make it again"), *_again(report)]


def _map(shown: Map) -> Markup:
    picture = shown.picture
    width, height = picture.width, picture.height
    overlay = el(
        "svg",
        *_scale_bar(shown),
        *_marks(shown),
        viewBox=f"0 0 {width} {height}",
        role="img",
        aria_label="Marks of the worst triangles",
    )
    most = round(min(_HIGHEST * width / height, 992))
    style = f"--shape: {width / height:.4f}; aspect-ratio: {width} / {height}; max-width: {most}px"
    return el(
        "figure",
        el("div", _img(picture), overlay, class_="map", style=style),
        el("figcaption", picture.caption),
    )


def _img(picture: Picture) -> Markup:
    data = base64.b64encode(picture.png).decode("ascii")
    return el(
        "img",
        src=f"data:image/png;base64,{data}",
        width=picture.width,
        height=picture.height,
        alt=picture.alt,
    )


def _marks(shown: Map) -> Iterator[Markup]:
    """Yield the marks: round ones for angles, square ones for errors; first all of their lines."""
    for marker in shown.markers:
        (x, y), (u, v) = marker.place, marker.label
        ends: Attributes = {
            "x1": f"{x:.1f}",
            "y1": f"{y:.1f}",
            "x2": f"{u:.1f}",
            "y2": f"{v:.1f}",
        }
        yield el("line", class_="halo", **ends)
        yield el("line", class_=f"leader {marker.by}", **ends)
        yield el("circle", class_=f"spot {marker.by}", cx=ends["x1"], cy=ends["y1"], r=5)
    for marker in shown.markers:
        u, v = marker.label
        size = {"x": f"{u - RADIUS:.1f}", "y": f"{v - RADIUS:.1f}"} | dict.fromkeys(
            ("width", "height"), f"{2 * RADIUS:g}"
        )
        if marker.by == "angle":
            size |= {"rx": f"{RADIUS:g}"}
        yield el(
            "g",
            el("rect", class_=f"disc {marker.by}", **size),
            el("text", marker.mark, class_="mark", x=f"{u:.1f}", y=f"{v + 6:.1f}"),
        )


def _scale_bar(shown: Map) -> Iterator[Markup]:
    if shown.scale is None:
        return
    length, text = shown.scale
    x, y = BAR_PLACE, shown.picture.height - BAR_PLACE
    ends: Attributes = {"x1": x, "x2": f"{x + length:.1f}", "y1": y, "y2": y}
    yield el("line", class_="bar-halo", **ends)
    yield el("line", class_="bar-line", **ends)
    yield el("text", text, class_="bar-text", x=f"{x + length / 2:.1f}", y=y - 11)


def _pairs(report: Report) -> Iterator[Markup]:
    yield el("p", report.pairs_note)
    for pair in report.pairs:
        figures = (
            el("figure", _img(picture), el("figcaption", picture.caption)) for picture in pair
        )
        yield el("div", *figures, class_="pair" if len(pair) > 1 else "pair alone")


def _paragraphs(sentences: Iterable[str]) -> Iterator[Markup]:
    return (el("p", sentence) for sentence in sentences)


def _check(statement: Statement) -> Markup:
    kind, mark, word = {
        True: ("held", "✓", "holds"),
        False: ("failed", "✗", "does not hold"),
        None: ("fact", "•", ""),
    }[statement.passed]
    detail = [el("small", statement.detail)] if statement.detail else []
    sign = el("b", mark, role="img", aria_label=word) if word else el("b", mark)
    return el("li", sign, statement.text, *detail, class_=kind)


def _warnings(warnings: Iterable[str]) -> Markup:
    return el("ul", *(el("li", warning) for warning in warnings), class_="warnings")


def _worst(found: WorstList) -> Iterator[Markup]:
    yield el("h3", found.title)
    if not found.triangles:
        yield el("p", "No triangle has a value.", class_="soft")
        return
    has_lonlat = any(each.lonlat is not None for each in found.triangles)
    labels = ["x", "y", *(["longitude", "latitude"] if has_lonlat else []), found.column]
    step = _step(found)
    rows = []
    for each in found.triangles:
        lonlat = [] if not has_lonlat else [_degrees(value) for value in each.lonlat or (None,) * 2]
        cells = [str(each.id), *(place(value, step) for value in each.place), *lonlat, each.value]
        mark = el("th", el("span", each.mark, class_=f"key {found.by}"), scope="row")
        rows.append(el("tr", mark, *(el("td", cell) for cell in cells)))
    head = (el("th", label, scope="col") for label in ("triangle", *labels))
    yield _table(el("th", "mark", class_="left", scope="col"), *head, rows=rows)


def _step(found: WorstList) -> float:
    """Return by what places in a list should be told apart: a millionth of their size or less."""
    sizes = [abs(value) for each in found.triangles for value in each.place]
    return 1e-5 if max(sizes) <= 360 else 0.1


def _degrees(value: float | None) -> str:
    return "–" if value is None else place(value, 1e-5)


def _table(*head: Markup, rows: Iterable[Markup]) -> Markup:
    table = el("table", el("thead", el("tr", *head)), el("tbody", *rows))
    return el("div", table, class_="wide")


def _quality(summary: Any) -> Iterator[Markup]:
    width, height = summary["size"]
    yield el(
        "p",
        f"Lengths are in pixels of a plane of {width:g} × {height:g}. Of the measures without a "
        "unit, 1 is an equilateral triangle; of equiangle_skew it is 0.",
        class_="soft",
    )
    head = (el("th", figure, scope="col") for figure in _FIGURES)
    rows = (
        el(
            "tr",
            el("th", measure, scope="row"),
            *(el("td", _spell(values[figure])) for figure in _FIGURES),
        )
        for measure, values in summary["measures"].items()
    )
    yield _table(el("th", "measure", class_="left", scope="col"), *head, rows=rows)
    shares = ", ".join(
        f"{share or 0:.2%} are below {limit}°"
        for limit, share in summary["share_min_angle_under"].items()
    )
    yield el("p", f"Of the smallest angles, {shares}.")
    yield el("p", f"Ki / √(area / nodes) = {_spell(summary['ki_normalised'])}. ", class_="soft")
    yield el("p", f"{summary['labelling']}.", class_="soft")


def _spell(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _facts(rows: Iterable[tuple[str, str]]) -> Markup:
    pairs = (part for label, fact in rows for part in (el("dt", label), _named(fact)))
    return el("dl", *pairs, class_="facts")


def _named(fact: str) -> Markup:
    return el("dd", fact, class_="name")


def _settings(report: Report) -> Iterator[Markup]:
    changed = sum(each.usual is not None for each in report.settings)
    count = {0: "No parameter differs", 1: "One parameter differs"}.get(
        changed, f"{changed} parameters differ"
    )
    marked = ". They are marked." if changed else "."
    yield el("p", f"{count} from the preset {report.preset}{marked}")
    cells = (
        el(
            "div",
            el("dt", each.name),
            el(
                "dd",
                each.value,
                *([] if each.usual is None else [el("small", f"preset: {each.usual}")]),
            ),
            class_=None if each.usual is None else "changed",
        )
        for each in report.settings
    )
    yield el("dl", *cells, class_="settings")


def _again(report: Report) -> Iterator[Markup]:
    again = report.again
    if again.command:
        yield el("pre", el("code", again.command))
    yield from _paragraphs(again.notes)
    if again.versions:
        named = ", ".join(f"{name} {version}" for name, version in sorted(again.versions.items()))
        yield el("p", f"Versions: {named}.")


def _footer(report: Report) -> Iterator[Markup]:
    made = report.again.versions.get("geomesh")
    by = f"Mesh made with geomesh {made}. " if made else ""
    yield el("p", f"{by}This page loads nothing from elsewhere.")
