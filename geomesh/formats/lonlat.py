"""The layers of a mesh for GeoJSON: longitude and latitude, cut at the antimeridian.

GDAL writes the file, but without its option RFC7946=YES. With that option, GDAL assumes that
a triangle crosses the antimeridian if it has corners within 10 degrees on both sides of it.
Other triangles that cross it, for example near the poles, would reach around the world, and
a triangle that really spans the world would be cut to a sliver. So GDAL gets geometries that
are already cut. It gets no CRS, because RFC 7946 allows only one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import Transformer
from pyproj.exceptions import ProjError

from geomesh.arrays.table import Table
from geomesh.errors import GeoreferenceError
from geomesh.formats.arrow import Layer, binary, wkb
from geomesh.formats.lonlat_cut import cut
from geomesh.formats.lonlat_heights import Lift
from geomesh.formats.lonlat_paths import Follower, Paths, whole_turns
from geomesh.formats.lonlat_poles import check_poles
from geomesh.formats.lonlat_precision import (
    Decimals,
    choose_decimals,
    orientation,
    round_each,
    short_way,
)
from geomesh.raster.crs import LONLAT, has_angles, is_lonlat, is_on_earth

if TYPE_CHECKING:
    from collections.abc import Callable

    import pyarrow as pa
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.arrays.types import Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

# Significant digits of attributes: the precision of float32.
_DIGITS = 7

# If the longitudes of a map differ from those of WGS 84 by angles that are within so many
# degrees of each other, edges are straight.
_MOST_DISTORTION = 0.1

# So many triangles tell whether the map is mirrored.
_SAMPLE = 100


@dataclass(frozen=True, eq=False, kw_only=True)
class LonLatLayer(Layer):
    """A layer with `points` in longitude and latitude.

    Inside a geometry, longitudes continue beyond 180 degrees. Then the geometry is cut there.
    Latitudes may go beyond 90 degrees by a part of a pixel; they are cut too.

    Parameters
    ----------
    follower : Follower, optional
        It follows edges, which may be curves in longitude and latitude. None if x and y on the
        map are these: then edges are straight, and `points` show in which direction they go.
    mirrored : bool
        Whether what is counter-clockwise on the map is clockwise here.
    decimals : Decimals
        Number of decimals to which coordinates are rounded.
    lift : callable, optional
        See `geomesh.formats.lonlat_heights.Lift`. None if there are no heights.
    """

    follower: Follower | None
    mirrored: bool
    decimals: Decimals
    lift: Lift | None = None

    @classmethod
    def of(cls, mesh: TriangleMesh, name: LayerName, precision: int | None = None) -> LonLatLayer:
        """Return the layer `name` of a mesh.

        Parameters
        ----------
        mesh : TriangleMesh
        name : {"triangles", "edges", "nodes"}
        precision : int, optional
            Number of decimals: see `geomesh.formats.lonlat_precision.choose_decimals`.

        Raises
        ------
        GeoreferenceError
            If the mesh has no CRS or one of another celestial body, or if nodes have no
            longitude and latitude (outside the disc of a geostationary image, beyond a pole).
        """
        crs = crs_on_earth(mesh)
        to_lonlat = lonlat_of(crs)
        check_poles(mesh)
        lonlat = to_lonlat(mesh.map_nodes)
        off = np.count_nonzero(np.isnan(lonlat).any(axis=1))
        if off:
            crop = "leave them out with `bounds` or `mask`, or " if off < len(lonlat) else ""
            raise GeoreferenceError(
                f"GeoJSON needs longitude and latitude, but {off} of {len(lonlat)} nodes have "
                f"none: {crop}write .gpkg"
            )
        layer, follower = Layer.of(mesh, name), None
        if is_lonlat(crs) and not is_distorted(mesh, lonlat):
            x, y = _degrees(mesh).T
            lonlat[:, 0] += whole_turns(x - lonlat[:, 0])
            lonlat[:, 1] += y - y.clip(-90, 90)
        else:
            follower = Follower.of(mesh.map_nodes, lonlat, mesh.nodes, mesh.triangles, to_lonlat)
        return cls(
            name,
            Table({name: _rounded(values) for name, values in layer.columns.items()}),
            lonlat,
            layer.vertices,
            layer.geometry_type,
            None if layer.heights is None else _rounded(layer.heights),
            follower=follower,
            mirrored=_is_mirrored(mesh, to_lonlat),
            decimals=choose_decimals(lonlat, mesh.triangles, mesh.edges.nodes, follower, precision),
            lift=None if mesh.heights is None else Lift(crs, mesh.map_nodes, mesh.heights),
        )

    def geometry(self, rows: slice) -> pa.Array:
        """Return the WKB of the given rows; rings are counter-clockwise."""
        nodes = self.vertices[rows]
        sides, turn, paths = self._follow(nodes)
        xy = self.points[nodes]
        lon = xy[:, :1, 0] + np.column_stack([np.zeros(len(xy)), np.cumsum(turn, axis=1)])
        lon -= whole_turns((lon.min(axis=1) + lon.max(axis=1)) / 2)[:, None]
        xy[..., 0] += whole_turns(lon - xy[..., 0])
        if self.geometry_type != "Polygon":
            beyond = (np.abs(xy[..., 1]) > 90).all(axis=1)
            xy[beyond, :, 1] = xy[beyond, :, 1].clip(-90, 90)
        rounded = round_each(xy, self.decimals.nodes[nodes])
        special = (np.abs(rounded) > (180, 90)).any(axis=(1, 2))
        if self.geometry_type == "Polygon":
            special |= rounded[:, 0, 0] != rounded[:, -1, 0]
        if paths is not None:
            special |= (np.diff(paths.offsets)[sides] > 0).any(axis=1)
        pieces = {}
        for row in np.flatnonzero(special).tolist():
            path = rounded[row]
            if paths is not None:
                path = paths.along(path, nodes[row], sides[row], self.decimals.inner)
            if self.mirrored:
                path = path[::-1]
            pieces[row] = cut(path, self.geometry_type)
            if self.lift is not None:
                pieces[row] = self.lift(pieces[row], np.unique(nodes[row]))
        if self.heights is not None:
            rounded = np.concatenate([rounded, self.heights[nodes][..., None]], axis=-1)
        if self.geometry_type == "Polygon":
            # A side that is straight on the map may be a curve here: a sliver can flip over.
            clockwise = orientation(rounded[..., :2]) < 0
            rounded[clockwise] = rounded[clockwise][:, ::-1]
        return binary(wkb(rounded, self.geometry_type), pieces)

    def _follow(
        self, nodes: NDArray[np.int32]
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], Paths | None]:
        """Follow the sides of geometries (R, V).

        Returns
        -------
        sides : int (R, V - 1)
            Which edge of the paths a side is.
        turn : float64 (R, V - 1)
            Change of longitude along the side.
        paths : Paths or None
            Of every edge in the direction from its smaller node, so that its two triangles agree.
        """
        start, stop = nodes[:, :-1], nodes[:, 1:]
        if self.follower is None or start.size == 0:
            turn = self.points[stop, 0] - self.points[start, 0]
            return np.zeros(start.shape, np.intp), turn, None
        low, high = np.minimum(start, stop), np.maximum(start, stop)
        keys, sides = np.unique(low * np.int64(len(self.points)) + high, return_inverse=True)
        paths = self.follower.follow(keys // len(self.points), keys % len(self.points))
        sides = sides.reshape(start.shape)
        return sides, np.where(start < stop, 1, -1) * paths.turn[sides], paths


def _rounded(values: NDArray[Any]) -> NDArray[Any]:
    """Return floats rounded to `_DIGITS` significant digits: half as much data to load."""
    if values.dtype.kind != "f":
        return values
    sizes = np.abs(values, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        places = _DIGITS - 1 - np.floor(np.log10(sizes))
    scale = 10.0 ** np.clip(np.where(np.isfinite(places), places, 0), -300, 300)
    rounded: NDArray[np.float64] = np.rint(values * scale) / scale
    return rounded


def crs_on_earth(mesh: TriangleMesh) -> CRS:
    """Return the CRS of a mesh; GeoreferenceError if there is none, or it is not on Earth."""
    crs = mesh.grid.crs
    if crs is None:
        raise GeoreferenceError(
            "GeoJSON needs longitude and latitude, but the mesh has no CRS: "
            "georeference the raster, or write .gpkg"
        )
    if not is_on_earth(crs):
        raise _no_transformation(crs)
    return crs


def lonlat_of(crs: CRS) -> Callable[[Points], Points]:
    """Return a function from map coordinates (N, 2) to degrees; NaN where there are none."""
    try:
        transformer = Transformer.from_crs(crs, LONLAT, always_xy=True)
    except ProjError as error:
        raise _no_transformation(crs) from error
    pole = np.inf
    if has_angles(crs):
        # PROJ knows no latitude beyond a pole. Of a grid that reaches there, all that is the pole.
        pole = np.pi / 2 / crs.axis_info[0].unit_conversion_factor

    def convert(places: Points) -> Points:
        x, y = places.T
        lonlat = np.column_stack(transformer.transform(x, y.clip(-pole, pole)))
        lonlat[~np.isfinite(lonlat).all(axis=1)] = np.nan
        return lonlat

    return convert


def _degrees(mesh: TriangleMesh) -> Points:
    crs = mesh.grid.crs
    assert crs is not None
    return mesh.map_nodes * float(np.degrees(crs.axis_info[0].unit_conversion_factor))


def is_distorted(mesh: TriangleMesh, lonlat: Points) -> bool:
    """Return whether longitudes change by different angles, as from one datum to another.

    That is so near the poles, which are in different places.
    """
    change = lonlat[:, 0] - _degrees(mesh)[:, 0]
    change -= change[0]
    change -= whole_turns(change)
    return bool(np.ptp(change) > _MOST_DISTORTION)


def _is_mirrored(mesh: TriangleMesh, to_lonlat: Callable[[Points], Points]) -> bool:
    """Return whether the map is mirrored, as one is whose x runs to the west and y to the north."""
    some = mesh.triangles[:: max(len(mesh.triangles) // _SAMPLE, 1)]
    middle = mesh.map_nodes[some].mean(axis=1)
    a, b, _, d, e, _ = mesh.grid.transform[:6]
    steps = np.array([(0, 0), (a, d), (b, e)]) / 16
    corners = np.stack([to_lonlat(middle + step) for step in steps], axis=1)
    turned = orientation(short_way(corners))
    return bool(np.nansum(turned) < 0) != mesh.grid.flips


def _no_transformation(crs: CRS) -> GeoreferenceError:
    return GeoreferenceError(
        "GeoJSON needs longitude and latitude on Earth, but there is no transformation from "
        f"{crs.name!r} to them: write .gpkg"
    )
