"""One robust l1 estimator: the search, its result, and what is certain about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.linear import StateSpace
from residua.robust.bounds import SmallestGain
from residua.robust.estimators.certified_threshold import CertifiedThreshold
from residua.robust.estimators.search_result import SearchResult

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RobustEstimator:
    r"""An estimator for one fault of an uncertain loop.

    .. math:: \hat x_{k+1} = A \hat x_k + W (y_k - C \hat x_k), \qquad r_k = P (y_k - C \hat x_k)

    Attributes
    ----------
    fault : str
        The target.
    decoupled : tuple of str
        Faults that do not reach the residual of the nominal loop.
    filter : StateSpace
        From the outputs of the loop to the residual, in units of its own.
    state_map : ndarray, shape (states of the filter, n)
        ``T``: what the filter estimates is ``T x``; the identity, unless faults of actuators are decoupled.
    certificate : CertifiedThreshold
        Over the whole set.
    sensitivity : SmallestGain
        Certified response to the target, the smallest over the set and the band of frequencies; ``values`` are
        parameters of the loop.
    cost : float
        Eq. (40), with the norms over the members that the search looked at.
    sampled_norm : float
        ``J_rw`` over these.
    search : SearchResult
        The search that it comes from.
    members : tuple of mapping
        The parameters of these members.
    """

    fault: str
    decoupled: tuple[str, ...]
    filter: StateSpace = field(repr=False)
    state_map: Matrix = field(repr=False)
    certificate: CertifiedThreshold
    sensitivity: SmallestGain
    cost: float
    sampled_norm: float
    search: SearchResult = field(repr=False)
    members: tuple[Mapping[str, float], ...] = field(repr=False)

    @property
    def gain(self) -> Matrix:
        """``W``, shape (states of the filter, outputs)."""
        return self.filter.B

    @property
    def projection(self) -> Matrix:
        """``P``, shape (1, outputs)."""
        return self.filter.D

    @property
    def threshold(self) -> float:
        """``J_th``: while the fault is absent and the assumptions hold, no member exceeds it."""
        return self.certificate.value

    @property
    def leakage(self) -> dict[str, float]:
        """What other faults of size one add to the residual at most: nothing in the nominal loop."""
        return self.certificate.leakage

    @property
    def smallest_fault(self) -> float:
        r"""The size from which a lasting fault is certain to be seen, whatever the disturbances.

        .. math:: \frac{2 J_{th}}{|T_{rf}| \cos(\omega_b \Delta t / 2)}

        Once the residual has settled, for a constant fault, and for a sinusoid of that amplitude at any frequency up
        to the band :math:`\omega_b`. The response of at least :math:`2 J_{th}` less a disturbance of at most
        :math:`J_{th}` reaches the threshold. The cosine is for what happens between samples: the phase of a sinusoid
        advances by :math:`\omega \Delta t` per sample, so that one of them lies within half of that of a crest, and
        no more is certain: of a wave of four samples in phase :math:`\pi/4` none is above 0.71 of the amplitude. At
        half the sample rate every sample may fall on a zero: infinite. One without a band.
        """
        return 2 * self.undisturbed_fault

    @property
    def undisturbed_fault(self) -> float:
        """The size from which it is seen where no disturbance acts: half of :attr:`smallest_fault`."""
        angle = self.sensitivity.band * self.filter.dt / 2
        if angle >= np.pi / 2 * (1 - 1e-9):
            return float("inf")
        return self.threshold / (self.sensitivity.bound * float(np.cos(angle)))

    def __str__(self) -> str:
        return (
            f"{self.fault}: threshold {self.threshold:.5g} (attained {self.certificate.attained:.5g}), "
            f"response at least {self.sensitivity.bound:.5g}, certain to be seen from {self.smallest_fault:.5g} on"
        )
