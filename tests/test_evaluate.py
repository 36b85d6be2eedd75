"""Evaluate: figures compared with other libraries, averages, tables, and bad images."""

from __future__ import annotations

import csv
import errno
import json
import math
import shutil
import sys
import warnings
from statistics import fmean, median

import cv2
import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from matplotlib.image import imread
from matplotlib.tri import LinearTriInterpolator, Triangulation
from scipy import ndimage, sparse
from scipy.sparse.linalg import lsqr
from scipy.spatial import Delaunay

import geomesh
from geomesh.cli import cli
from geomesh.errors import GeomeshWarning, OutputError, SourceError
from geomesh.evaluate.baselines import baselines
from geomesh.evaluate.comparison import COLUMNS, MEASURES
from geomesh.evaluate.figure import draw_comparison
from geomesh.evaluate.images import find_images
from geomesh.evaluate.run import evaluate
from support.samples import OLINDA, SAMPLES, write_mirrored

DEM = SAMPLES / "colorado_dem_float32_epsg4269.tif"  # no Canny edges with the paper's thresholds
NOWHERE = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
NAMES = list(baselines())


@pytest.fixture(scope="module")
def comparison():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        return evaluate([OLINDA, DEM, NOWHERE])


def figures_of(comparison, image, plane, method):
    (record,) = [r for r in comparison.of(plane, method) if r.image == str(image)]
    return record.figures


def run(*arguments, code=0):
    result = CliRunner().invoke(cli, ["evaluate", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result.stdout, result.stderr


# Figures


@pytest.mark.parametrize("image", [OLINDA, NOWHERE])
@pytest.mark.parametrize(("plane", "preset"), [("256x256", "paper"), ("native", "features")])
@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_a_preset_has_the_figures_of_its_mesh(comparison, image, plane, preset):
    found = figures_of(comparison, image, plane, preset)
    mesh = geomesh.mesh_raster(image, preset=preset)
    summary = mesh.quality().summary()
    measures = summary["measures"]
    assert (found.nodes, found.triangles) == (len(mesh.nodes), len(mesh.triangles))
    assert (found.ab, found.bc, found.ca) == tuple(summary["mean_sides"].values())
    assert found.ki_normalised == summary["ki_normalised"]
    for name in ("ki", "ki_min", "ki_mean"):
        assert getattr(found, name) == measures[name]["mean"]
    assert found.ki_median == measures["ki"]["median"]
    angles = measures["min_angle"]
    assert (found.angle_mean, found.angle_median) == (angles["mean"], angles["median"])
    assert found.angle_p5 == angles["p5"]
    assert found.angle_under_10 == summary["share_min_angle_under"]["10"]


@pytest.fixture(scope="module")
def small_gray():
    """The Olinda scene as the gray image of the paper's size."""
    with rasterio.open(OLINDA) as dataset:
        rgb = np.moveaxis(dataset.read(), 0, -1).copy()
    return cv2.resize(
        cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (256, 256), interpolation=cv2.INTER_AREA
    )


@pytest.fixture(scope="module")
def oracle(comparison, small_gray):
    """Random nodes on that image, with triangles from scipy and their pixels from matplotlib."""
    wanted = int(figures_of(comparison, OLINDA, "256x256", "paper").nodes)
    points = baselines()["random"](small_gray, np.ones((256, 256), np.bool_), wanted)
    triangles = Delaunay(points).simplices
    mesh = Triangulation(*points.T, triangles)
    x, y = np.meshgrid(np.arange(256) + 0.5, np.arange(256) + 0.5)
    return points, mesh, mesh.get_trifinder()(x, y), (x, y)


def cross(u, v):
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def decibels(shown, gray):
    known = np.isfinite(shown)
    return 10 * math.log10(255**2 / np.square(shown[known] - gray[known]).mean())


def test_sides_and_ki_are_those_of_scipys_triangles(comparison, oracle):
    points, mesh, *_ = oracle
    found = figures_of(comparison, OLINDA, "256x256", "random")
    corners = points[mesh.triangles]
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    ab, ca, bc = sides.T
    # For cocircular pixels, scipy may choose other triangles.
    expected = pytest.approx([ab.mean(), bc.mean(), ca.mean()], rel=2e-3)
    assert [found.ab, found.bc, found.ca] == expected
    assert found.ki == pytest.approx((2 * ca * bc / sides.sum(axis=1)).mean(), rel=2e-3)
    assert found.ki_min == pytest.approx((2 * ab * ca / sides.sum(axis=1)).mean(), rel=2e-3)
    of_sides = 2 * found.ca * found.bc / (found.ab + found.bc + found.ca)
    assert found.ki_of_sides == pytest.approx(of_sides, rel=1e-12)


def test_psnr_is_that_of_matplotlibs_interpolation_and_scipys_least_squares(
    comparison, oracle, small_gray
):
    points, mesh, owner, (x, y) = oracle
    found = figures_of(comparison, OLINDA, "256x256", "random")
    # A pixel on an edge may have another owner here, but such pixels are rare.
    assert found.covered == pytest.approx((owner >= 0).mean(), abs=2e-3)
    values = ndimage.map_coordinates(small_gray.astype(float), points[:, ::-1].T - 0.5, order=1)
    shown = LinearTriInterpolator(mesh, values)(x, y).filled(np.nan)
    assert found.psnr_linear_sampled == pytest.approx(decibels(shown, small_gray), abs=0.05)
    inside = owner >= 0
    column = mesh.triangles[owner[inside]]
    a, b, c = (points[column[:, k]] for k in range(3))
    pixel = np.column_stack([x[inside], y[inside]])
    twice = cross(b - a, c - a)
    weights = np.stack(
        [
            cross(b - pixel, c - pixel),
            cross(c - pixel, a - pixel),
            cross(a - pixel, b - pixel),
        ]
    )
    rows = np.repeat(np.arange(len(pixel)), 3)
    matrix = sparse.csr_array(((weights / twice).T.ravel(), (rows, column.ravel())))
    fitted = matrix @ lsqr(matrix, small_gray[inside].astype(float), iter_lim=3000)[0]
    expected = decibels(fitted, small_gray[inside])
    assert found.psnr_linear_least_squares == pytest.approx(expected, abs=0.05)
    ids, position = np.unique(owner[inside], return_inverse=True)
    means = ndimage.mean(small_gray[inside], position, np.arange(len(ids)))
    expected = decibels(means[position], small_gray[inside])
    assert found.psnr_constant_least_squares == pytest.approx(expected, abs=0.05)
    col, row = np.floor(points[mesh.triangles].mean(axis=1)).astype(int).T
    expected = decibels(small_gray[row, col].astype(float)[owner[inside]], small_gray[inside])
    assert found.psnr_constant_sampled == pytest.approx(expected, abs=0.1)


def test_all_methods_get_as_many_nodes_and_the_same_plane(comparison):
    for image in (OLINDA, NOWHERE):
        for plane, first in (("256x256", "paper"), ("native", "features")):
            records = [r for r in comparison.records if (r.image, r.plane) == (str(image), plane)]
            presets = ["paper", "features", "adaptive"][plane == "native" :]
            assert [r.method for r in records] == [*presets, *NAMES]
            assert records[0].method == first
            with rasterio.open(image) as dataset:
                size = (256, 256) if plane == "256x256" else (dataset.width, dataset.height)
            assert {(r.width, r.height) for r in records} == {size}
            assert {r.wanted for r in records} == {records[0].figures.nodes}
            assert {r.figures.nodes for r in records} == {records[0].figures.nodes}


def test_adaptive_refines_the_gray_image_of_the_plane(comparison, small_gray):
    found = figures_of(comparison, OLINDA, "256x256", "adaptive")
    mesh = geomesh.mesh_raster((small_gray, None, None), preset="adaptive", nodes=int(found.nodes))
    # The gray image of a plane is not stretched again, so the keypoints of the start differ.
    assert found.nodes == len(mesh.nodes)
    (band,) = mesh.metadata["refinement"]["bands"]
    rmse = 255 / 10 ** (found.psnr_whole / 20)
    assert rmse == pytest.approx(band["rmse"], rel=0.03)


def test_adaptive_keeps_its_floor_and_is_nearest_to_the_image(comparison):
    for plane, image in (("256x256", OLINDA), ("native", OLINDA), ("native", DEM)):
        records = [r for r in comparison.records if (r.image, r.plane) == (str(image), plane)]
        found = {r.method: r.figures for r in records}
        ours = found.pop("adaptive")
        assert ours.angle_under_10 == 0
        assert ours.covered == 1
        assert ours.psnr_whole > max(other.psnr_whole for other in found.values()) + 1


def test_bounds_that_every_mesh_keeps(comparison):
    for record in comparison.records:
        found = record.figures
        if not found.triangles:
            continue
        assert found.ki_min <= found.ki_mean <= found.ki <= min(found.ca, found.bc)
        assert found.ab <= found.ca <= found.bc <= found.ab + found.ca
        assert 0.5 < found.covered <= 1
        assert found.psnr_linear_least_squares >= found.psnr_linear_sampled
        assert found.psnr_constant_least_squares >= found.psnr_constant_sampled
        if found.covered == 1:
            assert found.psnr_whole == found.psnr_linear_least_squares


def test_overall_figures_are_means_and_medians_of_those_of_the_images(comparison):
    for average in comparison.overall():
        each = [r.figures for r in comparison.of(average.plane, average.method)]
        each = [figures for figures in each if figures.triangles]
        assert average.images == len(each) == (3 if average.plane == "native" else 2)
        for name in MEASURES:
            values = [getattr(figures, name) for figures in each]
            assert getattr(average.mean, name) == pytest.approx(fmean(values), rel=1e-12)
            assert getattr(average.median, name) == pytest.approx(median(values), rel=1e-12)


def test_an_image_in_which_the_paper_finds_nothing_has_figures_where_features_does(comparison):
    (record,) = [r for r in comparison.records if (r.image, r.plane) == (str(DEM), "256x256")]
    assert (record.method, record.figures.nodes, record.wanted) == ("paper", 0, 0)
    assert math.isnan(record.figures.ki)
    assert figures_of(comparison, DEM, "native", "features").triangles > 0
    assert not comparison.failures
    with pytest.warns(GeomeshWarning, match="colorado.*no nodes that span an area.* of paper"):
        evaluate(DEM)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_figures_do_not_depend_on_the_number_of_workers(comparison, workers):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        again = evaluate([str(OLINDA), str(DEM), str(NOWHERE)], workers=workers)
    assert repr(again.records) == repr(comparison.records)  # NaN is not equal to itself


@pytest.mark.slow
def test_of_a_large_image_the_native_plane_is_the_middle(tmp_path):
    path = write_mirrored(tmp_path / "large.tif", OLINDA.name, 2100, 1500)
    large = evaluate(path)
    with rasterio.open(path) as dataset:
        window = rasterio.windows.Window(538, 238, 1024, 1024)
        middle = dataset.read(window=window), dataset.window_transform(window), dataset.crs
    mesh = geomesh.mesh_raster(middle, preset="features")
    found = figures_of(large, path, "native", "features")
    assert (found.nodes, found.triangles) == (len(mesh.nodes), len(mesh.triangles))
    assert {(r.width, r.height) for r in large.of("native", "random")} == {(1024, 1024)}
    paper = geomesh.mesh_raster(path, preset="paper")
    assert figures_of(large, path, "256x256", "paper").nodes == len(paper.nodes)


def test_progress_can_be_followed_and_cancelled():
    seen = []
    evaluate([OLINDA], progress=lambda fraction, message: seen.append((fraction, message)))
    assert seen[-1] == (1.0, "Evaluating: image 1 of 1")

    def stop(fraction, message):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        evaluate([OLINDA], progress=stop)


# Tables, CSV, JSON, figure


def test_the_csv_holds_every_figure_under_its_documented_name(comparison, tmp_path):
    path = tmp_path / "table1.csv"
    comparison.to_csv(path)
    rows = list(csv.DictReader(path.open()))
    assert tuple(rows[0]) == COLUMNS
    images = [row for row in rows if row["row"] == "image"]
    assert len(images) == len(comparison.records)
    for row, record in zip(images, comparison.records, strict=True):
        assert (row["image"], row["plane"], row["method"]) == (
            record.image,
            record.plane,
            record.method,
        )
        for name in MEASURES:
            value = getattr(record.figures, name)
            assert (row[name] == "") == math.isnan(value)
            assert row[name] == "" or float(row[name]) == pytest.approx(value, rel=1e-5)
    means = [row for row in rows if row["row"] == "mean"]
    assert [float(row["ki"]) for row in means] == pytest.approx(
        [average.mean.ki for average in comparison.overall()], rel=1e-5
    )
    text = (SAMPLES.parent / "docs" / "evaluate.md").read_text()
    for name in COLUMNS:
        assert f"| `{name}`" in text or f", `{name}`" in text, name


def test_a_dataframe_has_a_row_for_each_image_plane_and_method(comparison):
    frame = comparison.to_dataframe()
    assert len(frame) == len(comparison.records)
    found = frame[frame.plane == "native"].groupby("method", sort=False).psnr_whole.mean()
    expected = {a.method: a.mean.psnr_whole for a in comparison.overall() if a.plane == "native"}
    assert found.to_dict() == pytest.approx(expected)


def test_json_is_json(comparison):
    document = json.loads(json.dumps(comparison.to_dict(), allow_nan=False))
    assert document["failed"] == 0
    assert len(document["results"]) == len(comparison.records)
    assert len(document["mean"]) == len(document["median"]) == len(comparison.overall())
    empty = next(row for row in document["results"] if row["nodes"] == 0)
    assert empty["ki"] is None


def test_the_figure_shows_every_method_and_image(comparison, tmp_path):
    figure = draw_comparison(comparison)
    names = ["features", "adaptive", *NAMES]
    labels = [[text.get_text() for text in ax.get_yticklabels()] for ax in figure.axes[::3]]
    assert labels == [["paper", *names], names]
    assert "2 images" in figure.axes[0].get_title(loc="left")
    assert "3 images" in figure.axes[3].get_title(loc="left")
    drawn = [line.get_xdata() for line in figure.axes[1].lines if line.get_marker() == "o"]
    expected = [
        [r.figures.angle_mean for r in comparison.of("256x256", method) if r.figures.triangles]
        for method in labels[0]
    ]
    for points, values in zip(drawn, expected, strict=True):
        np.testing.assert_array_equal(points, values)


@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_a_plane_without_figures_is_left_out_of_table_and_figure():
    figure = draw_comparison(evaluate(DEM))
    assert len(figure.axes) == 3
    assert "native" in figure.axes[0].get_title(loc="left")
    stdout, _ = run(DEM)
    assert "0 images" not in stdout
    assert "Native resolution, as many nodes as `features` finds; 1 image" in stdout


@pytest.mark.slow
def test_the_command_prints_tables_and_writes_csv_and_figure(tmp_path, comparison):
    table, picture = tmp_path / "table1.csv", tmp_path / "table1.png"
    stdout, stderr = run(OLINDA, NOWHERE, "-o", table, "--figure", picture)
    assert stderr == ""
    paper = figures_of(comparison, OLINDA, "256x256", "paper")
    line = next(line for line in stdout.splitlines() if OLINDA.name in line).split()
    expected = [
        f"{paper.nodes:.0f}",
        *(f"{v:.2f}" for v in (paper.ab, paper.bc, paper.ca, paper.ki)),
    ]
    assert line[1:6] == expected
    for name in ("paper", "features", "adaptive", *NAMES):
        assert f"\n  {name}" in stdout
    assert stdout.endswith(f"{table}: written\n{picture}: written\n")
    assert len(list(csv.DictReader(table.open()))) == 2 * 17 + 2 * 17
    assert imread(picture).std() > 0.05


@pytest.mark.slow
def test_programs_get_events_or_json(tmp_path):
    table = tmp_path / "t.csv"
    stdout, _ = run(OLINDA, "-o", table, "--progress", "jsonl")
    events = [json.loads(line) for line in stdout.splitlines()]
    assert events[0]["event"] == "start"
    assert events[-1] == {
        "event": "result",
        "outputs": [str(table)],
        "figures": {"images": 1, "failed": 0},
    }
    document = json.loads(run(OLINDA, "--json")[0])
    assert {row["method"] for row in document["results"]} == {
        *("paper", "features", "adaptive"),
        *NAMES,
    }


# Choice of images


def test_folders_and_patterns_stand_for_the_rasters_in_them(tmp_path):
    for name in ("b.tif", "a.TIF", "c.png", "notes.txt", "inner/d.tif", "e.tif.aux.xml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "folder.tif").mkdir()

    def found(*sources):
        return [path.removeprefix(f"{tmp_path}/") for path in find_images(sources)]

    assert found(tmp_path) == ["a.TIF", "b.tif", "c.png"]
    assert found(f"{tmp_path}/*.tif") == ["b.tif"]
    assert found(f"{tmp_path}/**/*.tif") == ["b.tif", "inner/d.tif"]
    assert found(tmp_path / "inner", tmp_path / "notes.txt") == ["inner/d.tif", "notes.txt"]
    assert found("https://host/scene.tif?x=1", "/vsizip/a.zip/b.tif") == [
        "https://host/scene.tif?x=1",
        "/vsizip/a.zip/b.tif",
    ]
    odd = tmp_path / "odd[1].tif"
    odd.touch()
    assert found(odd) == ["odd[1].tif"]


@pytest.mark.slow
def test_a_file_named_twice_counts_once_and_two_of_one_name_count_twice(tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        shutil.copy(OLINDA, tmp_path / folder / "scene.tif")
    (tmp_path / "link.tif").symlink_to(tmp_path / "one" / "scene.tif")
    with pytest.warns(GeomeshWarning, match=r"named more than once, but used once: .*link\.tif$"):
        images = find_images([tmp_path / "one", f"{tmp_path}/*/scene.tif", tmp_path / "link.tif"])
    assert images == [str(tmp_path / folder / "scene.tif") for folder in ("one", "two")]
    stdout, stderr = run(*images, *images[:1])
    assert stderr.startswith("Warning: named more than once")
    assert "\n  one/scene.tif" in stdout
    assert "\n  two/scene.tif" in stdout


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda folder: folder, r"the folder .* has no images \(\.tif"),
        (lambda folder: f"{folder}/*.tif", "no file matches"),
    ],
)
def test_nothing_to_evaluate_is_refused(tmp_path, make, told):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(SourceError, match=told):
        evaluate(make(tmp_path))
    _, stderr = run(make(tmp_path), OLINDA, "-o", tmp_path / "t.csv", code=1)
    assert stderr.startswith("Error: ")
    assert stderr.count("\n") == 1
    assert not (tmp_path / "t.csv").exists()


# Bad images


@pytest.mark.slow
def test_a_bad_image_does_not_keep_the_others(tmp_path):
    bad = tmp_path / "bad.tif"
    bad.write_bytes(OLINDA.read_bytes()[:5000])
    table = tmp_path / "t.csv"
    stdout, stderr = run(bad, OLINDA, tmp_path / "none.tif", "-o", table, code=1)
    assert len(stderr.splitlines()) == 2
    assert all(line.startswith("Error: ") for line in stderr.splitlines())
    assert "bad.tif" in stderr.splitlines()[0]
    assert "none.tif" in stderr.splitlines()[1]
    assert "\n  olinda" in stdout
    rows = list(csv.DictReader(table.open()))
    failed = [row for row in rows if row["row"] == "failed"]
    assert [row["image"] for row in failed] == [str(bad), str(tmp_path / "none.tif")]
    assert all(row["error"] in stderr for row in failed)
    assert len([row for row in rows if row["row"] == "image"]) == 17
    document = json.loads(run(OLINDA, bad, "--json", code=1)[0])
    assert document["failed"] == 1
    assert "bad.tif" in document["failures"][0]["error"]


def test_what_nobody_thought_of_is_told_of_the_image_it_befell(monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr("geomesh.evaluate.run.measure_figures", fail)
    (failure,) = evaluate(OLINDA).failures
    assert failure.code == "internal"
    assert failure.error == f"{OLINDA}: ZeroDivisionError: a b (a defect of geomesh)"


def test_where_all_images_fail_nothing_is_written(tmp_path):
    for name in ("a.tif", "b.tif"):
        (tmp_path / name).write_text("no raster")
    before = sorted(tmp_path.iterdir())
    stdout, stderr = run(tmp_path, "-o", tmp_path / "t.csv", "--figure", tmp_path / "t.png", code=1)
    assert stdout == ""
    assert len(stderr.splitlines()) == 3
    assert stderr.splitlines()[2].startswith("Error: none of 2 images could be evaluated")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (2, 2), (3, 3), (8, 5)])
@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_an_image_smaller_than_the_baselines_need_tells_how_many_nodes_they_found(tmp_path, size):
    path = write_mirrored(tmp_path / "tiny.tif", OLINDA.name, *size, tiled=False, compress="none")
    tiny = evaluate(path)
    assert not tiny.failures
    assert [r.method for r in tiny.records] == ["paper", "features", "adaptive", *NAMES]
    for record in tiny.records[3:]:
        assert record.figures.nodes <= min(record.wanted, size[0] * size[1])
        assert math.isnan(record.figures.ki) == (record.figures.triangles == 0)
    run(path)


@pytest.mark.slow
def test_images_without_crs_are_evaluated_as_any_other(tmp_path):
    with rasterio.open(OLINDA) as dataset:
        bands, profile = dataset.read(), dataset.profile
    plain = tmp_path / "plain.tif"
    with rasterio.open(plain, "w", **{**profile, "crs": None, "transform": None}) as dataset:
        dataset.write(bands)
    _, stderr = run(plain)
    assert stderr == ""
    one, other = (evaluate(path) for path in (OLINDA, plain))
    assert [r.figures for r in one.records] == [r.figures for r in other.records]


@pytest.mark.slow
def test_what_lies_under_nodata_does_not_matter(tmp_path):
    with rasterio.open(SAMPLES / "parana_landsat8_rgb_uint16_nodata_edge.tif") as dataset:
        bands, valid, profile = dataset.read(), dataset.dataset_mask(), dataset.profile
    found = []
    for name, under in (("dark.tif", 0), ("bright.tif", 65535)):
        with rasterio.open(tmp_path / name, "w", **{**profile, "nodata": None}) as dataset:
            dataset.write(np.where(valid > 0, bands, np.uint16(under)))
            dataset.write_mask(valid)
        found.append([record.figures for record in evaluate(tmp_path / name).records])
    assert found[0] == found[1]
    assert found[0][-len(NAMES) - 1].covered == 1  # features, native: the mesh follows the outline


# Bad output


def test_outputs_that_cannot_be_written_are_refused_before_the_work(
    tmp_path, comparison, monkeypatch
):
    monkeypatch.setattr("geomesh.evaluate.run.evaluate", None)  # must not be called
    kept = tmp_path / "kept.csv"
    kept.write_text("mine")
    image = tmp_path / "scene.png"
    shutil.copy(OLINDA, image)
    cases = [
        (["-o", kept], "exists; use --overwrite"),
        (["-o", tmp_path / "none" / "t.csv"], "does not exist; create it first"),
        (["-o", tmp_path], "is a folder"),
        (["--figure", tmp_path / "t.bmp"], "t.bmp is not named as a picture; choose from .png"),
        (["--figure", image, "--overwrite"], f"is the input {image}; choose another name"),
    ]
    for options, told in cases:
        _, stderr = run(image, *options, code=1)
        assert told in stderr
        assert stderr.count("\n") == 1
    assert kept.read_text() == "mine"
    with pytest.raises(OutputError, match="exists"):
        comparison.to_csv(kept)
    comparison.to_csv(kept, overwrite=True)
    assert kept.read_text().startswith("row,image,")


def test_a_disk_that_is_full_in_the_end_does_not_cost_the_tables(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("geomesh.evaluate.comparison.staged", fail)
    stdout, stderr = run(OLINDA, "-o", tmp_path / "t.csv", code=1)
    assert stderr.count("\n") == 1
    assert "t.csv could not be written: no space left on device; free some space or" in stderr
    assert "\n  olinda" in stdout
    assert "written" not in stdout
    assert list(tmp_path.iterdir()) == []


def test_without_pydelatin_the_other_methods_are_compared(monkeypatch):
    monkeypatch.setitem(sys.modules, "pydelatin", None)
    stdout, stderr = run(OLINDA)
    assert stderr.count("\n") == 1
    assert "pydelatin is not installed (pip install 'geomesh-toolkit[evaluate]')" in stderr
    assert "greedy" not in stdout
    assert "Shi-Tomasi" in stdout


def test_without_matplotlib_a_figure_is_refused_before_the_work(monkeypatch, tmp_path):
    monkeypatch.delitem(sys.modules, "geomesh.evaluate.figure", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("geomesh.evaluate.run.evaluate", None)
    _, stderr = run(OLINDA, "--figure", tmp_path / "t.png", code=1)
    assert stderr == (
        "Error: matplotlib is not installed: pip install 'geomesh-toolkit[evaluate]'\n"
    )
