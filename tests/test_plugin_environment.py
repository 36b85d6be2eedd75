"""The plugin's environment: find it, create it, keep it when an installation fails, remove it."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from geomesh_qgis.engine import environment, installing, managed, trial
from geomesh_qgis.engine.child import Cancelled
from geomesh_qgis.engine.environment import (
    MANAGED,
    PATH,
    SETTING,
    VARIABLE,
    EnvironmentProblem,
    Installation,
    find,
    forget_versions,
    installation_at,
)
from geomesh_qgis.engine.installing import explain, install, pip_fraction
from geomesh_qgis.engine.managed import remove, survey, wheel_version
from geomesh_qgis.engine.pythons import BasePython, choose, find_base_python, look, probe
from geomesh_qgis.engine.trial import self_test

import geomesh
from support.samples import ROOT

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the fakes are scripts of POSIX")


def script(path, text):
    """Write an executable script."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)
    return path


def answering(path, version):
    """Write a program that prints a version of geomesh and counts its runs."""
    return script(path, f'#!/bin/sh\necho run >> "$0.runs"\necho "geomesh, version {version}"\n')


def runs(path):
    return len(Path(f"{path}.runs").read_text().split())


def never():
    return False


@pytest.fixture(autouse=True)
def bare_computer(monkeypatch, tmp_path):
    """A computer where only the test's own geomesh exists."""
    forget_versions()
    monkeypatch.delenv("GEOMESH_PYTHON", raising=False)
    (tmp_path / "on path").mkdir()
    monkeypatch.setenv("PATH", f"{tmp_path / 'on path'}:/usr/bin:/bin")


@pytest.fixture
def own(tmp_path):
    """The folder of the plugin's own environment. It does not exist yet."""
    return tmp_path / "profile é" / "geomesh" / "environment"


def environment_at(folder, version):
    answering(folder / "bin" / "python", version)
    (folder / "pyvenv.cfg").touch()
    return folder


# Find an environment


def test_what_is_named_first_is_found_first(tmp_path, own, monkeypatch):
    places = {
        SETTING: answering(tmp_path / "a" / "python", "1.0.0"),
        VARIABLE: answering(tmp_path / "b" / "python3.12", "2.0.0"),
        PATH: answering(tmp_path / "on path" / "geomesh", "3.0.0"),
        MANAGED: environment_at(own, "4.0.0") / "bin" / "python",
    }
    monkeypatch.setenv("GEOMESH_PYTHON", str(places[VARIABLE]))
    module = ("-m", "geomesh")
    assert find(str(places[SETTING]), own) == Installation(
        (str(places[SETTING]), *module), SETTING, "1.0.0"
    )
    assert find("  ", own) == Installation((str(places[VARIABLE]), *module), VARIABLE, "2.0.0")
    monkeypatch.delenv("GEOMESH_PYTHON")
    assert find("", own) == Installation((str(places[PATH]),), PATH, "3.0.0")
    places[PATH].unlink()
    assert find("", own) == Installation((str(places[MANAGED]), *module), MANAGED, "4.0.0")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["python", "command", "folder", "link"])
def test_any_way_to_name_an_environment(tmp_path, own, kind):
    real = {
        "python": Path(sys.executable),
        "command": Path(sys.executable).with_name("geomesh"),
        "folder": Path(sys.prefix),
        "link": tmp_path / "link",
    }[kind]
    if kind == "link":
        real.symlink_to(sys.prefix)
    found = find(str(real), own)
    assert found.version == geomesh.__version__
    assert (len(found.command) == 1) == (kind == "command")


@pytest.mark.parametrize("origin", [SETTING, VARIABLE])
@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("nowhere", "does not exist"),
        ("empty folder", "no Python"),
        ("other python", "No module named geomesh"),
        ("other program", "has no working geomesh"),
        ("no program", "cannot be started"),
        ("old", "older than"),
        ("slow", "within 1 s"),
    ],
)
def test_what_the_user_named_is_never_skipped(tmp_path, own, monkeypatch, origin, kind, reason):
    environment_at(own, "9.9.9")
    answering(tmp_path / "on path" / "geomesh", "9.9.9")
    monkeypatch.setattr(environment, "_TIMEOUT", 1.0)
    place = tmp_path / "named"
    if kind == "empty folder":
        place.mkdir()
    elif kind == "other python":
        place = script(tmp_path / "named", f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')
    elif kind == "other program":
        script(place, "#!/bin/sh\necho hello\n")
    elif kind == "no program":
        place.write_text("text")
    elif kind == "old":
        answering(place, "0.0.9")
    elif kind == "slow":
        script(place, "#!/bin/sh\nexec sleep 30\n")
    if origin == VARIABLE:
        monkeypatch.setenv("GEOMESH_PYTHON", str(place))
    with pytest.raises(EnvironmentProblem, match=reason) as caught:
        find(str(place) if origin == SETTING else "", own)
    message = str(caught.value)
    assert str(place) in message
    assert origin in message
    assert "Settings > Options > geomesh" in message
    assert "\n" not in message


def test_a_command_on_path_that_does_not_work_is_passed_over(tmp_path, own):
    answering(tmp_path / "on path" / "geomesh", "0.0.1")
    with pytest.raises(EnvironmentProblem, match=r"not installed yet .*0\.0\.1.*Install geomesh"):
        find("", own)
    environment_at(own, "1.0.0")
    assert find("", own).origin == MANAGED


def test_nothing_found_points_to_the_options(own):
    with pytest.raises(EnvironmentProblem) as caught:
        find("", own)
    assert str(caught.value) == (
        "geomesh is not installed yet: press Install geomesh in Settings > Options > geomesh"
    )


def test_a_damaged_environment_of_the_plugin_is_to_be_reinstalled(own):
    own.mkdir(parents=True)
    with pytest.raises(EnvironmentProblem, match="Reinstall"):
        find("", own)


def test_a_version_is_asked_once_until_the_files_change(tmp_path, own):
    python = environment_at(own, "1.0.0") / "bin" / "python"
    packages = own / "lib" / "python3.11" / "site-packages"
    packages.mkdir(parents=True)
    find("", own)
    find("", own)
    assert runs(python) == 1
    os.utime(packages, (0, 0))  # as if pip had changed the folder
    find("", own)
    assert runs(python) == 2
    os.utime(python, (0, 0))
    find("", own)
    assert runs(python) == 3
    forget_versions()
    find("", own)
    assert runs(python) == 4


@pytest.mark.parametrize(
    ("smaller", "larger"), [("0.9", "0.10.0"), ("1.0.0", "1.0.1"), ("0.2.0.dev3", "0.2.1rc1")]
)
def test_versions_compare_as_numbers(smaller, larger):
    assert environment.order(smaller) < environment.order(larger)


# The wheel in the plugin


def test_the_newest_wheel_beside_the_plugin_is_taken(tmp_path, monkeypatch):
    monkeypatch.setattr(managed, "WHEELS", tmp_path / "wheel")
    with pytest.raises(EnvironmentProblem, match="make plugin"):
        managed.bundled_wheel()
    (tmp_path / "wheel").mkdir()
    for version in ("0.9.0", "0.10.0"):
        (tmp_path / "wheel" / f"geomesh_toolkit-{version}-py3-none-any.whl").touch()
    (tmp_path / "wheel" / "numpy-9.0.0-py3-none-any.whl").touch()
    assert wheel_version(managed.bundled_wheel()) == "0.10.0"


def test_other_wheels_are_refused(own):
    with pytest.raises(EnvironmentProblem, match="numpy"):
        install(own, Path("numpy-1.0-py3-none-any.whl"), progress=print, cancelled=never)
    assert not own.parent.exists()


def test_what_there_is_is_told_without_an_exception(own, tmp_path, monkeypatch):
    monkeypatch.setattr(managed, "WHEELS", tmp_path / "wheel")
    there_is = survey("", own)
    assert there_is.used is None
    assert "not installed" in there_is.problem
    assert (there_is.managed, there_is.managed_version, there_is.offered) == (False, "", "")
    environment_at(own, "1.0.0")
    (tmp_path / "wheel").mkdir()
    (tmp_path / "wheel" / "geomesh_toolkit-1.2.0-py3-none-any.whl").touch()
    there_is = survey("", own)
    assert there_is.used.origin == MANAGED
    assert (there_is.managed, there_is.managed_version, there_is.offered) == (
        True,
        "1.0.0",
        "1.2.0",
    )


# The Python to create an environment from


def python_of(version, *missing, bits=64, path="/usr/bin/python3"):
    return BasePython(Path(path), version, missing, bits)


def test_a_known_python_is_better_than_a_newer_one():
    found = [python_of((3, 99, 0), path="/new"), python_of((3, 11, 2), path="/old")]
    assert choose([*found, python_of((3, 13, 1), path="/best")]) == Path("/best")
    assert choose(found) == Path("/old")
    assert choose(found[:1]) == Path("/new")


@pytest.mark.parametrize(
    "unfit", [python_of((3, 10, 9)), python_of((3, 12, 0), "ssl"), python_of((3, 12, 0), bits=32)]
)
def test_unfit_pythons_are_passed_over_and_named(unfit):
    assert choose([unfit, python_of((3, 11, 2), path="/fit")]) == Path("/fit")
    with pytest.raises(EnvironmentProblem, match=r"/usr/bin/python3: 3\.1"):
        choose([unfit])


def test_no_python_at_all_is_told():
    with pytest.raises(EnvironmentProblem, match=r"found none.*python\.org"):
        choose([])


@pytest.mark.skipif(sys.platform != "linux", reason="apt is a matter of Debian")
def test_a_missing_package_of_debian_is_named():
    with pytest.raises(EnvironmentProblem, match="apt install python3-venv"):
        choose([python_of((3, 9, 2)), python_of((3, 11, 2), "ensurepip")])


def test_programs_are_asked_what_they_are(tmp_path):
    this = probe(Path(sys.executable))
    assert this == BasePython(Path(sys.executable), tuple(sys.version_info[:3]), (), 64)
    lacking = script(
        tmp_path / "lacking",
        f'#!/bin/sh\nshift\nexec {sys.executable} -c "import sys\n'
        "sys.modules['ensurepip'] = None\n$1\"\n",
    )
    assert probe(lacking).missing == ("ensurepip",)
    assert probe(script(tmp_path / "qgis", "#!/bin/sh\necho QGIS\n")) is None
    assert probe(tmp_path / "none") is None
    link = tmp_path / "link"
    link.symlink_to(sys.executable)
    assert len(look([Path(sys.executable), link, tmp_path])) == 1


def test_qgis_itself_is_never_run_as_a_python(tmp_path, monkeypatch):
    qgis = script(tmp_path / "qgis", f'#!/bin/sh\ntouch "{tmp_path}/opened"\n')
    monkeypatch.setattr(sys, "executable", str(qgis))
    python = find_base_python()
    assert not (tmp_path / "opened").exists()
    assert probe(python).usable


# Create the environment, with a Python that only simulates pip

PLAYER = f"""#!{sys.executable}
import os, shutil, sys, time
arguments = sys.argv[1:]
if arguments[:2] == ["-m", "venv"]:
    os.makedirs(arguments[2] + "/bin")
    open(arguments[2] + "/pyvenv.cfg", "w").close()
    shutil.copy(__file__, arguments[2] + "/bin/python")
elif arguments[:2] == ["-m", "pip"]:
    exec(os.environ.get("PLAY_PIP", ""))
elif "mesh" in arguments and "PLAY_MESH" in os.environ:
    exec(os.environ["PLAY_MESH"])
else:
    os.execv({sys.executable!r}, [{sys.executable!r}, *arguments])
"""

WHEEL = Path(f"/plugin/geomesh_toolkit-{geomesh.__version__}-py3-none-any.whl")


@pytest.fixture
def player(tmp_path):
    return script(tmp_path / "player", PLAYER)


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def make(own, player, progress=lambda *_: None, cancelled=never):
    return install(own, WHEEL, progress=progress, cancelled=cancelled, python=player)


@pytest.mark.slow
def test_the_first_installation(own, player):
    told = []
    made = make(own, player, progress=lambda *values: told.append(values))
    assert made == Installation(
        (str(own / "bin" / "python"), "-m", "geomesh"), MANAGED, geomesh.__version__
    )
    assert find("", own) == made
    assert tree(own.parent) == [
        "environment",
        "environment/bin",
        "environment/bin/python",
        "environment/pyvenv.cfg",
    ]
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1


@pytest.mark.slow
def test_pip_s_lines_are_heard_and_its_files_are_within_the_new_folder(own, player, monkeypatch):
    told = []
    play = "import tempfile; print('Collecting x', tempfile.gettempdir(), *sys.argv[3:])"
    monkeypatch.setenv("PLAY_PIP", play)
    make(own, player, progress=lambda _, message: told.append(message))
    (line,) = [message for message in told if message.startswith("Collecting x")]
    assert f"{own}.new/tmp" in line
    assert "--only-binary=:all:" in line
    assert "--no-input" in line
    assert line.endswith(f"geomesh-toolkit[figures,terrain] @ {WHEEL.as_uri()}")


FAILURES = {
    "disk full": (
        "PLAY_PIP",
        "sys.exit('ERROR: Could not install: [Errno 28] No space left on device')",
        "disk is full",
    ),
    "no wheel": (
        "PLAY_PIP",
        "print('Collecting click\\n  Downloading click-8-py3-none-any.whl (9 kB)');"
        "sys.exit('ERROR: Could not find numba (from versions: none)\\n"
        "ERROR: No matching distribution found for numba>=0.60')",
        "no wheel of numba",
    ),
    "other": ("PLAY_PIP", "print('ERROR: odd'); sys.exit(2)", r"pip failed \(ERROR: odd\)"),
    "silent": ("PLAY_PIP", "os.abort()", r"pip failed \(no message\)"),
    "no mesh": ("PLAY_MESH", "sys.exit('libGL is missing')", "libGL is missing"),
    "no file": (
        "PLAY_MESH",
        'print(\'{"event": "start", "protocol": 1}\\n{"event": "result"}\')',
        "wrote no file",
    ),
    "no crs": (
        "PLAY_MESH",
        "open(arguments[arguments.index('-o') + 1], 'w').close();"
        'print(\'{"event": "start", "protocol": 1}\\n{"event": "log", "message": "x has no CRS"}'
        '\\n{"event": "result"}\')',
        "coordinate systems",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAILURES)
@pytest.mark.parametrize("before", [True, False], ids=["upgrade", "first"])
def test_a_failure_leaves_things_as_they_were(own, player, monkeypatch, kind, before):
    if before:
        environment_at(own, "0.9.0")
    variable, play, reason = FAILURES[kind]
    monkeypatch.setenv(variable, play)
    with pytest.raises(EnvironmentProblem, match=reason) as caught:
        make(own, player)
    assert "\n" not in str(caught.value)
    assert [path.name for path in own.parent.iterdir()] == (["environment"] if before else [])
    if before:
        assert find("", own).version == "0.9.0"


def test_a_python_that_makes_no_environment_is_named(own, tmp_path):
    broken = script(tmp_path / "broken", "#!/bin/sh\necho 'no ensurepip' >&2\nexit 1\n")
    with pytest.raises(EnvironmentProblem, match=rf"{broken}.*no ensurepip"):
        make(own, broken)


@pytest.mark.slow
def test_an_old_environment_is_replaced(own, player):
    environment_at(own, "0.0.1")
    (own / "old").touch()
    make(own, player)
    assert not (own / "old").exists()
    assert [path.name for path in own.parent.iterdir()] == ["environment"]


@pytest.mark.slow
def test_the_old_one_comes_back_if_the_new_one_cannot_take_its_place(own, player, monkeypatch):
    environment_at(own, "0.9.0")
    move = managed.move_folder

    def refuse_new(folder, place):
        if folder.name.endswith(".new"):
            raise EnvironmentProblem("in use")
        move(folder, place)

    monkeypatch.setattr(installing, "move_folder", refuse_new)
    with pytest.raises(EnvironmentProblem, match="in use"):
        make(own, player)
    assert [path.name for path in own.parent.iterdir()] == ["environment"]
    assert find("", own).version == "0.9.0"


@pytest.mark.slow
def test_the_old_one_comes_back_if_the_new_one_does_not_answer_there(own, player, monkeypatch):
    environment_at(own, "0.9.0")
    move = managed.move_folder

    def damage(folder, place):
        move(folder, place)
        if folder.name.endswith(".new"):
            (place / "bin" / "python").unlink()

    monkeypatch.setattr(installing, "move_folder", damage)
    with pytest.raises(EnvironmentProblem, match="no Python"):
        make(own, player)
    assert find("", own).version == "0.9.0"


@pytest.mark.parametrize("lost", [True, False], ids=["between the moves", "before them"])
def test_an_installation_that_was_cut_off_is_tidied_up(own, player, monkeypatch, lost):
    environment_at(own, "0.9.0")
    if lost:
        own.rename(managed.beside(own, "old"))
    else:
        (managed.beside(own, "old") / "bin").mkdir(parents=True)
    (managed.beside(own, "new") / "half").mkdir(parents=True)
    monkeypatch.setenv("PLAY_PIP", "sys.exit(1)")
    with pytest.raises(EnvironmentProblem):
        make(own, player)
    assert [path.name for path in own.parent.iterdir()] == ["environment"]
    assert find("", own).version == "0.9.0"


def test_cancelling_leaves_the_old_one_and_no_process(own, player, monkeypatch, tmp_path):
    environment_at(own, "0.9.0")
    play = f"open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    monkeypatch.setenv("PLAY_PIP", play)

    def cancelled():
        return (tmp_path / "pid").exists() and bool((tmp_path / "pid").read_text())

    with pytest.raises(Cancelled):
        make(own, player, cancelled=cancelled)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
    assert [path.name for path in own.parent.iterdir()] == ["environment"]
    assert find("", own).version == "0.9.0"


def test_a_place_that_cannot_be_written_to_is_told(tmp_path, player):
    (tmp_path / "file").touch()
    with pytest.raises(EnvironmentProblem, match="cannot be installed into"):
        make(tmp_path / "file" / "geomesh" / "environment", player)


# The output of pip


def test_progress_follows_the_downloads():
    lines = [
        "Collecting numpy>=2",
        "  Downloading numpy-2.4.6-cp311-cp311-manylinux_2_28_x86_64.whl.metadata (62 kB)",
        "Collecting pyarrow>=17",
        "  Using cached pyarrow-26.0.1-cp311-cp311-manylinux_2_28_x86_64.whl (55.0 MB)",
        "WARNING: something",
        "Downloading opencv-5.0.0.93-cp37-abi3-manylinux_2_28_x86_64.whl (69.5 MB)",
        "Downloading big-1-py3-none-any.whl (9.5 GB)",
        "Collecting x",
        "Installing collected packages: numpy, pyarrow",
        "Successfully installed numpy-2.4.6",
    ]
    fractions = [pip_fraction(lines[:count]) for count in range(len(lines) + 1)]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0
    # The line appears before the download, so its size counts only from the next line on.
    assert fractions[6] - fractions[5] == pytest.approx(0.6 * 55 / 350, rel=0.01)
    assert fractions[-1] <= 1


@pytest.mark.parametrize(
    "line",
    [
        "WARNING: Retrying after connection broken by 'NewConnectionError(...)': /simple/click/",
        "pip._vendor.urllib3.exceptions.ReadTimeoutError: Read timed out.",
        "ERROR: Could not find click (from versions: none)",
        "Could not fetch URL https://index/simple/: There was a problem confirming the ssl",
    ],
)
def test_a_lost_connection_is_recognised(line):
    message = explain(["Processing geomesh.whl", line, "ERROR: No matching distribution"], WHEEL)
    assert "cannot be downloaded" in message
    assert f'pip install "{WHEEL}"' in message


# Real installations


@pytest.mark.slow
def test_a_real_mesh_is_made_to_try_it_out():
    here = installation_at(sys.executable, SETTING)
    assert self_test(here) == geomesh.__version__
    with pytest.raises(Cancelled):
        self_test(here, cancelled=lambda: True)
    with pytest.raises(EnvironmentProblem, match=r"cannot mesh a test image.*No module named none"):
        self_test(replace(here, command=(sys.executable, "-m", "none")))


def test_the_test_raster_has_a_crs_and_gives_a_mesh_with_nodes_inside(tmp_path):
    mesh = geomesh.mesh_raster(trial.write_test_raster(tmp_path))
    assert mesh.grid.crs.name.startswith("WGS 84")
    assert len(mesh.triangles) > 10


@pytest.mark.slow
def test_the_whole_life_of_an_environment(own, tmp_path, monkeypatch):
    """Install from a wheel, fail without network and when cancelled, verify, remove."""
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", tmp_path, ROOT],
        check=True,
    )
    (wheel,) = tmp_path.glob("geomesh_toolkit-*.whl")
    told = []
    made = install(own, wheel, progress=lambda *values: told.append(values), cancelled=never)
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert made.version == geomesh.__version__
    assert self_test(find("", own)) == geomesh.__version__
    subprocess.run([own / "bin" / "python", "-c", "import matplotlib"], check=True)
    assert [path.name for path in own.parent.iterdir()] == ["environment"]
    assert not (own / "tmp").exists()

    reached = []
    with pytest.raises(Cancelled):
        install(
            own,
            wheel,
            progress=lambda fraction, _: reached.append(fraction),
            cancelled=lambda: reached[-1:] > [0.1],
        )
    assert reached[-1] < 0.9
    assert [path.name for path in own.parent.iterdir()] == ["environment"]

    with monkeypatch.context() as offline:
        offline.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
        offline.setenv("PIP_CONFIG_FILE", os.devnull)
        offline.setenv("PIP_RETRIES", "0")
        offline.setenv("PIP_NO_CACHE_DIR", "1")
        with pytest.raises(EnvironmentProblem, match=r"cannot be downloaded: connect") as caught:
            install(own, wheel, progress=lambda *_: None, cancelled=never)
    assert caught.value.details
    assert [path.name for path in own.parent.iterdir()] == ["environment"]
    assert find("", own) == made

    remove(own)
    assert list(own.parent.iterdir()) == []
    with pytest.raises(EnvironmentProblem, match="not installed"):
        find("", own)


# Remove the environment


def test_removal_takes_what_unfinished_installations_left(own):
    for folder in (own, managed.beside(own, "new"), managed.beside(own, "old")):
        environment_at(folder, "1.0.0")
    remove(own)
    assert list(own.parent.iterdir()) == []
    remove(own)


def test_something_else_is_not_removed(own):
    own.mkdir(parents=True)
    (own / "thesis.txt").touch()
    with pytest.raises(EnvironmentProblem, match="not a Python environment, so it was not removed"):
        remove(own)
    assert (own / "thesis.txt").exists()


def test_two_windows_do_not_install_at_once(tmp_path, monkeypatch):
    place = tmp_path / "environment"
    wheel = tmp_path / "geomesh_toolkit-1.0.0-py3-none-any.whl"
    wheel.touch()
    with managed.locked(place):
        for act in (
            lambda: remove(place),
            lambda: install(
                place, wheel, progress=lambda *_: None, cancelled=lambda: False, python=wheel
            ),
        ):
            with pytest.raises(EnvironmentProblem, match="another QGIS window"):
                act()
    remove(place)
