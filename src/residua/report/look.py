"""What to look at: the components of the faults that are named, what to check there, and how large the fault is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.monitor.naming import fault_unit
from residua.report.choosing import SHOWN_FAULTS
from residua.report.tables import html_table
from residua.report.text import escape, number, size_text
from residua.report.verdict import POOR_SCORE

if TYPE_CHECKING:
    from residua.monitor.alarm import Alarm
    from residua.monitor.diagnosis import Diagnosis

_KINDS = {"sensor": "sensor", "actuator": "actuator", "component": "component"}


def look_table(diagnosis: Diagnosis) -> str:
    """Return what to look at where faults are named; empty without."""
    main, plant = diagnosis.main_alarm, diagnosis.generator.plant
    if main is None:
        return ""
    groups = [*diagnosis.named, *(c.faults for c in main.candidates[1:2] if main.doubt)]
    faults = [name for group in groups for name in group if name in plant.faults]
    if not faults:
        return ""
    shown = [plant.fault_list[plant.faults.index(name)] for name in faults[:SHOWN_FAULTS]]
    told = {size.fault: size for size in main.sizes}
    sizes, guessed = [], False
    for fault in shown:
        if fault.name in told:
            sizes.append(size_text(told[fault.name]))
            continue
        size = steady_size(diagnosis, main, fault.name)
        guessed |= size is not None
        sizes.append("" if size is None else f"{number(size, 2)} {fault_unit(plant, fault.name)}".strip())
    columns: list[tuple[str, list[str]]] = [
        ("Fault", [f'<td class="name">{escape(fault.name)}</td>' for fault in shown]),
        ("Component", [escape(fault.component) for fault in shown]),
        ("Kind", [_KINDS.get(fault.kind, escape(fault.kind)) for fault in shown]),
        ("What it is", [escape(fault.description) for fault in shown]),
        ("What to check", [escape(fault.check) for fault in shown]),
        ("Size, if constant by now" if guessed else "Size", [escape(size) for size in sizes]),
    ]
    kept = [(name, cells) for name, cells in columns if any(cells)]
    rows = [[cell or "–" for cell in row] for row in zip(*(cells for _, cells in kept), strict=True)]
    more = len(faults) - len(shown)
    note = f'<p class="muted">… and {more} more, which this monitor cannot tell from these.</p>' if more else ""
    return f"<h3>What to look at</h3>{html_table([name for name, _ in kept], rows)}{note}"


def steady_size(diagnosis: Diagnosis, main: Alarm, fault: str) -> float | None:
    """Return the size of a constant fault that explains the end of the main alarm best, by steady responses.

    ``None`` where a constant fault leaves no residual, where its direction does not fit, where the alarm is too short
    to have settled (twice the window), and where the name is not by direction.
    """
    best = main.candidates[0] if main.candidates else None
    if diagnosis.match is not None or diagnosis.codes is not None or best is None:
        return None
    if not best.score >= POOR_SCORE or main.samples < 2 * diagnosis.window:
        return None
    steady = diagnosis.generator.steady_directions[fault] @ diagnosis.whitening
    rows = np.flatnonzero(diagnosis.decided[: main.stop])[-diagnosis.window :]
    seen: NDArray[np.float64] = (diagnosis.residuals[rows] - diagnosis.center).mean(axis=0) @ diagnosis.whitening
    energy, along = float(steady @ steady), float(steady @ seen)
    if energy == 0 or not math.isfinite(along) or abs(along) < POOR_SCORE * math.sqrt(energy) * np.linalg.norm(seen):
        return None
    return along / energy
