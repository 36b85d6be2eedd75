"""Messages are not the work: whatever happens to them, each mesh is written and whole.

The command line runs as a separate program, because its own streams are tested.
"""

from __future__ import annotations

import errno
import io
import json
import os
import shlex
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

import pytest

from geomesh.cli.streams import echo, is_output_lost, printable, unfailing_streams
from geomesh.io.read import read_mesh
from support.commands import PROGRAM, Geomesh, run_program
from support.rasters import write_raster

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

NAME = "北京 \N{SATELLITE}"
ODD_NAMES = ("two\nlines", "quo'te\"!;", "[bold]markup[x]", "bell\a \x1b[31m", "\u2028", NAME)

posix = pytest.mark.skipif(os.name != "posix", reason="it redirects with a POSIX shell")
linux = pytest.mark.skipif(sys.platform != "linux", reason="it needs /dev/full")


def run_in_shell(folder: Path, redirection: str, *arguments: str) -> tuple[int, str, str]:
    """Run geomesh in a folder with its output redirected; return its exit code and its text."""
    command = shlex.join([*PROGRAM, *arguments])
    script = f"({command}; echo $? >code) {redirection}"
    done = subprocess.run(
        ["bash", "-c", script], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    return int((folder / "code").read_text()), done.stdout, done.stderr


def assert_whole(folder: Path, names: Sequence[str]) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(f"{n}.gpkg" for n in names)
    for name in names:
        assert read_mesh(folder / f"{name}.gpkg").certify().passed


# ------------------------------------------------------------------ separate programs


@pytest.mark.parametrize(
    ("encoding", "options"),
    [
        ("cp1252", ()),
        pytest.param("ascii", ("--progress=bar",), marks=pytest.mark.slow),
        pytest.param("utf-8", ("--progress=bar",), marks=pytest.mark.slow),
        pytest.param("latin-1", ("--json",), marks=pytest.mark.slow),
        pytest.param("ascii", ("--progress=jsonl",), marks=pytest.mark.slow),
    ],
)
def test_a_name_that_cannot_be_printed_stops_nothing(
    tmp_path: Path, encoding: str, options: tuple[str, ...]
) -> None:
    sources = [write_raster(tmp_path, f"{name}.tif") for name in (NAME, "plain")]
    out = tmp_path / "out"
    env = {**os.environ, "PYTHONIOENCODING": encoding}
    run = run_program("mesh", *sources, "-o", out, *options, env=env)
    assert run.code == 0, run
    assert_whole(out, [NAME, "plain"])
    assert "Traceback" not in run.err
    if not options:
        escaped = NAME.encode("cp1252", "backslashreplace").decode()
        assert run.out.splitlines()[0].startswith(f"{out / escaped}.gpkg: ")
    if "--json" in options:
        assert [each["source"] for each in json.loads(run.out)["results"]] == sources


@pytest.mark.slow
def test_every_table_is_printed_by_a_terminal_of_another_encoding(tmp_path: Path) -> None:
    mesh, source = tmp_path / f"{NAME}.gpkg", write_raster(tmp_path, f"{NAME}.tif")
    env = {**os.environ, "PYTHONIOENCODING": "cp1252"}
    for command in (
        ("mesh", source, "-o", mesh),
        ("info", mesh),
        ("info", source),
        ("quality", mesh),
        ("render", mesh, "--like", source, "-o", tmp_path / f"{NAME} painted.tif"),
        ("convert", mesh, "-o", tmp_path / f"{NAME}.geojson"),
        ("stages", source, "-o", tmp_path / f"{NAME}.png"),
        ("evaluate", source, tmp_path / f"{NAME} painted.tif"),
    ):
        run = run_program(*command, env=env, encoding="cp1252")
        assert (run.code, "Traceback" in run.err) == (0, False), run
        # The table is narrow, and a long name is folded in it.
        assert r"\u5317\u4eac" in run.out.replace("\n", "")


# What happens to the streams, and whether the result on standard output is lost with it.
REDIRECTIONS = {
    "reader that has exited": ("| head -0", False),
    "no stdout": (">&-", False),
    "no stderr": ("2>&-", False),
    "no streams": ("<&- >&- 2>&-", False),
    "full stdout": (">/dev/full", True),
    "full stderr": ("2>/dev/full", False),
    "full streams": (">/dev/full 2>&1", True),
}


@posix
@linux
@pytest.mark.slow
@pytest.mark.parametrize(("redirection", "lost"), REDIRECTIONS.values(), ids=REDIRECTIONS)
@pytest.mark.parametrize("style", ["bar", "jsonl"])
def test_meshes_are_whole_whatever_happens_to_the_streams(
    tmp_path: Path, redirection: str, lost: bool, style: str
) -> None:
    for name in ("a", "b"):
        write_raster(tmp_path, f"{name}.tif")
    arguments = ("mesh", "a.tif", "b.tif", "-o", "out", "--progress", style)
    code, _, err = run_in_shell(tmp_path, redirection, *arguments)
    assert code == 0  # the meshes count
    assert_whole(tmp_path / "out", ["a", "b"])
    assert "Traceback" not in err
    assert ("output could not be written: no space left" in err) == (
        lost and "2>" not in redirection
    )


@posix
@linux
def test_a_result_that_is_lost_on_a_full_disk_is_a_failure(tmp_path: Path) -> None:
    write_raster(tmp_path)
    document = ("mesh", "scene.tif", "-o", "mesh.gpkg", "--json")
    code, _, err = run_in_shell(tmp_path, ">/dev/full", *document)
    assert (code, err) == (
        1,
        "Error: standard output could not be written: no space left on device\n",
    )
    assert read_mesh(tmp_path / "mesh.gpkg").certify().passed
    for arguments in (("info", "scene.tif"), ("quality", "mesh.gpkg")):
        assert run_in_shell(tmp_path, ">/dev/full", *arguments)[0] == 1
        assert run_in_shell(tmp_path, "| head -1", *arguments)[0] == 0


@posix
@pytest.mark.slow
def test_a_closed_stream_is_not_replaced_by_the_mesh(tmp_path: Path) -> None:
    """GDAL prints to the descriptors of the standard streams, whatever file is there."""
    write_raster(tmp_path)
    script = (
        "import os; from geomesh.cli.streams import unfailing_streams\n"
        "with unfailing_streams():\n"
        "    file = open('mesh', 'w'); os.write(1, b'noise'); os.write(2, b'noise'); file.close()"
    )
    command = shlex.join([sys.executable, "-c", script])
    subprocess.run(["bash", "-c", f"{command} <&- >&- 2>&-"], cwd=tmp_path, check=True)
    assert (tmp_path / "mesh").read_text() == ""


# ----------------------------------------------------------------- in this process


def test_odd_names_are_told_on_one_line_each(tmp_path: Path, command: Geomesh) -> None:
    sources = [write_raster(tmp_path, f"{name}.tif") for name in ODD_NAMES]
    run = command("mesh", *sources, "-o", tmp_path / "out")
    assert run.code == 0
    assert_whole(tmp_path / "out", ODD_NAMES)
    assert len(run.out.splitlines()) == len(ODD_NAMES)
    assert "\x1b[31m" not in run.out + run.err
    for name in ODD_NAMES:
        assert f"{tmp_path / 'out' / printable(name)}.gpkg: " in run.out
    odd = tmp_path / "out" / "[bold]markup[x].gpkg"
    title = f"{odd.name}: {len(read_mesh(odd).nodes)} nodes"
    # The title of the table is folded.
    assert command("quality", odd).out.replace("\n", "").count(title) == 1


class Broken(io.RawIOBase):
    """A stream that fails with an error number."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def writable(self) -> bool:
        return True

    def write(self, data: Any, /) -> int:  # noqa: ARG002
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize(
    ("number", "lost"),
    [(errno.EPIPE, False), (errno.ENOSPC, True), (errno.EIO, True), (errno.EDQUOT, True)],
)
def test_a_stream_that_fails_is_given_up(
    monkeypatch: pytest.MonkeyPatch, number: int, lost: bool
) -> None:
    raw = Broken(number)
    broken = io.TextIOWrapper(io.BufferedWriter(raw))
    monkeypatch.setattr(sys, "stdout", broken)
    with unfailing_streams():
        for _ in range(3):
            echo("one")
        assert is_output_lost() is lost
        with unfailing_streams():  # as in `rio geomesh`, or in main and then in the group
            echo("two")
    assert sys.stdout is broken
    broken.flush()  # nothing is left in it that would fail when the interpreter exits


def test_a_stream_that_does_not_wait_for_its_reader_gets_everything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Programs such as node give pipes that do not block."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    monkeypatch.setattr(sys, "stdout", open(writing, "w"))  # noqa: PTH123, SIM115
    text = "x" * 300_000  # more than a pipe holds
    received: list[bytes] = []

    def read() -> None:
        while part := os.read(reading, 65_536):
            received.append(part)

    thread = threading.Thread(target=read)
    thread.start()
    with unfailing_streams():
        echo(text)
    sys.stdout.close()
    thread.join()
    os.close(reading)
    assert b"".join(received).decode() == f"{text}\n"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain é", "plain é"),
        ("two\nlines\t\r", r"two\nlines\t\r"),
        ("\x1b[31m\x00", r"\x1b[31m\x00"),
        (os.fsdecode(b"\xff"), r"\udcff"),
        ("北京", "北京"),
    ],
)
def test_printable_text_is_one_line(monkeypatch: pytest.MonkeyPatch, text: str, shown: str) -> None:
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(io.BytesIO(), encoding="utf-8"))
    assert printable(text) == shown
