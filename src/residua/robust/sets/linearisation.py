"""Uncertain plants from physical parameters and from lists of plants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.arrays import frozen
from residua.errors import AccuracyError, ModelError
from residua.linear.systems.scaling import even_units
from residua.plant.plant import Plant
from residua.robust.sets.uncertain_plant import UncertainParameter, UncertainPlant, make_uncertain_plant, visited_values
from residua.shown import Shown

Matrix = NDArray[np.float64]
#: Points inside of the box of parameters that are evaluated besides its corners.
_INSIDE = 64
#: From so many times its range on, how far an entry is off is not reported: it does not vary, but for rounding.
_MANY = 10.0
#: What rounding may do to an entry, relative to the terms that it is the sum of.
_ROUNDED = 1e-13
#: What the affine form describes, and what it takes from the nominal plant.
_MOVING, _FIXED = ("A", "B", "C", "D", "Bd", "Dd", "Bf", "Df"), ("E", "Bw", "Dw")
#: What plants of a list must have in common besides: the relations that are made of lists count on it.
_DIRECTIONS = ("Bd", "Dd", "Bf", "Df")


@dataclass(frozen=True, eq=False, repr=False)
class Linearisation(Shown):
    """Error of an affine form of a plant, over all points at which both were evaluated.

    Attributes
    ----------
    exact : bool
        Whether nothing is left out but rounding.
    deviation : dict of str to ndarray
        The largest absolute deviation of each entry of each matrix of the plant.
    relative : float
        The largest deviation of an entry of ``A``, ``B``, ``C`` or ``D``, or of the direction of a disturbance or a
        fault, relative to the range of that entry over the points.
    worst : dict of str to float
        The parameters at which ``relative`` is attained.
    points : int
        Points evaluated: corners of the box, and points inside. Between them more may be left out.
    kept : dict of str to float
        Matrices that the affine form takes from the nominal plant although they move, those of noise and ``E``: by how
        much at most, relative to the largest entry of the column in the nominal plant.
    before : Linearisation or None
        What an earlier step has left out, where the points of this one were taken from its affine form.
    """

    exact: bool
    deviation: Mapping[str, Matrix]
    relative: float
    worst: Mapping[str, float]
    points: int
    kept: Mapping[str, float] = field(default_factory=dict)
    before: Linearisation | None = None

    def __str__(self) -> str:
        if self.exact:
            return f"affine at {self.points} points"
        out = [] if self.before is None else [f"of a set that was {self.before} itself"]
        if self.relative:
            out.append(f"{self._share()} an entry's range is left out at {self.points} points")
        if self.kept:
            moved = ", ".join(f"{name} by {100 * share:.2g} %" for name, share in self.kept.items())
            out.append(f"kept as in the nominal plant although they move: {moved} of their size")
        return f"linearised: {'; '.join(out)}"

    def _share(self) -> str:
        return f"up to {100 * self.relative:.2g} % of" if self.relative < _MANY else f"more than {_MANY:g} times"


def uncertain_plant_from_parameters(
    function: Callable[[Mapping[str, float]], Plant],
    parameters: Mapping[str, Sequence[float]],
    *,
    rtol: float = 1e-9,
    seed: int = 0,
) -> UncertainPlant:
    """Return the uncertain plant of named physical parameters.

    Each parameter moves the matrices along the chord between its bounds, the others nominal. Where the matrices are
    affine in the parameters, that is the plant itself; where they are not, it is a linearisation. Both are evaluated
    at the corners of the box and at points inside: ``.linearisation`` says which of the two it is.

    Parameters
    ----------
    function : callable
        From a mapping of names to values to a :class:`residua.Plant`.
    parameters : mapping of str to (low, high) or (low, nominal, high)
        The middle of two numbers is nominal.
    rtol : float
        Deviations below this fraction of an entry are rounding.
    seed : int
        Of the points that are drawn.

    Returns
    -------
    UncertainPlant
        Guarantees over its members hold for the plants of ``function`` only where ``linearisation.exact``.

    Raises
    ------
    ModelError
        If bounds are not bounds, or the plants differ in more than their matrices.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import UncertainPlant
    >>> def motor(v):
    ...     return rs.Plant([[-v["friction"] / v["inertia"]]], [[1 / v["inertia"]]], [[1.0]])
    >>> unc = UncertainPlant.from_parameters(motor, {"friction": (0.1, 0.2), "inertia": (1.0, 1.0, 1.1)})
    >>> unc.linearisation.exact
    False
    >>> UncertainPlant.from_parameters(motor, {"friction": (0.1, 0.2), "inertia": (1.0, 1.0)}).linearisation.exact
    True
    """
    known = tuple(_parameter(name, values) for name, values in parameters.items())
    if not known:
        raise ModelError("name at least one parameter: {name: (low, high)} or {name: (low, nominal, high)}")
    names = tuple(p.name for p in known)
    centre = np.array([p.nominal for p in known])

    def evaluate(values: NDArray[np.float64]) -> Plant:
        plant = function(dict(zip(names, (float(v) for v in values), strict=True)))
        if not isinstance(plant, Plant):
            raise ModelError(f"the function of the parameters must return a Plant, got {type(plant).__name__}")
        return plant

    nominal = evaluate(centre)
    slopes = {}
    for i, p in enumerate(known):
        if p.high == p.low:
            continue
        high, low = centre.copy(), centre.copy()
        high[i], low[i] = p.high, p.low
        ends = [evaluate(high), evaluate(low)]
        slope = (_stacked(ends[0], nominal) - _stacked(ends[1], nominal)) / (p.high - p.low)
        # what moves by rounding only would be a channel of its own
        rounding = _stacked_from(_rounding([nominal, *ends], 0.0))
        slopes[i] = np.where(np.abs(slope) * (p.high - p.low) > 2 * rounding, slope, 0.0)
    affine = nominal, known, *_channels_of(slopes, nominal)
    uncertain = make_uncertain_plant(*affine)
    points = visited_values(uncertain, _INSIDE, seed)
    comparison = _compare(uncertain, [evaluate(v) for v in points], points, rtol)
    return make_uncertain_plant(*affine, linearisation=comparison, function=function)


def _parameter(name: str, values: Sequence[float]) -> UncertainParameter:
    try:
        v = [float(x) for x in values]
    except (TypeError, ValueError) as error:
        raise ModelError(f"parameter {name!r}: give (low, high) or (low, nominal, high), got {values!r}") from error
    if len(v) not in (2, 3) or not np.isfinite(v).all() or v != sorted(v):
        raise ModelError(f"parameter {name!r}: give (low, high) or (low, nominal, high), in order, got {values!r}")
    return UncertainParameter(str(name), v[0], v[-1], v[1] if len(v) == 3 else (v[0] + v[1]) / 2)


def _stacked(plant: Plant, like: Plant) -> Matrix:
    """Return ``[A B; C D]``, ``B`` with disturbances and faults, of a plant that has the channels of another."""
    for what in ("inputs", "outputs", "states", "disturbances", "faults", "noises", "dt"):
        if getattr(plant, what) != getattr(like, what):
            raise ModelError(
                f"the plants of one family differ in their {what}: {getattr(plant, what)} and {getattr(like, what)}"
            )
    return _stacked_from({name: getattr(plant, name) for name in _MOVING})


def _channels_of(slopes: Mapping[int, Matrix], nominal: Plant) -> tuple[tuple[int, ...], Matrix, Matrix]:
    """Return channels with ``-[Hx; Hy] [Gx Gu Gd Gf]`` the slope of each parameter, as few as its rank."""
    none = _stacked(nominal, nominal)
    channels, left, right = [], [none[:, :0]], [none[:0]]
    for i, slope in slopes.items():
        if np.any(slope):
            rows, columns = even_units(slope)
            U, s, Vh = np.linalg.svd(rows[:, None] * slope * columns, full_matrices=False)
            rank = int(np.count_nonzero(s > 1e-12 * s[0]))
            half = np.sqrt(s[:rank])
            left.append(-U[:, :rank] * half / rows[:, None])
            # no rounding where nothing moves
            right.append(np.where(slope.any(axis=0), half[:, None] * Vh[:rank] / columns, 0.0))
            channels += [i] * rank
    return tuple(channels), np.hstack(left), np.vstack(right)


def _all_matrices(plant: Plant) -> dict[str, Matrix]:
    E = np.eye(plant.n_states) if plant.E is None else plant.E
    return {name: E if name == "E" else getattr(plant, name) for name in (*_MOVING, *_FIXED)}


def _stacked_from(matrices: Mapping[str, Matrix]) -> Matrix:
    upper, lower = ([matrices[name] for name in names] for names in (("A", "B", "Bd", "Bf"), ("C", "D", "Dd", "Df")))
    return np.block([upper, lower])


def _rounding(plants: Sequence[Plant], rtol: float) -> dict[str, Matrix]:
    """Return what entries of matrices may be off by: a part of themselves, and of the largest in even units.

    A zero that was computed, by a change of coordinates or by sampling a plant, is off by the rounding of its terms,
    which are about as large as the other entries once rows and columns are in even units.
    """
    stacks = [_all_matrices(plant) for plant in plants]
    sizes = {name: np.abs(np.stack([m[name] for m in stacks])).max(axis=0) for name in (*_MOVING, *_FIXED)}
    whole = np.hstack([_stacked_from(sizes), np.vstack([sizes["Bw"], sizes["Dw"]])])
    beside = {"E": np.minimum(sizes["E"].max(axis=1, initial=0.0, keepdims=True), sizes["E"].max(axis=0, initial=0.0))}
    n, names = len(sizes["A"]), ("A", "B", "Bd", "Bf", "Bw")
    ends = np.cumsum([sizes[name].shape[1] for name in names[:-1]])
    rows, columns = even_units(whole) if np.any(whole) else (np.ones(len(whole)), np.ones(whole.shape[1]))
    even = (rows[:, None] * whole * columns).max(initial=0.0) / rows[:, None] / columns
    for name, part in zip(names, np.split(even, ends, axis=1), strict=True):
        beside |= {name: part[:n], {"A": "C", "B": "D"}.get(name, "D" + name[1:]): part[n:]}
    return {name: rtol * size + _ROUNDED * beside[name] for name, size in sizes.items()}


def _compare(uncertain: UncertainPlant, plants: list[Plant], points: NDArray[np.float64], rtol: float) -> Linearisation:
    """Compare the members of an affine form with the plants that they stand for."""
    for plant in plants:
        _stacked(plant, uncertain.nominal)
    real = [_all_matrices(plant) for plant in plants]
    ours = [_all_matrices(uncertain.member(v)) for v in points]
    rounding = _rounding(plants, rtol)
    deviation, kept, relative, where, exact = {}, {}, 0.0, 0, True
    for name in (*_MOVING, *_FIXED):
        true = np.stack([matrices[name] for matrices in real])
        off = np.abs(true - np.stack([matrices[name] for matrices in ours]))
        deviation[name] = frozen(off.max(axis=0))
        if not off.size or np.all(off <= rounding[name]):
            continue
        exact = False
        off = np.where(off > rounding[name], off, 0.0)
        if name in _FIXED:
            # relative to the largest of its column, in even units of the rows
            nominal, most = np.abs(_all_matrices(uncertain.nominal)[name]), off.max(axis=0)
            rows = np.maximum(nominal, most).max(axis=1, keepdims=True)
            columns, moved = ((M / np.where(rows > 0, rows, 1.0)).max(axis=0) for M in (nominal, most))
            # a column that is zero in the nominal plant moves by all that it is
            share = np.where(columns > 0, moved / np.where(columns > 0, columns, 1.0), np.sign(moved))
            kept[name] = float(share.max(initial=0.0))
            continue
        spread = np.maximum(np.ptp(true, axis=0), rounding[name])
        worst = (off / np.where(spread > 0, spread, np.finfo(float).tiny)).reshape(len(points), -1).max(axis=1)
        if worst.max() > relative:
            relative, where = float(worst.max()), int(np.argmax(worst))
    values = dict(zip(uncertain.names, (float(v) for v in points[where]), strict=True))
    return Linearisation(exact, deviation, relative, values, len(points), kept)


def uncertain_plant_from_plants(plants: Iterable[Plant]) -> UncertainPlant:
    """Return an uncertain plant that contains all plants of a list, and everything between them.

    The matrices span an affine space of at most one dimension less than there are plants. The parameters are
    coordinates along its principal axes, in units in which every entry that varies does so by 1, and their bounds are
    the extremes of the plants: the box contains every plant, every mixture of them, and more. For two plants it is the
    line between them. The first plant is nominal.

    Parameters
    ----------
    plants : sequence of Plant
        Same channels, same directions of disturbances, faults and noise.

    Returns
    -------
    UncertainPlant
        With ``.plants``, and ``.linearisation``, which compares the members at the plants with them.

    Raises
    ------
    ModelError
        If the plants differ in more than ``A, B, C, D``.

    Examples
    --------
    >>> import residua as rs
    >>> from residua.plant import UncertainPlant
    >>> slow, fast = (rs.Plant([[-a]], [[a]], [[1.0]]) for a in (1.0, 2.0))
    >>> unc = UncertainPlant.from_plants([slow, fast])
    >>> unc.vertices()[1].A.round(9), len(unc.channels)
    (array([[-2.]]), 1)
    """
    family = tuple(plants)
    if not family or not all(isinstance(plant, Plant) for plant in family):
        raise ModelError("give a list of at least one Plant")
    nominal = family[0]
    stacks = np.stack([_stacked(plant, nominal) for plant in family])
    fixed = [_all_matrices(plant) for plant in family]
    rounding = _rounding(family, 0.0)
    for name in (*_FIXED, *_DIRECTIONS):
        if any(np.any(np.abs(matrices[name] - fixed[0][name]) > rounding[name]) for matrices in fixed):
            raise ModelError(f"the plants differ in {name}: only A, B, C and D may vary within a family")
    spread = np.ptp(stacks, axis=0)
    varies = spread > _stacked_from(rounding)
    unit = np.where(varies, spread, 1.0)
    rows = (np.where(varies, stacks - stacks[0], 0.0) / unit).reshape(len(family), -1)
    middle = rows.mean(axis=0)
    _, s, axes = np.linalg.svd(rows - middle, full_matrices=False)
    axes = axes[s > 1e-12 * max(float(s.max(initial=0.0)), np.finfo(float).tiny)]
    coordinates = rows @ axes.T
    known, slopes = [], {}
    for i, axis in enumerate(axes):
        along = coordinates[:, i] * (1 if coordinates[np.argmax(np.abs(coordinates[:, i])), i] > 0 else -1)
        axis = axis * (1 if np.array_equal(along, coordinates[:, i]) else -1)
        known.append(UncertainParameter(f"axis {i + 1}", float(along.min()), float(along.max())))
        coordinates[:, i] = along
        slopes[i] = np.where(varies, axis.reshape(unit.shape) * unit, 0.0)
    affine = nominal, tuple(known), *_channels_of(slopes, nominal)
    uncertain = make_uncertain_plant(*affine)
    check = _compare(uncertain, list(family), coordinates, 1e-9)
    if not check.exact:
        raise AccuracyError(
            f"the box of principal axes misses the plants by {check._share()} an entry's range: the entries of the "
            "plants differ by too many orders of magnitude; write them in units of even size"
        )
    return make_uncertain_plant(*affine, linearisation=check, plants=family)
