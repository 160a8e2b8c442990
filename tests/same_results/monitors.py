"""Monitors of every kind of test and isolation: fitted, run, stepped, saved, loaded, reported."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import residua as rs
from residua.decide import Directional, Matched, NormThreshold, PeakThreshold, Structured
from same_results.ledger import Ledger

#: Fraction of false alarms that thresholds are fitted for: what short recordings can show.
RATE = 0.02
#: Samples that are stepped one by one after a run, and the length of the blocks of an update.
STEPS, BLOCK = 25, 67

Options = dict[str, Any]


def _halves(generator: rs.design.ResidualGenerator) -> NormThreshold:
    """Return a test of two groups of residuals, or of one where there is but one."""
    names = generator.residuals
    middle = max(1, len(names) // 2)
    groups = {"first": names[:middle], "last": names[middle:]}
    return NormThreshold(groups={name: group for name, group in groups.items() if group}, persistence=1)


def _thresholds(generator: rs.design.ResidualGenerator) -> PeakThreshold:
    return PeakThreshold({member.name: 0.5 for member in generator.members}, window=5)


#: Settings of a monitor by what its design is; each a function of the generator.
WHOLE: dict[str, Callable[[Any], Options]] = {
    "defaults": lambda g: {},
    "window": lambda g: {
        "test": NormThreshold(window=5, persistence=2, release=4),
        "isolate": Directional(window=20),
    },
    "each": lambda g: {"test": NormThreshold(groups="each"), "isolate": Directional(signature="steady")},
    "peak": lambda g: {"test": PeakThreshold(window=10)},
    "bare": lambda g: {
        "test": NormThreshold(2.0, whiten="none", persistence=1),
        "isolate": None,
        "start": "rest",
    },
    "peak given": lambda g: {
        "test": PeakThreshold(0.8, window=5),
        "isolate": Directional(window=9, signature="subspace"),
    },
    "settings": lambda g: {
        "test": NormThreshold(whiten="model"),
        "settle": 30,
        "max_hold": 3,
        "plausible": 5.0,
        "start": "rest",
    },
    "groups": lambda g: {"test": _halves(g)},
}
BANKS: dict[str, Callable[[Any], Options]] = {
    "code": lambda g: {"isolate": Structured(window=20)},
    "code, peak": lambda g: {"test": PeakThreshold(window=10), "isolate": Structured(window=10, distance=0)},
    "code, window": lambda g: {
        "test": NormThreshold(window=4, persistence=2),
        "isolate": Structured(window=30, share=0.8),
    },
    "code, peak given": lambda g: {"test": _thresholds(g), "isolate": Structured()},
    "direction": lambda g: {"isolate": Directional(window=20)},
}
MATCHED: dict[str, Callable[[Any], Options]] = {
    "defaults": lambda g: {},
    "release": lambda g: {"test": NormThreshold(persistence=1, release=8)},
    "alike": lambda g: {"isolate": Matched(window=8, alike=0.9)},
}


def settings_of(made: Any) -> dict[str, Callable[[Any], Options]]:
    """Return the settings that suit a design."""
    if isinstance(made, rs.design.MatchedFilters):
        return MATCHED
    generator = getattr(made, "generator", made)
    return WHOLE if generator.codes is None else BANKS


@dataclass(frozen=True)
class Watch:
    """What is measured, and where the files of monitors go to.

    Attributes
    ----------
    ledger : Ledger
    folder : Path
        Of the monitors that are saved.
    older : Path or None
        A folder of monitors that another state of the source saved: they are what is loaded.
    """

    ledger: Ledger
    folder: Path
    older: Path | None = None

    def monitor(
        self, case: str, monitor: rs.Monitor, normal: Any, faulty: Any, *, page: bool = True, files: bool = True
    ) -> None:
        """Fit a monitor, run it, and keep all that it says; then save it, load it, and run and step what was loaded."""
        ledger = self.ledger
        if normal is not None:
            fit = normal if isinstance(normal, tuple) else (normal,)
            if ledger.attempt(f"{case}/fit", lambda: monitor.fit(*fit, false_alarm_rate=RATE)) is None:
                return
        given = faulty if isinstance(faulty, tuple) else (faulty,)
        found = ledger.attempt(f"{case}/run", lambda: monitor.run(*given, source="recording"))
        if found is None:
            return
        for p, one in enumerate(found if isinstance(found, list) else [found]):
            note_diagnosis(ledger, f"{case}/run" + (f"/{p}" if isinstance(found, list) else ""), one)
        if isinstance(found, list):
            return
        if page:
            note_page(ledger, f"{case}/page", found, self.folder)
        if files:
            monitor.reset()
            self._file(case, monitor, given)

    def _file(self, case: str, monitor: rs.Monitor, given: tuple[Any, ...]) -> None:
        """Save a monitor, load it, run it and go on sample by sample."""
        ledger, name = self.ledger, re.sub(r"\W+", "-", case) + ".json"
        monitor.save(self.folder / name)
        content: dict[str, Any] = json.loads((self.folder / name).read_text(encoding="utf-8"))
        for entry, value in content.items():
            if entry != "checksum":
                ledger.note(f"{case}/saved", entry, json.dumps(value, sort_keys=True))
        source = self.folder if self.older is None or not (self.older / name).exists() else self.older
        loaded = ledger.attempt(f"{case}/loaded", lambda: rs.Monitor.load(source / name))
        if loaded is None or len(given) != 2:
            return
        u, y = given
        rows = range(0, len(y), BLOCK)
        parts = [loaded.update(None if u is None else u[k : k + BLOCK], y[k : k + BLOCK]) for k in rows]
        for kind in ("residuals", "statistic", "alarm", "usable", "scores", "fired", "code"):
            ledger.note(f"{case}/loaded", kind, np.concatenate([getattr(part, kind)[0] for part in parts], axis=0))
        loaded.save(self.folder / f"running-{name}")
        again = ledger.attempt(f"{case}/going on", lambda: rs.Monitor.load(self.folder / f"running-{name}"))
        if again is not None:
            decisions = [again.step(None if u is None else u[k], y[k]) for k in range(len(y) - STEPS, len(y))]
            note_decisions(ledger, f"{case}/steps", decisions)


def note_diagnosis(ledger: Ledger, case: str, found: rs.Diagnosis) -> None:
    """Keep the numbers and the words of a diagnosis."""
    ledger.count(case, "residuals", found.residuals)
    ledger.count(case, "statistic", found.statistic)
    ledger.count(case, "threshold", found.threshold)
    ledger.count(case, "member thresholds", found.member_thresholds)
    for kind in ("alarm", "decided", "missing", "scores", "member_statistics", "fired", "code", "band", "center"):
        ledger.note(case, kind, getattr(found, kind))
    if found.match is not None:
        for kind in ("ratios", "ages", "sizes", "deviations", "arrival"):
            ledger.note(case, f"match {kind}", getattr(found.match, kind))
    ledger.note(case, "groups", found.groups, found.naming.unjudged, found.members)
    ledger.note(case, "named", found.named)
    ledger.note(case, "times", *((a.onset, a.raised, a.ended, a.start, a.stop, a.began) for a in found.alarms))
    ledger.note(case, "alarms", *(json.dumps(a.to_dict(window=found.window)) for a in found.alarms))
    ledger.note(case, "str", found)
    ledger.note(case, "settings", sorted(found.settings.items()), found.notes)
    ledger.note(case, "columns", *(part for pair in found.columns().items() for part in pair))
    ledger.note(case, "predictions", *(part for pair in found.predictions.items() for part in pair))


def note_decisions(ledger: Ledger, case: str, decisions: list[rs.monitor.Decision]) -> None:
    """Keep what was said sample by sample."""
    ledger.note(case, "residuals", np.array([one.residual for one in decisions]))
    ledger.note(case, "alarms", np.array([(one.statistic, one.alarm, one.decided, one.missing) for one in decisions]))
    ledger.note(case, "candidates", *((c.faults, c.score, c.ratio) for one in decisions for c in one.candidates))
    ledger.note(case, "named", *((one.named, one.fired, one.blamed, one.arrived, one.present) for one in decisions))
    ledger.note(case, "readings", *(one.reading for one in decisions if one.reading is not None))
    ledger.note(case, "estimates", *(sorted(one.estimates.items()) for one in decisions))


def note_page(ledger: Ledger, case: str, found: rs.Diagnosis, folder: Path) -> None:
    """Keep the report page: words, data of the charts and its frame, without the version of the package."""
    text = found.to_html(folder / "page.html").read_text(encoding="utf-8")
    note_page_text(ledger, case, text)


def note_page_text(ledger: Ledger, case: str, text: str) -> None:
    """Keep the parts of a page."""
    text = re.sub(r"Made by residua [\w.+]+", "Made by residua", text)
    head, _, rest = text.partition("<main>")
    body, _, tail = rest.partition("</main>")
    data, _, scripts = tail.partition("</script>")
    ledger.note(case, "page", body)
    ledger.note(case, "charts", data)
    ledger.note(case, "page frame", head, scripts)
