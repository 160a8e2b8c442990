"""One robust l1 estimator: cheap norms over a few members, the worst members added, and the proof last."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.errors import DesignError, NoCertificateError
from residua.linear import StateSpace
from residua.progress import Progress
from residua.robust.bounds.robust_peak_norm import worst_member
from residua.robust.bounds.smallest_gain import SmallestGain, smallest_gain
from residua.robust.estimators.certified_threshold import CertifiedThreshold, certified_threshold
from residua.robust.estimators.estimator_family import EstimatorFamily
from residua.robust.estimators.genetic_search import GeneticSearch, settings_of
from residua.robust.estimators.global_search import DifferentialEvolution, SearchResult
from residua.robust.estimators.sampled_cost import PENALTY, SampledCost, Weights, sampled_cost
from residua.robust.estimators.starting_gains import starting_gains
from residua.robust.sets.uncertain_loop import loop_parameters, residual_over_set
from residua.robust.sets.uncertain_plant import UncertainPlant

Matrix = NDArray[np.float64]
Search = DifferentialEvolution | GeneticSearch
#: How far the worst member may exceed those that the search has looked at before it is taken among them.
_MISSED = 1.002
_ROUNDS = 4
#: How much farther than the starting gains the search looks.
_REACH = 3.0


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
        """Bound of the effect of other faults of size one on the residual: zero in the nominal loop."""
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


@dataclass(frozen=True, eq=False)
class Task:
    """Options that all estimators of a bank have in common.

    ``radii`` are largest spectral radii, in the order in which they are tried until a threshold is certified.
    """

    loop: UncertainPlant
    sizes: Mapping[str, float]
    weights: Weights
    band: float
    radii: tuple[float, ...]
    search: Search
    method: str | None
    checkpoint: Path | None
    seed: int


def search_estimator(task: Task, family: EstimatorFamily, tell: Progress) -> tuple[RobustEstimator, str]:
    """Search one estimator, take the worst members among those looked at, and certify the result.

    Where no threshold is certified for one as slow as it may be, a faster one is searched; a note tells of that.
    """
    failure: NoCertificateError | None = None
    times: list[float] = []
    for radius in task.radii:
        try:
            cost, best, values = _sought(task, family, radius, tell)
        except DesignError:
            if failure is None:
                raise
            break  # none is as fast: what counts is why the slower ones have failed
        times.append(float(task.loop.nominal.dt * np.log(0.02) / np.log(radius)))  # seconds to settle to 2 per cent
        tell(f"{family.target}: certificate", 0, 1)
        try:
            estimator = _certified(task, cost, best, values)
        except NoCertificateError as error:
            failure = failure or error
            continue
        return estimator, "" if failure is None else (
            f"settles in {times[-1]:.3g} s: no threshold was certified for one that may take {times[0]:.3g} s, the "
            "default; settling= sets it"
        )
    raise NoCertificateError(
        f"no threshold for {family.target!r} was certified over the set, for estimators that settle within "
        f"{', '.join(f'{t:.3g}' for t in times)} s ({str(failure).partition(': ')[0]}): narrow the set, give a shorter "
        "or longer settling=, or decouple fewer faults (decouple=)"
    ) from failure


def _sought(
    task: Task, family: EstimatorFamily, radius: float, tell: Progress
) -> tuple[SampledCost, SearchResult, list[Matrix]]:
    """Search over few members, and again with those among them that are worse for the result."""
    bounded = {name: size for name, size in task.sizes.items() if name != family.target}

    def over(values: list[Matrix]) -> SampledCost:
        members = [task.loop.member(v) for v in values]
        return sampled_cost(family, members, task.weights, radius=radius, band=task.band, bounded=bounded)

    values = [task.loop.nominal_values, (task.loop.low + task.loop.high) / 2]
    points = np.array([family.point(Z, g) for Z in starting_gains(family, radius) for g in np.eye(family.rows)])
    cost = over(values)
    norms = cost.norms(points)
    if not np.isfinite(norms.disturbance).any():
        raise DesignError(
            f"no estimator for {family.target!r} that ignores {', '.join(family.decoupled) or 'nothing'} settles in "
            f"time: its slowest pole stays at {norms.radius.min():.6g} from the origin, allowed are {radius:.6g}; give "
            "a longer settling=, or decouple fewer faults (decouple=) and give the others a size (sizes=)"
        )
    costs = task.weights.cost(norms.disturbance, norms.fault)
    if not np.isfinite(costs).any():
        raise _blind(task, cost, points[int(np.nanargmin(norms.disturbance))], values)
    # what is worst for the best start is mostly worst for the best estimator too
    values += _worse_members(task, cost, points[int(np.nanargmin(costs))])
    norms = over(values).norms(points)
    costs = task.weights.cost(norms.disturbance, norms.fault)
    unit = float(np.min(costs[np.isfinite(costs)], initial=np.inf))
    for k in range(_ROUNDS):
        cost = replace(over(values), unit=unit if 0 < unit < np.inf else 1.0)
        best = _searched(task, cost, points, f"{k + 1}", tell)
        if best.cost >= PENALTY:
            raise _blind(task, cost, best.x, values)
        fresh = _worse_members(task, cost, best.x)
        if not fresh:
            break
        values += fresh
        points = np.vstack([points, best.x])
    return cost, best, values


def _blind(task: Task, cost: SampledCost, point: Matrix, values: list[Matrix]) -> DesignError:
    """Return why an estimator is of no use, the best of all as it is."""
    target, ignored = cost.family.target, ", ".join(cost.family.decoupled) or "nothing"
    for part, v in zip(cost.parts, values, strict=True):
        if not replace(cost, parts=(part,)).norms(point[None]).fault[0] > 0:
            named = ", ".join(f"{name} = {x:g}" for name, x in zip(task.loop.names, v, strict=True))
            return DesignError(
                f"no estimator was found that ignores {ignored} and sees {target!r} while it lasts in every member of "
                f"the set: its response is zero{f' at {named}' if named else ''}; narrow the set, decouple fewer "
                "faults (decouple=), or add a sensor"
            )
    return DesignError(
        f"no estimator was found that ignores {ignored}, sees {target!r} and settles in time: give a longer settling="
    )


def _searched(task: Task, cost: SampledCost, starts: Matrix, label: str, tell: Progress) -> SearchResult:
    """Search a box around the starting gains, and a larger one where the best lies at its rim."""
    family = cost.family
    count = family.order * family.rows
    half = np.full(family.size, _REACH)
    half[:count] = _REACH * max(float(np.abs(starts[:, :count]).max(initial=0.0)), 0.1)
    number = family.plant.faults.index(family.target) + 1
    for attempt in range(3):
        options = {}
        if task.checkpoint is not None:
            # what the starts cost tells one loop, its members and its weights from others
            whole = [settings_of(task.search), half.tolist(), starts.tolist(), cost(starts).tolist()]
            digest = sha256(json.dumps(whole).encode()).hexdigest()[:12]
            options["checkpoint"] = task.checkpoint / f"estimator-{number}-{label}-{attempt + 1}-{digest}.json"
        result = task.search.minimise(
            cost,
            -half,
            half,
            start=starts,
            progress=lambda done, total, best: tell(f"{family.target}: search, cost {best:.5g}", done, total),
            **options,
        )
        if result.cost >= PENALTY or np.abs(result.x[:count]).max(initial=0.0) < 0.99 * half[:count].max(initial=1.0):
            break
        starts = np.vstack([starts, result.x])
        half[:count] *= _REACH
    return result


def _worse_members(task: Task, cost: SampledCost, point: Matrix) -> list[Matrix]:
    """Return members that are worse for an estimator than those that its search has looked at."""
    one, T = cost.family.estimator(point)
    found = cost.norms(point[None])
    out = []
    if task.loop.nominal.disturbances:
        worst = worst_member(residual_over_set(task.loop, one, T), samples=64, seed=task.seed)
        if worst.attained > _MISSED * found.alone[0]:
            out.append(worst.values)
    answer = smallest_gain(residual_over_set(task.loop, one, T, signals=(cost.family.target,)), band=task.band)
    if answer.attained < found.fault[0] / _MISSED:
        out.append(answer.values)
    return [np.array(list(loop_parameters(task.loop, v).values())) for v in out]


def _certified(task: Task, cost: SampledCost, best: SearchResult, values: list[Matrix]) -> RobustEstimator:
    """Give the residual its size, and certify threshold and response."""
    found, target = cost.norms(best.x[None]), cost.family.target
    disturbance, fault = float(found.disturbance[0]), float(found.fault[0])
    scale = task.weights.scale(disturbance, fault)
    one, T = cost.family.estimator(best.x, scale)
    others = tuple(name for name in task.loop.nominal.faults if name != target)
    sizes = {name: size for name, size in task.sizes.items() if name != target}
    certificate = certified_threshold(task.loop, one, T, faults=others, sizes=sizes, method=task.method)
    response = smallest_gain(residual_over_set(task.loop, one, T, signals=(target,)), band=task.band)
    if not response.bound > 0:
        raise NoCertificateError(
            f"the response to {target!r} was not shown to be other than zero over the set (smallest found "
            f"{response.attained:.3g}): {response.note or 'narrow the set, or look at another band of frequencies'}"
        )
    return RobustEstimator(
        target,
        cost.family.decoupled,
        one,
        T,
        certificate,
        replace(response, values=loop_parameters(task.loop, response.values)),
        float(task.weights.cost(np.array(disturbance), np.array(fault))),
        best,
        tuple(dict(zip(task.loop.names, map(float, v), strict=True)) for v in values),
    )
