"""The general form of a residual generator: its conditions checked, and any generator seen in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import matrix
from residua.design.core.balanced_filter import state_map_of, static_map
from residua.design.core.decoupling import Decoupled, leak
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.core.signals import signal_names
from residua.design.observers.observer import Observer
from residua.errors import DesignError, SettingError
from residua.linear import StateSpace
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.poles.zero_structure import explicit_poles
from residua.linear.subspaces.rank import RankDecision, decide_rank, equilibrated
from residua.plant import Plant
from residua.shown import Shown
from residua.tolerances import DESIGN_ROUNDING, IDENTITY, LEAK, above_rounding

REFERENCE = "Gertler (1991), Automatica 27(4), eqs. (3-11), (3-13), (4-8) and (4-15) to (4-20)"


#: The conditions in the order of (4-18), with feedthrough; those of (4-19) follow.
CONDITIONS = (
    "T A - M T E - N C = 0",
    "T B - N D - J = 0",
    "Ls T E + Ly C + V A = 0",
    "Lu + Ly D + V B = 0",
    "T Fd - N Dd = 0",
    "Ly Dd + V Fd = 0",
)


@dataclass(frozen=True, eq=False, repr=False)
class GeneralForm(Shown):
    r"""A residual generator in the general form, with the conditions that make it one.

    .. math:: \dot s = M s + J u + N y, \qquad r = L_s s + L_u u + L_y y

    While nothing fails :math:`s = T E x`. For a plant with feedthrough or ``E`` the conditions (4-18) read
    :math:`T A - M T E - N C = 0`, :math:`T B - N D - J = 0`, :math:`L_s T E + L_y C = 0`, :math:`L_u + L_y D = 0`.
    :func:`residua.design.decoupled_residual` gives the ``T, M, N, J, Ls, Ly`` of the unknown input observer of section
    4.4, of the smallest order and with poles of your choice:
    ``rs.design.general_form(rs.design.decoupled_residual(plant, ...))``.

    Attributes
    ----------
    T : ndarray, shape (order, n)
    M : ndarray, shape (order, order)
    J : ndarray, shape (order, inputs)
    N : ndarray, shape (order, outputs)
    Ls : ndarray, shape (residuals, order)
    Lu : ndarray, shape (residuals, inputs)
    Ly : ndarray, shape (residuals, outputs)
    V : ndarray, shape (residuals, n)
        What the residual reads of the algebraic equations of a singular plant, ``V E = 0``: :math:`V A` is added to
        the third condition and :math:`V B` to the fourth. Zero otherwise.
    conditions : dict of str to float
        How far each condition, (4-18) and (4-19), is missed, in balanced units: of each row, relative to the largest
        coefficient of the generator in it. The last two are there if the plant has disturbances, and large for a
        generator that does not decouple them.
    rank_TF, rank_F : RankDecision
        Condition (4-20): equal where the faults have independent columns in the error, so that structured residuals
        can be made of it.
    first_response : ndarray, shape (residuals, faults)
        :math:`-L_s T f`, what a fault does to the residual one step (one integration) later; with a feedthrough of
        the fault, :math:`-L_s (T f - N d)`.
    """

    T: NDArray[np.float64]
    M: NDArray[np.float64]
    J: NDArray[np.float64]
    N: NDArray[np.float64]
    Ls: NDArray[np.float64]
    Lu: NDArray[np.float64]
    Ly: NDArray[np.float64]
    V: NDArray[np.float64]
    conditions: Mapping[str, float]
    rank_TF: RankDecision
    rank_F: RankDecision
    first_response: NDArray[np.float64]

    @property
    def is_residual_generator(self) -> bool:
        """True if the conditions (4-18) hold: zero for the fault-free plant without disturbances."""
        return all(error <= IDENTITY for name, error in self.conditions.items() if name in CONDITIONS[:4])

    @property
    def decouples(self) -> bool:
        """True if the condition (4-19) holds too."""
        return self.is_residual_generator and all(error <= IDENTITY for error in self.conditions.values())

    @property
    def keeps_faults_apart(self) -> bool:
        """True if condition (4-20) holds, rank(T F) = rank(F)."""
        return self.rank_TF.rank == self.rank_F.rank

    def __str__(self) -> str:
        lines = [f"general form of order {len(self.M)}, {len(self.Ls)} residuals"]
        lines += [f"  {name}: missed by {error:.1e} of its terms" for name, error in self.conditions.items()]
        return "\n".join([*lines, f"  rank(T F) = {self.rank_TF.rank}, rank(F) = {self.rank_F.rank}"])


def general_form(generator: ResidualGenerator) -> GeneralForm:
    """Return a generator in the general form ``T, M, J, N, Ls, Lu, Ly``, with its conditions as numbers.

    Parameters
    ----------
    generator : ResidualGenerator

    Returns
    -------
    GeneralForm

    Raises
    ------
    DesignError
        If the states of the filter are no linear function of the plant's, as those of a sampled continuous design.

    References
    ----------
    Gertler (1991), eqs. (3-13) and (4-15) to (4-20).

    Examples
    --------
    >>> import residua as rs
    >>> flt = rs.design.decoupled_residual(rs.library.gertler().without_faults("p2"), poles=[0.1, 0.2, 0.3])
    >>> rs.design.general_form(flt).is_residual_generator
    True
    """
    if generator.state_map is None:
        raise DesignError(
            "this generator has no general form: its states are no linear function T x of the plant's, as after "
            "sampling a continuous design; design for plant.discretize(dt)"
        )
    return _form(generator.system, generator.plant, generator.state_map, generator.static_map)


def _form(system: StateSpace, plant: Plant, T: NDArray, V: NDArray | None) -> GeneralForm:
    n_u, V = len(plant.inputs), np.zeros((system.n_outputs, plant.n_states)) if V is None else V
    (J, N), (Lu, Ly) = (np.split(block, [n_u], axis=1) for block in (system.B, system.D))
    model = plant.balanced
    (A, C, E), units = model.written, model.units
    e, y = units.rate / units.equations, 1 / units.outputs
    roles = ((plant.B, plant.D), (plant.Bd, plant.Dd), (plant.Bf, plant.Df))
    u, d, f = np.split(units.inputs, np.cumsum([len(plant.inputs), len(plant.disturbances)]))
    (B, D), (Bd, Dd), (Bf, Df) = (
        (b / e[:, None] * by, c / y[:, None] * by) for (b, c), by in zip(roles, (u, d, f), strict=True)
    )
    Tb, Nb, Lb, Vb, TE = T * e, N * y, Ly * y, V * e, T / units.equations @ E
    X = np.abs(TE).max(axis=1, initial=0.0)  # the sizes of the states
    of_inputs, of_residual = np.hstack([Tb, Nb, J * u]), np.hstack([system.C * X, Lb, Lu * u, Vb])
    missed = (
        (np.hstack([of_inputs, system.A * X]), Tb @ A - system.A @ TE - Nb @ C),
        (of_inputs, Tb @ B - Nb @ D - J * u),
        (of_residual, system.C @ TE + Lb @ C + Vb @ A),
        (of_residual, Lu * u + Lb @ D + Vb @ B),
        (of_inputs, Tb @ Bd - Nb @ Dd),
        (of_residual, Lb @ Dd + Vb @ Bd),
    )
    conditions = {
        name: float(np.max(np.abs(off).max(axis=1, initial=0.0) / _largest(rows), initial=0.0))
        for name, (rows, off) in zip(CONDITIONS, missed if plant.disturbances else missed[:4], strict=False)
    }
    TF = above_rounding(Tb @ Bf - Nb @ Df, _largest(of_inputs)[:, None], DESIGN_ROUNDING) / f
    seen, F = np.vstack([TF, Ly @ plant.Df]), np.vstack([plant.Bf, plant.Df])
    rank_TF, rank_F = (decide_rank(equilibrated(one) if one.size else one) for one in (seen, F))
    return GeneralForm(T, system.A, J, N, system.C, Lu, Ly, V, conditions, rank_TF, rank_F, -system.C @ TF)


def _largest(M: NDArray) -> NDArray[np.float64]:
    """Return the largest entry of each row; one for a row of zeros."""
    size = np.abs(M).max(axis=1, initial=0.0)
    return np.where(size > 0, size, 1.0)


@method(
    designs_for="observer",
    needs=["its gain, or the matrices of the general form"],
    exists_when="these are stable and fulfil the conditions of a residual generator",
    order="that of the observer",
    source="Gertler (1991), eqs. (3-11), (3-13), (4-15) to (4-20)",
    decouples=True,
    singular=True,
)
def residual_generator_from_observer(
    source: Plant | Observer,
    *,
    gain: ArrayLike | None = None,
    weight: ArrayLike | None = None,
    M: ArrayLike | None = None,
    J: ArrayLike | None = None,
    N: ArrayLike | None = None,
    Ls: ArrayLike | None = None,
    Lu: ArrayLike | None = None,
    Ly: ArrayLike | None = None,
    T: ArrayLike | None = None,
    decouples: bool | None = None,
) -> ResidualGenerator:
    r"""Return the residual generator of an observer that was designed elsewhere, after checking that it is one.

    Three ways to say what it is:

    - a plant with ``gain=K`` and, if wanted, ``weight=S``:
      :math:`\dot{\hat x} = A \hat x + B u + K (y - D u - C \hat x)`, :math:`r = S (y - D u - C \hat x)`;
    - a plant with the matrices of the general form :math:`\dot s = M s + J u + N y`,
      :math:`r = L_s s + L_u u + L_y y`. The map ``T`` with ``s = T E x`` solves
      :math:`T A - M T E = N C` when it is omitted;
    - an :class:`Observer` of this package.

    Parameters
    ----------
    source : Plant or Observer
    gain : array_like, shape (n, outputs), optional
        ``K``; ``A - K C`` must be stable.
    weight : array_like, shape (residuals, outputs), optional
        ``S``; the identity when omitted.
    M : array_like, shape (order, order), optional
        Stable.
    J : array_like, shape (order, inputs), optional
        ``T B - N D`` when omitted.
    N : array_like, shape (order, outputs), optional
    Ls : array_like, shape (residuals, order), optional
    Lu : array_like, shape (residuals, inputs), optional
        ``-Ly D`` when omitted.
    Ly : array_like, shape (residuals, outputs), optional
    T : array_like, shape (order, n), optional
    decouples : bool, optional
        Whether the residual must ignore the disturbances of the plant, condition (4-19). When omitted: for the general
        form, as in the paper; not for a gain.

    Returns
    -------
    ResidualGenerator
        Its ``evidence.conditions`` say how far each condition is missed. Of a sampled plant with noise it has a
        ``covariance``, so that a monitor needs no data for a first threshold; of a continuous one once it is sampled.

    Raises
    ------
    DesignError
        If a condition fails, with its name and the number, or the observer is not stable.
    SettingError
        If the options do not go together, or a matrix of the general form is missing.

    See Also
    --------
    luenberger_observer : Designs the gain.
    unknown_input_observer : Designs the decoupling.
    eigenstructure_assignment : Designs a gain whose residual ignores faults.

    References
    ----------
    Gertler (1991), eqs. (3-11), (3-13), (4-8), (4-15) to (4-20).

    Examples
    --------
    The unknown input observer of Example 2 D:

    >>> import residua as rs
    >>> flt = rs.residual_generator_from_observer(
    ...     rs.library.gertler(),
    ...     M=[[0.25, 0], [0, 0.3]],
    ...     J=[[-3.65], [-3.3]],
    ...     N=[[0.975, -2.6], [0.6, -1.8]],
    ...     Ls=[[-2, 2]],
    ...     Ly=[[1, -2]],
    ... )
    >>> flt.state_map.round(9)
    array([[ 6.5, -6.5, -4. ],
           [ 6. , -6. , -3. ]])
    >>> flt.structure
    array([[False,  True]])
    """
    general = {"M": M, "J": J, "N": N, "Ls": Ls, "Lu": Lu, "Ly": Ly, "T": T}
    present = [name for name, value in general.items() if value is not None]
    if not isinstance(source, Plant):
        if present or gain is not None or weight is not None:
            raise SettingError("an observer brings its own matrices: leave gain, weight and the general form out")
        return _decoupling_as_asked(source.residual_generator(), decouples)
    if gain is not None:
        if present:
            raise SettingError(f"give either a gain or the general form, not both: got gain and {', '.join(present)}")
        return _decoupling_as_asked(_of_gain(source, gain, weight), decouples)
    missing = [name for name in ("M", "N", "Ls", "Ly") if general[name] is None]
    if missing or weight is not None:
        raise SettingError(
            "weight goes with a gain: give gain=K too"
            if weight is not None
            else f"the general form needs {', '.join(missing)} too; or give gain=K"
        )
    return _of_matrices(source, general, decouples is None or decouples)


def _of_gain(plant: Plant, gain: ArrayLike, weight: ArrayLike | None) -> ResidualGenerator:
    """Return the residual generator of a full-order observer with a gain of its own."""
    plant = plant.explicit()
    n, p = plant.n_states, plant.n_outputs
    K = matrix(gain, "gain", (n, p), what="states x outputs")
    S = np.eye(p) if weight is None else matrix(weight, "weight", (None, p), what="residuals x outputs")
    if not S.any():
        raise DesignError("weight is zero: the residual would be zero whatever fails; leave it out for all outputs")
    F = plant.A - K @ plant.C
    _require_stable(F, plant.dt, "A - K C")
    evidence = Evidence(method="observer with a given gain", poles=explicit_poles(F), references=(REFERENCE,))
    observer = Observer(plant, F, np.eye(n), K, np.eye(n), np.zeros((n, p)), S, evidence.method, False, evidence)
    return observer.residual_generator()


def _of_matrices(plant: Plant, entries: dict[str, Any], decouples: bool) -> ResidualGenerator:
    """Return the residual generator of matrices in the general form, after checking its conditions."""
    n, m, p = plant.n_states, len(plant.inputs), plant.n_outputs
    M = matrix(entries["M"], "M", (None, None))
    k = len(M)
    M = matrix(M, "M", (k, k), what="square")
    N = matrix(entries["N"], "N", (k, p), what="order x outputs")
    Ls = matrix(entries["Ls"], "Ls", (None, k), what="residuals x order")
    r = len(Ls)
    Ly = matrix(entries["Ly"], "Ly", (r, p), what="residuals x outputs")
    J = np.zeros((k, m)) if entries["J"] is None else matrix(entries["J"], "J", (k, m), what="order x inputs")
    Lu = -Ly @ plant.D if entries["Lu"] is None else matrix(entries["Lu"], "Lu", (r, m), what="residuals x inputs")
    _require_stable(M, plant.dt, "M")
    names = [f"r{i + 1}" for i in range(r)]
    system = StateSpace(
        M, np.hstack([J, N]), Ls, np.hstack([Lu, Ly]), dt=plant.dt, inputs=signal_names(plant), outputs=names
    )
    if entries["T"] is None:  # a state that the residual does not show may be anything, and is left out
        system, T, V = state_map_of(system, plant)
    else:
        T = matrix(entries["T"], "T", (k, n), what="order x states")
        V = static_map(system, plant, T)
    if entries["J"] is None:
        N = system.B[:, m:]
        system = system.replaced(B=np.hstack([T @ plant.B - N @ plant.D, N]))
    if entries["Lu"] is None and V is not None:
        system = system.replaced(D=np.hstack([Lu - V @ plant.B, Ly]))
    errors = _form(system, plant, T, V).conditions
    failed = [
        f"{name} is missed by {error:.2g} of its terms"
        for name, error in errors.items()
        if error > IDENTITY and (decouples or name in CONDITIONS[:4])
    ]
    if failed:
        what = "residual generator that ignores the disturbances" if decouples else "residual generator"
        hint = "" if entries["T"] is not None else "; T was found from these conditions: give T=... if you have it"
        raise DesignError(f"these matrices are no {what} for {plant.name!r}: {'; '.join(failed)}{hint}")
    method = "residual generator in the general form"
    evidence = Evidence(method=method, poles=explicit_poles(system.A), conditions=errors, references=(REFERENCE,))
    promise = Decoupled(disturbances=decouples)
    return make_generator(system, plant, method, evidence, decouples=promise, state_map=T, static_map=V)


def _decoupling_as_asked(generator: ResidualGenerator, decouples: bool | None) -> ResidualGenerator:
    """Return a generator, after checking that it ignores the disturbances where that is asked."""
    p = generator.plant
    if not decouples or not p.disturbances:
        return generator
    assert generator.state_map is not None  # every observer has one
    found = leak(generator.system, p, generator.state_map, generator.static_map)
    gain = float(found.gains[:, len(p.inputs) :].max())
    if gain > LEAK:
        raise DesignError(
            f"the residual does not ignore the disturbances {', '.join(p.disturbances)}, as decouples=True asks: they "
            f"reach it by {gain:.2g} of the terms that would have to cancel (allowed: {LEAK:.0e}); leave decouples out "
            "to take it as it is, or have one designed, as by unknown_input_observer or decoupled_residual"
        )
    return replace(generator, evidence=generator.evidence.extended(decoupling={"disturbance": gain}))


def _require_stable(F: NDArray, dt: float, name: str) -> None:
    poles = np.linalg.eigvals(F).astype(complex)
    if not is_stable_mode(poles, dt).all():
        raise DesignError(f"{name} is not stable: its eigenvalues are {describe_modes(poles)}")
