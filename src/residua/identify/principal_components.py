"""Static and dynamic principal components of recorded channels: scores and residuals."""

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
    KNOWN,
    channel_generator,
    channels_in,
    few_rows,
    lagged_rows,
    names_of_groups,
    treated,
    with_signs,
)
from residua.identify.segments import Names, checked_count, gather
from residua.linear.subspaces.rank import RankDecision
from residua.tolerances import RANK
from residua.visible import echo, listed
from residua.words import counted

_METHOD = "principal components"
#: Rows for each column below which components are those of chance.
_ROWS_FOR_EACH = 3


@dataclass(frozen=True, eq=False, repr=False)
class PrincipalComponents:
    """Principal components of recorded channels, with the generator of their scores.

    Attributes
    ----------
    generator : ResidualGenerator
        The filter that a :class:`residua.Monitor` runs.
    test : NormThreshold
        The default test of a monitor: the norm of each group, as it is.
    groups : mapping of str to tuple of str
        ``"T2"`` and ``"Q"``, with the residuals of each.
    lags, components : int
    mean, spread : ndarray, shape (channels,)
        Of each channel, in its own units; of one that is differenced the spread of its changes.
    variances : ndarray, shape (d,)
        Of all components, largest first, in standard units: they add to ``d``, nearly so with lags.
    loadings : ndarray, shape (d, d)
        Their directions, as columns; rows are the channels that are not left out now, then one sample ago, and so on.
    samples : int
        Rows that they are from.
    drifts : mapping of str to str
        The treatment of each channel that drifts, or was named.
    """

    generator: ResidualGenerator
    test: NormThreshold = field(repr=False)
    groups: Mapping[str, tuple[str, ...]] = field(repr=False)
    lags: int
    components: int
    mean: NDArray[np.float64] = field(repr=False)
    spread: NDArray[np.float64] = field(repr=False)
    variances: NDArray[np.float64] = field(repr=False)
    loadings: NDArray[np.float64] = field(repr=False)
    samples: int
    drifts: Mapping[str, str] = field(repr=False)

    @property
    def channels(self) -> tuple[str, ...]:
        """Inputs, then outputs."""
        return self.generator.plant.outputs

    @property
    def explained(self) -> float:
        """Share of the variance that the components carry."""
        return float(self.variances[: self.components].sum() / self.variances.sum())

    def __repr__(self) -> str:
        return (
            f"PrincipalComponents({counted(self.components, 'component')} of {len(self.variances)}, "
            f"{100 * self.explained:.3g} % of the variance, {len(self.channels)} channels, {counted(self.lags, 'lag')})"
        )


def principal_components(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    lags: int = 0,
    components: int | float | None = None,
    drifts: str | Mapping[str, str] = "keep",
    dt: float | None = None,
) -> PrincipalComponents:
    r"""Return the principal components of fault-free recordings as a residual generator, without any model.

    .. math::

       x_k = [z_k, z_{k-1}, \dots, z_{k-L}], \quad z = \frac{\text{channel} - \text{mean}}{\text{standard deviation}},
       \qquad \frac{1}{N-1} \sum_k x_k x_k^T = P \Lambda P^T + \tilde P \tilde \Lambda \tilde P^T

    with the components :math:`P` of largest variance :math:`\Lambda`, and the rest. The residuals are of two groups:

    - ``T2``: the scores in units of their standard deviation, :math:`\Lambda^{-1/2} P^T x`; their sum of squares is
      :math:`T^2`, how unusual the operation is within what the channels do together.
    - ``Q``: the scores of the rest, :math:`\tilde P^T x`, in standard units and not scaled any more; their sum of
      squares is :math:`Q` (SPE), how far the channels leave what they do together.

    A :class:`residua.Monitor` without a test of its own tests :math:`T` and :math:`\sqrt Q` each against its threshold
    (``made.test``, which is ``NormThreshold(groups=made.groups, whiten="none")``). A test that whitens ``Q`` is another
    one: it weighs each direction by its own variance, so that those that hardly ever move count most.

    Guaranteed: the same bits when a channel has other units, as far as these differ by a power of two. The residual of
    a fault of a channel is exactly the filter's own response to that channel.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free; rows with a missing value cut them into segments.
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        Channels by name; all columns when omitted. Inputs have faults called ``"NAME actuator"``, outputs
        ``"NAME sensor"``.
    lags : int
        ``L``: samples before the present one that are looked at; 0 for static components.
    components : int or float, optional
        A whole number of components; or the share of the variance, between 0 and 1, that they carry at least. When
        omitted, those of more variance than the largest that ``N`` rows of ``d`` independent columns would show,
        :math:`(1 + \sqrt{d / N})^2`.
    drifts : {"keep", "leave out", "difference"} or mapping of str to these
        Treatment of channels that do not keep their level (:func:`residua.identify.drifting_channels`): nothing,
        besides a note with numbers; they are read by no residual, and have no fault, though they stay a column of the
        recordings; or they are read by their changes from row to row, which show their faults only while these change.
        A mapping says it for each channel by name, whether it drifts or not; those that it does not name are kept.
    dt : float, optional
        Step in seconds of arrays.

    Returns
    -------
    PrincipalComponents

    Raises
    ------
    DataError
        If a channel never changes, or there are no more rows than columns ``d = channels (lags + 1)``.
    SettingError
        If ``lags`` or ``components`` are out of range, or a channel is named twice.

    Notes
    -----
    Assumes: operation around one point, with means and covariances that last; what is learnt is what the recordings
    show, so that another load or another controller raises alarms. Thresholds are fitted by
    :meth:`residua.Monitor.fit`, best on other fault-free rows than these: the components fit their own rows better than
    any others.

    Faults are those of records: each moves its own channel only. One that acts back through the plant, such as a drift
    of a sensor in a control loop, moves others too, and is then named only as far as its own channel stands out.
    Isolation by direction (:class:`residua.decide.Directional`) is here the reconstruction of Dunia and Qin: the
    squared score is the part of the squared norm of the residual, averaged over its window, that the best
    reconstruction of one channel takes away, of all its lags together. It is unique where no two channels have the
    same direction in the space of the residuals; those that have are one group.

    References
    ----------
    Jackson and Mudholkar (1979), Technometrics 21(3), 341-349 (Q). Ku, Storer and Georgakis (1995), Chemometrics and
    Intelligent Laboratory Systems 30(1), 179-196 (lags). Dunia and Qin (1998), AIChE Journal 44(8), 1813-1831
    (reconstruction). Johnstone (2001), Annals of Statistics 29(2), 295-327, section 1 (largest variance of independent
    columns).

    See Also
    --------
    residua.identify.canonical_variates : components of the past that say most of the future.
    residua.identify.parity_from_data : relations between inputs and outputs.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> load = rng.standard_normal((1000, 1))
    >>> rows = load @ [[1.0, 2.0, -1.0]] + 0.1 * rng.standard_normal((1000, 3))
    >>> made = rs.identify.principal_components(rows[:500], outputs=["flow", "speed", "pressure"])
    >>> made
    PrincipalComponents(1 component of 3, 99.5 % of the variance, 3 channels, 0 lags)
    >>> monitor = rs.Monitor(made).fit(None, rows[500:])
    >>> rows[-50:, 1] += 2.0
    >>> monitor.run(None, rows[500:]).named
    (('speed sensor',),)
    """
    lags = checked_count(lags, "lags")
    channels = treated(gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt), drifts)
    gathered = channels.gathered
    stacked = lagged_rows(gathered, channels.units, lags)
    d, q = len(stacked.factor), stacked.channels
    if stacked.count < _ROWS_FOR_EACH * d:
        raise DataError(
            f"{counted(stacked.count, 'row')} for {d} columns ({q} channels, {lags} lags): components of so few rows "
            f"are those of chance; at least {_ROWS_FOR_EACH * d} are needed, and {KNOWN * d} for thresholds that can "
            "be trusted: give a longer recording, fewer lags, or fewer channels"
        )
    values, vectors = np.linalg.eigh(stacked.factor.T @ stacked.factor / (stacked.count - 1))
    variances, loadings = np.maximum(values[::-1], 0.0), with_signs(vectors[:, ::-1])
    edge = (1 + np.sqrt(d / stacked.count)) ** 2
    kept = _dimension(components, variances, edge)
    scale = np.ones(d)
    scale[:kept] = 1 / np.sqrt(variances[:kept])
    weights = (loadings * scale).T.reshape(d, lags + 1, q).transpose(1, 0, 2)
    groups = {"T2": kept} | ({"Q": d - kept} if kept < d else {})
    exact = np.flatnonzero(variances <= RANK)
    notes = few_rows(stacked.count, d)
    if len(exact):
        names = listed(channels_in(loadings[:, exact], gathered.channels, RANK))
        notes += (
            f"{counted(len(exact), 'combination')} of {names} never moved: these channels determine one another "
            "exactly (one may be there twice), and the smallest deviation from that counts in Q with its plain size",
        )
    evidence = Evidence(
        _METHOD if lags == 0 else f"dynamic {_METHOD}",
        ranks={"components": RankDecision(kept, variances, float(variances[kept - 1]))},
        conditions={"share of the variance": float(variances[:kept].sum() / variances.sum())},
        notes=notes,
        references=("Jackson and Mudholkar (1979)", "Ku, Storer and Georgakis (1995)", "Dunia and Qin (1998)"),
    )
    generator = channel_generator(channels, weights, groups, evidence)
    members = names_of_groups(generator)
    return PrincipalComponents(
        generator,
        NormThreshold(groups=members, whiten="none"),
        members,
        lags,
        kept,
        channels.mean,
        channels.spread,
        variances,
        loadings,
        stacked.count,
        channels.ways,
    )


def _dimension(components: object, variances: NDArray[np.float64], edge: float) -> int:
    """Return the number of components to keep."""
    d = len(variances)
    wanted = f"components must be a whole number from 1 to {d}, or a share of the variance between 0 and 1"
    if components is None:
        return max(1, int(np.count_nonzero(variances > edge)))
    if isinstance(components, bool) or not isinstance(components, (int, float, np.integer, np.floating)):
        raise SettingError(f"{wanted}, got {echo(components)}")
    if isinstance(components, (int, np.integer)):
        if not 1 <= components <= d:
            raise SettingError(f"{wanted}, got {echo(components)}")
        if not variances[int(components) - 1] > RANK:
            known = int(np.count_nonzero(variances > RANK))
            raise SettingError(f"only {known} of {d} components move at all: ask for {known} at most")
        return int(components)
    if not 0 < components < 1:
        raise SettingError(f"{wanted}, got {echo(components)}")
    shares = np.cumsum(variances) / variances.sum()
    return min(int(np.count_nonzero(shares < components)) + 1, int(np.count_nonzero(variances > RANK)))
