"""Make parts of meshes for refinement, and check them with plain loops."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.refine.block import Block
from geomesh.refine.moments import CONSTANT, LINEAR, Surface, image_of, measure_all
from geomesh.refine.node_system import RIDGE
from geomesh.refine.patch import BORDER, OTHER_PATCH
from geomesh.refine.refined import start_part

if TYPE_CHECKING:
    from geomesh.refine.parts import Part
    from geomesh.refine.patch import Patch

MODELS = [LINEAR, CONSTANT]


def degrees(angle: float) -> float:
    """Return the floor of the kernels for a smallest angle."""
    return float(np.sin(np.radians(angle)) ** 2)


def grid_part(
    rng: np.random.Generator,
    cols: int = 5,
    rows: int = 4,
    spacing: int = 9,
    *,
    bands: int = 1,
    notch: bool = False,
    touches: bool = False,
    breaks: int = 0,
    stays: float = 0,
) -> Part:
    """Return a mesh of cols x rows uneven cells, with each cell cut along a random diagonal.

    Nodes are relative to the centre of the first pixel, on the lattice of 1/256 pixel or coarser.

    Parameters
    ----------
    notch : bool
        Leave out the last cells, so that the outline has corners inside.
    touches : bool
        Leave out two cells that share a corner, where the outline then touches itself.
    breaks : int
        Length of a breakline of random edges; and then a row of nodes is straight and hard too.
    stays : float
        Share of the nodes that stay.
    """
    x, y = (a.ravel() for a in np.meshgrid(np.arange(cols + 1), np.arange(rows + 1)))
    nodes = np.column_stack([x, y]) * float(spacing)
    step = rng.choice([1, 1 / 2, 1 / 256])
    jitter = np.rint(rng.uniform(-0.22, 0.22, nodes.shape) * spacing / step) * step
    on_border = [(x == 0) | (x == cols), (y == 0) | (y == rows)]
    if notch:  # the outline turns inside at these columns and rows
        on_border = [on_border[0] | (x == cols - 2), on_border[1] | (y == rows - 2)]
    middle = rows // 2
    on_border[1] |= (y == middle) & (breaks > 0)
    jitter[np.column_stack(on_border)] = 0
    nodes += jitter
    triangles: list[list[int]] = []
    for row in range(rows):
        for col in range(cols):
            if notch and row >= rows - 2 and col >= cols - 2:
                continue
            if touches and (row, col) in ((0, 1), (1, 2)):
                continue
            a = row * (cols + 1) + col
            b, c, d = a + 1, a + cols + 2, a + cols + 1
            pair = [[a, b, d], [b, c, d]] if rng.random() < 0.5 else [[a, b, c], [a, c, d]]
            triangles += pair
    edges: list[tuple[int, int]] = []
    if breaks:
        length = cols - 2 if notch else cols
        edges += [(middle * (cols + 1) + k, middle * (cols + 1) + k + 1) for k in range(length)]
        at = int(rng.choice(np.unique(triangles)))
        for _ in range(breaks):
            ring = [v for t in triangles if at in t for v in t if v != at]
            then = int(rng.choice(ring))
            edges.append((at, then))
            at = then
    used, corners = np.unique(triangles, return_inverse=True)
    number = np.full(len(nodes), -1, np.int32)
    number[used] = np.arange(len(used))
    constraints = number[np.array(edges, np.int32).reshape(-1, 2)]
    return start_part(
        nodes[used] - 0.5,
        corners.reshape(-1, 3).astype(np.int32),
        constraints,
        rng.random(len(used)) < stays,
        bands,
    )


def picture(
    rng: np.random.Generator, part: Part, *, most: int = 255, missing: float = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return whole numbers (B, h, w), smooth with edges and noise, and a random mask (h, w)."""
    width, height = np.rint(part.points.max(axis=0) + 0.5).astype(int)
    y, x = np.mgrid[:height, :width]
    bands = []
    for _ in range(part.values.shape[1]):
        turn = rng.uniform(0, 2 * np.pi)
        wave = np.sin((x * np.cos(turn) + y * np.sin(turn)) / 7)
        step = np.hypot(x - rng.uniform(0, width), y - rng.uniform(0, height)) < width / 4
        bands.append((wave + 1) / 4 + step / 3 + rng.random((height, width)) / 8)
    return np.rint(np.array(bands) / 1.2 * most), rng.random((height, width)) >= missing


def owned(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return which pixels (h, w) a triangle owns: the half-open rule, in whole numbers.

    A side from (xa, ya) down to (xb, yb) crosses the rows ya <= y < yb. A pixel belongs to the
    triangle if the crossing of exactly one side is at its centre or left of it.
    """
    whole = np.rint(corners * 256).astype(np.int64)
    assert (whole == corners * 256).all()
    y, x = np.mgrid[: shape[0], : shape[1]] * 256
    left = np.zeros(shape, np.int64)
    for k in range(3):
        (xa, ya), (xb, yb) = sorted(whole[[k, (k + 1) % 3]].tolist(), key=lambda p: p[1])
        left += (ya <= y) & (y < yb) & ((y - ya) * (xb - xa) <= (x - xa) * (yb - ya))
    return left == 1


def owned_moments(corners: np.ndarray, bands: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the moments (K,) of a triangle, from its list of pixels."""
    y, x = np.nonzero(owned(corners, valid.shape) & valid)
    sums = [len(x), x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum()]
    for band in bands:
        f = band[y, x]
        sums += [f.sum(), (x * f).sum(), (y * f).sum(), (f * f).sum()]
    return np.array(sums, float)


def pixel_errors(
    points: np.ndarray,
    values: np.ndarray,
    triangles: np.ndarray,
    bands: np.ndarray,
    valid: np.ndarray,
    model: int = LINEAR,
) -> np.ndarray:
    """Return the squared error of each triangle, pixel by pixel."""
    errors = np.zeros(len(triangles))
    for t, triangle in enumerate(triangles):
        y, x = np.nonzero(owned(points[triangle], valid.shape) & valid)
        if len(x) == 0:
            continue
        pixels = bands[:, y, x].T
        if model == CONSTANT:
            shown = pixels.mean(axis=0)
        else:
            corners = np.vstack([points[triangle].T, np.ones(3)])
            weights = np.linalg.solve(corners, np.vstack([x, y, np.ones(len(x))]))
            shown = weights.T @ values[triangle]
        errors[t] = ((pixels - shown) ** 2).sum()
    return errors


def best_step(
    points: np.ndarray,
    values: np.ndarray,
    star: np.ndarray,
    v: int,
    pixels: np.ndarray,
    valid: np.ndarray,
) -> np.ndarray:
    """Return the change of the values of node `v` that fits its triangles best, with the ridge."""
    left, right = [[RIDGE**0.5]], [np.zeros((1, values.shape[1]))]
    for triangle in star:
        y, x = np.nonzero(owned(points[triangle], valid.shape) & valid)
        corners = np.vstack([points[triangle].T, np.ones(3)])
        weights = np.linalg.solve(corners, np.vstack([x, y, np.ones(len(x))])).T
        left.append(weights[:, triangle == v][:, 0])
        right.append(pixels[:, y, x].T - weights @ values[triangle])
    return np.linalg.lstsq(np.concatenate(left)[:, None], np.concatenate(right), rcond=None)[0][0]


def smallest(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the squared sine of the smallest angle, from the sides and the law of cosines."""
    corners = points[triangles]
    sides = np.sort(
        [
            np.linalg.norm(np.subtract(*corners[:, s].swapaxes(0, 1)), axis=1)
            for s in ([0, 1], [1, 2], [2, 0])
        ],
        axis=0,
    )
    cosine = (sides[1] ** 2 + sides[2] ** 2 - sides[0] ** 2) / (2 * sides[1] * sides[2])
    return float((1 - np.minimum(cosine, 1) ** 2).min())


def hard_lines(points: np.ndarray, triangles: np.ndarray, hard: np.ndarray) -> shapely.Geometry:
    """Return the hard sides as one geometry, however they are cut into edges."""
    row, side = np.nonzero(hard)
    ends = [points[triangles[row, (side + k) % 3]] for k in (1, 2)]
    return shapely.line_merge(shapely.union_all(shapely.linestrings(np.stack(ends, axis=1))))


def same_lines(one: shapely.Geometry, other: shapely.Geometry) -> bool:
    """Return whether two sets of lines cover the same points, up to rounding."""
    return bool(
        shapely.hausdorff_distance(one, other) < 1e-6 and abs(one.length - other.length) < 1e-6
    )


def check_topology(
    points: np.ndarray, triangles: np.ndarray, across: np.ndarray, hard: np.ndarray
) -> None:
    """Check that triangles are positive, neighbours mutual, and hard sides hard on both sides."""
    assert (points * 256 == np.rint(points * 256)).all()
    assert (across >= OTHER_PATCH).all()
    assert np.isin(hard, [0, 1]).all()
    assert (hard[across == BORDER] == 1).all()
    sides: dict[tuple[int, int], tuple[int, int]] = {}
    for t, (a, b, c) in enumerate(triangles.tolist()):
        (ax, ay), (bx, by), (cx, cy) = points[[a, b, c]]
        assert (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0
        for k, side in enumerate([(b, c), (c, a), (a, b)]):
            assert side not in sides, "two triangles have a side in the same direction"
            sides[side] = (t, k)
    for (a, b), (t, k) in sides.items():
        if (b, a) in sides:
            u, other = sides[b, a]
            assert (across[t, k], across[u, other]) == (u, t)
            assert hard[t, k] == hard[u, other]
        else:
            assert across[t, k] < 0


def in_use(patch: Patch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return triangles, neighbours and hard sides without the rows that are not alive."""
    rows = int(patch.size[1])
    alive = np.flatnonzero(patch.alive[:rows])
    assert not patch.alive[rows:].any()
    place = np.full(rows, -9, np.int64)
    place[alive] = np.arange(len(alive))
    across = patch.across[alive]
    return (
        patch.triangles[alive],
        np.where(across >= 0, place[across], across),
        patch.hard[alive],
    )


def check_patch(patch: Patch) -> None:
    """Check everything that the arrays of a patch must keep."""
    nodes = int(patch.size[0])
    triangles, across, hard = in_use(patch)
    check_topology(patch.points[:nodes], triangles, across, hard)
    used = np.zeros(len(patch.at), bool)
    used[triangles.ravel()] = True
    assert (used[:nodes] == (patch.at[:nodes] >= 0)).all()
    for v in np.flatnonzero(used):
        assert patch.alive[patch.at[v]]
        assert v in patch.triangles[patch.at[v]]


def rounding(block: Block) -> float:
    """Return how far errors may be off: without a floor, triangles are steep needles."""
    return 1e-6 if block.floor else 1e-2


def check_block(block: Block) -> None:
    """Check a block's patch, and that stored moments and errors are those of its pixels."""
    patch, surface, image = block.patch, block.surface, block.image
    check_patch(patch)
    fresh = Surface(surface.values, *(np.zeros_like(array) for array in surface[1:]))
    measure_all(patch, fresh, image, block.model)
    rows = patch.size[1]
    alive = patch.alive[:rows]
    sides = np.repeat(alive, 3)
    np.testing.assert_array_equal(surface.moments[:rows][alive], fresh.moments[:rows][alive])
    np.testing.assert_array_equal(surface.along[: 3 * rows][sides], fresh.along[: 3 * rows][sides])
    found, expected = surface.errors[:rows], fresh.errors[:rows]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=rounding(block))


def brute_error(part: Part, bands: np.ndarray, valid: np.ndarray, model: int = LINEAR) -> float:
    """Return the squared error of a part, pixel by pixel."""
    found = pixel_errors(part.points, part.values, part.triangles, bands, valid, model)
    return float(found.sum())


def outline(part: Part) -> shapely.Geometry:
    """Return the union of the triangles of a part."""
    return shapely.union_all(shapely.polygons(part.points[part.triangles]))


def as_triangles(part: Part) -> set[Any]:
    """Return the triangles by their coordinates, each from its lowest corner on."""
    found = set()
    for corners in part.points[part.triangles].tolist():
        first = corners.index(min(corners))
        found.add(tuple(map(tuple, corners[first:] + corners[:first])))
    return found


def hard_ends(part: Part) -> dict[int, set[int]]:
    """Return the far ends of the hard sides at each node."""
    ends: dict[int, set[int]] = {v: set() for v in range(len(part.points))}
    for t, k in np.argwhere(part.hard).tolist():
        b, c = part.triangles[t, (k + 1) % 3], part.triangles[t, (k + 2) % 3]
        ends[int(b)].add(int(c))
        ends[int(c)].add(int(b))
    return ends


def between(points: np.ndarray, v: int, ends: set[int]) -> bool:
    """Return whether a node lies exactly on the straight line between two others."""
    if len(ends) != 2:
        return False
    one, other = (points[list(ends)] - points[v]).tolist()
    return one[0] * other[1] == one[1] * other[0] and np.dot(one, other) < 0


def sampled(part: Part, bands: np.ndarray) -> np.ndarray:
    """Return the values (n, B) of the pixels at the nodes."""
    at = np.clip(np.rint(part.points).astype(int), 0, np.array(bands.shape[:0:-1]) - 1)
    return np.ascontiguousarray(bands[:, at[:, 1], at[:, 0]].T)


def random_block(
    seed: int, model: int = LINEAR, floor: float = degrees(10), **options: Any
) -> tuple[Block, Part, np.ndarray, np.ndarray]:
    """Return a block of a random mesh, its part, and pixels; a third of the masks is full."""
    rng = np.random.default_rng(seed)
    bands = 1 + seed % 2
    shape = {"notch": seed % 2 == 0, "touches": seed % 4 > 1, "breaks": seed % 3 * 3}
    options = shape | {"bands": bands} | options
    part = grid_part(rng, **options)
    pixels, valid = picture(rng, part, missing=(0, 0.2, 0.6)[seed % 3])
    part = replace(part, values=sampled(part, pixels))
    return Block(part, image_of(pixels, valid), floor, model), part, pixels, valid
