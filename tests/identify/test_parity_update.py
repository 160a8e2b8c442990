"""Relations from data, updated: those of all data together, those of a plant that drifts, and nothing of a fault."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from recorded_examples import Recorded, diagnosed, recorded
from residua.decide.alarm import Alarm, Beginning
from residua.errors import DataError, SettingError
from residua.identify.parity_from_data import without_alarms
from residua.identify.segments import gather

#: Rounding of factors of some thousand windows, in correlations and directions.
ROUNDED = 1e-9


def sine(one: rs.identify.DataParity, other: rs.identify.DataParity) -> float:
    """Return the sine of the largest angle between the relations of two designs, in standard units of the first."""
    spaces = [np.linalg.qr((x.vectors / x.spread * one.spread).reshape(x.relations, -1).T)[0] for x in (one, other)]
    return float(np.linalg.norm(spaces[0] - spaces[1] @ (spaces[1].T @ spaces[0]), 2))


def drifting(
    seed: int, poles: NDArray[np.float64], *, gain: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a plant of two outputs whose pole is another at each row; the second sensor may have another gain."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.standard_normal((len(poles), 1)), np.zeros(2), np.zeros((len(poles), 2))
    for k, pole in enumerate(poles):
        y[k] = x * [1.0, gain] + 0.05 * rng.standard_normal(2)
        x = np.array([pole * x[0] + u[k, 0], 0.5 * x[1] + x[0]])
    return u, y


def size(made: rs.identify.DataParity, u: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the root mean square of the residuals on a recording."""
    r = made.generator.run(None, np.hstack([u, y]) - made.mean)[made.order :]
    return float(np.sqrt(np.mean(r**2)))


# --------------------------------------------------------------------------- all data together


@pytest.mark.parametrize("seed", range(20))
def test_without_forgetting_it_is_the_fit_to_all_recordings(seed: int) -> None:
    one = recorded(seed, 0.05, 3000)
    rows = one.rows + np.linspace(3.0, -40.0, one.rows.shape[1])
    rows[1700, -1] = np.nan
    order, m = one.plant.n_states, one.u.shape[1]
    u, y = one.plant.inputs, one.plant.outputs
    parts = rows[:900], rows[900:1400], rows[1400:]
    made = rs.identify.parity_from_data(parts[0], order=order, poles=[0.5] * order, inputs=u, outputs=y)
    made = made.updated(parts[1]).updated(parts[2][:, :m], parts[2][:, m:])
    whole = rs.identify.parity_from_data(
        list(parts), order=order, poles=[0.5] * order, relations=made.relations, inputs=u, outputs=y
    )
    assert made.samples == whole.samples
    assert np.allclose(made.mean, whole.mean, rtol=0, atol=ROUNDED * 40)
    assert np.allclose(made.spread, whole.spread, rtol=ROUNDED)
    assert np.allclose(made.correlations, whole.correlations, atol=ROUNDED)
    assert sine(made, whole) < ROUNDED
    assert np.allclose(made.generator.system.A, whole.generator.system.A)
    assert made.supported == whole.supported


def test_several_recordings_at_once_are_one_after_the_other() -> None:
    one = recorded(3, 0.1, 4000, outputs=2)
    made = rs.identify.parity_from_data(one.u[:2000], one.y[:2000], order=3)
    parts = [(one.u[a:b], one.y[a:b]) for a, b in ((2000, 2600), (2600, 4000))]
    together = made.updated(parts, forgetting=0.999)
    in_turn = made.updated(*parts[0], forgetting=0.999).updated(*parts[1], forgetting=0.999)
    assert sine(together, in_turn) < ROUNDED
    assert np.allclose(together.mean, in_turn.mean)


def test_weights_are_those_of_an_explicit_weighted_factor() -> None:
    one = recorded(4, 0.1, 1500, outputs=2)
    s, forgetting, first = 2, 0.995, 800
    made = rs.identify.parity_from_data(one.u[:first], one.y[:first], order=s)
    after = made.updated(one.u[first:], one.y[first:], forgetting=forgetting)
    length = 2 * s + 2
    H = [np.concatenate([[1.0], one.rows[k : k + length].ravel()]) for k in range(first - length + 1)]
    new = [np.concatenate([[1.0], one.rows[k : k + length].ravel()]) for k in range(first, 1500 - length + 1)]
    age = np.concatenate([np.full(len(H), len(new)), np.arange(len(new) - 1, -1, -1)])
    G = np.array(H + new)
    products = G.T @ (forgetting ** age[:, None] * G)
    R = after.memory.hankel.R  # in units that the columns are divided by, less the reference
    q = one.rows.shape[1]
    T = np.diag(np.concatenate([[1.0], np.tile(made.memory.hankel.units, length)]))
    T[0, 1:] = np.tile(made.memory.hankel.reference, length)
    assert np.allclose((R @ T).T @ (R @ T), products, rtol=ROUNDED, atol=ROUNDED * np.abs(products).max())
    weights = forgetting**age
    assert after.samples == round(weights.sum() ** 2 / (weights**2).sum())
    rows = forgetting ** np.concatenate([np.full(first, 1500 - first), np.arange(1500 - first - 1, -1, -1)])
    assert np.allclose(after.mean, rows @ one.rows / rows.sum())
    variance = rows @ (one.rows - after.mean) ** 2 / rows.sum()
    known = rows.sum() ** 2 / (rows**2).sum()
    assert after.spread.shape == (q,)
    assert np.allclose(after.spread, np.sqrt(variance * known / (known - 1)))


# --------------------------------------------------------------------------- drift and faults


def test_it_follows_a_plant_that_drifts() -> None:
    steps = np.linspace(0.85, 0.5, 9)
    made = first = rs.identify.parity_from_data(*drifting(0, np.full(3000, steps[0])), order=3)
    kept = first
    for day, pole in enumerate(steps[1:], 1):
        today = drifting(day, np.full(3000, pole))
        made, kept = made.updated(*today, forgetting=0.998), kept.updated(*today)
    last = drifting(99, np.full(3000, steps[-1]))
    fresh = rs.identify.parity_from_data(*last, order=3, relations=first.relations)
    assert made.relations == first.relations
    # the residual of noise alone; the old relations, and those of all days alike, leak what the inputs do
    assert size(first, *last) > 3 * size(fresh, *last)
    assert size(made, *last) < 1.2 * size(fresh, *last)
    assert size(kept, *last) > 1.5 * size(made, *last)


def test_alarms_keep_a_fault_from_being_learnt() -> None:
    normal, more = drifting(0, np.full(4000, 0.8)), drifting(1, np.full(3000, 0.8))
    u, y = drifting(2, np.full(4000, 0.8))
    _, faulty = drifting(2, np.full(4000, 0.8), gain=1.5)
    y[1500:3700] = faulty[1500:3700]
    made = rs.identify.parity_from_data(*normal, order=3)
    monitor = rs.Monitor(made, test=rs.decide.NormThreshold(window=10)).fit(
        None, np.hstack(more), false_alarm_rate=0.001
    )
    seen = diagnosed(monitor, np.hstack([u, y]))
    assert 1490 < seen.main_alarm.start < 1530
    learnt = made.updated(u, y, forgetting=0.999)
    guarded = made.updated(u, y, forgetting=0.999, alarms=seen.alarms)
    by_rows = np.zeros(4000, dtype=bool)
    by_rows[1500:3700] = True
    exact = made.updated(u, y, forgetting=0.999, alarms=by_rows)
    broken = drifting(5, np.full(2000, 0.8), gain=1.5)
    before = size(made, *broken)
    assert size(learnt, *broken) < 0.5 * before  # what the fault does counts as normal now
    assert size(guarded, *broken) > 0.9 * before
    assert size(exact, *broken) > 0.9 * before
    assert any("2200 rows in alarm left out" in note for note in exact.generator.evidence.notes)


def test_windows_that_overlap_an_alarm_are_left_out() -> None:
    one = recorded(6, 0.1, 2000, outputs=2)
    made = rs.identify.parity_from_data(one.u[:1000], one.y[:1000], order=2)
    spoilt = one.y[1000:].copy()
    spoilt[300:340] = 1e6
    alarms = np.zeros(1000, dtype=bool)
    alarms[300:340] = True
    guarded = made.updated(one.u[1000:], spoilt, alarms=alarms)
    gap = one.y[1000:].copy()
    gap[300:340] = np.nan
    missing = made.updated(one.u[1000:], gap)
    assert guarded.samples == made.samples + 2 * (1000 - 40) // 2 - 2 * 5
    assert np.array_equal(guarded.vectors, missing.vectors)
    assert np.array_equal(guarded.mean, missing.mean)


def test_rows_in_alarm_are_counted_from_when_the_cause_may_have_begun() -> None:
    def alarm(began: Beginning | None, start: int = 50, stop: int = 60) -> Alarm:
        return Alarm(onset=96.0, raised=100.0, ended=None, candidates=(), start=start, stop=stop, began=began)

    data = gather(np.random.default_rng(0).standard_normal((100, 2)), dt=2.0)
    for began, first in (
        (None, 48),
        (Beginning(90.0, 94.0, 95.0), 45),
        (Beginning(None, 94.0, 95.0), 0),
    ):
        kept, left_out = without_alarms(data, (alarm(began),))
        assert left_out == 60 - first
        assert [(one.start, one.stop) for one in kept.segments if one.start >= 60] == [(60, 100)]
    assert without_alarms(data, ())[1] == 0
    assert without_alarms(data, None) == (data, 0)


def test_a_recording_all_in_alarm_teaches_nothing_and_says_so() -> None:
    one = recorded(6, 0.1, 2000, outputs=2)
    made = rs.identify.parity_from_data(one.u, one.y, order=2)
    after = made.updated(one.u, one.y, alarms=np.ones(2000, dtype=bool), forgetting=0.9)
    assert np.array_equal(after.vectors, made.vectors)
    assert after.samples == made.samples
    assert (
        "nothing was learnt: no 6 rows in a row that are complete and without an alarm"
        in (after.generator.evidence.notes[-1])
    )


def test_what_was_done_with_channels_that_drift_is_known_after_an_update() -> None:
    rng = np.random.default_rng(0)
    u = rng.standard_normal((500, 1))
    y = np.hstack([2 * u + 0.1 * rng.standard_normal((500, 1)), np.linspace(0, 9, 500)[:, None] + u])
    made = rs.identify.parity_from_data(u, y, order=1)
    assert made.drifts == {"y2": "keep"}
    assert made.updated(u, y).drifts == made.drifts


def test_another_number_of_relations_is_said() -> None:
    """The second output of the second recording has noise of its own dynamics: fewer relations hold."""
    normal = drifting(0, np.full(3000, 0.8))
    made = rs.identify.parity_from_data(*normal, order=3)
    u, y = drifting(1, np.full(6000, 0.8))
    walk = np.zeros(6000)
    for k in range(1, 6000):
        walk[k] = 0.95 * walk[k - 1] + 0.3 * np.sin(k**1.5)
    fewer = made.updated(u, y + np.column_stack([np.zeros(6000), walk]), forgetting=0.998)
    assert fewer.relations == made.relations > fewer.supported
    assert any("were asked for, and" in note for note in fewer.generator.evidence.notes)
    few = rs.identify.parity_from_data(*normal, order=3, relations=2).updated(u, y)
    assert any("the data now support" in note and "2 are kept" in note for note in few.generator.evidence.notes)


def test_bits_do_not_depend_on_units() -> None:
    one = recorded(7, 0.1, 2000, outputs=2)
    m = one.u.shape[1]
    powers = 2.0 ** np.array([20, -20, 7, -13])[: one.rows.shape[1]]
    made = rs.identify.parity_from_data(one.u[:900], one.y[:900], order=3)
    other = rs.identify.parity_from_data(one.u[:900] * powers[:m], one.y[:900] * powers[m:], order=3)
    made = made.updated(one.u[900:], one.y[900:], forgetting=0.999)
    other = other.updated(one.u[900:] * powers[:m], one.y[900:] * powers[m:], forgetting=0.999)
    assert np.array_equal(made.vectors, other.vectors)
    assert np.array_equal(made.spread * powers, other.spread)
    assert np.array_equal(made.mean * powers, other.mean)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"forgetting": 0.0}, SettingError, "forgetting must be above 0"),
        ({"forgetting": 1.01}, SettingError, "forgetting must be above 0"),
        ({"forgetting": "slow"}, SettingError, "forgetting must be above 0"),
        ({"forgetting": 0.9}, DataError, "with forgetting=0.9 19 windows are remembered, .* take at least 0.9"),
        ({"alarms": np.zeros(5, dtype=bool)}, SettingError, "alarms must be 1000 booleans"),
        ({"alarms": np.zeros(1000)}, SettingError, "alarms must be 1000 booleans"),
    ],
)
def test_bad_settings_are_refused(options: dict[str, object], error: type[Exception], said: str) -> None:
    one = recorded(6, 0.1, 2000, outputs=2)
    made = rs.identify.parity_from_data(one.u[:1000], one.y[:1000], order=2)
    with pytest.raises(error, match=said):
        made.updated(one.u[1000:], one.y[1000:], **options)  # pyright: ignore[reportArgumentType]


def test_bad_recordings_are_refused() -> None:
    one = recorded(6, 0.1, 2000, outputs=2)
    made = rs.identify.parity_from_data(one.u[:1000], one.y[:1000], order=2)
    with pytest.raises(SettingError, match="one entry for each of 2 recordings"):
        made.updated([(one.u, one.y)] * 2, alarms=[None])
    still = one.y.copy()
    still[:, 1] = 7.0
    with pytest.raises(DataError, match="y2 no longer changes"):
        made.updated(one.u, still, forgetting=0.97)
    with pytest.raises(DataError, match="expected"):
        made.updated(one.u[:, :1], one.y[:, :1])


# --------------------------------------------------------------------------- the observer form


def observer(one: rs.identify.DataParity, poles: list[complex], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Run the diagnostic observer of each relation, written out: its state is s numbers."""
    d, s = np.poly(poles).real, one.order
    x, out = np.zeros((one.relations, s + 1)), np.zeros((len(z), one.relations))
    for k, row in enumerate(z):
        driven = one.vectors @ row
        out[k] = x[:, 0] + driven[:, 0]
        x[:, :s] = x[:, 1:] + driven[:, 1:] - np.outer(out[k], d[1:])
    return out


def plant_from(one: Recorded, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outputs from another start of the plant, without noise."""
    system = one.plant.system()
    return system.simulate(one.u, start)


@pytest.mark.parametrize("seed", range(8))
def test_poles_make_the_relations_observers(seed: int) -> None:
    one = recorded(seed, 0.0, 1500)
    order = one.plant.n_states + 1
    poles = [complex(p) for p in np.linspace(-0.4, 0.7, order)]
    made = rs.identify.parity_from_data(one.u, one.y, order=order, poles=poles)
    elsewhere = np.hstack([one.u, plant_from(one, np.full(one.plant.n_states, 30.0))])
    r = made.generator.run(None, elsewhere - made.mean)
    assert np.allclose(r, observer(made, poles, (elsewhere - made.mean) / made.spread), atol=1e-8)
    # the start of the plant, far from that of the observer, is forgotten at the rate of the slowest pole
    from_rest = made.generator.run(None, one.rows - made.mean)
    largest = np.abs(r - from_rest).max(axis=1)
    assert largest[:order].max() > 1.0
    assert largest[60:].max() < 1e-6 * largest[:order].max()
