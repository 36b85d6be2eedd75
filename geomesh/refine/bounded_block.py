"""BoundedBlock: refine one part of a mesh in place, with few nodes and errors within a bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.refine.bound import BOUND, measure_bound
from geomesh.refine.bound_flip import flip_in_bound
from geomesh.refine.bound_insert import insert_violating
from geomesh.refine.bound_merge import merge_nodes
from geomesh.refine.bound_move import new_system, relax_in_bound
from geomesh.refine.load import grown, ids_of, own_nodes, part_of, patch_of
from geomesh.refine.patch import room_for
from geomesh.refine.split import new_log
from geomesh.refine.star import new_star

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Mask
    from geomesh.refine.parts import Part

# A triangle is split in a batch if its error is at least this share of its neighbours' errors.
_SHARE = 0.9

# Share of the nodes that a round must remove for another one to follow.
_FEW = 0.003

# Most batches of one insertion; a few dozens suffice almost always.
_INSERTIONS = 500

# Nodes are moved this often where the floor refuses a node, to try again.
_TRIES = 8


class BoundedBlock:
    """A part of a mesh with its image, refined in place.

    Parameters
    ----------
    part : Part
        The triangles, with values in units of the bound at the nodes; all are finite.
    image : float64 (B, h, w)
        In units of the bound: each band divided by the error that is allowed in it. NaN where a
        pixel is not valid.
    floor : float
        `sharpness` below which no triangle may fall.

    Raises
    ------
    ValueError
        If a node has a value that is not finite: errors next to it would go unseen.
    """

    def __init__(self, part: Part, image: Floats, floor: float) -> None:
        if not np.isfinite(part.values).all():
            raise ValueError("all nodes need finite values")
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
            self._measure()
        return self._measured[0][: self.patch.size[1]]

    def _measure(self) -> None:
        measure_bound(self.patch, self.values, self.image, *self._measured)
        self._is_measured = True

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

    def insert(self, rounds: int = _INSERTIONS) -> int:
        """Insert nodes until nothing violates the bound; return how many triangles still do."""
        refused = 0
        for _ in range(rounds):
            order = self._worst_nearby()
            if not room_for(self.patch, len(order)):
                self._load(self.part(), 4 * len(order))
                order = self._worst_nearby()
            if not len(order):
                break
            if not self._insert(order):
                refused += 1
                if refused > _TRIES:
                    break
                near = self._near_violations()
                self._relax(np.flatnonzero(near))
                rows = self.patch.size[1]
                nearby = near[self.patch.triangles[:rows]].any(axis=1)
                self._flip(np.where(nearby, 0, -1), 3)
        return self.violations

    def _worst_nearby(self) -> NDArray[np.int64]:
        """Return the violating triangles that are nearly the worst among their neighbours."""
        errors = self.errors
        bad = np.flatnonzero(errors > BOUND)
        across = self.patch.across[bad]
        nearby = np.where(across >= 0, errors[across], 0.0).max(axis=1)
        bad = bad[errors[bad] >= _SHARE * nearby]
        order: NDArray[np.int64] = bad[np.argsort(-errors[bad], kind="stable")]
        return order

    def _insert(self, order: NDArray[np.int64]) -> int:
        touched = np.zeros(len(self.patch.triangles), np.bool_)
        worst, total, pixel = self._measured
        return insert_violating(
            self.patch,
            self.values,
            self.image,
            self._stars[0],
            self._log,
            worst,
            total,
            pixel,
            order,
            touched,
            self._interval,
            self.floor,
        )

    def _near_violations(self) -> Mask:
        """Return which nodes belong to violating triangles or are next to one that does."""
        triangles = self.patch.triangles[: len(self.errors)]
        near = np.zeros(self.patch.size[0], np.bool_)
        near[triangles[self.errors > BOUND]] = True
        near[triangles[near[triangles].any(axis=1) & self.patch.alive[: len(triangles)]]] = True
        return near

    def relax(self) -> int:
        """Lower the errors near the bound by moving nodes; return how many changed."""
        self._backwards = not self._backwards
        nodes = np.arange(self.patch.size[0])
        return self._relax(nodes if self._backwards else nodes[::-1].copy())

    def _relax(self, nodes: NDArray[np.int64]) -> int:
        self._is_measured = False
        return relax_in_bound(
            *(self.patch, self.values, self.image, self._stars[0], self._system),
            *(nodes, self.floor),
        )

    def flip(self, passes: int = 3) -> int:
        """Flip edges where that lowers the errors near the bound; return how many."""
        return self._flip(np.zeros(self.patch.size[1], np.int64), passes)

    def _flip(self, changed: NDArray[np.int64], passes: int) -> int:
        if not self._is_measured:
            self._measure()
        return flip_in_bound(
            *(self.patch, self.values, self.image, *self._measured, changed),
            *(self.floor, passes),
        )

    def collapse(self, *, placing: bool = False) -> int:
        """Merge nodes with neighbours as far as the bound allows; return how many vanished.

        `placing` also looks for places of merged nodes by Newton steps, which takes longer.
        """
        self._is_measured = False
        nodes = self.patch.size[0]
        width, target = np.full(nodes, -1.0), np.full(nodes, -1)
        common = (self.patch, self.values, self.image, *self._stars, self._interval)
        merge_nodes(*common, self.floor, np.arange(nodes), width, target, False)
        order = np.argsort(-width, kind="stable")
        order = order[width[order] >= 0]
        merged = merge_nodes(*common, self.floor, order, width, target, True)
        if placing:
            # Imported here, so that it is compiled only when used.
            from geomesh.refine.bound_place import place_merged

            merged += place_merged(*common, self._system, self.floor, np.flatnonzero(width < 0))
        return merged

    def simplify(self, rounds: int, placing_from: int | None = None) -> int:
        """Move nodes, flip edges and merge nodes, several times; return how many vanished.

        From the round `placing_from` on, places are found by Newton steps too. In the end all
        pixels are measured anew; should one be out of bounds, nodes are inserted there.
        """
        merged = 0
        for i in range(rounds):
            self.relax()
            self.flip()
            placing = placing_from is not None and i >= placing_from
            now = self.collapse(placing=placing)
            merged += now
            if now <= _FEW * self.own and (placing or placing_from is None):
                break
        self.insert(_INSERTIONS)
        return merged
