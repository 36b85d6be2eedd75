"""TriangleMesh: nodes, edges and triangles on the map, with their attributes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import shapely

from geomesh.arrays.table import Table, read_only
from geomesh.mesh.certify import certify
from geomesh.mesh.certify_refined import with_refinement
from geomesh.mesh.edge_columns import edge_columns
from geomesh.mesh.height import bands_with_values, find_height
from geomesh.mesh.quality import Quality, measure, measure_each
from geomesh.mesh.slope import slope_columns
from geomesh.mesh.topology import Edges, build_edges
from geomesh.parameters import LAYERS, LayerName
from geomesh.raster.crs import crs_label
from geomesh.raster.metres import metres_per_unit

if TYPE_CHECKING:
    from collections.abc import Mapping

    import geopandas as gpd
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points
    from geomesh.mesh.certificate import Certificate, DomainFacts
    from geomesh.mesh.height import Height
    from geomesh.mesh.provenance import Provenance
    from geomesh.raster.grid import Grid


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A conforming triangle mesh of a raster.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates in `grid` (x right, y down).
    triangles : int32 (T, 3)
        Node ids, counter-clockwise on the map.
    grid : Grid
        The pixel grid of the source raster.
    domain : DomainFacts
        The area that the mesh covers.
    constraints : int32 (C, 2)
        Pairs of nodes that must be edges: the outline, and inside of it the breaklines.
    plane_size : (int, int), optional
        Width and height of the image that the pipeline worked on. Lengths and angles are
        measured in its plane. By default the size of the source.
    node_table, triangle_table : Table
        Attributes that cannot be computed from the geometry.
    provenance : Provenance, optional
        How the mesh was made; None if it was made without a raster.
    height : Height, optional
        Which of its values is the height of the nodes; None if it is flat.
    """

    nodes: Points
    triangles: NDArray[np.int32]
    grid: Grid
    domain: DomainFacts
    constraints: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), np.int32))
    plane_size: tuple[int, int] = (0, 0)
    node_table: Table = field(default_factory=lambda: Table({}))
    triangle_table: Table = field(default_factory=lambda: Table({}))
    provenance: Provenance | None = None
    height: Height | None = None

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "nodes", read_only(self.nodes, np.float64))
        set_field(self, "triangles", read_only(self.triangles, np.int32))
        set_field(self, "constraints", read_only(self.constraints, np.int32))
        if self.plane_size == (0, 0):
            set_field(self, "plane_size", (self.grid.width, self.grid.height))
        for table, rows in ((self.node_table, self.nodes), (self.triangle_table, self.triangles)):
            if len(table) and table.length != len(rows):
                raise ValueError(f"a table has {table.length} rows for {len(rows)} elements")

    def __repr__(self) -> str:
        counts = f"{len(self.nodes)} nodes, {len(self.triangles)} triangles"
        return f"<{type(self).__name__}: {counts}, {crs_label(self.grid.crs)}>"

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies and pickles call the constructor, so that their arrays are read-only too.
        return type(self), tuple(getattr(self, field.name) for field in fields(self))

    @property
    def plane_scale(self) -> tuple[float, float]:
        """Factors in x and y from source pixels to the plane of the triangulation."""
        return self.plane_size[0] / self.grid.width, self.plane_size[1] / self.grid.height

    @cached_property
    def metadata(self) -> Mapping[str, Any]:
        """How the mesh was made, as plain JSON values: see `Provenance.to_dict`."""
        return MappingProxyType({} if self.provenance is None else self.provenance.to_dict())

    @cached_property
    def plane_nodes(self) -> Points:
        """Node coordinates, (N, 2), in the plane of the image that the pipeline worked on."""
        return read_only(self.nodes * self.plane_scale)

    @cached_property
    def map_nodes(self) -> Points:
        """Node coordinates, (N, 2), on the map."""
        return read_only(self.grid.to_map(self.nodes))

    @cached_property
    def heights(self) -> Floats | None:
        """Heights of the nodes, (N,), in the unit of `height`; NaN where there is no data.

        None if the mesh is flat.
        """
        if self.height is None:
            return None
        values = self.node_table[self.height.band].astype(np.float64)
        return read_only(values * self.height.factor)

    def with_height(self, z: int | str | None = None, z_factor: float = 1.0) -> Self:
        """Return the mesh with a band as the height of its nodes.

        Parameters
        ----------
        z : int or str, optional
            Number of the band in the raster (the first is 1), or its name. Default: the height
            that the mesh has, or else its only band.
        z_factor : float
            By which the values are multiplied, such as 0.3048 from feet to metres.

        Raises
        ------
        BandError
            If there is no such band, it has classes, or the mesh has several and `z` is None.
        """
        if z is None and self.height is not None and z_factor == 1.0:
            return self
        if z is None and self.height is not None:
            z = self.height.band
        known = () if self.provenance is None else self.provenance.source.bands
        bands = bands_with_values(known, self.node_table)
        height = find_height(bands, z, z_factor, self.grid.crs, name="the mesh")
        return replace(self, height=height)

    @cached_property
    def metres(self) -> Floats:
        """Metres for a unit of x and of y on the map, (T, 2), at the middle of each triangle."""
        middles = self.map_nodes[self.triangles].mean(axis=1)
        return read_only(metres_per_unit(self.grid.crs, middles))

    @cached_property
    def edges(self) -> Edges:
        """The undirected edges with the triangles on either side."""
        return build_edges(self.triangles)

    def quality(self, space: Literal["image", "map"] = "image") -> Quality:
        """Return Ki and the standard measures of every triangle.

        Parameters
        ----------
        space : {"image", "map"}
            Measure in the plane of the image that the pipeline worked on (in pixels), or
            in map coordinates (in units of the CRS).
        """
        if space == "image":
            return self._image_quality
        if space != "map":
            raise ValueError(f"space is {space!r}: choose image or map")
        a, b, _, d, e, _ = self.grid.transform[:6]
        size = self.grid.width * math.hypot(a, d), self.grid.height * math.hypot(b, e)
        return measure(self.map_nodes, self.triangles, size=size)

    @cached_property
    def _image_quality(self) -> Quality:
        width, height = self.plane_size
        return measure(self.plane_nodes, self.triangles, size=(width, height))

    def with_measures(self, space: Literal["image", "map"] = "image") -> Self:
        """Return the mesh with every measure of `quality` as an attribute of its triangles.

        The names of measures in map units start with ``map_``.
        """
        prefix = "map_" if space == "map" else ""
        shown = self._triangle_attributes()
        measures = {f"{prefix}{name}": col for name, col in self.quality(space).table.items()}
        added = {name: values for name, values in measures.items() if name not in shown}
        return replace(self, triangle_table=self.triangle_table.with_columns(added))

    def certify(self) -> Certificate:
        """Check the mesh and return its certificate (see `geomesh.mesh.certify`).

        A refined mesh has more checks (see `geomesh.mesh.certify_refined`).
        """
        pixels = None if self.provenance is None else self.provenance.pixels
        refinement = None if self.provenance is None else self.provenance.refinement
        certificate = certify(
            self.nodes,
            self.triangles,
            constraints=self.constraints,
            plane_scale=self.plane_scale,
            counter_clockwise=not self.grid.flips,
            domain=self.domain,
            pixels=pixels,
            edges=self.edges if self.triangles.min(initial=0) >= 0 else None,
            delaunay=refinement is None,
            breaklines=self.provenance is not None and self.provenance.breaklines is not None,
        )
        if refinement is None or math.isnan(certificate.min_angle):
            return certificate
        return with_refinement(
            certificate,
            refinement,
            nodes=self.nodes,
            triangles=self.triangles,
            plane_nodes=self.plane_nodes,
            held=self._held_nodes(),
            node_table=self.node_table,
            triangle_table=self.triangle_table,
        )

    def _held_nodes(self) -> NDArray[np.bool_]:
        """Return which nodes (N,) refinement cannot move or remove as it likes."""
        held = np.zeros(len(self.nodes), np.bool_)
        held[self.constraints] = True
        held[self.edges.nodes[self.edges.uses == 1]] = True
        keeps = self.provenance is not None and self.provenance.recipe.keep_features
        if keeps and "kind" in self.node_table:
            held |= self.node_table["kind"] == "feature"
        return held

    def attributes(self, layer: LayerName) -> Table:
        """Return the columns of a layer, in the order in which files have them.

        docs/formats.md lists every column with its unit and meaning.
        """
        if layer == "triangles":
            return self._triangle_attributes()
        if layer == "edges":
            return edge_columns(self.edges, self.constraints, self.plane_nodes)
        if layer != "nodes":
            raise ValueError(f"layer is {layer!r}: choose from {', '.join(LAYERS)}")
        columns: dict[str, NDArray[Any]] = {"id": np.arange(len(self.nodes), dtype=np.int32)}
        if "kind" in self.node_table:
            columns["kind"] = self.node_table["kind"]
        columns |= {"col": self.nodes[:, 0], "row": self.nodes[:, 1]}
        return Table(columns | dict(self.node_table))

    def _triangle_attributes(self) -> Table:
        corners = {f"n{k}": self.triangles[:, k] for k in range(3)}
        shown = ("ab", "bc", "ca", "ki", "min_angle", "shape")
        area = self.grid.areas(self.nodes, self.triangles)
        return Table(
            {
                "id": np.arange(len(self.triangles), dtype=np.int32),
                **corners,
                "area": area,
                **measure_each(self.plane_nodes, self.triangles, shown),
                **self._slopes(area),
                **self.triangle_table,
            }
        )

    def _slopes(self, areas: Floats) -> Mapping[str, Floats]:
        if self.height is None or self.heights is None:
            return {}
        heights = self.heights * self.height.metres
        return slope_columns(self.map_nodes, heights, self.triangles, self.metres, areas)

    def to_geodataframe(self, layer: LayerName = "triangles") -> gpd.GeoDataFrame:
        """Return a layer as a GeoDataFrame with CRS and attributes.

        Parameters
        ----------
        layer : {"triangles", "edges", "nodes"}
        """
        # Imported here: with pandas it takes 0.25 s, and a mesh itself does not need it.
        import geopandas as gpd

        columns = dict(self.attributes(layer))
        places = self.map_nodes
        if self.heights is not None:
            places = np.column_stack([places, self.heights])
        if layer == "triangles":
            geometry = shapely.polygons(places[self.triangles[:, [0, 1, 2, 0]]])
        elif layer == "edges":
            geometry = shapely.linestrings(places[self.edges.nodes])
        else:
            geometry = shapely.points(places)
        return gpd.GeoDataFrame(columns, geometry=geometry, crs=self.grid.crs)

    def to_graph(self, library: Literal["scipy", "networkx", "libpysal"] = "scipy") -> Any:
        """Return the mesh as a graph: its nodes, joined by its edges.

        Parameters
        ----------
        library : {"scipy", "networkx", "libpysal"}

        Returns
        -------
        scipy.sparse.csr_array (N, N), networkx.Graph or libpysal.graph.Graph
            The graph is symmetric; its weights are edge lengths in map units.
        """
        from geomesh.mesh.graph import build_graph

        return build_graph(self.map_nodes, self.edges, library)
