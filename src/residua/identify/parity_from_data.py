"""Parity relations straight from recorded inputs and outputs, by the null space of their Hankel matrices."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import runs
from residua.decide.alarm import Alarm
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator
from residua.errors import DataError, SettingError
from residua.identify.channel_facts import ChannelFacts, channel_facts
from residua.identify.channel_filter import (
    KEEP,
    LaggedRows,
    Standard,
    Treated,
    channel_generator,
    channels_in,
    enough_windows,
    few_rows,
    lagged_of,
    treated,
    untreated,
)
from residua.identify.hankel_factor import HankelFactor, count_windows, discounted_factor
from residua.identify.segments import Gathered, Names, checked_count, gather
from residua.linear.subspaces.rank import RankDecision, null_basis
from residua.progress import Progress, progress_of
from residua.recording.time_axis import REGULAR
from residua.tolerances import DATA_ROUNDING, SAME
from residua.visible import echo, listed
from residua.words import counted

#: A combination is a relation if what the past says of it has no more than this many times the variance of chance; the
#: windows overlap, so that chance alone reaches some times its plain value.
_CHANCE = 10.0
#: A gap of the correlations below this factor is no clear one.
_CLEAR = 2.0
_METHOD = "parity relations from data"
#: The alarms of one recording: for each row whether one stands, or the alarms of a diagnosis.
Alarms = ArrayLike | Sequence[Alarm] | None


@dataclass(frozen=True, eq=False, repr=False)
class DataParity:
    r"""Parity relations that recorded inputs and outputs obey, with the generator of their residuals.

    Attributes
    ----------
    generator : ResidualGenerator
        The filter that a :class:`residua.Monitor` runs.
    order : int
        ``s``: samples before the present one in each relation.
    relations : int
    supported : int
        Relations that the data support.
    correlations : ndarray
        For each combination of the ``s + 1`` samples how well past and inputs foretell it, largest first: 1 for inputs
        and states, that of chance for relations.
    vectors : ndarray, shape (relations, s + 1, channels)
        The relations, orthonormal in standard units: weights of ``z[k], z[k-1], ...``, inputs first, without channels
        that are left out.
    mean, spread : ndarray, shape (channels,)
        Of each channel, in its own units; of one that is differenced the spread of its changes.
    samples : int
        Windows that they are from; after forgetting, as many as are worth as much.
    memory : ParityMemory
        The state from which :meth:`updated` goes on.
    drifts : mapping of str to str
        The treatment of each channel that drifts, or was named.
    """

    generator: ResidualGenerator
    order: int
    relations: int
    supported: int
    correlations: NDArray[np.float64] = field(repr=False)
    vectors: NDArray[np.float64] = field(repr=False)
    mean: NDArray[np.float64] = field(repr=False)
    spread: NDArray[np.float64] = field(repr=False)
    samples: int
    memory: ParityMemory = field(repr=False)
    drifts: Mapping[str, str] = field(repr=False)

    def updated(
        self,
        recordings: Any,
        y: ArrayLike | None = None,
        *,
        forgetting: float = 1.0,
        alarms: Alarms | Sequence[Alarms] = None,
    ) -> DataParity:
        r"""Return the relations after more recordings, with those before them forgotten little by little.

        .. math:: R^T R \leftarrow \lambda R^T R + h h^T

        for every new window ``h`` of one and the signals ``z[k], z[k-1], ...``: the triangular factor of the Hankel
        matrix is all that is kept of the past, so that the work is that of the new rows. The relations are those of the
        weighted data; their number is the same as before, and a note says where the data now support another. They are
        orthonormal in the new standard deviations, which are weighted likewise.

        Guaranteed: with ``forgetting=1``, the relations of all recordings together.

        Parameters
        ----------
        recordings : Recording, data frame, path, array, pair (u, y), or a list of these
            With the same channels; an array holds the inputs, then the outputs.
        y : array_like, shape (time, outputs), optional
        forgetting : float
            The weight :math:`\lambda` that a window keeps with each new one: some :math:`2 / (1 - \lambda)` windows are
            remembered in the end. Windows that are left out forget nothing.
        alarms : array_like of bool, sequence of Alarm, or a sequence of these, optional
            For each row whether an alarm stands, or ``diagnosis.alarms``, which count from the earliest time at which
            their cause may have begun (from the first row where that is not known); one entry for each recording
            where there are several. What stands in alarm is left out as if it was missing, with every window that
            overlaps it.

        Returns
        -------
        DataParity
            A new one; a monitor of it is fitted as that of any other design.

        Raises
        ------
        DataError
            If a channel is missing, the step is another, a channel no longer changes, or too little is remembered for
            relations of this order.
        SettingError
            If ``forgetting`` or ``alarms`` are none, or a channel was left out or differenced (``drifts``).

        Notes
        -----
        A fault that raises no alarm is learnt as normal, the sooner the more is forgotten.

        References
        ----------
        Golub and Van Loan (2013), Matrix Computations, 4th edition, section 6.5 (updates of triangular factors); Naik,
        Yin, Ding and Zhang (2010), Journal of Process Control 20(8) (recursive identification of parity spaces).

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> rng = np.random.default_rng(0)
        >>> def day(pole):
        ...     u, y = rng.standard_normal((2000, 1)), np.zeros((2000, 1))
        ...     for k in range(1, 2000):
        ...         y[k] = pole * y[k - 1] + u[k - 1] + 0.1 * rng.standard_normal()
        ...     return u, y
        >>> made = rs.identify.parity_from_data(*day(0.8), order=1)
        >>> later = made.updated(*day(0.6), forgetting=0.995)
        >>> for one in (made, later):
        ...     relation = one.vectors[0] / one.spread
        ...     print((-relation[1, 1] / relation[0, 1]).round(1))
        0.8
        0.6
        """
        memory = self.memory
        number = isinstance(forgetting, (int, float, np.integer, np.floating)) and not isinstance(forgetting, bool)
        if not number or not 0 < forgetting <= 1:
            raise SettingError(
                f"forgetting must be above 0 and at most 1 (nothing is forgotten), got {echo(forgetting)}"
            )
        other = [name for name, way in self.drifts.items() if way != KEEP]
        if other:
            raise SettingError(
                f"relations in which {listed(other)} is left out or differenced are not updated: make them anew "
                "from the recordings before and these together"
            )
        gathered = gather(recordings, y, inputs=memory.inputs, outputs=memory.outputs)
        if gathered.timed and abs(gathered.dt - memory.dt) > REGULAR * memory.dt:
            raise DataError(f"the relations have a step of {memory.dt:g} s, the recordings have {gathered.dt:g} s")
        gathered, left_out = without_alarms(replace(gathered, dt=memory.dt), alarms)
        notes = (f"{counted(left_out, 'row')} in alarm left out of the update",) if left_out else ()
        if not count_windows(gathered, memory.hankel.length):
            note = f"nothing was learnt: no {memory.hankel.length} rows in a row that are complete and without an alarm"
            evidence = self.generator.evidence.extended(notes=(*notes, note))
            return replace(self, generator=replace(self.generator, evidence=evidence))
        facts = channel_facts(gathered)
        facts.check_size()
        after = memory.updated(gathered, float(forgetting))
        units = after.standard(facts)
        kept = replace(untreated(gathered, units), ways=self.drifts)
        # as many rows as the weights are worth
        known = after.windows.effective
        stacked = lagged_of(after.hankel, units, round(known))
        stacked = replace(stacked, factor=stacked.factor * np.sqrt(known / after.windows.total))
        relations = _parity(after, kept, stacked, self.relations, notes)
        if relations.supported <= relations.relations:  # where it is less, there is a note already
            return relations
        supported = counted(relations.supported, "relation")
        note = f"the data now support {supported}, and {relations.relations} are kept as before"
        evidence = relations.generator.evidence.extended(notes=(note,))
        return replace(relations, generator=replace(relations.generator, evidence=evidence))

    def __repr__(self) -> str:
        return (
            f"DataParity({counted(self.relations, 'relation')} of order {self.order}, {self.supported} supported, "
            f"{len(self.generator.plant.outputs)} channels)"
        )


def parity_from_data(
    recordings: Any,
    y: ArrayLike | None = None,
    *,
    inputs: Names = None,
    outputs: Names = None,
    order: int = 8,
    relations: int | None = None,
    poles: Sequence[complex] | None = None,
    drifts: str | Mapping[str, str] = "keep",
    dt: float | None = None,
    progress: Progress | bool | None = None,
) -> DataParity:
    r"""Return parity relations of fault-free recordings as a residual generator, without a model in between.

    .. math::

       r_k = \sum_{i=0}^{s} \left( \alpha_i\, z_{k-i} \right), \qquad
       \alpha \begin{bmatrix} U_f \\ Y_f \end{bmatrix} \Pi = 0

    with the Hankel matrices of ``s + 1`` samples of inputs and outputs, less their means and in standard deviations,
    and the projection :math:`\Pi` onto as many samples before them and the inputs, which takes out what noise adds.
    The rows of :math:`\alpha` are the data-driven form of the stable kernel representation. Of all combinations those
    are chosen of which past and inputs say least, relative to their variance: the smallest canonical correlations.
    With ``poles`` the residual is :math:`r_k / d(q^{-1})`: what a diagnostic observer of order ``s`` with these poles
    gives,

    .. math::

       x_{j,k+1} = x_{j+1,k} + \alpha_j z_k - d_j r_k, \quad j = 1, \dots, s, \qquad r_k = x_{1,k} + \alpha_0 z_k,

    whose state follows a map of the plant's, whatever both start from.

    Guaranteed: without noise and with inputs that excite the plant, the relations span all of order ``s`` that the
    model has, :math:`p (s + 1) - n` of them. The same bits when a channel has other units, as far as these differ by a
    power of two.

    Parameters
    ----------
    recordings : Recording, data frame, path, array, pair (u, y), or a list of these
        Fault-free; rows with a missing value cut them into segments.
    y : array_like, shape (time, outputs), optional
    inputs, outputs : sequence of str, optional
        Channels by name; without inputs all columns are outputs.
    order : int
        ``s``, at least the order of the plant, or of the part of it that a relation is to describe.
    relations : int, optional
        Number, those that hold best first; when omitted, all that the data support: those whose correlation
        with past and inputs is that of chance.
    poles : sequence of complex, optional
        ``order`` stable poles, closed under conjugation, that all residuals have; all zero, the moving average, when
        omitted.
    drifts : {"keep", "leave out", "difference"} or mapping of str to these
        Treatment of channels that do not keep their level (:func:`residua.identify.drifting_channels`): nothing,
        besides a note with numbers; they are read by no residual, and have no fault, though they stay a column of the
        recordings; or they are read by their changes from row to row, which show their faults only while these change.
        A mapping says it for each channel by name, whether it drifts or not; those that it does not name are kept.
        Relations among channels that wander together hold, so that keeping them is right where the inputs move them.
    dt : float, optional
        Step in seconds of arrays.
    progress : callable, bool, optional
        Is called with (stage, done, total); a bar on a terminal when omitted.

    Returns
    -------
    DataParity

    Raises
    ------
    DataError
        If a channel never changes, inputs determine one another, there are no more rows than columns
        ``2 (s + 1) channels``, or the data support no relation.
    SettingError
        If ``order``, ``relations`` or ``poles`` are out of range, or a channel is named twice.

    Notes
    -----
    Assumes: a linear plant around one point; noise of the ``s + 1`` samples that those before do not foretell, and
    inputs that do not depend on it: in a closed loop the relations are biased by what the controller feeds back.
    Thresholds are fitted by :meth:`residua.Monitor.fit`.

    A fault of an actuator, ``"NAME actuator"``, and of a sensor, ``"NAME sensor"``, moves the residual exactly as the
    column of its channel says, whatever the plant does: of the inputs what is recorded is what was asked for. In a
    closed loop that holds too, since the relation holds for whatever the inputs become.

    References
    ----------
    Ding (2014), Data-driven Design of Fault Diagnosis and Fault-tolerant Control Systems, Springer, chapter 9 (stable
    kernel representation from data), chapter 10 (observers from parity vectors). Wang, Gao and Qin (2005), IFAC
    World Congress (order of parity spaces from data).

    See Also
    --------
    DataParity.updated : recursive updates with forgetting, for a plant that changes slowly.
    residua.design.parity_relations : from a model.
    residua.identify.canonical_variates : the states besides.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9, 0.2], [0, 0.7]], [[0], [1.0]], [[1.0, 0], [1, 1]], dt=1, inputs=["valve"])
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal((3000, 1))
    >>> y = plant.system().simulate(u) + 0.05 * rng.standard_normal((3000, 2))
    >>> made = rs.identify.parity_from_data(u, y, inputs=["valve"], outputs=["a", "b"], order=3)
    >>> made
    DataParity(6 relations of order 3, 6 supported, 3 channels)
    >>> monitor = rs.Monitor(made).fit(None, np.hstack([u, y]))
    """
    s = checked_count(order, "order", 1)
    _denominator(poles, s)
    channels = treated(gather(recordings, y, inputs=inputs, outputs=outputs, dt=dt), drifts)
    tell, close = progress_of(progress)
    try:
        hankel = enough_windows(channels.gathered, channels.units, 2 * s + 1, tell)
        stacked = lagged_of(hankel, channels.units, hankel.windows)
        gathered, count, rows = channels.gathered, float(hankel.windows), float(channels.gathered.n_samples)
        memory = ParityMemory(
            replace(hankel, parts=()),
            Weights(count, count),
            Weights(rows, rows),
            channels.units.mean,
            channels.units.facts.deviation**2 * rows,
            gathered.inputs,
            gathered.outputs,
            gathered.dt,
            None if poles is None else tuple(complex(one) for one in np.atleast_1d(np.asarray(poles, dtype=complex))),
        )
        return _parity(memory, channels, stacked, relations, tell=tell)
    finally:
        close()


@dataclass(frozen=True, eq=False)
class Weights:
    """The sum of weights, and of their squares: both the number of items where all weights are one."""

    total: float
    squares: float

    @property
    def effective(self) -> float:
        """Number of equal weights that would know a mean as well."""
        return self.total**2 / self.squares

    def and_new(self, count: int, forgetting: float) -> Weights:
        """Return the weights after so many new ones, the last of which is one."""
        new = forgetting ** np.arange(count)
        old = forgetting**count
        return Weights(old * self.total + float(new.sum()), old**2 * self.squares + float((new**2).sum()))


@dataclass(frozen=True, eq=False)
class ParityMemory:
    r"""The factor of all windows so far, each with the weight that forgetting leaves it, and the channels' moments.

    .. math:: R^T R = \sum_k \lambda^{K - k} h_k h_k^T

    Attributes
    ----------
    hankel : HankelFactor
        ``R``, with the units and the reference of the first recordings.
    windows, rows : Weights
    mean, scatter : ndarray, shape (channels,)
        Weighted mean of each channel, and the sum of weighted squares about it.
    inputs, outputs : tuple of str
    dt : float
    poles : tuple of complex or None
        Of the residuals.
    """

    hankel: HankelFactor
    windows: Weights
    rows: Weights
    mean: NDArray[np.float64]
    scatter: NDArray[np.float64]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    poles: tuple[complex, ...] | None

    def standard(self, facts: ChannelFacts) -> Standard:
        """Return mean and standard deviation of each channel over all that is remembered.

        Raises
        ------
        DataError
            If a channel no longer changes.
        """
        known = self.rows.effective
        spread = np.sqrt(self.scatter / self.rows.total * known / (known - 1))
        channels = self.inputs + self.outputs
        still = [
            name
            for name, one, mean in zip(channels, spread, self.mean, strict=True)
            if one <= DATA_ROUNDING * abs(mean)
        ]
        if still:
            raise DataError(
                f"{listed(still)} no longer {'changes' if len(still) == 1 else 'change'} in what is remembered: take a "
                "forgetting nearer to 1, or a recording in which they move"
            )
        return Standard(facts, self.mean, spread)

    def updated(self, gathered: Gathered, forgetting: float) -> ParityMemory:
        """Return the memory after new rows: each window takes ``forgetting`` of the weight of those before it.

        Raises
        ------
        DataError
            If what is remembered is worth fewer windows than the relations have columns.
        """
        length = self.hankel.length
        new = count_windows(gathered, length)
        windows = self.windows.and_new(new, forgetting)
        columns = length * self.hankel.n_channels
        if windows.effective <= columns + 1:
            raise DataError(
                f"with forgetting={forgetting:g} {counted(round(windows.effective), 'window')} are remembered, and "
                f"relations over {length} rows of {self.hankel.n_channels} channels need more than {columns + 1}: take "
                f"at least {1 - 2 / (columns + 3):.6g}, or {1 - 2 / (10 * columns):.6g} to know them well"
            )
        hankel = discounted_factor(self.hankel, gathered, forgetting)
        count, seen = gathered.n_samples, 0
        first, second = np.zeros_like(self.mean), np.zeros_like(self.mean)  # moments about the mean before
        for *_, block in gathered.blocks():
            seen += len(block)
            weights = forgetting ** (count - seen + np.arange(len(block) - 1, -1, -1))
            apart = block - self.mean
            first += weights @ apart
            second += weights @ apart**2
        rows = self.rows.and_new(count, forgetting)
        scatter = forgetting**count * self.scatter + second - first**2 / rows.total
        mean = self.mean + first / rows.total
        return replace(self, hankel=hankel, windows=windows, rows=rows, mean=mean, scatter=np.maximum(scatter, 0.0))


def without_alarms(gathered: Gathered, alarms: Alarms | Sequence[Alarms]) -> tuple[Gathered, int]:
    """Return recordings cut where an alarm stands, as where a value is missing, and the number of rows left out.

    Parameters
    ----------
    gathered : Gathered
    alarms : array_like of bool, sequence of Alarm, or a sequence of these
        One for each recording where there are several.

    Raises
    ------
    SettingError
        If there is not one for each recording, or not a value for each row.
    """
    if alarms is None:
        return gathered, 0
    several = len(gathered.samples) > 1
    each: list[Any] = list(alarms) if several and isinstance(alarms, Iterable) else [alarms]
    if len(each) != len(gathered.samples):
        raise SettingError(
            f"alarms must have one entry for each of {counted(len(gathered.samples), 'recording')}, got {len(each)}"
        )
    standing = [np.zeros(rows, dtype=bool) for rows in gathered.samples]
    for one, rows in zip(each, standing, strict=True):
        if one is None:
            continue
        if isinstance(one, Sequence) and all(isinstance(alarm, Alarm) for alarm in one):
            for alarm in one:
                began, first = alarm.began, 0  # the row from which its cause may have begun, where that is known
                if began is None or began.earliest is not None:
                    since = alarm.onset if began is None else min(began.earliest or 0.0, alarm.onset)
                    first = max(alarm.start - int(np.ceil((alarm.raised - since) / gathered.dt)), 0)
                rows[first : alarm.stop] = True
            continue
        given = np.asarray(one)
        if given.dtype != bool or given.shape != rows.shape:
            raise SettingError(
                f"alarms must be {len(rows)} booleans, one for each row of the recording, or the alarms of a "
                f"diagnosis; got values of type {given.dtype} in the shape {given.shape}"
            )
        rows[:] = given
    segments = []
    for segment in gathered.segments:
        quiet = ~standing[segment.recording][segment.start : segment.stop]
        segments += [segment.cut(start, stop) for start, stop in runs(quiet).tolist()]
    kept = gathered.with_segments(segments)
    return kept, gathered.n_samples - kept.n_samples


def _parity(
    memory: ParityMemory,
    channels: Treated,
    stacked: LaggedRows,
    relations: int | None,
    notes: tuple[str, ...] = (),
    tell: Progress = lambda stage, done, total: None,
) -> DataParity:
    """Return the relations of a memory, with their generator."""
    tell("relations", 0, 2)
    s, m, q = stacked.lags // 2, len(memory.inputs), stacked.channels
    poles = memory.poles
    correlations, directions, chance = _correlations(stacked, s, m, memory.inputs)
    most = (q - m) * (s + 1)
    supported = min(most, int(np.count_nonzero(correlations <= chance)))
    k = supported if relations is None else checked_count(relations, "relations", 1)
    if not k:
        raise DataError(
            f"past and inputs foretell every combination of {s + 1} samples better than by chance (smallest "
            f"correlation {correlations[-1]:.3g}, by chance {chance:.3g}): no relation of order {s} holds; raise "
            "order, name inputs that are missing, or ask for those that hold best, relations=..."
        )
    if k > most:
        raise SettingError(f"relations of order {s} are {most} at most, got {k}")
    basis = np.linalg.qr(directions[:, ::-1][:, :k])[0]
    basis *= np.sign(basis[np.abs(basis).argmax(axis=0), np.arange(k)])
    vectors = basis.T.reshape(k, s + 1, q)
    weights = vectors.transpose(1, 0, 2)
    kept = len(correlations) - k
    gap = float(correlations[kept - 1] / max(correlations[kept], DATA_ROUNDING)) if kept else np.inf
    if k > supported:
        notes = (
            f"{k} relations were asked for, and {supported} hold: past and inputs foretell the others with a "
            f"correlation of up to {correlations[kept]:.3g}, by chance {chance:.3g}",
            *notes,
        )
    elif k == supported and gap < _CLEAR:
        notes = (
            f"no clear gap: the combinations beside the relations have a correlation of {gap:.3g} times theirs; "
            "other numbers of relations are as good, relations=...",
            *notes,
        )
    evidence = Evidence(
        _METHOD,
        requested_poles=np.asarray(poles or (), dtype=complex),
        ranks={"inputs and states": RankDecision(kept, correlations, chance)},
        conditions={"gap of the correlations": gap},
        notes=(*few_rows(stacked.count, len(stacked.factor)), *channels.units.facts.repeated_outputs(), *notes),
        references=("Ding (2014), chapter 9",),
    )
    denominator = _denominator(poles, s)
    tell("relations, and the checks of their generator", 1, 2)
    generator = channel_generator(channels, weights, {"relation": k}, evidence, denominator=denominator)
    values = correlations, vectors, channels.mean, channels.spread
    return DataParity(generator, s, k, supported, *values, stacked.count, memory, channels.ways)


def _correlations(
    stacked: LaggedRows, s: int, m: int, inputs: tuple[str, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return canonical correlations of the window with past and inputs, its combinations, and the limit of chance.

    Combinations are the columns of an array, shape ((s + 1) channels, as many), in the order of the channels.
    """
    q = stacked.channels
    window, past = range(s + 1), range(s + 1, 2 * s + 2)
    known = [*stacked.columns(past), *stacked.columns(window, range(m))]
    outputs = stacked.columns(window, range(m, q))
    R = stacked.rearranged([*known, *outputs]) / np.sqrt(stacked.count)
    n, n_past = len(known), (s + 1) * q
    still, decision = null_basis(R[:n, n_past:n], rtol=DATA_ROUNDING, scale=1.0)
    if m and still.size:  # a relation may be one of inputs alone
        raise DataError(
            f"{s + 1} samples of {listed(channels_in(still, inputs, DATA_ROUNDING))} determine one another (smallest "
            f"singular value {decision.singular_values[-1]:.2g} of their spread): the recording does not excite the "
            "plant enough for relations of this order; record with inputs that move more freely, lower order, or "
            "leave an input out"
        )
    ours = R[:, n_past:]  # inputs of the window, then its outputs
    T = np.linalg.qr(np.vstack([ours, DATA_ROUNDING * np.eye(ours.shape[1])]), mode="r")
    inverse = np.linalg.inv(T)
    _, correlations, rows = np.linalg.svd(ours[:n] @ inverse, full_matrices=True)
    correlations = np.minimum(np.concatenate([correlations, np.zeros(len(rows) - len(correlations))]), 1.0)
    combinations = inverse @ rows.T
    combinations /= np.linalg.norm(combinations, axis=0)
    place = {column: i for i, column in enumerate([*stacked.columns(window, range(m)), *outputs])}
    order = [place[column] for column in stacked.columns(window)]
    limit = _CHANCE * n / (_CHANCE * n + stacked.count - n)
    return correlations, combinations[order], float(np.sqrt(limit))


def _denominator(poles: Any, order: int) -> list[float]:
    """Return the coefficients of the polynomial with these poles, after the first."""
    if poles is None:
        return []
    try:
        values = np.atleast_1d(np.asarray(poles, dtype=complex))
    except (TypeError, ValueError) as error:
        raise SettingError(f"poles must be numbers: {error}") from error
    if values.shape != (order,):
        raise SettingError(f"relations of order {order} take {counted(order, 'pole')}, got {echo(values.size)}")
    if not (np.isfinite(values).all() and np.abs(values).max() < 1):
        raise SettingError(f"poles must be stable, inside the unit circle, got {echo(poles)}")
    coefficients = np.poly(values)
    if np.abs(np.imag(coefficients)).max() > SAME:
        raise SettingError(f"complex poles must come with their conjugates, got {echo(poles)}")
    return np.real(coefficients)[1:].tolist()
