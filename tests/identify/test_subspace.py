"""Subspace identification: the truth is recovered, in open and closed loop, whatever the units; bad data are said."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import residua as rs
from effort import rounds
from recorded_plants import generated_plant, in_closed_loop, markov_parameters, recorded
from residua.errors import DataError, SettingError
from residua.identify import subspace_methods

METHODS = ("pbsid", "cva", "n4sid", "moesp")


def off(model: rs.identify.IdentifiedModel, plant: rs.Plant, count: int = 30) -> float:
    """Return the relative error of the first Markov parameters."""
    truth, made = (np.hstack(markov_parameters(one, count)) for one in (plant, model.plant))
    return float(np.linalg.norm(truth - made) / np.linalg.norm(truth))


@pytest.mark.parametrize("method", METHODS)
def test_noise_free_data_give_the_plant_to_rounding(method: str) -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 4, 7):
        plant = generated_plant(rng, n, 2, min(n, 2), least=0.05)
        u, y = recorded(plant, rng, 1500, 1e12)
        model = rs.identify.subspace(u, y, method=method, past=max(n, 2), dt=1.0)
        assert model.report.order == n
        assert off(model, plant) < 1e-6


@pytest.mark.parametrize("method", METHODS)
def test_poles_converge_at_the_root_of_the_samples(method: str) -> None:
    errors = np.zeros((2, 10))
    for case in range(10):
        rng = np.random.default_rng(100 + case)
        plant = generated_plant(rng, 3, 1, 2, least=0.1)
        for k, rows in enumerate((1500, 13_500)):
            u, y = recorded(plant, np.random.default_rng(case), rows, 10, process=True)
            errors[k, case] = off(
                rs.identify.subspace(u, y, method=method, order=3, max_order=3, past=15, dt=1.0), plant
            )
    ratio = np.median(errors[0] / errors[1])
    assert 2.0 < ratio < 4.5  # nine times the samples: 3


@pytest.mark.parametrize("plants", rounds(20, 100))
@pytest.mark.parametrize("closed", [False, True])
def test_the_order_is_right_in_95_of_100(closed: bool, plants: int) -> None:
    right = 0
    for case in range(plants):
        rng = np.random.default_rng(500 + case)
        n, m, p = int(rng.integers(1, 7)), int(rng.integers(1, 3)), int(rng.integers(1, 4))
        plant = generated_plant(rng, n, m, p, least=0.1)
        u, y = (in_closed_loop if closed else recorded)(plant, rng, 6000, 10)
        right += rs.identify.subspace(u, y, dt=1.0, max_order=9).report.order == n
    assert right >= 0.95 * plants


def test_closed_loop_biases_projections_and_not_the_predictor() -> None:
    """A controller moves the plant by the noise itself, with little else: only PBSID is right, as the report says."""
    rng = np.random.default_rng(5)
    plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1.0)
    x, rows = 0.0, 40_000
    u, y = np.zeros((rows, 1)), np.zeros((rows, 1))
    for k in range(rows):
        noise = rng.standard_normal()
        y[k] = x + noise
        u[k] = -0.7 * y[k] + 0.3 * rng.standard_normal()
        x = 0.9 * x + u[k, 0] + 0.7 * noise
    models = {name: rs.identify.subspace(u, y, order=1, past=12, method=name, dt=1.0) for name in ("pbsid", "moesp")}
    assert off(models["pbsid"], plant) < 0.1
    assert off(models["moesp"], plant) > 5 * off(models["pbsid"], plant)
    for name, model in models.items():
        assert model.report.feedback == (("y1", "u1"),), name
    assert "biases this method" in str(models["moesp"].report)


@pytest.mark.parametrize("order", [0, 1])
def test_an_order_too_small_is_no_controller(order: int) -> None:
    """Errors that go with inputs before them, which vary slowly, go with later ones too: nothing was fed back."""
    rng = np.random.default_rng(3)
    plant = rs.Plant([[0.95, 0.1], [0, 0.8]], [[0], [1.0]], [[1.0, 0]], dt=1.0)
    u = np.repeat(rng.standard_normal((200, 1)), 20, axis=0)
    y = plant.system("control").simulate(u) + 0.05 * rng.standard_normal((4000, 1))
    report = rs.identify.subspace(u, y, order=order, dt=1.0).report
    assert report.coloured
    assert report.feedback == ()
    assert "closed loop" not in str(report)
    u, y = in_closed_loop(plant, rng, 4000, 2, dither=0.1)
    assert rs.identify.subspace(u, y, order=order, dt=1.0).report.feedback == (("y1", "u1"),)


def test_the_innovations_are_those_of_the_kalman_filter() -> None:
    rng = np.random.default_rng(2)
    plant = generated_plant(rng, 3, 1, 2, least=0.1).with_noise(process=0.05, measurement=[0.2, 0.1])
    truth = rs.design.kalman_filter(plant)
    noise = rng.standard_normal((60_000, len(plant.noises)))
    u = rng.standard_normal((60_000, 1))
    y = plant.system(("control", "noise")).simulate(np.hstack([u, noise]))
    model = rs.identify.subspace(u, y, order=3, dt=1.0)
    made = rs.design.kalman_filter(model.plant.with_sensor_faults())
    assert truth.covariance is not None
    assert made.covariance is not None
    np.testing.assert_allclose(made.covariance, truth.covariance, rtol=0.05, atol=0.01)
    np.testing.assert_allclose(model.innovation_covariance, truth.covariance, rtol=0.05, atol=0.01)
    np.testing.assert_allclose(made.observer.K, model.gain, atol=1e-6)  # the design finds the gain that was identified
    assert not model.report.coloured
    assert max(np.abs(model.report.predictor_poles)) < 1


def test_units_change_nothing() -> None:
    rng = np.random.default_rng(3)
    plant = generated_plant(rng, 4, 2, 2, least=0.05)
    u, y = recorded(plant, rng, 4000, 10)
    one = rs.identify.subspace(u, y, dt=1.0)
    for a, b in ((2.0**20, 2.0**-20), (2.0**-20, 2.0**11)):
        other = rs.identify.subspace(u * [a, 1.0], y * [1.0, b], dt=1.0)
        assert other.report.order == one.report.order
        np.testing.assert_array_equal(other.report.criterion, one.report.criterion)
        np.testing.assert_array_equal(other.plant.A, one.plant.A)
        np.testing.assert_array_equal(other.plant.B * [a, 1.0], one.plant.B)
        np.testing.assert_array_equal(other.plant.C, one.plant.C * [[1.0], [b]])


def test_levels_are_the_operating_point() -> None:
    rng = np.random.default_rng(4)
    plant = generated_plant(rng, 3, 2, 2, least=0.05)
    u, y = recorded(plant, rng, 4000, 30)
    model = rs.identify.subspace(u + [5.0, -2e4], y + [1e5, 300.0], dt=1.0)
    moved = plant.system("control").dc_gain() @ (model.plant.operating_point.inputs - np.array([5.0, -2e4]))
    np.testing.assert_allclose(model.plant.operating_point.outputs - np.array([1e5, 300.0]), moved, atol=0.2)
    assert off(model, plant) < 0.02


def test_gaps_and_several_recordings_are_cut_not_joined() -> None:
    rng = np.random.default_rng(6)
    plant = generated_plant(rng, 2, 1, 1, least=0.1)
    parts = [recorded(plant, rng, 1500, 20) for _ in range(3)]
    parts[1][1][700] = np.nan
    model = rs.identify.subspace([(u, y) for u, y in parts], dt=1.0, order=2)
    assert off(model, plant) < 0.03
    assert any("1 row of 4500 with a missing value" in note for note in model.report.notes)
    joined = np.vstack([u for u, _ in parts]), np.vstack([y for _, y in parts])
    assert rs.identify.subspace(*joined, dt=1.0, order=2).report.samples > model.report.samples - 1


def test_a_known_delay_is_states_of_the_plant() -> None:
    rng = np.random.default_rng(7)
    plant = generated_plant(rng, 2, 2, 1, least=0.1)
    u, y = recorded(plant, rng, 5000, 30)
    late = u.copy()
    late[:-4, 0] = u[4:, 0]  # the plant answers to what was recorded four rows before
    model = rs.identify.subspace(late[:-4], y[:-4], inputs=["a", "b"], outputs=["y"], delays={"a": 4}, order=2, dt=1.0)
    assert model.plant.n_states == 6
    made, truth = markov_parameters(model.plant, 20), markov_parameters(plant, 20)
    assert all(np.abs(one[:, 0]).max() < 1e-12 for one in made[:4])
    np.testing.assert_allclose([one[0, 0] for one in made[4:]], [one[0, 0] for one in truth[:16]], atol=0.05)
    plain = rs.identify.subspace(late[:-4], y[:-4], dt=1.0)
    assert plain.report.excitation.delays[0].tolist()[0] >= 5  # and without being told, the report shows it


def test_feedthrough_is_asked_for_not_guessed() -> None:
    rng = np.random.default_rng(8)
    u = rng.standard_normal((4000, 1))
    plant = rs.Plant([[0.7]], [[1.0]], [[1.0]], [[2.0]], dt=1.0)
    y = plant.system("control").simulate(u) + 0.1 * rng.standard_normal((4000, 1))
    assert any("feedthrough=True" in note for note in rs.identify.subspace(u, y, dt=1.0).report.notes)
    model = rs.identify.subspace(u, y, dt=1.0, feedthrough=True)
    assert model.report.order == 1
    np.testing.assert_allclose(model.plant.D, [[2.0]], atol=0.02)


def test_held_out_fit_is_on_rows_that_the_model_has_not_seen() -> None:
    rng = np.random.default_rng(9)
    plant = generated_plant(rng, 2, 1, 1, least=0.1)
    u, y = recorded(plant, rng, 4000, 10)
    one = rs.identify.subspace(u, y, dt=1.0)
    spoilt = y.copy()
    spoilt[3000:] = rng.standard_normal((1000, 1)) * y.std()
    other = rs.identify.subspace(u, spoilt, dt=1.0)
    np.testing.assert_array_equal(one.plant.A, other.plant.A)
    assert one.report.held_out.fit[0] > 0.8 > 0.2 > other.report.held_out.fit[0]
    assert rs.identify.subspace(u, y, dt=1.0, held_out=0).report.held_out is None


def test_the_spread_of_parts_covers_the_truth() -> None:
    inside = 0
    for case in range(40):
        rng = np.random.default_rng(900 + case)
        plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1.0)
        u, y = recorded(plant, rng, 3000, 3)
        gain = rs.identify.subspace(u, y, order=1, past=10, dt=1.0).report.steady_gain
        inside += abs(gain.gain[0, 0] - 5.0) < 2 * gain.error[0, 0]
    assert inside >= 34  # of 40 at 95 %: 38; fewer than 34 happen once in 500 times


def test_the_uncertain_plant_holds_the_estimates_of_the_parts() -> None:
    rng = np.random.default_rng(10)
    plant = generated_plant(rng, 2, 1, 2, least=0.1)
    u, y = recorded(plant, rng, 6000, 10)
    model = rs.identify.subspace(u, y, dt=1.0)
    uncertain = model.uncertain_plant(model.plant.with_actuator_faults().with_sensor_faults())
    assert uncertain.nominal.faults == ("u1 actuator", "y1 sensor", "y2 sensor")
    member = uncertain.member(uncertain.high)
    np.testing.assert_allclose(member.Bf[:, 0], member.B[:, 0], rtol=1e-9)
    gains = [(m.C @ np.linalg.solve(np.eye(m.n_states) - m.A, m.B)).ravel() for m in uncertain.sample(0, 100)]
    truth = (plant.C @ np.linalg.solve(np.eye(2) - plant.A, plant.B)).ravel()
    assert (np.min(gains, axis=0) < truth).all()
    assert (truth < np.max(gains, axis=0)).all()


# ---------------------------------------------------------------------- bad data


def good(rows: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return recorded(generated_plant(rng, 2, 2, 2, least=0.1), rng, rows, 10)


def test_channels_that_say_nothing_are_refused_by_name() -> None:
    u, y = good()
    options = {"inputs": ["a", "b"], "outputs": ["c", "d"], "dt": 1.0}
    still = np.column_stack([y[:, 0], np.full(len(y), 7.3)])
    with pytest.raises(DataError, match="d never moves"):
        rs.identify.subspace(u, still, **options)
    with pytest.raises(DataError, match="'a' and 'b' are the same signal"):
        rs.identify.subspace(np.column_stack([u[:, 0], -3 * u[:, 0]]), y, **options)
    with pytest.raises(DataError, match="the output 'd' is the input 'a'"):
        rs.identify.subspace(u, np.column_stack([y[:, 0], 5 * u[:, 0]]), **options)
    with pytest.raises(DataError, match="linear functions of one another"):
        rs.identify.subspace(u, np.column_stack([y[:, 0], y[:, 0] + 2 * u[:, 0]]), **options)
    with pytest.raises(DataError) as both:  # all at once, so that one correction is enough
        rs.identify.subspace(np.column_stack([u, np.full(len(y), 2.0), u[:, 1]]), still, outputs=["c", "d"], dt=1.0)
    assert "u3, d never move" in str(both.value)
    assert "'u2' and 'u4' are the same signal" in str(both.value)
    with pytest.raises(SettingError, match="a cannot be an input and an output"):
        rs.identify.subspace(u, y, inputs=["a", "b"], outputs=["a", "d"], dt=1.0)
    with pytest.raises(DataError, match="overflow"):
        rs.identify.subspace(u, y * 1e200, **options)


def test_too_few_rows_and_missing_values_are_refused_with_numbers() -> None:
    u, y = good(12)
    with pytest.raises(DataError, match=r"12 rows|9 rows"):
        rs.identify.subspace(u, y, dt=1.0)
    u, y = good()
    with pytest.raises(DataError, match=r"windows? of \d+ rows in the data"):
        rs.identify.subspace(u, y, dt=1.0, past=2000)
    y[:, 1] = np.nan
    with pytest.raises(DataError, match="'y2' is missing in 3000 of 3000 rows"):
        rs.identify.subspace(u, y, dt=1.0)
    every_second = good()[1]
    every_second[::2] = np.nan
    with pytest.raises(DataError, match="too few data"):
        rs.identify.subspace(u, every_second, dt=1.0)


def test_settings_that_are_none_are_refused() -> None:
    u, y = good()
    for options in (
        {"method": "magic"},
        {"order": -1},
        {"order": 2.5},
        {"order": 500},
        {"past": 0},
        {"held_out": 1.0},
        {"delays": {"u9": 1}},
        {"delays": {"u1": -1}},
        {"dt": 0.0},
    ):
        with pytest.raises((SettingError, DataError)):
            rs.identify.subspace(u, y, **({"dt": 1.0} | options))
    with pytest.raises(DataError, match="u has 3000 rows"):
        rs.identify.subspace(u, y[:-1], dt=1.0)


def test_drift_few_values_and_other_units_are_said() -> None:
    u, y = good()
    y[:, 0] += np.linspace(0, 50, len(y))
    y[:, 1] = np.round(y[:, 1] / np.ptp(y[:, 1]) * 5)
    notes = " ".join(rs.identify.subspace(u, y, dt=1.0).report.notes)
    assert "'y1' drifts" in notes
    assert "'y2' takes only" in notes
    parts = [good(), good(), good()]
    parts[1][1][:, 0] *= 1000
    notes = " ".join(rs.identify.subspace(parts, dt=1.0).report.notes)
    assert "'y1' may be in other units in recording 2 (level" in notes


def test_a_model_of_nothing_and_a_check_of_nothing_are_said() -> None:
    rng = np.random.default_rng(13)
    notes = rs.identify.subspace(rng.standard_normal((500, 1)), rng.standard_normal((500, 1)), dt=1.0).report.notes
    assert any("no states" in note for note in notes)
    report = rs.identify.subspace(*good(), held_out=0.001, dt=1.0).report
    assert report.held_out is None
    assert any("nothing is judged on held-out rows: 3 in a row" in note for note in report.notes)


def test_little_dither_is_said_with_its_share() -> None:
    rng = np.random.default_rng(12)
    plant = generated_plant(rng, 2, 1, 1, least=0.1)
    u, y = in_closed_loop(plant, rng, 5000, 10, dither=1e-3)
    report = rs.identify.subspace(u, y, dt=1.0).report
    assert report.weak_inputs == ("u1",)
    assert "dither" in str(report)


# ---------------------------------------------------------------------- another package


def test_never_worse_than_another_n4sid_on_held_out_data() -> None:
    nfoursid = pytest.importorskip("nfoursid.nfoursid", exc_type=ImportError)
    pandas = pytest.importorskip("pandas")
    from nfoursid.kalman import Kalman

    ours, theirs = [], []
    for case in range(6):
        rng = np.random.default_rng(40 + case)
        plant = generated_plant(rng, 3, 1, 1, least=0.1)
        u, y = recorded(plant, rng, 4000, 10, process=True)
        frame = pandas.DataFrame({"u": u[:3000, 0], "y": y[:3000, 0]})
        other = nfoursid.NFourSID(frame, output_columns=["y"], input_columns=["u"], num_block_rows=15)
        other.subspace_identification()
        system, covariance = other.system_identification(rank=3)
        kalman = Kalman(system, covariance)
        predicted = []
        for k in range(3000, 4000):
            predicted.append(float(np.squeeze(system.c @ kalman.x_predicteds[-1] if kalman.x_predicteds else 0.0)))
            kalman.step(y[k][:, None], u[k][:, None])
        theirs.append(np.std(y[3050:, 0] - np.array(predicted)[50:]))
        report = rs.identify.subspace(u, y, order=3, dt=1.0).report
        ours.append(report.held_out.error[0])
    assert np.all(np.array(ours) <= 1.02 * np.array(theirs))


@pytest.mark.parametrize(
    ("option", "value"),
    [("order", None), ("past", None), ("max_order", "auto"), ("held_out", "a"), ("held_out", None), ("order", 2.0)],
)
def test_options_of_another_kind_are_refused_by_name(option: str, value: object) -> None:
    u, y = recorded(rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1.0), np.random.default_rng(0), 300, 10)
    with pytest.raises(SettingError, match=f"^{option} must be"):
        rs.identify.subspace(u, y, dt=1.0, **{option: value})


def test_an_order_may_be_a_numpy_integer() -> None:
    u, y = recorded(rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1.0), np.random.default_rng(0), 600, 10)
    with pytest.raises(DataError, match="states at most"):
        rs.identify.subspace(u, y, dt=1.0, past=3, order=np.int64(100))
    assert rs.identify.subspace(u, y, dt=1.0, past=5, order=np.int64(3), max_order=3).report.orders == (0, 1, 2, 3)


def test_a_recording_of_which_no_row_is_left_moves_no_note_to_another() -> None:
    """A delay takes the whole of a short recording: notes on the others keep their names."""
    plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1.0)
    u, y = recorded(plant, np.random.default_rng(0), 2003, 10)
    short, usual, large = (u[:3], y[:3]), (u[3:1503], y[3:1503]), (100 * u[1503:], 100 * y[1503:])
    model = rs.identify.subspace([short, usual, usual, large], dt=1.0, inputs=["u1"], delays={"u1": 5})
    notes = [note for note in model.report.notes if "in other units" in note]
    assert notes
    assert all("in recording 4" in note for note in notes)


def test_moesp_has_no_states_that_its_shift_cannot_tell_apart() -> None:
    plant = rs.Plant([[0.8, 0.2], [0.0, 0.5]], [[1.0], [0.5]], np.eye(2), dt=1.0)
    u, y = recorded(plant, np.random.default_rng(0), 2000, 10)
    with pytest.raises(SettingError, match="at least 2 for 'moesp'"):
        rs.identify.subspace(u, y, dt=1.0, method="moesp", past=1)
    with pytest.raises(DataError, match="the data support 4 states at most"):
        rs.identify.subspace(u, y, dt=1.0, method="moesp", past=3, order=5)
    model = rs.identify.subspace(u, y, dt=1.0, method="moesp", past=2, order=2)
    np.testing.assert_allclose(np.sort(model.report.poles.real), [0.5, 0.8], atol=0.05)


def test_moesp_takes_two_rows_where_one_is_enough_for_a_predictor() -> None:
    rng = np.random.default_rng(1)
    u, noise = rng.standard_normal((2, 1500, 1))
    y = np.zeros((1500, 1))
    for k in range(1499):
        y[k + 1] = 0.8 * y[k] + u[k] + 0.1 * noise[k]
    assert rs.identify.subspace(u, y, dt=1.0, past="auto").report.past == 1
    model = rs.identify.subspace(u, y, dt=1.0, method="moesp")
    assert model.report.past == 2
    np.testing.assert_allclose(model.report.poles.real, [0.8], atol=0.02)


# ---------------------------------------------------------------------- what is said of little data


def test_a_largest_order_below_the_order_is_refused() -> None:
    u, y = good()
    with pytest.raises(SettingError, match="max_order must be at least the order that is asked for, 3, got 2"):
        rs.identify.subspace(u, y, order=3, max_order=2, dt=1.0)
    assert rs.identify.subspace(u, y, order=2, max_order=2, dt=1.0).report.order == 2


def slow(rows: int, *, pole: float = 0.9995) -> tuple[np.ndarray, np.ndarray]:
    return recorded(rs.Plant([[pole]], [[1 - pole]], [[1.0]], dt=1.0), np.random.default_rng(0), rows, 10)


def test_a_steady_gain_by_transients_alone_is_said_to_be_one() -> None:
    """A time constant of about 2000 rows: not in 4000, but in 40000."""
    notes = rs.identify.subspace(*slow(4000), order=1, dt=2.0).report.notes
    (note,) = (one for one in notes if "a pole lies near one" in one)
    assert "the longest stretch without a gap has 6000 s" in note
    for data in (slow(4000, pole=0.9), slow(40_000)):
        notes = rs.identify.subspace(*data, order=1, dt=2.0).report.notes
        assert not any("a pole lies near one" in one for one in notes)


def test_what_standard_errors_are_from_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = good(80)
    model = rs.identify.subspace(u, y, order=1, past=4, dt=1.0)
    assert not model.resampled
    assert any("no standard errors: the rows make" in one for one in model.report.notes)
    u, y = good()
    assert not any("standard errors" in one for one in rs.identify.subspace(u, y, dt=1.0).report.notes)
    real, calls = subspace_methods.realise, []

    def failing(factor: Any, *rest: Any, **options: Any) -> Any:
        calls.append(factor)
        if len(calls) in (2, 5):
            raise DataError("no stable predictor")
        return real(factor, *rest, **options)

    monkeypatch.setattr(subspace_methods, "realise", failing)
    model = rs.identify.subspace(u, y, order=2, dt=1.0)
    assert len(model.resampled) == 14
    assert any("standard errors are from 14 of 16 parts of the data" in one for one in model.report.notes)


def test_why_there_is_no_fit_from_inputs_is_said() -> None:
    u, y = slow(12_000, pole=0.999)
    pieces = [(u[k : k + 3000], y[k : k + 3000]) for k in range(0, 12_000, 3000)]
    short = rs.identify.subspace(pieces, order=1, dt=1.0).report
    assert short.checked.simulated_fit is None
    assert "no fit from inputs: the start of a simulation is left out until 1 % of it is left" in str(short)
    whole = rs.identify.subspace(u, y, order=1, dt=1.0, held_out=0.0).report
    assert whole.checked.simulated_fit is not None
    assert "no fit from inputs" not in str(whole)
    assert "there are no inputs" in str(rs.identify.subspace(None, y, order=1, dt=1.0).report)


def test_a_gain_that_no_row_shows_is_unknown_however_alike_the_parts_are() -> None:
    """A controller without noise of its own computes the input from the outputs: a gain near zero is no finding."""
    rng = np.random.default_rng(12)
    plant = rs.Plant([[0.95]], [[1.0]], [[1.0]], dt=1.0)
    x, integral, rows = 0.0, 0.0, 3000
    u, y = np.zeros((rows, 1)), np.zeros((rows, 1))
    for k in range(rows):
        y[k] = x + 0.5 * rng.standard_normal()
        integral -= 0.01 * y[k, 0]
        u[k] = integral - 0.1 * y[k, 0]
        x = plant.A[0, 0] * x + u[k, 0] + 0.05 * rng.standard_normal()
    report = rs.identify.subspace(u, y, dt=1.0).report
    assert report.excitation.unexplained[0] < 1e-20
    assert report.steady_gain.error is not None
    assert np.isinf(report.steady_gain.error).all()
    assert "'u1' on 'y1': unknown" in str(report)


@pytest.mark.parametrize("method", METHODS)
def test_a_large_order_gets_the_past_that_it_needs(method: str) -> None:
    rng = np.random.default_rng(3)
    u, y = recorded(generated_plant(rng, 14, 1, 1, least=0.0), rng, 3000, 3)
    report = rs.identify.subspace(u, y, order=14, method=method, dt=1.0).report
    assert report.order == 14
    assert report.past >= 15


def test_an_order_beyond_the_data_is_refused_with_the_largest_that_they_are_enough_for() -> None:
    u, y = good(800)
    with pytest.raises(DataError, match=r"order 900: it needs .* the data are enough for order (\d+);") as caught:
        rs.identify.subspace(u, y, order=900, dt=1.0)
    largest = int(re.findall(r"enough for order (\d+)", str(caught.value))[0])
    with pytest.raises(DataError, match="too few data for a model of order"):
        rs.identify.subspace(u, y, order=largest + 1, dt=1.0)
    report = rs.identify.subspace(u, y, order=largest, dt=1.0).report
    assert (report.order, report.orders[-4:]) == (largest, tuple(range(largest - 3, largest + 1)))
    assert len(report.orders) < 31  # not every order below is tried
    assert report.order_reason == "as asked for"
    assert str(report)
