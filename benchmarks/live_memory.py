"""Memory of a run over a day of a thousand plants at one sample a second, replayed fast: writes a table by hour."""

from __future__ import annotations

import csv
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

from live_runs import configuration, memory_by_hour  # noqa: E402
from residua.live.config import load_settings  # noqa: E402
from residua.live.run import Run  # noqa: E402

TABLE = ROOT / "docs" / "data" / "live_memory.csv"
PLANTS, HOURS = 1000, 24
SOURCE = '[[sources]]\nkind = "stdin"\npath = "rows.jsonl"'


def main() -> None:
    """Run the day, and write the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rows.jsonl").touch()
        run = Run(load_settings(configuration(folder, SOURCE, plants=[f"p{k}" for k in range(PLANTS)])))
        memory, rows, seconds = memory_by_hour(run, PLANTS, HOURS)
        run.close()
    later = max(memory[1:])
    print(f"{rows:,} rows in {seconds:.0f} s; {memory[0]:.1f} MB after the first hour, {later:.1f} MB at most after it")
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["hour", *range(1, HOURS + 1)])
        writer.writerow(["MB", *(f"{one:.1f}" for one in memory)])


if __name__ == "__main__":
    main()
