"""Write a page that shows tiles, from disk or from a web server, without any outside request."""

from __future__ import annotations

import base64
import html
import json
import os
import re
from importlib.resources import files
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any
from urllib.parse import quote

from geomesh.formats.document import KEY
from geomesh.formats.pmtiles import Archive
from geomesh.io.atomic import staged, writing_to
from geomesh.io.html import check_html, policy_digest

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

# Tiles up to this size are a part of the page. With larger ones, it would be slow to open.
EMBEDDED = 30_000_000

_PLACEHOLDER = re.compile("@([a-z_]+)@")
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
_SOURCE_MAP = re.compile(r"^//# sourceMappingURL=.*$", re.MULTILINE)

# Bytes of the tiles that are encoded at once: a multiple of 3.
_CHUNK = 3_000_000


def write_page(
    path: str | PathLike[str],
    tiles: str | PathLike[str],
    *,
    overwrite: bool = False,
    embedded: int = EMBEDDED,
) -> bool:
    """Write a page that shows tiles; it is complete or does not exist.

    Parameters
    ----------
    path : path-like
        Ends in .html.
    tiles : path-like
        A file that geomesh wrote.
    overwrite : bool
        Replace an existing page, as the last step.
    embedded : int
        Tiles of up to so many bytes become a part of the page. Larger ones stay where they are:
        a web server has to hand them out, or the user chooses the file.

    Returns
    -------
    bool
        Whether the page holds the tiles.

    Raises
    ------
    OutputError
        If the page cannot be written; then an existing one does not change.
    """
    target, source = Path(path), Path(tiles)
    check_html(target, overwrite=overwrite)
    holds = source.stat().st_size <= embedded
    address = os.path.relpath(source.resolve(), target.resolve().parent)
    with (
        source.open("rb") as archive,
        staged(target, ".html", overwrite=overwrite) as temporary,
        writing_to(target),
        temporary.open("w", encoding="utf-8", newline="\n") as page,
    ):
        before, after = _page(_about(Archive(archive).metadata, address)).split("@tiles@")
        page.write(before)
        if holds:
            _encode(archive, page)
        page.write(after)
    return holds


def _about(metadata: Mapping[str, Any], address: str) -> dict[str, Any]:
    """Return what the page has to know before it reads the tiles."""
    own = metadata[KEY]
    return {
        "name": metadata["name"],
        "source": own["source"],
        "version": own["version"],
        "bounds": own["bounds"],
        "levels": own["levels"],
        "ramps": own["ramps"],
        "fields": list(metadata["vector_layers"][0]["fields"]),
        "address": quote(Path(address).as_posix()),
    }


def _page(about: Mapping[str, Any]) -> str:
    """Return the page, with the placeholder for the tiles."""
    folder = files(__package__)
    read = {
        name: folder.joinpath(path).read_text(encoding="utf-8")
        for name, path in (
            ("maplibre_css", "vendor/maplibre-gl.css"),
            ("maplibre_js", "vendor/maplibre-gl.js"),
            ("pmtiles_js", "vendor/pmtiles.js"),
            ("page_css", "page.css"),
            ("page_js", "page.js"),
        )
    }
    # A part of a script cannot end it: no name can add code to the page.
    document = json.dumps(about)
    for letter in "<&@":
        document = document.replace(letter, f"\\u{ord(letter):04x}")
    values = {
        **{name: _SOURCE_MAP.sub("", text) for name, text in read.items()},
        "title": html.escape(str(about["name"])).replace("@", "&#64;"),
        "about": document,
        "tiles": "@tiles@",
        "policy": "@policy@",
    }
    template = folder.joinpath("page.html").read_text(encoding="utf-8")
    page = _PLACEHOLDER.sub(lambda match: values[match[1]], template)
    return page.replace("@policy@", _policy(page), 1)


def _policy(page: str) -> str:
    """Return what the page may do: run its own scripts, and read tiles next to it."""
    own = " ".join(map(policy_digest, _SCRIPT.findall(page)))
    return (
        f"default-src 'none'; script-src {own}; worker-src blob:; child-src blob:; "
        "style-src 'unsafe-inline'; img-src data: blob:; connect-src 'self' blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _encode(archive: IO[bytes], page: IO[str]) -> None:
    archive.seek(0)
    while chunk := archive.read(_CHUNK):
        page.write(base64.b64encode(chunk).decode("ascii"))
