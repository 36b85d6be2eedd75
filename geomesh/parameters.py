"""Allowed values of parameters: lists of choices, and the rules for a recipe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

LayerName = Literal["triangles", "edges", "nodes"]
LAYERS: tuple[LayerName, ...] = ("triangles", "edges", "nodes")

# What a band tagged as alpha is used as, and whether masks hide pixels.
Alpha = Literal["mask", "data"]
ALPHA: tuple[Alpha, ...] = ("mask", "data")

GRAY_METHODS = ("auto", "luma", "mean", "pca")
DOMAINS = ("valid", "image", "hull")
SIFT_SOURCES = ("gray", "edges")

# What a refined mesh shows the raster with, and how long refinement may take.
Model = Literal["linear", "constant"]
MODELS: tuple[Model, ...] = ("linear", "constant")
Effort = Literal["fast", "normal", "best"]
EFFORTS: tuple[Effort, ...] = ("fast", "normal", "best")
# Largest value of min_angle, in degrees. Above it, too few changes of a mesh are allowed.
LARGEST_MIN_ANGLE = 25
# The node budget of a refined mesh without any other goal.
DEFAULT_BUDGET = "1%"

STATISTICS = ("mean", "std", "min", "max", "median", "majority", "variety")
DEFAULT_STATISTICS = STATISTICS[:4]
# Those that need to know how often each value occurs, and those that make sense for classes.
COUNTED_STATISTICS = ("median", "majority", "variety")
CLASS_STATISTICS = ("majority", "variety")

# Largest value of edge_distance, in pixels. A tile does not see edges outside its halo.
FARTHEST_EDGE = 32
LARGEST_RESIZE = 32_767
_LARGEST_NUMBER = 1e300

Rule = tuple[Callable[[Any], bool], str]


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) < _LARGEST_NUMBER


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_gray(value: Any) -> bool:
    if not isinstance(value, str):
        return False
    number = value.removeprefix("band:")
    return value in GRAY_METHODS or (number != value and number.isdecimal() and int(number) > 0)


def _is_stretch(value: Any) -> bool:
    pair = isinstance(value, tuple) and len(value) == 2 and all(map(_is_number, value))
    return pair and 0 <= value[0] < value[1] <= 100


def _is_size(value: Any) -> bool:
    pair = isinstance(value, tuple) and len(value) == 2 and all(map(_is_whole, value))
    return pair and min(value) >= 1 and max(value) <= LARGEST_RESIZE


def _one_of(choices: tuple[str, ...]) -> Rule:
    return lambda value: isinstance(value, str) and value in choices, f"one of {', '.join(choices)}"


_TEXT: Rule = (lambda value: isinstance(value, str), "a name")
_FLAG: Rule = (lambda value: isinstance(value, bool), "true or false")
_NOT_NEGATIVE: Rule = (lambda value: _is_number(value) and value >= 0, "a number, 0 or more")
_POSITIVE: Rule = (lambda value: _is_number(value) and value > 0, "a number above 0")
_OPTIONAL: Rule = (
    lambda value: value is None or (_is_number(value) and value >= 0),
    "a number, 0 or more, or null",
)


def _is_limit(value: Any) -> bool:
    """Return whether a value is None, a positive number, or a tuple of one for each band."""
    each = value if isinstance(value, tuple) else (value,)
    return value is None or (len(each) > 0 and all(_is_number(v) and v > 0 for v in each))


_LIMIT: Rule = (_is_limit, "a number above 0, or a list of one for each band, or null")

RULES: Mapping[str, Rule] = {
    "preset": _TEXT,
    "gray": (_is_gray, f"one of {', '.join(GRAY_METHODS)} or band:N"),
    "stretch": (_is_stretch, "two increasing percentiles such as [2, 98]"),
    "stretch_gray": _FLAG,
    "sobel": _FLAG,
    "resize": (
        lambda value: value is None or _is_size(value),
        f"a width and a height of 1 to {LARGEST_RESIZE} pixels such as [256, 256], or null",
    ),
    "canny_low": _OPTIONAL,
    "canny_high": _OPTIONAL,
    "canny_l2": _FLAG,
    "sift_source": _one_of(SIFT_SOURCES),
    "sift_upsample": _FLAG,
    "sift_max_octave": (
        lambda value: value is None or (_is_whole(value) and value >= -1),
        "a whole number, -1 or more, or null",
    ),
    "sift_octave_layers": (lambda value: _is_whole(value) and value > 0, "a whole number above 0"),
    "sift_contrast_threshold": _NOT_NEGATIVE,
    "sift_edge_threshold": _POSITIVE,
    "sift_sigma": _POSITIVE,
    "edge_distance": (
        lambda value: value is None or (_is_number(value) and 0 <= value <= FARTHEST_EDGE),
        f"a number from 0 to {FARTHEST_EDGE}, or null",
    ),
    "min_spacing": _NOT_NEGATIVE,
    "domain": _one_of(DOMAINS),
    "border_spacing": (
        lambda value: value is None or (_is_number(value) and value > 0),
        "a number above 0, or null",
    ),
    "min_hole": (lambda value: _is_whole(value) and value >= 0, "a whole number, 0 or more"),
    "refine": _FLAG,
    "max_error": _LIMIT,
    "rmse": _LIMIT,
    "min_angle": (
        lambda value: _is_number(value) and 0 <= value <= LARGEST_MIN_ANGLE,
        f"a number of degrees from 0 to {LARGEST_MIN_ANGLE}",
    ),
    "model": _one_of(MODELS),
    "effort": _one_of(EFFORTS),
    "keep_features": _FLAG,
    "z": (
        lambda value: value is None or (isinstance(value, str) and value != "") or _is_whole(value),
        "the number of a band (the first is 1), its name, or null",
    ),
    "z_factor": (lambda value: _is_number(value) and value != 0, "a number other than 0"),
    "statistics": (
        lambda value: isinstance(value, tuple) and all(name in STATISTICS for name in value),
        f"some of {', '.join(STATISTICS)}",
    ),
}
