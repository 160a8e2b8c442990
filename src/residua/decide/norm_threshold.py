"""Threshold on the norm of the residual: of all residuals together, or of each group of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from residua.decide.member_thresholds import (
    BankTest,
    Groups,
    GroupTest,
    bank_test_from_model,
    fit_bank_test,
    fit_group_test,
    group_test_from_model,
    rows_of_groups,
)
from residua.decide.norm_fit import fit_norm, fit_norm_test
from residua.decide.test import FaultFreeRun, ResidualTest, Watched
from residua.decide.whitened_norm import NormSettings, NormTest, norm_test_from_model
from residua.errors import FileFormatError, SettingError
from residua.records import joined, table_in, text_in, texts_in, values_in, values_out
from residua.visible import echo


@dataclass(frozen=True)
class NormThreshold(NormSettings):
    r"""Alarm while the norm of the whitened residual stays over a threshold.

    .. math:: J_k = \sqrt{\bar q_k^T \bar q_k} > J_{th}, \qquad
       \bar q_k = \frac{1}{\sqrt N} \sum_{i=0}^{N-1} \Sigma_N^{-1/2} (r_{k-i} - \bar r)

    with the covariance :math:`\Sigma_N` of the residual summed over ``N`` samples, divided by ``N``. With a
    window of one sample this is the norm of the whitened residual itself.

    Parameters
    ----------
    threshold : float, optional
        Fitted from fault-free data when omitted (:meth:`residua.Monitor.fit`), or, where the residual's
        covariance is known from the plant's noise, taken from the chi-squared distribution.
    persistence : int
        Samples in a row over the threshold that raise an alarm.
    release : int, optional
        Samples in a row below it that end the alarm; as many as ``persistence`` when omitted.
    window : int
        Samples ``N`` over which the residual is summed. A longer window sees smaller and slower faults, and
        sees large ones no more than that later. It holds the last ``N`` judged samples: those where something is
        missing or the filter settles again do not count, and it reaches further back instead.
    whiten : {"auto", "data", "model", "none"}
        Whose covariance :math:`\Sigma_N` is used: that of the fault-free data, that of the plant's noise
        model, or the identity. ``"auto"`` takes the data when fitted, else the model, else none.
    false_alarm_rate : float, optional
        Intended fraction of fault-free samples in alarm, unless ``fit`` gets another one. When omitted, one that the
        log of a fit can support: 5 / rows, of the usable fault-free rows that the fit uses, between 1e-4 and 1e-2 (1e-3
        of 5,000 rows); and 1e-4 where the threshold is from the plant's noise. A sample is in alarm from the one that
        raises it, the last of ``persistence`` over the threshold, to the one before that which ends it: the rate counts
        samples, not alarms, on data other than those of the fit, once windows are full.
    groups : "each", mapping of str to sequence of str, or sequence of sequence of str, optional
        Groups of residuals that are tested by themselves, each with its own whitening, threshold, alarm and share of
        the rate: every residual alone, or those that are named, each residual in one group. The monitor is in alarm
        while any group is, and tells which. Of many residuals one norm hides a fault that few of them show: of 52, it
        lies at 10 standard deviations where that of a single one lies at 5. Not for banks, whose members are groups
        already.
    source : {"auto", "quantile"}
        How a fit finds the threshold. ``"auto"``: by worlds of the fitted residual model, each fitted anew, so that the
        errors of a fit to so few rows are allowed for. ``"quantile"``: an order statistic of the data, so that the rate
        is at most ``false_alarm_rate`` with 95 % confidence, whatever the distribution. ``basis`` states the rate that
        the samples can promise.

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (24). Of order statistics:
    :func:`residua.decide.confident_thresholds.promise_by`.
    """

    kind: ClassVar[str] = "norm"
    makes: ClassVar[type[ResidualTest]] = NormTest

    groups: Any = None

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        object.__setattr__(self, "groups", _checked_groups(self.groups))

    def from_model(self, watched: Watched) -> NormTest | BankTest | None:
        """Return the test that needs no data; ``None`` when data are needed."""
        generator = watched.generator
        covariance = generator.covariance_of_sums(self.window)
        if watched.parts is not None:
            return bank_test_from_model(self, covariance, watched.parts, generator.n_residuals)
        if self.groups is not None:
            rows = rows_of_groups(self.groups, generator.residuals)
            return group_test_from_model(self, covariance, rows, generator.n_residuals)
        return norm_test_from_model(self, covariance, generator.n_residuals)

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> NormTest | BankTest:
        """Return the test fitted to fault-free data, for a rate of false alarms."""
        covariance = watched.generator.covariance_of_sums(self.window)
        if watched.parts is not None:
            return fit_bank_test(self, run, watched.parts, rate, covariance)
        if self.groups is not None:
            return fit_group_test(self, run, rows_of_groups(self.groups, watched.generator.residuals), rate, covariance)
        return fit_norm(self, run, rate, covariance)

    # ----------------------------------------------- interface to the rest of a monitor

    def check(self, watched: Watched) -> None:
        """Raise unless the groups have each residual exactly once."""
        if self.groups is not None:
            rows_of_groups(self.groups, watched.generator.residuals)
        if self.source != "auto" and (watched.parts is not None or self.groups is not None):
            raise SettingError(
                f"source={self.source!r} makes a promise for one threshold, and here several parts are tested: leave "
                "it at 'auto', or test the residual as a whole (isolate by direction, no groups=)"
            )

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold."""
        if self.source != "auto":
            return super().remedy
        return f"{super().remedy}, give the plant noise (with_noise), or set NormThreshold(threshold=...)"

    @property
    def divides(self) -> bool:
        """True if groups are tested separately."""
        return self.groups is not None

    def kept(self, watched: Watched) -> tuple[str, int, int] | None:
        """Return the window, and the number of whitened residuals kept for each of its samples."""
        parts = watched.parts
        columns = watched.generator.n_residuals if parts is None else sum(map(len, parts.values()))
        return f"NormThreshold(window={self.window})", self.window, columns

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the settings as a record, with ``groups`` if there are any, and ``source`` if not the default."""
        content = values_out(self)
        groups = content.pop("groups")
        if self.source == "auto":
            del content["source"]
        if self.groups is not None:
            content["groups"] = groups if isinstance(groups, str) else {name: list(part) for name, part in self.groups}
        return content

    @classmethod
    def from_record(cls, content: Any, where: str) -> Self:
        """Return the settings that a record describes."""
        content = table_in(content, where)
        groups, source = content.pop("groups", None), content.pop("source", "auto")
        if groups is not None and groups != "each":
            parts = table_in(groups, joined(where, "groups"))
            groups = {name: texts_in(part, joined(joined(where, "groups"), name)) for name, part in parts.items()}
        known = {"groups": groups, "source": text_in(source, joined(where, "source"))}
        return values_in(content, where, cls, known)

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if a test has another window."""
        if content.get("window") != self.window:
            raise FileFormatError(f"{where}.window must be that of the test, {self.window}")

    def test_from_record(self, content: Any, where: str, watched: Watched) -> ResidualTest:
        """Read a test from a record."""
        cls = BankTest if watched.parts is not None else NormTest if self.groups is None else GroupTest
        if cls is GroupTest:
            watched = replace(watched, parts=rows_of_groups(self.groups, watched.generator.residuals))
        test = values_in(content, where, cls)
        test.check(watched)
        return test


def _checked_groups(groups: object) -> Groups:
    """Return groups of residuals as plain names; those without a name are called by their residuals."""
    if groups is None:
        return None
    if isinstance(groups, str) and groups == "each":
        return "each"
    wanted = "groups must be 'each', names of groups with the names of their residuals, or a list of lists of these"
    if isinstance(groups, Mapping):
        pairs = list(groups.items())
    elif isinstance(groups, Sequence) and not isinstance(groups, str):
        if all(isinstance(one, tuple) and len(one) == 2 and isinstance(one[0], str) and isinstance(one[1], tuple)
               for one in groups):  # the form that this function returns  # fmt: skip
            pairs = list(groups)
        else:
            pairs = [(None, one) for one in groups]
    else:
        raise SettingError(f"{wanted}, got {echo(groups)}")
    out: dict[str, tuple[str, ...]] = {}
    for name, members in pairs:
        if isinstance(members, str) or not isinstance(members, Sequence) or not len(members):
            raise SettingError(f"{wanted}, got {echo(members)} for one group")
        names = tuple(str(one) for one in members)
        label = ", ".join(names) if name is None else str(name)
        if label in out:
            raise SettingError(f"two groups are called {echo(label)}")
        out[label] = names
    if not out:
        raise SettingError(f"{wanted}, got none")
    return tuple(out.items())


__all__ = ["NormTest", "NormThreshold", "fit_norm_test", "norm_test_from_model"]
