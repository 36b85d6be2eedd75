"""Pictures: their content is correct, and they are written like every other output."""

import numpy as np
import pytest
from affine import Affine
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.image import imread

import geomesh
from geomesh.errors import OutputError
from geomesh.raster.crop import middle
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from geomesh.view.plot import plot_mesh, save_picture
from geomesh.view.stages import draw_stages, run_stages
from support.samples import OLINDA, mirrored


def stages_of(source, **values):
    return run_stages(open_scene(source), Recipe().with_values(**values), lambda *_: None)


@pytest.mark.parametrize("preset", ["features", "paper"])
def test_the_stages_are_those_of_the_mesh(olinda, preset):
    recipe = Recipe.from_preset(preset)
    stages = run_stages(open_scene(olinda), recipe, lambda *_: None)
    mesh = geomesh.mesh_raster(olinda, preset=preset)
    np.testing.assert_array_equal(stages.mesh.nodes, mesh.nodes)
    assert stages.gray.shape == stages.edges.shape == mesh.plane_size[::-1]
    assert stages.image.shape == (352, 349, 3)
    if preset == "features":
        features = mesh.nodes[mesh.node_table["kind"] == "feature"]
        row, col = np.floor(features[:, ::-1]).astype(int).T
        near = [
            stages.edges[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2].any()
            for r, c in zip(row, col, strict=True)
        ]
        assert all(near)


def test_the_figure_has_four_panels_with_their_figures(olinda):
    figure = draw_stages(stages_of(olinda))
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert [title[:3] for title in titles] == ["(a)", "(b)", "(c)", "(d)"]
    assert "349 × 352" in titles[0]
    assert "SIFT keypoints" in titles[2]


def test_a_large_scene_is_shown_by_its_middle():
    image = mirrored(OLINDA, 2500, 300)
    scene = open_scene((image, None, None))
    shown = middle(scene)
    assert (shown.grid.width, shown.grid.height) == (1024, 300)
    assert shown.window.col == 738
    stages = run_stages(scene, Recipe(), lambda *_: None)
    np.testing.assert_array_equal(stages.image[..., 0], image[0][:, 738:1762])


def test_a_mesh_drawn_on_the_map_has_the_colours_of_the_image(olinda, tmp_path):
    mesh = geomesh.mesh_raster(olinda)
    path = tmp_path / "mesh.png"
    axes = mesh.plot(path=path)
    west, south, east, north = mesh.grid.bounds()
    assert axes.get_xlim() == (west, east)
    assert axes.get_ylim() == (south, north)
    picture = imread(path)[..., :3]
    height, width, _ = picture.shape
    middle_part = picture[height // 4 : height // 2, width // 4 : width // 2]
    means = np.array([mesh.triangle_table[f"{c}_mean"] for c in ("red", "green", "blue")])
    expected = means.mean(axis=1) / np.percentile(means, 99)  # brightened
    assert np.abs(middle_part.mean(axis=(0, 1)) - expected).max() < 0.2


def test_any_numeric_column_can_be_drawn(olinda, tmp_path):
    mesh = geomesh.mesh_raster(olinda, nodes=200)
    axes = plot_mesh(mesh, column="min_angle", path=tmp_path / "angles.png")
    np.testing.assert_array_equal(
        axes.collections[0].get_array(), mesh.quality().table["min_angle"]
    )


@pytest.mark.parametrize("name", ["figure.bmp", "figure", "missing/figure.png"])
def test_a_picture_that_cannot_be_written_is_refused(olinda, tmp_path, name):
    figure = draw_stages(stages_of(olinda, nodes=100))
    with pytest.raises(OutputError, match="figure"):
        save_picture(figure, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_narrow_image_makes_a_page_of_sensible_size():
    image = mirrored(OLINDA, 3, 1500)
    figure = draw_stages(stages_of((image, None, None)))
    width, height = figure.get_size_inches()
    assert max(width, height) < 20


def test_a_plot_is_drawn_where_the_caller_wants_it(olinda):
    mesh = geomesh.mesh_raster(olinda, nodes=100)
    ax = Figure().subplots()
    assert mesh.plot(ax=ax) is ax
    assert ax.get_aspect() == 1
    assert len(ax.collections) == 1


def test_a_plot_that_cannot_be_drawn_leaves_no_figure(olinda):
    mesh = geomesh.mesh_raster(olinda, nodes=100)
    before = pyplot.get_fignums()
    with pytest.raises(ValueError, match="column is 'nope'"):
        mesh.plot("nope")
    assert pyplot.get_fignums() == before


@pytest.mark.parametrize(
    ("transform", "crs", "upwards"),
    [
        (Affine(30, 0, 0, 0, -30, 9000), "EPSG:31985", True),
        (Affine(30, 0, 0, 0, 30, 0), "EPSG:31985", True),
        (Affine(30, 0, 0, 0, -30, 9000), None, True),
        (None, None, False),
    ],
    ids=["north up", "south up", "without a crs", "rows"],
)
@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_y_runs_up_unless_it_counts_rows(olinda, transform, crs, upwards):
    mesh = geomesh.mesh_raster((mirrored(olinda, 200, 150), transform, crs), nodes=100)
    bottom, top = mesh.plot(ax=Figure().subplots()).get_ylim()
    assert (bottom < top) == upwards
