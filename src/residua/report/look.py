"""What to look at: the components of the faults that are named, what to check there, and how large the fault is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from residua.report.choosing import SHOWN_FAULTS
from residua.report.tables import html_table
from residua.report.text import escape, size_text

if TYPE_CHECKING:
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
    sizes = [size_text(told[fault.name]) if fault.name in told else "" for fault in shown]
    columns: list[tuple[str, list[str]]] = [
        ("Fault", [f'<td class="name">{escape(fault.name)}</td>' for fault in shown]),
        ("Component", [escape(fault.component) for fault in shown]),
        ("Kind", [_KINDS.get(fault.kind, escape(fault.kind)) for fault in shown]),
        ("What it is", [escape(fault.description) for fault in shown]),
        ("What to check", [escape(fault.check) for fault in shown]),
        ("Estimated size", [escape(size) for size in sizes]),
    ]
    kept = [(name, cells) for name, cells in columns if any(cells)]
    rows = [[cell or "–" for cell in row] for row in zip(*(cells for _, cells in kept), strict=True)]
    more = len(faults) - len(shown)
    note = f'<p class="muted">… and {more} more, which this monitor cannot tell from these.</p>' if more else ""
    return f"<h3>What to look at</h3>{html_table([name for name, _ in kept], rows)}{note}"
