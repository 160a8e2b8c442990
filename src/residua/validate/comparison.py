"""Two monitors on the same draws, run by run: differences with their intervals, and McNemar's test."""

from __future__ import annotations

from dataclasses import dataclass

from residua.shown import Shown
from residua.validate.figure_table import FigureTable
from residua.validate.intervals import Estimate


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


def mcnemar(first: int, second: int) -> float:
    """Return the exact two-sided p-value of a split of discordant pairs.

    Examples
    --------
    >>> from residua.validate.comparison import mcnemar
    >>> mcnemar(5, 5), mcnemar(0, 10)
    (1.0, 0.001953125)
    """
    from scipy.special import bdtr  # slow to import, and needed only here

    pairs = first + second
    return min(1.0, 2 * float(bdtr(min(first, second), pairs, 0.5))) if pairs else 1.0
