"""Every generated plant with some designs, and every design with some monitors, by turns."""

from __future__ import annotations

from typing import Any

import numpy as np

import residua as rs
from same_results.designs import chosen, generators_of, note_analyses, note_design
from same_results.monitors import Watch, settings_of
from same_results.plants import STEP, Case, case


def measure_plants(watch: Watch, plants: int) -> None:
    """Measure the analyses, designs and monitors of so many plants."""
    for number in range(plants):
        one = case(number)
        note_analyses(watch.ledger, one.name, one.plant, number)
        for turn, (name, make) in enumerate(chosen(number)):
            made = watch.ledger.attempt(f"{one.name}/{name}", lambda make=make, one=one: make(one.plant))
            for member, generator in generators_of(made).items() if made is not None else ():
                _watched(watch, one, f"{one.name}/{name}" + (f"/{member}" if member else ""), generator, turn)


def _watched(watch: Watch, one: Case, name: str, made: Any, turn: int) -> None:
    """Keep a design, and what one of the monitors that suit it says."""
    note_design(watch.ledger, name, made)
    all_settings = list(settings_of(made).items())
    setting, options = all_settings[(one.number // 50 + one.number % 5 + turn) % len(all_settings)]
    dt = None if one.plant.is_discrete else STEP
    generator = getattr(made, "generator", made)
    kind = f"{name}/{setting}"
    monitor = watch.ledger.attempt(kind, lambda: rs.Monitor(made, dt=dt, **options(generator)))
    if monitor is None:
        return
    number = one.number + turn
    fleet = number % 11 == 0
    normal: Any = one.normal if number % 7 else [tuple(x[:200] for x in one.normal), tuple(x[200:] for x in one.normal)]
    faulty = tuple(np.stack([x, x[::-1]]) for x in one.faulty) if fleet else one.faulty
    if setting.endswith("given") or (monitor.is_fitted and number % 4 == 0):
        normal = None  # by the thresholds that are set, or those of the noise model
    watch.monitor(kind, monitor, normal, faulty, page=number % 3 == 0, files=number % 2 == 0)
