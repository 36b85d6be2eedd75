"""Run the command line, and check its output."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pathlib import Path

# geomesh as a separate program.
PROGRAM = (sys.executable, "-c", "from geomesh.cli import main; main()")

# Content of an output file that exists before the command runs.
OLD = b"an older mesh"


class Run(NamedTuple):
    """The result of a command: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    def warnings(self) -> list[str]:
        """Return the warnings. Standard error must contain nothing else."""
        lines = self.err.splitlines()
        assert [line for line in lines if not line.startswith("Warning: ")] == []
        return [line.removeprefix("Warning: ") for line in lines]

    def error(self) -> str:
        """Return the only error of a failed run. It must have printed only warnings besides."""
        assert self.code == 1, self
        assert self.out == ""
        lines = [line for line in self.err.splitlines() if not line.startswith("Warning: ")]
        assert len(lines) == 1, self.err
        assert lines[0].startswith("Error: ")
        assert "Traceback" not in self.err
        assert "defect of geomesh" not in self.err
        return lines[0].removeprefix("Error: ")


Geomesh = Callable[..., Run]


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """Return the contents of all files in a folder, hidden ones too. Subfolders are None."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def assert_refused(run: Geomesh, *arguments: str | Path, folder: Path, output: Path) -> str:
    """Run a command that must fail, with and without an existing output; return its error.

    Nothing in `folder` may change: no new output, no temporary file, the same old output.
    """
    before = snapshot(folder)
    error = run("mesh", "-o", output, *arguments).error()
    assert snapshot(folder) == before
    output.write_bytes(OLD)
    assert run("mesh", "--overwrite", "-o", output, *arguments).error() == error
    assert snapshot(folder) == before | {str(output.relative_to(folder)): OLD}
    return error


def run_program(*arguments: str | Path, **options: Any) -> Run:
    """Run geomesh as a separate program. `options` are those of subprocess.run."""
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        **options,
    )
    return Run(done.returncode, done.stdout, done.stderr)
