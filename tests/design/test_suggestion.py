"""What is suggested designs, sees what it is said to see, and comes first only where nothing speaks against it."""

from __future__ import annotations

import importlib.util
import inspect
import time
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from effort import cases
from generated import random_plant, singular_plant
from guards import trips
from refusals import Refused
from residua.design import catalogue, ranking, suggestion
from residua.design.core.generator import as_generator, brings_a_generator, for_monitor
from residua.design.core.method import method
from residua.design.lasting_faults import RATE, WINDOW, lasting_faults
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.linear import filter_riccati
from residua.plant import Perturbation, UncertainPlant
from residua.plant.assumed_noise import sensible_step
from residua.progress import TimeUsedUpError, check_time, time_limit

REPOSITORY = Path(__file__).resolve().parents[2]
LIBRARY = ("gertler", "twardy", "jet_engine", "three_tank", "vtol")
REFUSALS = (DesignError, AccuracyError, ModelError)


def generated() -> list[rs.Plant]:
    """Return plants with and without disturbances, noise, singular E."""
    rng = np.random.default_rng(30)
    plants = [random_plant(rng, n=4, disturbances=k % 2, sensors=k % 3 == 0, faults=2) for k in range(2)]
    plants.append(random_plant(rng, n=3, dt=0.1).with_noise(process=0.1, measurement=0.2))
    plants.append(random_plant(rng, n=5, faults=0, disturbances=1))
    return [*plants, *(singular_plant(rng, disturbances=k, faults=1, sensors=False) for k in range(2))]


PLANTS = [getattr(rs.library, name)() for name in LIBRARY] + generated()


#: Two of the library and three generated ones on every day.
_USUAL = (0, 3, 5, 7, 9)


def motor() -> rs.Plant:
    plant = rs.Plant([[-10, 1], [-0.02, -2]], [[0], [2]], np.eye(2), inputs=["V"], outputs=["speed", "current"])
    return plant.with_sensor_faults().with_actuator_faults().discretize(0.01)


def noisy_motor() -> rs.Plant:
    return motor().with_noise(process=1e-5, measurement=1e-3)


def tanks() -> rs.Plant:
    """Return the plant of the README."""
    A = [[-0.015769, 0, 0.015769], [0, -0.022714, 0.015087], [0.015769, 0.015087, -0.030856]]
    tank = rs.Plant(A, [[0.0064935, 0], [0, 0.0064935], [0, 0]], np.eye(3), inputs=["Q1", "Q2"])
    tank = tank.with_actuator_faults().with_sensor_faults()
    tank = tank.with_faults({"leak 1": [-1, 0, 0], "leak 3": [0, 0, -1], "clog 32": [0, -1, 1]})
    return tank.discretize(1.0).with_noise(process=1e-4, measurement=0.02)


def chain(n: int) -> rs.Plant:
    """Return tanks in a row, each with its sensor."""
    A = np.diag(np.full(n, -0.1)) + np.diag(np.full(n - 1, 0.05), 1) + np.diag(np.full(n - 1, 0.05), -1)
    plant = rs.Plant(np.eye(n) + A, np.eye(n)[:, :1], np.eye(n), dt=1.0).with_sensor_faults().with_actuator_faults()
    return plant.with_noise(process=1e-5, measurement=1e-3)


@pytest.fixture(params=cases(sorted(range(len(PLANTS)), key=lambda k: k not in _USUAL), len(_USUAL)), scope="module")
def answer(request: pytest.FixtureRequest) -> suggestion.Suggestion:
    return rs.suggest(PLANTS[request.param], seconds=120)


def entry_of(found: suggestion.Suggestion, name: str) -> ranking.Entry:
    return next(entry for entry in found.entries if entry.method.name == name)


def call(entry: ranking.Entry, plant: rs.Plant) -> object:
    """Type the line that was suggested."""
    return eval(entry.call, {"rs": rs, "plant": plant})


# --------------------------------------------------------------------- what is said of a call


def test_the_lines_do_what_is_said_of_them(answer: suggestion.Suggestion) -> None:
    for entry in answer.entries:
        if entry.works:
            assert type(call(entry, answer.plant)) is type(entry.made)
        elif entry.works is False:
            with pytest.raises(REFUSALS) as error:
                call(entry, answer.plant)
            assert str(error.value) == entry.reason
        assert entry.reason


def test_the_best_is_what_a_monitor_runs(answer: suggestion.Suggestion) -> None:
    if answer.best is not None and answer.plant.faults:
        generator = as_generator(for_monitor(answer.best.made))
        dt = None if generator.system.is_discrete else sensible_step(answer.plant)
        u, y = np.zeros((80, len(answer.plant.inputs))), np.zeros((80, answer.plant.n_outputs))
        monitor = rs.Monitor(for_monitor(answer.best.made), dt=dt)
        assert monitor.generator.run(u, y, dt=dt).shape[0] == 80


def test_it_prints_what_it_found(answer: suggestion.Suggestion) -> None:
    text = str(answer)
    assert all(entry.label in text for entry in answer.entries)
    assert all(note in text for note in answer.notes)
    if answer.best is not None:
        assert f"first: {answer.best.call}" in text


def test_faults_that_a_code_names_are_told_apart_by_the_rank_conditions_too(answer: suggestion.Suggestion) -> None:
    plant = answer.plant
    if not plant.faults:
        return
    isolable = rs.diagnosability(plant).isolable
    for entry in answer.entries:
        if isinstance(entry.made, rs.design.Bank) and not entry.left_out:
            for name in entry.names:
                i = plant.faults.index(name)
                others = [j for j in range(len(plant.faults)) if j != i]
                assert (isolable[i, others] | isolable[others, i]).all(), (entry.call, name)


# ------------------------------------------------------------------------- what it foretells


@pytest.mark.parametrize("make", [noisy_motor, tanks], ids=["motor", "tanks"])
def test_the_share_that_is_foretold_is_that_of_simulations(make) -> None:
    """Each fault at the size that is called seen, and at half and twice of it, in a test with the true covariance."""
    plant = make()
    generator = rs.design.kalman_filter(plant)
    found = lasting_faults(generator, plant.dt)
    [(_, whiten)] = found.whitening
    rng, errors = np.random.default_rng(4), []
    noise = generator.internal_form().select(inputs=range(len(plant.faults), generator.internal_form().n_inputs))
    limit = found._limit(whiten)
    for j, name in enumerate(plant.faults):
        response = generator.internal_form().select(inputs=[j]).simulate(np.ones((1500, 1)))
        quiet = noise.simulate(rng.standard_normal((30 * 2000, noise.n_inputs)))
        for factor in (0.5, 1.0, 2.0):
            shares = []
            for run in range(30):
                r = quiet[2000 * run + 500 : 2000 * (run + 1)] + factor * found.sizes[name] * response
                sums = np.cumsum(r, axis=0)
                sums[WINDOW:] -= sums[:-WINDOW].copy()
                norms = np.sum((sums @ whiten.T) ** 2, axis=1) / WINDOW
                shares.append(float((norms[WINDOW:] > limit).mean()))
            wanted = found.share(name, factor * found.sizes[name])
            errors.append(abs(float(np.mean(shares)) - wanted))
    assert np.mean(errors) < 0.04
    assert np.max(errors) < 0.15


def test_a_monitor_is_in_alarm_at_the_size_that_it_prints() -> None:
    plant = noisy_motor()
    best = rs.suggest(plant).best
    assert best is not None
    rng = np.random.default_rng(1)
    system = plant.system(("control", "fault", "noise"))

    def recorded(rows: int, fault: int | None = None, size: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        v = np.zeros((rows, system.n_inputs))
        v[:, 0] = np.repeat(rng.uniform(-1, 1, rows // 50), 50)
        v[:, 1 + len(plant.faults) :] = rng.standard_normal((rows, len(plant.noises)))
        if fault is not None:
            v[:, 1 + fault] = size
        return v[:, :1], system.simulate(v)

    test = rs.decide.NormThreshold(window=WINDOW, persistence=1)
    monitor = rs.Monitor(best.made, test=test).fit(*recorded(20_000), false_alarm_rate=RATE)
    for j, name in enumerate(plant.faults):
        for part, least, most in ((1.0, 0.85, 1.0), (1 / 3, 0.0, 0.5)):
            diagnosis = monitor.run(*recorded(1500, j, part * best.sizes[name]))
            assert isinstance(diagnosis, rs.Diagnosis)
            assert least <= diagnosis.alarm.mean() <= most, name


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_sizes_are_in_the_units_of_the_fault(scale: float) -> None:
    plant = noisy_motor()
    other = rs.Plant(plant.A, plant.B, scale * plant.C, dt=plant.dt, inputs=["V"], outputs=["speed", "current"])
    other = other.with_sensor_faults().with_actuator_faults().with_noise(process=1e-5, measurement=scale**2 * 1e-3)
    first, second = rs.suggest(plant).best, rs.suggest(other).best
    assert first is not None
    assert second is not None
    assert second.call == first.call
    expected = [first.sizes[name] * (scale if "sensor" in name else 1.0) for name in plant.faults]
    assert np.allclose([second.sizes[name] for name in plant.faults], expected, rtol=1e-6)


# ------------------------------------------------------------------------------ what is first


def test_the_kalman_filter_is_first_with_noise() -> None:
    found = rs.suggest(noisy_motor())
    assert found.best is not None
    assert found.best.call == "rs.design.kalman_filter(plant)"
    assert f"seen as long as it lasts (in brackets, by deviations of the noise): {found.seen_by(found.best)}" in str(
        found
    )
    assert found.entries[1].method.name == "structured_bank"


def ratio(found: suggestion.Suggestion, name: str) -> float:
    """Return how many times smaller the faults are that a design sees than those of the Kalman filter."""
    sizes = [entry_of(found, one).sizes for one in ("kalman_filter", name)]
    return float(np.exp(np.mean([np.log(sizes[0][fault] / sizes[1][fault]) for fault in found.plant.faults])))


def test_another_design_is_first_where_its_sizes_are_clearly_smaller_and_its_names_no_worse() -> None:
    """The slow poles of the detection filter average: its names of leaks are worse, those of sensors are not."""
    whole, sensors = rs.suggest(tanks()), rs.suggest(tanks().without_faults().with_sensor_faults())
    assert min(ratio(found, "detection_filter") for found in (whole, sensors)) > ranking.SMALLER
    assert whole.best is not None
    assert sensors.best is not None
    assert whole.best is entry_of(whole, "kalman_filter")
    assert "leak 3" in whole.best.names
    assert "leak 3" not in entry_of(whole, "detection_filter").names
    assert sensors.best is entry_of(sensors, "detection_filter")
    assert sensors.best.names == sensors.plant.faults


def test_the_first_names_the_leak_of_the_demo() -> None:
    """The detection filter, which sees smaller ones, took it for a sensor."""
    plant = rs.library.three_tank(dt=1.0).with_noise(process=1e-4, measurement=0.02)
    best = suggestion.first_design(plant).best
    assert best is not None
    normal = rs.library.simulate_three_tank(20_000)
    test = rs.decide.NormThreshold(persistence=5, window=10)
    monitor = rs.Monitor(best.made, test=test).fit(normal.u, normal.y, false_alarm_rate=0.01)
    faulty = rs.library.simulate_three_tank(1500, faults={"leak 3": 0.05 * (np.arange(1500) >= 600)}, seed=1)
    diagnosis = monitor.run(faulty.u, faulty.y)
    assert isinstance(diagnosis, rs.Diagnosis)
    assert diagnosis.candidates[0].faults == ("leak 3",)


def test_without_noise_it_says_what_it_assumes() -> None:
    found = rs.suggest(motor())
    assert found.best is not None
    assert found.best.call == "rs.design.kalman_filter(plant.with_assumed_noise())"
    assert "no noise is given: sizes assume 10 %" in found.notes[0]
    assert "plant.with_noise(...)" in found.notes[0]
    with pytest.raises(ModelError, match="has noise"):
        noisy_motor().with_assumed_noise()


def test_what_a_disturbance_reaches_is_never_first() -> None:
    found = rs.suggest(rs.library.twardy())
    assert found.best is not None
    assert found.best.method.name == "decoupled_residual"
    assert entry_of(found, "kalman_filter").left_out == "d1 reaches it"
    generator = as_generator(for_monitor(found.best.made))
    form = generator.internal_form()
    response = np.abs(form.frequency_response(np.logspace(-2, 3, 20)))
    assert response[:, :, len(generator.faults)].max() < 1e-6 * response[:, :, : len(generator.faults)].max()


def test_where_nothing_keeps_a_disturbance_out_nothing_is_first() -> None:
    plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=0.1, measurement=0.2)
    found = rs.suggest(plant.with_disturbances({"load": [1.0]}))
    assert found.best is None
    assert entry_of(found, "kalman_filter").left_out == "load reaches it"
    assert any("without_disturbances().with_noise" in note for note in found.notes)


def test_an_estimator_without_a_free_pole_does_not_exist() -> None:
    found = rs.suggest(rs.library.vtol(), want="size")
    assert found.best is not None
    poles = as_generator(found.best.made).system.poles()
    assert len(as_generator(found.best.made).evidence.fixed_poles) < len(poles)
    assert not any(len(entry.estimates) == 3 for entry in found.entries)
    assert any("no pole of an estimate that ignores v_horizontal sensor" in str(entry) for entry in found.entries)


def test_what_leaves_a_fault_unseen_that_another_sees_is_left_out() -> None:
    found = rs.suggest(tanks())
    for entry in found.entries:
        if entry.left_out.startswith("does not see"):
            assert not set(entry.left_out.removeprefix("does not see ").split(", ")) <= {
                name for name, size in entry.sizes.items() if size < ranking.UNSEEN * found.deviations[name]
            }


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_banks_averages_and_derivatives_are_never_first(plant: rs.Plant) -> None:
    if plant.faults:
        best = suggestion.first_design(plant).best
        assert best is None or not (best.method.many or best.method.noise in ("moving average", "differentiated"))


def test_matched_filters_are_first_for_sizes_of_sampled_plants() -> None:
    noisy = rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)
    best = rs.suggest(noisy, want="size").best
    assert best is not None
    assert best.call == "rs.design.matched_filters(plant)"
    assert best.names == best.estimates == noisy.faults
    twins = entry_of(rs.suggest(noisy.with_faults({"p1 again": [1, 1, 0]})), "matched_filters")
    assert set(twins.names) == set(noisy.faults) - {"p1"}
    assert "p1" in twins.estimates
    continuous = rs.Plant([[-1.0]], [[1.0]], [[1.0]]).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    assert "discretize" in entry_of(rs.suggest(continuous), "matched_filters").reason


def test_a_continuous_plant_is_sampled_for_its_sizes() -> None:
    plant = rs.Plant([[-1.0]], [[1.0]], [[1.0]]).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    found = rs.suggest(plant)
    assert found.best is not None
    assert found.best.sizes
    assert not as_generator(found.best.made).system.is_discrete
    assert any("a sample each 0.1 s" in note for note in found.notes)


# ---------------------------------------------------------------------------- for the state


def test_for_the_state_noise_brings_the_kalman_filter() -> None:
    plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1)
    assert rs.suggest(plant).best.call == "rs.design.luenberger_observer(plant)"  # pyright: ignore
    noisy = rs.suggest(plant.with_noise(process=0.1, measurement=0.2))
    assert noisy.best.call == "rs.design.kalman_filter(plant)"  # pyright: ignore


@pytest.mark.parametrize("plant", [PLANTS[0], PLANTS[2], PLANTS[-1]], ids=lambda plant: plant.name)
def test_the_best_for_the_state_estimates_all_of_it(plant: rs.Plant) -> None:
    found = rs.suggest(plant, want="state")
    assert found.best is not None
    made = call(found.best, plant)
    observer = made.observer if isinstance(made, rs.design.ResidualGenerator) else made
    assert observer.system.n_outputs == plant.n_states  # pyright: ignore
    if plant.disturbances:
        assert found.best.method.decouples


def test_a_singular_plant_is_said_to_be_one() -> None:
    found = rs.suggest(singular_plant(np.random.default_rng(1), faults=0, sensors=False))
    assert any("singular" in note for note in found.notes)
    refused = {entry.method.name for entry in found.entries if entry.works is False}
    assert {"luenberger_observer", "reduced_order_observer"} <= refused


def test_disturbances_that_cannot_be_decoupled_are_told() -> None:
    plant = rs.Plant([[0, 1], [-2, -3]], [[0], [1]], [[1, 0]])
    late = rs.suggest(plant.with_disturbances({"load": [0, 1]}))  # seen by the second derivative only
    assert any("only perfect_observer decouples" in note for note in late.notes)
    assert late.best.call == "rs.design.perfect_observer(plant)"  # pyright: ignore
    hidden = rs.suggest(plant.with_disturbances({"load": [0, 1], "slip": [1, 0]}))
    assert any("cannot be decoupled" in note for note in hidden.notes)
    assert hidden.best.call == "rs.design.luenberger_observer(plant)"  # pyright: ignore


# ------------------------------------------------------------------------------------ time


def test_a_chain_of_fifty_tanks_is_answered_within_its_seconds() -> None:
    plant = chain(50)
    start = time.process_time()
    found = rs.suggest(plant, seconds=5)
    assert time.process_time() - start < 12
    assert found.best is not None
    assert any("the time is used up" in entry.reason for entry in found.entries if entry.works is None)


def test_time_runs_out_inside_a_trial_and_only_there() -> None:
    with time_limit(0), pytest.raises(TimeUsedUpError):
        rs.design.kalman_filter(
            random_plant(np.random.default_rng(8), n=5, dt=0.1).with_noise(process=1, measurement=1)
        )
    with time_limit(100), time_limit(0), pytest.raises(TimeUsedUpError):
        check_time()
    with time_limit(1), pytest.raises(TimeUsedUpError):
        check_time(needed=2)
    check_time(needed=2)


def test_no_time_no_trials() -> None:
    found = rs.suggest(rs.library.gertler(), seconds=0)
    assert all(entry.works is None for entry in found.entries)
    assert found.best is None


def test_what_is_too_large_is_not_tried() -> None:
    rng = np.random.default_rng(5)
    n = suggestion.LARGE + 10
    plant = rs.Plant(-np.diag(rng.uniform(1, 2, n)), rng.standard_normal((n, 2)), np.eye(n)[:4]).with_sensor_faults()
    found = rs.suggest(plant)
    skipped = [entry for entry in found.entries if entry.works is None and "states are more" in entry.reason]
    assert {"sensor_fault_bank", "fault_estimator"} <= {entry.method.name for entry in skipped}
    n = suggestion.LARGEST + 1
    found = rs.suggest(rs.Plant(-np.eye(n), np.ones((n, 1)), np.eye(n)[:2]).with_sensor_faults())
    assert all(entry.works is None for entry in found.entries)
    assert found.best is None
    assert "nothing that was tried" in str(found)


# ---------------------------------------------------------------------------------- errors


def test_errors_that_are_not_the_packages_pass() -> None:
    def breaks(plant: rs.Plant) -> rs.design.Observer:
        raise KeyError("gain")

    method(exists_when="never", order="n", source="this test", state="estimate")(breaks)
    try:
        with pytest.raises(KeyError, match="gain"):
            rs.suggest(motor())
    finally:
        catalogue.forget("breaks")


@trips("linear.poles.riccati:_gain")
def test_a_random_walk_that_hides_the_noise_of_the_outputs_is_refused() -> None:
    """Its innovations have a covariance that is singular to working precision: that was a LinAlgError."""
    A = [[2.3435e-02, 1.2563e08, 0], [-4.7907e-09, 0, 6.9044e-04], [0, 0, 1]]
    C = [[-4.9889e-03, -4.0517e06, 0], [-3.9380e-04, -8.0171e04, 0], [0, -3.4911e05, 0], [0, 0, 0]]
    plant = rs.Plant(A, np.zeros((3, 1)), C, dt=1)
    noisy = plant.with_noise(process=[0, 0, 1.3648e08], measurement=[2.8582e-02, 4.9478e-10, 1.9078e-07, 4.4799e-07])
    with pytest.raises(AccuracyError, match="no gain was found"):
        rs.design.kalman_filter(noisy)
    with pytest.raises(AccuracyError, match="the measurement noise is rounding"):
        filter_riccati(noisy.A, noisy.C, noisy.process_noise, noisy.measurement_noise, dt=1)


@pytest.mark.parametrize("options", [{"want": "everything"}, {"seconds": -1}, {"seconds": float("nan")}])
def test_settings_that_make_no_sense_are_refused(options: dict) -> None:
    with pytest.raises(SettingError):
        rs.suggest(rs.library.gertler(), **options)


@pytest.mark.parametrize("want", ["name", "size"])
def test_faults_that_are_not_there_cannot_be_wanted(want: str) -> None:
    with pytest.raises(SettingError, match="no faults"):
        rs.suggest(rs.Plant([[-1.0]], [[1.0]], [[1.0]]), want=want)


def test_a_set_of_plants_is_sent_to_what_serves_sets() -> None:
    """It has no attributes of a plant; the calls that are named are run here."""
    plant = rs.Plant([[0.9, 0.0], [0.1, 0.7]], [[1.0], [0.0]], np.eye(2), dt=1.0).with_sensor_faults()
    uncertain = UncertainPlant(
        plant.with_disturbances([[0.1], [0.0]], output=[[0.0], [0.1]]),
        deltas=[Perturbation("A", [[-1.0], [0.0]], [[1.0, 0.0]], -0.02, 0.02)],
    )
    with pytest.raises(ModelError, match=r"in_closed_loop.*robust_l1_bank.*multi_model_parity.*insensitive_parity"):
        rs.suggest(uncertain)  # pyright: ignore[reportArgumentType]
    members = [uncertain.member(v) for v in uncertain.sample_values(0, 20)]
    assert rs.design.multi_model_parity(members, order=1)
    loop = uncertain.in_closed_loop(rs.StateSpace([[0.5]], [[0.1, 0.0]], [[-1.0]], dt=1.0))
    with pytest.raises(ModelError, match=r"rs.design.robust_l1_bank\(plant\), whose.*suggest\(plant.nominal\)"):
        rs.suggest(loop)  # pyright: ignore[reportArgumentType]
    assert rs.suggest(loop.nominal).entries


def test_what_is_no_plant_is_refused() -> None:
    model = rs.InputOutputModel.from_plant(rs.library.gertler())
    with pytest.raises(ModelError, match="to_plant"):
        rs.suggest(model)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match="got StateSpace"):
        rs.suggest(rs.StateSpace([[0.5]], [[1.0]], [[1.0]], dt=1.0))  # pyright: ignore[reportArgumentType]


# ------------------------------------------------------------------------ the catalogue


METHODS = catalogue.methods()


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_records_say_what_the_functions_return(method: catalogue.Method) -> None:
    assert inspect.signature(getattr(rs.design, method.name)).return_annotation == method.returns


@pytest.mark.parametrize(
    "method", [one for one in METHODS if one.designs_for in ("plant", "observer")], ids=lambda method: method.name
)
def test_records_say_who_serves_singular_plants(method: catalogue.Method) -> None:
    plant = rs.Plant(
        [[-1, 1, 0], [0, -1, 1], [0, 0, 1]],
        [[1], [0], [1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        E=[[1, 0, 0], [0, 1, 0], [0, 0, 0]],
        dt=1.0 if method.name == "matched_filters" else 0.0,
    ).with_noise(process=1.0, measurement=1.0)
    plant = plant.with_actuator_faults() if method.name == "actuator_fault_bank" else plant.with_sensor_faults([0])
    if method.name == "inverse_form_observer":
        plant = plant.without_faults().with_actuator_faults()
    arguments, options = (["1"],) if method.name in ("structured_bank", "structured_parity") else (), {}
    if method.name == "directional_parity":
        options = {"directions": {plant.faults[0]: [2, 1]}}
    if method.name == "optimal_parity":
        options = {"order": 2}
    if method.name == "residual_generator_from_observer":  # one row of the bank's member in the general form
        form = rs.design.general_form(rs.design.decoupled_residual(plant))
        options = {name: getattr(form, name) for name in ("M", "J", "N", "Ls", "Lu", "Ly", "T")}

    def design() -> object:
        return getattr(rs.design, method.name)(plant, *arguments, **options)

    if method.singular:
        assert type(design()).__name__ == method.returns
    else:
        with pytest.raises((DesignError, ModelError)):
            design()


@pytest.mark.refusals(at_most=0)
def test_records_say_what_decouples(refused: Refused) -> None:
    plant = rs.library.jet_engine().with_noise(process=1.0, measurement=1.0)
    for entry in rs.suggest(plant).entries:
        made = entry.made
        if made is None:
            continue
        if not brings_a_generator(type(made)):
            continue
        try:
            generator = as_generator(for_monitor(made))
        except DesignError as error:
            refused(error)
            continue
        form = generator.internal_form()
        first = len(generator.faults)
        columns = list(range(first, first + len(generator.plant.disturbances)))
        response = np.abs(form.frequency_response(np.logspace(-2, 3, 20)))
        gain = response[:, :, columns].max() / response[:, :, :first].max()
        assert (gain < 1e-6) == entry.method.decouples, entry.call


def test_the_tables_of_the_documentation_are_current() -> None:
    path = REPOSITORY / "docs" / "make_tables.py"
    spec = importlib.util.spec_from_file_location("make_tables", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.METHODS.read_text(encoding="utf-8") == module.methods()
    assert module.DESIGN_OPTIONS.read_text(encoding="utf-8") == module.design_options()


def test_groups_are_advised_where_residuals_are_many() -> None:
    def notes(sensors: int) -> str:
        plant = rs.Plant([[0.9]], [[0.1]], np.linspace(0.5, 1.5, sensors)[:, None], dt=1.0).with_faults({"leak": [1.0]})
        return " ".join(rs.suggest(plant.with_noise(process=1e-4, measurement=1e-2)).notes)

    assert "NormThreshold(groups='each')" in notes(12)
    assert "groups" not in notes(3)
