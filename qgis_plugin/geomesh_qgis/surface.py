"""The linear surface of a refined mesh: which band of a mesh layer shows which colour.

A mesh layer shows one quantity. It draws values at nodes as a surface that is linear in each
face, which is just what an adaptive mesh is fitted with. An image has three: its red, green and
blue are three layers, whose light adds up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from qgis.core import QgsFeatureRequest, QgsVectorLayer

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

_COLORS = ("red", "green", "blue")
_WHITE = "#ffffff"
_LIGHT = {"red": "#ff0000", "green": "#00ff00", "blue": "#0000ff"}

# The value that has all the light if a band has bytes, and its peak in the metadata.
_BYTE = 255

# Enough triangles to find how values become colours.
_MOST_TRIANGLES = 3000


@dataclass(frozen=True)
class Channel:
    """A band of the surface, and the colours of its values.

    Parameters
    ----------
    name : str
        "red", "green" or "blue"; empty if this band alone is shown, in gray.
    band : str
        Name of the band in the columns of the mesh.
    black, full : float or None
        Values that have no light, and all of it. None: the lowest and the highest value.
    """

    name: str
    band: str
    black: float | None
    full: float | None

    @property
    def color(self) -> str:
        """The colour of `full`."""
        return _LIGHT.get(self.name, _WHITE)


def find_channels(triangles: QgsVectorLayer, document: Mapping[str, Any]) -> tuple[Channel, ...]:
    """Return the channels that show a linear surface, from the first to draw to the last.

    Parameters
    ----------
    triangles : QgsVectorLayer
        The triangles of the mesh. Values become colours as in them.
    document : mapping
        How the mesh was made.

    Returns
    -------
    tuple of Channel
        None if the mesh has no linear surface; one or three otherwise.
    """
    refinement = document.get("refinement") or {}
    bands = [each["name"] for each in refinement.get("bands", ())]
    if refinement.get("model") != "linear" or not bands:
        return ()
    are_bytes = {each["name"]: each.get("peak") == _BYTE for each in refinement["bands"]}
    rows = _read(triangles, bands)
    fitted = [_fit_channel(rows, bands, position) for position in range(3)]
    if None in fitted:
        fitted = _guess_channels(bands, are_bytes)
    fitted = [
        (band, 0, _BYTE) if are_bytes[band] and _is_whole_byte(*limits) else (band, *limits)
        for band, *limits in fitted
    ]
    if len({band for band, _, _ in fitted}) == 1:
        return (Channel("", *fitted[0]),)
    return tuple(Channel(name, *each) for name, each in zip(_COLORS, fitted))


def _read(
    triangles: QgsVectorLayer, bands: Iterable[str]
) -> list[tuple[tuple[int, int, int], dict[str, float]]]:
    """Return the colours of triangles, and the means of those bands of which they have one."""
    names = triangles.fields().names()
    means = {band: f"{band}_mean" for band in bands if f"{band}_mean" in names}
    step = triangles.featureCount() // _MOST_TRIANGLES + 1
    request = QgsFeatureRequest().setFlags(QgsFeatureRequest.Flag.NoGeometry)
    request.setSubsetOfAttributes(["id", "count", "color", *means.values()], triangles.fields())
    request.setFilterExpression(f'"id" % {step} = 0 AND "count" > 0')
    rows = []
    for feature in triangles.getFeatures(request):
        color = int(str(feature["color"])[1:], 16)
        known = {band: float(feature[mean]) for band, mean in means.items()}
        rows.append(((color >> 16 & 255, color >> 8 & 255, color & 255), known))
    return rows


def _fit_channel(
    rows: Sequence[tuple[tuple[int, int, int], dict[str, float]]],
    bands: Sequence[str],
    position: int,
) -> tuple[str, float, float] | None:
    """Return the band that gives one channel of the colours, and its values for 0 and 255."""
    preferred = sorted(bands, key=lambda band: band != _COLORS[position])
    for band in preferred:
        pairs = [(means[band], color[position]) for color, means in rows if band in means]
        found = _fit_line(pairs)
        if found is not None:
            return band, *found
    return None


def _fit_line(pairs: Sequence[tuple[float, int]]) -> tuple[float, float] | None:
    """Return the values that become 0 and 255, if all levels are a stretch of the values."""
    inner = [(value, level) for value, level in pairs if 0 < level < 255]
    if len({level for _, level in inner}) < 2:
        return None
    value_mean = sum(value for value, _ in inner) / len(inner)
    level_mean = sum(level for _, level in inner) / len(inner)
    spread = sum((value - value_mean) ** 2 for value, _ in inner)
    slope = sum((v - value_mean) * (level - level_mean) for v, level in inner)
    if spread == 0 or slope <= 0:
        return None
    slope /= spread
    black = value_mean - level_mean / slope
    for value, level in pairs:
        if abs(min(max(slope * (value - black), 0), 255) - level) > 1:
            return None
    return black, black + 255 / slope


def _is_whole_byte(black: float | None, full: float | None) -> bool:
    """Return whether bytes are shown as they are. The limits were found from rounded levels."""
    return black is not None and abs(black) < 1 and full is not None and abs(full - _BYTE) < 1


def _guess_channels(
    bands: Sequence[str], are_bytes: Mapping[str, bool]
) -> list[tuple[str, float | None, float | None]]:
    """Return the bands to show if their means do not tell: there are none, or all are equal."""
    if set(_COLORS) <= set(bands):
        chosen = list(_COLORS)
    else:
        chosen = list(bands[:3]) if len(bands) > 2 else [bands[0]] * 3
    return [(band, 0, _BYTE) if are_bytes[band] else (band, None, None) for band in chosen]
