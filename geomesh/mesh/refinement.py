"""Refinement: what a refined mesh was to reach, and how far it is from its raster."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geomesh.arrays.plain import plain_json
from geomesh.errors import MeshFileError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from geomesh.arrays.table import Table
    from geomesh.arrays.types import Floats, Points, Triangles
    from geomesh.parameters import Model

Goal = Literal["nodes", "max_error", "rmse"]


@dataclass(frozen=True)
class BandAccuracy:
    """How far the valid pixels of a band are from the surface, in the units of the band.

    Parameters
    ----------
    name : str
        Name of the band in the columns of the mesh.
    max_error, rmse : float
        Greatest absolute error, and root mean square error. Infinite if the surface has no
        value at some valid pixel.
    peak : float
        The reference value of PSNR: 255 for uint8, else the range of the pixels.
    """

    name: str
    max_error: float
    rmse: float
    peak: float

    @property
    def psnr(self) -> float:
        """Peak signal-to-noise ratio in decibels, 20 log10(peak / rmse); infinite if exact."""
        if self.rmse == 0:
            return math.inf
        if self.peak == 0:
            return -math.inf
        return 20 * (math.log10(self.peak) - math.log10(self.rmse))

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain JSON values; what is not finite becomes None."""
        figures: dict[str, Any] = plain_json({**asdict(self), "psnr": self.psnr})
        return figures

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> BandAccuracy:
        """Return the figures from the values that `to_dict` returned."""
        figures = (values[name] for name in ("max_error", "rmse", "peak"))
        return cls(values["name"], *(math.inf if v is None else float(v) for v in figures))


@dataclass(frozen=True)
class Refinement:
    """The goal of a refinement, and what the finished mesh reaches.

    Parameters
    ----------
    model : {"linear", "constant"}
        Linear in each triangle between values at the nodes, which are in the columns of the
        nodes with the names of `bands`; or one value for each triangle, which is its
        `<band>_mean`.
    goal : {"nodes", "max_error", "rmse"}
    budget : int or None
        Number of nodes that was wanted, or the most that were allowed; None: no limit.
    limits : tuple of float
        The largest greatest error, or the largest rmse, that was wanted for each band, in its
        units. Empty if the goal is a number of nodes.
    reached : bool
        Whether the mesh reaches its goal. False if the budget or the time ended before.
    note : str
        Why the goal was not reached; empty if it was.
    min_angle_floor : float
        Smallest angle that refinement was allowed to make, in degrees.
    pixels : int
        Number of valid pixels that were compared with the surface.
    bands : tuple of BandAccuracy
        One for each band that the surface shows.
    digest : str
        `surface_digest` of the mesh and the values that were compared.

    Raises
    ------
    ValueError
        If there is not one limit for each band.
    """

    model: Model
    goal: Goal
    budget: int | None
    limits: tuple[float, ...]
    reached: bool
    note: str
    min_angle_floor: float
    pixels: int
    bands: tuple[BandAccuracy, ...]
    digest: str

    def __post_init__(self) -> None:
        expected = 0 if self.goal == "nodes" else len(self.bands)
        if len(self.limits) != expected:
            raise ValueError(f"{len(self.limits)} limits for the goal {self.goal}: not {expected}")

    def to_dict(self) -> dict[str, Any]:
        """Return the refinement as plain JSON values."""
        return {
            **asdict(self),
            "limits": list(self.limits),
            "bands": [band.to_dict() for band in self.bands],
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Refinement:
        """Return the refinement from the values that `to_dict` returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            If an entry is missing or not valid.
        """
        bands = tuple(BandAccuracy.from_dict(band) for band in values["bands"])
        own = {name: values[name] for name in cls.__dataclass_fields__}
        return cls(**{**own, "bands": bands, "limits": tuple(map(float, values["limits"]))})


def surface_columns(bands: Sequence[str], model: Model) -> tuple[str, ...]:
    """Return the columns with the values of a surface, of the nodes or of the triangles."""
    return tuple(bands) if model == "linear" else tuple(f"{band}_mean" for band in bands)


def surface_values(table: Table, bands: Sequence[str], model: Model) -> Floats:
    """Return the values of a surface from the columns of a mesh.

    Parameters
    ----------
    table : Table
        Of the nodes for the model "linear", of the triangles for "constant".
    bands : sequence of str
        Names of the bands.
    model : {"linear", "constant"}

    Returns
    -------
    float64 (N, B) or (T, B)

    Raises
    ------
    MeshFileError
        If the mesh does not have all of the columns, or not all hold numbers.
    """
    names = surface_columns(bands, model)
    missing = [name for name in names if name not in table or table[name].dtype.kind not in "iuf"]
    if missing:
        owner = "nodes" if model == "linear" else "triangles"
        raise MeshFileError(
            f"the {owner} of the mesh have no values in {', '.join(missing)}, which the {model} "
            "model needs: choose another `fit`, which computes them from the raster"
        )
    return np.column_stack([table[name].astype(np.float64) for name in names])


def surface_digest(nodes: Points, triangles: Triangles, values: Floats) -> str:
    """Return a digest of a surface, which changes if any coordinate, id or value does.

    It is the same on every machine. Of the many NaN and the two zeros, files keep only one.

    Parameters
    ----------
    nodes : float64 (N, 2)
    triangles : int32 (T, 3)
    values : float64 (N, B) or (T, B)
    """
    digest = blake2b(digest_size=16)
    known = np.where(np.isnan(values), np.nan, values + 0.0)
    for array, dtype in ((nodes + 0.0, "<f8"), (triangles, "<i4"), (known, "<f8")):
        digest.update(repr(array.shape).encode())
        digest.update(np.ascontiguousarray(array, dtype).data)
    return digest.hexdigest()
