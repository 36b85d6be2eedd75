"""Save figures as image files: checked before the work, and written atomically."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import OutputError
from geomesh.io.atomic import check_place, staged, writing_to

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.figure import Figure

PICTURES = (".png", ".pdf", ".svg", ".jpg")


def check_picture(path: str | PathLike[str], *, overwrite: bool) -> None:
    """Raise OutputError if the picture cannot be written; call this before any work is done.

    Raises
    ------
    OutputError
        If `path` has an unknown extension, exists (unless `overwrite`), or cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in PICTURES:
        raise OutputError(f"{path} is not named as a picture; choose from {', '.join(PICTURES)}")
    check_place(Path(path), overwrite=overwrite)


def save_picture(figure: Figure, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Save a figure at print resolution, in the format of the extension.

    Raises
    ------
    OutputError
        If the figure cannot be written; then an existing file does not change.
    """
    check_picture(path, overwrite=overwrite)
    target = Path(path)
    with writing_to(target), staged(target, target.suffix, overwrite=overwrite) as temporary:
        figure.savefig(temporary, dpi=200, bbox_inches="tight", pad_inches=0.08)
