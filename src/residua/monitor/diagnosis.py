"""Outcome of a monitor on data: the alarms, their times, and the faults to blame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import Alarm, Beginning, Candidate, PresentFault
from residua.decide.explanation import FINAL, Explainer
from residua.decide.isolation import Isolation, NoNames
from residua.decide.matched_recursion import Match
from residua.decide.sizes import estimates_of
from residua.decide.statement import (
    SHOWN_ALARMS,
    Statement,
    alike,
    arrival_text,
    began_text,
    left_out_text,
    longest_alarms,
    over_thresholds,
    ranked,
    sizes_text,
    tied_name,
    weight_text,
)
from residua.decide.word import Word
from residua.design import ResidualGenerator
from residua.errors import DataError, MissingExtraError, SettingError
from residua.files import write_text
from residua.monitor.alarms import word_of
from residua.monitor.diagnosis_facts import NamingFacts, PartSeries, RecordingFacts, ThresholdFacts, Totals
from residua.monitor.fit_check import FitCheck
from residua.recording.clock import Clock
from residua.shown import Shown
from residua.visible import echo, listed
from residua.words import counted
from residua.wrong_guesses import Guessed

__all__ = ["Alarm", "Candidate", "Diagnosis"]

#: The words for a fault that a single estimate shows.
NO_DIRECTION = "one estimate has no direction: any of these would look like this"


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Guessed, Shown):
    """The result of a monitor on a recording. Prints as a table.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Seconds.
    residuals : ndarray, shape (T, residuals)
        NaN where a sample was missing.
    statistic : ndarray, shape (T,)
        Norm of the (whitened) residual, of a bank the largest ratio of a member's to its threshold; NaN where no
        decision was possible.
    alarm : ndarray of bool, shape (T,)
    decided : ndarray of bool, shape (T,)
        Where a decision was taken: not while the filter settles, nor where data are missing.
    missing : ndarray of bool, shape (T,)
        Samples with at least one missing value.
    scores : ndarray, shape (T, groups)
        Correlation of each group's signature with the residual over the window, or the fraction of the members of
        a bank that agree with its code; NaN outside decisions.
    alarms : tuple of Alarm
    generator : ResidualGenerator
        The sampled generator that ran.
    test : ThresholdFacts
        Thresholds, and the normal range of residuals: ``threshold``, ``center``, ``band``, ``band_share``,
        ``whitening``, ``averaged``, ``horizon``, ``certified``, ``outside``.
    naming : NamingFacts
        Faults that can be named, and what they are named by: ``groups``, ``signatures``, ``unjudged``, ``window``,
        ``codes``, ``learnt_faults``.
    settings : mapping of str to str
        How threshold, alarms and isolation were set, in words.
    recording : RecordingFacts
        Source of the recording, and what was unusual about it: ``source``, ``origin``, ``resets``, ``predicted``,
        ``is_unlike_the_fit``, ``compared``, ``thinned``, ``table``, ``counted``.
    notes : tuple of str
    parts : PartSeries
        Members of a bank, or groups of residuals, one by one: ``statistics``, ``thresholds``, ``fired``, ``code``,
        ``residuals``.
    match : Match or None
        Of matched filters: likelihood ratio, arrival and size of every fault at every sample, and the
        attribution of a standing alarm; see :class:`residua.decide.Match`.
    fit_check : FitCheck or None
        Check of the fit on its own recordings, and the faults it could have seen; ``None`` without a fit.
    signals : ndarray, shape (T, inputs + outputs)
        The measurements, in plant units; NaN for a missing value. No rows if they were not kept.
    isolation : Isolation
        Isolation that names the alarms, with the certainty of the names.
    explainer : Explainer or None
        Explainer that gives alarms their words, if faults are named by direction or by response.
    """

    time: NDArray[np.float64] = field(repr=False)
    residuals: NDArray[np.float64] = field(repr=False)
    statistic: NDArray[np.float64] = field(repr=False)
    alarm: NDArray[np.bool_] = field(repr=False)
    decided: NDArray[np.bool_] = field(repr=False)
    missing: NDArray[np.bool_] = field(repr=False)
    scores: NDArray[np.float64] = field(repr=False)
    alarms: tuple[Alarm, ...]
    generator: ResidualGenerator = field(repr=False)
    test: ThresholdFacts = field(repr=False)
    naming: NamingFacts = field(repr=False)
    settings: Mapping[str, str] = field(default_factory=dict)
    recording: RecordingFacts = field(default_factory=RecordingFacts)
    notes: tuple[str, ...] = ()
    parts: PartSeries = field(default_factory=PartSeries, repr=False)
    match: Match | None = field(default=None, repr=False)
    fit_check: FitCheck | None = field(default=None, repr=False)
    signals: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    isolation: Isolation = field(default_factory=NoNames, repr=False)
    explainer: Explainer | None = field(default=None, repr=False)

    # ------------------------------------------------------------------- facts

    @property
    def threshold(self) -> float:
        """Threshold on the statistic."""
        return self.test.threshold

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The faults, those that this monitor cannot tell apart in one group."""
        return self.naming.groups

    @property
    def fault_detected(self) -> bool:
        """True if any alarm was raised."""
        return bool(self.alarms)

    @property
    def main_alarm(self) -> Alarm | None:
        """The longest alarm."""
        return max(self.alarms, key=lambda a: a.stop - a.start, default=None)

    @property
    def onset(self) -> float | None:
        """Time at which the longest alarm first crossed its threshold, in seconds; ``None`` without an alarm.

        The change behind it began earlier, as a rule: ``began``.
        """
        return self.main_alarm.onset if self.main_alarm else None

    @property
    def began(self) -> Beginning | None:
        """Interval in which the change behind the longest alarm began; ``None`` if unknown."""
        return self.main_alarm.began if self.main_alarm else None

    @property
    def clock(self) -> Clock:
        """Clock for times: that of the recording if it has dates."""
        return Clock(self.recording.origin, self.generator.dt)

    @property
    def predictions(self) -> dict[str, NDArray[np.float64]]:
        """Model prediction of each output that the filter predicts, in plant units: measured less residual.

        An observer, a Kalman filter and a parity relation predict an output from everything that was measured before,
        and what was measured beside it. Empty for other filters, and where signals were not kept.
        """
        if not len(self.signals):
            return {}
        plant = self.generator.plant
        m = len(plant.inputs)
        return {plant.outputs[j]: self.signals[:, m + j] - self.residuals[:, i] for i, j in self.recording.compared}

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Candidates of the longest alarm, best first; empty without an alarm.

        They are alternatives: empty also by a code of several faults at once (``named`` has them), or of unknown ones.
        """
        return self.main_alarm.candidates if self.main_alarm else ()

    @property
    def named(self) -> tuple[tuple[str, ...], ...]:
        """The faults that explain the longest alarm, one or several; empty without a named fault.

        Each with the faults that look the same.
        """
        return self.main_alarm.named if self.main_alarm else ()

    @property
    def present(self) -> tuple[PresentFault, ...]:
        """Faults of the longest alarm by the code of a dedicated bank, with the times at which their members fired."""
        return self.main_alarm.present if self.main_alarm else ()

    @property
    def members(self) -> tuple[str, ...]:
        """Names of the members of a bank, the columns of ``parts.fired``, ``parts.code`` and ``parts.statistics``.

        Or of the groups of residuals that are tested by themselves, which have no ``code``.
        """
        return self.naming.codes.members if self.naming.codes else tuple(self.parts.residuals)

    @property
    def group_names(self) -> tuple[str, ...]:
        """The groups as text; a fault marked *settled* has the code of its group only once it is constant."""
        return (
            self.naming.codes.labels if self.naming.codes else tuple(" or ".join(group) for group in self.naming.groups)
        )

    @property
    def no_direction(self) -> bool:
        """True if the fault is shown by a single estimate, which cannot distinguish it from anything else."""
        if self.naming.codes is not None or not any(self.generator.estimated) or not self.candidates:
            return False
        best, *_ = self.candidates
        return len(best.faults) > 1 and self.generator.residual_rank == 1

    @property
    def alike(self) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
        """The groups of several faults that look the same here, each with its names as text."""
        return (
            alike(self.naming.codes.groups, self.naming.codes.settled)
            if self.naming.codes
            else alike(self.naming.groups)
        )

    def statement(self, alarm: Alarm) -> Statement:
        """Return the statement about an alarm: headline, confidence, and the reasons."""
        return self.isolation.statement(alarm, self.clock, self.naming.window)

    def word(self, alarm: Alarm, after: int = FINAL) -> Word | None:
        """Return the word for an alarm: the fit of listed faults to so many of its samples and those before it.

        Parameters
        ----------
        alarm : Alarm
        after : int

        Returns
        -------
        Word or None
            ``None`` where faults are named in another way, and of a thinned diagnosis, whose alarms have theirs.
        """
        if self.explainer is None or self.recording.thinned:
            return None
        return word_of(alarm, self.residuals, self.decided, self.explainer, after)

    @property
    def estimates(self) -> dict[str, NDArray[np.float64]]:
        """The estimated size of every fault that is estimated, over time, in its own unit; empty without any.

        As estimated: the fault-free mean is not subtracted. NaN where a sample was missing.
        """
        return estimates_of(self.generator, self.residuals)

    @property
    def false_alarm_fraction(self) -> float:
        """Fraction of the decided samples that are in alarm (a false alarm rate on fault-free data)."""
        return self.totals.alarmed / self.totals.decided if self.totals.decided else 0.0

    @property
    def n_missing(self) -> int:
        """Number of samples with at least one missing value."""
        return self.totals.missing if self.recording.counted else int(self.missing.sum())

    @property
    def totals(self) -> Totals:
        """Numbers of samples of the whole recording."""
        if self.recording.counted is not None:
            return self.recording.counted
        waited = ~(self.decided | self.missing) & np.maximum.accumulate(self.missing)
        return Totals(
            len(self.time),
            *((float(self.time[0]), float(self.time[-1])) if len(self.time) else (0.0, 0.0)),
            int(self.decided.sum()),
            int((self.alarm & self.decided).sum()),
            int(self.missing.sum()),
            int(np.count_nonzero(waited)),
            tuple(_absent(self.signals)),
        )

    # ------------------------------------------------------------------ output

    def __bool__(self) -> bool:
        raise SettingError(
            "a diagnosis is neither true nor false: diagnosis.fault_detected tells whether an alarm was raised"
        )

    def _headline(self) -> str:
        from residua.report.verdict import verdict

        return f"{self.generator.plant.name}, {counted(self.totals.samples, 'sample')}: {verdict(self).headline}"

    def _parts(self) -> list[str]:
        from residua.report.notebook import parts_of

        return parts_of(self)

    def __str__(self) -> str:
        lines = [f"{self.generator.plant.name}: {self.totals.samples} samples, {self._span()}"]
        if self.n_missing:
            lines.append(self.missing_text)
        if not self.alarms:
            seen = self.fit_check.could_have_seen if self.fit_check else ()
            lines += [self._nothing_found, *seen] if self.decided.any() else [f"no decision: {self.why_undecided}"]
        for k, alarm in longest_alarms(self.alarms, SHOWN_ALARMS):
            until = "to the end" if alarm.ended is None else f"until {self.clock.at(alarm.ended)}"
            lines.append(f"alarm {k}: raised {self.clock.at(alarm.raised)}, {until}")
            lines += self.alarm_lines(alarm)
        if self.alarms:
            lines += filter(None, [left_out_text(self.alarms, SHOWN_ALARMS)])
            lines += [f"not distinguishable here: {', '.join(names)}" for _, names in self.alike]
        if self.naming.unjudged:
            want = "a code" if self.naming.codes else "a signature"
            lines.append(f"never named by this monitor; it lacks {want}: {', '.join(self.naming.unjudged)}")
        return "\n".join([*lines, *self.notes])

    @property
    def _nothing_found(self) -> str:
        """Meaning of a result without an alarm."""
        nothing = self.fit_check.sees_nothing if self.fit_check else ""
        return f"cannot tell: {nothing}" if nothing else "no fault found"

    def alarm_lines(self, alarm: Alarm) -> list[str]:
        """Return the printed lines of an alarm: its beginning, the thresholds exceeded, and the faults that explain it.

        Parameters
        ----------
        alarm : Alarm

        Returns
        -------
        list of str
        """
        lines = [f"  {began_text(alarm, self.clock)}"]
        if alarm.fired:
            lines.append(f"  {over_thresholds(alarm, 8)}")
        lines += [f"  {line}" for line in self.statement(alarm).lines]
        return lines + self._candidate_lines(alarm)

    def _candidate_lines(self, alarm: Alarm) -> list[str]:
        """Return the candidates of the first three ranks, those of one rank on one line."""
        lines, last = [], 0
        for rank, candidate in ranked(alarm.candidates):
            if rank == last or len(lines) == 3:
                continue
            last = rank
            if self.no_direction:
                size = "".join(f"  estimated size, if it is {s.fault}: {s}" for s in candidate.sizes[:1])
            else:
                size = f"  estimated size {sizes_text(candidate.sizes, str)}" if candidate.sizes else ""
            name = tied_name(alarm.candidates, rank)
            lines.append(f"  {rank}. {name:<40} {weight_text(candidate)}{size}{arrival_text(candidate)}")
        return [*lines, f"  {NO_DIRECTION}"] if lines and self.no_direction else lines

    @property
    def why_undecided(self) -> str:
        """Reason for a result without any decision, as text: channels missing throughout, or too few samples."""
        if not len(self.time):
            return "the recording is empty"
        if self.n_missing < self.totals.samples:
            return "the recording is too short, or has too many gaps, for the filter to settle"
        names = (*self.generator.plant.inputs, *self.generator.plant.outputs)
        absent = np.array(self.totals.absent, dtype=int)
        never = [name for name, count in zip(names, absent, strict=False) if count == self.totals.samples]
        if never:
            them, their = ("them", "their") if len(never) > 1 else ("it", "its")
            return (
                f"{listed(never)} {'have' if len(never) > 1 else 'has'} no value in the whole recording, and no sample "
                f"without {them} is judged: give {their} values, or a monitor that is made without {them}"
            )
        worst = f" ({names[int(absent.argmax())]!r} is missing most often, at {absent.max()})" if absent.any() else ""
        return f"every sample has a missing value{worst}"

    def _span(self) -> str:
        if not len(self.time):
            return "empty"
        first, last = self.totals.first, self.totals.last
        if self.clock.moment is not None:
            return f"{self.clock.at(first)} to {self.clock.at(last)}"
        return f"{first:.6g} to {last:.6g} s"

    @property
    def missing_text(self) -> str:
        """Text on the treatment of missing values."""
        times = f"{self.recording.resets} time{'' if self.recording.resets == 1 else 's'}"
        restarts = f"; filter restarted {times} after longer gaps" if self.recording.resets else ""
        one = "" if self.n_missing == 1 else "s"
        waited = self.totals.waited
        after = f", nor at {waited} after them while the filter settled again" if waited else ""
        how = "the filter went on with the others" if self.recording.predicted else "last values held"
        return f"{self.n_missing} sample{one} with missing values: {how}, no decision there{after}{restarts}"

    def columns(self) -> dict[str, NDArray]:
        """Return time, residuals, statistic, alarm and scores as named columns.

        For a bank also the statistic of each member and whether it is in alarm; for an estimator also the
        estimates under the names of the faults; for matched filters sizes and ages of the faults.

        Raises
        ------
        DataError
            If the diagnosis is thinned: the message says where the full table is.
        """
        if self.recording.thinned:
            where = (
                f"the full table is in {self.recording.table}"
                if self.recording.table
                else "run_file(residuals=...) writes all of them"
            )
            raise DataError(
                f"this diagnosis keeps {len(self.time)} points of {self.totals.samples} samples, to be drawn: {where}"
            )
        out: dict[str, NDArray] = {"time": self.time}
        out |= {name: self.residuals[:, i] for i, name in enumerate(self.generator.residuals)}
        out |= {"statistic": self.statistic, "alarm": self.alarm}
        out |= {f"score {name}": self.scores[:, g] for g, name in enumerate(self.group_names)}
        for m, member in enumerate(self.members):
            out |= {f"statistic {member}": self.parts.statistics[:, m], f"fired {member}": self.parts.fired[:, m]}
        out |= {f"estimate {fault}": values for fault, values in self.estimates.items()}
        for j, fault in enumerate(self.generator.faults if self.match else ()):
            assert self.match is not None
            out |= {f"size {fault}": self.match.sizes[:, j], f"age {fault}": self.match.ages[:, j]}
        return out

    def to_frame(self, backend: str = "pandas") -> Any:
        """Return the columns as a data frame.

        Parameters
        ----------
        backend : {"pandas", "polars"}

        Raises
        ------
        MissingExtraError
            If that package is not installed.
        SettingError
            If it is another one.
        """
        if backend not in ("pandas", "polars"):
            raise SettingError(f"backend must be 'pandas' or 'polars', got {echo(backend)}")
        try:
            module = __import__(backend)
        except ImportError as error:
            raise MissingExtraError(f"this needs the package {echo(backend)}: pip install {backend}") from error
        return module.DataFrame(self.columns())

    def write_alarms(self, path: str | Path) -> None:
        """Write one JSON object per alarm and line (JSON Lines)."""
        text = "".join(json.dumps(alarm.to_dict(window=self.naming.window)) + "\n" for alarm in self.alarms)
        write_text(path, text)

    def to_json(self, *, whole: bool = True) -> str:
        """Return the diagnosis as JSON, which :meth:`from_json` reads again, every number to its last bit.

        Parameters
        ----------
        whole : bool
            With all series and the generator. If false, only the findings: the verdict, the alarms, the notes.

        Returns
        -------
        str

        Examples
        --------
        >>> import json
        >>> import numpy as np
        >>> import residua as rs
        >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
        >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
        >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
        >>> found = monitor.run(np.ones((200, 1)), np.r_[np.ones(100), 2 * np.ones(100)][:, None])
        >>> json.loads(found.to_json(whole=False))["alarms"][0]["onset"]
        100.0
        >>> again = rs.Diagnosis.from_json(found.to_json())
        >>> str(again) == str(found) and np.array_equal(again.statistic, found.statistic, equal_nan=True)
        True
        """
        from residua.report.document import document_of

        return document_of(self, whole=whole)

    @staticmethod
    def from_json(text: str | bytes) -> Diagnosis:
        """Return the diagnosis that :meth:`to_json` wrote; nothing in the text is executed.

        Raises
        ------
        FileFormatError
            If the text is not a whole diagnosis, an entry is missing, unknown or invalid (the message names it), or the
            content was changed, by its checksum.
        """
        from residua.report.document import diagnosis_of

        return diagnosis_of(text)

    def plot(self, ax: Any = None) -> Any:
        """Plot residuals, statistic with threshold, and candidates over time (needs matplotlib).

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Draw only the statistic, its threshold and the alarms, on these axes.

        Returns
        -------
        matplotlib Figure, or the Axes of the call

        Raises
        ------
        DataError
            If the diagnosis is thinned.
        """
        self._check_whole()
        from residua.report.plots import plot_diagnosis

        return plot_diagnosis(self, ax=ax)

    def to_html(self, path: str | Path, *, title: str | None = None) -> Path:
        """Write a self-contained report page and return its path; not of a thinned diagnosis."""
        self._check_whole()
        from residua.report.page import write_page

        return write_page(self, path, title=title)

    def thinned_to_draw(self, table: str = "") -> Diagnosis:
        """Return the diagnosis with few points of each series, all in memory; ``table``: path of the full table."""
        from residua.report.decimate import thinned

        return thinned(self, table)

    def _check_whole(self) -> None:
        if self.recording.thinned:
            raise DataError(
                "a thinned diagnosis lacks the samples that alarms are drawn at: run_file(report=...) writes the page"
            )


def _absent(signals: NDArray[np.float64], rows: int = 1 << 18) -> NDArray[np.int64]:
    """Return the number of missing values of each channel, piece by piece: recordings may be larger than memory."""
    out = np.zeros(signals.shape[1] if len(signals) else 0, dtype=np.int64)
    for start in range(0, len(signals), rows):
        out += np.count_nonzero(~np.isfinite(signals[start : start + rows]), axis=0)
    return out
