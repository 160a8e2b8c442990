"""Channels that drift: how often chance looks like one, which drifts are found, and what generators make of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

import residua as rs
from recorded_examples import diagnosed
from residua.decide.stationarity import independent_samples
from residua.errors import DataError, SettingError
from residua.identify import Drifts, drifting_channels
from residua.testing import check_residual_generator

Rows = NDArray[np.float64]
MAKERS: dict[str, Callable[..., Any]] = {
    "static components": lambda rows, **o: rs.identify.principal_components(rows, components=2, **o),
    "dynamic components": lambda rows, **o: rs.identify.principal_components(rows, lags=2, components=4, **o),
    "innovations": lambda rows, **o: rs.identify.canonical_variates(rows, lags=2, states=3, **o),
    "variates": lambda rows, **o: rs.identify.canonical_variates(rows, lags=2, states=3, residuals="variates", **o),
    "moving average": lambda rows, **o: rs.identify.parity_from_data(rows, order=2, relations=2, **o),
    "observer form": lambda rows, **o: rs.identify.parity_from_data(rows, order=2, relations=2, poles=[0.5, 0.4], **o),
}
each = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)


def first_order(rng: np.random.Generator, rows: int, times: float, columns: int) -> Rows:
    """Return noise of variance one of which so many correlation times fit into the rows."""
    tau = rows / times
    phi = max(0.0, (tau - 1) / (tau + 1))
    begun = int(10 * tau) + 10
    noise = rng.standard_normal((rows + begun, columns)) * np.sqrt(1 - phi**2)
    return np.asarray(lfilter([1.0], [1.0, -phi], noise, axis=0))[begun:]


def loaded(seed: int = 0, rows: int = 2000) -> Rows:
    """Return five channels of two loads, of which the third warms up by six."""
    rng = np.random.default_rng(seed)
    out = rng.standard_normal((rows, 2)) @ rng.standard_normal((2, 5)) + 0.3 * rng.standard_normal((rows, 5))
    out[:, 2] += np.linspace(0, 6, rows)
    return out


def share(columns: Rows) -> float:
    """Return the part of the columns, each a channel of its own recording, that drift."""
    return float(np.mean([bool(drifting_channels(columns[:, [j]]).drifting) for j in range(columns.shape[1])]))


# ------------------------------------------------------------------ what is found


@pytest.mark.parametrize("times", [40, 100, 400])
@pytest.mark.parametrize("rows", [200, 400, 3000])
def test_noise_of_many_correlation_times_hardly_ever_drifts(rows: int, times: int) -> None:
    """3 % of 300 channels at most, whatever the colour of the noise."""
    assert share(first_order(np.random.default_rng(rows + times), rows, times, 300)) <= 0.03


@pytest.mark.parametrize("rows", [400, 3000])
def test_oscillating_noise_does_not_drift(rows: int) -> None:
    noise = np.random.default_rng(rows).standard_normal((rows + 500, 200))
    columns = lfilter([1.0], np.poly(0.95 * np.exp([0.3j, -0.3j])).real, noise, axis=0)[500:]
    assert share(columns) <= 0.03
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, 200)
    waves = 3 * np.sin(40 * np.pi * np.arange(rows)[:, None] / rows + phases)  # twenty of them
    assert share(waves + noise[500:]) <= 0.03


@pytest.mark.parametrize("rows", [200, 400, 3000])
def test_drifts_larger_than_the_noise_are_found(rows: int) -> None:
    """Lines that climb by three standard deviations of the noise, steps by two, and walks that come as far."""
    rng = np.random.default_rng(rows)
    noise = first_order(rng, rows, rows / 2, 200)
    assert share(noise + np.linspace(0, 3, rows)[:, None]) >= 0.95
    assert share(noise + 2.0 * (np.arange(rows) > 0.4 * rows)[:, None]) >= 0.95
    walks = np.cumsum(rng.standard_normal((rows, 200)), axis=0)
    assert share(noise + 8 * walks / np.ptp(walks, axis=0)) >= 0.7
    assert share(walks) >= 0.97


def test_what_moves_by_less_than_the_noise_is_no_drift() -> None:
    noise = np.random.default_rng(0).standard_normal((3000, 200))
    assert share(noise + np.linspace(0, 1, 3000)[:, None]) <= 0.02


def test_numbers_are_those_of_what_was_made() -> None:
    """A step by four at row 700, in units of a tenth."""
    rows = 0.1 * np.random.default_rng(0).standard_normal((5000, 2))
    rows[700:, 1] += 0.4
    found = drifting_channels(rows, outputs=["pressure", "temperature"])
    assert found.drifting == ("temperature",)
    assert abs(found.change[0, 1] - 4.0) < 0.2  # standard error of the means .04, of stretches of five rows
    assert abs(found.place[0, 1] - 700) <= 10
    assert found.change[0, 0] == 0
    assert str(found).startswith("Drifts(1 of 2 channels):\n  'temperature' drifts: its mean moves by 4")
    assert "keeps its level" in found.sentence("pressure")


def test_samples_are_worth_what_theory_says() -> None:
    """First-order noise: its correlation time is (1 + phi) / (1 - phi), and one standard error is added."""
    columns = first_order(np.random.default_rng(1), 4000, 200, 100)
    worth = [independent_samples(columns[:, j]) for j in range(100)]
    assert 150 < np.median(worth) <= 205
    assert independent_samples(np.ones(50)) == 50


def test_channels_in_other_units_drift_alike() -> None:
    rows = loaded()
    factors = np.exp2([-20.0, 20, -7, 13, 0])
    one, other = drifting_channels(rows), drifting_channels(rows * factors)
    assert one.drifting == other.drifting == ("y3",)
    for name in ("change", "place", "worth"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


def test_long_recordings_are_looked_at_by_means_of_stretches() -> None:
    """More rows than are read at a time; the means computed here at once."""
    rows = first_order(np.random.default_rng(0), 150_000, 300, 2)
    means = rows[: 150_000 // 150 * 150].reshape(-1, 150, 2).mean(axis=1)
    found = drifting_channels(rows)
    # seven digits: the units differ
    assert np.allclose(found.worth[0], [independent_samples(means[:, j]) for j in range(2)], rtol=1e-7)


# ------------------------------------------------------------------ several recordings, gaps


def test_of_several_recordings_those_with_half_of_the_rows_decide() -> None:
    rng = np.random.default_rng(0)
    calm = rng.standard_normal((2000, 5))
    assert drifting_channels([(None, loaded()), (None, calm)]).drifting == ("y3",)
    found = drifting_channels([(None, loaded()), (None, calm), (None, calm[:500]), (None, calm[:50])])
    assert found.drifting == ()
    assert found.moves[:, 2].tolist() == [True, False, False, False]
    assert found.judged.tolist() == [True, True, True, False]
    assert "recording 1 (it drifts in 1 of 3 recordings)" in found.sentence("y3")
    made = rs.identify.principal_components([(None, loaded()), (None, calm), (None, calm[:500])], drifts="leave out")
    assert made.drifts == {}
    assert any("1 of 3 recordings); kept" in note for note in made.generator.evidence.notes)


def test_levels_of_recordings_are_no_drift() -> None:
    rows = np.random.default_rng(0).standard_normal((2000, 2))
    assert drifting_channels([(None, rows[:1000]), (None, rows[1000:] + [0.0, 9.0])]).drifting == ()


def test_rows_with_missing_values_are_left_out() -> None:
    rows = loaded()
    rows[[300, 301, 302, 900], [0, 1, 2, 4]] = np.nan
    found, without = drifting_channels(rows), drifting_channels(rows[np.isfinite(rows).all(axis=1)])
    assert found.drifting == without.drifting == ("y3",)
    # their order of additions is another
    assert np.allclose(found.worth, without.worth)
    assert found.rows.tolist() == [1996]


# ------------------------------------------------------------------ what generators make of them


@each
def test_what_is_left_out_is_read_by_no_residual(make: Callable[..., Any]) -> None:
    """The same residuals, to the last bit, as without the channel."""
    rows = loaded()
    made, without = make(rows, drifts="leave out"), make(np.delete(rows, 2, axis=1), outputs=["y1", "y2", "y4", "y5"])
    assert made.drifts == {"y3": "leave out"}
    assert made.generator.faults == without.generator.faults
    assert made.generator.plant.outputs == ("y1", "y2", "y3", "y4", "y5")
    point = np.array(made.generator.plant.operating_point.outputs)
    ours, theirs = (
        one.generator.run(None, data)
        for one, data in ((made, rows - point), (without, np.delete(rows - point, 2, axis=1)))
    )
    assert np.allclose(ours, theirs, atol=1e-12)
    assert any("left out, so that its own faults show nowhere" in note for note in made.generator.evidence.notes)
    check_residual_generator(made.generator)


@each
def test_differences_are_those_of_a_recording_of_changes(make: Callable[..., Any]) -> None:
    """Apart from a constant: the mean change, which a monitor takes off."""
    rows = loaded()
    changes = rows[1:].copy()
    changes[:, 2] = np.diff(rows[:, 2])
    made, other = make(rows, drifts="difference"), make(changes)
    assert made.drifts == {"y3": "difference"}
    assert np.allclose(made.spread, other.spread, rtol=1e-12)
    point = np.array(made.generator.plant.operating_point.outputs)
    settled = slice(60, None)  # of the slowest pole, 0.5, nothing is left
    ours = made.generator.run(None, rows - point)[1:][settled]
    theirs = other.generator.run(None, changes - changes.mean(axis=0))[settled]
    assert np.ptp(ours - theirs, axis=0).max() < 1e-9 * np.abs(ours).max()
    check_residual_generator(made.generator)


@each
@pytest.mark.parametrize("way", ["leave out", "difference"])
def test_units_change_no_bit_of_a_treated_generator(make: Callable[..., Any], way: str) -> None:
    rows, factors = loaded(), np.exp2([-20.0, 20, -7, 13, 0])
    made, other = make(rows, drifts=way), make(rows * factors, drifts=way)
    point = np.array(made.generator.plant.operating_point.outputs)
    assert np.array_equal(made.generator.run(None, rows - point), other.generator.run(None, (rows - point) * factors))


@each
@pytest.mark.parametrize("way", ["leave out", "difference"])
def test_a_drift_that_goes_on_raises_no_alarms(make: Callable[..., Any], way: str, tmp_path: Path) -> None:
    """The channel goes on as far again; a sensor that is off is detected all the same; files keep both."""
    rows = loaded(rows=4000)
    made = make(rows[:2000], drifts=way)
    monitor = rs.Monitor(made, isolate=None).fit(None, rows[:2000], false_alarm_rate=0.001)
    assert diagnosed(monitor, rows).alarm[2000:].mean() < 0.02
    wrong = rows.copy()
    wrong[3000:, 3] += 4.0
    assert diagnosed(monitor, wrong).alarm[3000:].any()
    again = rs.Monitor.load(monitor.save(tmp_path / "monitor.json") or tmp_path / "monitor.json")
    assert np.array_equal(diagnosed(again, wrong).alarm, diagnosed(monitor, wrong).alarm)


def test_without_a_treatment_it_raises_alarms_and_a_note_says_why() -> None:
    rows = loaded(rows=4000)
    made = rs.identify.principal_components(rows[:2000], components=2)
    monitor = rs.Monitor(made, isolate=None).fit(None, rows[:2000], false_alarm_rate=0.001)
    assert diagnosed(monitor, rows).alarm[3000:].mean() > 0.5
    assert made.drifts == {"y3": "keep"}
    note = next(note for note in made.generator.evidence.notes if "drifts" in note)
    assert note.startswith("'y3' drifts: its mean moves by")
    assert "drifts='leave out' or 'difference' treats it" in note


def test_channels_are_treated_by_name() -> None:
    rows = loaded()
    made = rs.identify.principal_components(rows, drifts={"y1": "leave out", "y3": "difference", "y4": "keep"})
    assert made.generator.faults == ("y2 sensor", "y3 sensor", "y4 sensor", "y5 sensor")
    assert any("'y1' keeps its level; left out" in note for note in made.generator.evidence.notes)
    short = rs.identify.principal_components(rows[:50], drifts={"y1": "leave out"})
    assert any("'y1' was named" in note for note in short.generator.evidence.notes)


def test_inputs_that_drift_are_treated_too() -> None:
    rng = np.random.default_rng(0)
    u = np.column_stack([np.cumsum(rng.standard_normal(1000)), rng.standard_normal(1000)])
    y = u @ [[0.0], [2.0]] + 0.1 * rng.standard_normal((1000, 1))
    made = rs.identify.canonical_variates(u, y, lags=2, states=2, drifts="leave out")
    assert made.generator.faults == ("u2 actuator", "y1 sensor")


def test_bad_ways_are_refused() -> None:
    rows = loaded(rows=300)
    for wrong in ("drop", True, None, ["y3"], {"y3": "drop"}, {"y3": None}):
        with pytest.raises(SettingError, match="drifts must be one of 'keep', 'leave out', 'difference'"):
            rs.identify.principal_components(rows, drifts=wrong)  # pyright: ignore
    with pytest.raises(SettingError, match="there is no channel 'y9', only y1, y2"):
        rs.identify.principal_components(rows, drifts={"y9": "leave out"})
    walks = np.cumsum(np.random.default_rng(0).standard_normal((500, 2)), axis=0)
    with pytest.raises(DataError, match="all outputs are left out, since they drift: y1, y2"):
        rs.identify.principal_components(walks, drifts="leave out")


def test_recordings_that_are_too_short_are_refused_where_it_matters() -> None:
    rows = loaded(rows=59)
    with pytest.raises(DataError, match="59 complete rows of a recording at most: 60 are needed"):
        drifting_channels(rows)
    with pytest.raises(DataError, match="60 are needed to tell a drift from noise"):
        rs.identify.principal_components(rows, drifts="leave out")
    assert rs.identify.principal_components(rows).drifts == {}
    alternating = np.where(np.arange(400)[:, None] % 2, np.random.default_rng(0).standard_normal((400, 2)), np.nan)
    with pytest.raises(DataError, match="no two complete rows follow on each other"):
        rs.identify.principal_components(alternating, drifts={"y1": "difference"})


def test_values_without_squares_are_refused() -> None:
    rows = loaded(rows=300)
    rows[:, 1] *= 1e200
    with pytest.raises(DataError, match="y2: values so large that their squares overflow"):
        drifting_channels(rows)


def test_drifts_are_shown() -> None:
    assert repr(drifting_channels(np.random.default_rng(0).standard_normal((300, 2)))) == "Drifts(0 of 2 channels)"
    assert isinstance(drifting_channels(loaded()), Drifts)
