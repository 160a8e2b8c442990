"""Exported C in a shared library, run over recordings."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.export.c99 import code, header
from residua.export.monitor_program import MonitorProgram

STRICT = (
    *("-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"),
    *("-fPIC", "-shared"),
)
_RUN = """
#include "mon.h"
void run(long samples, const REAL *u, const REAL *y, int inputs, int outputs, double *out, int width);
void run(long samples, const REAL *u, const REAL *y, int inputs, int outputs, double *out, int width)
{
    static mon_state state;
    static mon_decision d;
    long k;
    mon_init(&state);
    for (k = 0; k < samples; k++) {
        mon_step(&state, u + k * inputs, y + k * outputs, &d);
        COLUMNS
    }
}
"""
#: What a decision leaves, in this order.
_ORDER = (
    "residual",
    "statistic",
    "known",
    "decided",
    "alarm",
    "best",
    "score",
    "code",
    "answer",
    "part_statistic",
    "fired",
)


class CompiledExport:
    """A monitor in C, compiled without a warning."""

    def __init__(self, made: MonitorProgram, folder: Path, *flags: str) -> None:
        real = made.precision.name
        names = made.program.names
        kept = [names[name] for name in _ORDER if name in names and names[name].role == "output"]
        lines, self._width = [], 0
        for one in kept:
            for j in range(1 if one.size is None else one.size):
                place = "" if one.size is None else f"[{j}]"
                lines.append(f"out[k * width + {self._width}] = (double)d.{one.name}{place};")
                self._width += 1
        (folder / "mon.h").write_text(header(made, "mon"), encoding="utf-8")
        (folder / "mon.c").write_text(code(made, "mon"), encoding="utf-8")
        text = _RUN.replace("COLUMNS", "\n        ".join(lines)).replace("REAL", real)
        (folder / "run.c").write_text(text, encoding="utf-8")
        command = ["gcc", *STRICT, *flags, "mon.c", "run.c", "-o", "mon.so", "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        self._kind = np.float64 if real == "double" else np.float32
        self._library = ctypes.CDLL(str(folder / "mon.so"))

    def run(self, u: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return residuals, statistic, known, decided, alarm, best group and scores of each sample, a column each."""
        u, y = np.ascontiguousarray(u, dtype=self._kind), np.ascontiguousarray(y, dtype=self._kind)
        out = np.zeros((len(y), self._width))
        count = ctypes.c_long(len(y))
        self._library.run(count, u.ctypes, y.ctypes, u.shape[1], y.shape[1], out.ctypes, self._width)
        return out
