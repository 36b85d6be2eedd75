"""The checks that the certificate of a refined mesh has in addition, and what it reaches.

They use the columns of the mesh and what was measured when it was made, and no pixels. So
they hold, or fail, in the same way for a mesh that is read from a file. The digest says that
the mesh and its values are those that were measured; the columns of the triangles, that the
recorded figures are theirs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geomesh.errors import MeshFileError
from geomesh.mesh.certificate import Certificate, Check, Fact
from geomesh.mesh.quality import measure_each
from geomesh.mesh.refinement import BandAccuracy, Refinement, surface_digest, surface_values

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.table import Table
    from geomesh.arrays.types import Floats, Points, Triangles

# In degrees. An angle that is equal to the floor may be rounded to less.
ANGLE_TOLERANCE = 1e-6

# Relative difference of two sums of the same squares in another order.
_SUM_TOLERANCE = 1e-9

_BOUND = "no valid pixel is farther from the surface than the bound"
_RMSE = "the root mean square error of each band is at most its goal"


def with_refinement(
    certificate: Certificate,
    refinement: Refinement,
    *,
    nodes: Points,
    triangles: Triangles,
    plane_nodes: Points,
    held: NDArray[np.bool_],
    node_table: Table,
    triangle_table: Table,
) -> Certificate:
    """Return a certificate with the checks and facts of a refinement.

    Parameters
    ----------
    certificate : Certificate
    refinement : Refinement
    nodes, plane_nodes : float64 (N, 2)
        In pixels of the source, and in the plane in which angles are measured.
    triangles : int32 (T, 3)
    held : bool (N,)
        The nodes that refinement cannot move or remove as it likes.
    node_table, triangle_table : Table
    """
    reached = _goal(refinement, len(nodes))
    values = node_table if refinement.model == "linear" else triangle_table
    checks = (
        *((reached,) if isinstance(reached, Check) else ()),
        _check_angles(plane_nodes, triangles, held, refinement.min_angle_floor),
        _check_surface(nodes, triangles, values, refinement),
        _check_sums(triangle_table, refinement),
    )
    facts = (
        *((reached,) if isinstance(reached, Fact) else ()),
        *(
            Fact(f"accuracy of {band.name}", _spell(band, refinement.pixels))
            for band in refinement.bands
        ),
    )
    return replace(certificate, checks=(*certificate.checks, *checks), facts=facts)


def _goal(refinement: Refinement, node_count: int) -> Check | Fact:
    """Check what was to be reached; if it was not, only say what was."""
    if refinement.goal == "nodes":
        detail = f"{node_count} nodes of {refinement.budget}"
        if not refinement.reached:
            return Fact("the number of nodes was not reached", f"{detail}: {refinement.note}")
        holds = node_count == refinement.budget
        return Check("the mesh has the number of nodes that was wanted", holds, detail)
    name, part = (_BOUND, "max_error") if refinement.goal == "max_error" else (_RMSE, "rmse")
    pairs = list(zip(refinement.bands, refinement.limits, strict=True))
    detail = "; ".join(f"{b.name}: {getattr(b, part):.6g} of {limit:.6g}" for b, limit in pairs)
    if not refinement.reached:
        short = "bound" if part == "max_error" else "root mean square error"
        return Fact(f"the {short} was not reached", f"{detail}: {refinement.note}")
    holds = all(getattr(band, part) <= limit for band, limit in pairs)
    return Check(name, holds, f"{detail}; {refinement.pixels} valid pixels")


def _check_angles(
    plane_nodes: Points, triangles: Triangles, held: NDArray[np.bool_], floor: float
) -> Check:
    """Check the smallest angles.

    Refinement cannot move the outline, breaklines and features that it has to keep. A triangle
    with such a node may have to be thinner than the floor. Any other may not.
    """
    angles = measure_each(plane_nodes, triangles, ("min_angle",))["min_angle"]
    thin = ~(angles >= floor - ANGLE_TOLERANCE)
    name = f"the smallest angle is at least {floor:g} degrees"
    if not thin.any():
        return Check(name, True, f"{angles.min():.4f} degrees in {len(angles)} triangles")
    kept = held[triangles].any(axis=1)
    others = float(angles[~kept].min(initial=math.inf))
    below, free = int(thin.sum()), int((thin & ~kept).sum())
    rest = f", {others:.4f} in the {int((~kept).sum())} that do not" if not kept.all() else ""
    return Check(
        f"{name}, except next to the outline and to lines and nodes that are kept",
        free == 0,
        f"{below} of {len(angles)} triangles are below, {below - free} of them touch these; "
        f"the smallest angle is {angles.min():.4f} degrees{rest}",
    )


def _check_surface(
    nodes: Points, triangles: Triangles, table: Table, refinement: Refinement
) -> Check:
    name = "the nodes, triangles and values are those whose errors were measured"
    try:
        values = surface_values(table, [b.name for b in refinement.bands], refinement.model)
    except MeshFileError as error:
        return Check(name, False, str(error))
    digest = surface_digest(nodes, triangles, values)
    same = digest == refinement.digest
    return Check(name, same, digest if same else f"{digest}, expected {refinement.digest}")


def _check_sums(table: Table, refinement: Refinement) -> Check:
    """Compare the errors of the triangles with the recorded ones of all pixels."""
    name = "the errors of the triangles add up to those recorded"
    wanted = [f"{b.name}_{part}" for b in refinement.bands for part in ("max_error", "rmse")]
    missing = [column for column in ("count", *wanted) if column not in table]
    if missing:
        return Check(name, False, f"the triangles have no {', '.join(missing)}")
    count = table["count"]
    own = count > 0
    pixels, differing = int(count.sum()), []
    for band in refinement.bands:
        greatest = float(table[f"{band.name}_max_error"][own].max(initial=0))
        rmse = _combined(table[f"{band.name}_rmse"][own], count[own])
        same = greatest == band.max_error
        if not (same and math.isclose(rmse, band.rmse, rel_tol=_SUM_TOLERANCE)):
            differing.append(
                f"{band.name}: greatest error {greatest!r}, rmse {rmse!r}, recorded "
                f"{band.max_error!r} and {band.rmse!r}"
            )
    if pixels != refinement.pixels:
        differing.append(f"{pixels} pixels, recorded {refinement.pixels}")
    detail = "; ".join(differing) or f"{len(refinement.bands)} bands, {pixels} pixels"
    return Check(name, not differing, detail)


def _combined(rmse: Floats, count: NDArray[np.int64]) -> float:
    """Return the root mean square error of all pixels from those of the triangles."""
    largest = float(rmse.max(initial=0))
    if not 0 < largest < math.inf:  # also if it is NaN
        return largest
    # Relative to the largest, because squares of large errors could overflow.
    mean = float((count * np.square(rmse / largest)).sum()) / float(count.sum())
    return largest * math.sqrt(mean)


def _spell(band: BandAccuracy, pixels: int) -> str:
    return (
        f"greatest error {band.max_error:.6g}, rmse {band.rmse:.6g}, PSNR {band.psnr:.2f} dB "
        f"at {pixels} valid pixels"
    )
