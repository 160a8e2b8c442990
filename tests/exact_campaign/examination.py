"""One plant in several units through everything, with what is wrong, what contradicts, and what depends on units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from exact_campaign.analyses import analyses
from exact_campaign.answers import FAILURES, Record, Subject, without_numbers
from exact_campaign.cases import Case, Units, base_units, in_other_time, literal, units
from exact_campaign.designs import designs
from exact_campaign.kinds import case_of
from residua.tolerances import LEAK

#: Evidence below this is rounding whatever its factor: a filter is refused from a millionth on.
_ROUNDING = 1e-8
#: Evidence may grow by this factor with the units.
_FACTOR = 10.0


@dataclass(frozen=True)
class Failure:
    """What went wrong, and the plant."""

    kind: str
    seed: int
    units: str
    function: str
    outcome: str
    topic: str
    text: str
    plant: str


Stage = Callable[[Subject], None]


def stages() -> tuple[Stage, ...]:
    """Return what is asked of every plant."""
    return analyses, designs


def examined(case: Case, by: Units, ask: tuple[Stage, ...], like: Subject | None = None) -> Subject:
    """Return a plant in some units with all its records; ``like`` is the same plant in others."""
    subject = Subject(case, by, like=like)
    for stage in ask:
        stage(subject)
    return subject


def examine(kind: str, seed: int, ask: tuple[Stage, ...] | None = None) -> tuple[dict[str, str], list[Failure]]:
    """Return the outcome of every function for a plant, and what went wrong or was close.

    In base units, and in powers of two, that of time too, where nothing may differ; every third plant in powers of ten
    too, where the floats are no longer the fractions that the plant was made of.
    """
    case = case_of(kind, seed)
    ask = stages() if ask is None else ask
    base = examined(case, base_units(case), ask)
    other = examined(case, in_other_time(case, units(case, seed, powers_of_two=True), seed), ask, base)
    compare(base, other)
    subjects = [base, other]
    if seed % 3 == 0:
        subjects.append(rounded(case, units(case, seed, powers_of_two=False), ask, base))
    outcomes, failures = {}, []
    for subject in subjects:
        for name, record in subject.records.items():
            outcomes[f"{name} | {subject.by.name}"] = record.outcome
            failures += [
                Failure(kind, seed, subject.by.name, name, outcome, topic, text, literal(subject.plant))
                for outcome, topic, text in record.problems
                if outcome in FAILURES or outcome == "close"
            ]
    return outcomes, failures


def rounded(case: Case, by: Units, ask: tuple[Stage, ...], base: Subject) -> Subject:
    """Return a plant in decimal units with its records: wrong is what neither its floats nor the case itself allow."""
    subject = examined(case, by, ask, base)
    if not any(outcome == "wrong" for record in subject.records.values() for outcome, _, _ in record.problems):
        return subject
    second = Subject(case, by, of_floats=False, known=subject.known, like=base)
    for stage in ask:
        stage(second)
    for name, record in subject.records.items():
        again = second.records.get(name)  # what is asked may depend on what is exactly attainable
        wrong = {topic for outcome, topic, _ in again.problems if outcome == "wrong"} if again else set()
        record.problems = [
            (outcome if outcome != "wrong" or topic in wrong else "close", topic, text)
            for outcome, topic, text in record.problems
        ]
    return subject


def compare(base: Subject, other: Subject) -> None:
    """Note on the second subject what is not as on the first, though only units differ."""
    for name, record in other.records.items():
        if name in base.records:
            _compare(base.records[name], record)


def _compare(base: Record, other: Record) -> None:
    a, b = base.answer, other.answer
    if a.crash or b.crash:
        return
    if bool(a.refused) != bool(b.refused):
        text = f"in base units: {a.refused[:150] or 'made'}; in others: {b.refused[:150] or 'made'}"
        accepted, refused = (b, a) if a.refused else (a, b)
        close = refused.accuracy and _hardly_accurate(accepted.made)
        other.problem("close" if close else "units", "units: refusal", text)
        return
    if a.refused and without_numbers(a.refused) != without_numbers(b.refused):
        other.problem("units", "units: reason", f"{a.refused[:250]} || {b.refused[:250]}")
    for key, value in base.facts.items():
        if key in other.facts and masked(value) != masked(other.facts[key]):
            other.problem("units", f"units: {key}", f"{key}: {str(value)[:200]} || {str(other.facts[key])[:200]}")
    for key, value in base.evidence.items():
        least, most = sorted((value, other.evidence.get(key, value)))
        if most > _FACTOR * max(least, _ROUNDING):
            other.problem("units", "units: evidence", f"{key}: {value:.2e} || {other.evidence[key]:.2e}")


def _hardly_accurate(design: Any) -> bool:
    """Tell whether the evidence of a design would fail its check if it grew with the units as far as it may."""
    found = getattr(getattr(design, "generator", design), "evidence", None)
    if found is None:
        return False
    errors = [*found.decoupling.values(), found.conditions.get("estimate off the state", 0.0)]
    return max(errors) * _FACTOR > LEAK


def masked(value: Any) -> Any:
    """Return a fact with the numbers in its texts masked."""
    if isinstance(value, str):
        return without_numbers(value)
    if isinstance(value, dict):
        return {k: masked(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [masked(v) for v in value]
    return value
