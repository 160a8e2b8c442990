"""Bounds of the peak norm over an uncertain set: what each method gives, in what time, up to which size.

Run it with::

    .venv/bin/python benchmarks/robust_norms.py > docs/data/robust_norms.csv
    .venv/bin/python docs/make_tables.py

It prints CSV: one row per size and method, with the bound over the largest output that was found (1 is the best there
can be). A method that takes longer than the limit at one size is left out at all larger ones. The second command makes
the table of the page "Peak norms and robust bounds" of it.
"""

from __future__ import annotations

# ruff: noqa: E402
import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import csv
import sys
import time

import numpy as np

from residua.errors import AccuracyError, DesignError
from residua.linear import UncertainSystem, robust_peak_norm

SIZES = ((2, 2), (4, 4), (6, 6), (8, 8), (12, 6), (12, 12), (20, 5), (20, 10), (20, 20))
#: Name, options.
METHODS = (
    ("star", {"method": "star"}),
    ("star, 16 boxes", {"method": "star", "boxes": 16, "rtol": 0.0}),
    ("centred", {"method": "centred"}),
    ("centred, 32 boxes", {"method": "centred", "boxes": 32, "rtol": 1e-3}),
    ("quadratic", {"method": "quadratic"}),
    ("popov-tsypkin", {"method": "popov-tsypkin"}),
    ("lifted", {"method": "lifted"}),
)
HEADER = ("states", "parameters", "method", "bound / attained", "seconds", "outcome")


def system(n: int, k: int, seed: int = 0, change: float = 0.1) -> UncertainSystem:
    """Return a system with ``k`` parameters that change ``A`` by about a tenth of its stability margin."""
    rng = np.random.default_rng([n, k, seed])
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    left, right = rng.standard_normal((n, k)), rng.standard_normal((k, n))
    left /= np.linalg.norm(left, axis=0)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    size = change * (1 - 0.9) / np.sqrt(k)
    Bw, Cz = rng.standard_normal((n, 2)), rng.standard_normal((1, n))
    return UncertainSystem(A, left, Bw, right, Cz, None, [[0.5, 0.0]], low=[-size] * k, high=[size] * k, dt=1.0)


def measure(n: int, k: int, options: dict) -> tuple[str, float, str]:
    start = time.perf_counter()
    try:
        found = robust_peak_norm(system(n, k), **options)
    except (DesignError, AccuracyError) as error:
        return "", time.perf_counter() - start, f"{type(error).__name__}: {error}"[:80]
    return f"{found.ratio:.4f}", time.perf_counter() - start, "bound"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=float, default=400.0, help="seconds after which a method is given up")
    parser.add_argument("--most", type=int, default=20, help="largest number of states")
    asked = parser.parse_args()
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(HEADER)
    slow: set[str] = set()
    for n, k in SIZES:
        for name, options in METHODS:
            if n > asked.most or name in slow:
                continue
            ratio, seconds, outcome = measure(n, k, options)
            out.writerow((n, k, name, ratio, f"{seconds:.2f}", outcome))
            sys.stdout.flush()
            if seconds > asked.limit:
                slow.add(name)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
