"""Matched filters: signatures of faults, as steps that just arrived, in the innovations of a Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.method import FAULTS, NOISE, SAMPLED, method
from residua.design.core.signatures import steady_responses
from residua.design.observers.kalman_filter import kalman_filter
from residua.errors import DesignError
from residua.plant import Plant
from residua.shown import Shown
from residua.tolerances import RESPONSE_ROUNDING, above_rounding

#: A response that far from where it settles, as a fraction of its peak, is still under way.
_SETTLED = 0.1
#: Numbers in the table of responses; more is a mistake in the window.
_MOST_NUMBERS = 10**7


@dataclass(frozen=True, eq=False, repr=False)
class MatchedFilters(Shown):
    r"""The responses that the innovations are matched with, one for each fault and each arrival time.

    Attributes
    ----------
    generator : ResidualGenerator
        The Kalman filter whose innovations are matched.
    window : int
        ``N``: arrivals up to that many samples ago are distinguished.
    steady : bool
        Whether only the responses of settled faults are used, without an arrival time.
    alike : float
        Faults whose responses over the window correlate by that much are one group.
    responses : ndarray, shape (N + 1, residuals, faults)
        :math:`\rho_j(k)`: the innovation ``k`` samples after a step of size one in fault ``j``, in units of the
        outputs.
    settled : ndarray, shape (residuals, faults)
        What they settle to.
    whitening : ndarray, shape (residuals, residuals)
        ``r @ whitening`` are innovations of covariance one.
    """

    generator: ResidualGenerator
    window: int
    steady: bool
    alike: float
    responses: NDArray[np.float64] = field(repr=False)
    settled: NDArray[np.float64] = field(repr=False)
    whitening: NDArray[np.float64] = field(repr=False)

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults."""
        return self.generator.faults

    @cached_property
    def whitened(self) -> NDArray[np.float64]:
        """The responses of whitened innovations, (N + 1, residuals, faults); only the settled one with ``steady``."""
        if self.steady:
            return (self.whitening.T @ self.settled)[None]
        return np.einsum("kmf,mr->krf", self.responses, self.whitening)

    @cached_property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The faults, those in one group that cannot be told apart over the window, whenever each arrived."""
        return tuple(tuple(self.faults[j] for j in group) for group in alike_faults(self.whitened, self.alike))

    @property
    def unseen(self) -> tuple[str, ...]:
        """Faults to which the innovations (with ``steady``: once they have settled) do not answer at all."""
        grouped = {name for group in self.groups for name in group}
        return tuple(name for name in self.faults if name not in grouped)

    @property
    def vanishing(self) -> tuple[str, ...]:
        """Faults that the innovations answer to for a while only: a constant one is not seen once it has settled."""
        silent = ~np.any(self.settled != 0, axis=0)
        return tuple(name for name, gone in zip(self.faults, silent, strict=True) if gone and name not in self.unseen)

    @cached_property
    def under_way(self) -> tuple[str, ...]:
        """Faults whose responses are still over a tenth of their peak away from settled at the end of the window.

        If one of them arrived longer ago than the window is, and has not settled yet, no hypothesis describes it: the
        result then holds only as far as it was obtained while the arrival lay within the window.
        """
        settled = self.whitening.T @ self.settled
        return () if self.steady else tuple(self.faults[j] for j in not_settled(self.whitened, settled))

    def deviation(self, age: int | None = None) -> dict[str, float]:
        """Return the standard deviation of the estimated size of each fault, in its own units.

        Parameters
        ----------
        age : int, optional
            Samples since it arrived, at a known time; the whole window when omitted.

        Returns
        -------
        dict of str to float
            Infinite where nothing has been seen of the fault by then. A fault of about six of these is detected within
            that age.
        """
        energy = np.cumsum(np.sum(self.whitened**2, axis=1), axis=0)
        at = energy[self._age(age)] * (self.window + 1 if self.steady else 1)
        return {n: float(1 / np.sqrt(e)) if e > 0 else float("inf") for n, e in zip(self.faults, at, strict=True)}

    def similarity(self, age: int | None = None) -> NDArray[np.float64]:
        """Return the similarity of faults that arrive together: 1 means that nothing tells them apart.

        Parameters
        ----------
        age : int, optional
            Samples since they arrived; the whole window when omitted.

        Returns
        -------
        ndarray, shape (faults, faults)
            Size of the correlation of their responses; NaN where a fault is not seen by then.
        """
        rho = self.whitened[: self._age(age) + 1]
        return np.abs(correlations(rho.reshape(-1, rho.shape[2])))

    def _age(self, age: int | None) -> int:
        whole = isinstance(age, (int, np.integer)) and not isinstance(age, bool)
        if age is not None and not (whole and 0 <= age <= self.window):
            raise DesignError(f"age must be a whole number of samples, 0 to {self.window}, the window, got {age!r}")
        return len(self.whitened) - 1 if age is None or self.steady else int(age)

    def __repr__(self) -> str:
        return f"MatchedFilters({self.generator.plant.name!r}: {len(self.faults)} faults, " + (
            f"settled, over {self.window + 1} samples)" if self.steady else f"arrivals 0 to {self.window} samples ago)"
        )

    def __str__(self) -> str:
        lines = [f"{self.generator.method}, {'settled responses' if self.steady else f'window {self.window}'}"]
        half, whole = (self.deviation(age) for age in (self.window // 2, None))
        width = max(map(len, self.faults))
        lines.append(f"{'':{width}}  deviation of the size after {self.window // 2} and {self.window} samples")
        for name in self.faults:
            remark = "  vanishes once constant" if name in self.vanishing else ""
            remark = "  not seen" if name in self.unseen else remark
            lines.append(f"{name:{width}}  {half[name]:.3g}, {whole[name]:.3g}{remark}")
        lines += [f"alike: {', '.join(group)}" for group in self.groups if len(group) > 1]
        lines += _window_notes(self)
        return "\n".join(lines)


@method(
    needs=[NOISE, FAULTS, SAMPLED],
    exists_when="as kalman_filter",
    order="n",
    source="Gertler (1991), section 5.3, eqs. (5-19) to (5-21)",
    faults="by expected response, with arrival time; one step at a time",
    size=True,
    noise="least",
    time_course="step",
)
def matched_filters(plant: Plant, *, window: int = 40, steady: bool = False, alike: float = 0.999) -> MatchedFilters:
    r"""Match the innovations of a Kalman filter with the responses to every fault and every arrival time.

    A fault of size :math:`\nu` that arrived as a step at :math:`t - \tau` adds :math:`\nu \rho_j(k)` to the innovation
    at :math:`t - \tau + k`, where

    .. math::

       e(k + 1) = (A - K C)\, e(k) + (B_{f,j} - K D_{f,j}), \qquad \rho_j(k) = C\, e(k) + D_{f,j}, \qquad e(0) = 0

    for faults of actuators, processes and sensors alike. Innovations are white, so that of all tests the sum of
    products with the expected response sees that fault best (a matched filter). With whitened innovations :math:`r`
    and responses

    .. math::

       \hat\nu = \frac{\sum_k \rho_j(k)^T r(t - \tau + k)}{\sum_k |\rho_j(k)|^2}, \qquad
       T(j, \tau) = \frac{\left(\sum_k \rho_j(k)^T r(t - \tau + k)\right)^2}{\sum_k |\rho_j(k)|^2}

    are the maximum likelihood size and twice the logarithm of the generalised likelihood ratio. The largest of all
    ``T`` gives the fault, its arrival and its size, with standard deviation :math:`(\sum_k |\rho_j(k)|^2)^{-1/2}`.
    One hypothesis more per fault, that it arrived before the window, uses the steady response over the whole window.

    Parameters
    ----------
    plant : Plant
        Sampled, with process and measurement noise (:meth:`residua.Plant.with_noise`) and with faults.
    window : int
        ``N``: arrival times ``t - N`` to ``t`` are hypotheses. It should be longer than the filter takes to settle
        (``under_way`` names the faults for which it is not, and so does the print): a fault that arrived before the
        window is taken to have settled. Each sample of it costs faults x residuals products.
    steady : bool
        The simplified version: one direction per fault, that of its steady response, averaged over ``N + 1`` samples,
        and no arrival time. Cheaper, and wrong about the name while the residual turns to its steady direction.
    alike : float
        Faults whose responses correlate by that much or more over the window, for arrival times of their own, are
        named as one group.

    Returns
    -------
    MatchedFilters
        ``residua.Monitor(matched)`` runs it; it lists groups, unseen and vanishing faults.

    Raises
    ------
    DesignError
        If the plant is continuous, has no noise or no faults, the window or ``alike`` make no sense, the innovations
        answer to none of the faults, or the Kalman filter does not exist.

    See Also
    --------
    kalman_filter : Names by the direction of settled faults.
    fault_estimator : The size over any time course.
    structured_bank : Names by code.

    Notes
    -----
    Guaranteed: for Gaussian noise, one fault at a time, and a step that arrived at a known time within the window, the
    size is normally distributed around the true one with this standard deviation, and no unbiased estimate from
    the same innovations has a smaller one; the fault named is the most likely one.

    Assumes: the model is exact and linear, the filter has settled, noise is white with the covariances of the plant,
    one fault at a time, and it is a step. After missing data, what follows is matched once the filter has settled
    again, as if nothing had been missing. Other time courses are matched with the steps that resemble them most: a slow
    drift is named, but its arrival is late and its size that of an equivalent step. Where the arrival is estimated too,
    the size is the largest of many and the deviation does not know of it: sizes near the threshold are somewhat too
    large. Disturbances are not decoupled.

    References
    ----------
    Gertler (1991), section 5.3, eqs. (5-19) to (5-21); Willsky and Jones (1976), IEEE TAC 21(1), 108-112.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)
    >>> matched = rs.design.matched_filters(plant, window=30)
    >>> matched.groups
    (('p1',), ('p2',), ('y1 sensor',), ('y2 sensor',))
    >>> round(matched.deviation()["p1"], 3), round(matched.deviation(5)["p1"], 3)
    (0.021, 0.054)
    """
    if not isinstance(window, (int, np.integer)) or isinstance(window, bool) or window < 1:
        raise DesignError(f"window must be a whole number of samples, at least 1, got {window!r}")
    if not isinstance(alike, (int, float)) or not 0 < alike <= 1:
        raise DesignError(f"alike must be a correlation, over 0 and up to 1, got {alike!r}")
    if not plant.is_discrete:
        raise DesignError(
            "matched filters count samples since a fault arrived, and this plant is continuous: sample it first, "
            "matched_filters(plant.discretize(dt))"
        )
    if not plant.faults:
        raise DesignError(
            "the plant has no faults: add some with with_sensor_faults, with_actuator_faults or with_faults"
        )
    if plant.Bw.shape[1] == 0:
        raise DesignError(
            "matched filters weigh a response against noise, and this plant has none: "
            "with_noise(process=..., measurement=...)"
        )
    numbers = (int(window) + 1) * plant.n_outputs * len(plant.faults)
    if numbers > _MOST_NUMBERS:
        raise DesignError(
            f"{len(plant.faults)} faults x {plant.n_outputs} outputs x {window} samples are {numbers:,} numbers, the "
            f"most is {_MOST_NUMBERS:,}: shorten the window, or sample more slowly"
        )
    kalman = kalman_filter(plant)
    responses, settled = step_responses(kalman, int(window))
    covariance = kalman.covariance
    if covariance is None:
        raise DesignError("the innovations have no stationary covariance: give every measurement noise")
    whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=float)
    matched = MatchedFilters(kalman, int(window), bool(steady), float(alike), responses, settled, whitening)
    if not matched.groups:
        when = "once they are constant" if steady else f"within {window} samples"
        raise DesignError(
            f"the innovations answer to none of the faults {when} ({', '.join(plant.faults)}): add a sensor that sees "
            + ("them, or steady=False" if steady else "them, or a longer window")
        )
    generator = replace(
        kalman,
        method="matched filters on Kalman innovations",
        evidence=kalman.evidence.extended(
            notes=_notes(matched), references=("Gertler (1991), section 5.3, eqs. (5-19) to (5-21)",)
        ),
    )
    return replace(matched, generator=generator)


def step_responses(generator: ResidualGenerator, window: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the residual of each fault as a step of size one, at 0 to ``window`` samples, and its steady value.

    Returns
    -------
    responses : ndarray, shape (window + 1, residuals, faults)
    settled : ndarray, shape (residuals, faults)
    """
    form, n = generator.internal_form(), len(generator.faults)
    x = np.zeros((form.n_states, n))
    B, D = form.B[:, :n], form.D[:, :n]
    responses, terms = np.empty((window + 1, form.n_outputs, n)), np.abs(D)
    for k in range(window + 1):
        responses[k] = form.C @ x + D
        terms = np.maximum(terms, np.abs(form.C) @ np.abs(x) + np.abs(D))
        x = form.A @ x + B
    settled = steady_responses(form.select(inputs=range(n)))
    return above_rounding(responses, terms, RESPONSE_ROUNDING), settled


def alike_faults(responses: NDArray[np.float64], alike: float) -> list[list[int]]:
    """Return the numbers of the faults, those in one list whose responses are the same but for size and arrival.

    Two faults are alike when the response of one over the whole window correlates by ``alike`` or more with that of
    the other, arrived then or later. Faults without a response are in no list.

    Parameters
    ----------
    responses : ndarray, shape (window + 1, residuals, faults)
        Whitened.
    alike : float
    """
    length, _, count = responses.shape
    whole = _unit(responses.reshape(-1, count))
    linked = np.zeros((count, count), dtype=bool)
    rest = np.cumsum(np.sum(responses**2, axis=1)[::-1], axis=0)[::-1]  # what is left of each from that sample on
    for later in range(length):
        if not np.any((rest[later] >= alike**2 * rest[0]) & (rest[0] > 0)):
            break  # most of every response lies before the other fault arrived
        shifted = np.concatenate([np.zeros((later, *responses.shape[1:])), responses[: length - later]])
        linked |= np.abs(whole.T @ _unit(shifted.reshape(-1, count))) >= alike
    linked |= linked.T
    seen = whole.any(axis=0)
    groups: list[list[int]] = []
    for j in np.flatnonzero(seen).tolist():
        joined = [group for group in groups if linked[j, group].any()]
        groups = [group for group in groups if group not in joined]
        groups.append(sorted([j, *(other for group in joined for other in group)]))
    return sorted(groups)


def not_settled(responses: NDArray[np.float64], settled: NDArray[np.float64]) -> list[int]:
    """Return the numbers of the faults whose responses end over a tenth of their peak away from where they settle.

    Parameters
    ----------
    responses : ndarray, shape (window + 1, residuals, faults)
        Whitened, as ``settled``.
    settled : ndarray, shape (residuals, faults)
    """
    peak = np.maximum(np.linalg.norm(responses, axis=1).max(axis=0), np.linalg.norm(settled, axis=0))
    off = np.linalg.norm(responses[-1] - settled, axis=0)
    return np.flatnonzero(off > _SETTLED * peak).tolist()


def correlations(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlation of every two columns, about zero; NaN for a zero column."""
    unit = _unit(columns)
    unit[:, ~columns.any(axis=0)] = np.nan
    return np.clip(unit.T @ unit, -1.0, 1.0)


def _unit(columns: NDArray) -> NDArray[np.float64]:
    size = np.linalg.norm(columns, axis=0)
    return columns / np.where(size > 0, size, 1.0)


def _notes(matched: MatchedFilters) -> tuple[str, ...]:
    """Return notes for the reader: faults that are alike, that vanish, and whether the window is long enough."""
    notes = [f"not told apart within the window: {', '.join(group)}" for group in matched.groups if len(group) > 1]
    if matched.unseen:
        notes.append(f"not seen: {', '.join(matched.unseen)}")
    if matched.vanishing:
        notes.append(f"seen only for a while, and not once constant: {', '.join(matched.vanishing)}")
    if matched.steady:
        notes.append("settled responses only: the name may be wrong until the residual has settled")
        return tuple(notes)
    return (*notes, *_window_notes(matched))


def _window_notes(matched: MatchedFilters) -> tuple[str, ...]:
    """Warn of a window that is shorter than the responses take to settle, with a length that suffices."""
    if not matched.under_way:
        return ()
    slowest = float(np.abs(matched.generator.system.poles()).max(initial=0.0))
    enough = int(np.ceil(np.log(_SETTLED) / np.log(min(max(slowest, 1e-3), 1 - 1e-9))))
    longer = f", of about {enough} samples," if enough > matched.window else ""
    return (
        f"still under way at the end of the window: {', '.join(matched.under_way)}; a longer window{longer} sees them "
        "settle (until then, once its arrival has left the window, a fault resembles none that is expected)",
    )


__all__ = ["MatchedFilters", "alike_faults", "correlations", "matched_filters", "not_settled", "step_responses"]
