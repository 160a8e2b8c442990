"""Sizes of constant faults that are seen as long as they last: predicted from the noise, without simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.errors import DesignError
from residua.tolerances import IDENTITY, RANK

#: The test that is foretold: the whitened norm of sums of as many samples as the longest mean of the default test is
#: worth, with this rate of false alarms.
WINDOW, RATE = 127, 1e-3
#: Share of the time that a fault of the size that is called seen is in alarm, or has the right name.
SEEN = 0.95
#: The normal quantile of that share.
_QUANTILE = 1.644854
#: What is measured is that many times what is foretold, in the mean.
_MEASURED = 1.25
#: A transient of a filter has passed when so much of it is left; its faults are followed for so many samples.
_SETTLED, _FOLLOWED = 0.01, 1500


@dataclass(frozen=True, eq=False)
class LastingFaults:
    r"""Detection of constant faults by a test on sums of a residual.

    With :math:`S` the covariance of a sum of ``N`` samples over :math:`\sqrt N`, from the noise of the plant, and
    :math:`Z_n` the same sum of the response to a step of size one, a fault of size :math:`s` puts the whitened norm
    over its threshold :math:`h` with the probability

    .. math:: P(\chi^2_k(s^2 d_n^2) > h^2), \qquad d_n = |S^{-1/2} Z_n|

    of a noncentral :math:`\chi^2`. A bank tests its members one by one, each with its part of the rate.

    Attributes
    ----------
    generator : ResidualGenerator
        Sampled.
    whitening : tuple of (tuple of int, ndarray)
        For each part that is tested by itself its residuals, and :math:`S^{-1/2}` over them.
    """

    generator: ResidualGenerator
    whitening: tuple[tuple[tuple[int, ...], NDArray[np.float64]], ...] = field(repr=False)

    @cached_property
    def sizes(self) -> dict[str, float]:
        """For each fault the size that is seen as long as it lasts; infinite where none is."""
        return dict(zip(self.generator.faults, self._of_parts.min(axis=0, initial=np.inf).tolist(), strict=True))

    @cached_property
    def named(self) -> dict[str, float]:
        """For each fault the size from which on its name is right too, by direction or code; infinite where none is.

        By direction a sum must lie nearer to the line or plane of its own fault than to that of any other, as
        an isolation reads them; by code every member that the fault fires must fire.
        """
        g, faults = self.generator, self.generator.faults
        if g.codes is not None:
            codes = [tuple(column) for column in g.codes.T.tolist()]
            fired = np.where(g.codes, self._of_parts, 0.0).max(axis=0, initial=0.0)
            unique = [any(code) and codes.count(code) == 1 for code in codes]
            return {name: float(size) if one else np.inf for name, size, one in zip(faults, fired, unique, strict=True)}
        whiten, away = self.whitening[0][1], self._settled[0]
        signatures = {}
        for name, steady in zip(faults, away.T, strict=True):  # as an isolation by direction reads them
            plane = g.subspaces[name]
            narrow = 0 < plane.shape[1] < g.residual_rank
            signatures[name] = np.linalg.qr(whiten @ plane if narrow else steady[:, None])[0]
        found = dict.fromkeys(faults, np.inf)
        for name, steady in zip(faults, away.T, strict=True):
            length = float(np.linalg.norm(steady))
            others = [
                signatures[other] for other, gain in zip(faults, away.T, strict=True) if other != name and gain.any()
            ]
            near = max((float(np.linalg.norm(basis.T @ steady)) for basis in others), default=-length)
            half = float(np.sqrt(max(1 - near / length, 0.0) / 2)) if length > 0 else 0.0  # of the angle, its sine
            if half > np.sqrt(IDENTITY):
                found[name] = max(self.sizes[name], _MEASURED * _QUANTILE / (half * length))
        return found

    @property
    def settling(self) -> float:
        """Samples until a hundredth is left of a transient of the slowest pole."""
        slowest = float(np.abs(self.generator.system.poles()).max(initial=0.0))
        return float(np.ceil(np.log(_SETTLED) / np.log(slowest))) if slowest > 0 else 0.0

    def share(self, fault: str, size: float) -> float:
        """Return the share of 1,500 samples from its onset on in which a constant fault is in alarm."""
        from scipy.special import chndtr  # slow to import

        g = self.generator
        response = g.internal_form().select(inputs=[g.faults.index(fault)]).simulate(np.ones((_FOLLOWED, 1)))
        sums = np.cumsum(response, axis=0)
        sums[WINDOW:] -= sums[:-WINDOW].copy()
        alarm = np.zeros(_FOLLOWED)
        for residuals, whiten in self.whitening:
            d = np.linalg.norm(sums[:, residuals] @ whiten.T, axis=1) / np.sqrt(WINDOW)
            alarm = np.maximum(alarm, 1 - chndtr(self._limit(whiten), len(whiten), (size * d) ** 2))
        return float(alarm.mean())

    @cached_property
    def _settled(self) -> list[NDArray[np.float64]]:
        """Steady whitened sums of each part for faults of size one, (directions, faults)."""
        steady = self.generator.steady_directions
        gain = np.array([steady[name] for name in self.generator.faults]).reshape(len(steady), -1).T
        return [np.sqrt(WINDOW) * whiten @ gain[list(residuals)] for residuals, whiten in self.whitening]

    @cached_property
    def _of_parts(self) -> NDArray[np.float64]:
        """The size from which on each part sees each fault, shape (parts, faults)."""
        from scipy.special import chndtrinc  # slow to import

        found = np.full((len(self.whitening), len(self.generator.faults)), np.inf)
        for row, (_, whiten), away in zip(found, self.whitening, self._settled, strict=True):
            d = np.linalg.norm(away, axis=0)
            if len(whiten):
                needed = np.sqrt(chndtrinc(self._limit(whiten), len(whiten), 1 - SEEN))
                row[:] = np.where(d > 0, _MEASURED * needed / np.where(d > 0, d, 1.0), np.inf)
        return found

    def _limit(self, whiten: NDArray[np.float64]) -> float:
        from scipy.special import chdtri  # slow to import

        return float(chdtri(len(whiten), RATE / len(self.whitening)))


def lasting_faults(generator: ResidualGenerator, dt: float) -> LastingFaults:
    """Predict the detection of constant faults by a test on sums of 127 samples, in the noise of the plant.

    Parameters
    ----------
    generator : ResidualGenerator
    dt : float
        The step that a continuous one is sampled with, in seconds.

    Returns
    -------
    LastingFaults

    Raises
    ------
    DesignError
        If the residual has no stationary covariance.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.design.lasting_faults import lasting_faults
    >>> plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1).with_sensor_faults()
    >>> found = lasting_faults(rs.design.kalman_filter(plant.with_noise(process=0.1, measurement=0.2)), 1)
    >>> round(found.sizes["y1 sensor"], 2), round(found.share("y1 sensor", found.sizes["y1 sensor"]), 2)
    (1.75, 0.96)
    """
    sampled = generator if generator.system.is_discrete else generator.discretize(dt)
    S = sampled.covariance_of_sums(WINDOW)
    if S is None:
        raise DesignError("the residual has no stationary covariance")
    parts: Sequence[tuple[int, ...]] = [tuple(range(sampled.n_residuals))]
    if sampled.codes is not None:
        parts = [member.residuals for member in sampled.members]
    whitening = []
    for part in parts:  # S^(-1/2) over the directions that noise moves
        covariance = S[np.ix_(part, part)]
        units = np.sqrt(np.where(np.diag(covariance) > 0, np.diag(covariance), 1.0))
        values, vectors = np.linalg.eigh(covariance / np.outer(units, units))
        kept = values > RANK * values.max(initial=0.0)
        whitening.append((part, (vectors[:, kept] / np.sqrt(values[kept])).T / units))
    return LastingFaults(sampled, tuple(whitening))
