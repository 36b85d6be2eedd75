"""Read the geometries of a vector file, with the layer that the user chose."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import shapely

from geomesh.errors import SourceError, one_line
from geomesh.raster.paths import is_remote, plain_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray


@dataclass(frozen=True)
class Role:
    """What geometries are for, in the words of messages.

    Parameters
    ----------
    parameter : str
        The parameter that the user gave them with.
    title : str
        How messages call them if they are not a file.
    content : str
        What they should be.
    """

    parameter: str
    title: str
    content: str


def read_file(
    path: str, name: str, layer: str | None, role: Role
) -> tuple[NDArray[Any], str | None]:
    """Return the geometries of the layer of a file, and its CRS as GDAL names it."""
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError

    _require_set(path, name, role)
    source = path if is_remote(path) else plain_name(path)
    try:
        layers = {str(found): kind for found, kind in pyogrio.list_layers(source)}
        chosen = _choose_layer(layers, layer, name, role)
        # Not read_dataframe: it imports pandas, which takes a quarter of a second.
        about, _, shapes, _ = pyogrio.raw.read(source, layer=chosen, columns=[], force_2d=True)
        found = shapely.from_wkb(shapes)
    except (DataSourceError, DataLayerError, shapely.GEOSException) as error:
        reason = one_line(error) if Path(path).exists() else "no such file; check the path"
        raise SourceError(
            f"{name} cannot be read as a vector file ({reason}); give {role.content} in a file "
            "such as .gpkg"
        ) from error
    return found, about["crs"]


def _choose_layer(
    layers: Mapping[str, str | None], layer: str | None, name: str, role: Role
) -> str:
    spatial = [found for found, kind in layers.items() if kind is not None]
    if layer is not None:
        if layer not in spatial:
            raise SourceError(
                f"{name} has no layer {layer!r} of geometries; choose from {_listed(spatial)} with "
                f"`{role.parameter}_layer`"
            )
        return layer
    if not spatial:
        raise SourceError(f"{name} has no geometry; give {role.content}")
    if len(spatial) > 1:
        raise SourceError(
            f"{name} has several layers, {_listed(spatial)}: choose one with "
            f"`{role.parameter}_layer`"
        )
    return spatial[0]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))


def _require_set(path: str, name: str, role: Role) -> None:
    """Raise an error that names the file that is missing beside a shapefile."""
    file = Path(path)
    if file.suffix.lower() == ".shp" and file.exists():
        beside = {each.name.lower() for each in file.parent.glob(f"{_exactly(file.stem)}.*")}
        missing = f"{file.stem}.shx"
        if missing.lower() not in beside:
            raise SourceError(
                f"{name} is incomplete: its index {missing} is missing; copy it too, or export the "
                f"{role.content} again, as .gpkg"
            )


def _exactly(text: str) -> str:
    """Return a pattern that matches exactly this text."""
    return re.sub(r"([*?[])", r"[\1]", text)
