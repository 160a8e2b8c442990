"""Isolation by direction: the fault whose signature is nearest to the residual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.alarm import Alarm, Candidate
from residua.decide.checks import check_samples
from residua.decide.compiled import CompiledIsolation
from residua.decide.isolation import Isolation, IsolationSettings, Scores, by_cosine, check_groups
from residua.decide.multiscale_fit import averaged, lengths_at
from residua.decide.row_norms import row_norms, row_squares
from residua.decide.statement import Statement, angle, statement_by_score
from residua.decide.test import Block, ResidualTest, Tested, Watched
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.design import ResidualGenerator
from residua.errors import DataError, FileFormatError, SettingError
from residua.linear.subspaces.rank import range_basis
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import FINITE, MAX_WINDOW, WINDOW, NumberKind
from residua.recording.clock import Clock
from residua.records import joined
from residua.visible import echo

#: Signatures whose largest principal angle is below this (sine) are one and the same.
SAME_SIGNATURE = 1e-3
#: Bases from a file are orthonormal to that.
_ORTHONORMAL = 1e-6
_COSINE = "The score is the cosine of the angle between the residual and a signature, judged over the monitor's window."
#: Weights of the two long means; the first mean is the sample itself.
MEAN_WEIGHTS = (1 / 8, 1 / 64)
#: Samples that the longest mean is worth.
_MEMORY = 127
#: Normal score of the length from which a mean is clear of noise: one in 100,000 of noise alone.
_CLEAR = 4.26
#: Of the fitted isolation; 0 for the clear mean.
_WINDOW = NumberKind(f"a whole number from 0 to {MAX_WINDOW}", "i", lambda n: (n >= 0) & (n <= MAX_WINDOW))


@dataclass(frozen=True, eq=False)
class MeansState:
    """Long means of each plant.

    Attributes
    ----------
    means : ndarray, shape (plants, 2, k)
    """

    means: NDArray[np.float64]

    def arrays(self) -> tuple[NDArray[np.float64], None, None]:
        """Return the arrays that the fused loop reads and writes, in its order."""
        return self.means, None, None


def no_means(plants: int, k: int) -> MeansState:
    """Return the state before the first sample."""
    return MeansState(np.zeros((plants, len(MEAN_WEIGHTS), k)))


def clear_square(k: int) -> float:
    """Return the squared length, in deviations, beyond which a mean of k residuals is not noise."""
    return float(lengths_at(_CLEAR, [k])[0] ** 2) if k else np.inf


def clear_means(
    values: NDArray[np.float64], state: MeansState, judged: NDArray[np.bool_], clear: float
) -> tuple[NDArray[np.float64], MeansState]:
    r"""Return the mean that shows the direction of a residual best, at every sample.

    :math:`s_k = (1 - \lambda) s_{k-1} + \lambda q_k` has the variance :math:`\lambda / (2 - \lambda)` of white noise. A
    slower mean takes the place of a quicker one where it is clear of noise or, in its own deviations, no shorter: just
    after a large fault it is the sample itself, of a small one in the end the mean of a hundred.

    Parameters
    ----------
    values : ndarray, shape (plants, time, k)
        Whitened.
    state : MeansState
    judged : ndarray of bool, shape (plants, time)
        The samples that count; at the others no mean moves on.
    clear : float
        See :func:`clear_square`.

    Returns
    -------
    chosen : ndarray, shape (plants, time, k)
        Zero at samples that do not count.
    state : MeansState
        To go on with.
    """
    chosen = np.where(judged[..., None], values, 0.0)
    longest = row_squares(chosen)
    after = state.means.copy()
    whole = judged.all(axis=1)
    groups = [(np.flatnonzero(whole), np.arange(values.shape[1]))] if whole.any() else []
    groups += [(np.array([plant]), np.flatnonzero(judged[plant])) for plant in np.flatnonzero(~whole)]
    for who, rows in groups:
        at = np.ix_(who, rows)
        if not rows.size:
            continue
        for j, weight in enumerate(MEAN_WEIGHTS):
            means, after[who, j] = averaged(weight, state.means[who, j], values[at])
            squares = row_squares(means) * ((2 - weight) / weight)
            clearer = (squares > clear) | (squares >= longest[at])
            longest[at] = np.where(clearer, squares, longest[at])
            chosen[at] = np.where(clearer[..., None], means, chosen[at])
    return chosen, MeansState(after)


@dataclass(frozen=True, eq=False)
class DirectionTest(Isolation):
    """Fitted isolation by signatures in whitened residual space.

    Attributes
    ----------
    window : int
        Samples over which the residual is summed; 0 for the mean of :func:`clear_means`.
    groups : tuple of tuple of str
        Faults with the same signature are one group.
    bases : tuple of ndarray, shape (k, dimension)
        Orthonormal, one per group.
    unjudged : tuple of str
        Faults without a usable signature.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"window": _WINDOW, "bases": FINITE}
    has_words: ClassVar[bool] = True

    window: int
    groups: tuple[tuple[str, ...], ...]
    bases: tuple[NDArray[np.float64], ...]
    unjudged: tuple[str, ...]

    @property
    def dimensions(self) -> tuple[int, ...]:
        """Dimension of each group's signature."""
        return tuple(basis.shape[1] for basis in self.bases)

    @cached_property
    def clear(self) -> float:
        """Squared length beyond which a mean is not noise; 0 with a window."""
        return 0.0 if self.window else clear_square(len(self.bases[0]) if self.bases else 0)

    def start(self, plants: int) -> WindowState | MeansState:
        """Return the window of the residual, or its means, before the first sample."""
        k = len(self.bases[0]) if self.bases else 0
        return empty_window(plants, self.window, k) if self.window else no_means(plants, k)

    def run(
        self, state: WindowState | MeansState, block: Block, tested: Tested
    ) -> tuple[WindowState | MeansState, Scores]:
        """Return the correlation of the residual, over the window or as its clear mean, with each signature."""
        if not self.bases:  # nothing to compare a direction with
            return state, Scores(np.zeros((*tested.usable.shape, 0)))
        if isinstance(state, MeansState):
            sums, after = clear_means(tested.whitened, state, tested.usable, self.clear)
        else:
            sums, after = moving_sum(tested.whitened, state, tested.usable)
        size = row_norms(sums)
        usable = tested.usable & (size > 0)
        size = np.where(usable, size, 1.0)
        scores = np.full((*sums.shape[:2], len(self.bases)), np.nan)
        for g, basis in enumerate(self.bases):
            part = row_norms(ordered_product(sums, basis)) / size
            scores[..., g] = np.where(usable, np.minimum(part, 1.0), np.nan)
        return after, Scores(scores)

    @property
    def compiled(self) -> CompiledIsolation | None:
        """Equivalent for the fused loop."""
        return CompiledIsolation(self.window, self.bases, self.clear) if type(self) is DirectionTest else None

    def candidates(self, scores: NDArray[np.float64]) -> tuple[Candidate, ...]:
        """Return the groups ranked by score, best first; none if the direction is unknown.

        Scores that agree to three digits are a tie, which the narrower signature wins: a plane contains more
        residuals by chance than a line.
        """
        return candidates_at(scores, self.groups, self.dimensions)

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Largest number of samples over which the residual is averaged."""
        return self.window or _MEMORY

    @property
    def signatures(self) -> tuple[NDArray[np.float64], ...]:
        """The bases."""
        return self.bases

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        if self.window:
            over = f"{self.window} samples ({self.window * step:g} s)"
            return {"isolation": f"direction of the residual averaged over {over}"}
        return {
            "isolation": "direction of the residual: of the longest of its means (weights 1, 1/8, 1/64) that is clear "
            f"of noise, over some {_MEMORY} samples ({_MEMORY * step:g} s) at most"
        }

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: the scores, and the angles that they mean."""
        return statement_by_score(alarm, clock, self.word(alarm, window), angle, _COSINE)

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched, test: ResidualTest) -> None:
        """Raise if signatures from a file do not match the residuals and faults, or are not orthonormal."""
        where, residuals = "running.isolation", watched.generator.n_residuals
        check_groups(self.groups, self.unjudged, where, watched.generator.faults)
        if len(self.bases) != len(self.groups):
            raise FileFormatError(f"{where}.bases: expected a list of {len(self.groups)}")
        for k, basis in enumerate(self.bases):
            if basis.ndim != 2 or len(basis) != residuals:
                raise FileFormatError(f"{where}: every basis must have {residuals} rows")
            if not basis.size or not np.abs(basis.T @ basis - np.eye(basis.shape[1])).max() <= _ORTHONORMAL:
                raise FileFormatError(f"{joined(where, 'bases')}[{k}]: its columns must be orthonormal")

    def check_state(self, state: WindowState | MeansState, count: int) -> None:
        """Raise if a state from a file is invalid."""
        if isinstance(state, WindowState):
            state.check("state.isolation")


@dataclass(frozen=True)
class Directional(IsolationSettings):
    """Rank the faults by the angle between the residual and their signatures.

    Parameters
    ----------
    window : int, optional
        Judged samples over which the (whitened) residual is averaged before its direction is judged. When omitted, its
        longest mean that noise does not explain: of the sample itself and of exponentially weighted means of weight
        1/8 and 1/64, so that a large fault has a name at once, and a small one that of a hundred samples.
    signature : {"auto", "subspace", "steady"}
        ``"subspace"``: the line or plane that the residual of a fault never leaves. ``"steady"``: the
        direction that it settles to when the fault is constant. ``"auto"`` takes the line or plane where
        the design has one that is smaller than the space that the residual can reach, and the steady direction
        elsewhere, also for faults that share a plane and settle to different directions in it.

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (26) to (30); steady directions: Gertler (1991), section 5.3.
    """

    kind: ClassVar[str] = "direction"
    makes: ClassVar[type[Isolation]] = DirectionTest
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"window": WINDOW}

    window: int | None = None
    signature: str = "auto"

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.window is not None:
            check_samples(self.window, "window")
            object.__setattr__(self, "window", int(self.window))
        if self.signature not in ("auto", "subspace", "steady"):
            raise SettingError(f"signature must be 'auto', 'subspace' or 'steady', got {echo(self.signature)}")

    def isolation(self, generator: ResidualGenerator, test: ResidualTest) -> DirectionTest:
        """Return the signatures in the space of the whitened residual."""
        return direction_test(
            self, generator.subspaces, generator.steady_directions, test.metric, generator.residual_rank
        )

    @classmethod
    def for_design(cls, design: Any, generator: ResidualGenerator) -> Self | None:
        """Return the settings, the default for any generator without codes; else ``None``."""
        return None if generator.codes is not None else cls()

    def kept(self, generator: ResidualGenerator) -> tuple[str, int, int]:
        """Return the window, and the number of values it keeps: the residuals."""
        return f"Directional(window={self.window})", self.window or len(MEAN_WEIGHTS), generator.n_residuals

    def check_record(self, content: Mapping[str, Any], where: str) -> None:
        """Raise if the window of the record differs from that of the settings."""
        if content.get("window") != (self.window or 0):
            raise FileFormatError(f"{where}.window must be that of isolate, {self.window or 0}")


def candidates_at(
    scores: NDArray[np.float64], groups: tuple[tuple[str, ...], ...], dimensions: tuple[int, ...]
) -> tuple[Candidate, ...]:
    """Return the groups ranked by score, best first; see :meth:`DirectionTest.candidates`."""
    if scores.size == 0 or np.isnan(scores).all():
        return ()
    order = np.lexsort((-scores, np.asarray(dimensions), -np.round(scores, 3)))
    return tuple(by_cosine(groups[g], float(scores[g])) for g in order)


def correlation(residual: ArrayLike, signature: ArrayLike, *, rtol: float = 1e-9) -> float:
    r"""Return ``CORR``: the cosine of the angle between a residual and a signature direction or subspace.

    :math:`\|\Phi \Phi^+ r\| / \|r\|`, by pseudoinverse with a rank tolerance, so that the columns of
    :math:`\Phi` may be dependent or zero.

    Parameters
    ----------
    residual : array_like, shape (k,)
    signature : array_like, shape (k,) or (k, columns)
    rtol : float
        Singular values of the signature below this fraction of the largest count as zero.

    Returns
    -------
    float
        Between 0 and 1; NaN for a zero residual.

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (26), (28) and (29).

    Examples
    --------
    >>> from residua.decide import correlation, projection_distance
    >>> round(correlation([3.0, 4.0], [1.0, 0.0]), 3), round(projection_distance([3.0, 4.0], [1.0, 0.0]), 3)
    (0.6, 0.8)
    """
    r, Q = _vector_and_basis(residual, signature, rtol)
    size = float(np.linalg.norm(r))
    return float(np.linalg.norm(Q.T @ r) / size) if size > 0 else float("nan")


def projection_distance(residual: ArrayLike, signature: ArrayLike, *, rtol: float = 1e-9) -> float:
    """Return ``NPD``: the normalised distance of a residual from a signature direction or subspace.

    ``CORR**2 + NPD**2 = 1``; see :func:`correlation`.

    Parameters
    ----------
    residual : array_like, shape (k,)
    signature : array_like, shape (k,) or (k, columns)
    rtol : float

    Returns
    -------
    float

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (30).
    """
    r, Q = _vector_and_basis(residual, signature, rtol)
    size = float(np.linalg.norm(r))
    return float(np.linalg.norm(r - Q @ (Q.T @ r)) / size) if size > 0 else float("nan")


def _vector_and_basis(residual: ArrayLike, signature: ArrayLike, rtol: float) -> tuple[NDArray, NDArray]:
    r, Phi = np.asarray(residual, dtype=float), np.asarray(signature, dtype=float)
    if r.ndim != 1 or Phi.ndim not in (1, 2) or len(Phi) != len(r):
        raise DataError(f"a residual of {r.shape} does not go with a signature of {Phi.shape}: one row per residual")
    return r, range_basis(Phi.reshape(len(r), -1), rtol=rtol)[0]


def direction_test(
    settings: Directional,
    subspaces: Mapping[str, NDArray],
    steady: Mapping[str, NDArray],
    whitening: NDArray[np.float64],
    rank: int | None = None,
) -> DirectionTest:
    """Return the signatures of all faults in whitened space, with equal ones grouped.

    ``rank`` is the number of independent directions of the residual (all of them when omitted): a subspace
    of that dimension holds every residual and tells nothing.
    """
    n = len(whitening) if rank is None else rank
    bases = {
        fault: _signature(settings.signature, subspace, steady.get(fault), whitening, n)
        for fault, subspace in subspaces.items()
    }
    judged = {fault: basis for fault, basis in bases.items() if basis is not None}
    groups = _grouped(judged)
    if settings.signature == "auto":  # faults that share a plane, by their steady directions in it where these differ
        lines = {
            fault: range_basis(whitening.T @ steady[fault][:, None], rtol=1e-9)[0]
            for fault in judged
            if fault in steady and np.any(steady[fault])
        }
        divided = []
        for faults, basis in groups:
            parts = [(faults, basis)]
            if len(faults) > 1 and basis.shape[1] > 1 and all(fault in lines for fault in faults):
                parts = _grouped({fault: lines[fault] for fault in faults})
            divided += parts if len(parts) > 1 else [(faults, basis)]
        groups = divided
    return DirectionTest(
        settings.window or 0,
        tuple(tuple(faults) for faults, _ in groups),
        tuple(basis for _, basis in groups),
        tuple(fault for fault, basis in bases.items() if basis is None),
    )


def _grouped(bases: Mapping[str, NDArray]) -> list[tuple[list[str], NDArray]]:
    """Return faults with the same signature as groups, in their order, with that signature."""
    groups: list[tuple[list[str], NDArray]] = []
    for fault, basis in bases.items():
        for faults, other in groups:
            alike = other.shape[1] == basis.shape[1]
            if alike and np.linalg.norm(basis - other @ (other.T @ basis), 2) < SAME_SIGNATURE:
                faults.append(fault)
                break
        else:
            groups.append(([fault], basis))
    return groups


def _signature(
    kind: str, subspace: NDArray, steady: NDArray | None, whitening: NDArray, n: int
) -> NDArray[np.float64] | None:
    """Return a basis of the signature of a fault in whitened space; ``None`` without a usable one."""
    narrow = 0 < subspace.shape[1] < n
    if kind == "subspace" or (kind == "auto" and narrow):
        return range_basis(whitening.T @ subspace, rtol=1e-9)[0] if narrow else None
    if steady is None or not np.any(steady):
        return None
    return range_basis(whitening.T @ steady[:, None], rtol=1e-9)[0]
