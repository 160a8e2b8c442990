"""Equations from recordings: least squares, their errors, their orders, and what they become."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from arx_plants import TrueEquations, true_equations
from residua.errors import DataError, SettingError
from residua.identify.arx import ArxModel, PastOf

ROWS = 3000
#: Standard errors within which 95 % of estimates lie; and how far the share of some 900 of them may be off by chance.
QUANTILE, CHANCE = 1.96, 0.03
#: Standard errors that none of some 900 estimates is off: chance passes it once in ten thousand such sets.
FAR = 5.5
#: Sums of a few hundred rounded products, relative to the largest.
ROUNDED = 1e-9


def standardised(made: ArxModel, true: TrueEquations) -> NDArray[np.float64]:
    """Return the errors of all coefficients in units of their standard errors."""
    out = []
    for i, one in enumerate(made.report.equations):
        for (name, row), value, error in zip(one.terms, one.coefficients, one.standard_errors, strict=True):
            side = true.a if name[0] == "y" else true.b
            exact = side[row, i, int(name[1:]) - 1] if row < len(side) else 0.0
            out.append((value - exact) / error)
    return np.array(out)


@cache
def sixty_plants() -> tuple[int, int, NDArray[np.float64]]:
    """Return how many orders were chosen right, of how many, and the standardised errors with the true orders."""
    right, count, errors = 0, 0, []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        orders = tuple(int(n) for n in rng.integers(1, 7, rng.integers(1, 3)))
        true = true_equations(rng, orders, int(rng.integers(1, 3)))
        u, y = true.recorded(rng, ROWS, (10.0, 100.0)[seed % 2])
        chosen = rs.identify.arx(u, y, held_out=0.2).report.equations
        right += sum(one.order == n and not one.coupled for one, n in zip(chosen, orders, strict=True))
        count += len(orders)
        by_output = {f"y{i + 1}": n for i, n in enumerate(orders)}
        errors.append(standardised(rs.identify.arx(u, y, order=by_output, past_of="own", held_out=0), true))
    return right, count, np.concatenate(errors)


def test_the_true_coefficients_lie_within_their_standard_errors() -> None:
    _, _, errors = sixty_plants()
    assert len(errors) > 800
    assert np.abs(errors).max() < FAR
    assert abs(np.mean(np.abs(errors) < QUANTILE) - 0.95) < CHANCE


def test_the_order_is_chosen_right() -> None:
    right, count, _ = sixty_plants()
    assert right >= 0.95 * count


@pytest.mark.parametrize("seed", range(3))
def test_errors_shrink_with_the_root_of_the_samples(seed: int) -> None:
    true = true_equations(np.random.default_rng(seed), (3, 2), 1)
    sizes = []
    for rows in (500, 8000):
        squares = 0.0
        for again in range(20):
            u, y = true.recorded(np.random.default_rng([seed, rows, again]), rows, 10.0)
            made = rs.identify.arx(u, y, order={"y1": 3, "y2": 2}, past_of="own", held_out=0)
            errors = standardised(made, true) * np.concatenate([e.standard_errors for e in made.report.equations])
            squares += float(errors @ errors)
        sizes.append(np.sqrt(squares))
    assert 3.0 < sizes[0] / sizes[1] < 5.3  # 4, known to an eighth from twenty recordings each


# --------------------------------------------------------------------------- oracle


def stacked(pieces: list[NDArray[np.float64]], i: int, order: int, m: int, coupled: bool) -> tuple[NDArray, NDArray]:
    """Return regressors (constant last) and targets of one output, written out row by row."""
    rows, targets = [], []
    for Z in pieces:
        columns = list(range(m)) + (list(range(m, Z.shape[1])) if coupled else [m + i])
        for k in range(order, len(Z)):
            rows.append(np.concatenate([*(Z[k - row, columns] for row in range(1, order + 1)), [1.0]]))
            targets.append(Z[k, m + i])
    return np.array(rows), np.array(targets)


@pytest.mark.parametrize("coupled", [False, True])
def test_it_is_the_least_squares_solution_over_recordings_with_gaps(coupled: bool) -> None:
    rng = np.random.default_rng(5)
    true = true_equations(rng, (2, 2), 2)
    first, second = true.recorded(rng, 400, 5.0), true.recorded(rng, 300, 5.0)
    first[1][:] += [20.0, -3.0]
    second[1][:] += [20.0, -3.0]
    first[1][100:103, 1], first[0][250, 0] = np.nan, np.nan
    made = rs.identify.arx([first, second], order=2, past_of="all" if coupled else "own", held_out=0)
    whole = [np.hstack(first), np.hstack(second)]
    pieces = [whole[0][:100], whole[0][103:250], whole[0][251:], whole[1]]
    for i, one in enumerate(made.report.equations):
        X, target = stacked(pieces, i, 2, 2, coupled)
        theta, (squares,), _, _ = np.linalg.lstsq(X, target)
        assert np.allclose(one.coefficients, theta[:-1], rtol=0, atol=ROUNDED * np.abs(theta[:-1]).max())
        variance = squares / (len(X) - X.shape[1])
        errors = np.sqrt(variance * np.diag(np.linalg.inv(X.T @ X)))[:-1]
        assert np.allclose(one.standard_errors, errors, rtol=1e-6)
        assert one.error == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_predictions_are_those_of_the_stacked_regression_and_judged_as_such() -> None:
    rng = np.random.default_rng(6)
    u, y = true_equations(rng, (3, 1), 1).recorded(rng, 800, 5.0)
    made = rs.identify.arx(u, y, order={"y1": 3, "y2": 1}, past_of="own")
    [seen] = made.predict(u, y)
    X, target = stacked([np.hstack([u, y])[:600]], 0, 3, 1, coupled=False)
    error = target - X @ np.linalg.lstsq(X, target)[0]
    assert np.allclose(seen.error[3:600, 0], error, atol=ROUNDED)
    assert np.isnan(seen.predicted[:3]).all()
    assert np.isfinite(seen.predicted[3:]).all()
    held_out = made.report.held_out
    assert np.allclose(held_out.error, np.sqrt(np.mean(seen.error[603:] ** 2, axis=0)), rtol=1e-6)
    shares = made.report.equations[0].choice.held_out_errors[0]
    assert 0 < shares[3] < shares[0]


def test_covariances_between_equations_hold() -> None:
    true, mix = true_equations(np.random.default_rng(1), (1, 2), 1), np.array([[1.0, 0.0], [0.9, 0.4]])
    values, said = [], []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal((400, 1))
        y = true.simulated(u, 0.5 * rng.standard_normal((400, 2)) @ mix.T)
        made = rs.identify.arx(u, y, order={"y1": 1, "y2": 2}, past_of="own", held_out=0)
        values.append(np.concatenate([one.coefficients for one in made.report.equations]))
        said.append(made.covariance)
    unit = np.std(values, axis=0)
    seen, mean = np.corrcoef(np.transpose(values)), np.mean(said, axis=0)
    # 150 recordings: correlations are known to 0.08, standard deviations to 6 %
    assert np.abs(mean / np.outer(unit, unit) - seen).max() < 0.3
    assert np.abs(mean[:2, 2:] / np.outer(unit[:2], unit[2:])).max() > 0.3


# --------------------------------------------------------------------------- what becomes of it


@pytest.mark.parametrize("past_of", ["own", "all"])
@pytest.mark.parametrize("feedthrough", [False, True])
def test_model_and_plant_are_the_same(past_of: PastOf, feedthrough: bool) -> None:
    rng = np.random.default_rng(8)
    u, y = true_equations(rng, (2, 3), 2).recorded(rng, 1000, 5.0)
    delayed = np.vstack([np.zeros((2, 2)), y[:-2]])
    made = rs.identify.arx(
        u,
        delayed,
        order={"y1": 0, "y2": 3} if past_of == "own" else 2,
        past_of=past_of,
        feedthrough=feedthrough,
        delays={"u1": 2, "u2": 1},
    )
    points = np.exp(1j * np.linspace(0.1, 3, 7))
    G, D = made.model.transfer(points, "control"), made.plant.system("control")
    for point, value in zip(points, G, strict=True):
        exact = D.C @ np.linalg.solve(point * np.eye(len(D.A)) - D.A, D.B) + D.D
        assert np.allclose(value, exact, atol=ROUNDED)
    assert made.model.operating_point == made.plant.operating_point
    gain = made.report.steady_gain
    assert np.allclose(gain.gain, D.dc_gain(), atol=ROUNDED)


def test_delays_that_are_known_need_no_coefficients() -> None:
    rng = np.random.default_rng(2)
    u, y = true_equations(rng, (1,), 1).recorded(rng, 2000, 10.0)
    late = np.vstack([np.zeros((3, 1)), y[:-3]])
    made = rs.identify.arx(u, late, delays={"u1": 3})
    [one] = made.report.equations
    assert one.order == 1
    assert one.terms == (("u1", 4), ("y1", 1))


def test_standard_errors_of_steady_gains_are_calibrated() -> None:
    true = true_equations(np.random.default_rng(3), (2, 1), 1)
    exact = np.linalg.solve(np.eye(2) - true.a.sum(axis=0), true.b.sum(axis=0))
    inside = []
    for seed in range(100):
        u, y = true.recorded(np.random.default_rng(seed), 500, 5.0)
        gain = rs.identify.arx(u, y, order=2, past_of="all", held_out=0).report.steady_gain
        assert gain.error is not None
        inside.append(np.abs(gain.gain - exact) < QUANTILE * gain.error)
    assert np.abs(np.mean(inside, axis=0) - 0.95).max() < 0.07  # a hundred recordings


def test_the_uncertain_plant_varies_as_the_coefficients_do() -> None:
    rng = np.random.default_rng(4)
    u, y = true_equations(rng, (2,), 1).recorded(rng, 1000, 5.0)
    made = rs.identify.arx(u, y, order=2, held_out=0)
    uncertain = made.uncertain_plant(made.plant.with_sensor_faults().with_actuator_faults(), directions=4)
    sizes, directions = made.basis.directions(4)
    A = sum(size**2 * one["A"][:, 0] ** 2 for size, one in zip(sizes, directions, strict=True))
    B = sum(size**2 * one["B"][:, 0] ** 2 for size, one in zip(sizes, directions, strict=True))
    errors = made.report.equations[0].standard_errors  # of u[k-1], y[k-1], u[k-2], y[k-2]
    assert np.allclose(np.sqrt(A), errors[[1, 3]], rtol=1e-6)
    assert np.allclose(np.sqrt(B) * made.plant.C[0, 0], errors[[0, 2]], rtol=1e-6)
    assert len(uncertain.names) == 4
    with pytest.raises(SettingError, match="level must lie between 0 and 1"):
        made.uncertain_plant(level=1.0)
    with pytest.raises(SettingError, match="plant of this model"):
        made.uncertain_plant(rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1))


@pytest.mark.parametrize(
    ("design", "options"),
    [
        ("primary_residuals", {}),
        ("parity_relations", {"order": 3}),
        ("kalman_filter", {}),
    ],
)
def test_a_monitor_of_the_equations_finds_a_faulty_sensor(design: str, options: dict[str, object]) -> None:
    rng = np.random.default_rng(11)
    true = true_equations(rng, (2, 3, 1), 2)
    learnt, normal, today = (true.recorded(rng, 3000, 10.0) for _ in range(3))
    offset = np.array([20.0, -4.0, 300.0])
    made = rs.identify.arx(learnt[0], learnt[1] + offset, past_of="own")
    model = made.plant if design == "kalman_filter" else made.model
    monitor = rs.Monitor(getattr(rs.design, design)(model.with_sensor_faults(), **options))
    monitor = monitor.fit(normal[0], normal[1] + offset, false_alarm_rate=0.001)
    quiet = monitor.run(today[0], today[1] + offset)
    assert quiet.false_alarm_fraction < 0.01
    broken = today[1] + offset
    broken[1500:, 1] += 3.0 * today[1][:, 1].std()
    seen = monitor.run(today[0], broken)
    assert seen.main_alarm.candidates[0].faults == ("y2 sensor",)
    assert 1500 <= seen.main_alarm.start < 1520


def test_bits_do_not_depend_on_units() -> None:
    rng = np.random.default_rng(9)
    u, y = true_equations(rng, (2, 1), 2).recorded(rng, 600, 5.0)
    powers = 2.0 ** np.array([20, -20, 7, -13])
    one, other = rs.identify.arx(u, y), rs.identify.arx(u * powers[:2], y * powers[2:])
    scale = {name: float(power) for name, power in zip(("u1", "u2", "y1", "y2"), powers, strict=True)}
    for a, b in zip(one.report.equations, other.report.equations, strict=True):
        factor = np.array([scale[a.output] / scale[name] for name, _ in a.terms])
        assert a.terms == b.terms
        assert np.array_equal(a.coefficients * factor, b.coefficients)
        assert np.array_equal(a.standard_errors * factor, b.standard_errors)
    assert np.array_equal(one.plant.A, other.plant.A)
    assert np.array_equal(one.plant.C * powers[2:, None], other.plant.C)
    (gain, error), (other_gain, other_error) = (judged(x) for x in (one, other))
    assert np.array_equal(gain * powers[2:, None] / powers[:2], other_gain)
    assert np.array_equal(error * powers[2:], other_error)


def judged(made: ArxModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors of the steady gains, and those of the predictions of held-out rows."""
    gain, held_out = made.report.steady_gain, made.report.held_out
    assert gain.error is not None
    return gain.error, held_out.error


def test_an_equation_may_have_no_past() -> None:
    rng = np.random.default_rng(18)
    u = rng.standard_normal((400, 1))
    made = rs.identify.arx(u, 3 * u + 0.1 * rng.standard_normal((400, 1)) + 7, feedthrough=True, max_order=0)
    [one] = made.report.equations
    assert one.terms == (("u1", 0),)
    assert abs(one.coefficients[0] - 3) < FAR * one.standard_errors[0]
    assert made.plant.n_states == 0
    level = rs.identify.arx(None, rng.standard_normal((400, 2)) + 7, order=0)
    assert [len(one.terms) for one in level.report.equations] == [0, 0]
    [seen] = level.predict(None, np.full((5, 2), 7.0))
    assert np.allclose(seen.predicted, 7, atol=0.3)


def test_too_many_coefficients_for_an_uncertain_plant_are_refused() -> None:
    rng = np.random.default_rng(19)
    made = rs.identify.arx(None, rng.standard_normal((3000, 26)), order=3, max_order=3, past_of="all", held_out=0)
    assert made.report.steady_gain is None
    with pytest.raises(SettingError, match="covariance of 2028 coefficients"):
        made.uncertain_plant()


def test_the_past_of_other_outputs_is_taken_where_it_helps() -> None:
    rng = np.random.default_rng(12)
    true = true_equations(rng, (1, 1), 1)
    true.a[1, 0, 1] = 0.5
    u, y = true.recorded(rng, 3000, 3.0)
    first, second = rs.identify.arx(u, y).report.equations
    assert first.coupled
    assert not second.coupled
    assert "its own past alone the criterion is" in first.choice.reason
    assert "the past of the other outputs too the criterion is" in second.choice.reason


def test_a_controller_is_named_and_does_no_harm() -> None:
    true, errors = TrueEquations(np.array([[[0.0]], [[0.7]]]), np.array([[[0.0]], [[1.0]]]), (1,)), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        e, dither = rng.standard_normal(1500), rng.standard_normal(1500)
        u, y = np.zeros((1500, 1)), np.zeros((1500, 1))
        for k in range(1, 1500):
            y[k] = 0.7 * y[k - 1] + u[k - 1] + e[k]
            u[k] = dither[k] - 0.4 * y[k]
        made = rs.identify.arx(u, y, order=1, held_out=0)
        assert made.report.feedback == (("y1", "u1"),)
        errors.append(standardised(made, true))
    assert "allow for" in str(made.report)
    assert np.abs(np.mean(errors, axis=0)).max() < 4 / np.sqrt(40)
    assert np.mean(np.abs(errors) < QUANTILE) > 0.85


def test_noise_of_sensors_is_called_coloured() -> None:
    rng = np.random.default_rng(14)
    true = TrueEquations(np.array([[[0.0]], [[0.9]]]), np.array([[[0.0]], [[1.0]]]), (1,))
    u = rng.standard_normal((3000, 1))
    y = true.simulated(u, np.zeros((3000, 1)))
    made = rs.identify.arx(u, y + y.std() * rng.standard_normal(y.shape), order=1)
    assert made.report.coloured == ("y1",)
    assert made.plant.identification.coloured == ("y1",)


def test_without_inputs_and_without_noise() -> None:
    rng = np.random.default_rng(15)
    e = rng.standard_normal(2000)
    y = np.zeros((2000, 1))
    for k in range(1, 2000):
        y[k] = 0.7 * y[k - 1] + e[k]
    made = rs.identify.arx(None, y, held_out=0)
    assert made.report.equations[0].order == 1
    assert made.report.steady_gain is None
    true = true_equations(rng, (3,), 1)
    u = rng.standard_normal((500, 1))
    exact = rs.identify.arx(u, true.simulated(u, np.zeros((500, 1))))
    [one] = exact.report.equations
    assert one.order == 3
    assert "do not determine more than 3 rows" in one.choice.reason
    values = dict(zip(one.terms, one.coefficients, strict=True))
    assert np.allclose([values["y1", row] for row in (1, 2, 3)], true.a[1:, 0, 0], atol=ROUNDED)


# --------------------------------------------------------------------------- refusals


def example() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(16)
    return true_equations(rng, (2,), 2).recorded(rng, 400, 5.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda u, y: (np.column_stack([u[:, 0], np.full(400, 7.0)]), y), "u2 never moves"),
        (lambda u, y: (np.column_stack([u[:, 0], 3 * u[:, 0]]), y), "the same signal"),
        (
            lambda u, y: (np.column_stack([u[1:, 0], u[:-1, 0]]), y[1:]),
            "'y1' with 2 rows .* 'u1' 2 rows before follows from 'u2' 1 row before but for",
        ),
        (lambda u, y: (u, np.full_like(y, np.nan)), "no row is complete"),
        (lambda u, y: (u[:12], y[:12]), "longest segment has 9 rows"),
    ],
)
def test_bad_data_are_refused_by_name(change, said: str) -> None:
    u, y = change(*example())
    with pytest.raises(DataError, match=said):
        rs.identify.arx(u, y, order=2)


def test_an_order_that_the_data_do_not_determine_is_refused_with_numbers() -> None:
    rng = np.random.default_rng(17)
    u, e = rng.standard_normal((500, 1)), np.zeros((500, 1))
    y = true_equations(rng, (2,), 1).simulated(u, e)
    with pytest.raises(DataError, match=r"'y1' with 4 rows .* 'y1' 3 rows before follows from .*below 3"):
        rs.identify.arx(u, y, order=4)
    wave = np.sin(0.3 * np.arange(500))[:, None]
    noisy = true_equations(rng, (2,), 1).simulated(wave, 0.1 * rng.standard_normal((500, 1)))
    with pytest.raises(DataError, match=r"'u1' 3 rows before follows from .* move the inputs more freely"):
        rs.identify.arx(wave, noisy, order=4)
    [one] = rs.identify.arx(wave, noisy).report.equations
    assert one.order <= 2
    assert "do not determine more than 2 rows" in one.choice.reason


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"order": -1}, "order must be"),
        ({"order": "best"}, "order must be"),
        ({"order": {"y1": "auto"}}, "order must be"),
        ({"order": {"y7": 1}}, "y7"),
        ({"order": True}, "order must be"),
        ({"order": [1, 2]}, "mapping of outputs to their orders"),
        ({"max_order": 1.5}, "max_order must be"),
        ({"past_of": "some"}, "past_of must be one of"),
        ({"held_out": 1.0}, "held_out must be"),
        ({"delays": {"u7": 1}}, "is no input"),
    ],
)
def test_bad_settings_are_refused(options: dict[str, object], said: str) -> None:
    with pytest.raises(SettingError, match=said):
        rs.identify.arx(*example(), **options)  # pyright: ignore[reportArgumentType]


def test_the_report_says_it_all() -> None:
    u, y = example()
    u[:, 1] = np.round(u[:, 1])
    made = rs.identify.arx(u, y, inputs=["valve", "pump"], outputs=["level"])
    text = str(made.report)
    for part in (
        "1 equation by ARX",
        "information criterion",
        "held-out error",
        "level[k] = ",
        "rows held out",
        "'pump' takes only",
    ):
        assert part in text
    assert repr(made.report).startswith("EquationReport(1 equation by ARX: ")
    assert repr(made).startswith("ArxModel(orders ")
    assert repr(made.report.equations[0]).startswith("Equation('level', order ")
