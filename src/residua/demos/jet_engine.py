"""The jet engine of Chen, Patton and Zhang: the model is slightly wrong, only the robust filter names the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.decide import Directional, NormThreshold, projection_distance
from residua.demos.outcome import Outcome
from residua.design import ResidualGenerator, detection_filter, robust_detection_filter
from residua.library import (
    SimulatedRecording,
    jet_engine as library_engine,
    jet_engine_steady_state,
    simulate_jet_engine,
)
from residua.monitor import Diagnosis, Monitor
from residua.report.page import Section, write_demo_page
from residua.report.tables import Table
from residua.words import listing

POLES = (-3.0, -3.0, -3.0)
#: The manoeuvre: fuel goes up at 1 s, a sensor fails at 7 s, when the engine has settled.
FUEL, FAULT_FRACTION = 0.2, 0.02
STEP, FUEL_AT, FAULT_AT, END = 0.005, 1.0, 7.0, 12.0
PLAIN, ROBUST = "Plain detection filter (Beard)", "Robust filter"
#: The cases in which the plain filter is expected to be misled by the linearisation error (paper, section 4).
MISLED = ("n_high sensor", "fuel_flow sensor")


@dataclass(frozen=True, eq=False)
class Case:
    """One filter on one recording.

    Attributes
    ----------
    filter : str
    fault : str
        The fault; empty for none.
    diagnosis : Diagnosis
    distances : dict of str to float
        Normalised projection distance of the last residual from each fault's signature.
    """

    filter: str
    fault: str
    diagnosis: Diagnosis
    distances: Mapping[str, float]

    @property
    def named(self) -> str:
        """The fault that the monitor names; empty without an alarm."""
        return self.diagnosis.candidates[0].name if self.diagnosis.candidates else ""

    @property
    def residual(self) -> NDArray[np.float64]:
        """The residual at the end of the recording."""
        return self.diagnosis.residuals[-1]


def run(folder: Path) -> Outcome:
    """Diagnose the three sensor faults with both filters and write the page, with one case open.

    Parameters
    ----------
    folder : Path
        Exists.

    Returns
    -------
    Outcome
    """
    cases, threshold = diagnose()
    table = distance_table(cases)
    lines = _lines(cases, threshold)
    shown = next(
        (case for case in cases if case.filter == ROBUST and case.fault and case.named == case.fault), cases[0]
    )
    order = sorted(cases, key=lambda case: (case is not shown, case.filter != ROBUST))
    page = write_demo_page(
        [
            _overview(table, lines),
            *(_section(case, folded=case is not shown) for case in order),
        ],
        folder / "jet-engine.html",
        "Jet engine: which sensor failed?",
        introduction=_INTRODUCTION,
    )
    return Outcome(lines, (table,), page, surprises(cases))


def diagnose() -> tuple[list[Case], float]:
    """Return every case, the fault-free one first for each filter, and the threshold of both monitors."""
    engine = library_engine().without_faults("fuel actuator")
    filters = {
        PLAIN: detection_filter(engine, poles=POLES),
        ROBUST: robust_detection_filter(engine, poles=POLES, H0=np.zeros((3, 6))),  # as in the paper
    }
    threshold = 0.5 * min(expected_effect(filters[ROBUST], fault) for fault in engine.faults)
    cases = []
    for name, generator in filters.items():
        monitor = Monitor(
            generator, test=NormThreshold(threshold=threshold, whiten="none"), isolate=Directional(), dt=STEP
        )
        for fault in ("", *engine.faults):
            recording = record(fault)
            found = monitor.run(
                recording.u, recording.y, time=recording.time, source=f"simulated: {fault or 'no fault'}"
            )
            assert isinstance(found, Diagnosis)
            distances = {
                other: projection_distance(found.residuals[-1], generator.subspaces[other]) for other in engine.faults
            }
            cases.append(Case(name, fault, found, distances))
    return cases, threshold


def record(fault: str) -> SimulatedRecording:
    """Return the manoeuvre on the second-order engine, with a fault of 2 % of the measured steady deviation."""
    time = STEP * np.arange(round(END / STEP))
    command = np.where(time >= FUEL_AT - STEP / 2, FUEL, 0.0)
    faults = {fault: np.where(time >= FAULT_AT - STEP / 2, fault_size(fault), 0.0)} if fault else {}
    return simulate_jet_engine(command, dt=STEP, faults=faults)


def fault_size(fault: str) -> float:
    """Return the size of a fault: 2 % of the sensor's value at the end of the manoeuvre."""
    engine = library_engine()
    sensor = engine.outputs.index(fault.removesuffix(" sensor"))
    return FAULT_FRACTION * float((engine.C @ jet_engine_steady_state(FUEL))[sensor])


def expected_effect(generator: ResidualGenerator, fault: str) -> float:
    """Return the norm of the steady residual under the fault, by the linear model."""
    return float(np.linalg.norm(generator.steady_directions[fault]) * fault_size(fault))


def distance_table(cases: list[Case]) -> Table:
    """Return the distances of the residual of each case from the three signatures, and the named sensor."""
    faults = [case.fault for case in cases if case.filter == ROBUST and case.fault]
    rows = []
    for case in cases:
        verdict = case.named or "no fault found"
        if case.fault:
            right = "right" if case.named == case.fault else "wrong"
        else:
            right = "false alarm" if case.diagnosis.fault_detected else "right"
        distances = [round(case.distances[fault], 6) for fault in faults]
        size = float(np.linalg.norm(case.residual))
        if not case.fault and not case.diagnosis.fault_detected:
            distances = [float("nan")] * len(faults)  # the direction of rounding errors means nothing
        rows.append([case.filter, case.fault or "none", size, *distances, verdict, right])
    header = ["filter", "actual fault", "size of residual", *(f"distance: {fault}" for fault in faults), "named", ""]
    caption = (
        "Normalised projection distance of the residual from the signature of each sensor, at the end of the "
        "recording: 0 along it, 1 at right angles; the smallest names the fault"
    )
    return Table(header, rows, caption=caption)


def surprises(cases: list[Case]) -> tuple[str, ...]:
    """Return the results that differ from the paper."""
    out = []
    for case in cases:
        expected_wrong = case.filter == PLAIN and case.fault in MISLED
        if case.filter == ROBUST and not case.fault and case.diagnosis.fault_detected:
            out.append("the robust filter raises a false alarm without a fault")
        if case.fault and (case.named == case.fault) == expected_wrong:
            out.append(
                f"{case.filter}, {case.fault}: it names {case.named or 'nothing'}, "
                f"{'another sensor' if expected_wrong else 'the failed one'} was expected"
            )
    return tuple(out)


_INTRODUCTION = (
    "A jet engine with six sensors is watched by two filters that use a linear model of it (Chen, Patton and Zhang, "
    f"1996, section 4). The engine is the paper's second-order model, eq. (32). When the fuel goes up by {FUEL:g} at "
    f"t = {FUEL_AT:g} s, the engine leaves its operating point, and the linear model is slightly wrong from then on. "
    f"At t = {FAULT_AT:g} s one of the first three sensors begins to read {100 * FAULT_FRACTION:g} % of its deviation "
    "too much.",
    "The plain detection filter (Beard) trusts the linear model. The robust filter is an unknown input observer: it "
    "ignores everything that acts like the second-order terms, and still keeps the fault directions apart. Both have "
    "three poles at -3.",
)


def _lines(cases: list[Case], threshold: float) -> tuple[str, ...]:
    free = {case.filter: float(np.linalg.norm(case.residual)) for case in cases if not case.fault}
    right = {name: [c.fault for c in cases if c.filter == name and c.fault and c.named == c.fault] for name in free}
    alarm_without_fault = {case.filter: case.named for case in cases if not case.fault}
    total = sum(1 for case in cases if case.filter == ROBUST and case.fault)
    shift = [
        float(np.linalg.norm(case.residual - base.residual))
        for base in cases
        if base.filter == PLAIN and not base.fault
        for case in cases
        if case.filter == PLAIN and case.fault
    ]
    return (
        *(_score(name, right[name], total, alarm_without_fault[name]) for name in (ROBUST, PLAIN)),
        f"The reason is the error of the linear model. Without a fault, it leaves a residual of {free[PLAIN]:.2g} in "
        f"the plain filter, where the three faults add only {listing(f'{s:.2g}' for s in shift)}. In the robust filter "
        f"it leaves {free[ROBUST]:.2g}.",
        f"The threshold of both filters is {threshold:.2g}: half of the smallest effect of a fault on the robust one.",
    )


def _score(name: str, right: list[str], total: int, without_fault: str) -> str:
    """Describe how often a filter was right, and whether by chance."""
    text = f"{name}: names {len(right)} of {total} sensors right"
    if right:
        text += f" ({listing(right)})"
    if without_fault:
        text += f". It raises an alarm without a fault, too, and then names {without_fault}"
        if right == [without_fault]:
            text += ": its right answer is chance"
    return text + "."


def _overview(table: Table, lines: tuple[str, ...]) -> Section:
    return Section("Both filters compared", paragraphs=lines, table=table)


def _section(case: Case, *, folded: bool) -> Section:
    heading = f"{case.filter}: {case.fault or 'no fault'}"
    return Section(heading, diagnosis=case.diagnosis, actual=case.fault or (), folded=folded)
