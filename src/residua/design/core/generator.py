"""The residual generator, the result of every design, and the protocols of designs that have or make one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, SupportsFloat, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.balanced_filter import BalancedFilter, state_map_of
from residua.design.core.decoupling import Approximate, Decoupled, Promise, reached
from residua.design.core.evidence import Evidence, format_pole, of_sampling
from residua.design.core.internal_form import (
    covariance_of_sums,
    frequency_grid,
    internal_form,
    refuse_growth,
    sampled_form,
    with_silent_inputs,
)
from residua.design.core.signals import discretized_filter, run_signals, sampled_filter
from residua.design.core.signatures import responses_of_filter, responses_of_form, signatures_of, steady_responses
from residua.errors import AccuracyError, ModelError
from residua.linear import StateSpace, decide_rank
from residua.plant import Plant
from residua.progress import check_time
from residua.tolerances import LEAK

if TYPE_CHECKING:
    from residua.design.observers.observer import Observer
    from residua.design.parity.equivalence import Equivalence
    from residua.design.parity.relations import ParityRelations, Poles


@dataclass(frozen=True)
class Member:
    """A part of a generator that was designed on its own: its residual numbers and the faults it is for."""

    name: str
    residuals: tuple[int, ...]
    faults: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ResidualGenerator:
    r"""A stable linear filter from inputs and outputs of a plant to residuals.

    .. math:: r = Q(s) \begin{bmatrix} u \\ y \end{bmatrix}

    Guaranteed (and checked when it was designed): for the fault-free plant ``r`` decays to zero for any
    control input and any disturbance that was decoupled.

    Attributes
    ----------
    system : StateSpace
        Inputs are the plant's control inputs, then its outputs; outputs are the residuals. Signals are
        deviations from the plant's operating point.
    plant : Plant
        What it was designed for.
    method : str
        The design, in words.
    evidence : Evidence
        What the design proves about itself.
    subspaces : dict of str to ndarray, shape (residuals, k)
        For each fault an orthonormal basis of the smallest subspace that the residual never leaves,
        whatever the time course of that fault (Chen, Patton and Zhang 1996, Definitions 5 and 6; the part that it
        can reach).
        When it is the whole residual space, the fault's residual has no fixed direction.
    observer : Observer or None
        The observer that it is made of, where there is one.
    members : tuple of Member
        The filters that it is stacked from.
    state_map : ndarray or None, shape (states of the filter, states of the plant)
        ``T`` with ``xi = T E x`` while nothing fails; ``None`` for a filter that only approximates one, such as
        a sampled continuous design, or whose states are filtered signals.
    static_map : ndarray or None, shape (residuals, states of the plant)
        ``V`` with ``V E = 0``: the algebraic equations of a singular plant that the residual reads.
    known_form : StateSpace or None
        The internal form of a filter that has no state map, or of a sampled one that had one before.
    codes : ndarray of bool or None, shape (members, faults)
        For a bank: which of its members each fault fires, as its structure promises.
    estimated : tuple of str
        For an estimator: the fault that each residual estimates, in its own units (``""`` for one that estimates
        none); empty otherwise.
    relations : ParityRelations or None
        The polynomials that it was made from; :meth:`to_parity` finds those of any other generator.
    steady : mapping of str to ndarray, or None
        Steady responses where they are known from elsewhere: sampling a continuous design keeps them.

    References
    ----------
    Gertler (1991), section 3.5; Chen, Patton and Zhang (1996), section 3.
    """

    system: StateSpace
    plant: Plant
    method: str
    evidence: Evidence
    subspaces: Mapping[str, NDArray[np.float64]] = field(repr=False)
    observer: Observer | None = field(default=None, repr=False)
    members: tuple[Member, ...] = ()
    state_map: NDArray[np.float64] | None = field(default=None, repr=False)
    static_map: NDArray[np.float64] | None = field(default=None, repr=False)
    known_form: StateSpace | None = field(default=None, repr=False)
    codes: NDArray[np.bool_] | None = field(default=None, repr=False)
    estimated: tuple[str, ...] = ()
    relations: ParityRelations | None = field(default=None, repr=False)
    steady: Mapping[str, NDArray[np.float64]] | None = field(default=None, repr=False)

    # ------------------------------------------------------------------- facts

    @property
    def dt(self) -> float:
        """0 for a continuous generator, otherwise its sample step in seconds."""
        return self.system.dt

    @property
    def residuals(self) -> tuple[str, ...]:
        """Names of the residuals."""
        return self.system.outputs

    @property
    def n_residuals(self) -> int:
        """Number of residuals."""
        return self.system.n_outputs

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the plant's faults."""
        return self.plant.faults

    @cached_property
    def directions(self) -> dict[str, NDArray[np.float64]]:
        """The faults whose residual keeps one direction, with that direction (unit length)."""
        return {name: basis[:, 0] for name, basis in self.subspaces.items() if basis.shape[1] == 1}

    @cached_property
    def steady_directions(self) -> dict[str, NDArray[np.float64]]:
        """For each fault the residual that a constant fault of size one settles to; not normalised.

        A zero vector means that a constant fault is not seen (it is not strongly detectable). Residuals that do not
        answer to a fault at all stay exactly zero.
        """
        if self.steady is not None:
            return {name: vector.copy() for name, vector in self.steady.items()}
        gain = steady_responses(self.internal_form().select(inputs=range(len(self.faults))))
        return {name: np.where(self.structure[:, i], gain[:, i], 0.0) for i, name in enumerate(self.faults)}

    @cached_property
    def residual_rank(self) -> int:
        """Number of independent directions in which faults and noise can move the residual.

        Less than the number of residuals where decoupling disturbances made some of them copies of others: a
        signature of this dimension says nothing.
        """
        form = self._internal_form
        skip = range(len(self.faults), len(self.faults) + len(self.plant.disturbances))
        columns = [i for i in range(form.n_inputs) if i not in skip]
        scaled = form.select(inputs=columns).frequency_response(frequency_grid(form))
        for axes in ((0, 1), (0, 2)):  # each input, then each output, in units of its own
            units = np.abs(scaled).max(axis=axes, keepdims=True, initial=0.0)
            scaled = scaled / np.where(units > 0, units, 1.0)
        flat = scaled.transpose(1, 0, 2).reshape(form.n_outputs, -1)
        return decide_rank(np.hstack([flat.real, flat.imag]), rtol=1e-6).rank

    @cached_property
    def structure(self) -> NDArray[np.bool_]:
        """Marks of the residuals that answer to each fault: boolean, shape (residuals, faults)."""
        rows = [np.any(self.subspaces[name], axis=1) for name in self.faults]
        return np.array(rows, dtype=bool).reshape(len(self.faults), self.n_residuals).T

    @cached_property
    def covariance(self) -> NDArray[np.float64] | None:
        """Stationary covariance of the fault-free residual, from the plant's noise.

        ``None`` when the plant has no noise, or is continuous (white measurement noise has no finite
        variance there: sample the generator first), or the residual has no stationary covariance, as with a
        sampled continuous design on an unstable plant, or one with three integrators in a row before an output: noise
        then bends what the filter takes to run straight from sample to sample, more and more.
        """
        return self.covariance_of_sums(1)

    def covariance_of_sums(self, window: int) -> NDArray[np.float64] | None:
        r"""Return the covariance of the residual summed over ``window`` samples, divided by ``window``.

        :math:`R_0 + \sum_{k=1}^{N-1} (1 - k/N) (R_k + R_k^T)` with the autocovariances
        :math:`R_0 = C X C^T + D D^T`, :math:`R_k = C A^{k-1} (A X C^T + B D^T)`. For white residuals, such as
        Kalman innovations, it does not depend on the window.

        Parameters
        ----------
        window : int

        Returns
        -------
        ndarray, shape (residuals, residuals), or None
            ``None`` under the conditions of :attr:`covariance`.
        """
        if not self.system.is_discrete or self.plant.Bw.shape[1] == 0 or not self._internal_form.is_stable():
            return None
        noise = range(len(self.faults) + len(self.plant.disturbances), self._internal_form.n_inputs)
        return covariance_of_sums(self._internal_form.select(inputs=noise), window)

    # ----------------------------------------------------------------- results

    def internal_form(self, plant: Plant | None = None, *, controls: bool = False) -> StateSpace:
        """Return the system from faults, disturbances and noise to the residual.

        Parameters
        ----------
        plant : Plant, optional
            The plant to look at; the one it was designed for when omitted. With another plant the result
            shows what the residual does there.
        controls : bool
            Whether the control inputs are further columns, at the end: zero for the plant that the
            generator was designed for, not for another.

        Returns
        -------
        StateSpace
            Inputs are the faults, disturbances and noise of the plant. The states that the residual does
            not see are removed, so that an unstable plant is no obstacle.
        """
        same = plant is None or plant is self.plant
        if same and not controls:
            return self._internal_form
        plant = self.plant if plant is None else plant
        leaks = [self.evidence.decoupling.get(name, 0.0) for name in ("control", *of_sampling({"control": 0.0}))]
        if same and self.known_form is not None and max(leaks) < LEAK:
            return with_silent_inputs(self.known_form, plant.inputs)
        maps = (self.state_map, self.static_map) if same else (None, None)
        return internal_form(self.system, plant, *maps, with_controls=controls)

    @cached_property
    def _internal_form(self) -> StateSpace:
        if self.known_form is not None:
            return self.known_form
        return internal_form(self.system, self.plant, self.state_map, self.static_map)

    def run(
        self,
        u: ArrayLike | None,
        y: ArrayLike,
        *,
        x0: ArrayLike | None = None,
        dt: float | None = None,
    ) -> NDArray[np.float64]:
        """Run the filter over recorded deviations from the operating point.

        Parameters
        ----------
        u : array_like, shape (time, inputs) or (plants, time, inputs), or None
            Control inputs; ``None`` for a plant without any.
        y : array_like, shape (time, outputs) or (plants, time, outputs)
        x0 : array_like, shape (states of the filter,), optional
            Initial state of the filter; zero when omitted.
        dt : float, optional
            Step of the recording in seconds; needed when the generator is continuous, which is then
            sampled with it.

        Returns
        -------
        ndarray, shape (time, residuals) or (plants, time, residuals)
        """
        return run_signals(sampled_filter(self.system, self.plant, dt), self.plant, u, y, x0)

    def discretize(self, dt: float, *, hold_outputs: str = "linear") -> ResidualGenerator:
        """Return the generator sampled with step ``dt``.

        Control inputs are held between samples (exact when the plant's actuators hold them). Outputs are
        taken to run linearly between samples, which costs a small leakage of control inputs and
        disturbances into the residual, of second order in ``dt``; the evidence states it. For an exactly
        zero residual design on ``plant.discretize(dt)`` instead.

        Parameters
        ----------
        dt : float
            Step in seconds.
        hold_outputs : {"linear", "zero"}
            What measured outputs are assumed to do between samples.

        Returns
        -------
        ResidualGenerator

        Raises
        ------
        AccuracyError
            If an unstable plant grows so much from one sample to the next (more than :math:`10^8`) that its digits hide
            the residual.
        """
        system = discretized_filter(self.system, self.plant, dt, hold_outputs)
        plant = self.plant.discretize(dt)
        refuse_growth(plant)
        known = None
        if self.state_map is not None and plant.n_states == self.plant.n_states:
            known = sampled_form(self.system, self.state_map, self.plant, system, plant, hold_outputs)
        cost = of_sampling(reached(system, plant, None))
        note = (
            f"sampled at {system.dt:g} s: inputs held, outputs {hold_outputs} between samples; "
            "the gains marked 'sampled' are what that costs"
        )
        evidence = self.evidence.extended(
            decoupling=cost,
            notes=(note,),
            poles=system.poles(),
            requested_poles=np.exp(self.evidence.requested_poles * system.dt),
            fixed_poles=np.exp(self.evidence.fixed_poles * system.dt),
        )
        return replace(
            self,
            system=system,
            plant=plant,
            evidence=evidence,
            state_map=None,
            static_map=None,
            relations=None,
            known_form=known,  # noise of the sampled plant is not that of the continuous one, held between samples
            steady=self.steady_directions,
        )

    def to_parity(self) -> ParityRelations:
        r"""Return the parity relations behind the residuals: the same equations without poles.

        Each residual is :math:`r = r^* c(z) / d(z)` with a relation :math:`r^*` that is polynomial in inputs and
        outputs; a factor ``c`` that all signals share is divided out, and reported in ``divided``.

        Returns
        -------
        ParityRelations

        Raises
        ------
        AccuracyError
            If a residual is no exact relation, such as that of a sampled continuous design, or the polynomials lose
            too many digits.
        DesignError
            If the plant has an ``E`` and the generator no state map.

        References
        ----------
        Gertler (1991), eqs. (3-18) to (3-23).

        Examples
        --------
        >>> import residua as rs
        >>> flt = rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1", poles=[0.25, 0.3])
        >>> flt.to_parity().orders
        (2,)
        """
        from residua.design.parity.conversion import to_parity

        return to_parity(self)

    def with_poles(self, poles: Poles | None = None) -> ResidualGenerator:
        """Return the generator of the same relations with other poles; see :meth:`ParityRelations.with_poles`.

        Parameters
        ----------
        poles : sequence of complex, or mapping of str to sequence, optional
            As many as the order of each relation; all zero in sampled time when omitted (the moving-average form).

        Returns
        -------
        ResidualGenerator

        Raises
        ------
        DesignError
            If the poles do not fit.
        AccuracyError
            As for :meth:`to_parity`.

        References
        ----------
        Gertler (1991), section 3.5.
        """
        generator = self.to_parity().with_poles(poles)
        old = self.evidence
        evidence = generator.evidence.extended(
            ranks=dict(old.ranks), references=tuple({*generator.evidence.references, *old.references})
        )
        kept = [note for note in old.notes if self.relations is not None and "digits" not in note]
        evidence = replace(evidence, notes=tuple(dict.fromkeys([*kept, *generator.evidence.notes])))
        return replace(generator, method=self.method, evidence=evidence, codes=self.codes, members=self.members)

    def equivalent_to(self, other: ResidualGenerator) -> Equivalence:
        """Compare with another generator: the same up to poles and scale, or another transformation.

        Parameters
        ----------
        other : ResidualGenerator
            Of a plant with as many inputs and outputs, and of the same step.

        Returns
        -------
        Equivalence
            True when equivalent; prints the transformation from this generator to the other.

        Raises
        ------
        ModelError
            If the two take different signals.

        References
        ----------
        Gertler (1991), section 3.5: every residual generator is a transformation of the primary residuals.

        Examples
        --------
        >>> import residua as rs
        >>> plant = rs.library.gertler()
        >>> a = rs.design.decoupled_residual(plant, insensitive_to="p1", poles=[0.25, 0.3])
        >>> b = rs.design.parity_relations(plant, insensitive_to="p1")
        >>> print(b.equivalent_to(a))
        equivalent: the same up to poles and scale (to ...)
          r1 = ... x zeros at 0, 0 / poles at 0.25, 0.3 of r1
        """
        from residua.design.parity.equivalence import equivalence

        return equivalence(self, other)

    def __repr__(self) -> str:
        kind = f"dt={self.dt:g} s" if self.system.is_discrete else "continuous"
        return (
            f"ResidualGenerator({self.method}: {self.n_residuals} residuals, {self.system.n_states} states, "
            f"{len(self.faults)} faults, {kind})"
        )


def make_generator(
    system: StateSpace,
    plant: Plant,
    method: str,
    evidence: Evidence,
    *,
    decouples: Promise,
    state_map: NDArray[np.float64] | None = None,
    static_map: NDArray[np.float64] | None = None,
    known_form: StateSpace | None = None,
    observer: Observer | None = None,
    members: tuple[Member, ...] = (),
    codes: NDArray[np.bool_] | None = None,
    estimated: tuple[str, ...] = (),
    relations: ParityRelations | None = None,
) -> ResidualGenerator:
    """Return a generator with its signatures, after checking that it is stable, decoupled, and its identities hold.

    Every design passes here, and no other place makes a generator of a filter. ``decouples`` says what must not reach
    the residual, which is measured here, or which entry of the evidence says how far it does. The state map of an exact
    design is found where it is not given. An approximate filter, such as a sampled continuous one, has none; its
    internal form is ``known_form`` where it is known.
    """
    check_time()
    if not system.is_stable():
        raise AccuracyError(f"the filter is not stable: poles {', '.join(map(format_pole, system.poles()))}")
    if state_map is None and isinstance(decouples, Decoupled):
        system, state_map, static_map = state_map_of(system, plant)
    entries = {"", *evidence.conditions, *evidence.decoupling}
    if isinstance(decouples, Approximate) and decouples.entry not in entries:
        raise TypeError(f"an approximate design must say how far inputs reach its residual: no {decouples.entry!r}")
    f = None if state_map is None else BalancedFilter.of(system, plant, state_map, static_map)
    leaks, measured = decouples.leaks(f)
    if f is not None:
        responses = responses_of_filter(f)
    else:
        form = internal_form(system, plant) if known_form is None else known_form
        responses = responses_of_form(form, len(plant.faults))
    if isinstance(decouples, Decoupled):  # what is left of the faults that are ignored has passed the check
        responses.values[:, :, [plant.faults.index(name) for name in decouples.faults]] = 0.0
    if codes is not None:  # and so have those that a member ignores
        for member, code in zip(members, codes, strict=True):
            responses.values[:, [[i] for i in member.residuals], np.flatnonzero(~code)] = 0.0
    bases, off = signatures_of(responses, plant.faults)
    conditions = {"response off the signatures": off} if plant.faults else {}
    if not members:
        members = (Member(method, tuple(range(system.n_outputs)), plant.faults),)
    return ResidualGenerator(
        system,
        plant,
        method,
        evidence.extended(decoupling=leaks, conditions=measured | conditions),
        bases,
        observer=observer,
        members=members,
        state_map=state_map,
        static_map=static_map,
        known_form=known_form,
        codes=codes,
        estimated=estimated,
        relations=relations,
    )


@runtime_checkable
class Design(Protocol):
    """A design that is no generator itself, such as a bank or an estimator: it has one."""

    @property
    def generator(self) -> ResidualGenerator:
        """The generator that runs."""
        ...


@runtime_checkable
class CertifiedDesign(Protocol):
    """A design that has proved thresholds: no fault-free residual of a member exceeds that of the member."""

    @property
    def thresholds(self) -> Mapping[str, SupportsFloat]:
        """Thresholds by name of the member."""
        ...


@runtime_checkable
class BoundedDesign(Protocol):
    """A design with guaranteed responses of each member, over a whole uncertainty set."""

    @property
    def member_bounds(self) -> Mapping[str, tuple[float, float, Mapping[str, float]]]:
        """By name of the member, the bound of what disturbances cause, the least response to its own fault of size one,
        and the bounds of what other faults of size one cause.
        """
        ...


@runtime_checkable
class DesignWithTest(Protocol):
    """A design whose residuals are made for a test of some kind: T2 and Q of principal components, for example."""

    @property
    def test(self) -> Any:
        """Settings of that test, a :class:`residua.decide.TestSettings`."""
        ...


@runtime_checkable
class Watcher(Protocol):
    """A design, such as an observer, that makes a generator when it is asked which residuals are meant."""

    def residual_generator(self) -> ResidualGenerator:
        """Return one."""
        ...


@runtime_checkable
class PartialDesign(Protocol):
    """A design whose members need not all exist."""

    @property
    def failures(self) -> Mapping[str, str]:
        """Reasons by name of the member that could not be designed."""
        ...


def brings_a_generator(cls: Any) -> bool:
    """Tell from the return class of a design function, before any design, that a monitor can take its result."""
    if not isinstance(cls, type):
        return False
    declared = {name for base in cls.__mro__ for name in vars(base).get("__annotations__", {})} | set(dir(cls))
    return issubclass(cls, ResidualGenerator) or bool(declared & {"generator", "residual_generator"})


def as_generator(design: Any) -> ResidualGenerator:
    """Return the generator that was handed over, or the ``generator`` of a bank or an estimator.

    Other objects that could give one, such as observers, are refused: which of their residuals is meant is the
    caller's to say.
    """
    if isinstance(design, ResidualGenerator):
        return design
    if isinstance(design, Design) and isinstance(design.generator, ResidualGenerator) and not isinstance(design, type):
        return design.generator
    raise ModelError(
        f"a monitor runs a residual generator, got {type(design).__name__}"
        + ("; use its residual_generator()" if isinstance(design, Watcher) else "")
    )


def for_monitor(design: Any) -> Any:
    """Return the part of a design that a monitor takes.

    What makes a generator makes it, and its evidence says which members do not exist; what has one, such as matched
    filters, stays as it is.

    Raises
    ------
    ModelError
        If it is, has and makes no generator.
    """
    if isinstance(design, ResidualGenerator):
        return design
    if isinstance(design, Watcher):
        generator = design.residual_generator()
        missing = design.failures if isinstance(design, PartialDesign) else {}
        notes = tuple(f"no member {name!r}: {reason}" for name, reason in missing.items())
        return replace(generator, evidence=generator.evidence.extended(notes=notes)) if notes else generator
    if isinstance(design, Design):
        return design
    raise ModelError(f"no monitor can take {type(design).__name__}: it is, has and makes no residual generator")
