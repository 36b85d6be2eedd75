"""Turn a raster into a mesh file: what `geomesh mesh` does for each source."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.errors import OutputError
from geomesh.formats.names import choose_columns
from geomesh.formats.registry import find_format
from geomesh.io.write import check_output, open_writer
from geomesh.parallel.deadline import deadline
from geomesh.parallel.memory import trim_memory
from geomesh.parallel.progress import Progress, part_of
from geomesh.parallel.tiles import CORE
from geomesh.pipeline.attributes import name_columns
from geomesh.pipeline.breaklines import read_breaklines
from geomesh.pipeline.existing import find_made
from geomesh.pipeline.jobs import MeshJob, MeshSummary
from geomesh.pipeline.mesh_scene import mesh_scene
from geomesh.raster.open import open_scene

if TYPE_CHECKING:
    from geomesh.io.gdal_process import WriterPool
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.workers import Workers
    from geomesh.raster.lines import PixelLines
    from geomesh.raster.scene import Scene

# For scenes with at least this number of pixels, separate processes write the layers. They
# need a third of a second to start, but save more than that while writing.
_LARGE = 2_000_000


def mesh_file(
    job: MeshJob, workers: Workers, writer_pool: WriterPool | None, progress: Progress
) -> MeshSummary:
    """Turn a raster into a mesh file; the edges are written while triangles are measured.

    Parameters
    ----------
    job : MeshJob
    workers : Workers
        Can be used for one job after another.
    writer_pool : WriterPool, optional
        Can be used for one job after another; by default this process writes.
    progress : callable(fraction, message)
        May raise an exception to cancel.

    Raises
    ------
    GeomeshError
        With one line that says what is wrong and what to do; then an existing file does not
        change.
    """
    scene = open_job(job)
    return (
        scene
        if isinstance(scene, MeshSummary)
        else mesh_opened(job, scene, workers, writer_pool, progress)
    )


def open_job(job: MeshJob) -> Scene | MeshSummary:
    """Return the scene to mesh, or the summary of the existing file if it can be kept."""
    keep = job.skip_existing and job.output.exists()
    check_output(
        job.output, overwrite=job.overwrite or keep, driver=job.driver, options=job.options
    )
    scene = open_scene(job.source, **job.reading)
    if not keep:
        return scene
    lines = _read_breaklines(job, scene)
    made = find_made(
        *(job.output, scene, job.recipe, lines),
        layers=job.layers,
        driver=job.driver,
        options=job.options,
    )
    if isinstance(made, str):
        if job.overwrite:
            return scene
        raise OutputError(f"{job.output} exists, but {made}; use `overwrite=True` to replace it")
    counts, warnings = made
    return MeshSummary(counts["nodes"], counts["triangles"], warnings, skipped=True)


def mesh_opened(
    job: MeshJob,
    scene: Scene,
    workers: Workers,
    writer_pool: WriterPool | None,
    progress: Progress,
) -> MeshSummary:
    """Mesh a scene that `open_job` returned: see `mesh_file`."""
    _require_room(job, scene)
    lines = _read_breaklines(job, scene)
    is_large = scene.grid.width * scene.grid.height >= _LARGE
    with open_writer(
        job.output,
        layers=job.layers,
        driver=job.driver,
        overwrite=job.overwrite,
        options=job.options,
        writer_pool=writer_pool if is_large else None,
    ) as writer:

        def begin(shaped: TriangleMesh) -> None:
            if is_large:
                trim_memory()  # detection needed more memory than the next steps
            if job.recipe.z is None:  # heights are known only with the statistics
                writer.begin(shaped)

        mesh = mesh_scene(
            *(scene, job.recipe, workers, part_of(progress, 0, 0.8)),
            breaklines=lines,
            is_late=deadline(job.time_limit),
            shaped=begin,
        )
        if is_large:
            trim_memory()  # all pixels are read: GDAL's cache is no longer needed
        writer.finish(mesh, part_of(progress, 0.8, 1))
    warnings = mesh.provenance.warnings if mesh.provenance is not None else ()
    return MeshSummary(len(mesh.nodes), len(mesh.triangles), warnings)


def _read_breaklines(job: MeshJob, scene: Scene) -> PixelLines | None:
    return read_breaklines(job.breaklines, job.breaklines_layer, scene, job.recipe)


def _require_room(job: MeshJob, scene: Scene) -> None:
    """Raise OutputError if the format cannot store the columns: before any pixel is read.

    So too if the user chose columns that the mesh will not have.
    """
    file_format = find_format(job.output, job.driver)
    layers = file_format.choose_layers(job.layers)
    for name in layers:
        names = name_columns(name, scene, job.recipe)
        if job.options.columns is not None:
            choose_columns(names, job.options.columns, name)
            continue
        columns = len(names)
        ways_out = ["choose fewer bands with `bidx`", "write .parquet"]
        fewest = job.recipe.with_values(statistics=("mean",))
        if len(name_columns(name, scene, fewest)) <= (file_format.most_columns or columns):
            ways_out.insert(0, "compute one statistic with `statistics=mean`")
        if len(layers) > 1 and job.layers is not None:
            ways_out[-1] += f" with `layers={name}`"
        try:
            file_format.require_room(name, columns=columns, way_out=", or ".join(ways_out))
        except OutputError as error:
            raise OutputError(f"{job.output} cannot hold the mesh: {error}") from error


def fits_one_worker(scene: Scene) -> bool:
    """Return whether a scene has only one tile, so that only one worker can work on it."""
    return max(scene.grid.width, scene.grid.height) <= CORE
