"""Thresholds that no member of an uncertain set exceeds while nothing fails: for any filter, by proof."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import index_of
from residua.design.banks.bank import Bank
from residua.design.core.evidence import AFFINE_FORM
from residua.design.core.generator import ResidualGenerator
from residua.errors import DesignError, ModelError, NoCertificateError, SettingError
from residua.linear import StateSpace, peak_norm
from residua.plant import Plant
from residua.robust.bounds.robust_peak_norm import RobustPeakNorm, robust_peak_norm
from residua.robust.sets.uncertain_loop import check_members_stable, loop_parameters, residual_over_set
from residua.robust.sets.uncertain_plant import UncertainPlant
from residua.shown import Shown

#: How close bounds are to what is attained: those that count, and those only reported, in so many parts of the set.
_COUNTS, _ONLY_TOLD = 1e-2, {"rtol": 0.1, "boxes": 8}
#: Parts that the set is cut into where a method has no answer before; a tolerance that any answer keeps to.
_BOXES, _ANY = 32, 1e300
#: Parts of what a residual would be without cancellation. Designs that decouple all disturbances left 1e-14 of it, for
#: plants with units 1e8 apart up to 6e-11, and searches 2e-9; thresholds that mean something are 1e-6 and more.
_DECOUPLED, _ROUNDED = 1e-8, 1e-13


@dataclass(frozen=True, eq=False, repr=False)
class CertifiedThreshold(Shown):
    r"""A bound of the residual of every member while disturbances and bounded faults keep to their sizes.

    .. math:: J_{th} = J_{rw} + \sum_k \kappa_k J_{rf_k}

    Attributes
    ----------
    value : float
        ``J_th``.
    disturbances : RobustPeakNorm
        ``J_rw``: all disturbances together, of length one at every sample. ``worst`` are parameters of the loop, for
        ``loop.member``.
    faults : mapping of str to RobustPeakNorm
        ``J_rf`` of other faults of size one, at any time course: what leaks into the residual. Of faults that are
        decoupled it is what rounding may leave.
    sizes : mapping of str to float
        ``kappa``: those of them that the threshold covers.
    notes : tuple of str
        What the proof leaves out; empty when there is nothing.
    """

    value: float
    disturbances: RobustPeakNorm
    faults: Mapping[str, RobustPeakNorm]
    sizes: Mapping[str, float]
    notes: tuple[str, ...] = ()

    @property
    def attained(self) -> float:
        """The largest residual of a visited member for the disturbances alone: that of ``disturbances.worst``."""
        return self.disturbances.attained

    @property
    def leakage(self) -> dict[str, float]:
        """Bound of the effect on the residual of a fault of size one that is not to be seen."""
        return {name: bound.bound for name, bound in self.faults.items()}

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        covered = "".join(f", {name} up to {size:g} covered" for name, size in self.sizes.items())
        text = f"threshold {self.value:.5g} (disturbances alone attain {self.attained:.5g}{covered})"
        return "\n".join([text, *(f"note: {note}" for note in self.notes)])

    def __repr__(self) -> str:
        leaks = ", ".join(f"{name} {bound:.3g}" for name, bound in self.leakage.items())
        ending = f", leakage: {leaks}" if leaks else ""
        return (
            f"CertifiedThreshold({self.value:.6g}, attained {self.attained:.6g}, {self.disturbances.method!r}{ending})"
        )


def left_out(loop: UncertainPlant) -> tuple[str, ...]:
    """Return what certificates of a loop do not cover."""
    out = []
    if loop.linearisation is not None and not loop.linearisation.exact:
        out.append(f"{AFFINE_FORM}: {loop.linearisation}")
    if loop.nominal.noises:
        out.append("white noise has no bound: the thresholds are for the disturbances alone")
    return tuple(out)


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
        Faults whose leakage is reported, besides those with a size.
    sizes : mapping of str to float, optional
        Largest sizes of faults that the threshold covers; those of different faults are reached at once.
    method : str, optional
        Of :func:`residua.linear.robust_peak_norm`; its default when omitted, within 1 per cent of what is attained
        if that is possible. What is only reported is known to 10 per cent. ``method`` is used for the whole
        set, and for parts of it where it has no answer for the whole.
    """
    plant = loop.nominal
    sized = {name: float(size) for name, size in (sizes or {}).items() if size}
    if not plant.disturbances and not sized:
        raise ModelError(
            "the loop has neither disturbances nor bounded faults: nothing but rounding would be under a threshold; "
            "give the plant its disturbances, with_disturbances(...)"
        )

    def bound(
        signals: tuple[str, ...], *, rtol: float = 0.0, atol: float = 0.0, boxes: int | None = None
    ) -> tuple[RobustPeakNorm, float]:
        """Bound the residual for some signals, no smaller than rounding; and return its size without cancellation."""
        system = residual_over_set(loop, residual_filter, state_map, signals=signals)
        scale = rounding_scale(plant, residual_filter, signals)
        # the user may want a method for what it proves of the whole: parameters that vary in time
        options = {"method": method, "boxes": 1} if method else {"method": boxes and "centred", "boxes": boxes}
        try:
            norm = robust_peak_norm(system, rtol=rtol, atol=max(atol, _DECOUPLED * scale), **options)
        except NoCertificateError:
            if not options["method"]:
                raise
            # where there is no answer for the set as it is asked for, the first for parts of it
            norm = robust_peak_norm(system, method=options["method"], boxes=_BOXES, atol=_ANY)
        worst = loop_parameters(loop, norm.worst)
        # signals may reach the outputs by way of the uncertainty only
        scale = max(scale, rounding_scale(loop.member(worst), residual_filter, signals))
        return replace(norm, worst=worst, bound=float(max(norm.bound, _ROUNDED * scale))), scale

    try:
        disturbance, scale = bound(plant.disturbances, rtol=_COUNTS)
        others, reached = {}, disturbance.attained > _DECOUPLED * scale
        for name in dict.fromkeys((*faults, *sized)) if reached or sized else ():
            # what leaks matters by what it adds to the threshold, and hardly if it is only reported
            close: dict[str, Any] = {"atol": _COUNTS * disturbance.bound / sized[name]} if name in sized else _ONLY_TOLD
            others[name], unit = bound((name,), **close)
            reached |= name in sized and others[name].attained > _DECOUPLED * unit
    except DesignError:
        check_members_stable(loop)  # that error names deviations from the nominal values
        raise
    if not reached:
        bounded = f" and the bounded faults ({', '.join(sized)})" if sized else ""
        why = (
            f"they cancel in it, and what is left of them, {disturbance.attained:.2g}, is rounding (their parts of it "
            f"are of the order of {scale:.2g}): they are decoupled from it, or it weighs outputs without disturbances "
            "too much; a threshold of that would mean false alarms"
        )
        raise DesignError(
            f"the disturbances{bounded} do not reach this residual: "
            f"{why if scale else 'they reach no output that it reads'}; give the measurements their bounded noise as "
            "disturbances, with_disturbances(..., output=...), or test the residual by a threshold that is fitted to "
            "data, residua.decide.NormThreshold()"
        )
    value = disturbance.bound + sum(size * others[name].bound for name, size in sized.items())
    return CertifiedThreshold(value, disturbance, others, sized, left_out(loop))


def check_uncertain(loop: object) -> None:
    """Raise unless it is an uncertain plant."""
    if not isinstance(loop, UncertainPlant):
        how = "UncertainPlant(plant, deltas=[...]), or UncertainPlant(plant) where nothing is uncertain"
        raise ModelError(f"the loop must be an UncertainPlant, got {type(loop).__name__}: make one by {how}")


def checked_sizes(loop: UncertainPlant, sizes: Mapping[str, float] | None) -> dict[str, float]:
    """Return the sizes that are not zero, by fault, in the order of the loop."""
    out = dict.fromkeys(loop.nominal.faults, 0.0)
    if not isinstance(sizes, Mapping | None):
        raise SettingError(f"sizes names faults: {{name: size}}, got {sizes!r}"[:200])
    for name, size in (sizes or {}).items():
        index_of(name, loop.nominal.faults, "fault")
        if not (isinstance(size, Real) and np.isfinite(size) and size >= 0):
            raise SettingError(f"the size of {name!r} must be a finite number, 0 or more, got {size!r}")
        out[name] = float(size)
    return {name: size for name, size in out.items() if size}


def certified_thresholds(
    generator: ResidualGenerator | Bank,
    loop: UncertainPlant,
    *,
    sizes: Mapping[str, float] | None = None,
    method: str | None = None,
) -> dict[str, CertifiedThreshold]:
    r"""Certify thresholds for the members of any residual generator of a closed loop.

    For each member, the smallest certified bound of :math:`|r(k)|_2` over the whole set, for disturbances of length
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
        By member; :class:`residua.decide.PeakThreshold` takes them as they are.

    Raises
    ------
    ModelError
        If the generator does not read the outputs of the loop, or nothing acts on it.
    DesignError
        If a member of the set is not stable, or there is no bound; if the disturbances do not reach a residual.

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
    >>> thresholds = rs.design.certified_thresholds(observer, loop)
    >>> [(name, round(one.value, 2), round(one.attained, 2)) for name, one in thresholds.items()]
    [('Luenberger observer', 0.22, 0.22)]
    """
    check_uncertain(loop)
    source = generator.generator if isinstance(generator, Bank) else generator
    chosen = checked_sizes(loop, sizes)
    if source.plant.inputs:
        raise ModelError(
            "this generator reads control inputs; a closed loop has none: design on loop.nominal, whose only signals "
            "are its outputs"
        )
    if source.plant.outputs != loop.nominal.outputs:
        raise ModelError(
            f"this generator reads the outputs {', '.join(source.plant.outputs)}, the loop has "
            f"{', '.join(loop.nominal.outputs)}: they must be the same, in the same order"
        )
    out = {}
    for member in source.members:
        others = [name for name in loop.nominal.faults if name not in member.faults]
        part, T = _part(source, list(member.residuals))
        sized = {name: size for name, size in chosen.items() if name in others}
        out[member.name] = certified_threshold(loop, part, T, faults=others, sizes=sized, method=method)
    return out


def _part(generator: ResidualGenerator, rows: list[int]) -> tuple[StateSpace, ArrayLike | None]:
    """Return the filter of some residuals without the states that do not reach them: those of other members."""
    part = generator.system.explicit().select(outputs=rows)
    reaching = np.any(part.C, axis=0)
    for _ in range(part.n_states):
        reaching = reaching | np.any(part.A[reaching], axis=0)
    kept = np.flatnonzero(reaching)
    T = None if generator.state_map is None else np.asarray(generator.state_map)[kept]
    return StateSpace(part.A[np.ix_(kept, kept)], part.B[kept], part.C[:, kept], part.D, dt=part.dt), T


def rounding_scale(plant: Plant, residual_filter: StateSpace, signals: Iterable[str]) -> float:
    """Return the size of the residual that each output of the loop would cause alone, for signals of unit size.

    The outputs are as large as the signals make them in this loop, the filter is as large as it answers to these.
    Estimators of which the signals are decoupled have a residual of 1e-15 to 1e-10 times that, for rounding.
    """
    flt = residual_filter.explicit()
    sizes = _sizes(plant.system(("disturbance", "fault")).select(inputs=list(signals)))
    if not np.any(sizes) or not flt.n_outputs:
        return 0.0
    return float(np.linalg.norm(_sizes(StateSpace(flt.A, flt.B * sizes, flt.C, flt.D * sizes, dt=flt.dt))))


def _sizes(system: StateSpace) -> NDArray[np.float64]:
    """Return about the largest value of every output."""
    direct = np.linalg.norm(system.D, axis=1)
    if not system.n_inputs or not np.any(system.B):
        return direct
    Q = peak_norm(system, kind="star").ellipsoid
    assert Q is not None  # "star" gives one
    return direct + np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", system.C, Q, system.C), 0.0))
