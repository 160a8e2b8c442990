"""Ten million rows of eight channels: memory and time of subspace identification, beside the matrix products it needs.

``python benchmarks/identification_at_size.py [--rows N]`` simulates a plant into a file on disk, which is read as it is
(``numpy.memmap``), and prints the largest memory of the process that is not the file's, the time, and the time of the
products ``H' H`` of the same Hankel matrix in blocks of the same size.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import residua as rs

INPUTS, OUTPUTS, PAST, BLOCK = 3, 5, 15, 100_000


def recorded(path: Path, rows: int) -> np.ndarray:
    """Write a recording of a plant with six states, block by block, and return it as a view of the file."""
    rng = np.random.default_rng(0)
    A = np.diag([0.95, 0.9, 0.8, 0.6, 0.4, -0.3]) + np.triu(0.05 * rng.standard_normal((6, 6)), 1)
    C = rng.standard_normal((OUTPUTS, 6))
    plant = rs.StateSpace(A, rng.standard_normal((6, INPUTS)), np.vstack([C, A]), dt=1.0)
    plant = plant.replaced(D=np.vstack([np.zeros((OUTPUTS, INPUTS)), plant.B]))  # the next states are outputs too
    x = np.zeros(6)
    data = np.memmap(path, dtype=np.float32, mode="w+", shape=(rows, INPUTS + OUTPUTS))
    for start in range(0, rows, BLOCK):
        count = min(BLOCK, rows - start)
        u = rng.standard_normal((count, INPUTS))
        both = plant.simulate(u, x)
        y, x = both[:, :OUTPUTS], both[-1, OUTPUTS:]
        data[start : start + count] = np.hstack([u, y + 0.1 * y.std(axis=0) * rng.standard_normal(y.shape)])
    data.flush()
    del data
    return np.memmap(path, dtype=np.float32, mode="r", shape=(rows, INPUTS + OUTPUTS))


class Anonymous:
    """The largest memory of this process that belongs to no file, in MB, watched every 20 ms."""

    def __init__(self) -> None:
        self.largest, self._stop = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Anonymous:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._stop.wait(0.02):
            text = Path("/proc/self/status").read_text(encoding="ascii")
            self.largest = max(self.largest, int(text.split("RssAnon:")[1].split()[0]) / 1024)


def products(data: np.ndarray, rows: int) -> float:
    """Return the seconds that the products of the Hankel matrix take, in blocks as the factor has them."""
    columns = 1 + (PAST + 1) * (INPUTS + OUTPUTS)
    block = np.random.default_rng(1).standard_normal((8 * columns, columns))
    block.T @ block  # warm
    start = time.perf_counter()
    for _ in range(int(np.ceil(0.75 * rows / len(block)))):
        np.matmul(block.T, block)
    return time.perf_counter() - start


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    rows = parser.parse_args().rows
    with tempfile.TemporaryDirectory() as folder:
        data = recorded(Path(folder, "data"), rows)
        names = {"inputs": [f"u{i}" for i in range(INPUTS)], "outputs": [f"y{i}" for i in range(OUTPUTS)]}
        with Anonymous() as memory:
            start = time.perf_counter()
            model = rs.identify.subspace(data, **names, dt=1.0, past=PAST, progress=False)
            taken = time.perf_counter() - start
        needed = products(data, rows)
    print(f"{rows} rows of {INPUTS + OUTPUTS} channels, order {model.report.order}: {taken:.1f} s")
    print(
        f"memory at most {memory.largest:.0f} MB; products of the Hankel matrix {needed:.1f} s, {taken / needed:.2f} x"
    )


if __name__ == "__main__":
    main()
