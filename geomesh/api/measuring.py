"""Methods of a mesh that compare it with a raster and measure its surface."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.parallel.progress import reporting

if TYPE_CHECKING:
    from collections.abc import Sequence

    import geopandas as gpd

    from geomesh.parallel.progress import Progress
    from geomesh.raster.open import Source
    from geomesh.surface.accuracy import Accuracy
    from geomesh.surface.fidelity import Fidelity
    from geomesh.terrain.volume import Volume


class MeasuringMesh(TriangleMesh):
    """A mesh that can be compared with its raster, and measured as a surface."""

    def psnr(self, source: Source, **options: Any) -> Fidelity:
        """Return how faithfully the mesh shows a raster.

        See `geomesh.surface.fidelity.measure_fidelity`.
        """
        from geomesh.surface.fidelity import measure_fidelity

        return measure_fidelity(self, source, **options)

    def verify(self, source: Source, **options: Any) -> Accuracy:
        """Measure the errors of a refined mesh again, and compare them with the recorded ones.

        See `geomesh.surface.verify.verify`.
        """
        from geomesh.surface.verify import verify

        return verify(self, source, **options)

    def surface_area(self) -> float:
        """Return the area of the surface in space, in square metres.

        Triangles without heights are left out. The mesh needs heights: see `with_height`.
        """
        return float(np.nansum(self.with_height().attributes("triangles")["area_3d"]))

    def volume(self, base: Any = None, *, progress: bool | Progress = False) -> Volume:
        """Return the volume between the surface and a base.

        Parameters
        ----------
        base : float, Mesh, path, or raster, optional
            A level in the unit of the mesh's heights; another mesh, or the GeoPackage of one; or
            a raster of heights, of which each pixel is a prism. Default: the lowest height of
            the mesh.
        progress : bool or callable(fraction, message)

        Returns
        -------
        Volume
            `cut`, above the base; `fill`, below it; and `net`, in cubic metres.

        Examples
        --------
        >>> import geomesh
        >>> mesh = geomesh.mesh_raster("data_samples/rmnp_dem.tif", nodes=200, z=1)
        >>> found = mesh.volume(3000)
        >>> bool(found.net == found.cut - found.fill)
        True
        """
        from geomesh.pipeline.volume import measure_volume

        with reporting(progress) as report:
            return measure_volume(self.with_height(), base, report)

    def contours(
        self,
        interval: float | None = None,
        *,
        base: float = 0.0,
        levels: Sequence[float] | None = None,
        index: int = 5,
    ) -> gpd.GeoDataFrame:
        """Return the contours of the heights: exact on the surface, joined, never crossing.

        Parameters
        ----------
        interval : float, optional
            Contours are at ``base + k * interval``, in the unit of the heights. Default: a round
            number that gives 10 to 20 levels.
        base : float
        levels : sequence of float, optional
            The levels themselves, in rising order, instead of an interval.
        index : int
            Every `index`-th level is marked, for thick lines and labels. 0: none.

        Returns
        -------
        geopandas.GeoDataFrame
            In the CRS of the mesh, with the columns `level`, `index`, `closed`, `length` (in
            metres) and LineString Z. Higher ground is to the left of a line.

        Raises
        ------
        BandError
            If the mesh has no heights and several bands: see `with_height`.
        LevelError
            If a value is not valid, or there would be more than 10,000 levels.
        """
        from geomesh.terrain.contour_frame import contour_frame, find_levels

        mesh = self.with_height()
        found = find_levels(mesh, interval=interval, base=base, levels=levels, index=index)
        return contour_frame(mesh, found)
