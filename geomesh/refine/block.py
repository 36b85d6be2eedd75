"""Block: refine one part of a mesh in place, by the least squares of its pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.refine.flip_edges import flip_edges
from geomesh.refine.insert import insert_where_worst
from geomesh.refine.load import grown, ids_of, own_nodes, part_of, patch_of
from geomesh.refine.moments import LINEAR, OF_BAND, OF_PIXELS, Image, Surface, measure_all
from geomesh.refine.move import move_nodes
from geomesh.refine.node_system import new_room
from geomesh.refine.patch import room_for
from geomesh.refine.remove import NEVER, remove_nodes
from geomesh.refine.split import new_log
from geomesh.refine.star import new_star

if TYPE_CHECKING:
    from geomesh.arrays.types import Counts, Floats
    from geomesh.refine.parts import Part

# Squared error that a flip must save, so that equal diagonals are not flipped back and forth.
_GAIN = 0.5

# Batches of one growth are tried again while triangles refuse nodes.
_TRIES = 4


class Block:
    """A part of a mesh with its image, refined in place.

    Parameters
    ----------
    part : Part
        The triangles, with values in the image's units at the nodes.
    image : Image
    floor : float
        `sharpness` below which no triangle may fall.
    model : int
        `LINEAR` or `CONSTANT`.
    """

    def __init__(self, part: Part, image: Image, floor: float, model: int = LINEAR) -> None:
        self.image, self.floor, self.model = image, floor, model
        self._stars, self._log = (new_star(), new_star()), new_log()
        self._room = new_room(part.values.shape[1])
        self._load(part, 64)

    def _load(self, part: Part, room: int) -> None:
        self.patch = patch_of(part, room)
        n, m = len(self.patch.points), len(self.patch.triangles)
        width = OF_PIXELS + OF_BAND * part.values.shape[1]
        self.surface = Surface(
            grown(part.values, n), np.zeros((3 * m, width)), np.zeros((m, width)), np.zeros(m)
        )
        self.ids = ids_of(part, n)
        measure_all(self.patch, self.surface, self.image, self.model)

    def part(self) -> Part:
        """Return the refined part, without unused nodes; shared nodes stay first, in order."""
        return part_of(self.patch, self.surface.values, self.ids)

    @property
    def own(self) -> int:
        """Number of nodes that only this part has."""
        return own_nodes(self.patch)

    @property
    def error(self) -> float:
        """Sum of the squared errors."""
        return float(np.maximum(self.surface.errors[: self.patch.size[1]], 0).sum())

    @property
    def pixels(self) -> int:
        """Number of valid pixels."""
        rows = self.patch.size[1]
        return int(np.rint(self.surface.moments[:rows, 0][self.patch.alive[:rows]].sum()))

    def relax(self, times: int, *, moving: bool = True) -> None:
        """Improve the values of the nodes, and their positions if `moving`, several times."""
        patch, surface, image, star = self.patch, self.surface, self.image, self._stars[0]
        for turn in range(times):
            backwards = turn % 2 == 1
            if self.model == LINEAR:
                move_nodes(patch, surface, image, star, self._room, moving, self.floor, backwards)
            elif moving:
                # Imported here: only few need the kernel, which takes a second to compile.
                from geomesh.refine.shift import shift_nodes

                shift_nodes(patch, surface, image, star, self._room, self.floor, backwards)

    def flip(self, passes: int = 3) -> None:
        """Flip edges where that lowers the error."""
        changed = np.zeros(self.patch.size[1], np.int64)
        flip_edges(
            *(self.patch, self.surface, self.image, self._room, changed),
            *(self.floor, _GAIN, passes, self.model),
        )

    def grow(self, target: int, batches: int) -> None:
        """Insert nodes until the block has `target` nodes of its own, in a few batches."""
        steps = np.geomspace(max(self.own, 4), max(target, 4), batches + 1)[1:]
        for wanted in np.minimum(np.rint(steps).astype(int), target).tolist():
            for _ in range(_TRIES):
                missing = wanted - self.own
                if missing <= 0 or self._insert(missing) == 0:
                    break
                self.relax(1, moving=False)
                self.flip(2)
                self.relax(1)

    def _insert(self, wanted: int) -> int:
        if not room_for(self.patch, wanted):
            self._load(self.part(), 2 * wanted)
        rows = self.patch.size[1]
        order = np.argsort(-self.surface.errors[:rows], kind="stable")
        touched = np.zeros(len(self.patch.triangles), np.bool_)
        return insert_where_worst(
            self.patch,
            self.surface,
            self.image,
            self._log,
            order,
            touched,
            self.floor,
            wanted,
            self.model,
        )

    def shrink(self, wanted: int) -> int:
        """Remove up to `wanted` nodes that are needed least; return how many."""
        nodes = int(self.patch.size[0])
        costs = np.full(nodes, NEVER)
        self._remove(np.arange(nodes), costs, 0)
        order = np.argsort(costs, kind="stable")
        order = order[costs[order] < NEVER]
        return self._remove(order, costs, wanted) if wanted > 0 else 0

    def _remove(self, order: Counts, costs: Floats, wanted: int) -> int:
        locked = np.zeros(len(costs), np.bool_)
        return remove_nodes(
            *(self.patch, self.surface, self.image, *self._stars, self._room, order, locked),
            *(costs, self.floor, wanted, self.model),
        )

    def adjust(self, target: int, batches: int) -> None:
        """Insert or remove nodes until the block has `target` nodes of its own."""
        # One batch removes no neighbours, so a fraction of the nodes.
        while self.own > target:
            if self.shrink(self.own - target) == 0:
                break
        self.grow(target, batches)

    def replace(self, share: float, target: int) -> None:
        """Remove a share of the nodes, those needed least, and insert others elsewhere."""
        self.relax(2)
        self.flip()
        self.shrink(int(share * target))
        self.grow(target, 2)

    def finish(self, times: int) -> None:
        """Move nodes and flip edges a few more times, and then improve the values."""
        for _ in range(times):
            self.relax(2)
            self.flip()
        self.relax(3, moving=False)
