"""Physical parameters from recordings: recovered, with intervals that cover, and refused where the data are silent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

import residua as rs
from effort import rounds
from residua.errors import DataError, ModelError, SettingError
from residua.identify import GreyBox, grey_box
from residua.identify.grey_box import _whiteness
from residua.library.three_tank import CLOGS, FLOWS, GRAVITY, LEAKS, LEVELS, PIPE, three_tank, three_tank_rate
from residua.plant import UncertainPlant
from three_tank_faults import FAILED, diagnosis

DT = 0.2
TRUE = {"stiffness": 2.0, "damping": 0.3}
BOX = {"stiffness": (1.0, 1.7, 4.0), "damping": (0.05, 0.4, 1.0)}
#: Standard errors within which an estimate is: 2 of 1000 normal ones are not.
SPREAD = 3.0
#: Two searches for one minimum end this near to each other, in standard errors.
SAME_MINIMUM = 0.02


def bare_spring(stiffness: float, damping: float) -> rs.Plant:
    """Return a mass on a spring, with its position and acceleration measured."""
    A, B = [[0, 1], [-stiffness, -damping]], [[0], [1]]
    return rs.Plant(A, B, [[1, 0], A[1]], [[0], [1]], inputs="force", outputs=["position", "acceleration"])


def spring(stiffness: float, damping: float) -> rs.Plant:
    """Return the same, sampled, with noise."""
    return bare_spring(stiffness, damping).discretize(DT).with_noise(process=[1e-5, 1e-3], measurement=[1e-3, 1e-2])


def record(plant: rs.Plant, samples: int, seed: int, *, hold: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return a recording of a sampled plant with its noise, moved by steps."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], (samples // hold + 1, len(plant.inputs))), hold, axis=0)[:samples]
    w = rng.standard_normal((samples, len(plant.noises)))
    start = 0.3 * rng.standard_normal(plant.n_states)
    y = plant.system(("control", "noise")).simulate(np.hstack([u, w]), start)
    return u + plant.operating_point.inputs, y + plant.operating_point.outputs


@pytest.fixture(scope="module")
def made() -> GreyBox:
    return grey_box(spring, record(spring(**TRUE), 1000, 1), BOX)


def distance(model: GreyBox, true: dict[str, float]) -> float:
    return max(abs(model.parameters[name] - value) / model.standard_errors[name] for name, value in true.items())


# ------------------------------------------------------------ what is right


@pytest.mark.parametrize("seed", range(5))
def test_parameters_are_recovered(seed: int) -> None:
    model = grey_box(spring, record(spring(**TRUE), 600, seed), BOX)
    assert distance(model, TRUE) < SPREAD
    assert all(error < 0.05 * TRUE[name] for name, error in model.standard_errors.items())
    np.testing.assert_allclose(model.covariance, model.covariance.T)


def test_without_noise_in_the_plant_it_is_output_error() -> None:
    u, y = record(spring(**TRUE), 600, 3)
    y = bare_spring(**TRUE).discretize(DT).system().simulate(u) + 0.05 * np.random.default_rng(0).standard_normal(
        y.shape
    )
    model = grey_box(bare_spring, (u, y), BOX, dt=DT)
    assert distance(model, TRUE) < SPREAD
    assert not model.plant.is_discrete
    np.testing.assert_allclose(model.plant.measurement_noise / DT, model.innovation_covariance)
    assert model.fit == model.simulation_fit


def test_data_without_noise_give_the_parameters_to_many_digits() -> None:
    plant = bare_spring(**TRUE).discretize(DT)
    u, _ = record(spring(**TRUE), 300, 3)
    model = grey_box(bare_spring, (u, plant.system().simulate(u)), BOX, dt=DT)
    for name, value in TRUE.items():
        assert model.parameters[name] == pytest.approx(value, rel=1e-8)
    assert any("without noise" in note for note in model.notes)


@pytest.mark.parametrize("runs", rounds(50, 200))
def test_the_intervals_cover(runs: int) -> None:
    """Of 100 intervals for 95 % some 95 hold the parameter; the bounds are what chance allows."""
    true, inside = {"pole": 0.8, "gain": 2.0}, 0

    def lag(pole: float, gain: float) -> rs.Plant:
        return rs.Plant([[pole]], [[gain * (1 - pole)]], [[1.0]], dt=1.0).with_noise(process=0.04, measurement=0.1)

    for seed in range(runs):
        box = {"pole": (0.0, 0.7, 0.99), "gain": (0.0, 1.5, 5.0)}
        model = grey_box(lag, record(lag(**true), 250, 1000 + seed), box, held_out=0.0)
        for name, (low, high) in model.interval(0.95).items():
            inside += low <= true[name] <= high
    assert 0.88 <= inside / (2 * runs) <= 0.99


@pytest.mark.parametrize("runs", rounds(20, 80))
def test_standard_errors_count_coloured_errors(runs: int) -> None:
    """Slow noise on the output of a plant without process noise: those for white errors are too small by half."""
    plant, estimates, said, plain = bare_spring(**TRUE).discretize(DT), [], [], []
    for seed in range(runs):
        u, _ = record(spring(**TRUE), 400, seed, hold=40)
        slow = np.random.default_rng(seed).standard_normal((400, 2))
        for k in range(1, 400):
            slow[k] += 0.9 * slow[k - 1]
        y = plant.system().simulate(u) + 0.05 * slow
        model = grey_box(bare_spring, (u, y), BOX, dt=DT, held_out=0.0)
        estimates.append(list(model.parameters.values()))
        said.append(list(model.standard_errors.values()))
        plain.append(np.sqrt(np.diag(model.plain_covariance)))
    real, robust, white = np.std(estimates, axis=0), np.median(said, axis=0), np.median(plain, axis=0)
    ratio = robust / real
    assert (ratio > 0.6).all(), ratio
    assert (ratio < 1.5).all(), ratio
    assert (abs(np.log(robust / real)) <= abs(np.log(white / real)) + 0.1).all(), (robust, white, real)
    assert any("correlated over time" in note for note in model.notes)


@pytest.mark.parametrize("seed", range(3))
def test_units_change_nothing_but_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    U, Y = 2.0 ** rng.integers(-20, 21, 1), 2.0 ** rng.integers(-20, 21, 2)
    X, P = 2.0 ** rng.integers(-20, 21, 2), 2.0 ** rng.integers(-20, 21, 2)
    u, y = record(spring(**TRUE), 400, 7)

    def scaled(stiffness: float, damping: float) -> rs.Plant:
        p = spring(stiffness / P[0], damping / P[1])
        plant = rs.Plant(
            p.A * X[:, None] / X,
            p.B * X[:, None] / U,
            p.C * Y[:, None] / X,
            p.D * Y[:, None] / U,
            dt=DT,
            inputs=p.inputs,
            outputs=p.outputs,
        )
        return plant.with_noise(
            process=np.diag(p.process_noise) * X**2, measurement=np.diag(p.measurement_noise) * Y**2
        )

    box = {name: tuple(float(v * s) for v in BOX[name]) for name, s in zip(BOX, P, strict=True)}
    plain, other = grey_box(spring, (u, y), BOX), grey_box(scaled, (u * U, y * Y), box)
    for name, s in zip(BOX, P, strict=True):
        assert abs(other.parameters[name] / s - plain.parameters[name]) < SAME_MINIMUM * plain.standard_errors[name]
        assert other.standard_errors[name] / s == pytest.approx(plain.standard_errors[name], rel=1e-3)
    np.testing.assert_allclose(list(other.fit.values()), list(plain.fit.values()), rtol=1e-3)
    np.testing.assert_allclose(other.identifiability.singular_values, plain.identifiability.singular_values, rtol=1e-3)


def test_the_start_within_the_bounds_does_not_matter() -> None:
    data = record(spring(**TRUE), 400, 2)
    models = [
        grey_box(spring, data, {"stiffness": (1.0, s, 4.0), "damping": (0.05, c, 1.0)})
        for s, c in ((1.1, 0.9), (3.5, 0.1))
    ]
    models.append(grey_box(spring, data, {name: (low, high) for name, (low, _, high) in BOX.items()}))
    for name, error in models[0].standard_errors.items():
        assert np.ptp([model.parameters[name] for model in models]) < SAME_MINIMUM * error


def test_several_recordings_and_gaps_are_stretches_of_their_own() -> None:
    plant = spring(**TRUE)
    first, second = record(plant, 400, 1), record(plant, 400, 2)
    u, y = first[0].copy(), first[1].copy()
    y[200, 0] = np.nan
    model = grey_box(spring, [(u, y), second], BOX)
    assert distance(model, TRUE) < SPREAD
    assert model.samples + model.held_out == 799
    assert any("missing value" in note for note in model.notes)


def test_unknown_offsets_are_taken_out() -> None:
    u, y = record(spring(**TRUE), 800, 4)
    wrong = grey_box(spring, (u, y + [0.0, 1.0]), BOX)
    right = grey_box(spring, (u, y + [0.0, 1.0]), BOX, offsets=["acceleration"])
    everything = grey_box(spring, (u, y + [0.5, 1.0]), BOX, offsets=True)
    assert distance(right, TRUE) < SPREAD
    assert distance(everything, TRUE) < SPREAD
    assert min(right.fit.values()) > wrong.fit["acceleration"] + 0.2


def test_a_function_of_one_mapping_does_as_well(made: GreyBox) -> None:
    model = grey_box(lambda values: spring(**values), record(spring(**TRUE), 1000, 1), BOX)
    assert model.parameters == made.parameters


def test_the_uncertain_plant_is_the_box_of_the_covariance(made: GreyBox) -> None:
    unc = made.uncertain_plant(0.95)
    assert isinstance(unc, UncertainPlant)
    assert unc.names == tuple(BOX)
    box = made.interval(0.95, together=True)
    for parameter in unc.parameters:
        assert (parameter.low, parameter.high) == box[parameter.name]
        assert parameter.nominal == made.parameters[parameter.name]
        single = made.interval(0.95)[parameter.name]
        assert parameter.low < single[0] < single[1] < parameter.high
    np.testing.assert_allclose(unc.nominal.A, made.plant.A)
    with pytest.raises(SettingError, match="between 0 and 1"):
        made.interval(1.5)


def test_the_report_can_be_read(made: GreyBox) -> None:
    text = made.report
    assert "grey box: 2 parameters" in text
    assert "750 samples" in text
    assert "250 held-out samples" in text
    for name in (*BOX, "position", "acceleration", "std. error", "simulation fit", "whiteness"):
        assert name in text
    assert min(made.whiteness.values()) > 0.001
    assert min(made.fit.values()) > 0.7


# -------------------------------------------------------- what data do not say


def test_a_combination_that_nothing_tells_is_named() -> None:
    data = record(spring(**TRUE), 400, 1)

    def two_springs(left: float, right: float, damping: float) -> rs.Plant:
        return spring(left + right, damping)

    box = {"left": (0.1, 3.0), "right": (0.1, 3.0), "damping": (0.05, 1.0)}
    with pytest.raises(
        DataError,
        match=r"do not tell left from right: moved together, .* they change no prediction by more than the noise hides",
    ):
        grey_box(two_springs, data, box)
    model = grey_box(two_springs, data, box, priors={"left": (0.5, 0.01)})
    assert any("left from right" in note and "the priors do" in note for note in model.notes)
    assert model.parameters["left"] == pytest.approx(0.5, abs=1e-3)
    assert model.standard_errors["left"] == pytest.approx(0.01, rel=0.05)
    total = model.parameters["left"] + model.parameters["right"]
    assert abs(total - 2.0) < 0.1
    assert model.identifiability.unknown == (2,)
    assert model.identifiability.condition > 1e6
    moves = model.identifiability.moves(2)
    assert sorted(moves) == ["left", "right"]
    assert moves["left"] == pytest.approx(-moves["right"], rel=1e-3)


def test_a_parameter_without_effect_is_named() -> None:
    data = record(spring(**TRUE), 400, 1)
    with pytest.raises(DataError, match="the data say nothing of colour"):
        grey_box(
            lambda stiffness, colour: spring(stiffness, 0.3), data, {"stiffness": (1.0, 4.0), "colour": (0.0, 1.0)}
        )


def test_inputs_that_stand_still_tell_little() -> None:
    rng = np.random.default_rng(0)
    y = 1.0 + 1e-3 * rng.standard_normal((300, 1))

    def lag(gain: float, rate: float) -> rs.Plant:
        return rs.Plant([[-rate]], [[gain * rate]], [[1.0]])

    with pytest.raises(DataError, match="the data say nothing of rate"):
        grey_box(lag, (np.ones((300, 1)), y), {"gain": (0.1, 3.0), "rate": (0.05, 0.5)}, dt=1.0)


def test_an_estimate_at_a_bound_is_said() -> None:
    model = grey_box(spring, record(spring(**TRUE), 400, 1), {"stiffness": (1.0, 1.5), "damping": (0.05, 1.0)})
    assert model.at_bounds == ("stiffness",)
    assert model.parameters["stiffness"] == 1.5
    assert "(at a bound)" in str(model)
    assert any("the estimate is a bound" in note for note in model.notes)


def test_noise_that_the_plant_does_not_have_is_said() -> None:
    data = record(spring(**TRUE), 800, 1)
    model = grey_box(lambda **p: spring(**p).with_noise(process=[1e-6, 1e-4], measurement=[1e-4, 1e-3]), data, BOX)
    assert distance(model, TRUE) < SPREAD
    assert any("is not what the noise of the plant gives" in note for note in model.notes)


# -------------------------------------------------------------- what is refused


def raising(stiffness: float, damping: float) -> rs.Plant:
    if stiffness > 1.9:
        raise RuntimeError("too stiff")
    return spring(stiffness, damping)


def test_starts_that_cannot_be_tried_are_said() -> None:
    def stiff(stiffness: float, damping: float) -> rs.Plant:
        if stiffness > 3.2:
            raise RuntimeError("too stiff")
        return spring(stiffness, damping)

    box = {"stiffness": (1.0, 4.0), "damping": (0.05, 1.0)}
    model = grey_box(stiff, record(spring(**TRUE), 400, 1), box)
    assert distance(model, TRUE) < SPREAD
    assert any("starts within the bounds could not be tried" in note and "too stiff" in note for note in model.notes)
    with pytest.raises(ModelError, match="too stiff"):
        grey_box(raising, record(spring(**TRUE), 400, 1), {"stiffness": (2.0, 4.0), "damping": (0.05, 1.0)})


@pytest.mark.parametrize(
    ("options", "kind", "said"),
    [
        ({"parameters": {}}, SettingError, "at least one parameter"),
        ({"parameters": {"stiffness": 3.0}}, SettingError, "give \\(low, high\\)"),
        ({"parameters": BOX | {"damping": (1.0, 1.0)}}, SettingError, "a constant is no parameter"),
        ({"parameters": BOX | {"damping": (0.0, np.inf)}}, SettingError, "without bounds a start"),
        ({"parameters": {"wrong": (0.0, 1.0)}}, ModelError, "the parameters are wrong"),
        ({"plant_at": 3}, ModelError, "must be a function"),
        ({"plant_at": lambda **p: 3}, ModelError, "must return a Plant or NonlinearModel, got int"),
        ({"plant_at": raising}, ModelError, r"plant_at\(stiffness=.*, damping=.*\) raised RuntimeError: too stiff"),
        ({"plant_at": lambda **p: bare_spring(**p).with_noise(process=1.0)}, ModelError, r"R is singular"),
        ({"plant_at": lambda **p: rs.Plant([[1.5]], [[1]], [[1], [1]], dt=DT)}, ModelError, "without bound"),
        (
            {"plant_at": lambda stiffness: spring(-stiffness, 0.1), "parameters": {"stifness": (1.0, 2.0)}},
            ModelError,
            r"plant_at\(stiffness\) was called with the mapping \{stifness: 1.5\}, .* takes no keyword of these names",
        ),
        (
            {
                "plant_at": lambda stiffness, damping=0.1: spring(stiffness, damping),
                "parameters": BOX | {"mass": (1, 2)},
            },
            ModelError,
            r"plant_at\(stiffness, damping=0.1\) was called .*; the parameters are stiffness, damping and mass",
        ),
        ({"priors": {"wrong": (0.0, 1.0)}}, SettingError, "is no parameter"),
        ({"priors": {"damping": (0.0, 0.0)}}, SettingError, "standard deviation"),
        ({"priors": {"damping": 3.0}}, SettingError, "standard deviation"),
        ({"held_out": 1.0}, SettingError, "held_out must be"),
        ({"starts": 0, "parameters": {"stiffness": (1.0, 4.0), "damping": (0.1, 1.0)}}, SettingError, "starts must be"),
        ({"offsets": ["wrong"]}, ModelError, "unknown offsets: channel 'wrong'"),
        ({"dt": 0.3}, DataError, "dt=0.2 s"),
        ({"recordings": (np.ones((8, 1)), np.ones((8, 2)))}, DataError, "too few for 4 unknowns"),
        ({"recordings": (np.eye(80)[:, :1], np.eye(80)[:, :2] * [0, 1])}, DataError, "position never moves"),
        ({"recordings": (np.ones((80, 2)), np.ones((80, 2)))}, DataError, "expected 2 names, got 1: force"),
        ({"recordings": (np.ones((80, 1)), np.full((80, 2), np.nan))}, DataError, "no row is complete"),
    ],
)
def test_bad_input_is_refused(options: dict[str, Any], kind: type[Exception], said: str) -> None:
    given = {"plant_at": spring, "recordings": record(spring(**TRUE), 200, 1), "parameters": BOX} | options
    with pytest.raises(kind, match=said):
        grey_box(given.pop("plant_at"), given.pop("recordings"), given.pop("parameters"), **given)


def test_a_plant_that_changes_its_channels_is_refused() -> None:
    def changing(stiffness: float, damping: float) -> rs.Plant:
        plant = spring(stiffness, damping)
        return plant if stiffness == 1.7 else plant.discretize(DT) if not plant.is_discrete else other

    other = rs.Plant([[0.5]], [[1.0]], [[1.0], [1.0]], dt=DT, inputs="push", outputs=["position", "acceleration"])
    with pytest.raises(ModelError, match=r"has the inputs \('push',\), other parameters give \('force',\)"):
        grey_box(changing, record(spring(**TRUE), 200, 1), BOX)


# ----------------------------------------------------------- the three tanks

FLOW_COEFFICIENTS = {"a1": 0.46, "a2": 0.60, "a3": 0.45}


def tanks(a1: float, a2: float, a3: float) -> rs.Plant:
    """Return the three tanks' own equations with their faults, linearised at rest at the nominal levels."""

    def rate(h: np.ndarray, q: np.ndarray, f: np.ndarray) -> np.ndarray:
        def flow(a: float, drop: float, clog: float) -> float:
            return float(a * PIPE * (1 - clog) * np.sign(drop) * np.sqrt(2 * GRAVITY * abs(drop)))

        q13, q20, q32 = flow(a1, h[0] - h[2], f[3]), flow(a2, h[1], f[4]), flow(a3, h[2] - h[1], f[5])
        leaks = f[:3] * np.sqrt(2 * GRAVITY * h)
        return (np.array([q[0] - q13, q[1] + q32 - q20, q13 - q32]) - leaks) / 154.0

    levels = ["h1", "h2", "h3"]
    plant = rs.identify.linearise(
        rate,
        at=(LEVELS, FLOWS),
        hold={"h1": 41.0, "h2": 32.0},
        faults=[*LEAKS, *CLOGS],
        inputs=["Q1", "Q2"],
        states=levels,
        outputs=levels,
    )
    plant = plant.with_actuator_faults().with_sensor_faults()
    return plant.discretize(1.0).with_noise(process=1e-4, measurement=0.02)


def test_the_three_tanks_equations_by_hand_are_the_librarys() -> None:
    reference = three_tank()
    np.testing.assert_allclose(tanks(**FLOW_COEFFICIENTS).A, reference.A, rtol=1e-3)
    assert abs(three_tank_rate(LEVELS, FLOWS)).max() < 1e-3


@pytest.fixture(scope="module")
def normal(shared_data: Path) -> np.ndarray:
    data = scipy.io.loadmat(shared_data / "three_tank_dts200" / "train_5ch.mat")
    return next(value for key, value in data.items() if not key.startswith("__"))


@pytest.fixture(scope="module")
def from_recording(normal: np.ndarray) -> GreyBox:
    return grey_box(tanks, (normal[:6000, :2], normal[:6000, 2:]), dict.fromkeys(FLOW_COEFFICIENTS, (0.2, 1.0)))


def test_the_flow_coefficients_of_the_three_tanks(from_recording: GreyBox) -> None:
    assert distance(from_recording, FLOW_COEFFICIENTS) < SPREAD
    assert max(from_recording.standard_errors.values()) < 2e-3
    assert min(from_recording.whiteness.values()) > 0.01


def test_the_faults_of_the_three_tanks_are_named(
    from_recording: GreyBox, normal: np.ndarray, shared_data: Path
) -> None:
    """With the demo's settings and the plant of the recording; the model as published names 11 too."""
    test = rs.decide.NormThreshold(persistence=5, window=10, false_alarm_rate=0.005)
    monitor = rs.Monitor(rs.design.kalman_filter(from_recording.plant), test=test).fit(normal[:, :2], normal[:, 2:])
    faulty = scipy.io.loadmat(shared_data / "three_tank_dts200" / "test_5ch.mat")
    named = 0
    for number in range(1, 13):
        found = diagnosis(monitor, faulty[f"fault{number:02d}"])
        wanted = {FAILED[number]} if number > 1 else {"Q1 actuator", "Q2 actuator"}
        alarm = found.main_alarm
        named += bool(alarm and alarm.candidates and wanted & set(alarm.candidates[0].faults))
    assert named >= 11


def test_whiteness_counts_only_pairs_of_rows_within_a_stretch() -> None:
    """Of white errors in many short stretches the probabilities are even; 0.06 are four deviations of their mean."""
    rng = np.random.default_rng(0)
    found = [_whiteness([rng.standard_normal((8, 1)) for _ in range(40)])[0] for _ in range(400)]
    assert np.mean(found) == pytest.approx(0.5, abs=0.06)


def test_progress_is_told_of_starts_and_of_the_search() -> None:
    told: list[tuple[str, int, int]] = []
    box = {"stiffness": (1.0, 4.0), "damping": (0.05, 1.0)}
    data = record(spring(**TRUE), 300, 1)
    one = grey_box(spring, data, box, progress=lambda *now: told.append(now))
    assert one.parameters == grey_box(spring, data, box, progress=False).parameters
    assert {stage for stage, _, _ in told} >= {"starts", "search, turn 1"}
    assert all(0 <= done <= total for _, done, total in told)
