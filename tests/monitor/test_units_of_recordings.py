"""A channel in other units than the model, or in some recordings, is named with its numbers."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.identify import IdentifiedModel
from residua.recording.levels import level_and_spread, units_between, units_of


def day(seed: int, samples: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Return a fault-free day of a heated tank: a valve in per cent, a temperature in Celsius, a flow."""
    rng = np.random.default_rng(seed)
    valve = 50 + 10 * np.repeat(rng.standard_normal(samples // 30), 30)
    heat = 20.0 + np.cumsum(rng.standard_normal(samples)) * 0.02
    temperature, flow = np.empty(samples), 3.0 + 0.02 * valve + 0.05 * rng.standard_normal(samples)
    now = 20.0
    for k in range(samples):
        now += 0.1 * (heat[k] + 0.1 * (valve[k] - 50) - now)
        temperature[k] = now + 0.1 * rng.standard_normal()
    return valve[:, None], np.column_stack([temperature, flow])


def model() -> IdentifiedModel:
    return rs.identify.subspace(
        [day(1), day(2)], inputs=["valve"], outputs=["temperature", "flow"], dt=60.0, progress=False
    )


CHANGES = {
    "Fahrenheit": ("temperature", lambda y: np.column_stack([1.8 * y[:, 0] + 32, y[:, 1]])),
    "thousand": ("flow", lambda y: y * [1.0, 1000.0]),
    "Kelvin": ("temperature", lambda y: y + [273.15, 0.0]),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_day_in_other_units_is_named_when_it_is_fitted_and_when_it_is_run(change: str) -> None:
    name, changed = CHANGES[change]
    made = model()
    monitor = rs.Monitor(rs.design.kalman_filter(made.plant.with_sensor_faults()))
    days = [day(3), day(4), day(5)]
    other = (days[2][0], changed(days[2][1]))
    clean = monitor.fit(days).fit_check
    assert clean is not None
    assert clean.units == ()
    assert not any("units" in note for note in monitor.run(*day(6)).notes)  # type: ignore[union-attr]
    notes = [note for note in monitor.run(*other).notes if "units" in note]  # type: ignore[union-attr]
    assert [note.split("'")[1] for note in notes] == [name]
    with_odd = monitor.fit([*days[:2], other]).fit_check
    assert with_odd is not None
    first, *_ = with_odd.units
    assert first.startswith(f"'{name}' may be in other units in recording 3 (level ")
    alone = monitor.fit(*other).fit_check
    assert alone is not None
    assert alone.units[0].startswith(f"'{name}' lies far from the operating point")
    assert any("units" in note for note in monitor.run(*other).notes)  # type: ignore[union-attr]


def test_of_two_recordings_nobody_is_blamed_and_of_three_the_odd_one() -> None:
    other = (day(2)[0], day(2)[1] * [1.0, 1000.0])
    both = rs.identify.subspace([day(1), other], inputs=["valve"], outputs=["temperature", "flow"], progress=False)
    (note,) = (one for one in both.report.notes if "units" in one)
    assert note.startswith("'flow' may be in different units in recording 1 (level 4")
    assert "and in recording 2 (level " in note
    assert "the data do not show which of them is right" in note
    for odd in range(3):
        days = [day(k) for k in range(1, 4)]
        days[odd] = (days[odd][0], days[odd][1] * [1.0, 1000.0])
        made = rs.identify.subspace(days, inputs=["valve"], outputs=["temperature", "flow"], progress=False)
        (note,) = (one for one in made.report.notes if "units" in one)
        assert note.startswith(f"'flow' may be in other units in recording {odd + 1} (level ")


def test_halves_are_not_told_apart_and_what_stands_still_is_not_compared() -> None:
    mean, spread = np.array([[1.0], [1.0], [1000.0], [1000.0]]), np.array([[1.0], [1.0], [1000.0], [1000.0]])
    (note,) = units_between(["flow"], ["a", "b", "c", "d"], mean, spread)
    assert "different units in a (level 1, spread 1) and b" in note
    assert "and in c (level 1000, spread 1000) and d" in note
    spread[2:] = 0.0
    assert units_between(["flow"], ["a", "b", "c", "d"], mean, spread) == []
    assert units_between(["flow"], ["a"], mean[:1], spread[:1]) == []


@pytest.mark.parametrize("units", [2.0**-20, 2.0**20])
def test_what_is_found_does_not_depend_on_units_that_all_recordings_share(units: float) -> None:
    rng = np.random.default_rng(0)
    factor = np.where(rng.random((5, 30)) < 0.05, 1000.0, 1.0)
    mean, spread = rng.uniform(90, 100, (5, 30)) * factor, rng.uniform(9, 10, (5, 30)) * factor
    names = [str(i) for i in range(30)]
    told = [one.split()[0] for one in units_between(names, "abcde", mean, spread)]
    assert told == [one.split()[0] for one in units_between(names, "abcde", units * mean, units * spread)]
    assert 0 < len(told) < 30


def test_a_fault_that_comes_later_is_not_taken_for_units() -> None:
    values = np.random.default_rng(0).standard_normal((1000, 1)) + 5.0
    values[500:] += 25.0
    assert units_of(["level"], values, np.array([5.0]), np.array([1.0]), "the fit") == []
    values += 25.0
    (note,) = units_of(["level"], values, np.array([5.0]), np.array([1.0]), "the fit")
    assert "against level 5, spread 1 there" in note


def test_a_saved_monitor_says_it_too(tmp_path) -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(model().plant.with_sensor_faults())).fit([day(3), day(4)])
    monitor.save(tmp_path / "monitor.json")
    u, y = day(5)
    notes = rs.Monitor.load(tmp_path / "monitor.json").run(u, y * [1000.0, 1.0]).notes  # type: ignore[union-attr]
    assert any(
        note.startswith("'temperature' is unlike the recordings that the monitor was fitted on") for note in notes
    )


@pytest.mark.parametrize("level", [0.1, 0.125, 273.15, -1e6 / 3])
def test_a_channel_that_stands_still_is_in_no_other_unit(level: float) -> None:
    """Whatever its value: the rounding of its mean is no spread, which would be tiny beside that of others."""
    still = np.where(np.arange(1000) % 7, level, np.nan)[:, None]
    mean, spread = level_and_spread(still)
    assert (mean[0], spread[0]) == (level, 0.0)
    means, spreads = np.array([[0.0], mean]), np.array([[1.0], spread])
    assert units_between(["valve"], ["a", "b"], means, spreads) == []
    assert units_of(["valve"], still, np.array([level + 100.0]), np.array([1.0]), "the fit") == []


def test_an_input_in_other_units_is_named_though_it_varies_much() -> None:
    """Turns in a minute, that is 1500 with a spread of 170, as turns in a second."""
    rng = np.random.default_rng(0)
    speed = 1500 + np.repeat(rng.uniform(-300, 300, 100), 30)[:, None]
    was = np.array([1480.0]), np.array([175.0])
    (note,) = units_of(["speed"], speed / 60, *was, "the fit")
    assert note.startswith("'speed' is unlike the fit: level 2")
    assert units_of(["speed"], speed, *was, "the fit") == []
    assert units_of(["speed"], 600 + 0.2 * speed, *was, "the fit") == []
    u, flow = speed, 0.1 * speed[:, 0] + rng.standard_normal(len(speed))
    plant = rs.Plant([[0.0]], [[0.1]], [[1.0]], dt=1, inputs=["speed"]).with_sensor_faults()
    plant = plant.with_noise(process=1e-4, measurement=1.0)
    plant = plant.with_operating_point(inputs=[1500.0], outputs=[150.0])
    monitor = rs.Monitor(rs.design.kalman_filter(plant)).fit(u, flow[:, None])
    diagnosis = monitor.run(u / 60, flow[:, None])
    assert [note.split("'")[1] for note in diagnosis.notes if "units" in note] == ["speed"]  # type: ignore[union-attr]


def test_all_channels_in_fahrenheit_are_named_though_they_wander() -> None:
    """Spreads of short recordings of slow signals are less alike than those of one that is in Fahrenheit for sure."""
    rng = np.random.default_rng(0)
    was = np.array([60.0, 20.0, 5.0]), np.array([6.0, 4.0, 1.0])
    alike = was[0] + was[1] * [1.0, 0.8, 1.0] * rng.standard_normal((1000, 3))
    notes = units_of(["a", "b", "flow"], np.column_stack([1.8 * alike[:, :2] + 32, alike[:, 2]]), *was, "the fit")
    assert [note.split("'")[1] for note in notes] == ["a", "b"]
    only = np.column_stack([alike[:, 0], 1.8 * alike[:, 1] + 32, alike[:, 2]])
    assert units_of(["a", "b", "flow"], alike, *was, "the fit") == []
    assert units_of(["a", "b", "flow"], only, *was, "the fit") == []


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_all_channels_times_ten_are_unlike_the_fit(factor: float) -> None:
    design = rs.design.kalman_filter(model().plant.with_sensor_faults())
    monitor = rs.Monitor(design).fit([day(3), day(4)], dt=60.0)
    u, y = day(5)
    middle = [one.mean(axis=0) for one in (u, y)]
    assert not monitor.run(u, y).recording.is_unlike_the_fit
    same_level = monitor.run(middle[0] + factor * (u - middle[0]), middle[1] + factor * (y - middle[1]))
    assert same_level.recording.is_unlike_the_fit  # a gain about the level, which the level does not show
    assert any(f"all 3 channels move {factor:g} times as much" in note for note in same_level.notes)
    assert monitor.run(factor * u, factor * y).recording.is_unlike_the_fit
