"""How the plugin runs geomesh: real child processes, some of them with errors."""

import os
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from geomesh_qgis.engine.child import clean_environment
from geomesh_qgis.engine.runner import Cancelled, Outcome, RunError, run

import geomesh
from support.samples import OLINDA, SAMPLES, write_mirrored

LARGE = SAMPLES / "iguacu_landsat8_rgb_uint16.tif"
TOLD = ("--progress", "jsonl", "--until-eof")

posix = pytest.mark.skipif(os.name != "posix", reason="signals are a matter of POSIX")
linux = pytest.mark.skipif(sys.platform != "linux", reason="it looks into /proc")


@dataclass
class Listener:
    """Records all reports. Cancels when `stop` is set or the progress reaches `stop_at`."""

    fractions: list[float] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stop: threading.Event = field(default_factory=threading.Event)
    stop_at: float = 2.0

    def progress(self, fraction, _message):
        self.fractions.append(fraction)
        if fraction >= self.stop_at:
            self.stop.set()

    def run(self, *command, places=()):
        return run(
            [str(part) for part in command],
            progress=self.progress,
            warn=self.warnings.append,
            cancelled=self.stop.is_set,
            places=places,
        )


@pytest.fixture
def listener():
    return Listener()


@pytest.fixture
def fake(tmp_path):
    """Return a function that makes a command from lines of Python."""

    def make(code):
        script = tmp_path / "fake.py"
        script.write_text(PRELUDE + textwrap.dedent(code), encoding="utf-8")
        return sys.executable, "-u", script

    return make


PRELUDE = """
import json, os, signal, sys, time
def tell(event, **values):
    print(json.dumps({"event": event, **values}), flush=True)
def start(**values):
    prefix = f".geomesh-{os.getpid()}-"
    tell("start", **{"protocol": 1, "pid": os.getpid(), "unfinished": prefix, **values})
"""


def mesh(source, out, *options):
    return sys.executable, "-m", "geomesh", "mesh", source, "-o", out, *TOLD, *options


def left(folder):
    return sorted(path.name for path in folder.iterdir())


def is_running(pid):
    """Return whether a process exists and is not a zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_until(condition, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return condition()


# Messages


def test_a_mesh_is_made_and_told(tmp_path, listener):
    out = tmp_path / "mesh.gpkg"
    outcome = listener.run(*mesh(OLINDA, out, "--nodes", 300))
    made = geomesh.read_mesh(out)
    assert outcome == Outcome((str(out),), {"nodes": 300, "triangles": len(made.triangles)})
    assert made.certify().passed
    assert listener.fractions == sorted(listener.fractions)
    assert listener.fractions[-1] == 1
    assert len(listener.fractions) > 5


def test_warnings_are_passed_on(tmp_path, listener):
    source = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
    listener.run(*mesh(source, tmp_path / "mesh.gpkg", "--nodes", 200))
    assert any("CRS" in warning for warning in listener.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["with space", 'quo\'te "double"', "Iguaçu 伊瓜苏 😀", "-o $HOME;x"]
)
def test_any_path_reaches_the_command(tmp_path, listener, name):
    folder = tmp_path / name
    folder.mkdir()
    source = folder / f"{name}.tif"
    source.symlink_to(OLINDA)
    out = folder / f"{name}.gpkg"
    outcome = listener.run(*mesh(source, out, "--nodes", 100))
    assert outcome.outputs == (str(out),)
    assert left(folder) == sorted([source.name, out.name])


def test_an_error_keeps_its_code_and_message(tmp_path, listener):
    with pytest.raises(RunError) as caught:
        listener.run(*mesh(tmp_path / "none.tif", tmp_path / "mesh.gpkg"))
    assert caught.value.code == "source"
    assert "none.tif" in str(caught.value)
    assert left(tmp_path) == []


def test_an_error_is_raised_when_the_command_has_ended(fake, listener):
    command = fake("start(); tell('error', code='band', message='no'); time.sleep(0.7)")
    begun = time.monotonic()
    with pytest.raises(RunError, match=r"^no$"):
        listener.run(*command)
    assert time.monotonic() - begun > 0.7


def test_other_text_on_stdout_is_ignored(fake, listener):
    command = fake(r"""
        sys.stdout.buffer.write(b'\xff\xfe garbage\n\n[1, 2]\n"text"\n{"no": "event"}\n{"event"\n')
        sys.stdout.buffer.write(b'[' * 100000 + b'\n')
        start()
        print("3 driver", end="\r\n")
        tell("progress", fraction=0.5, message="half")
        tell("progress", fraction="much", message="?")
        tell("something new", value=1)
        tell("result", outputs=["a.gpkg"], figures={"nodes": 3})
    """)
    assert listener.run(*command) == Outcome(("a.gpkg",), {"nodes": 3})
    assert listener.fractions == [0.5]


def test_results_of_several_sources_are_gathered(fake, listener):
    command = fake("""
        start(); tell("result", outputs=["a"], figures={"nodes": 1})
        start(); tell("result", outputs=["b"], figures={"nodes": 2})
    """)
    assert listener.run(*command).outputs == ("a", "b")


@pytest.mark.parametrize(
    ("version", "way_out"),
    [("2", "upgrade the plugin"), ("0", "upgrade geomesh"), ("None", "upgrade geomesh")],
)
def test_another_protocol_is_refused_at_once(fake, listener, version, way_out):
    command = fake(f"""
        import threading
        threading.Timer(9, os._exit, [0]).start()
        start(protocol={version})
        sys.stdin.read()
        os._exit(0)
    """)
    begun = time.monotonic()
    with pytest.raises(RunError, match=way_out) as caught:
        listener.run(*command)
    assert caught.value.code == "protocol"
    assert time.monotonic() - begun < 2


def test_much_text_on_both_streams_blocks_nothing(fake, listener):
    command = fake("""
        for number in range(50_000):
            print("x" * 80, file=sys.stderr)
            print("y" * 80)
        sys.stderr.write("z" * 5_000_000)
        start(); tell("result", outputs=[], figures={})
    """)
    assert listener.run(*command) == Outcome((), {})


# End of the process


def test_a_command_that_says_nothing_is_an_error(fake, listener):
    with pytest.raises(RunError, match=r"exit code 0: no message") as caught:
        listener.run(*fake("pass"))
    assert caught.value.code == "crash"


def test_an_exit_code_comes_with_the_last_line(fake, listener):
    code = "start()\nfor i in range(99): print('line', i, file=sys.stderr)\nsys.exit(3)"
    with pytest.raises(RunError, match="exit code 3: line 98") as caught:
        listener.run(*fake(code))
    assert caught.value.details == tuple(f"line {i}" for i in range(59, 99))
    assert "\n" not in str(caught.value)


def test_wrong_usage_is_told_in_the_command_s_words(tmp_path, listener):
    with pytest.raises(RunError, match="No such option"):
        listener.run(*mesh(OLINDA, tmp_path / "mesh.gpkg", "--no-such-option"))


def test_a_result_does_not_cover_up_a_later_crash(fake, listener):
    command = fake("start(); tell('result', outputs=['a'], figures={}); start(); os._exit(9)")
    with pytest.raises(RunError, match="exit code 9"):
        listener.run(*command)


@posix
def test_a_crash_names_the_signal_and_leaves_nothing(fake, listener, tmp_path):
    places = tmp_path / "places"
    theirs = places / ".geomesh-1-theirs"
    theirs.mkdir(parents=True)
    command = fake(f"""
        start()
        os.makedirs({str(places)!r} + f"/.geomesh-{{os.getpid()}}-abc/deep")
        open({str(places)!r} + f"/.geomesh-{{os.getpid()}}-abc/output.gpkg", "w").close()
        os.kill(os.getpid(), signal.SIGSEGV)
    """)
    with pytest.raises(RunError, match="SIGSEGV") as caught:
        listener.run(*command, places=[places, tmp_path / "not there"])
    assert caught.value.code == "crash"
    assert left(places) == [theirs.name]


@posix
def test_being_killed_hints_at_memory(fake, listener):
    with pytest.raises(RunError, match="memory"):
        listener.run(*fake("start(); os.kill(os.getpid(), signal.SIGKILL)"))


@pytest.mark.parametrize("kind", ["missing", "folder", "text", "null byte"])
def test_what_cannot_be_started_is_told(tmp_path, listener, kind):
    program = tmp_path / "python"
    if kind == "folder":
        program.mkdir()
    if kind == "text":
        program.write_text("no program")
    name = f"{program}\0" if kind == "null byte" else str(program)
    with pytest.raises(RunError, match=r"cannot be started.*Settings > Options") as caught:
        listener.run(name, "-m", "geomesh")
    assert caught.value.code == "environment"


def test_an_environment_without_geomesh_is_a_clear_error(tmp_path, listener):
    with pytest.raises(RunError, match="No module named"):
        listener.run(sys.executable, "-m", "geomesh_that_is_not_there")


# Cancellation


def test_cancelling_a_real_mesh_leaves_nothing(tmp_path, listener):
    listener.stop_at = 0.1
    with pytest.raises(Cancelled):
        listener.run(*mesh(LARGE, tmp_path / "mesh.gpkg"), places=[tmp_path])
    assert left(tmp_path) == []


@pytest.mark.slow
def test_cancelling_while_writing_keeps_the_old_file(tmp_path, listener):
    # It has many triangles, so that writing them takes longer than to stop.
    large = write_mirrored(tmp_path / "large.tif", LARGE.name, 1500, 1500)
    out = tmp_path / "mesh.gpkg"
    out.write_text("old")
    listener.stop_at = 0.8
    with pytest.raises(Cancelled):
        listener.run(*mesh(large, out, "--overwrite"), places=[tmp_path])
    assert left(tmp_path) == ["large.tif", "mesh.gpkg"]
    assert out.read_text() == "old"


def test_a_silent_command_is_stopped_soon_by_closing_its_input(fake, listener, tmp_path):
    command = fake(f"""
        start()
        sys.stdin.read()
        open({str(tmp_path / "clean")!r}, "w").close()
        sys.exit(143)
    """)
    threading.Timer(1.0, listener.stop.set).start()
    begun = time.monotonic()
    with pytest.raises(Cancelled):
        listener.run(*command)
    assert 1 <= time.monotonic() - begun < 2
    assert (tmp_path / "clean").exists()


@pytest.mark.slow
def test_a_chatty_command_can_be_cancelled_too(fake, listener):
    command = fake("start()\nwhile True: tell('log', level='warning', message='on')")
    threading.Timer(0.5, listener.stop.set).start()
    with pytest.raises(Cancelled):
        listener.run(*command)


@pytest.mark.slow
@linux
@pytest.mark.parametrize("helper", [False, True], ids=["alone", "behind a wrapper"])
def test_a_command_that_will_not_stop_is_killed_and_swept(fake, listener, tmp_path, helper):
    places = tmp_path / "places"
    places.mkdir()
    command = fake(f"""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        open({str(tmp_path / "pid")!r}, "w").write(str(os.getpid()))
        os.mkdir({str(places)!r} + f"/.geomesh-{{os.getpid()}}-abc")
        start()
        tell("progress", fraction=0.5, message="")
        while True: time.sleep(60)
    """)
    if helper:
        command = ("/bin/sh", "-c", '"$@"; exit 0', "sh", *command)
    listener.stop_at = 0.5
    begun = time.monotonic()
    with pytest.raises(Cancelled):
        listener.run(*command, places=[places])
    assert time.monotonic() - begun < 6
    # A killed process ends a moment later, and only its parent, the wrapper, was waited for.
    pid = int((tmp_path / "pid").read_text())
    assert wait_until(lambda: not is_running(pid), 5)
    assert left(places) == []


def test_what_was_finished_before_the_stop_took_effect_counts(fake, listener):
    command = fake("""
        start()
        tell("progress", fraction=0.9, message="writing")
        sys.stdin.read()
        tell("result", outputs=["a.gpkg"], figures={})
    """)
    listener.stop_at = 0.9
    assert listener.run(*command).outputs == ("a.gpkg",)


@linux
@pytest.mark.parametrize("callback", ["progress", "warn", "cancelled"])
def test_a_defect_of_the_caller_leaves_no_orphan(fake, tmp_path, callback):
    def fail(*_):
        if callback == "cancelled" and not (tmp_path / "pid").exists():
            return False
        raise ZeroDivisionError

    callbacks = {
        "progress": lambda *_: None,
        "warn": lambda _: None,
        "cancelled": lambda: False,
        callback: fail,
    }
    command = fake(f"""
        with open({str(tmp_path / "tmp")!r}, "w") as file: file.write(str(os.getpid()))
        os.rename({str(tmp_path / "tmp")!r}, {str(tmp_path / "pid")!r})
        start()
        tell("progress", fraction=0.5, message="")
        tell("log", level="warning", message="")
        sys.stdin.read()
    """)
    with pytest.raises(ZeroDivisionError):
        run([str(part) for part in command], **callbacks)
    assert not is_running(int((tmp_path / "pid").read_text()))


@pytest.mark.slow
@posix
def test_something_left_behind_by_a_command_does_not_hold_us(fake, listener):
    command = fake("""
        if os.fork() == 0:
            time.sleep(60)
            os._exit(0)
        start(); tell("result", outputs=[], figures={})
    """)
    begun = time.monotonic()
    assert listener.run(*command) == Outcome((), {})
    assert time.monotonic() - begun < 5


@linux
def test_the_command_ends_when_qgis_is_killed(tmp_path):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, *map(str, mesh(LARGE, tmp_path / "mesh.gpkg"))],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent / "qgis_plugin")},
    )
    parent.stdout.readline()
    (pid,) = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
    assert is_running(pid)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert wait_until(lambda: not is_running(pid), 5)
    assert left(tmp_path) == []


PARENT = """
import sys
from geomesh_qgis.engine.runner import run

def progress(fraction, message):
    if fraction >= 0.1:
        print("meshing", flush=True)

run(sys.argv[1:], progress=progress, warn=print, cancelled=lambda: False)
"""


# Environment variables


def test_the_environment_of_qgis_is_left_out():
    ours = {"PATH": "/bin", "HOME": "/h", "LANG": "de_DE.UTF-8", "PIP_PROXY": "p", "PROJECTS": "x"}
    names = (
        *("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "VIRTUAL_ENV", "PROJ_LIB", "PROJ_DATA"),
        *("GDAL_DATA", "GDAL_DRIVER_PATH", "LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_LIBRARY_PATH"),
        *("QGIS_PREFIX_PATH", "QT_PLUGIN_PATH"),
    )
    theirs = dict.fromkeys(names, "/qgis")
    assert clean_environment({**ours, **theirs}) == {
        **ours,
        "PYTHONUTF8": "1",
        "PYTHONSAFEPATH": "1",
    }


def test_qgis_s_own_libraries_do_not_reach_the_command(tmp_path, listener, monkeypatch):
    (tmp_path / "json.py").write_text("raise SystemExit('the wrong json')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    monkeypatch.setenv("PROJ_DATA", str(tmp_path))
    monkeypatch.setenv("GDAL_DATA", str(tmp_path))
    out = tmp_path / "mesh.gpkg"
    listener.run(*mesh(OLINDA, out, "--nodes", 100))
    assert listener.warnings == []
    monkeypatch.undo()
    assert geomesh.read_mesh(out).grid.crs.to_epsg() == 31985
