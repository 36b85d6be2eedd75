"""Write web pages: checked before the work, and written atomically."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import OutputError
from geomesh.io.atomic import check_place, staged, writing_to

if TYPE_CHECKING:
    from os import PathLike

_EXTENSIONS = (".html", ".htm")


def check_html(path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Raise OutputError if a page cannot be written; call this before any work is done.

    Raises
    ------
    OutputError
        If `path` is not named as a page, exists (unless `overwrite`), or cannot be written.
    """
    if Path(path).suffix.lower() not in _EXTENSIONS:
        raise OutputError(f"{path} is not named as a page: name it .html")
    check_place(Path(path), overwrite=overwrite)


def write_html(text: str, path: str | PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a page; the file is complete or does not exist.

    Raises
    ------
    OutputError
        If the file cannot be written; then an existing one does not change.
    """
    target = Path(path)
    with writing_to(target), staged(target, ".html", overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return target


def policy_digest(text: str) -> str:
    """Return the hash by which the policy of a page allows one script or style, and no other."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
