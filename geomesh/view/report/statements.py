"""The certificate of a mesh in plain words, and how far its pixels are from the surface."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from geomesh.view.report.content import Statement
from geomesh.view.report.errors import differs, refinement_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.mesh.certificate import Certificate
    from geomesh.mesh.refinement import BandAccuracy
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.view.report.errors import Errors

# Bands whose errors are told in a sentence.
_MOST_BANDS = 12

# The names of checks, and what they say in plain words.
_SENTENCES = (
    (r"all nodes exist", "Every corner of a triangle is a node of the mesh."),
    (
        r"nodes are finite, distinct and used",
        "Every node has a place of its own and is the corner of a triangle.",
    ),
    (
        r"every triangle is counter-clockwise.*",
        "Every triangle has an area, and its corners are in counter-clockwise order on the map.",
    ),
    (
        r"every inner edge is used once.*",
        "Triangles meet edge to edge: every inner edge has one triangle on each side.",
    ),
    (
        r"the triangles cover the domain.*",
        "The triangles fill the area of the mesh without gaps or overlaps: their areas add up.",
    ),
    (
        r"the boundary is the domain's outline.*",
        "The border of the mesh is the outline of its area, and every line that has to be an edge "
        "is one.",
    ),
    (
        r"Euler number",
        "The mesh hangs together as its area does: it has as many parts and holes.",
    ),
    (
        r"triangles go once around every node",
        "Around every node, the triangles go once and do not fold over.",
    ),
    (
        r"empty circumcircles.*",
        "The mesh is a Delaunay triangulation: no circle through the corners of a triangle "
        "contains a node that can be seen from inside the triangle.",
    ),
    (
        r"each pixel of the domain lies in one triangle.*",
        "Every pixel of the area is in exactly one triangle, and no triangle has a pixel outside "
        "the area.",
    ),
    (
        r"the mesh has the number of nodes that was wanted",
        "The mesh has exactly the number of nodes that was asked for.",
    ),
    (
        r"no valid pixel is farther from the surface than the bound",
        "No valid pixel is farther from the surface than the error bound.",
    ),
    (
        r"the root mean square error of each band is at most its goal",
        "The root mean square error of each band is at most what was asked for.",
    ),
    (
        r"the smallest angle is at least (\S+) degrees",
        r"No angle of a triangle is smaller than \1 degrees.",
    ),
    (
        r"the smallest angle is at least (\S+) degrees, except.*",
        r"No angle is smaller than \1 degrees, except in triangles that touch the outline, or "
        r"lines and nodes that have to stay.",
    ),
    (
        r"the nodes, triangles and values are those whose errors were measured",
        "Nodes, triangles and values are the same, to the last bit, as those whose errors were "
        "measured.",
    ),
    (
        r"the errors of the triangles add up to those recorded",
        "The errors of the single triangles add up to those of the whole mesh.",
    ),
)


def in_words(certificate: Certificate) -> Iterator[Statement]:
    """Yield a sentence for each check of a certificate, then its facts about missed goals."""
    for check in certificate.checks:
        passed: bool | None = check.passed
        if check.detail.startswith("not checked"):
            passed = None
        yield Statement(_sentence(check.name), check.detail, passed)
    for fact in certificate.facts:
        if "was not reached" in fact.name:
            yield Statement(_sentence(fact.name), fact.detail)


def _sentence(name: str) -> str:
    for pattern, sentence in _SENTENCES:
        match = re.fullmatch(pattern, name)
        if match:
            return match.expand(sentence)
    return f"{name[:1].upper()}{name[1:]}."


def about_errors(mesh: TriangleMesh, errors: Errors | None) -> Iterator[str]:
    """Yield sentences about the errors of a mesh: the bound that it keeps, and what it reaches."""
    if errors is None:
        yield (
            "How far the pixels are from the surface is not recorded in this mesh. A report that "
            "is made with the raster measures it."
        )
        return
    refinement = refinement_of(mesh)
    units = (
        {} if mesh.provenance is None else {b.name: b.unit for b in mesh.provenance.source.bands}
    )
    limits: dict[str, float] = {}
    if refinement is not None and refinement.goal == "max_error":
        names = (band.name for band in refinement.bands)
        limits = dict(zip(names, refinement.limits, strict=True))
    for band in errors.bands[:_MOST_BANDS]:
        yield _about_band(band, units.get(band.name, ""), limits.get(band.name))
    if len(errors.bands) > _MOST_BANDS:
        yield f"There are {len(errors.bands) - _MOST_BANDS} more bands."
    origin = "measured for this report" if errors.measured else "recorded when the mesh was made"
    yield f"These errors are those of {errors.pixels:,} valid pixels, {origin}."
    if errors.measured and refinement is not None:
        yield (
            "They are not those that the mesh records: the raster is not the one from which the "
            "mesh was made."
            if differs(mesh, errors)
            else "They are those that the mesh records."
        )
    elif errors.measured:
        yield "The values at the nodes are those with the smallest squared error for these pixels."
    if refinement is not None and refinement.note:
        reached = "Note" if refinement.reached else "The goal was not reached"
        yield f"{reached}: {refinement.note}."


def _about_band(band: BandAccuracy, unit: str, limit: float | None) -> str:
    unit = f" {unit}" if unit else ""
    greatest = f"{band.max_error:.6g}{unit}"
    rest = (
        f"The root mean square error is {band.rmse:.4g}{unit}"
        + (f", which is a PSNR of {band.psnr:.2f} dB" if -500 < band.psnr < 500 else "")
        + "."
    )
    if limit is None:
        return (
            f"The pixel of band {band.name} that is farthest from the surface differs by "
            f"{greatest}. {rest}"
        )
    if band.max_error <= limit:
        return (
            f"No valid pixel of band {band.name} differs by more than {limit:.6g}{unit} from the "
            f"surface; the greatest difference is {greatest}. {rest}"
        )
    return (
        f"Pixels of band {band.name} differ from the surface by up to {greatest}, which is more "
        f"than the bound of {limit:.6g}{unit}. {rest}"
    )
