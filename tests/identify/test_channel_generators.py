"""What all generators from recordings keep: units, exact responses to faults, names, files, and bad recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.optimize

import residua as rs
from recorded_examples import diagnosed, recorded
from residua.decide import Directional, NormThreshold
from residua.design.core.generator import DesignWithTest
from residua.errors import DataError, ModelError, SettingError
from residua.report.contributions import channels_by_reconstruction
from residua.testing import check_residual_generator

Maker = Callable[..., Any]
MAKERS: dict[str, Maker] = {
    "static components": lambda *data, **o: rs.identify.principal_components(*data, components=2, **o),
    "dynamic components": lambda *data, **o: rs.identify.principal_components(*data, lags=2, **o),
    "innovations": lambda *data, **o: rs.identify.canonical_variates(*data, **o),
    "variates": lambda *data, **o: rs.identify.canonical_variates(*data, lags=3, residuals="variates", **o),
    "moving average": lambda *data, **o: rs.identify.parity_from_data(*data, order=3, **o),
    "observer form": lambda *data, **o: rs.identify.parity_from_data(*data, order=3, poles=[0.5, 0.4, 0.3], **o),
}
each = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)


@each
def test_powers_of_two_as_units_change_no_bit(make: Maker) -> None:
    one = recorded(7, 0.2, 1500, outputs=3)
    m = one.u.shape[1]
    factors = np.exp2(np.linspace(-20, 20, one.rows.shape[1]).round())
    rows = one.rows + 3.0
    made, other = make(rows[:, :m], rows[:, m:]), make((rows * factors)[:, :m], (rows * factors)[:, m:])
    point = np.array(made.generator.plant.operating_point.outputs)
    assert np.array_equal(np.array(other.generator.plant.operating_point.outputs), point * factors)
    plain = made.generator.run(None, rows - point)
    assert np.array_equal(plain, other.generator.run(None, (rows - point) * factors))


@each
def test_answers_do_not_hang_on_any_units(make: Maker) -> None:
    one = recorded(7, 0.2, 1500, outputs=3)
    m = one.u.shape[1]
    factors = 10.0 ** np.linspace(-6, 6, one.rows.shape[1])
    rows = one.rows * factors
    made, other = make(one.u, one.y), make(rows[:, :m], rows[:, m:])
    assert made.generator.residuals == other.generator.residuals
    squares = [(one.generator.run(None, data) ** 2).sum(axis=1) for one, data in ((made, one.rows), (other, rows))]
    assert np.allclose(squares[0], squares[1], rtol=1e-5, atol=1e-8)


@each
def test_a_fault_of_a_channel_does_what_the_filter_does(make: Maker) -> None:
    one = recorded(7, 0.2, 1500, outputs=3)
    made = make(one.u, one.y, **one.names).generator
    m = one.u.shape[1]
    assert made.faults == tuple(
        [f"{n} actuator" for n in one.plant.inputs] + [f"{n} sensor" for n in one.plant.outputs]
    )
    fault = np.zeros(one.rows.shape[0])
    fault[100:] = np.linspace(0, 1, 1400)
    before = made.run(None, one.rows)
    for i in range(one.rows.shape[1]):
        rows = one.rows.copy()
        rows[:, i] += -fault if i < m else fault
        expected = made.internal_form().select(inputs=[i]).simulate(fault[:, None])
        assert np.allclose(made.run(None, rows) - before, expected, atol=1e-10)
    check_residual_generator(made)


@pytest.mark.parametrize("lags", [0, 2])
@pytest.mark.parametrize("seed", range(4))
def test_faults_of_channels_are_named_by_reconstruction(seed: int, lags: int) -> None:
    """Eight channels of two loads; each in turn is off by ten times its noise."""
    rng = np.random.default_rng(seed)
    loads = rng.standard_normal((2, 8))
    rows = rng.standard_normal((6000, 2)) @ (loads / np.linalg.norm(loads, axis=0))
    rows += 0.1 * rng.standard_normal(rows.shape)
    made = rs.identify.principal_components(rows[:2000], lags=lags)
    monitor = rs.Monitor(made).fit(None, rows[2000:4000], false_alarm_rate=0.001)
    for i, fault in enumerate(made.generator.faults):
        wrong = rows[4000:].copy()
        wrong[1000:, i] += 1.0
        out = diagnosed(monitor, wrong)
        assert out.named == ((fault,),)
        assert out.alarm[1010:].all()
        main = out.main_alarm
        assert main.fired[0] == "Q"


def test_the_score_is_what_reconstruction_takes_away() -> None:
    """Dunia and Qin: the squared norm less the least that is left of it after one channel is changed at will."""
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((3000, 2)) @ rng.standard_normal((2, 6)) + 0.1 * rng.standard_normal((3000, 6))
    made = rs.identify.principal_components(rows, components=2)
    monitor = rs.Monitor(made, isolate=Directional(window=1)).fit(None, rows)
    wrong = rows[:400].copy()
    wrong[200:, 3] += 2.0
    out = diagnosed(monitor, wrong)
    for k in (250, 399):
        r = out.residuals[k] - out.test.center
        for group, score in zip(out.groups, out.scores[k], strict=True):
            direction = made.generator.steady_directions[group[0]]
            least = scipy.optimize.minimize_scalar(lambda f, d=direction, r=r: ((r - f * d) ** 2).sum()).fun
            assert np.isclose(1 - least / (r @ r), score**2, atol=1e-8)


def test_the_page_shows_what_reconstruction_of_each_channel_takes_away(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((3000, 2)) @ rng.standard_normal((2, 6)) + 0.1 * rng.standard_normal((3000, 6))
    monitor = rs.Monitor(rs.identify.principal_components(rows, components=2)).fit(None, rows)
    wrong = rows[:400].copy()
    wrong[200:, 3] += 2.0
    out = diagnosed(monitor, wrong)
    name, share = channels_by_reconstruction(out)[0]
    taken = out.scores[out.main_alarm.start : out.main_alarm.stop, out.group_names.index(name)] ** 2
    assert name == "y4 sensor"
    assert np.isclose(share, taken.mean())
    out.to_html(tmp_path / "page.html")
    assert "Which channel explains the alarm" in (tmp_path / "page.html").read_text()


def test_channels_of_one_direction_are_one_group() -> None:
    """A single relation says that something is wrong, and nothing of which channel it is."""
    one = recorded(1, 0.1, outputs=3)
    made = rs.identify.parity_from_data(
        one.u, one.y, order=3, relations=1, inputs=one.plant.inputs, outputs=one.plant.outputs
    )
    out = diagnosed(rs.Monitor(made).fit(None, one.rows), one.rows)
    faults = [name for group in (*out.groups, out.naming.unjudged) for name in group]
    assert sorted(faults) == sorted(made.generator.faults)
    assert len(out.groups) == 1


@pytest.mark.parametrize("make", [m for name, m in MAKERS.items() if "components" not in name])
def test_faults_of_channels_are_named(make: Maker) -> None:
    """Each channel moves by two of its standard deviations in the second half."""
    one = recorded(0, 0.1, 6000, outputs=3)
    made = make(one.u[:2000], one.y[:2000], **one.names)
    monitor = rs.Monitor(made).fit(None, one.rows[2000:4000], false_alarm_rate=0.001)
    named = 0
    for i, fault in enumerate(made.generator.faults):
        rows = one.rows[4000:].copy()
        rows[1000:, i] += 2.0 * one.rows[:, i].std() * (-1 if "actuator" in fault else 1)
        out = diagnosed(monitor, rows)
        named += out.named == ((fault,),)
        assert not out.alarm[:1000].mean() > 0.02
    assert named >= len(made.generator.faults)


@each
def test_a_saved_monitor_gives_the_same_bits(make: Maker, tmp_path: Path) -> None:
    one = recorded(0, 0.1, 3000, outputs=3)
    made = make(one.u[:1500], one.y[:1500], **one.names)
    monitor = rs.Monitor(made).fit(None, one.rows[1500:])
    again = rs.Monitor.load(monitor.save(tmp_path / "monitor.json") or tmp_path / "monitor.json")
    rows = one.rows[1500:].copy()
    rows[700:, -1] += 3.0
    out, other = diagnosed(monitor, rows), diagnosed(again, rows)
    assert np.array_equal(out.residuals, other.residuals, equal_nan=True)
    assert np.array_equal(out.statistic, other.statistic, equal_nan=True)
    assert np.array_equal(out.parts.fired, other.parts.fired)
    assert out.named == other.named
    out.to_html(tmp_path / "page.html")
    assert "sensor" in (tmp_path / "page.html").read_text()


@each
def test_rows_with_missing_values_cut_the_recording(make: Maker) -> None:
    """The same as two recordings without them."""
    one = recorded(0, 0.1, 3000, outputs=3)
    u, y = one.u.copy(), one.y.copy()
    y[1000:1010, 0] = np.nan
    made = make(u, y)
    apart = make([(u[:1000], y[:1000]), (u[1010:], y[1010:])])
    assert np.array_equal(made.generator.system.D, apart.generator.system.D)
    assert any("10 rows of 3000 with a missing value" in note for note in made.generator.evidence.notes)


@each
def test_constant_and_doubled_names_and_short_recordings_are_refused(make: Maker) -> None:
    one = recorded(0, 0.1, 300, outputs=3)
    still = one.y.copy()
    still[:, 1] = 4.0
    with pytest.raises(DataError, match="y2 never moves"):
        make(one.u, still)
    with pytest.raises(DataError, match="are needed: give a longer recording"):
        make(one.u[:5], one.y[:5])
    with pytest.raises(SettingError, match="cannot be an input and an output"):
        make(one.u, one.y, inputs=[f"a{i}" for i in range(one.u.shape[1])], outputs=["a0", "b", "c"])


def test_large_recordings_are_read_block_by_block() -> None:
    """The factor of many blocks is that of all rows at once."""
    one = recorded(0, 0.1, 30_000, outputs=3)
    made = rs.identify.principal_components(one.rows, lags=1)
    z = (one.rows - made.mean) / made.spread
    x = np.hstack([z[1:], z[:-1]])
    assert made.samples == 29_999
    assert np.allclose(made.variances, np.linalg.eigvalsh(np.cov(x.T))[::-1], rtol=1e-9)


def test_a_monitor_takes_the_test_that_a_design_brings_unless_it_gets_another() -> None:
    one = recorded(0, 0.1, 1000, outputs=3)
    made = rs.identify.principal_components(one.rows)
    assert isinstance(made, DesignWithTest)
    assert rs.Monitor(made).test == made.test
    own = NormThreshold(window=5)
    assert rs.Monitor(made, test=own).test == own


def test_a_design_must_bring_settings_of_a_test() -> None:
    class Wrong:
        generator = rs.identify.principal_components(recorded(0, 0.1, 500).rows).generator
        test = "norm"

    with pytest.raises(ModelError, match="the test of this design must be TestSettings, got 'norm'"):
        rs.Monitor(Wrong())


def test_a_moving_average_decides_once_its_memory_is_full() -> None:
    """Its poles are all zero, and what was before the start is in the residual for as long as it reads it."""
    one = recorded(0, 0.1, 3000, outputs=3)
    rows = one.rows + 100.0  # far from zero, so that a wrong start would show
    made = rs.identify.parity_from_data(rows[:, : one.u.shape[1]], rows[:, one.u.shape[1] :], order=6)
    monitor = rs.Monitor(made, test=rs.decide.NormThreshold(), start="rest").fit(None, rows)
    out = diagnosed(monitor, rows[50:])
    assert int(np.argmax(out.decided)) == 6
    assert not out.alarm[:20].any()


def test_channels_come_as_one_array_or_as_inputs_and_outputs() -> None:
    one = recorded(7, 0.2, 1500, outputs=3)
    u, y = one.u, one.rows[:, one.u.shape[1] :]
    made = rs.identify.parity_from_data(u, y, order=3)
    apart, whole = rs.Monitor(made).fit(u[:1000], y[:1000]), rs.Monitor(made).fit(None, one.rows[:1000])
    expected = diagnosed(whole, one.rows[1000:]).statistic
    assert np.array_equal(diagnosed(apart, one.rows[1000:]).statistic, expected, equal_nan=True)
    pair = apart.run(u[1000:], np.ma.masked_invalid(y[1000:]))
    assert not isinstance(pair, list)
    assert np.array_equal(pair.statistic, expected, equal_nan=True)
    apart.reset()
    steps = [apart.step(a, b).statistic for a, b in zip(u[1000:], y[1000:], strict=True)]
    assert np.array_equal(steps, expected, equal_nan=True)
    for a, b in ((u, one.rows), (u[:, :0], y), (y, y), (u[5:], y)):
        with pytest.raises(DataError, match=r"columns of y, with None for u|y must be"):
            apart.run(a, b)


def test_frames_of_inputs_and_outputs_are_matched_by_name() -> None:
    one = recorded(7, 0.2, 1500, outputs=3)
    m = one.u.shape[1]
    names = [f"u{i}" for i in range(m)], ["a", "b", "c"]
    made = rs.identify.principal_components(one.u, one.rows[:, m:], inputs=names[0], outputs=names[1])
    monitor = rs.Monitor(made).fit(None, one.rows)
    u = pd.DataFrame(one.u, columns=names[0])
    y = pd.DataFrame(one.rows[:, m:], columns=names[1])[["c", "a", "b"]]
    found = monitor.run(u, y)
    assert not isinstance(found, list)
    assert np.array_equal(found.statistic, diagnosed(monitor, one.rows).statistic, equal_nan=True)


def test_a_path_is_read_for_the_plant(tmp_path: Path) -> None:
    one = recorded(7, 0.2, 600, outputs=3)
    rows = np.column_stack([np.arange(600.0), one.rows])
    names = [f"c{i}" for i in range(one.rows.shape[1])]
    for name, part in (("normal", rows[:300]), ("new", rows[300:])):
        np.savetxt(tmp_path / f"{name}.csv", part, delimiter=",", header=",".join(["time", *names]), comments="")
    made = rs.identify.principal_components(tmp_path / "normal.csv")
    plant = made.generator.plant
    monitor = rs.Monitor(made).fit(str(tmp_path / "normal.csv"))
    again = rs.Monitor(made).fit([rs.read_recording(tmp_path / "normal.csv", plant)])
    found, expected = monitor.run(tmp_path / "new.csv"), again.run(rs.read_recording(tmp_path / "new.csv", plant))
    assert not isinstance(found, list)
    assert not isinstance(expected, list)
    assert np.array_equal(found.statistic, expected.statistic, equal_nan=True)
    assert found.recording.source == "new.csv"
    with pytest.raises(DataError, match="shows no fault"):
        monitor.learn_fault("none", tmp_path / "new.csv", interval=(300, 600))
