"""What is suggested designs, what is said to be refused is refused, and the ranking serves what is wanted."""

from __future__ import annotations

import importlib.util
import inspect
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from effort import cases
from generated import random_plant, singular_plant
from refusals import Refused
from residua.design import catalogue, suggestion
from residua.design.core.brought import as_generator, brings_a_generator, for_monitor
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.plant import Perturbation, UncertainPlant

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


@pytest.fixture(params=cases(sorted(range(len(PLANTS)), key=lambda k: k not in _USUAL), len(_USUAL)), scope="module")
def answer(request: pytest.FixtureRequest) -> suggestion.Suggestion:
    return rs.suggest(PLANTS[request.param], seconds=120)


def call(entry: suggestion.Entry, plant: rs.Plant) -> object:
    """Type the line that was suggested."""
    return eval(entry.call, {"rs": rs, "plant": plant})


def test_the_lines_do_what_is_said_of_them(answer: suggestion.Suggestion) -> None:
    for entry in answer.entries:
        if entry.works:
            assert type(call(entry, answer.plant)) is type(entry.made)
        elif entry.works is False:
            with pytest.raises(REFUSALS) as error:
                call(entry, answer.plant)
            assert str(error.value) == entry.reason
        assert entry.reason


@pytest.mark.parametrize("want", suggestion.WANTS)
@pytest.mark.parametrize("plant", [PLANTS[0], PLANTS[2], PLANTS[-1]], ids=lambda plant: plant.name)
def test_the_best_gives_what_is_wanted(plant: rs.Plant, want: str) -> None:
    found = rs.suggest(plant, want=want)
    best = found.best
    if best is None:
        working = [entry for entry in found.entries if entry.works]
        assert not any(entry.estimates if want == "size" else entry.names for entry in working)
        return
    made = call(best, plant)
    if want == "size":
        assert set(made.faults) == set(best.estimates)
        assert all(len(best.estimates) >= len(entry.estimates) for entry in found.entries if entry.works)
    if want == "state":
        observer = made.observer if isinstance(made, rs.design.ResidualGenerator) else made
        assert observer.system.n_outputs == plant.n_states
    if plant.disturbances and any(e.works and e.method.decouples and suggestion._gives(e, want) for e in found.entries):
        assert best.method.decouples


def test_faults_that_are_named_are_told_apart_by_the_rank_conditions_too(answer: suggestion.Suggestion) -> None:
    plant = answer.plant
    if not plant.faults:
        return
    isolable = rs.diagnosability(plant).isolable
    for entry in answer.entries:
        exposed = plant.disturbances and not entry.method.decouples
        if isinstance(entry.made, rs.design.Bank) and not exposed:
            for name in entry.names:
                i = plant.faults.index(name)
                others = [j for j in range(len(plant.faults)) if j != i]
                assert (isolable[i, others] | isolable[others, i]).all(), (entry.call, name)


def test_a_named_fault_is_told_on_simulated_data() -> None:
    rng = np.random.default_rng(3)
    plant = random_plant(rng, n=4, outputs=4, faults=3, dt=0.1)
    entry = next(e for e in rs.suggest(plant).entries if e.method.name == "structured_bank")
    assert set(entry.names) == set(plant.faults)
    bank = entry.made
    system = plant.system(("control", "fault"))
    for k, name in enumerate(plant.faults):
        v = rng.standard_normal((300, system.n_inputs))
        v[:, len(plant.inputs) :] *= np.arange(3) == k
        r = np.abs(bank.generator.run(v[:, : len(plant.inputs)], system.simulate(v)))
        fired = [r[:, list(member.residuals)].max() > 1e-6 for member in bank.generator.members]
        assert fired == list(bank.structure[:, bank.faults.index(name)])


def test_it_prints_what_it_found(answer: suggestion.Suggestion) -> None:
    text = str(answer)
    for entry in answer.entries:
        assert entry.call in text
    assert all(note in text for note in answer.notes)


def test_noise_brings_the_kalman_filter_first() -> None:
    plant = rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1)
    assert rs.suggest(plant).best.call == "rs.design.luenberger_observer(plant)"
    noisy = rs.suggest(plant.with_noise(process=0.1, measurement=0.2))
    assert noisy.best.call == "rs.design.kalman_filter(plant)"
    assert any("noise" in note for note in noisy.notes)


def test_matched_filters_are_for_sampled_plants_with_noise() -> None:
    def tried(plant: rs.Plant) -> suggestion.Entry:
        return next(entry for entry in rs.suggest(plant).entries if entry.method.name == "matched_filters")

    plant = rs.library.gertler(sensor_faults=True)
    assert "no noise" in tried(plant).reason
    noisy = plant.with_noise(process=0.01, measurement=0.1)
    entry = tried(noisy)
    assert entry.works
    assert entry.names == entry.estimates == plant.faults
    assert rs.suggest(noisy, want="size").best.call == entry.call  # no estimator has all four faults
    twins = tried(noisy.with_faults({"p1 again": [1, 1, 0]}))
    assert set(twins.names) == set(plant.faults) - {"p1"}
    assert "p1" in twins.estimates
    continuous = rs.Plant([[-1.0]], [[1.0]], [[1.0]]).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    assert "discretize" in tried(continuous).reason
    exposed = tried(noisy.with_disturbances({"load": [1, 0, 1]}))
    assert "disturbances reach it" in exposed.reason


def test_banks_are_suggested_with_a_chosen_coding_set() -> None:
    plant = rs.library.three_tank()
    entry = next(e for e in rs.suggest(plant).entries if e.method.name == "structured_bank")
    assert entry.call == "rs.design.structured_bank(plant, rs.coding.choose(plant))"
    alone = {group[0] for group in rs.diagnosability(plant).groups if len(group) == 1}
    assert set(entry.names) == alone


def test_a_singular_plant_is_said_to_be_one() -> None:
    found = rs.suggest(singular_plant(np.random.default_rng(1), faults=0, sensors=False))
    assert any("singular" in note for note in found.notes)
    refused = {entry.method.name for entry in found.entries if entry.works is False}
    assert {"luenberger_observer", "reduced_order_observer"} <= refused


def test_disturbances_that_cannot_be_decoupled_are_told() -> None:
    plant = rs.Plant([[0, 1], [-2, -3]], [[0], [1]], [[1, 0]])
    late = rs.suggest(plant.with_disturbances({"load": [0, 1]}))  # seen by the second derivative only
    assert any("only perfect_observer decouples" in note for note in late.notes)
    assert late.best.call == "rs.design.perfect_observer(plant)"
    hidden = rs.suggest(plant.with_disturbances({"load": [0, 1], "slip": [1, 0]}))
    assert any("cannot be decoupled" in note for note in hidden.notes)
    assert hidden.best.call == "rs.design.luenberger_observer(plant)"


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


def test_no_time_no_trials() -> None:
    found = rs.suggest(rs.library.gertler(), seconds=0)
    assert all(entry.works is None for entry in found.entries)


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
