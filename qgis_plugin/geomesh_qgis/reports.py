"""HTML reports for the results viewer."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qgis.core import QgsProcessingException

if TYPE_CHECKING:
    from collections.abc import Mapping

_FIGURES = ("mean", "median", "p5", "p95", "min", "max")

# The results viewer supports only a small part of CSS.
_STYLE = """
body { font-family: sans-serif; }
th, td { padding: 3px 10px; text-align: right; }
th.name, td.name { text-align: left; }
th { border-bottom: 1px solid #888888; }
tr.key td { font-weight: bold; }
"""
_KEY_MEASURES = ("ki", "min_angle", "shape")


def quality_report(name: str, summary: Mapping[str, Any], unit: str) -> str:
    """Return a table of the quality measures of a mesh.

    Parameters
    ----------
    name : str
        Name of the mesh.
    summary : mapping
        Summary from `geomesh quality`.
    unit : str
        Unit of lengths.
    """
    head = "".join(f"<th>{figure}</th>" for figure in _FIGURES)
    rows = "".join(
        f'<tr{" class=key" if measure in _KEY_MEASURES else ""}><td class="name">{measure}</td>'
        + "".join(f"<td>{_spell(values[figure])}</td>" for figure in _FIGURES)
        + "</tr>"
        for measure, values in summary["measures"].items()
    )
    small = "".join(
        f"<li>{share or 0:.2%} of the triangles have an angle below {limit}°</li>"
        for limit, share in summary["share_min_angle_under"].items()
    )
    body = (
        f"<p>{summary['nodes']:,} nodes, {summary['triangles']:,} triangles; lengths in {unit}.</p>"
        f'<table cellspacing="0"><tr><th class="name">measure</th>{head}</tr>{rows}</table>'
        f"<ul>{small}"
        f"<li>Ki / √(area / nodes) = {_spell(summary['ki_normalised'])}, "
        "which, unlike Ki, does not depend on the number of nodes</li></ul>"
        f"<p>{escape(summary['labelling'])}.</p>"
    )
    return _page(f"Quality of {name}", body)


def picture_report(title: str, picture: Path) -> str:
    """Return a page that shows a picture."""
    uri = escape(picture.absolute().as_uri())
    if picture.suffix.lower() == ".pdf":
        return _page(title, f'<p><a href="{uri}">{escape(picture.name)}</a></p>')
    return _page(title, f'<p><a href="{uri}"><img src="{uri}" width="800"/></a></p>')


def volume_report(name: str, base: str, rows: Mapping[str, str]) -> str:
    """Return a table of volumes and areas.

    Parameters
    ----------
    name : str
        Name of the TIN.
    base : str
        What the volume is measured from.
    rows : mapping of str to str
        Numbers with their units, by what they are.
    """
    cells = "".join(
        f'<tr><td class="name">{escape(label)}</td><td>{escape(value)}</td></tr>'
        for label, value in rows.items()
    )
    return _page(
        f"Volume of {name}",
        f'<p>Over {escape(base)}:</p><table cellspacing="0">{cells}</table>',
    )


def save_report(page: str, path: str) -> None:
    """Write a report.

    Raises
    ------
    QgsProcessingException
        If it cannot be written. The text is one line.
    """
    try:
        Path(path).write_text(page, encoding="utf-8")
    except OSError as error:
        raise QgsProcessingException(
            f"The report {path} cannot be written: {error.strerror}; choose another file."
        ) from error


def _page(title: str, body: str) -> str:
    return (
        f'<html><head><meta charset="utf-8"/><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body><h2>{escape(title)}</h2>{body}</body></html>\n"
    )


def _spell(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
