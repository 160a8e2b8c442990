"""One question to the package about one plant: what it says, and what is to be said of that."""

from __future__ import annotations

import re
import traceback
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

import residua as rs
from exact.plants import ExactPlant, exact_plant, integrators, with_answers_of
from exact_campaign.cases import Case, Units, base_units, plant_of
from residua.errors import AccuracyError, ResiduaError
from residua.linear.subspaces.rank import RankDecision

#: Outcomes from best to worst; the last ones fail the campaign.
OUTCOMES = ("holds", "near", "refused", "accuracy", "close", "units", "evidence", "contradiction", "wrong", "crash")
FAILURES = ("units", "evidence", "contradiction", "wrong", "crash")


@dataclass(frozen=True)
class Answer:
    """What a function returned, or why it refused, or how it crashed."""

    made: Any = None
    refused: str = ""
    accuracy: bool = False
    crash: str = ""


@dataclass
class Record:
    """An answer with the facts that may not depend on units, and what is wrong with it."""

    function: str
    answer: Answer
    facts: dict[str, Any] = field(default_factory=dict)
    evidence: dict[str, float] = field(default_factory=dict)
    problems: list[tuple[str, str, str]] = field(default_factory=list)  # outcome, topic, text

    @cached_property
    def near(self) -> bool:
        """Whether the answer says that double precision hardly decides it."""
        made = self.answer.made
        ranks = [made, *getattr(made, "decisions", ())]
        notes = getattr(getattr(getattr(made, "generator", made), "evidence", None), "notes", ())
        return (
            any(isinstance(one, RankDecision) and not one.is_clear for one in ranks)
            or bool(getattr(made, "near", ()))
            or any("near:" in note for note in notes)
        )

    def problem(self, outcome: str, topic: str, text: str) -> None:
        """Note what is wrong; where the answer says that it is near, it is close."""
        self.problems.append(("close" if outcome == "wrong" and self.near else outcome, topic, text))

    @property
    def outcome(self) -> str:
        """The worst of what is to be said."""
        own = "refused" if self.answer.refused else "near" if self.near else "holds"
        own = "accuracy" if self.answer.accuracy else own
        found = [own, *(outcome for outcome, _, _ in self.problems)]
        return max(found, key=OUTCOMES.index)


@dataclass
class Subject:
    """A plant in some units, with its exact twin and the records about it."""

    case: Case
    by: Units
    of_floats: bool = True  # whether the exact twin is that of the floats, or the case itself
    records: dict[str, Record] = field(default_factory=dict)
    known: dict[str, Answer] = field(default_factory=dict)
    like: Subject | None = None  # the same plant in other units, whose exact answers are had already

    @cached_property
    def plant(self) -> rs.Plant:
        """The plant of floats."""
        return plant_of(self.case, self.by)

    @cached_property
    def noisy(self) -> rs.Plant:
        """The plant with noise."""
        return plant_of(self.case, self.by, noise=True)

    @cached_property
    def exact(self) -> ExactPlant:
        """The plant as fractions: those of the floats themselves, or of the case."""
        by = replace(self.by, t=1.0)  # its twin has the rates of the case
        found = exact_plant(plant_of(self.case, by) if self.of_floats else plant_of(self.case))
        if self.like is None:
            return found
        return with_answers_of(found, self.like.exact, self.by if self.of_floats else base_units(self.case))

    @cached_property
    def rates(self) -> float:
        """The size of the dynamics, of the case."""
        A = plant_of(self.case).A
        return float(np.abs(A).max(initial=0.0)) or 1.0

    @cached_property
    def integrators(self) -> int:
        """How often the plant integrates, of the case: decimal units may move them off by rounding."""
        return integrators(exact_plant(plant_of(self.case)))

    def ask(self, function: str, call: Callable[[], Any], about: str = "") -> Record:
        """Ask, and keep the record; ``about`` is what the question depends on besides the plant, if anything."""
        question = f"{function} {about}"
        if question not in self.known:
            self.known[question] = answered(call)
        record = Record(function, self.known[question])
        if record.answer.crash:
            record.problem("crash", "crash", record.answer.crash)
        self.records[function] = record
        return record


def answered(call: Callable[[], Any]) -> Answer:
    """Return what a call says; an error outside the package's own is a crash, and so is a warning of NumPy."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return Answer(made=call())
        except ResiduaError as error:
            return Answer(refused=str(error), accuracy=isinstance(error, AccuracyError))
        except Exception as error:
            last = traceback.extract_tb(error.__traceback__)[-4:]
            where = " < ".join(f"{frame.filename.rsplit('/', 1)[-1]}:{frame.lineno}" for frame in reversed(last))
            return Answer(crash=f"{type(error).__name__}: {str(error)[:160]} ({where})")


_NUMBER = re.compile(r"(?<![A-Za-z_0-9.])[-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan)(?:[-+]\d+\.?\d*(?:e[-+]?\d+)?[ij])?")


def without_numbers(text: str) -> str:
    """Return a text with its numbers masked; names such as ``y1`` stay."""
    return _NUMBER.sub("#", text)


def plain(value: Any) -> Any:
    """Return a fact that can be compared and printed."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value
