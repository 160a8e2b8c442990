"""Result of a campaign: its figures, each with its confidence interval, and the comparison of two on the same draws."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError, SettingError
from residua.files import check_output, other_version, read_bytes, replacing
from residua.number_kinds import KNOWN_OR_NOT, NumberKind
from residua.records import Record, values_in, values_out
from residua.shown import Shown, notes
from residua.validate.delays import Delays, delays_of
from residua.validate.figure_table import FigureTable
from residua.validate.intervals import CONFIDENCE, Estimate, bootstrap, clustered_share, events_apart, wilson
from residua.validate.runs import NO_ALARM, SEVERAL, UNKNOWN, RunFigures
from residua.validate.separation import Roc, roc_of
from residua.validate.size_fit import DetectionProbability, detection_probability
from residua.words import counted, number, percent

#: Shares of the runs whose delays are in tables.
_QUANTILES = (0.5, 0.9, 0.95)
#: Share of the runs that count as detected by chance, from which on a note says so.
_CHANCE = 0.1
#: Version of the file of a campaign; files of another one are refused.
VERSION = 1
_ARRAYS = tuple(one.name for one in fields(RunFigures))


@dataclass(frozen=True)
class PairedCase:
    """One case of two campaigns.

    Attributes
    ----------
    fault, shape : str
    size : float
    only_first, only_second : int
        Runs that only one of the monitors detected.
    detected : Estimate
        Share of the runs that the first detects less that of the second, with its bootstrap interval over runs.
    p_value : float
        That so uneven a split of these runs, or more so, comes by chance where neither detects more (McNemar, exact).
    named : Estimate
        Share of the runs in which the first names the fault less that of the second.
    delay : Estimate
        Delay of the first less that of the second, in seconds: mean over the runs that both detected.
    """

    fault: str
    shape: str
    size: float
    only_first: int
    only_second: int
    detected: Estimate
    p_value: float
    named: Estimate
    delay: Estimate


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Two campaigns on the same draws, the first less the second. Prints as a table.

    Attributes
    ----------
    false_alarm_rate : Estimate
        Difference of the fractions of fault-free samples in alarm, with its bootstrap interval over runs.
    cases : tuple of PairedCase

    References
    ----------
    McNemar (1947), Psychometrika 12, 153-157.
    """

    false_alarm_rate: Estimate
    cases: tuple[PairedCase, ...]

    def table(self) -> FigureTable:
        """Return a row for each case."""
        header = ("fault", "shape", "size", "detected", "only first", "only second", "p", "named", "delay [s]")
        rows = [
            (c.fault, c.shape, c.size, c.detected, c.only_first, c.only_second, c.p_value, c.named, c.delay)
            for c in self.cases
        ]
        return FigureTable(header, tuple(rows))

    def __str__(self) -> str:
        first = f"the first monitor less the second; false-alarm rate {self.false_alarm_rate}"
        return f"{first}\n\n{self.table()}" if self.cases else first


@dataclass(frozen=True)
class CaseFacts(Record):
    """One case of a campaign: a fault of one size in one shape.

    Attributes
    ----------
    fault, shape : str
    size : float
        In the unit of the fault; NaN of a stuck channel.
    scenario : int
        Number of its scenario.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"size": KNOWN_OR_NOT}

    fault: str
    shape: str
    size: float
    scenario: int

    @property
    def name(self) -> str:
        """The case as text."""
        sized = "" if np.isnan(self.size) else f", size {number(self.size)}"
        return f"{self.fault}, {self.shape}{sized}"


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Shown):
    """The result of a campaign. Prints as its tables.

    Runs are independent of each other. Run number ``k`` draws the same noise in every case, and without a fault.

    Attributes
    ----------
    plant : str
        Name of the plant that the monitor is designed for.
    cases : tuple of CaseFacts
    groups : tuple of tuple of str
        The faults as the monitor names them, those that it cannot tell apart in one group.
    figures : RunFigures
        Figures of each run; times in samples.
    runs, samples : int
        How many runs of each case, and how long each is.
    seed : int
    dt : float
        Step in seconds.
    threshold : float
        Of the monitor's statistic.
    window : int
        Samples that the statistic is made of.
    settling : int
        Samples after the start in which nothing is decided.
    settings : mapping of str to str
        How the runs were simulated and watched, and by which versions, in words.
    draws, watched : str
        Digests of the settings of the runs, and of the monitor.
    confidence : float
        Of all intervals.
    """

    plant: str
    cases: tuple[CaseFacts, ...]
    groups: tuple[tuple[str, ...], ...]
    figures: RunFigures = field(repr=False)
    runs: int
    samples: int
    seed: int
    dt: float
    threshold: float
    window: int
    settling: int
    settings: Mapping[str, str]
    draws: str = field(repr=False)
    watched: str = field(repr=False)
    confidence: float = CONFIDENCE

    # ----------------------------------------------------------- without faults

    def false_alarm_rate(self) -> Estimate:
        """Return the fraction of the decided fault-free samples that are in alarm, on all runs without a fault.

        Samples of one run are correlated; the interval is Wilson's for as many independent ones as runs show that they
        are worth, or one for each window of the test where that is fewer.
        """
        return clustered_share(self.figures.alarmed, self.figures.decided, self.window, self.confidence)

    def time_between_false_alarms(self) -> Estimate:
        """Return the mean time from one false alarm to the next, in seconds, with its exact Poisson interval.

        Assumes alarms far enough apart that they are independent of one another.
        """
        watched = self.dt * float(self.figures.decided.sum())
        return events_apart(int(self.figures.raised.sum()), watched, self.confidence)

    # -------------------------------------------------------------- with faults

    def detected(self, case: int) -> Estimate:
        """Return the share of the runs of a case that were detected in time, with its Wilson interval."""
        return wilson(int((self.figures.detected[case] >= 0).sum()), self.runs, self.confidence)

    def missed(self, case: int) -> Estimate:
        """Return the share of the runs of a case that were not, with its Wilson interval."""
        return wilson(int((self.figures.detected[case] < 0).sum()), self.runs, self.confidence)

    def by_chance(self, case: int) -> Estimate:
        """Return the share of the runs that would have counted as detected without any fault.

        Those in which a false alarm stands at or after the moment of the onset: a share of detections means something
        as far as it is above this one.
        """
        return wilson(int(self.figures.by_chance[case].sum()), self.runs, self.confidence)

    def named(self, case: int) -> Estimate:
        """Return the share of the detected runs in which the group of the fault was named, with its Wilson interval."""
        detected = int((self.figures.detected[case] >= 0).sum())
        return wilson(int(self._named_right(case).sum()), detected, self.confidence)

    def delay(self, case: int) -> Delays:
        """Return the distribution of the delay from onset to alarm, in seconds; runs without an alarm are censored."""
        f = self.figures
        seen = f.detected[case] >= 0
        end = np.where(seen, f.detected[case], f.stop[case])
        return delays_of(self.dt * (end - f.onset[case]), seen, self.confidence)

    def table(self) -> FigureTable:
        """Return a row for each case: the share detected, by chance, the delay in seconds, and the named faults."""
        header = ("detected", "by chance", "median delay [s]", "90 % delay [s]", "named")

        def figures(c: int) -> tuple[Estimate, ...]:
            return self.detected(c), self.by_chance(c), *self.delay(c).quantiles((0.5, 0.9)), self.named(c)

        return self._by_case(header, figures)

    def delays(self) -> FigureTable:
        """Return a row for each case: the delay in seconds by which shares of the runs were detected.

        Infinite where the runs do not show it: fewer were detected before their end. The mean is that of the detected
        runs alone, with its bootstrap interval.
        """
        header = ("censored", "mean of detected [s]", *(f"{100 * share:g} % [s]" for share in _QUANTILES))

        def figures(c: int) -> tuple[int | Estimate, ...]:
            delay = self.delay(c)
            return delay.censored, delay.mean(self.seed), *delay.quantiles(_QUANTILES)

        return self._by_case(header, figures)

    def confusion(self) -> FigureTable:
        """Return the share of a case's runs in which each group was named, a row for each case.

        A run counts by the attribution of its longest alarm from the onset on. ``several``: several faults at once, by
        code; ``unknown``: an alarm attributed to none, by likelihood where a fault that is not listed, or
        none, is more probable than each that is; ``none``: no alarm.
        """
        shown = [*range(len(self.groups)), SEVERAL, UNKNOWN, NO_ALARM]
        if not (self.figures.named == SEVERAL).any():
            shown.remove(SEVERAL)
        words = {SEVERAL: "several", UNKNOWN: "unknown", NO_ALARM: "none"}
        header = tuple(words.get(g) or " or ".join(self.groups[g]) for g in shown)

        def figures(c: int) -> tuple[Estimate, ...]:
            counts = [int((self.figures.named[c] == g).sum()) for g in shown]
            return tuple(wilson(count, self.runs, self.confidence) for count in counts)

        return self._by_case(header, figures)

    def _by_case(self, header: tuple[str, ...], figures: Callable[[int], tuple[Any, ...]]) -> FigureTable:
        """Return a table with a row for each case."""
        rows = tuple((case.fault, case.shape, case.size, *figures(c)) for c, case in enumerate(self.cases))
        return FigureTable(("fault", "shape", "size", *header), rows)

    def roc(self, case: int | None = None) -> dict[str, Roc] | Roc:
        """Return the curves of detections against false alarms over all thresholds, by case; or that of one case.

        Cases whose names are the same are told apart by their number.
        """
        if case is not None:
            f = self.figures
            return roc_of(f.peak[case], f.quiet_peak[case], self.threshold, self.confidence)
        names = [one.name for one in self.cases]
        labels = [name if names.count(name) == 1 else f"{name} (case {c})" for c, name in enumerate(names)]
        return {name: self.roc(c) for c, name in enumerate(labels)}  # pyright: ignore[reportReturnType]

    def detection_probabilities(self) -> tuple[DetectionProbability, ...]:
        """Return the probability of detection by size for each scenario: fit, a90 and a90/95, or why there is none."""
        out = []
        for scenario in dict.fromkeys(case.scenario for case in self.cases):
            which = [c for c, case in enumerate(self.cases) if case.scenario == scenario]
            first = self.cases[which[0]]
            sizes = np.array([self.cases[c].size for c in which])
            seen = (self.figures.detected[which] >= 0).sum(axis=1)
            runs = np.full(len(which), self.runs, dtype=np.int64)
            out.append(detection_probability(first.fault, first.shape, sizes, runs, seen))
        return tuple(out)

    def compare(self, other: Campaign) -> Comparison:
        """Return this campaign against that of another monitor on the same draws, run by run.

        Raises
        ------
        SettingError
            If the other one has other runs: seed, plant, scenarios, noise, inputs or their number.
        """
        if (self.draws, self.runs) != (other.draws, other.runs):
            raise SettingError(
                "the campaigns are not on the same draws: give both the same plants, scenarios, runs, samples, seed, "
                "noise, inputs, disturbances, controller and within"
            )
        first, second = self.figures, other.figures

        def mean(values: NDArray[np.generic]) -> Estimate:
            return bootstrap(values.astype(float), lambda drawn: drawn.mean(axis=1), self.seed, self.confidence)

        def difference_of_rates(drawn: NDArray[np.float64]) -> NDArray[np.float64]:
            sums = drawn.sum(axis=1)
            return sums[:, 0] / np.maximum(sums[:, 1], 1) - sums[:, 2] / np.maximum(sums[:, 3], 1)

        cases = []
        for c, case in enumerate(self.cases):
            one, two = first.detected[c] >= 0, second.detected[c] >= 0
            alone = int((one & ~two).sum()), int((two & ~one).sum())
            detected = mean(one.astype(float) - two)
            named = mean(self._named_right(c).astype(float) - other._named_right(c))
            delay = mean(self.dt * (first.detected[c] - second.detected[c])[one & two])
            facts = (case.fault, case.shape, case.size)
            cases.append(PairedCase(*facts, *alone, detected, mcnemar(*alone), named, delay))
        rows = np.column_stack([first.alarmed, first.decided, second.alarmed, second.decided]).astype(float)
        return Comparison(bootstrap(rows, difference_of_rates, self.seed, self.confidence), tuple(cases))

    @property
    def notes(self) -> tuple[str, ...]:
        """Cautions about the figures."""
        out, f = [], self.figures
        if not f.decided.any():
            out.append("no fault-free sample was judged: the runs are too short for the filter to settle")
        for c, case in enumerate(self.cases):
            silent, chance = int((f.peak[c] == -np.inf).sum()), self.by_chance(c).value
            early = int((f.onset[c] < self.settling).sum())
            if early:
                out.append(
                    f"{case.name}: in {early} of {self.runs} runs the onset is within the {self.settling} samples "
                    f"({self.settling * self.dt:g} s) over which the monitor settles, and the delay counts these: "
                    "choose a later one"
                )
            if silent:
                out.append(
                    f"{case.name}: in {silent} of {self.runs} runs nothing was judged from the onset on: the filter "
                    "had not settled, or the fault makes values that the monitor takes for no measurement "
                    "(Monitor(plausible=...))"
                )
            if chance > _CHANCE:
                out.append(
                    f"{case.name}: {percent(int(f.by_chance[c].sum()), self.runs)} of the runs would count as detected "
                    "without the fault: count over a shorter time (within=), or compare the curve over all thresholds"
                )
        return tuple(out)

    # ------------------------------------------------------------------- output

    def _parts(self) -> list[str]:
        facts = [f"false-alarm rate {self.false_alarm_rate()} of the fault-free samples"]
        facts.append(f"mean time between false alarms {self.time_between_false_alarms()} s")
        fits = [str(one) for one in self.detection_probabilities() if len(one.sizes) > 1]
        return [notes(facts), *self.table()._parts(), notes([*fits, *self.notes])]

    def __str__(self) -> str:
        rate, apart = self.false_alarm_rate(), self.time_between_false_alarms()
        lines = [
            f"{self.plant}: {counted(self.runs, 'run')} of {self.samples:,} samples for each of "
            f"{counted(len(self.cases), 'case')}, seed {self.seed}",
            f"false-alarm rate {rate} of the fault-free samples",
            f"mean time between false alarms {apart} s",
            f"intervals of {100 * self.confidence:g} % confidence",
        ]
        if self.cases:
            lines += ["", str(self.table())]
            lines += ["", *(str(one) for one in self.detection_probabilities() if len(one.sizes) > 1)]
        return "\n".join([*lines, *(["", *self.notes] if self.notes else [])]).rstrip()

    def to_html(self, path: str | Path, *, title: str | None = None) -> Path:
        """Write a self-contained page with tables, pictures, seed, versions and settings; return its path."""
        from residua.report.campaign_page import write_campaign_page

        return write_campaign_page(self, path, title=title)

    def save(self, path: str | Path) -> Path:
        """Write the campaign to a file, whole or not at all, from which :meth:`load` reads it: arrays and JSON."""
        path = Path(path)
        check_output(path)
        head = json.dumps({"version": VERSION, **values_out(self, but=("figures",))}, allow_nan=False)
        arrays = {name: getattr(self.figures, name) for name in _ARRAYS}
        with replacing(path) as partial, open(partial, "wb") as file:
            np.savez(file, **arrays, head=np.array(head))  # pyright: ignore[reportArgumentType]
        return path

    @staticmethod
    def load(path: str | Path) -> Campaign:
        """Read a campaign written by :meth:`save`, or run with ``resume=``.

        Raises
        ------
        FileFormatError
            If the file is none, is damaged, or holds a campaign that is not complete.
        """
        whole = read_campaign(path)
        if whole.figures.runs < whole.runs:
            raise FileFormatError(
                f"{path} holds {whole.figures.runs} of {whole.runs} runs: call campaign(..., resume={str(path)!r}) "
                "again with the same settings to go on"
            )
        return whole

    def _named_right(self, case: int) -> NDArray[np.bool_]:
        """Return the mask of the runs in which the group of the fault was named."""
        groups = [g for g, group in enumerate(self.groups) if self.cases[case].fault in group]
        return np.isin(self.figures.named[case], groups)


def read_campaign(path: str | Path) -> Campaign:
    """Read a campaign whose runs may not be complete.

    Raises
    ------
    FileFormatError
        If the file is none, or damaged.
    """
    content = read_bytes(path, "campaign file")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            head = json.loads(str(file["head"]))
            arrays = {name: file[name] for name in _ARRAYS}
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path} is not the file of a campaign: {error}") from error
    version = head.pop("version", None) if isinstance(head, dict) else None
    if version != VERSION:
        raise FileFormatError(other_version(str(path), version, VERSION, "run the campaign again"))
    like = RunFigures.empty(len(arrays["onset"]), len(arrays["decided"]))
    for name, values in arrays.items():
        wanted = getattr(like, name)
        if values.shape != wanted.shape or values.dtype != wanted.dtype:
            got = f"{values.dtype} of shape {values.shape}"
            raise FileFormatError(f"{path}: {name} must be {wanted.dtype} of shape {wanted.shape}, got {got}")
    campaign: Campaign = values_in(head, f"{path}: head", Campaign, {"figures": RunFigures(**arrays)})
    if len(campaign.cases) != len(arrays["onset"]):
        raise FileFormatError(f"{path}: head.cases must be {len(arrays['onset'])}, as the figures are")
    return campaign


def mcnemar(first: int, second: int) -> float:
    """Return the exact two-sided p-value of a split of discordant pairs.

    Examples
    --------
    >>> from residua.validate.campaign_result import mcnemar
    >>> mcnemar(5, 5), mcnemar(0, 10)
    (1.0, 0.001953125)
    """
    from scipy.special import bdtr  # slow to import, and needed only here

    pairs = first + second
    return min(1.0, 2 * float(bdtr(min(first, second), pairs, 0.5))) if pairs else 1.0
