"""Thresholds that no member of an uncertain set exceeds while nothing fails: for any filter, by proof."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from residua.design.banks.bank import Bank
from residua.design.generator import ResidualGenerator
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.linear import StateSpace, UncertainSystem, lmi
from residua.linear.arrays import index_of
from residua.linear.robust_norm import RobustPeakNorm, robust_peak_norm
from residua.plant import UncertainPlant
from residua.plant.uncertain_loop import residual_over_set

#: A bound this close to what is attained is not worth cutting the set, or this close not the matrix inequalities.
_CLOSE, _NOT_FAR = 1.02, 1.1
#: Parts that the set is cut into where one is not close.
_BOXES = (1, 8, 32)
#: States and twice the channels up to which these take minutes at most.
_PRACTICAL = 50


@dataclass(frozen=True, eq=False)
class CertifiedThreshold:
    r"""What the residual of no member exceeds while disturbances and bounded faults keep to their sizes.

    .. math:: J_{th} = J_{rw} + \sum_k \kappa_k J_{rf_k}

    Attributes
    ----------
    value : float
        ``J_th``.
    disturbances : RobustPeakNorm
        ``J_rw``: all disturbances together, of length one at every sample.
    faults : mapping of str to RobustPeakNorm
        ``J_rf`` of other faults of size one, at any time course: what leaks into the residual.
    sizes : mapping of str to float
        ``kappa``: those of them that the threshold covers.
    """

    value: float
    disturbances: RobustPeakNorm
    faults: Mapping[str, RobustPeakNorm] = field(repr=False)
    sizes: Mapping[str, float]

    @property
    def attained(self) -> float:
        """The largest residual that was found for the disturbances alone: of the member ``disturbances.worst``."""
        return self.disturbances.attained

    @property
    def leakage(self) -> dict[str, float]:
        """Bound of what a fault of size one that is not to be seen adds to the residual."""
        return {name: found.bound for name, found in self.faults.items()}

    def __float__(self) -> float:
        return self.value


def certified_threshold(
    loop: UncertainPlant,
    residual_filter: StateSpace,
    state_map: ArrayLike | None = None,
    *,
    faults: Iterable[str] = (),
    sizes: Mapping[str, float] | None = None,
    method: str | None = None,
) -> CertifiedThreshold:
    """Return the threshold of one residual (or of the length of several together) over the whole set.

    Parameters
    ----------
    loop : UncertainPlant
        In closed loop.
    residual_filter : StateSpace
        From the outputs of the loop to the residual.
    state_map : array_like, optional
        ``T`` with ``xi = T x`` while nothing happens to the nominal loop.
    faults : sequence of str
        Faults whose leakage is told, those with a size besides.
    sizes : mapping of str to float, optional
        Largest sizes of faults that the threshold covers; those of different faults are reached at once.
    method : str, optional
        Of :func:`residua.linear.robust_peak_norm`. When omitted ``"centred"``; where that leaves more than 2 per cent
        to what is attained, of a set cut into parts; where 10 per cent are left then, ``"lifted"``, if the extra
        ``lmi`` is there and the system is not too large. The smallest counts. For what is only told, less.
    """
    sized = {name: float(size) for name, size in (sizes or {}).items() if size}
    if not loop.nominal.disturbances and not sized:
        raise ModelError(
            "the loop has neither disturbances nor bounded faults: nothing but rounding would be under a threshold; "
            "give the plant its disturbances, with_disturbances(...)"
        )

    def system(signals: tuple[str, ...]) -> UncertainSystem:
        return residual_over_set(loop, residual_filter, state_map, signals=signals)

    own = _bound(
        system(loop.nominal.disturbances), method, lambda found: found.ratio <= _CLOSE, matrix_inequalities=True
    )
    # what the filter weighs signals with: a bound far below is rounding of what cancels, and no threshold
    J, plant = residual_filter.D, loop.nominal
    weighed = float(np.linalg.norm(J) * (np.linalg.norm(plant.Dd) + np.linalg.norm(plant.Bd)))
    if not sized and own.bound <= 1e-12 * max(weighed, float(np.linalg.norm(J))):
        raise DesignError(
            f"the disturbances do not reach this residual (bound {own.bound:.2g}, rounding): a threshold would mean "
            "nothing; give it one for the noise of the measurements, NormThreshold() fitted to data"
        )
    others = {}
    for name in dict.fromkeys((*faults, *sized)):
        # what leaks matters by what it adds to the threshold, and hardly where it is only told
        room = 0.02 * own.bound / sized[name] if name in sized else np.inf
        others[name] = _bound(
            system((name,)), method, lambda found, room=room: found.bound - found.attained <= room and found.ratio <= 3
        )
    value = own.bound + sum(size * others[name].bound for name, size in sized.items())
    return CertifiedThreshold(value, own, others, sized)


def _bound(
    system: UncertainSystem,
    method: str | None,
    close: Callable[[RobustPeakNorm], bool],
    *,
    matrix_inequalities: bool = False,
) -> RobustPeakNorm:
    """Return the smallest of ever dearer bounds, until one is close to what is attained."""
    attempts: list[dict[str, Any]] = [{"method": method or "centred", "boxes": boxes} for boxes in _BOXES]
    if (
        method is None
        and matrix_inequalities
        and lmi.has_solver()
        and system.n_states + 2 * len(system.channels) <= _PRACTICAL
    ):
        attempts.append({"method": "lifted"})
    best: RobustPeakNorm | None = None
    failure: DesignError | AccuracyError | None = None
    for options in attempts:
        if best is not None and (method or (options["method"] == "lifted" and best.ratio <= _NOT_FAR)):
            break  # what was asked for is cut into parts only where it has no answer for the whole
        try:
            found = robust_peak_norm(system, **options)
        except (DesignError, AccuracyError) as error:
            failure = failure or error
            continue
        best = found if best is None or found.bound < best.bound else best
        if close(best):
            break
    if best is None:
        assert failure is not None  # no attempt has ended otherwise
        raise failure
    return best


def checked_sizes(loop: UncertainPlant, sizes: Mapping[str, float] | None) -> dict[str, float]:
    """Return sizes by fault, zero where none is given."""
    out = dict.fromkeys(loop.nominal.faults, 0.0)
    for name, size in (sizes or {}).items():
        index_of(name, loop.nominal.faults, "fault")
        if not (np.isfinite(size) and size >= 0):
            raise SettingError(f"the size of {name!r} must be a finite number, 0 or more, got {size!r}")
        out[name] = float(size)
    return out


def certified_thresholds(
    generator: ResidualGenerator | Bank,
    loop: UncertainPlant,
    *,
    sizes: Mapping[str, float] | None = None,
    method: str | None = None,
) -> dict[str, CertifiedThreshold]:
    r"""Certify thresholds for the members of any residual generator of a closed loop.

    For each member the smallest bound that is found of :math:`|r(k)|_2` over the whole set, for disturbances of length
    at most one at every sample, from rest. Guaranteed: while nothing fails, no member of the set exceeds its threshold.

    Parameters
    ----------
    generator : ResidualGenerator or Bank
        Designed on ``loop.nominal``, or any generator that reads its outputs.
    loop : UncertainPlant
        In closed loop.
    sizes : mapping of str to float, optional
        Sizes up to which faults that a member is not to see may leak into it: their bounds are added.
    method : str, optional
        See :func:`residua.linear.robust_peak_norm`.

    Returns
    -------
    dict of str to CertifiedThreshold
        By member; for :class:`residua.decide.PeakThreshold` take ``{name: float(t) for name, t in ...items()}``.

    Raises
    ------
    ModelError
        If the generator does not read the outputs of the loop, or nothing acts on it.
    DesignError
        If a member of the set is not stable, or no bound is found.

    References
    ----------
    Robust l1 fault detection, eqs. (41)-(48), which hold for the nominal plant only.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import Perturbation, UncertainPlant
    >>> tank = rs.Plant([[0.9]], [[]], [[1.0]], dt=1.0, outputs=["level"])
    >>> tank = tank.with_disturbances([[0.1]]).with_sensor_faults()
    >>> loop = UncertainPlant(tank, deltas=[Perturbation("A", [[-1.0]], [[1.0]], -0.02, 0.01)])
    >>> observer = rs.design.luenberger_observer(tank, poles=[0.5]).residual_generator()
    >>> found = rs.design.certified_thresholds(observer, loop)
    >>> [(name, round(one.value, 3), round(one.attained, 3)) for name, one in found.items()]
    [('Luenberger observer', 0.225, 0.222)]
    """
    made = generator.generator if isinstance(generator, Bank) else generator
    chosen = checked_sizes(loop, sizes)
    if made.plant.inputs:
        raise ModelError(
            "this generator reads control inputs; a closed loop has none: design on loop.nominal, whose only signals "
            "are its outputs"
        )
    if made.plant.outputs != loop.nominal.outputs:
        raise ModelError(
            f"this generator reads the outputs {', '.join(made.plant.outputs)}, the loop has "
            f"{', '.join(loop.nominal.outputs)}: they must be the same, in the same order"
        )
    out = {}
    for member in made.members:
        rows = list(member.residuals)
        others = [name for name in loop.nominal.faults if name not in member.faults]
        part = made.system.select(outputs=rows)
        sized = {name: chosen[name] for name in others if chosen[name]}
        out[member.name] = certified_threshold(loop, part, made.state_map, faults=others, sizes=sized, method=method)
    return out
