"""Change a text, such as a VRT or the header of ENVI."""

from __future__ import annotations

import re

from support.fuzz.numbers import NUMBERS, Random, pick

_WORDS = [b"Byte", b"UInt16", b"Int8", b"UInt64", b"Int64", b"Float32", b"Float64", b"CFloat32"]
_WORDS += [b"CInt16", b"Palette", b"Alpha", b"Red", b"Gray", b"scene.vrt", b"source.tif", b"true"]
_WORDS += [b"cubic", b"average", b"VRTDerivedRasterBand", b"EPSG:4326", b'LOCAL_CS["a"]', b"bsq"]
_WORDS += [b"none", b"Meters", b"UTM", b"Arbitrary", b"\xff\xfe", b"<a>", b"}", b"{", b""]


def _change_number(data: bytes, random: Random) -> bytes:
    return _substitute(data, rb"-?\d[\d.]*(e[+-]?\d+)?", pick(random, NUMBERS).encode(), random)


def _change_word(data: bytes, random: Random) -> bytes:
    return _substitute(data, rb"[A-Za-z]\w+", pick(random, _WORDS), random)


def _substitute(data: bytes, pattern: bytes, new: bytes, random: Random) -> bytes:
    found = list(re.finditer(pattern, data))
    if not found:
        return data
    match = pick(random, found)
    return data[: match.start()] + new + data[match.end() :]


def _change_lines(data: bytes, random: Random) -> bytes:
    """Remove, repeat or move a line."""
    lines = data.splitlines(keepends=True)
    line = lines.pop(int(random.integers(len(lines)))) if lines else b""
    for _ in range(pick(random, [0, 1, 2, 300])):
        lines.insert(int(random.integers(len(lines) + 1)), line)
    return b"".join(lines)


_ELEMENTS = [b"<MaskBand>", b"<ColorTable><Entry c1='1' c4='0'/></ColorTable>", b"</VRTRasterBand>"]
_ELEMENTS += [
    b"<!DOCTYPE a [<!ENTITY b 'cccccccc'>]>",
    b"<NoDataValue>nan</NoDataValue>",
    b"<![CDATA[",
]
_ELEMENTS += [b"<ColorInterp>Alpha</ColorInterp>", b"<LUT>0:5,nan:9,300:1e400</LUT>", b"<Overview>"]
_ELEMENTS += [
    b"<Metadata><MDI key='NODATA_VALUES'>1 nan 3</MDI></Metadata>",
    b"<Offset>inf</Offset>",
]
_ELEMENTS += [
    b"<GCPList><GCP Id='1' Pixel='nan' Line='1' X='1e300' Y='-1'/></GCPList>",
    b"<UseMaskBand>",
]


def _insert_line(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    lines.insert(int(random.integers(len(lines) + 1)), pick(random, _ELEMENTS) + b"\n")
    return b"".join(lines)


CHANGES = [_change_number] * 4 + [_change_word] * 3 + [_change_lines, _insert_line]
