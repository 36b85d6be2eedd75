"""Recipe: values are kept exactly, and invalid values are refused in one line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import fields
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geomesh.errors import RecipeError
from geomesh.parameters import (
    DOMAINS,
    FARTHEST_EDGE,
    GRAY_METHODS,
    LARGEST_RESIZE,
    SIFT_SOURCES,
    STATISTICS,
)
from geomesh.recipe import PRESETS, Recipe

NAMES = tuple(field.name for field in fields(Recipe))


@st.composite
def recipes(draw: st.DrawFn) -> Recipe:
    def maybe(values: st.SearchStrategy[Any]) -> Any:
        return draw(st.none() | values)

    lengths = st.floats(0, 1e6)
    low = draw(st.floats(0, 99))
    thresholds = sorted(draw(st.tuples(lengths, lengths)))
    return Recipe(
        gray=draw(st.sampled_from([*GRAY_METHODS, "band:1", "band:12"])),
        stretch=(low, draw(st.floats(low, 100, exclude_min=True))),
        stretch_gray=draw(st.booleans()),
        sobel=draw(st.booleans()),
        resize=maybe(st.tuples(st.integers(1, 9999), st.integers(1, 9999))),
        canny_low=thresholds[0],
        canny_high=maybe(st.just(thresholds[1])),
        canny_l2=draw(st.booleans()),
        sift_source=draw(st.sampled_from(SIFT_SOURCES)),
        sift_max_octave=maybe(st.integers(-1, 9)),
        sift_octave_layers=draw(st.integers(1, 9)),
        sift_sigma=draw(st.floats(0.1, 10)),
        edge_distance=maybe(st.floats(0, FARTHEST_EDGE)),
        min_spacing=draw(lengths),
        nodes=maybe(st.integers(1, 10**9) | st.sampled_from(["1%", "0.25%", "400"])),
        domain=draw(st.sampled_from(DOMAINS)),
        border_spacing=maybe(st.floats(0.1, 1e6)),
        min_hole=draw(st.integers(0, 9999)),
        statistics=tuple(draw(st.lists(st.sampled_from(STATISTICS), unique=True))),
    )


# JSON


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_survives_json(name: str) -> None:
    recipe = Recipe.from_preset(name)
    again = Recipe.from_json(recipe.to_json())
    assert again == recipe
    assert hash(again) == hash(recipe)
    assert recipe.preset == name


@given(recipes())
def test_any_recipe_survives_json(recipe: Recipe) -> None:
    again = Recipe.from_json(recipe.to_json())
    assert again == recipe
    assert hash(again) == hash(recipe)


def test_json_holds_every_parameter() -> None:
    assert tuple(json.loads(Recipe().to_json())) == NAMES


def test_a_document_may_leave_parameters_out() -> None:
    assert Recipe.from_json('{"canny_low": 5}') == Recipe(canny_low=5)


@pytest.mark.parametrize("document", ["", "{", "[1, 2]", "7", "null", '"paper"'])
def test_a_document_that_is_no_recipe_is_refused(document: str) -> None:
    with pytest.raises(RecipeError) as caught:
        Recipe.from_json(document)
    assert "\n" not in str(caught.value)


# Presets


def test_the_defaults_are_the_features_preset() -> None:
    assert Recipe.from_preset("features") == Recipe()


def test_the_paper_preset_is_the_published_system() -> None:
    paper = Recipe.from_preset("paper")
    expected = {
        "sobel": True,
        "resize": (256, 256),
        "canny_low": 100,
        "canny_high": 200,
        "canny_l2": False,
        "sift_source": "edges",
        "sift_octave_layers": 3,
        "sift_contrast_threshold": 0.04,
        "sift_edge_threshold": 10,
        "sift_sigma": 1.6,
        "sift_max_octave": None,
        "edge_distance": None,
        "domain": "hull",
        "stretch_gray": False,
    }
    assert {name: getattr(paper, name) for name in expected} == expected


@pytest.mark.parametrize("name", ["", "Paper", "quick", None, 3, ["paper"]])
def test_an_unknown_preset_is_refused(name: Any) -> None:
    with pytest.raises(RecipeError) as caught:
        Recipe.from_preset(name)
    assert repr(name) in str(caught.value)
    assert "features" in str(caught.value)


# Unknown names and invalid values


@pytest.mark.parametrize("name", ["canny", "Canny_low", "node", ""])
def test_an_unknown_parameter_is_refused(name: str) -> None:
    for make in (lambda: Recipe().with_values(**{name: 1}), lambda: Recipe.from_dict({name: 1})):
        with pytest.raises(RecipeError) as caught:
            make()
        assert repr(name) in str(caught.value)
        assert "canny_low" in str(caught.value)


BAD = [
    ("preset", 5),
    ("gray", "grey"),
    ("gray", "band:0"),
    ("gray", "band:"),
    ("gray", "band:-1"),
    ("gray", "band:red"),
    ("gray", "band:1.5"),
    ("gray", 3),
    ("gray", None),
    ("stretch", (98, 2)),
    ("stretch", (2, 2)),
    ("stretch", (-1, 98)),
    ("stretch", (2, 101)),
    ("stretch", (2, math.nan)),
    ("stretch", (2,)),
    ("stretch", (2, 50, 98)),
    ("stretch", 5),
    ("stretch", None),
    ("stretch", "ab"),
    ("stretch", ("2", "98")),
    ("stretch_gray", "no"),
    ("stretch_gray", None),
    ("sobel", "false"),
    ("sobel", 2),
    ("resize", 5),
    ("resize", (0, 256)),
    ("resize", (256, -1)),
    ("resize", (256,)),
    ("resize", (256, 256, 3)),
    ("resize", (256.5, 256)),
    ("resize", ("256", "256")),
    ("resize", "256x256"),
    ("resize", (LARGEST_RESIZE + 1, 256)),
    ("resize", True),
    ("canny_low", "abc"),
    ("canny_low", -1),
    ("canny_low", math.nan),
    ("canny_low", math.inf),
    ("canny_low", [100]),
    ("canny_high", "200"),
    ("canny_high", -0.5),
    ("canny_high", True),
    ("canny_l2", "yes"),
    ("sift_source", "sobel"),
    ("sift_source", None),
    ("sift_max_octave", "two"),
    ("sift_max_octave", 1.5),
    ("sift_max_octave", -2),
    ("sift_max_octave", math.nan),
    ("sift_octave_layers", 0),
    ("sift_octave_layers", 2.5),
    ("sift_octave_layers", "3"),
    ("sift_octave_layers", None),
    ("sift_contrast_threshold", -0.01),
    ("sift_contrast_threshold", "low"),
    ("sift_contrast_threshold", None),
    ("sift_edge_threshold", 0),
    ("sift_edge_threshold", math.nan),
    ("sift_edge_threshold", "10"),
    ("sift_sigma", 0),
    ("sift_sigma", -1.6),
    ("sift_sigma", math.inf),
    ("sift_sigma", (1.6,)),
    ("edge_distance", -1),
    ("edge_distance", FARTHEST_EDGE + 1),
    ("edge_distance", "far"),
    ("min_spacing", -2),
    ("min_spacing", math.nan),
    ("min_spacing", None),
    ("min_spacing", "2"),
    ("nodes", 0),
    ("nodes", -5),
    ("nodes", 2.5),
    ("nodes", True),
    ("nodes", "many"),
    ("nodes", "0%"),
    ("nodes", "-1%"),
    ("nodes", "%"),
    ("nodes", "nan%"),
    ("nodes", "inf%"),
    ("nodes", "5 000"),
    ("nodes", ""),
    ("nodes", [5000]),
    ("domain", "everything"),
    ("domain", None),
    ("domain", ["valid"]),
    ("border_spacing", -1),
    ("border_spacing", 0),
    ("border_spacing", "wide"),
    ("min_hole", -1),
    ("min_hole", "64"),
    ("min_hole", 1.5),
    ("min_hole", None),
    ("statistics", "mean"),
    ("statistics", ("mean", "mode")),
    ("statistics", None),
    ("statistics", 5),
    ("statistics", (1,)),
]


@pytest.mark.parametrize(("name", "value"), BAD, ids=repr)
def test_a_value_that_makes_no_sense_is_refused(name: str, value: Any) -> None:
    with pytest.raises(RecipeError) as caught:
        Recipe().with_values(**{name: value})
    message = str(caught.value)
    assert "\n" not in message
    assert name in message
    parts = value if isinstance(value, tuple) else ()
    assert any(repr(part) in message for part in (value, *parts)), message


@pytest.mark.parametrize("low", [200, 100.5])
def test_the_low_threshold_must_not_exceed_the_high_one(low: float) -> None:
    with pytest.raises(RecipeError, match=rf"canny_low is {low}: .*canny_high"):
        Recipe(canny_low=low, canny_high=100)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("canny_low", 0),
        ("canny_high", None),
        ("edge_distance", 0),
        ("min_spacing", 0),
        ("min_hole", 0),
        ("nodes", 1),
        ("nodes", "100"),
        ("nodes", " 2 %"),
        ("sift_max_octave", -1),
        ("sift_max_octave", None),
        ("resize", (1, 1)),
        ("resize", (LARGEST_RESIZE, LARGEST_RESIZE)),
        ("edge_distance", FARTHEST_EDGE),
        ("stretch", (0, 100)),
        ("statistics", ()),
        ("gray", "band:12"),
    ],
)
def test_a_value_at_the_limit_is_taken(name: str, value: Any) -> None:
    assert getattr(Recipe().with_values(**{name: value}), name) == value


@pytest.mark.parametrize(
    ("name", "listed"),
    [("stretch", [1, 99]), ("resize", [64, 32]), ("statistics", ["mean", "std"])],
)
def test_a_list_is_as_good_as_a_tuple(name: str, listed: list[Any]) -> None:
    recipe = Recipe().with_values(**{name: listed})
    assert recipe == Recipe().with_values(**{name: tuple(listed)})
    assert Recipe.from_json(recipe.to_json()) == recipe


def test_with_values_leaves_the_recipe_as_it_was() -> None:
    recipe = Recipe()
    assert recipe.with_values(canny_low=7.0).canny_low == 7
    assert recipe.canny_low is None
    with pytest.raises(AttributeError):
        recipe.canny_low = 7.0  # type: ignore[misc]


# Budget and locality


@pytest.mark.parametrize(
    ("nodes", "pixels", "expected"),
    [
        (None, 1000, None),
        (5000, 1000, 5000),
        ("5000", 1000, 5000),
        ("1%", 65536, 655),
        ("0.5%", 1000, 5),
        ("100%", 77, 77),
        ("1%", 10, 1),
        ("2 %", 1000, 20),
    ],
)
def test_node_budget(nodes: int | str | None, pixels: int, expected: int | None) -> None:
    assert Recipe(nodes=nodes).node_budget(pixels) == expected


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, True),
        ({"sift_max_octave": -1}, True),
        ({"sift_max_octave": 3}, False),
        ({"sift_max_octave": None}, False),
        ({"sift_source": "edges"}, False),
    ],
)
def test_only_low_octaves_of_the_gray_image_are_local(values: dict, expected: bool) -> None:
    assert Recipe(**values).is_local is expected


# Modules that an import loads

HEAVY = ("cv2", "geopandas", "matplotlib", "numba", "numpy", "rasterio", "rich", "scipy", "shapely")


def run(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("module", ["geomesh", "geomesh.recipe", "geomesh.errors", "geomesh.cli"])
def test_importing_brings_nothing_heavy(module: str) -> None:
    program = f"import sys, {module}; print(*sorted({{n.split('.')[0] for n in sys.modules}}))"
    loaded = set(run("-c", program).split())
    assert "geomesh" in loaded
    assert loaded.isdisjoint(HEAVY)


def test_meshing_needs_no_data_frames() -> None:
    program = "import sys, geomesh.pipeline.mesh_scene; print('pandas' in sys.modules)"
    assert run("-c", program).strip() == "False"


def test_help_answers_without_anything_heavy() -> None:
    program = (
        "import sys, atexit\n"
        "sys.argv = ['geomesh', '--help']\n"
        f"heavy = {HEAVY!r}\n"
        "atexit.register(lambda: print('loaded:', *(n for n in heavy if n in sys.modules)))\n"
        "from geomesh.cli import main\n"
        "main()\n"
    )
    help_text, _, loaded = run("-c", program).partition("loaded:")
    assert "geomesh mesh scene.tif -o mesh.gpkg" in help_text
    assert loaded.split() == []


def test_help_of_mesh_lists_the_presets() -> None:
    text = run("-c", "import sys; sys.argv = ['geomesh', 'mesh', '--help']\n"
               "from geomesh.cli import main; main()")  # fmt: skip
    for name in PRESETS:
        assert name in text
