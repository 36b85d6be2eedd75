"""Reading: which bands of a source to use, and how to understand their values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pyproj.exceptions import CRSError

from geomesh.errors import BandError, GeoreferenceError, one_line
from geomesh.parameters import ALPHA, Alpha
from geomesh.raster.crs import to_pyproj
from geomesh.raster.nodata import Number, parse_nodata

if TYPE_CHECKING:
    from pyproj import CRS


@dataclass(frozen=True)
class Reading:
    """What the user asked for when a source was opened: see `geomesh.raster.open.open_scene`."""

    bidx: Sequence[int] | None = None
    nodata: Number | None = None
    alpha: Alpha = "mask"
    unscale: bool = False
    crs: CRS | None = None

    @classmethod
    def of(
        cls,
        *,
        bidx: Sequence[int] | None,
        nodata: float | None,
        alpha: Alpha,
        unscale: bool,
        crs: Any,
    ) -> Reading:
        """Return the reading of the arguments of `open_scene`.

        Raises
        ------
        BandError, GeoreferenceError
            If a value is not valid.
        """
        if bidx is not None and not (
            isinstance(bidx, Sequence) and all(isinstance(index, int) for index in bidx)
        ):
            raise BandError(f"bidx is {bidx!r}: give a list of band numbers such as [3, 2, 1]")
        if alpha not in ALPHA:
            raise BandError(f"alpha is {alpha!r}: choose from {', '.join(ALPHA)}")
        stored = None if nodata is None else parse_nodata(nodata)
        given = None if crs is None else read_crs("the CRS", crs)
        return cls(bidx, stored, alpha, bool(unscale), given)


def read_crs(label: str, crs: Any) -> CRS | None:
    """Return what a user gave as a CRS; `label` is its name in the error, GeoreferenceError."""
    try:
        if crs == "":
            raise CRSError("it is empty")
        return to_pyproj(crs)
    except CRSError as error:
        raise GeoreferenceError(
            f"{label} {crs!r} is unknown ({one_line(error)}); give a code such as EPSG:32722"
        ) from error
