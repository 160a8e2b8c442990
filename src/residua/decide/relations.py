"""Relations of recorded channels: each from the others without its own past, or outputs predicted further ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.multiscale_fit import averaged
from residua.errors import DataError
from residua.linear import StateSpace
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import NumberKind
from residua.records import Record
from residua.tolerances import DATA_ROUNDING, TINY
from residua.words import counted

STATIC, CURVE, LAGS, HORIZON = "static", "curve", "lags", "horizon"
#: In the order in which one is preferred to the next.
FORMS = (STATIC, CURVE, LAGS, HORIZON)
#: Weights of the means of other channels that a relation with lags reads beside their present values.
LAG_WEIGHTS = (1 / 4, 1 / 16, 1 / 64)
#: Rows after which the slowest mean has forgotten the first one, to 5 %.
_FORGOTTEN = round(3 / min(LAG_WEIGHTS))
#: Contiguous parts of the rows, each of which is predicted by a fit to the others.
_FOLDS = 5
#: Penalties of ridge regression, in parts of the rows.
_PENALTIES = tuple(10.0**-k for k in (5, 4, 3, 2, 1))
#: Knots of a curve.
_KNOTS = 13
#: Rows ahead of a prediction over a horizon, and its largest response to an innovation of one.
_AHEAD, _EXPLODES = 50, 1e3
#: Least saving of the error by a second driver, number of drivers tried, and the least scale of a curve in parts of it.
_SAVES, _TRIED, _LEAST_SCALE = 0.03, 10, 0.14
#: Deviations that a relation outside of the learnt range may add before it is not judged.
_OUTSIDE = 2.0
_DRIVER = NumberKind("a whole number, -1 or more", "i", lambda n: n >= -1)


@dataclass(frozen=True, eq=False)
class RelationsState:
    """State of relations between two blocks.

    ``averages`` (plants, weights, channels) of relations with lags, ``rows`` (plants,) how many they are of, and
    ``innovations`` (plants, ahead, residuals) of a prediction over a horizon, the latest last.
    """

    averages: NDArray[np.float64]
    rows: NDArray[np.int64]
    innovations: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Relations(Record):
    """Fitted relations of channels.

    Attributes
    ----------
    form : str
    middle, spread : ndarray, shape (channels,)
        ``z`` is the deviation from the middle in spreads; a channel of spread zero never moved, and is left out.
    constant : ndarray, shape (channels,)
    gains : ndarray, shape (channels or 4 channels, channels)
        By column the weights for each channel: of the others, and of their means with lags. No rows in other forms.
    drivers : ndarray of int, shape (channels, 2)
        Of a curve the channels that it is a curve of; -1 for none.
    knots : ndarray, shape (channels, knots)
    curves : ndarray, shape (channels, 2, knots)
    scales : ndarray, shape (channels, knots)
        Deviation of the channel around the curve at each knot of its first driver.
    ahead : ndarray, shape (rows, residuals, residuals)
        Of a horizon: effect of an innovation on outputs 1, 2, ... rows later.
    outputs : ndarray of int, shape (residuals,)
        The channel of each residual, for a horizon.
    lows, highs : ndarray, shape (channels,) or (4 channels,)
        Learnt range of each channel, in spreads; with lags, of their means too.
    reach : ndarray, shape (channels, channels) or (channels, 4 channels)
        By row how much a channel's relation is moved by each driver one spread outside of that range, in parts of what
        is borne.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"drivers": _DRIVER}

    form: str
    middle: NDArray[np.float64]
    spread: NDArray[np.float64]
    constant: NDArray[np.float64]
    gains: NDArray[np.float64]
    drivers: NDArray[np.int64]
    knots: NDArray[np.float64]
    curves: NDArray[np.float64]
    scales: NDArray[np.float64]
    ahead: NDArray[np.float64]
    outputs: NDArray[np.int64]
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    reach: NDArray[np.float64]

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Mask of channels that are judged."""
        if self.form == HORIZON:
            return np.isin(np.arange(len(self.spread)), self.outputs) & (self.spread > 0)
        return self.spread > 0

    def start(self, plants: int, *, settled: bool = False) -> RelationsState:
        """Return the state before the first row; ``settled`` starts the means at the middle."""
        q, lagged = len(self.spread), len(LAG_WEIGHTS) if self.form == LAGS else 0
        return RelationsState(
            np.zeros((plants, lagged, q)),
            np.full(plants, _FORGOTTEN if settled else 0),
            np.zeros((plants, *self.ahead.shape[:2])),
        )

    def run(
        self, state: RelationsState, signals: NDArray[np.float64], innovations: NDArray[np.float64]
    ) -> tuple[RelationsState, NDArray[np.float64]]:
        """Return the residual of each channel, (plants, time, channels); NaN where it is not judged.

        Parameters
        ----------
        state : RelationsState
        signals : ndarray, shape (plants, time, channels)
        innovations : ndarray, shape (plants, time, residuals)
            NaN where they are not known.
        """
        z = features = _in_spreads(signals, self.middle, self.spread)
        judged = self.moving
        if self.form == HORIZON:
            state, residuals = self._over_horizon(state, innovations)
        elif self.form == CURVE:
            residuals = self._off_curves(z)
        else:
            if self.form == LAGS:
                rows = state.rows[:, None] + np.cumsum(np.isfinite(z).all(axis=2), axis=1)
                judged = judged & (rows[..., None] >= _FORGOTTEN)  # before, the means are of the first row
                state, features = self._with_lags(state, z)
            residuals = z - self.constant - ordered_product(features, self.gains)
        beyond = np.maximum(np.maximum(self.lows - features, features - self.highs), 0.0)
        within = ordered_product(np.where(np.isfinite(beyond), beyond, 0.0), self.reach.T) <= 1.0
        return state, np.where(judged & within, residuals, np.nan)

    def _with_lags(self, state: RelationsState, z: NDArray[np.float64]) -> tuple[RelationsState, NDArray[np.float64]]:
        """Return channels beside their means; rows with a missing value change none of these.

        Values enter the means no further outside of the range of the fit than it is wide, so as to be forgotten again.
        """
        plants, time, q = z.shape
        low, high = self.lows[:q], self.highs[:q]
        entering = np.clip(z, 2 * low - high, 2 * high - low)
        complete = np.asarray(np.isfinite(z).all(axis=2))
        means = np.repeat(state.averages[:, None], time, axis=1)
        averages, count = state.averages.copy(), state.rows.copy()
        for plant in range(plants):
            at = np.flatnonzero(complete[plant])
            if not at.size:
                continue
            if not count[plant]:
                averages[plant] = entering[plant, at[0]]
            latest = np.maximum.accumulate(np.where(complete[plant], np.arange(time), -1))
            rows = np.cumsum(complete[plant])[latest] - 1
            for k, weight in enumerate(LAG_WEIGHTS):
                after, last = averaged(weight, averages[plant, k][None], entering[plant, at][None])
                means[plant, :, k] = np.where((latest >= 0)[:, None], after[0][rows], averages[plant, k])
                averages[plant, k] = last[0]
            count[plant] += len(at)
        features = np.concatenate([z, means.reshape(plants, time, len(LAG_WEIGHTS) * q)], axis=2)
        return replace(state, averages=averages, rows=count), features

    def _off_curves(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the deviation of each channel from its curve, in deviations there."""
        residuals = np.full(z.shape, np.nan)
        for i, (first, second) in enumerate(self.drivers.tolist()):
            if first < 0:
                continue
            off = z[..., i] - np.interp(z[..., first], self.knots[first], self.curves[i, 0])
            if second >= 0:
                off = off - np.interp(z[..., second], self.knots[second], self.curves[i, 1])
            residuals[..., i] = off / np.interp(z[..., first], self.knots[first], self.scales[i])
        return residuals

    def _over_horizon(
        self, state: RelationsState, innovations: NDArray[np.float64]
    ) -> tuple[RelationsState, NDArray[np.float64]]:
        """Return the errors of predictions so many rows ahead; an unknown innovation counts as zero."""
        complete = np.asarray(np.isfinite(innovations).all(axis=2))
        e = np.where(complete[..., None], innovations, 0.0)
        past, rows = len(self.ahead), e.shape[1]
        whole = np.concatenate([state.innovations, e], axis=1)
        errors = e.copy()
        for j, gain in enumerate(self.ahead, 1):
            errors += ordered_product(whole[:, past - j : past - j + rows], gain.T)
        residuals = np.full((*complete.shape, len(self.spread)), np.nan)
        residuals[..., self.outputs] = np.where(complete[..., None], errors, np.nan)
        return replace(state, innovations=whole[:, len(whole[0]) - past :].copy()), residuals


# ------------------------------------------------------------------------------ fitting


def fit_relations(
    form: str,
    signals: NDArray[np.float64],
    innovations: NDArray[np.float64],
    recordings: Sequence[slice],
    system: StateSpace,
    inputs: int,
) -> tuple[Relations, NDArray[np.float64]]:
    """Fit relations to fault-free rows, and return them with the residuals of each row by a fit to the others.

    Parameters
    ----------
    form : {"static", "curve", "lags", "horizon"}
    signals : ndarray, shape (time, channels)
        NaN in rows that are not to be used.
    innovations : ndarray, shape (time, residuals)
    recordings : sequence of slice
    system : StateSpace
        The generator, for a horizon.
    inputs : int
        Channels that are inputs, the first ones.

    Returns
    -------
    relations : Relations
    residuals : ndarray, shape (time, channels)

    Raises
    ------
    DataError
        If there are too few rows, or a horizon is asked for of a model whose prediction explodes.
    """
    used = np.asarray(np.isfinite(signals).all(axis=1))
    count, q = int(used.sum()), signals.shape[1]
    if count < 4 * q + 2 * _KNOTS:
        raise DataError(f"relations of {counted(q, 'channel')} need more than {count} complete rows")
    rows = signals[used]
    middle, spread = rows.mean(axis=0), rows.std(axis=0)
    spread = np.where(spread > DATA_ROUNDING * np.abs(rows).max(axis=0), spread, 0.0)
    z = _in_spreads(rows, middle, spread)
    blank = Relations(
        form, middle, spread, np.zeros(q), np.zeros((0, q)), np.full((q, 2), -1),
        np.tile(np.arange(_KNOTS * 1.0), (q, 1)),
        np.zeros((q, 2, _KNOTS)), np.ones((q, _KNOTS)), np.zeros((0, 0, 0)), np.zeros(0, np.int64),
        z.min(axis=0), z.max(axis=0), np.zeros((q, q)),
    )  # fmt: skip
    if form == HORIZON:
        size = np.sqrt(np.nanmean(innovations[used] ** 2, axis=0))
        relations = replace(blank, ahead=_ahead(system, inputs, size), outputs=_outputs_of(system, inputs))
        residuals = np.concatenate(
            [relations.run(relations.start(1), signals[None, p], innovations[None, p])[1][0] for p in recordings]
        )
        return relations, np.where(used[:, None], residuals, np.nan)
    features = z
    if form == LAGS:
        whole = _in_spreads(signals, middle, spread)
        parts = [blank._with_lags(blank.start(1), whole[None, p])[1][0] for p in recordings]
        features = np.concatenate(parts)[used]
    folds = np.minimum(np.arange(count) * _FOLDS // count, _FOLDS - 1)
    fitted, off = _curves(z, folds) if form == CURVE else _regressions(features, z, folds)
    residuals = np.full(signals.shape, np.nan)
    residuals[used] = off
    return replace(blank, **fitted), np.where(spread > 0, residuals, np.nan)


def _in_spreads(
    signals: NDArray[np.float64], middle: NDArray[np.float64], spread: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return deviations from the middle in spreads; zero for a channel that was constant in the data."""
    return np.where(spread > 0, (signals - middle) / np.where(spread > 0, spread, 1.0), 0.0)


def _normal_equations(
    basis: NDArray[np.float64], targets: NDArray[np.float64], folds: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the products of a basis with itself and with targets, of each fold."""
    parts = [(basis[folds == f], targets[folds == f]) for f in range(_FOLDS)]
    return np.array([rows.T @ rows for rows, _ in parts]), np.array([rows.T @ one for rows, one in parts])


def _regressions(
    features: NDArray[np.float64], z: NDArray[np.float64], folds: NDArray[np.int64]
) -> tuple[dict[str, NDArray], NDArray[np.float64]]:
    """Return each channel regressed on features of the others, with a cross-validated ridge penalty."""
    count, q = z.shape
    ones = np.hstack([np.ones((count, 1)), features])
    grams, right = _normal_equations(ones, z, folds)
    owner = np.concatenate([[-1], np.arange(features.shape[1]) % q])
    constant, gains, off = np.zeros(q), np.zeros((features.shape[1], q)), np.zeros((count, q))
    total, whole = grams.sum(axis=0), right.sum(axis=0)
    moving = np.concatenate([[True], np.diag(total)[1:] > 0])
    for i in range(q):
        mine = np.flatnonzero((owner != i) & moving)
        square, penalised = np.ix_(mine, mine), np.diag((mine > 0) * 1.0)
        best = np.inf
        for penalty in _PENALTIES:
            ridge = penalty * count * penalised
            errors = np.empty(count)
            for f in range(_FOLDS):
                weights = np.linalg.solve((total - grams[f])[square] + ridge, (whole - right[f])[mine, i])
                errors[folds == f] = z[folds == f, i] - ones[folds == f][:, mine] @ weights
            error = float(errors @ errors)
            if error < best:
                best, off[:, i] = error, errors
                weights = np.linalg.solve(total[square] + ridge, whole[mine, i])
                constant[i], gains[:, i] = weights[0], 0.0
                gains[mine[1:] - 1, i] = weights[1:]
    size = np.sqrt(np.mean(off**2, axis=0))
    reach = np.abs(gains).T / (_OUTSIDE * np.where(size > 0, size, 1.0))[:, None]
    ranges = {"lows": features.min(axis=0), "highs": features.max(axis=0)}
    return {"constant": constant, "gains": gains, "reach": reach, **ranges}, off


def _curves(z: NDArray[np.float64], folds: NDArray[np.int64]) -> tuple[dict[str, NDArray], NDArray[np.float64]]:
    """Return each channel as a piecewise linear curve of one other, or a sum of two, chosen by cross-validation."""
    count, q = z.shape
    knots = [np.unique(np.quantile(z[:, j], np.linspace(0, 1, _KNOTS))) for j in range(q)]
    # weights of the knots in piecewise linear interpolation, a row for each value
    hats = [np.stack([np.interp(z[:, j], at, one) for one in np.eye(len(at))], axis=1) for j, at in enumerate(knots)]
    alone = np.full((q, q), np.inf)
    for j in range(q):
        if len(knots[j]) > 1:
            alone[:, j] = np.mean(_cross_validated(hats[j], z, folds)[0] ** 2, axis=0)
    np.fill_diagonal(alone, np.inf)
    drivers, curves, scales = np.full((q, 2), -1), np.zeros((q, 2, _KNOTS)), np.ones((q, _KNOTS))
    off, reach = np.full((count, q), np.nan), np.zeros((q, q))
    for i in range(q):
        if len(knots[i]) < 2 or not np.isfinite(alone[i]).any():
            continue
        order = np.argsort(alone[i], kind="stable")
        first = int(order[0])
        chosen, (errors, weights) = [first], _cross_validated(hats[first], z[:, [i]], folds)
        best = alone[i, first]
        for other in order[1 : 1 + _TRIED].tolist():
            if np.isfinite(alone[i, other]):
                found = _cross_validated(np.hstack([hats[first], hats[other]]), z[:, [i]], folds)
                error = float(np.mean(found[0] ** 2))
                if error < min(best, alone[i, first] * (1 - _SAVES) ** 2):
                    best, chosen, (errors, weights) = error, [first, other], found
        e, at = errors[:, 0], np.split(weights[:, 0], [len(knots[first])])
        whole = float(np.sqrt(np.mean(e**2)))
        near = np.sqrt(hats[first].T @ e**2 / np.maximum(hats[first].sum(axis=0), TINY))
        scale = np.maximum(near, max(_LEAST_SCALE * whole, TINY))
        scales[i] = _padded(scale)
        off[:, i] = e / np.interp(z[:, first], knots[first], scale)
        for k, j in enumerate(chosen):
            drivers[i, k], curves[i, k] = j, _padded(at[k])
            ends = np.abs(np.diff(at[k]) / np.diff(knots[j]))[[0, -1]]
            reach[i, j] = ends.max() / (_OUTSIDE * max(whole, TINY))
    grid = np.array([_padded(values, 1.0) for values in knots])
    return {"drivers": drivers, "knots": grid, "curves": curves, "scales": scales, "reach": reach}, off


def _padded(values: NDArray[np.float64], step: float = 0.0) -> NDArray[np.float64]:
    """Return values at all knots for a channel with fewer: the last repeated, each a step further."""
    more = _KNOTS - len(values)
    return np.concatenate([values, values[-1] + step * np.arange(1, more + 1)])


def _cross_validated(
    basis: NDArray[np.float64], targets: NDArray[np.float64], folds: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return cross-validated least-squares errors of targets, fold by fold, and the weights of all rows."""
    grams, right = _normal_equations(basis, targets, folds)
    total, whole, ridge = grams.sum(axis=0), right.sum(axis=0), DATA_ROUNDING * len(basis) * np.eye(basis.shape[1])
    errors = np.empty_like(targets)
    for f in range(_FOLDS):
        weights = np.linalg.solve(total - grams[f] + ridge, whole - right[f])
        errors[folds == f] = targets[folds == f] - basis[folds == f] @ weights
    return errors, np.linalg.solve(total + ridge, whole)


def _ahead(system: StateSpace, inputs: int, size: NDArray[np.float64]) -> NDArray[np.float64]:
    r"""Return :math:`C A^{j-1} K`, the effect of an observer's innovation on the outputs j rows later.

    ``size`` is that of the innovations: an answer to one of that size is held against it.
    """
    gain, C = system.B[:, inputs:], -system.C
    A, row, out = system.A + gain @ C, C, []
    for _ in range(_AHEAD - 1):
        out.append(row @ gain)
        row = row @ A
    ahead = np.array(out).reshape(_AHEAD - 1, len(C), gain.shape[1])
    size = np.where(size > 0, size, 1.0)
    largest = float((np.abs(ahead) * size / size[:, None]).max(initial=0.0))
    if not largest < _EXPLODES:
        raise DataError(f"a prediction {_AHEAD} rows ahead explodes, to {largest:.2g} for an innovation of one")
    return ahead


def _outputs_of(system: StateSpace, inputs: int) -> NDArray[np.int64]:
    """Return the channel of each residual of a filter whose residuals are outputs less their predictions."""
    now = system.D[:, inputs:]
    if now.shape[0] != now.shape[1] or not np.array_equal(now, np.eye(len(now))):
        raise DataError("a horizon needs residuals that are outputs less their predictions, as of a Kalman filter")
    return inputs + np.arange(len(now))
