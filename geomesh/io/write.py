"""Writing a mesh to a file, which is there whole and certified or not at all."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from geomesh.errors import OutputError
from geomesh.formats.batch_stream import BatchStream
from geomesh.formats.document import build_document
from geomesh.formats.format import PENDING, Format, LayerFile
from geomesh.formats.registry import find_format
from geomesh.io.atomic import check_place, staged, undisturbed, writing_to
from geomesh.parallel.processes import Process
from geomesh.parameters import LAYERS, LayerName

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from os import PathLike

    from geomesh.io.gdal_process import WriterPool
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress

# Seconds between looks for Ctrl-C, and those granted to threads that were told to stop.
_LOOK = 0.5
_GRACE = 1.0


def check_output(
    path: str | PathLike[str], *, overwrite: bool = False, driver: str | None = None
) -> None:
    """Refuse an output that could not be written; meant to be called before any work.

    Parameters
    ----------
    path : path-like
    overwrite : bool
        Whether an existing file may be replaced.
    driver : str, optional
        Name of a format (see docs/formats.md); by the extension of `path` if not given.

    Raises
    ------
    OutputError
        If the format is unknown, the file exists, or its folder is missing or
        cannot be written to.
    """
    find_format(path, driver)
    check_place(Path(path), overwrite=overwrite)


def write_mesh(
    mesh: TriangleMesh,
    path: str | PathLike[str],
    *,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a mesh that passes its certificate; the file is there whole or not at all.

    Parameters
    ----------
    mesh : TriangleMesh
    path : path-like
    layers : iterable of {"triangles", "edges", "nodes"}, optional
        All three by default in a GeoPackage, else the triangles: the other formats
        hold one layer.
    driver : str, optional
        Name of a format (see docs/formats.md); by the extension of `path` if not given.
    overwrite : bool
        Replace an existing file, at the very end.
    progress : callable(fraction, message), optional
        Called after each batch of rows; an exception in it stops the writing.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    OutputError
        If the output cannot be written; what was there before is untouched.
    CertificateError
        If the mesh fails one of its checks.
    GeoreferenceError
        If GeoJSON is asked for and the nodes have no longitude and latitude.
    """
    with open_writer(path, layers=layers, driver=driver, overwrite=overwrite) as writer:
        writer.finish(mesh, progress or (lambda _fraction, _message: None))
    return Path(path)


@contextmanager
def open_writer(
    path: str | PathLike[str],
    *,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    writer_pool: WriterPool | None = None,
) -> Iterator[MeshWriter]:
    """Yield a writer of one mesh; its file is put in place when the block ends well.

    Parameters
    ----------
    path, layers, driver, overwrite
        As in `write_mesh`, which tells the errors, too.
    writer_pool : WriterPool, optional
        Processes to write the layers, side by side; without any this one does it.
    """
    target = Path(path)
    check_output(target, overwrite=overwrite, driver=driver)
    file_format = find_format(target, driver)
    names = choose_layers(layers, file_format)
    with staged(target, file_format.extensions[0], overwrite=overwrite) as temporary:
        writer = MeshWriter(target, temporary, names, file_format, writer_pool)
        try:
            yield writer
        finally:
            with undisturbed():
                writer.stop()


class MeshWriter:
    """Writes the layers of a mesh, each on a thread, beside the work on the mesh itself.

    Parameters
    ----------
    target : Path
        What messages call the file.
    path : Path
        Where to write it.
    names : list of {"triangles", "edges", "nodes"}
    file_format : Format
    writer_pool : WriterPool, optional
    """

    def __init__(
        self,
        target: Path,
        path: Path,
        names: list[LayerName],
        file_format: Format,
        writer_pool: WriterPool | None,
    ) -> None:
        self._target = target
        self._path = path
        self._names = names
        self._format = file_format
        self._writer_pool = writer_pool
        writers = writer_pool.count if writer_pool is not None else 1
        self._joining = file_format.joining
        self._apart = (
            self._joining is not None
            and min(writers, len(names)) > 1
            and self._joining.is_possible()
        )
        # Not the workers' threads: these wait for the writers, and tiles should not wait for them.
        # A file has one writer.
        self._threads = ThreadPoolExecutor(writers if self._apart else 1, "geomesh-layer")
        self._streams: dict[LayerName, BatchStream] = {}
        self._written: dict[LayerName, Future[None]] = {}
        self._news: SimpleQueue[None] = SimpleQueue()
        if writer_pool is not None and file_format.by_gdal:
            writer_pool.warm()

    def begin(self, mesh: TriangleMesh) -> None:
        """Start on the edges, which need no statistics, where the format holds several layers.

        Parameters
        ----------
        mesh : TriangleMesh
            Final but for its tables and metadata.
        """
        if self._joining is not None and "edges" in self._names:
            self._start(mesh, "edges", PENDING)

    def finish(self, mesh: TriangleMesh, progress: Progress) -> None:
        """Write the mesh if it passes its certificate; raise as `write_mesh` does."""
        progress(0.0, "Writing")
        if self._joining is not None:
            for name in self._names:
                self._start(mesh, name, PENDING)
        # Not in this thread: a Ctrl-C while compiled code is loaded comes out as another error.
        with ThreadPoolExecutor(1, "geomesh-certificate") as thread:
            certificate = thread.submit(mesh.certify).result()
        certificate.require()
        document = build_document(mesh, certificate)
        for name in self._names:
            self._start(mesh, name, document)
        self._await(len(mesh.nodes), len(mesh.triangles), progress)
        if self._joining is not None:
            with self._one_line_failures():
                self._joining.finish(self._path, self._names, self._others(), document)
        progress(1.0, "Written")

    def stop(self) -> None:
        """Stop what is still being written."""
        for stream in self._streams.values():
            stream.stop()
        if self._writer_pool is not None:
            self._writer_pool.stop(Process.kill)
        self._threads.shutdown(wait=False, cancel_futures=True)
        begun = [future for future in self._written.values() if not future.cancelled()]
        wait(begun, timeout=_GRACE)

    def _start(self, mesh: TriangleMesh, name: LayerName, document: str) -> None:
        if name not in self._streams:
            stream = self._streams[name] = BatchStream(self._news)
            path = self._others().get(name, self._path)
            file = LayerFile(mesh, name, path, self._format, document)
            self._written[name] = self._threads.submit(
                _write_layer, file, stream, self._writer_pool
            )
            self._written[name].add_done_callback(lambda _: self._news.put(None))

    def _others(self) -> dict[LayerName, Path]:
        """Return the layers that get a file of their own first, and these files."""
        apart = self._names[1:] if self._apart else []
        return {name: self._path.with_name(f"{name}{self._path.suffix}") for name in apart}

    def _await(self, nodes: int, triangles: int, progress: Progress) -> None:
        """Wait for all layers, and report each batch."""
        # About: by how many the edges are fewer than these two depends on the holes.
        sizes = {"nodes": nodes, "triangles": triangles, "edges": nodes + triangles}
        total = sum(sizes[name] for name in self._names)
        while True:
            running = []
            for name, future in self._written.items():
                if not future.done():
                    running.append(name)
                    continue
                with self._one_line_failures():
                    future.result()
            rows = sum(stream.rows for stream in self._streams.values())
            progress(min(rows / total, 1.0), f"Writing {', '.join(running)}".rstrip())
            if not running:
                return
            with suppress(Empty):
                self._news.get(timeout=_LOOK)

    @contextmanager
    def _one_line_failures(self) -> Iterator[None]:
        """Raise OutputError for what a library says of a failed write, and pass on all else."""
        with writing_to(self._target, "pyogrio", "pyarrow", "sqlite3"):
            try:
                yield
            except Exception:
                for stream in self._streams.values():
                    if stream.failure is not None:
                        raise stream.failure from None
                raise


def choose_layers(layers: Iterable[LayerName] | None, file_format: Format) -> list[LayerName]:
    """Return the layers to write, in their order; by default all that the format holds in one file.

    Raises
    ------
    OutputError
        If one does not exist, or the format cannot hold them.
    """
    if layers is None:
        return list(LAYERS if file_format.joining is not None else LAYERS[:1])
    asked = [layers] if isinstance(layers, str) else list(layers)
    for name in asked:
        if name not in LAYERS:
            raise OutputError(f"there is no layer {name!r}; choose from {', '.join(LAYERS)}")
        if name not in file_format.layers:
            raise OutputError(
                f"{file_format.driver} holds {', '.join(file_format.layers)}, not {name}; "
                "write .gpkg for all layers"
            )
    if not asked:
        raise OutputError(f"no layer to write; choose from {', '.join(LAYERS)}")
    chosen = [name for name in LAYERS if name in asked]
    if len(chosen) > 1 and file_format.joining is None:
        raise OutputError(
            f"{file_format.driver} holds one layer, not {', '.join(chosen)}; "
            "choose one of them, or write .gpkg"
        )
    return chosen


def _write_layer(file: LayerFile, stream: BatchStream, writer_pool: WriterPool | None) -> None:
    # What writes files is loaded by the thread that needs it.
    from geomesh.io.layer import write_layer

    write_layer(file, stream, writer_pool)
