"""Calls, files and frames of the package in a design of four states: how far it is from a call to SciPy.

Only functions of the package count, and none of what imports it; the plant is new, so that nothing of it is kept::

    PYTHONPATH=src python benchmarks/design_depth.py
    PYTHONPATH=../before/src python benchmarks/design_depth.py
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import residua as rs

PACKAGE = str(Path(rs.__file__).resolve().parent) + os.sep
SCIPY = f"{os.sep}scipy{os.sep}"


def plant(seed: int) -> rs.Plant:
    """Return the vertical take-off aircraft in other units, with a disturbance, noise and two faults."""
    p = rs.library.vtol()
    made = rs.Plant(p.A * (1 + seed / 8), p.B, p.C, name="vtol").with_disturbances(p.B[:, [1]])
    return made.with_faults({"f1": p.B[:, 0]}).with_noise(process=1.0, measurement=0.1)


def singular(p: rs.Plant) -> rs.Plant:
    """Return a plant whose last state obeys an algebraic equation."""
    return rs.Plant(p.A, p.B, p.C, E=np.diag([1.0, 1, 1, 0]), name="singular")


DESIGNS: dict[str, Callable[[rs.Plant], Any]] = {
    "kalman_filter": lambda p: rs.design.kalman_filter(p.without_disturbances()),
    "unknown_input_observer": rs.design.unknown_input_observer,
    "detection_filter": lambda p: rs.design.detection_filter(p.without_disturbances()),
    "robust_detection_filter": rs.design.robust_detection_filter,
    "luenberger_observer": lambda p: rs.design.luenberger_observer(p.without_disturbances()),
    "reduced_order_observer": rs.design.reduced_order_observer,
    "descriptor_observer": lambda p: rs.design.descriptor_observer(singular(p)),
    "perfect_observer": lambda p: rs.design.perfect_observer(p, least_order=True),
    "inverse_form_observer": lambda p: rs.design.inverse_form_observer(p.without_disturbances()),
    "eigenstructure_assignment": lambda p: rs.design.eigenstructure_assignment(p, insensitive_to="f1"),
    "fault_estimator": lambda p: rs.design.fault_estimator(p.without_disturbances(), faults="f1"),
    "sensor_fault_estimators": rs.design.sensor_fault_estimators,
}


def counted(design: Callable[[rs.Plant], Any], subject: rs.Plant) -> tuple[int, int, int, int]:
    """Return calls, files, frames when SciPy is first reached, and the most frames."""
    calls, files, first, most = 0, set[str](), 0, 0

    def look(frame: FrameType, event: str, _: object) -> None:
        nonlocal calls, first, most
        name = frame.f_code.co_filename
        if event != "call" or not (name.startswith(PACKAGE) or (SCIPY in name and not first)):
            return
        depth, at = 0, frame
        while at is not None:
            depth += at.f_code.co_filename.startswith(PACKAGE)
            at = at.f_back
        if name.startswith(PACKAGE):
            calls, most = calls + 1, max(most, depth)
            files.add(name)
        else:
            first = depth

    sys.setprofile(look)
    try:
        design(subject)
    finally:
        sys.setprofile(None)
    return calls, len(files), first, most


def main() -> None:
    """Print the table."""
    print(f"{'design':<24}{'calls':>8}{'files':>8}{'SciPy at':>10}{'deepest':>9}")
    for name, design in DESIGNS.items():
        design(plant(1))  # imports
        calls, files, first, most = counted(design, plant(2))
        print(f"{name:<24}{calls:>8}{files:>8}{first:>10}{most:>9}")


if __name__ == "__main__":
    main()
