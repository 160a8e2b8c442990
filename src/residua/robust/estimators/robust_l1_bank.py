"""A bank of robust l1 estimators: one per fault of an uncertain loop, with thresholds that are proved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path

import numpy as np

from residua import arrays
from residua.design.banks.bank import Bank, Wanted, check_promise, stacked_members
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.errors import DesignError, ModelError, SettingError
from residua.linear.poles.spectrum import spectral_radius
from residua.progress import Progress, progress_of
from residua.robust.bounds.robust_peak_norm import check_method
from residua.robust.estimators.certified_threshold import check_uncertain, checked_sizes, left_out
from residua.robust.estimators.estimator_family import estimator_family
from residua.robust.estimators.genetic_search import GeneticSearch
from residua.robust.estimators.global_search import DifferentialEvolution
from residua.robust.estimators.robust_estimator import RobustEstimator, Search, Task, search_estimator
from residua.robust.estimators.sampled_cost import Weights
from residua.robust.sets.uncertain_loop import check_members_stable
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.tolerances import SAME

_METHOD = "robust l1 estimators"
_REFERENCE = "Robust l1 fault detection, eqs. (27)-(49)"
#: Samples that estimators may take to settle, however fast the loop is.
_LEAST_SETTLING = 50
#: Powers of the loop's own decay that are tried, one after the other, where no threshold is certified.
_POWERS = (1.0, 2.0, 4.0)


@dataclass(frozen=True, eq=False, repr=False)
class RobustL1Bank(Bank):
    """Robust estimators, one per fault, with thresholds that hold for every member of the set.

    A :class:`Bank`: it goes into a :class:`residua.Monitor`, which then takes the certified thresholds.

    Attributes
    ----------
    loop : UncertainPlant
        The closed loop that it is for.
    estimators : mapping of str to RobustEstimator
        By fault; the members of the bank have the names of their faults.
    """

    loop: UncertainPlant = field(repr=False)
    estimators: Mapping[str, RobustEstimator] = field(repr=False)

    @property
    def thresholds(self) -> dict[str, float]:
        """The certified threshold of every member."""
        return {name: one.threshold for name, one in self.estimators.items()}

    @property
    def member_bounds(self) -> dict[str, tuple[float, float, dict[str, float]]]:
        """For every member the bound of the effect of disturbances, the least response to its fault, and the leakage.

        The faults are of size one.
        """
        out = {}
        for name, one in self.estimators.items():
            leakage = {fault: float(bound) for fault, bound in one.certificate.leakage.items()}
            out[name] = float(one.certificate.disturbances.bound), float(one.sensitivity.bound), leakage
        return out

    @property
    def smallest_faults(self) -> dict[str, float]:
        """For every fault the size from which it is certain to be seen, once settled."""
        return {name: one.smallest_fault for name, one in self.estimators.items()}

    def __str__(self) -> str:
        lines = [super().__str__()] + [str(one) for one in self.estimators.values()]
        common = left_out(self.loop)  # which every member has in its notes
        notes = [note for note in self.generator.evidence.notes if not note.endswith(common)]
        lines += [f"note: {note}" for note in (*common, *notes)]
        for one in self.estimators.values():
            parts = []
            for fault, size in one.leakage.items():
                covered = one.certificate.sizes.get(fault)
                # what is rounding beside the threshold is nothing
                parts.append(f"{fault} {size if size > 1e-9 * one.threshold else 0.0:.3g}")
                parts[-1] += "" if covered is None else f" (covered to {covered:g})"
            if parts:
                lines.append(f"{one.fault}: of other faults a unit adds at most: {', '.join(parts)}")
        return "\n".join(lines)


@method(
    designs_for="uncertain plant",
    needs=["in closed loop", "sampled", "faults", "bounded disturbances"],
    exists_when="every member of the set stable; each fault apart from the others, lasting; a threshold certified",
    order="k n",
    source="Robust l1 fault detection, eqs. (20) to (49)",
    faults="by code: one estimator per fault; certain from a size on",
    many=True,
)
def robust_l1_bank(
    loop: UncertainPlant,
    faults: Iterable[str | int] | str | None = None,
    *,
    decouple: Iterable[str | int] | str | None = None,
    sizes: Mapping[str, float] | None = None,
    beta: float = 0.5,
    gamma: float = 1.0,
    band: float = 0.0,
    settling: float | None = None,
    search: Search | str | None = None,
    method: str | None = None,
    checkpoint: str | Path | None = None,
    progress: Progress | bool | None = None,
    seed: int = 0,
) -> RobustL1Bank:
    r"""Design one robust l1 estimator per fault of an uncertain closed loop, and certify its threshold.

    The estimator :math:`\hat x_{k+1} = A \hat x_k + W (y_k - C \hat x_k)`, :math:`r_k = P (y_k - C \hat x_k)` minimises

    .. math:: J = \beta J_{rw} + \frac{1 - \beta}{J_{rf}} + \gamma \frac{J_{rw}}{J_{rf}}

    over the gains with :math:`W R_{2k} = R_{1k}` and :math:`P R_{2k} = 0` for every other fault ``k``: in closed loop,
    where a sensor fault drives the controller too, these are the gains that it does not reach.
    :math:`J_{rw}` is the largest residual that disturbances of length one cause, :math:`J_{rf}` the smallest response
    to the fault, each over the set.

    Guaranteed, and checked after the search: no member of the set exceeds its threshold from rest while its fault is
    absent, no other fault is larger than its size in ``sizes`` and the disturbances keep to :math:`|w(k)|_2 \le 1`; a
    lasting fault of ``smallest_fault`` or more is above the threshold once the residual has settled, whatever
    disturbance acts.

    Parameters
    ----------
    loop : UncertainPlant
        In closed loop (:meth:`UncertainPlant.in_closed_loop`) or without control inputs; sampled, with disturbances
        scaled to a length of one together.
    faults : sequence of str, optional
        The targets; all faults of the loop when omitted.
    decouple : sequence of str, optional
        Faults that estimators of other faults are decoupled from; all when omitted.
    sizes : mapping of str to float, optional
        Largest sizes of faults that leak into the residuals of others, or are not decoupled: what they cause there
        counts with the disturbances, in the cost and in the thresholds. None: the leakage is only reported.
    beta, gamma : float
        Weights of the cost: ``0 <= beta <= 1``, ``gamma >= 0``.
    band : float
        Angular frequency in rad/s up to which faults are to be seen; 0 for constant and slowly drifting ones.
        With a band the residual answers faster, and the threshold is higher for it.
    settling : float, optional
        Seconds in which a residual settles to 2 per cent. When omitted, as long as the loop takes, and 50 samples at
        least; half of that, and a quarter, where no threshold is certified, as a note then tells. A monitor of the
        bank decides nothing for several times as long after a start or a gap; a longer time may lower thresholds.
    search : DifferentialEvolution or GeneticSearch or {"differential-evolution", "genetic"}, optional
        The former when omitted.
    method : str, optional
        Of the certificate, see :func:`residua.linear.robust_peak_norm`; its default when omitted.
    checkpoint : str or Path, optional
        A folder in which a genetic search leaves its state: the same design, started anew or with more generations,
        goes on from there. Another begins its own files.
    progress : callable or bool, optional
        Called with (what, done, of how many); ``True`` for a line on standard error, ``False`` for none. When omitted,
        the line where that is a terminal.
    seed : int
        Of the search, unless that is an object, and of the members that are drawn.

    Returns
    -------
    RobustL1Bank

    Raises
    ------
    ModelError
        If the loop has control inputs, no disturbances, or is continuous.
    DesignError
        If a fault cannot be told from the others, or is not seen while it lasts; if a member of the set is not stable;
        if no threshold is certified (a NoCertificateError).
    SettingError
        If an option makes no sense.

    See Also
    --------
    multi_model_parity : For a list of models.
    insensitive_parity : Takes the effect of parameters out as data arrive.
    structured_bank : For one plant.

    Notes
    -----
    Assumes
        Parameters that are constant in time and lie in the set; disturbances of at most unit length at every sample;
        rest at the start, or a start long ago. White noise of the plant has no bound and is left out.

    What is different from the paper, and why: the residual contains :math:`\Delta C x` and the fault itself, which
    eqs. (42) and (45) leave out; thresholds bound the whole loop over the set, where eqs. (46)-(48) hold for the
    nominal ``A - W C`` only; a parameter that stands in ``C`` acts once, not as two copies that are free of each other;
    :math:`J_{rf}` is bounded from below, for the paper's bound from above guarantees nothing (its footnote); other
    faults have declared sizes. ``A_e = A``, for with any other the state of the loop, which other faults drive through
    the controller, would reach the residual even of the nominal loop. One row in ``P`` is enough: the projection of
    several on the direction of the response to a lasting fault has the same response and no larger norm.

    The search looks at single members of the set, by their exact norms; where another turns out to be worse, it is
    taken among them and the search goes on. Of the cost only the ratio :math:`J_{rw} / J_{rf}` is left when the size of
    the residual is chosen best. It has a floor that no gain goes below, that of constant disturbances; many gains come
    near.

    References
    ----------
    Robust l1 fault detection, eqs. (20)-(49); Collins and Song (1999), Proc. American Control Conference.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import Perturbation, UncertainPlant
    >>> tank = rs.Plant([[0.9, 0.0], [0.05, 0.8]], [[], []], [[1, 0], [0, 1]], dt=1.0, outputs=["upper", "lower"])
    >>> tank = tank.with_disturbances([[0.1, 0], [0, 0.1]]).with_sensor_faults()
    >>> loop = UncertainPlant(tank, deltas=[Perturbation("A", [[0], [-1]], [[1, 0]], 0.0, 0.01, ["outflow"])])
    >>> bank = rs.design.robust_l1_bank(loop)
    >>> list(bank.thresholds)
    ['upper sensor', 'lower sensor']
    """
    check_uncertain(loop)
    plant = loop.nominal
    if plant.inputs:
        raise ModelError("the loop is open: loop.in_closed_loop(controller) closes it, and nothing is certain without")
    if not plant.is_discrete:
        raise ModelError("robust l1 estimators run on samples: loop.discretize(dt), before the loop is closed")
    if not plant.disturbances and not any((sizes or {}).values()):
        raise ModelError(
            "the loop has no disturbances to be robust against: with_disturbances(...), scaled to length one"
        )
    if not plant.faults:
        raise DesignError("the loop has no faults to look for: with_sensor_faults(), with_actuator_faults()")
    # one that is named twice is meant once
    targets = dict.fromkeys(plant.faults[i] for i in arrays.positions(faults, plant.faults, "fault"))
    if not targets:
        raise SettingError(f"faults= is empty: leave it out for all, or choose of {', '.join(plant.faults)}")
    check_method(method)
    if not (0 <= beta <= 1 and np.isfinite(gamma) and gamma >= 0):
        raise SettingError(f"beta must lie in [0, 1] and gamma be 0 or more, got {beta!r} and {gamma!r}")
    if gamma == 0 and beta in (0, 1):
        raise SettingError(
            "without gamma, beta must lie between 0 and 1: the least disturbance alone is had by a residual that is "
            "blind to the fault, the largest response alone by one that only disturbances fill"
        )
    if not (np.isfinite(band) and 0 <= band * plant.dt <= np.pi):
        raise SettingError(f"band must lie in [0, {np.pi / plant.dt:.6g}] rad/s, half the sample rate, got {band!r}")
    ignored = dict.fromkeys(plant.faults[i] for i in arrays.positions(decouple, plant.faults, "fault"))
    task = Task(
        loop,
        checked_sizes(loop, sizes),
        Weights(float(beta), float(gamma)),
        float(band),
        _radii(loop, settling),
        _search(search, seed),
        method,
        None if checkpoint is None else Path(checkpoint),
        seed,
    )
    families = [estimator_family(plant, one, tuple(name for name in ignored if name != one)) for one in targets]
    check_members_stable(loop)
    if task.checkpoint is not None:
        if not isinstance(task.search, GeneticSearch):
            raise SettingError("only a genetic search leaves its state: search='genetic' with checkpoint=")
        try:
            task.checkpoint.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SettingError(
                f"checkpoint= must be a folder, for several files, and {str(task.checkpoint)!r} is not or cannot be "
                f"made one: {error.strerror or error}"
            ) from error
    tell, close = progress_of(progress)
    parts, estimators = {}, {}
    try:
        for family in families:
            one, note = search_estimator(task, family, tell)
            parts[one.fault], estimators[one.fault] = _generator(loop, one, note), one
    finally:
        close()
    generator = stacked_members(parts, loop.nominal, _METHOD, _REFERENCE)
    assert generator.codes is not None  # stacked_members gives them
    return RobustL1Bank(generator, generator.codes, {}, {}, loop, estimators)


def _radii(loop: UncertainPlant, settling: float | None) -> tuple[float, ...]:
    """Return the spectral radii up to which estimators count; ever faster ones where that is left open."""
    radius = float(spectral_radius(loop.nominal.A))
    if not radius < 1:
        raise DesignError(f"the nominal loop is not stable (spectral radius {radius:.6g}): nothing is bounded in it")
    if settling is None:
        fastest = 0.02 ** (1 / _LEAST_SETTLING)
        return tuple(dict.fromkeys(max(radius**power, fastest) for power in _POWERS))
    if not (isinstance(settling, Real) and np.isfinite(settling) and settling > 0):
        raise SettingError(f"settling must be a positive time in seconds, got {settling!r}")
    if settling < loop.nominal.dt * (1 - SAME):
        raise SettingError(
            f"settling = {settling:g} s is shorter than one sample, {loop.nominal.dt:g} s: no filter is that fast; "
            "give a few samples at least"
        )
    return (float(0.02 ** (loop.nominal.dt / settling)),)


def _search(search: Search | str | None, seed: int) -> Search:
    if isinstance(search, (DifferentialEvolution, GeneticSearch)):
        return search
    if search not in (None, "differential-evolution", "genetic"):
        raise SettingError(f"search must be 'differential-evolution', 'genetic' or an object of these, got {search!r}")
    return GeneticSearch(seed=seed) if search == "genetic" else DifferentialEvolution(seed=seed)


def _generator(loop: UncertainPlant, one: RobustEstimator, note: str) -> ResidualGenerator:
    """Return one estimator as a residual generator of the nominal loop, after checking that it ignores the others."""
    poles = one.filter.poles()
    evidence = Evidence(
        method=_METHOD,
        poles=poles,
        conditions={
            "threshold over what is attained": one.certificate.disturbances.ratio,
            "certified response over the smallest found": one.sensitivity.ratio,
            "cost": one.cost,
        },
        notes=(*filter(None, (note, one.certificate.disturbances.note, one.sensitivity.note)), *left_out(loop)),
        references=(_REFERENCE,),
    )
    promise = Decoupled(disturbances=False)  # the certificate bounds what they do
    generator = make_generator(one.filter, loop.nominal, _METHOD, evidence, decouples=promise, state_map=one.state_map)
    check_promise(generator, Wanted(one.fault, one.decoupled, (one.fault,)))
    return generator
