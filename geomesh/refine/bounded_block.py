"""BoundedBlock: refine one part of a mesh in place, with few nodes and errors within a bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.refine.bound import BOUND, measure_bound
from geomesh.refine.bound_flip import flip_in_bound
from geomesh.refine.bound_insert import insert_violating
from geomesh.refine.bound_merge import find_merges, merge_widest
from geomesh.refine.bound_move import new_system, relax_in_bound
from geomesh.refine.load import grown, ids_of, own_nodes, part_of, patch_of
from geomesh.refine.patch import new_star, room_for
from geomesh.refine.split import new_log

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats
    from geomesh.refine.parts import Part

# A triangle is split in a batch if its error is at least this share of its neighbours' errors.
_SHARE = 0.9


class BoundedBlock:
    """A part of a mesh with its image, refined in place.

    Parameters
    ----------
    part : Part
        The triangles, with values in units of the bound at the nodes.
    image : float64 (B, h, w)
        In units of the bound: each band divided by the error that is allowed in it. NaN where a
        pixel is not valid.
    floor : float
        `sharpness` below which no triangle may fall.
    """

    def __init__(self, part: Part, image: Floats, floor: float) -> None:
        self.image, self.floor = image, floor
        self._stars, self._log = (new_star(), new_star(), new_star()), new_log()
        bands = part.values.shape[1]
        self._system, self._interval = new_system(bands), np.zeros((4, bands))
        self._backwards = False
        self._load(part, 64)

    def _load(self, part: Part, room: int) -> None:
        self.patch = patch_of(part, room)
        n, m = len(self.patch.points), len(self.patch.triangles)
        self.values, self.ids = grown(part.values, n), ids_of(part, n)
        self._measured = (np.zeros(m), np.zeros(m), np.zeros((m, 2), np.int64))
        self._is_measured = False

    def part(self) -> Part:
        """Return the refined part, without unused nodes; shared nodes stay first, in order."""
        return part_of(self.patch, self.values, self.ids)

    @property
    def own(self) -> int:
        """Number of nodes that only this part has."""
        return own_nodes(self.patch)

    @property
    def errors(self) -> Floats:
        """Greatest error of each triangle, in units of the bound; 0 if it has no pixel."""
        if not self._is_measured:
            measure_bound(self.patch, self.values, self.image, *self._measured)
            self._is_measured = True
        return self._measured[0][: self.patch.size[1]]

    @property
    def worst(self) -> float:
        """Greatest error, in units of the bound."""
        return float(self.errors.max(initial=0.0))

    @property
    def violations(self) -> int:
        """Number of triangles with a pixel out of bounds."""
        return int(np.count_nonzero(self.errors > BOUND))

    @property
    def below_floor(self) -> int:
        """Number of triangles whose smallest angle is below the floor."""
        patch = self.patch
        rows = patch.size[1]
        corners = patch.points[patch.triangles[:rows][patch.alive[:rows]]]
        sides = np.roll(corners, -1, axis=1) - corners
        doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
        squares = np.sort((sides**2).sum(axis=2), axis=1)
        return int(np.count_nonzero(doubled**2 < self.floor * squares[:, 1] * squares[:, 2]))

    def insert(self, rounds: int) -> int:
        """Insert nodes until nothing violates the bound; return how many triangles still do."""
        for _ in range(rounds):
            order = self._worst_nearby()
            if not room_for(self.patch, len(order)):
                self._load(self.part(), 4 * len(order))
                order = self._worst_nearby()
            if not len(order) or not self._insert(order):
                break
        return self.violations

    def _worst_nearby(self) -> NDArray[np.int64]:
        """Return the violating triangles that are nearly the worst among their neighbours."""
        errors = self.errors
        bad = np.flatnonzero(errors > BOUND)
        across = self.patch.across[bad]
        nearby = np.where(across >= 0, errors[across], 0.0).max(axis=1)
        bad = bad[errors[bad] >= _SHARE * nearby]
        return bad[np.argsort(-errors[bad], kind="stable")]

    def _insert(self, order: NDArray[np.int64]) -> int:
        touched = np.zeros(len(self.patch.triangles), np.bool_)
        return insert_violating(
            *(self.patch, self.values, self.image, self._stars[0], self._log),
            *self._measured,
            *(order, touched, self._interval, self.floor),
        )

    def relax(self) -> int:
        """Lower the errors near the bound by moving nodes; return how many changed."""
        self._is_measured = False
        self._backwards = not self._backwards
        return relax_in_bound(
            *(self.patch, self.values, self.image, self._stars[0], self._system),
            *(self.floor, not self._backwards),
        )

    def flip(self, passes: int = 3) -> int:
        """Flip edges where that lowers the errors near the bound; return how many."""
        changed = np.zeros(len(self.errors), np.int64)
        return flip_in_bound(
            *(self.patch, self.values, self.image, *self._measured, changed),
            *(self.floor, passes),
        )

    def collapse(self) -> int:
        """Merge nodes with neighbours as far as the bound allows; return how many vanished."""
        self._is_measured = False
        nodes = self.patch.size[0]
        width, target = np.empty(nodes), np.empty(nodes, np.int64)
        common = (self.patch, self.values, self.image, *self._stars, self._interval, self.floor)
        find_merges(*common, width, target)
        order = np.argsort(-width, kind="stable")
        order = order[width[order] >= 0]
        return merge_widest(*common, width, target, order)
