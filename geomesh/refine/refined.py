"""Begin and end of refinement: from a triangulation to a part, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.mesh.topology import edge_keys, neighbours
from geomesh.refine.parts import Part, has_two_fans
from geomesh.refine.patch import FREE, STAYS, TWO_FANS

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Ids, Mask, Points, Triangles
    from geomesh.refine.units import Units


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined triangulation.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
        Oriented as those of the start.
    values : float64 (N, B)
        Values of the linear surface, in the raster's units.
    came_from : int32 (N,)
        Number of the node in the start; -1 for new nodes.
    constraints : int32 (C, 2)
        Pairs of nodes that are hard edges: the outline and breaklines.
    in_time : bool
        False if refinement ended early.
    """

    nodes: Points
    triangles: Triangles
    values: Floats
    came_from: Ids
    constraints: Ids
    in_time: bool


def start_part(
    nodes: Points, triangles: Triangles, constraints: Ids, stays: Mask, bands: int
) -> Part:
    """Return a mesh as one part, without values.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates on the lattice of 1/256 pixel.
    triangles : int32 (T, 3)
        With positive areas in pixel coordinates.
    constraints : int32 (C, 2)
        Pairs of nodes whose edges must stay. The boundary always stays.
    stays : bool (N,)
        Nodes that neither move nor vanish.
    bands : int
    """
    across = neighbours(triangles)
    hard = across < 0
    if len(constraints):
        keys = np.unique(edge_keys(constraints))
        for k in range(3):
            sides = edge_keys(triangles[:, [(k + 1) % 3, (k + 2) % 3]])
            place = np.minimum(np.searchsorted(keys, sides), len(keys) - 1)
            hard[:, k] |= keys[place] == sides
    held = np.where(stays, STAYS, FREE)
    held[has_two_fans(triangles, across, len(nodes))] = TWO_FANS
    return Part(
        ids=np.arange(len(nodes), dtype=np.int32),
        points=np.array(nodes, np.float64),
        values=np.zeros((len(nodes), bands)),
        held=held.astype(np.uint8),
        triangles=triangles,
        across=across,
        hard=hard.astype(np.uint8),
    )


def finished(part: Part, units: Units, *, in_time: bool) -> Refined:
    """Return a part as arrays in the raster's units, in an order that is easy to read.

    Nodes are sorted by y, then x; a triangle begins with its lowest node, and triangles are
    sorted by their nodes.
    """
    order = np.lexsort((part.points[:, 0], part.points[:, 1]))
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    triangles = number[part.triangles]
    first = triangles.argmin(axis=1)[:, None]
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    row, side = np.nonzero(part.hard)
    ends = [number[part.triangles[row, (side + k) % 3]] for k in (1, 2)]
    constraints = np.unique(np.sort(np.column_stack(ends), axis=1), axis=0)
    return Refined(
        nodes=part.points[order],
        triangles=triangles[np.lexsort((triangles[:, 1], triangles[:, 0]))],
        values=units.raw(part.values[order]),
        came_from=part.ids[order],
        constraints=constraints.reshape(-1, 2),
        in_time=in_time,
    )
