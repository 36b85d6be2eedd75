"""The certificate: the checks that a mesh must pass before it is written."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from geomesh.arrays.plain import plain_json
from geomesh.errors import CertificateError


@dataclass(frozen=True)
class DomainFacts:
    """Facts about the area that a mesh must cover, known before the triangulation.

    Parameters
    ----------
    kind : {"valid", "image", "hull"}
    area : float
        Area inside the outline, in square pixels.
    components, holes : int
        Number of outer and inner loops of the outline.
    valid_pixels : int
        Number of valid pixels of the scene.
    pixels : int, optional
        Number of pixels whose centre is inside the outline; None if the outline does
        not follow pixels (`hull`).
    islands_dropped, holes_bridged : int
        Number of islands of data, and of holes of nodata, that were removed because they
        are smaller than the recipe's `min_hole`.
    pixels_dropped : int
        Number of pixels in those islands minus the number of pixels in those holes.
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
    """One statement about a mesh, and whether it is true.

    Parameters
    ----------
    name : str
        The statement.
    passed : bool
        Whether the statement is true.
    detail : str
        The numbers that were compared.
    """

    name: str
    passed: bool
    detail: str


@dataclass(frozen=True)
class Fact:
    """A figure of a mesh that is reported and not a condition: no value of it is wrong.

    Parameters
    ----------
    name : str
        What the figure is about.
    detail : str
        The figure.
    """

    name: str
    detail: str


@dataclass(frozen=True)
class Certificate:
    """The results of all checks of a mesh.

    Parameters
    ----------
    checks : tuple of Check
    min_angle : float
        Smallest angle of all triangles, in degrees, in the plane of the image that the
        pipeline worked on; NaN if there are no triangles.
    facts : tuple of Fact
        What a refined mesh reaches. Other meshes have none.
    """

    checks: tuple[Check, ...]
    min_angle: float
    facts: tuple[Fact, ...] = ()

    def __repr__(self) -> str:
        held = sum(check.passed for check in self.checks)
        return f"<Certificate: {held} of {len(self.checks)} checks hold>"

    @property
    def passed(self) -> bool:
        """True if every check passed."""
        return all(check.passed for check in self.checks)

    def require(self) -> None:
        """Raise CertificateError, with the names of the failed checks, if any check failed."""
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
            **({"facts": [asdict(fact) for fact in self.facts]} if self.facts else {}),
        }
