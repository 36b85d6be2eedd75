"""The unit of x and y of a TIN, and its heights in this unit: for formats that have only one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from geomesh.mesh.height import same_unit
from geomesh.raster.crs import crs_label, horizontal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.mesh.triangle_mesh import TriangleMesh


@dataclass(frozen=True)
class LinearUnit:
    """A unit of length.

    Parameters
    ----------
    name : str
    metres : float
    """

    name: str
    metres: float

    def equals(self, metres: float) -> bool:
        """Return whether a unit of this size is the same."""
        return same_unit(self.metres, metres)


METRE = LinearUnit("metre", 1.0)


def horizontal_unit(crs: CRS | None) -> LinearUnit | None:
    """Return the unit of x and y where they are lengths; None without a CRS."""
    if crs is None:
        return None
    axis = horizontal(crs).axis_info[0]
    # 0 stands for an unknown unit.
    return LinearUnit(axis.unit_name, float(axis.unit_conversion_factor or 1.0))


def height_unit(mesh: TriangleMesh) -> LinearUnit:
    """Return the unit of the heights of a mesh."""
    assert mesh.height is not None
    return LinearUnit(mesh.height.unit, mesh.height.metres)


def converted(
    heights: NDArray[np.float64], own: LinearUnit, wanted: LinearUnit
) -> NDArray[np.float64]:
    """Return heights in another unit; the same, to the last bit, if it is the same unit."""
    return heights if own.equals(wanted.metres) else heights * (own.metres / wanted.metres)


def note_on_conversion(
    mesh: TriangleMesh, driver: str, wanted: LinearUnit | None
) -> tuple[str, ...]:
    """Return what to say if the heights are converted to another unit."""
    own = height_unit(mesh)
    if wanted is None or own.equals(wanted.metres):
        return ()
    return (
        f"the heights are converted from {own.name} to {wanted.name}, "
        f"because {driver} has one unit for x, y and heights",
    )


def told_crs(mesh: TriangleMesh) -> str:
    """Return in which CRS and unit x and y are, and in which unit the heights."""
    crs = mesh.grid.crs
    assert mesh.height is not None
    assumed = " (assumed)" if mesh.height.assumed else ""
    place = "no CRS" if crs is None else f"{crs_label(crs)}, {crs.name}"
    unit = "" if crs is None else f" in {horizontal(crs).axis_info[0].unit_name}"
    return f"x and y{unit}: {place}; heights in {mesh.height.unit}{assumed}"
