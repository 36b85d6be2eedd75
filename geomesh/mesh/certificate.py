"""The certificate: what was checked of a mesh before anyone may rely on it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from geomesh.arrays.plain import plain_json
from geomesh.errors import CertificateError


@dataclass(frozen=True)
class DomainFacts:
    """What is known, before triangulating, of the area that a mesh must cover.

    Parameters
    ----------
    kind : {"valid", "image", "hull"}
    area : float
        Area inside the outline, in square pixels.
    components, holes : int
        Number of outer and of inner outline loops.
    valid_pixels : int
        Valid pixels of the scene.
    pixels : int, optional
        Pixels whose centre the outline encloses; None where the outline does not
        follow pixels (`hull`).
    islands_dropped, holes_bridged : int
        Islands of data and holes of nodata smaller than the recipe's `min_hole`.
    pixels_dropped : int
        Pixels in those islands, less the pixels in those holes.
    """

    kind: str
    area: float
    components: int
    holes: int
    valid_pixels: int
    pixels: int | None = None
    islands_dropped: int = 0
    holes_bridged: int = 0
    pixels_dropped: int = 0


@dataclass(frozen=True)
class Check:
    """One statement about a mesh, whether it holds, and the figures behind it.

    Parameters
    ----------
    name : str
        The statement.
    passed : bool
    detail : str
    """

    name: str
    passed: bool
    detail: str


@dataclass(frozen=True)
class Certificate:
    """The outcome of all checks; `passed` only if every one of them is.

    Parameters
    ----------
    checks : tuple of Check
    min_angle : float
        Smallest angle of all triangles, in degrees, in the plane of the image that the
        pipeline worked on; NaN without triangles.
    """

    checks: tuple[Check, ...]
    min_angle: float

    def __repr__(self) -> str:
        held = sum(check.passed for check in self.checks)
        return f"<Certificate: {held} of {len(self.checks)} checks hold>"

    @property
    def passed(self) -> bool:
        """Whether every check holds."""
        return all(check.passed for check in self.checks)

    def require(self) -> None:
        """Raise CertificateError naming the checks that failed, if any did."""
        failed = [f"{check.name} ({check.detail})" for check in self.checks if not check.passed]
        if failed:
            raise CertificateError(
                f"the mesh failed its certificate: {'; '.join(failed)}; it was not written. "
                "This is a defect of geomesh: please report it with the source raster"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return the certificate as plain JSON values."""
        return {
            "passed": self.passed,
            "min_angle_degrees": plain_json(self.min_angle),
            "checks": [asdict(check) for check in self.checks],
        }
