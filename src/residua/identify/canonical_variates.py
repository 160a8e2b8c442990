"""Canonical variate analysis of recorded channels: the states that predict the future best, and the residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.norm_threshold import NormThreshold
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator
from residua.errors import DataError, SettingError
from residua.identify.channel_filter import (
    Standard,
    channel_generator,
    channels_in,
    few_rows,
    lagged_rows,
    names_of_groups,
    treated,
    with_signs,
)
from residua.identify.hankel_factor import count_windows
from residua.identify.segments import Gathered, Names, checked_count, gather
from residua.linear.subspaces.rank import RankDecision, null_basis
from residua.tolerances import RANK
from residua.visible import echo, listed
from residua.words import counted

#: Lags that are tried at most when they are not given.
_MOST_LAGS = 20
_METHOD = "canonical variates"
STATES, REST = "T2 of states", "T2 of residuals"
_KINDS = ("innovations", "variates")


@dataclass(frozen=True, eq=False, repr=False)
class CanonicalVariates:
    """Canonical variates of recorded channels, with the generator of states and residuals.

    Attributes
    ----------
    generator : ResidualGenerator
        The filter that a :class:`residua.Monitor` runs.
    test : NormThreshold
        The default test of a monitor: the norm of each group.
    groups : mapping of str to tuple of str
        ``"T2 of states"`` and ``"T2 of residuals"``, with the residuals of each.
    lags, states : int
    correlations : ndarray
        Canonical correlations of past and future, largest first.
    criterion_of_lags, criterion_of_states : mapping of int to float
        Akaike's criterion for each number that was tried; empty where it was given.
    mean, spread : ndarray, shape (channels,)
        Of each channel, in its own units; of one that is differenced the spread of its changes.
    samples : int
        Rows that they are from.
    drifts : mapping of str to str
        The treatment of each channel that drifts, or was named.
    """

    generator: ResidualGenerator
    test: NormThreshold = field(repr=False)
    groups: Mapping[str, tuple[str, ...]] = field(repr=False)
    lags: int
    states: int
    correlations: NDArray[np.float64] = field(repr=False)
    criterion_of_lags: Mapping[int, float] = field(repr=False)
    criterion_of_states: Mapping[int, float] = field(repr=False)
    mean: NDArray[np.float64] = field(repr=False)
    spread: NDArray[np.float64] = field(repr=False)
    samples: int
    drifts: Mapping[str, str] = field(repr=False)

    def __repr__(self) -> str:
        return (
            f"CanonicalVariates({counted(self.states, 'state')} of {counted(self.lags, 'lag')}, "
            f"{len(self.generator.plant.outputs)} channels)"
        )


def canonical_variates(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    lags: int | str = "auto",
    states: int | str = "auto",
    residuals: str = "innovations",
    drifts: str | Mapping[str, str] = "keep",
    dt: float | None = None,
) -> CanonicalVariates:
    r"""Return canonical states and residuals of fault-free recordings as a residual generator, without any model.

    .. math::

       p_k = [z_k, \dots, z_{k-L+1}], \quad f_k = [y_{k+1}, \dots, y_{k+L}], \qquad
       \Sigma_{pp}^{-1/2} \Sigma_{pf} \Sigma_{ff}^{-1/2} = U S V^T, \qquad
       x_k = U_n^T \Sigma_{pp}^{-1/2} p_k

    with the channels ``z`` (inputs and outputs) and the outputs ``y``, each less its mean and in standard deviations.
    The states ``x`` are the ``n`` combinations of the past that say most of the future. The residuals are of two
    groups:

    - ``T2 of states``: ``x``; its sum of squares is :math:`T_s^2`, how unusual the state is.
    - ``T2 of residuals``: with ``residuals="innovations"`` :math:`e_k = y_k - \hat C x_{k-1} - \hat D u_k` by least
      squares, in symmetric units of its covariance, :math:`\Sigma_e^{-1/2} e_k`: what the states do not foretell.
      With ``residuals="variates"`` the other canonical variates, :math:`U_r^T \Sigma_{pp}^{-1/2} p_k`; their sum of
      squares is :math:`T_r^2`.

    A :class:`residua.Monitor` without a test of its own tests the norm of each group, whitened by mean and covariance
    of the rows that it is fitted to (``made.test``).

    Guaranteed: the same bits when a channel has other units, as far as these differ by a power of two. The residual of
    a fault of a channel is exactly the filter's own response to that channel.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free; rows with a missing value cut them into segments.
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        Channels by name; without inputs all columns are outputs.
    lags : int or "auto"
        ``L``, samples of the past and of the future. ``"auto"``: where the small-sample form of Akaike's criterion of
        :math:`y_k` regressed on ``L`` samples of the past is least.
    states : int or "auto"
        ``n``. ``"auto"``: where the same criterion of the innovations is least (Larimore).
    residuals : {"innovations", "variates"}
    drifts : {"keep", "leave out", "difference"} or mapping of str to these
        Treatment of channels that do not keep their level (:func:`residua.identify.drifting_channels`): nothing,
        besides a note with numbers; they are read by no residual, and have no fault, though they stay a column of the
        recordings; or they are read by their changes from row to row, which show their faults only while these change.
        A mapping says it for each channel by name, whether it drifts or not; those that it does not name are kept.
    dt : float, optional
        Step in seconds of arrays.

    Returns
    -------
    CanonicalVariates

    Raises
    ------
    DataError
        If a channel never changes, channels determine one another exactly (such as one that is there twice), or there
        are no more rows than columns, ``2 L channels``.
    SettingError
        If ``lags``, ``states`` or ``residuals`` are out of range, or a channel is named twice.

    Notes
    -----
    Assumes: operation around one point, with a mean and covariances that last. Future inputs are not held constant:
    where inputs can be foretold from the past, states say that too. Thresholds are fitted by
    :meth:`residua.Monitor.fit`, best on other fault-free rows than these: residuals fit their own rows better than any
    others, the more so the more lags.

    Faults are those of records: each moves its own channel only; one that acts back through the plant moves others
    too. See :func:`residua.identify.principal_components` for what isolation by direction then is.

    References
    ----------
    Larimore (1983), Proc. American Control Conference, 445-451 (states by Akaike's criterion). Negiz and Cinar (1997),
    AIChE Journal 43(8), 2002-2020. Russell, Chiang and Braatz (2000), Chemometrics and Intelligent Laboratory Systems
    51(1), 81-93 (both statistics). Odiowei and Cao (2010), IEEE Transactions on Industrial Informatics 6(1), 36-45.
    Hurvich and Tsai (1989), Biometrika 76(2), 297-307 (small samples).

    See Also
    --------
    residua.identify.principal_components : components of largest variance.
    residua.identify.parity_from_data : relations between inputs and outputs.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9, 0.2], [0, 0.7]], [[0], [1.0]], [[1.0, 0], [1, 1]], dt=1, inputs=["valve"])
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((2000, 1))
    >>> y = plant.system().simulate(u) + 0.1 * rng.standard_normal((2000, 2))
    >>> made = rs.identify.canonical_variates(u[:1000], y[:1000], inputs=["valve"], outputs=["a", "b"])
    >>> made
    CanonicalVariates(2 states of 13 lags, 3 channels)
    >>> monitor = rs.Monitor(made).fit(None, np.hstack([u, y])[1000:])
    """
    if residuals not in _KINDS:
        raise SettingError(f"residuals must be 'innovations' or 'variates', got {echo(residuals)}")
    channels = treated(gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt), drifts)
    gathered, units = channels.gathered, channels.units
    by_lags: dict[int, float] = {}
    if lags == "auto":
        by_lags = _criteria_of_lags(gathered, units)
        lags = min(by_lags, key=lambda one: by_lags[one])
    else:
        lags = checked_count(lags, "lags", 1)
    stacked = lagged_rows(gathered, units, 2 * lags - 1)
    m, q, count = len(gathered.inputs), stacked.channels, stacked.count
    d, f = lags * q, lags * (q - m)
    blocks = (range(lags, 2 * lags), None), (range(lags), range(m, q)), (range(lags - 1, lags), None)
    past, future, now = (stacked.columns(*one) for one in blocks)
    F = stacked.rearranged([*past, *future, *now]) / np.sqrt(count - 1)
    _check_regular(F[:d, :d], gathered.channels, "the past")
    basis, T = np.linalg.qr(F[:, d : d + f])
    _check_regular(T, gathered.outputs, "the future")
    U, s, _ = np.linalg.svd(basis[:d])
    U, correlations = with_signs(U), np.minimum(s, 1.0)
    to_variates = np.linalg.solve(F[:d, :d], U)  # they are of variance one
    # the next sample: its covariance with the variates in the first rows, by the root of the rows; the rest below
    present = np.vstack([U.T @ F[:d, d + f :], F[d:, d + f :]])
    by_states: dict[int, float] = {}
    if states == "auto":
        for k in range(1, len(correlations) + 1):
            value = _criterion(_innovations(present, k, m)[1], count, k * (2 * (q - m) + m) + m * (q - m))
            by_states |= {} if value is None else {k: value}
        n = min(by_states, key=lambda one: by_states[one])
    else:
        n = checked_count(states, "states", 1)
        if n > len(correlations):
            raise SettingError(
                f"{lags} lags have {len(correlations)} canonical variates that say anything of the future: ask for "
                f"that many states at most, not {n}"
            )
    weights = to_variates.T.reshape(d, lags, q).transpose(1, 0, 2)
    if residuals == "innovations":
        weights = _with_innovations(weights[:, :n], *_innovations(present, n, m), m)
    rest = weights.shape[1] - n
    groups = {STATES: n} | ({REST: rest} if rest else {})
    evidence = Evidence(
        _METHOD,
        ranks={"states": RankDecision(n, correlations, float(correlations[n - 1]))},
        conditions={"smallest correlation kept": float(correlations[n - 1])},
        notes=few_rows(count, 2 * d),
        references=("Larimore (1983)", "Negiz and Cinar (1997)", "Russell, Chiang and Braatz (2000)"),
    )
    generator = channel_generator(channels, weights, groups, evidence)
    members = names_of_groups(generator)
    chosen = (lags, n, correlations, by_lags, by_states, channels.mean, channels.spread, count, channels.ways)
    return CanonicalVariates(generator, NormThreshold(groups=members), members, *chosen)


def _innovations(present: NDArray[np.float64], n: int, m: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least-squares weights of ``n`` states and the present inputs for the outputs, and the covariance left.

    Parameters
    ----------
    present : ndarray, shape (variates + others, inputs + outputs)
        Products of the present sample with the variates, and the rest of it.
    n, m : int
        States and inputs.
    """
    known = np.hstack([np.eye(len(present), n), present[:, :m]])
    weights = np.asarray(np.linalg.lstsq(known, present[:, m:], rcond=None)[0], dtype=float)
    left = present[:, m:] - known @ weights
    return weights, left.T @ left


def _check_regular(factor: NDArray[np.float64], channels: tuple[str, ...], what: str) -> None:
    """Raise where columns determine one another: their covariance has no inverse."""
    still, decision = null_basis(factor, rtol=np.sqrt(RANK), scale=1.0)
    if not still.size:
        return
    names = channels_in(still, channels, RANK)
    raise DataError(
        f"the covariance of {what} is singular (smallest spread {decision.singular_values[-1]:.2g} of a channel's): "
        f"{listed(names)} determine one another exactly, such as a channel that is there twice; leave one of them out"
    )


def _criteria_of_lags(gathered: Gathered, units: Standard) -> dict[int, float]:
    """Return Akaike's criterion of regressions on the past, for each number of lags that the rows suffice for."""
    q, m, most = len(gathered.channels), len(gathered.inputs), 1
    while most < _MOST_LAGS and count_windows(gathered, 2 * most + 2) > 2 * (most + 1) * q:
        most += 1
    stacked = lagged_rows(gathered, units, most)
    out: dict[int, float] = {}
    for lags in range(1, most + 1):
        columns = [*stacked.columns(range(1, lags + 1)), *stacked.columns(range(1))]
        factor = stacked.rearranged(columns) / np.sqrt(stacked.count)
        left = factor[lags * q + m :, lags * q + m :]
        value = _criterion(left.T @ left, stacked.count, (lags * q + m) * (q - m))
        if value is not None:
            out[lags] = value
    return out


def _criterion(covariance: NDArray[np.float64], count: int, parameters: int) -> float | None:
    r"""Return :math:`N \ln |\Sigma| + 2 \delta M`, or ``None`` where rows are too few for so many parameters.

    ``M`` counts those of the covariance as well, :math:`\delta = N / (N - (M / p + (p + 1) / 2))`.

    References
    ----------
    Hurvich and Tsai (1989); Larimore (1996).
    """
    p = len(covariance)
    total = parameters + p * (p + 1) / 2
    room = count - (total / p + (p + 1) / 2)
    if not room > 0:
        return None
    sign, logarithm = np.linalg.slogdet(covariance)
    if not sign > 0:
        return -np.inf
    return float(count * logarithm + 2 * total * count / room)


def _with_innovations(
    states: NDArray[np.float64], gains: NDArray[np.float64], covariance: NDArray[np.float64], m: int
) -> NDArray[np.float64]:
    """Return the weights of states and of the whitened innovations, shape (lags + 1, residuals, channels)."""
    lags, n, q = states.shape
    W = np.zeros((lags + 1, n + q - m, q))
    W[:lags, :n] = states
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors / np.sqrt(values)) @ vectors.T
    W[0, n:, m:] = root
    W[0, n:, :m] = -root @ gains[n:].T
    W[1:, n:] = -np.einsum("ij,ljc->lic", root @ gains[:n].T, states)
    return W
