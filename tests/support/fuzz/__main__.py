"""Put many mutants through geomesh by hand: see the package."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from support.fuzz.run import fuzz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/fuzz"), help="for the mutants")
    given = parser.parse_args()
    numbers = range(given.start, given.start + given.count)
    report = fuzz(given.seed, numbers, given.folder, processes=given.processes, verbose=True)
    print(report)
    sys.exit(1 if report.faults else 0)


main()
