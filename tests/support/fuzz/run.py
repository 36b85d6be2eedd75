"""Make mutants and put them through geomesh in other processes, which may crash or hang."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
import traceback
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO

import numpy as np

from support.fuzz.mutate import mutate
from support.fuzz.originals import Original, write_originals

# Seconds for a mutant; bytes of addresses and of memory for a process. GDAL accepts blocks of 2 GB.
SECONDS = 60
ADDRESSES = 8_000_000_000
MEMORY = 3_000_000_000


@dataclass
class Report:
    """What came of the mutants: how many of each outcome, and the faults."""

    seed: int
    outcomes: Counter[str] = field(default_factory=Counter)
    faults: dict[int, str] = field(default_factory=dict)
    seconds: float = 0
    slowest: tuple[float, int] = (0, -1)
    by_original: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))

    def add(self, number: int, name: str, answer: dict[str, str], seconds: float) -> None:
        self.outcomes[answer["outcome"]] += 1
        self.by_original[name][answer["outcome"]] += 1
        self.slowest = max(self.slowest, (seconds, number))
        if "fault" in answer:
            self.faults[number] = f"{name}: {answer['fault']}"

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {times}" for name, times in self.outcomes.most_common())
        lines = [
            f"seed {self.seed}: {self.outcomes.total()} mutants in {self.seconds:.0f} s: {parts}; "
            f"slowest: number {self.slowest[1]}, {self.slowest[0]:.1f} s"
        ]
        for name, found in self.by_original.items():
            lines.append(
                f"{name:12}" + ", ".join(f"{n} {times}" for n, times in found.most_common())
            )
        lines += [f"number {number}: {fault}" for number, fault in sorted(self.faults.items())]
        return "\n".join(lines)


def make_mutant(
    originals: dict[str, Original], seed: int, number: int, folder: Path
) -> tuple[str, Path]:
    """Write mutant `number` of a seed; return the name of its original, and the file to open."""
    name = list(originals)[number % len(originals)]
    original = originals[name]
    folder.mkdir(parents=True, exist_ok=True)
    for file in original.files:
        shutil.copyfile(file, folder / file.name)
    changed = mutate(original, np.random.default_rng([seed, number]))
    (folder / original.changed.name).write_bytes(changed)
    return name, folder / original.opened.name


def fuzz(
    seed: int, numbers: range, folder: Path, *, processes: int = 2, verbose: bool = False
) -> Report:
    """Put mutants through geomesh. The files of those that show a fault stay in `folder`."""
    shutil.rmtree(folder, ignore_errors=True)
    originals = write_originals(folder / "originals")
    report, started = Report(seed), time.monotonic()
    waiting: SimpleQueue[int] = SimpleQueue()
    for number in numbers:
        waiting.put(number)

    lock = threading.Lock()

    def work() -> None:
        child = Child()
        while True:
            try:
                number = waiting.get_nowait()
            except Empty:
                break
            mutant = folder / f"{seed}-{number}"
            name, path = make_mutant(originals, seed, number, mutant)
            begun = time.monotonic()
            answer = child.check(path, number)
            with lock:
                report.add(number, name, answer, time.monotonic() - begun)
            if "fault" not in answer:
                shutil.rmtree(mutant)
            elif verbose:
                print(f"number {number}: {name}: {answer['fault']}", flush=True)
        child.close()

    with ThreadPoolExecutor(processes) as pool:
        for future in [pool.submit(work) for _ in range(processes)]:
            future.result()
    report.seconds = time.monotonic() - started
    return report


class Child:
    """A process that checks one mutant after another, started again after a crash."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def check(self, path: Path, number: int) -> dict[str, str]:
        if self._process is None:
            self._process = _start()
        process, expired = self._process, threading.Event()

        def stop() -> None:
            expired.set()
            process.kill()

        assert process.stdin is not None
        assert process.stdout is not None
        timer = threading.Timer(SECONDS, stop)
        timer.start()
        try:
            process.stdin.write(f"{number} {path}\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            timer.cancel()
        if line:
            answer: dict[str, str] = json.loads(line)
            if answer["outcome"] == "memory":
                self.close()
            return answer
        code = process.wait()
        self.close()
        if expired.is_set():
            return {"outcome": "hang", "fault": f"no result after {SECONDS} s"}
        return {"outcome": "crash", "fault": f"the process ended with code {code}"}

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def close(self) -> None:
        if self._process is not None:
            self._process.communicate()
            self._process = None


def _start() -> subprocess.Popen[str]:
    tests = str(Path(__file__).parents[2])
    paths = os.pathsep.join([tests, *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.Popen(
        [sys.executable, "-X", "faulthandler", "-c", "from support.fuzz.run import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": paths},
        text=True,
    )


def serve() -> None:
    """Answer each line "number path" on standard input with a line of JSON."""
    import resource  # not available on Windows

    from support.fuzz.check import check

    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = _own_output()
    for line in sys.stdin:
        number, _, path = line.rstrip("\n").partition(" ")
        try:
            answer = {"outcome": check(Path(path), int(number))}
        except BaseException:
            answer = {"outcome": "fault", "fault": traceback.format_exc().strip()}
        used = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if used > MEMORY and "fault" not in answer:
            answer = {"outcome": "memory", "fault": f"{used:,} bytes in use ({answer['outcome']})"}
        print(json.dumps(answer), file=answers, flush=True)


def _own_output() -> IO[str]:
    """Return standard output, and send there what libraries print to standard error."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return answers
