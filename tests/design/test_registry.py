"""One registry of methods: what declares itself is in ``__all__``, in the catalogue, tried, and on the command line."""

from __future__ import annotations

import copy
import inspect
import pickle
import typing
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.cli import main
from residua.design import catalogue
from residua.design.core.generator import as_generator, brings_a_generator, for_monitor
from residua.design.core.method import METHODS, Need, method, parameters_in, signature_of
from residua.errors import ModelError, SettingError

FUNCTIONS = {name: f for name in rs.design.__all__ if inspect.isfunction(f := getattr(rs.design, name))}
RECORDS = catalogue.methods()


def runs(cls: Any) -> bool:
    """Whether a class maps measurements to residuals or estimates, or has or makes what does: the rule of a design."""
    if not inspect.isclass(cls) or cls.__module__.split(".")[0] != "residua":
        return False
    fields = {name for base in cls.__mro__ for name in vars(base).get("__annotations__", {})}
    if (fields | set(dir(cls))) & {"run", "estimate", "generator", "residual_generator", "observer"}:
        return True
    mapped = [base for base in getattr(cls, "__orig_bases__", ()) if typing.get_origin(base) is Mapping]
    return any(runs(typing.get_args(base)[-1]) for base in mapped)


@pytest.mark.parametrize("name", sorted(set(FUNCTIONS) - {"method"}))
def test_a_function_is_a_method_when_what_it_returns_runs_on_measurements(name: str) -> None:
    function = FUNCTIONS[name]
    assert runs(signature_of(function).return_annotation) == (name in METHODS)


def test_the_rule_tells_designs_from_tools() -> None:
    """Both sides of the rule are there: forms, orders, gains, thresholds and choices are tools."""
    beside = {name for name in FUNCTIONS if name not in METHODS} - {"method"}
    assert {"general_form", "parity_orders", "compensation_gain", "certified_thresholds", "select_equations"} <= beside
    assert runs(rs.design.SensorFaultEstimators)
    assert runs(rs.design.InverseFormObserver)
    assert not runs(rs.design.GeneralForm)
    assert not runs(dict[str, rs.design.CertifiedThreshold])


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.name)
def test_every_method_of_the_package_is_a_public_name(record: catalogue.Method) -> None:
    assert record.name in rs.design.__all__
    assert getattr(rs.design, record.name) is record.function
    assert catalogue.method(record.name) is record
    assert record.called == f"rs.design.{record.name}"
    assert record.condition
    assert record.order
    assert record.source


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.name)
def test_what_a_method_is_for_is_what_it_takes_first(record: catalogue.Method) -> None:
    first = next(iter(signature_of(record.function).parameters.values()))
    assert record.takes_a_plant == (first.name == "plant" or record.name == "primary_residuals")


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.name)
def test_every_option_of_a_method_is_described(record: catalogue.Method) -> None:
    described = parameters_in(inspect.getdoc(record.function) or "")
    assert {one.name for one in record.options} <= set(described)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.name)
def test_every_method_links_those_to_weigh_against_it(record: catalogue.Method) -> None:
    text = inspect.getdoc(record.function) or ""
    links = [line.split(" : ")[0] for line in text.split("See Also\n--------\n")[1].split("\n\n")[0].splitlines()]
    assert 2 <= len(links) <= 4
    assert set(links) <= set(METHODS) - {record.name}


def test_a_declared_function_is_what_it_was() -> None:
    function = rs.design.kalman_filter
    assert list(inspect.signature(function).parameters) == ["plant"]
    assert (function.__doc__ or "").startswith("Use the innovations")
    assert pickle.loads(pickle.dumps(function)) is function


def test_a_record_is_one_of_its_kind_in_copies_too() -> None:
    record = catalogue.method("robust_detection_filter")
    assert pickle.loads(pickle.dumps(record)) is record
    assert copy.deepcopy(record) is record


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(SettingError, match="no design function is called 'magic'"):
        catalogue.method("magic")


# ------------------------------------------------------------------ a method of one's own


def gain_of_three(plant: rs.Plant, *, times: float = 3.0, keep: bool = False) -> rs.design.Observer:
    """Design an observer that is so many times as fast as the plant.

    Parameters
    ----------
    plant : Plant
    times : float
        How much faster.
    keep : bool
        Whether the pace of the plant is kept.
    """
    pace = float(np.abs(np.linalg.eigvals(plant.A)).min())
    return rs.design.luenberger_observer(plant, margin=pace if keep else times * pace)


@pytest.fixture
def own() -> Iterator[Any]:
    declare = method(exists_when="(C, A) detectable", order="n", source="this test", state="estimate, converges")
    yield declare(gain_of_three)
    catalogue.forget("gain_of_three")


@pytest.fixture
def plant() -> rs.Plant:
    made = rs.Plant([[-1.0, 0.2], [0.0, -2.0]], [[1.0], [0.0]], np.eye(2), inputs=["u"], outputs=["a", "b"])
    return made.with_sensor_faults()


def test_a_method_of_ones_own_is_everywhere(
    own: Any, plant: rs.Plant, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the catalogue, tried by suggest, and offered on the command line with its options: without a change inside."""
    record = catalogue.method("gain_of_three")
    assert own.__wrapped__ is gain_of_three
    assert record in catalogue.methods()
    assert any("gain_of_three" in row[0] for row in catalogue.table())
    entry = next(one for one in rs.suggest(plant).entries if one.method is record)
    assert entry.works
    assert eval(entry.call, {"gain_of_three": own, "plant": plant}).K.tolist() == entry.made.K.tolist()
    plant.to_toml(tmp_path / "plant.toml")
    command = ["design", str(tmp_path / "plant.toml"), "-o", str(tmp_path / "m.json"), "--method", "gain-of-three"]
    assert main([*command, "--times", "5", "--show-call"]) == 0
    assert "call: gain_of_three(plant, times=5.0)" in capsys.readouterr().out
    read = rs.plant.load_plant(tmp_path / "plant.toml")
    saved = rs.Monitor.load(tmp_path / "m.json").design.system
    wanted = own(read, times=5.0).residual_generator().system
    assert all((getattr(saved, k) == getattr(wanted, k)).all() for k in "ABCD")
    assert main([*command, "--keep"]) == 0
    assert main(["design", "--help", "gain-of-three"]) == 0
    assert "How much faster." in " ".join(capsys.readouterr().out.split())


def test_a_forgotten_method_is_nowhere(plant: rs.Plant) -> None:
    declare = method(exists_when="always", order="n", source="this test", state="estimate")
    declare(gain_of_three)
    catalogue.forget("gain_of_three")
    assert "gain_of_three" not in METHODS
    assert all(one.method.name != "gain_of_three" for one in rs.suggest(plant, seconds=0).entries)


def breaks(plant: rs.Plant) -> rs.design.Observer:
    raise KeyError("gain")


def returns_none(plant: rs.Plant) -> rs.design.Observer:
    return None  # pyright: ignore[reportReturnType]


def returns_text(plant: rs.Plant) -> rs.design.ResidualGenerator:
    return "a design"  # pyright: ignore[reportReturnType]


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (breaks, "breaks raised KeyError: 'gain' (a defect of the method)"),
        (returns_none, "returns_none returned NoneType, which is no design"),
        (returns_text, "returns_text returned str, which is no design"),
    ],
)
def test_what_is_no_design_takes_no_other_with_it(
    function: Any, reason: str, plant: rs.Plant, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = [one.call for one in rs.suggest(plant).entries if one.works]
    method(exists_when="never", order="n", source="this test", state="estimate")(function)
    answer = None
    try:
        if function is breaks:
            with pytest.raises(KeyError):
                rs.suggest(plant)
        else:
            answer = rs.suggest(plant)
        plant.to_toml(tmp_path / "plant.toml")
        command = ["design", str(tmp_path / "plant.toml"), "-o", str(tmp_path / "m.json"), "--method"]
        assert main([*command, function.__name__]) == 2
        alone = capsys.readouterr().err
        assert main([*command, "perfect-observer"]) == 2
        beside = capsys.readouterr().err
    finally:
        catalogue.forget(function.__name__)
    if answer is not None:
        entry = next(one for one in answer.entries if one.method.name == function.__name__)
        assert entry.works is False
        assert entry.reason.startswith(reason)
        assert [one.call for one in answer.entries if one.works] == whole
    assert alone.startswith(f"error: {reason}")
    assert "--method luenberger-observer" in beside
    assert function.__name__.replace("_", "-") not in beside


def test_a_name_that_is_taken_is_refused() -> None:
    def kalman_filter(plant: rs.Plant) -> rs.design.Observer:
        return rs.design.luenberger_observer(plant)

    with pytest.raises(SettingError, match="the name 'kalman_filter' is that of residua"):
        method(exists_when="never", order="n", source="this test")(kalman_filter)
    assert METHODS["kalman_filter"].function is rs.design.kalman_filter


def test_what_is_no_method_is_refused() -> None:
    def nothing() -> rs.design.Observer:
        raise AssertionError

    with pytest.raises(SettingError, match="nothing takes nothing"):
        method(exists_when="never", order="n", source="this test")(nothing)
    with pytest.raises(SettingError, match="designs_for must be one of plant"):
        method(exists_when="never", order="n", source="this test", designs_for="luck")(gain_of_three)  # pyright: ignore


def test_a_method_says_what_it_returns_and_takes_a_plant() -> None:
    declare = method(exists_when="never", order="n", source="this test")

    def says_nothing(plant: rs.Plant):
        raise AssertionError

    def returns_nothing(plant: rs.Plant) -> None:
        raise AssertionError

    def takes_a_number(speed: float, plant: rs.Plant) -> rs.design.Observer:
        raise AssertionError

    def takes_anything(plant) -> rs.design.Observer:
        raise AssertionError

    for function in (says_nothing, returns_nothing):
        with pytest.raises(SettingError, match=f"{function.__name__} does not say what it returns: write '-> rs"):
            declare(function)
    for function, first in ((takes_a_number, "speed"), (takes_anything, "plant")):
        with pytest.raises(SettingError, match=f"its first parameter is not .*: write '{first}: rs.Plant'"):
            declare(function)
    assert not {"says_nothing", "returns_nothing", "takes_a_number", "takes_anything"} & set(METHODS)


@pytest.mark.parametrize("wrong", [{"noise": "low"}, {"time_course": "ramp"}], ids=lambda wrong: next(iter(wrong)))
def test_a_value_that_is_none_of_a_declaration_is_refused(wrong: dict[str, Any]) -> None:
    name, value = next(iter(wrong.items()))
    with pytest.raises(SettingError, match=f"{name} must be one of .*, got '{value}'"):
        method(exists_when="never", order="n", source="this test", **wrong)(gain_of_three)
    assert "gain_of_three" not in METHODS
    assert catalogue.methods() == RECORDS


def test_a_method_is_forgotten_whatever_the_others_are() -> None:
    METHODS["gain_of_three"] = replace(RECORDS[0], function=gain_of_three, noise="low")  # cannot be sorted
    catalogue.forget("gain_of_three")
    assert catalogue.methods() == RECORDS
    with pytest.raises(SettingError, match="no design function is called 'gain_of_three'"):
        catalogue.forget("gain_of_three")


def test_annotations_that_cannot_be_read_are_refused() -> None:
    """A type that is imported for type checkers only has no meaning when the method is offered."""

    def unread(plant: rs.Plant, *, gains: Numbers = ()) -> rs.design.Observer:  # pyright: ignore  # noqa: F821
        raise AssertionError

    with pytest.raises(SettingError, match="the annotations of unread cannot be read: name 'Numbers' is not defined"):
        method(exists_when="never", order="n", source="this test")(unread)
    assert "unread" not in METHODS


def raises(plant: rs.Plant, known: Any) -> Any:
    raise KeyError("gain")


@pytest.mark.parametrize(
    ("asked", "error"),
    [
        ({"calls": raises}, KeyError),
        ({"needs": [Need("luck", raises)]}, KeyError),
        ({"calls": lambda plant, known: [3.0]}, TypeError),
    ],
    ids=["calls", "needs", "no options"],
)
def test_what_a_method_raises_when_it_is_asked_passes(
    asked: dict[str, Any], error: type[Exception], plant: rs.Plant
) -> None:
    method(exists_when="never", order="n", source="this test", state="estimate", **asked)(gain_of_three)
    try:
        with pytest.raises(error):
            rs.suggest(plant)
    finally:
        catalogue.forget("gain_of_three")


def takes_more(plant: rs.Plant, *more: float, margin: float = 0.1, **others: float) -> rs.design.Observer:
    return rs.design.luenberger_observer(plant, margin=margin)


def test_any_number_of_arguments_is_no_option(plant: rs.Plant) -> None:
    method(exists_when="(C, A) detectable", order="n", source="this test", state="estimate")(takes_more)
    try:
        assert [one.name for one in catalogue.method("takes_more").options] == ["margin"]
        entry = next(one for one in rs.suggest(plant).entries if one.method.name == takes_more.__name__)
    finally:
        catalogue.forget("takes_more")
    assert entry.works


def test_a_method_that_is_declared_meanwhile_does_not_disturb_the_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    place = catalogue.Method.place
    declare = method(exists_when="never", order="n", source="this test")

    def meanwhile(one: catalogue.Method) -> tuple[Any, ...]:
        declare(gain_of_three)
        return place.__get__(one)

    monkeypatch.setattr(catalogue.Method, "place", property(meanwhile))
    try:
        assert catalogue.methods() == RECORDS
        assert "gain_of_three" in METHODS
    finally:
        catalogue.forget("gain_of_three")


def test_needs_are_asked_in_their_order(plant: rs.Plant) -> None:
    record = catalogue.method("matched_filters")
    assert [one.text for one in record.requirements if isinstance(one, Need)] == ["noise", "faults", "sampled"]
    assert "no noise" in record.missing(plant)
    noisy = plant.with_noise(process=1.0, measurement=1.0)
    assert "counts samples" in record.missing(noisy)
    assert not record.missing(noisy.discretize(0.1))


# --------------------------------------------------------------- what a monitor takes


def test_what_no_monitor_can_take_is_told_by_its_class_and_refused() -> None:
    plant = rs.Plant(-np.diag([1.0, 2.0]) + 0.1, np.eye(2), np.eye(2)).with_actuator_faults([0])
    made = rs.design.inverse_form_observer(plant)
    assert not brings_a_generator(type(made))
    with pytest.raises(ModelError, match="no monitor can take InverseFormObserver"):
        for_monitor(made)


def test_members_that_are_left_out_are_in_the_notes() -> None:
    plant = rs.Plant(np.diag([0.9, 0.8, 0.7]) + 0.1, np.ones((3, 1)), np.eye(3), dt=1.0).with_sensor_faults()
    bank = rs.design.sensor_fault_bank(plant.with_disturbances({"inflow": {"x1": 1.0}}), allow_missing=True)
    made = as_generator(for_monitor(bank))
    assert set(bank.failures) == {"without y1"}
    assert any(note.startswith("no member 'without y1': rank") for note in made.evidence.notes)
    assert made.system is bank.generator.system
