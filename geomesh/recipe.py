"""Recipe: the parameters of all stages, and the presets.

This module imports no slow library, because `geomesh --help` lists the presets.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from geomesh.errors import RecipeError
from geomesh.parameters import DEFAULT_BUDGET, DEFAULT_STATISTICS, RULES, Effort, Model

# Up to this octave, a tile with a halo of 64 pixels gives the keypoints of the whole image.
LOCAL_OCTAVE = 2

# The largest blur within an octave for which that is true: the one of SIFT's default layers.
LOCAL_BLUR = 1.6 * 2 ** (2 / 3)

# Parameters that are lists in JSON.
_TUPLES = ("stretch", "resize", "statistics", "max_error", "rmse")

# Parameters that only refinement uses, and that have no effect without it.
_OF_REFINEMENT = ("max_error", "rmse", "min_angle", "model", "effort", "keep_features")


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """The parameters that decide how a raster becomes a mesh.

    A recipe without arguments is the preset "features". The default preset of `mesh_raster`
    and of the command is another one: ``Recipe.from_preset("adaptive")``. Every output contains
    its recipe, so the same mesh can be made again: ``Recipe.from_json(document)``.

    Parameters
    ----------
    preset : str
        Name of the preset that the recipe started from.
    gray : {"auto", "luma", "mean", "pca"} or "band:N"
        How the bands become one gray image: Rec. 601 luma, mean, first principal
        component, or one band of the file (the first is 1). "auto" is luma if the
        bands are red, green and blue, the band itself if there is only one, else pca.
    stretch : (float, float)
        Percentiles of the valid pixels that become black and white.
    stretch_gray : bool
        True: stretch the gray image. False, as in the paper: stretch each band before
        the gray image is made, and do not stretch 8-bit bands.
    sobel : bool
        Replace the gray image by its Sobel magnitude before all other steps.
    resize : (int, int) or None
        Width and height in pixels to resize to; None keeps the native resolution.
    canny_low, canny_high : float or None
        Hysteresis thresholds on the 3x3 Sobel gradient of the 8-bit gray image,
        in gray levels. None: computed from the median gradient.
    canny_l2 : bool
        True: measure the gradient by its L2 norm. False: by its L1 norm, the default
        of OpenCV.
    sift_source : {"gray", "edges"}
        The input image of SIFT: the gray image, or the Canny edge map.
    sift_upsample : bool
        True: search for keypoints in the image at twice its size, the default of SIFT.
        False: at its own size, smoothed over 2 x 2 pixels. This takes less than half of
        the time, but misses the finest keypoints, which are most of all keypoints.
    sift_max_octave : int or None
        Highest octave to keep (-1 is the doubled image, 0 the native one). Tiles need a
        limit, because a keypoint of a high octave depends on a large area. None: all.
    sift_octave_layers : int
        Layers per octave.
    sift_contrast_threshold, sift_edge_threshold : float
        OpenCV's thresholds on contrast and on similarity to an edge, without unit.
    sift_sigma : float
        Blur of the first octave, in pixels.
    edge_distance : float or None
        Largest distance of a keypoint to a Canny edge, in pixels between pixel centres.
        Keypoints farther away are dropped. None: all are kept.
    min_spacing : float
        Smallest distance between feature nodes, in pixels. The strongest node is kept.
    nodes : int, str or None
        Node budget: a number, or a percentage of the valid pixels such as "1%".
        With `refine`: the number of nodes that the mesh gets. None: 1 % of the valid pixels, at
        least twice the nodes of outline and breaklines; or as many as `max_error` or `rmse`
        needs. Together with one of these, `nodes` is a limit.
        Without `refine`: the strongest features are kept, spread evenly over the image. None:
        all.
    domain : {"valid", "image", "hull"}
        Area of the mesh: the valid data, the whole frame, or the convex hull of the
        keypoints.
    border_spacing : float or None
        Smallest distance between the nodes that are added along the outline, in pixels.
        Nodes are added until they are as close to each other as to the nearest feature
        node, or until they reach this distance. None: the median distance between
        feature nodes.
    min_hole : int
        Holes of nodata with fewer pixels are filled, and islands of data with fewer
        pixels are dropped.
    refine : bool
        Refine the mesh, so that it shows the raster as well as its nodes can.
    max_error : float, tuple of float, or None
        Goal of the refinement: no valid pixel is farther than this from the surface, in the
        raster's units. One number for all bands, or one for each.
    rmse : float, tuple of float, or None
        Goal of the refinement: the root mean square error of each band is at most this.
    min_angle : float
        Smallest angle that refinement may make, in degrees.
    model : {"linear", "constant"}
        What refinement optimises: a surface that is linear in each triangle, with values at
        the nodes; or one value for each triangle, which is its mean.
    effort : {"fast", "normal", "best"}
        How much time refinement takes for a better mesh.
    keep_features : bool
        Refinement does not move or remove the feature nodes.
    z : int, str or None
        The band that is the height of the nodes, by number (the first is 1) or by name. None:
        the mesh is flat.
    z_factor : float
        Factor by which the heights are multiplied, such as 0.3048 from feet to metres.
    statistics : tuple of {"mean", "std", "min", "max", "median", "majority", "variety"}
        What to compute for each triangle and each band: also the median, the most frequent
        value, and the number of distinct values. For the classes of a palette only the last
        two make sense: those of them that are in the list are computed, or else both.
    """

    preset: str = "features"
    gray: str = "auto"
    stretch: tuple[float, float] = (2.0, 98.0)
    stretch_gray: bool = True
    sobel: bool = False
    resize: tuple[int, int] | None = None
    canny_low: float | None = None
    canny_high: float | None = None
    canny_l2: bool = True
    sift_source: str = "gray"
    sift_upsample: bool = True
    sift_max_octave: int | None = 2
    sift_octave_layers: int = 3
    sift_contrast_threshold: float = 0.002
    sift_edge_threshold: float = 10.0
    sift_sigma: float = 1.6
    edge_distance: float | None = 1.5
    min_spacing: float = 2.0
    nodes: int | str | None = None
    domain: str = "valid"
    border_spacing: float | None = None
    min_hole: int = 64
    refine: bool = False
    max_error: float | tuple[float, ...] | None = None
    rmse: float | tuple[float, ...] | None = None
    min_angle: float = 10.0
    model: Model = "linear"
    effort: Effort = "normal"
    keep_features: bool = False
    z: int | str | None = None
    z_factor: float = 1.0
    statistics: tuple[str, ...] = DEFAULT_STATISTICS

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, list) and field.name in _TUPLES:
                value = tuple(map(_plain, value))
            object.__setattr__(self, field.name, _plain(value))
        for name, (is_valid, expected) in RULES.items():
            value = getattr(self, name)
            if not is_valid(value):
                raise RecipeError(f"{name} is {value!r}: expected {expected}")
        low, high = self.canny_low, self.canny_high
        if low is not None and high is not None and low > high:
            raise RecipeError(f"canny_low is {low!r}: expected canny_high ({high!r}) or less")
        if self.sift_max_octave == -1 and not self.sift_upsample:
            raise RecipeError(
                "sift_max_octave is -1, the doubled image, but sift_upsample is false: expected 0 "
                "or more"
            )
        self._require_one_goal()
        self.node_budget(1)

    def _require_one_goal(self) -> None:
        if self.max_error is not None and self.rmse is not None:
            raise RecipeError(
                f"`max_error` is {self.max_error!r} and `rmse` is {self.rmse!r}: give one of both"
            )
        if self.max_error is not None and self.model == "constant":
            raise RecipeError(
                "`max_error` needs `model=linear`: one value for each triangle cannot keep a bound"
            )
        defaults = {field.name: field.default for field in fields(self)}
        for name in _OF_REFINEMENT:
            value = getattr(self, name)
            if value != defaults[name]:
                self.require_refinement(name, value)

    def require_refinement(self, name: str, value: object) -> None:
        """Raise RecipeError if the recipe does not refine, so that a given value has no effect."""
        if not self.refine:
            raise RecipeError(
                f"`{name}` is {value!r}, but the preset {self.preset} is not refined: use "
                "`preset=adaptive`"
            )

    @property
    def budget(self) -> int | str | None:
        """The node budget in force: `nodes`, or 1 % if refinement has no other goal."""
        if self.refine and self.nodes is None and self.max_error is None and self.rmse is None:
            return DEFAULT_BUDGET
        return self.nodes

    def node_budget(self, pixels: int) -> int | None:
        """Return the node budget for an image with `pixels` valid pixels; None: no limit."""
        if self.budget is None:
            return None
        text = str(self.budget).strip()
        percent = text.endswith("%")
        try:
            number = float(text.removesuffix("%")) if percent else int(text)
        except ValueError:
            number = math.nan
        if not 0 < number < math.inf:
            raise RecipeError(
                f"nodes is {self.nodes!r}: give a number such as 5000 or a percentage such as 1%"
            )
        return max(round(number / 100 * pixels), 1) if percent else int(number)

    @property
    def is_local(self) -> bool:
        """Whether tiles find the same keypoints as the whole image.

        High octaves and large blurs need a larger halo than tiles have. SIFT on the edge
        map needs hysteresis of the whole image first. Such recipes use one tile.
        """
        capped = self.sift_max_octave is not None and self.sift_max_octave <= LOCAL_OCTAVE
        blur = self.sift_sigma * 2 ** (2 / self.sift_octave_layers)
        return capped and blur <= LOCAL_BLUR and self.sift_source == "gray"

    def with_values(self, **values: Any) -> Recipe:
        """Return the recipe with some values changed; unknown names raise RecipeError."""
        known = {field.name for field in fields(self)}
        for name in values:
            _require_one_of("a parameter of the recipe", name, tuple(sorted(known)))
        return replace(self, **values)

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as a dict of JSON values."""
        values = asdict(self)
        return {name: list(v) if isinstance(v, tuple) else v for name, v in values.items()}

    def to_json(self) -> str:
        """Return the recipe as a JSON document."""
        return json.dumps(self.to_dict(), indent=2)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Recipe:
        """Return the recipe that `to_dict` wrote."""
        if not isinstance(values, Mapping):
            raise RecipeError(f"{values!r} is not a recipe: expected names and values")
        return cls().with_values(**values)

    @classmethod
    def from_json(cls, document: str) -> Recipe:
        """Return the recipe that `to_json` wrote."""
        try:
            values = json.loads(document)
        except ValueError as error:
            raise RecipeError(f"the recipe is not JSON ({error})") from error
        return cls.from_dict(values)

    @classmethod
    def from_preset(cls, name: str) -> Recipe:
        """Return the recipe of a preset; see `PRESETS`."""
        _require_one_of("preset", name, tuple(PRESETS))
        return PRESETS[name]


def _plain(value: Any) -> Any:
    """Convert a number of numpy to Python, because JSON cannot write it otherwise."""
    return value.item() if hasattr(value, "item") else value


def _require_one_of(name: str, value: Any, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise RecipeError(f"{name} is {value!r}: choose from {', '.join(choices)}")


DEFAULT_PRESET = "adaptive"

PRESETS: Mapping[str, Recipe] = {
    "adaptive": Recipe(preset="adaptive", refine=True),
    "features": Recipe(),
    # Exactly the published system. Where the paper gives no value (thresholds,
    # interpolation), this uses the defaults of OpenCV and the usual methods.
    "paper": Recipe(
        preset="paper",
        stretch_gray=False,
        sobel=True,
        resize=(256, 256),
        canny_low=100.0,
        canny_high=200.0,
        canny_l2=False,
        sift_source="edges",
        sift_contrast_threshold=0.04,
        sift_max_octave=None,
        edge_distance=None,
        min_spacing=0.0,
        domain="hull",
    ),
}
