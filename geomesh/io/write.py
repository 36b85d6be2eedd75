"""Write a mesh to a file, atomically, and only if it passes its certificate."""

from __future__ import annotations

import warnings
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from geomesh.errors import GeomeshWarning, OutputError
from geomesh.formats.batch_stream import BatchStream
from geomesh.formats.document import build_document
from geomesh.formats.format import PENDING, PLAIN, Format, LayerFile, WriteOptions
from geomesh.formats.registry import FORMATS, find_format
from geomesh.io.atomic import check_place, staged, undisturbed, writing_to
from geomesh.parallel.processes import Process

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from os import PathLike

    from geomesh.io.gdal_process import WriterPool
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parameters import LayerName

# Seconds between two checks for Ctrl-C, and seconds to wait for threads after `stop`.
_POLL = 0.5
_GRACE = 1.0


def check_output(
    path: str | PathLike[str],
    *,
    overwrite: bool = False,
    driver: str | None = None,
    options: WriteOptions = PLAIN,
) -> None:
    """Raise OutputError if the output cannot be written; call this before any work is done.

    Parameters
    ----------
    path : path-like
    overwrite : bool
        Whether an existing file may be replaced.
    driver : str, optional
        Name of a format (see docs/formats.md); by default chosen by the extension of `path`.
    options : WriteOptions, optional

    Raises
    ------
    OutputError
        If the format is unknown or does not have an option, the file exists, or its folder does
        not exist or cannot be written to.
    MissingExtraError
        If the format needs a library that is not installed.
    """
    file_format = find_format(path, driver)
    for name in options.given():
        if name not in file_format.options:
            *most, last = (known.extensions[0] for known in FORMATS if name in known.options)
            able = f"{', '.join(most)} and {last}" if most else last
            raise OutputError(f"`{name}` is for {able}, not for {path}")
    file_format.require()
    check_place(Path(path), overwrite=overwrite)


def write_mesh(
    mesh: TriangleMesh,
    path: str | PathLike[str],
    *,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    options: WriteOptions = PLAIN,
    progress: Progress | None = None,
) -> Path:
    """Write a mesh if it passes its certificate; the file is complete or does not exist.

    Parameters
    ----------
    mesh : TriangleMesh
    path : path-like
    layers : iterable of {"triangles", "edges", "nodes"}, optional
        By default all three in a GeoPackage, else the triangles: the other formats can store
        only one layer.
    driver : str, optional
        Name of a format (see docs/formats.md); by default chosen by the extension of `path`.
    overwrite : bool
        Replace an existing file, as the last step.
    options : WriteOptions, optional
    progress : callable(fraction, message), optional
        Called after each batch of rows. An exception in it stops the writing.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    OutputError
        If the output cannot be written; then an existing file does not change.
    CertificateError
        If the mesh fails one of its checks.
    GeoreferenceError
        If the format is GeoJSON and the nodes have no longitude and latitude.
    """
    with open_writer(
        path, layers=layers, driver=driver, overwrite=overwrite, options=options
    ) as writer:
        writer.finish(mesh, progress or (lambda _fraction, _message: None))
    return Path(path)


@contextmanager
def open_writer(
    path: str | PathLike[str],
    *,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    options: WriteOptions = PLAIN,
    writer_pool: WriterPool | None = None,
) -> Iterator[MeshWriter]:
    """Yield a writer for one mesh; the file appears at `path` if the block ends without error.

    Parameters
    ----------
    path, layers, driver, overwrite, options
        As in `write_mesh`, which also lists the errors.
    writer_pool : WriterPool, optional
        Processes that write the layers in parallel; by default this process writes them.
    """
    target = Path(path)
    check_output(target, overwrite=overwrite, driver=driver, options=options)
    file_format = find_format(target, driver)
    names = file_format.choose_layers(layers)
    with staged(target, file_format.extension_for(target), overwrite=overwrite) as temporary:
        writer = MeshWriter(target, temporary, names, file_format, options, writer_pool)
        try:
            yield writer
        finally:
            with undisturbed():
                writer.stop()


class MeshWriter:
    """Writes the layers of a mesh in threads, while other threads work on the mesh itself.

    Parameters
    ----------
    target : Path
        The name of the file in messages.
    path : Path
        The temporary file to write to.
    names : list of {"triangles", "edges", "nodes"}
    file_format : Format
    options : WriteOptions
    writer_pool : WriterPool, optional
    """

    def __init__(
        self,
        target: Path,
        path: Path,
        names: list[LayerName],
        file_format: Format,
        options: WriteOptions,
        writer_pool: WriterPool | None,
    ) -> None:
        self._options = options
        self._target = target
        self._path = path
        self._names = names
        self._format = file_format
        self._writer_pool = writer_pool
        writers = writer_pool.count if writer_pool is not None else 1
        self._joining = file_format.joining
        self._separate_files = (
            self._joining is not None
            and min(writers, len(names)) > 1
            and self._joining.is_possible()
        )
        # Own threads, not those of the workers: they wait for the writers, and tiles should not
        # have to wait. A file can have only one writer.
        self._threads = ThreadPoolExecutor(writers if self._separate_files else 1, "geomesh-layer")
        self._streams: dict[LayerName, BatchStream] = {}
        self._written: dict[LayerName, Future[None]] = {}
        # Gets an entry after each batch and each layer.
        self._events: SimpleQueue[None] = SimpleQueue()
        if writer_pool is not None and file_format.by_gdal:
            writer_pool.warm()

    def begin(self, mesh: TriangleMesh) -> None:
        """Start to write the edges, which need no statistics, if the format has several layers.

        Parameters
        ----------
        mesh : TriangleMesh
            Its geometry is final; its tables and metadata need not be.
        """
        if self._joining is not None and "edges" in self._names:
            self._start(mesh, "edges", PENDING)

    def finish(self, mesh: TriangleMesh, progress: Progress) -> None:
        """Write the mesh if it passes its certificate; raise the errors of `write_mesh`."""
        for note in self._format.notes(mesh, self._options):
            warnings.warn(note, GeomeshWarning, stacklevel=2)
        progress(0.0, "Writing")
        if self._joining is not None:
            for name in self._names:
                self._start(mesh, name, PENDING)
        # In another thread: Ctrl-C while compiled code is loaded would raise another error.
        with ThreadPoolExecutor(1, "geomesh-certificate") as thread:
            certificate = thread.submit(mesh.certify).result()
        certificate.require()
        document = build_document(mesh, certificate, self._options)
        for name in self._names:
            self._start(mesh, name, document)
        self._await(len(mesh.nodes), len(mesh.triangles), progress)
        if self._joining is not None:
            with self._one_line_failures():
                self._joining.finish(self._path, self._names, self._extra_paths(), document)
        progress(1.0, "Written")

    def stop(self) -> None:
        """Stop the writing of unfinished layers."""
        for stream in self._streams.values():
            stream.stop()
        if self._writer_pool is not None:
            self._writer_pool.stop(Process.kill)
        self._threads.shutdown(wait=False, cancel_futures=True)
        begun = [future for future in self._written.values() if not future.cancelled()]
        wait(begun, timeout=_GRACE)

    def _start(self, mesh: TriangleMesh, name: LayerName, document: str) -> None:
        if name not in self._streams:
            stream = self._streams[name] = BatchStream(self._events)
            path = self._extra_paths().get(name, self._path)
            file = LayerFile(mesh, name, path, self._format, document, self._options)
            self._written[name] = self._threads.submit(
                _write_layer, file, stream, self._writer_pool
            )
            self._written[name].add_done_callback(lambda _: self._events.put(None))

    def _extra_paths(self) -> dict[LayerName, Path]:
        """Return the layers that are first written to separate files, and these files."""
        names = self._names[1:] if self._separate_files else []
        return {name: self._path.with_name(f"{name}{self._path.suffix}") for name in names}

    def _await(self, nodes: int, triangles: int, progress: Progress) -> None:
        """Wait until all layers are written, and report progress after each batch."""
        # Approximate: the exact number of edges depends on the components and holes.
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
                self._events.get(timeout=_POLL)

    @contextmanager
    def _one_line_failures(self) -> Iterator[None]:
        """Turn a library's error of a failed write into OutputError; pass on other errors."""
        libraries, other = ("pyogrio", "pyarrow", "sqlite3"), "choose another format"
        with writing_to(self._target, *libraries, way_out=other):
            try:
                yield
            except Exception:
                for stream in self._streams.values():
                    if stream.failure is not None:
                        raise stream.failure from None
                raise


def _write_layer(file: LayerFile, stream: BatchStream, writer_pool: WriterPool | None) -> None:
    # Imported here, so that the thread that writes loads the libraries for it.
    from geomesh.io.layer import write_layer

    write_layer(file, stream, writer_pool)
