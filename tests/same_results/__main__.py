"""Measure a source tree, or compare two measurements.

``PYTHONPATH=SRC:tests python -m same_results --out FILE`` measures the package in ``SRC``: it writes a hash of
everything that the package answers for 300 generated plants and all recordings, and the numbers beside them. With
``--older FOLDER`` monitors are loaded from those that another measurement kept (``--keep FOLDER``).

``python -m same_results --compare BEFORE AFTER`` prints what differs.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import residua
from same_results.commands import measure_commands
from same_results.compare import compare
from same_results.ledger import Ledger
from same_results.monitors import Watch
from same_results.plants import PLANTS
from same_results.recordings import measure_recordings
from same_results.runs import measure_plants
from same_results.uncertain import measure_uncertain


@contextlib.contextmanager
def standing_clock() -> Iterator[None]:
    """Let no time pass: what is tried until its time is used up must not depend on how busy the machine is."""
    kept = time.monotonic, time.perf_counter
    time.monotonic = time.perf_counter = lambda: 0.0
    try:
        yield
    finally:
        time.monotonic, time.perf_counter = kept


def measure(out: Path, plants: int, older: Path | None, keep: Path | None) -> None:
    """Measure everything and write the file."""
    ledger = Ledger()
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings(), standing_clock():
        warnings.simplefilter("ignore")
        folder = Path(name)
        watch = Watch(ledger, folder, older)
        parts = {
            "plants": lambda: measure_plants(watch, plants),
            "recordings": lambda: measure_recordings(watch),
            "uncertain plants": lambda: measure_uncertain(watch),
            "commands": lambda: measure_commands(ledger, folder),
        }
        for part, run in parts.items():
            start = time.process_time()
            run()
            print(
                f"{part}: {time.process_time() - start:.0f} s of work, {len(ledger.hashes)} hashes so far", flush=True
            )
        if keep is not None:
            shutil.copytree(folder, keep, dirs_exist_ok=True)
    ledger.write(out)


def main() -> int:
    """Measure or compare."""
    parser = argparse.ArgumentParser(prog="same_results", description=__doc__)
    parser.add_argument("--out", type=Path, help="file of hashes to write")
    parser.add_argument("--plants", type=int, default=PLANTS, help="generated plants")
    parser.add_argument("--keep", type=Path, help="folder for the saved monitors")
    parser.add_argument("--older", type=Path, help="folder of monitors that are loaded in place of one's own")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"))
    options = parser.parse_args()
    if options.compare:
        return int(compare(*options.compare) > 0)
    if options.out is None:
        parser.error("give --out FILE, or --compare BEFORE AFTER")
    print(f"measured: {Path(residua.__file__).parent}")
    measure(options.out.resolve(), options.plants, options.older, options.keep)
    return 0


if __name__ == "__main__":
    sys.exit(main())
