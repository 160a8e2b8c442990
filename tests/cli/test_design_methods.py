"""Every method that the command line offers, with every option that its function has: from the registry alone."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from cli_examples import Residua, assert_error
from residua.analysis import coding
from residua.cli import methods
from residua.cli.option_types import (
    Form,
    form_of,
    in_plain_words,
    parse_matrix,
    parse_names,
    parse_number,
    parse_rate,
    parse_rows,
    parse_whole,
)
from residua.design.catalogue import methods as registered
from residua.design.core.method import METHODS, Option
from residua.errors import SettingError

OFFERED = methods.offered()
PLANTS = ("gertler", "three_tank", "jet_engine", "vtol", "twardy")
#: What is needed besides a plant file.
NEEDED = {"order": "2", "directions": "p1=1,0.5; p2=1,2"}


def needed(name: str) -> list[str]:
    """Return the options without which a method cannot be called."""
    wanted = methods.Call(OFFERED[name], {}).left_out
    return [text for one in wanted for text in (methods.option_name(one), NEEDED[one])]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the plants of the library, one of them sampled, noisy and disturbed."""
    folder = tmp_path_factory.mktemp("library")
    for name in PLANTS:
        getattr(rs.library, name)().to_toml(folder / f"{name}.toml")
    return folder


@pytest.mark.parametrize("name", OFFERED)
def test_a_design_is_that_of_the_call_in_python_to_the_bit(
    name: str, files: Path, tmp_path: Path, residua: Residua
) -> None:
    """On the first plant of the library for which it exists, by the line that ``--show-call`` prints."""
    for plant in PLANTS:
        path = files / f"{plant}.toml"
        command = ("design", path, "-o", tmp_path / "m.json", "--method", name, *needed(name), "--show-call")
        status, out, _ = residua(*command)
        if status == 0:
            break
    else:
        pytest.fail(f"{name} exists for no plant of the library")
    line = re.search(r"^call: (.*)$", out, flags=re.MULTILINE)
    assert line is not None
    assert line[1].startswith(f"rs.design.{OFFERED[name].name}(plant")
    made = eval(line[1], {"rs": rs, "plant": rs.plant.load_plant(path)})
    made = (
        made
        if isinstance(made, rs.design.ResidualGenerator) or hasattr(made, "generator")
        else made.residual_generator()
    )
    system, saved = getattr(made, "generator", made).system, rs.Monitor.load(tmp_path / "m.json").design.system
    for matrix in "ABCD":
        assert getattr(saved, matrix).tobytes() == getattr(system, matrix).tobytes()


#: What a design for two tanks needs besides, so that a residual is left.
OF_TWO_TANKS = {
    "reduced-order-observer": ["--outputs", "level 1"],
    "descriptor-observer": ["--outputs", "level 1"],
    "perfect-observer": ["--least-order"],
    "fault-estimator": ["--faults", "level 1 sensor"],
    "directional-parity": ["--directions", "leak=1,0.5; level 1 sensor=1,2"],
}


@pytest.mark.parametrize("name", OFFERED)
def test_what_is_designed_can_be_fitted_and_run(name: str, made: Path, tmp_path: Path, residua: Residua) -> None:
    plant = made / ("disturbed.toml" if name == "robust-detection-filter" else "plant.toml")
    options = OF_TWO_TANKS.get(name, needed(name))
    status, _, err = residua("design", plant, "-o", tmp_path / "m.json", "--method", name, *options)
    assert status == 0, err
    fit = ("fit", tmp_path / "m.json", made / "normal.csv", "-o", tmp_path / "m.json", "--false-alarm-rate", "0.01")
    assert residua(*fit)[0] == 0
    assert residua("run", tmp_path / "m.json", made / "faulty.csv", "-q")[0] in (0, 1)


# ------------------------------------------------------------------------------- options


def written(form: Form) -> list[str]:
    """Return texts of a form, by what stands for its value."""
    texts = {
        "LIST": ["01,10"] if form.read is parse_rows else ["0.5,0.25"],
        "MATRIX": ["1,2;3,4"],
        "RATE": ["0.5"],
        "NUMBER": ["0.5"],
        "N": ["2"],
    }
    first, _, named = form.metavar.partition("NAME=")
    out = texts.get(first.rstrip("|")) or ([] if named else first.split("|"))
    return out + ([f"p1={texts[named.partition(';')[0]][0].replace(';', ',')}; p2=0.5"] if named else [])


def pairs() -> Iterator[tuple[str, Option]]:
    for name, method in OFFERED.items():
        for option in method.options:
            if form_of(option) is not None:
                yield name, option


@pytest.fixture
def spied(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[dict[str, Any]]]:
    """Put a function in the place of a method that keeps what it is called with."""

    def spy(name: str) -> list[dict[str, Any]]:
        calls: list[dict[str, Any]] = []
        record = OFFERED[name]

        @functools.wraps(record.function)
        def function(plant: rs.Plant, **asked: Any) -> rs.design.ResidualGenerator:
            calls.append(asked)
            return rs.design.detection_filter(plant)

        monkeypatch.setitem(METHODS, record.name, replace(record, function=function))
        return calls

    return spy


@pytest.mark.parametrize(("name", "option"), [pytest.param(*pair, id=f"{pair[0]} {pair[1].name}") for pair in pairs()])
def test_every_option_of_a_method_reaches_its_function(
    name: str, option: Option, spied: Any, files: Path, tmp_path: Path, residua: Residua
) -> None:
    form = form_of(option)
    assert form is not None
    calls = spied(name)
    others = needed(name)
    flag = methods.flag(option)
    if flag in others:
        at = others.index(flag)
        others = others[:at] + others[at + 2 :]
    noisy = files / "noisy.toml"
    rs.library.gertler().with_noise(process=1.0, measurement=1.0).to_toml(noisy)
    command = ("design", noisy, "-o", tmp_path / "m.json", "--method", name, *others)
    told = [((flag,), True), ((f"--no-{flag[2:]}",), False)] if form.is_flag else []
    for given, value in told or [((flag, text), form.read(text)) for text in written(form)]:
        status, _, err = residua(*command, *given)
        assert status == 0, err
        assert calls[-1][option.name] == value
    assert len(calls) == len(told or written(form)) > 0


@pytest.mark.parametrize("name", OFFERED)
def test_an_option_that_a_method_does_not_have_is_refused(name: str) -> None:
    own = {option.name for option in OFFERED[name].options}
    for one in methods.options():
        if one.name not in own:
            with pytest.raises(SettingError) as error:
                methods.call_of(name, {one.name: "1"}, {}, None)
            assert str(error.value).endswith(f", not for {name}")
            for other in one.methods:
                assert other in str(error.value)
                assert one.name in {option.name for option in OFFERED[other].options}


def test_the_refusal_of_an_option_is_one_line(files: Path, tmp_path: Path, residua: Residua) -> None:
    command = ("design", files / "gertler.toml", "-o", tmp_path / "m.json", "--method", "kalman-filter")
    assert_error(residua(*command, "--side", "left"), "--side is for --method eigenstructure-assignment, not")
    assert_error(residua(*command, "--no-combine"), "--combine is for --method eigenstructure-assignment, not for")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "options", "part"),
    [
        ("optimal-parity", (), "optimal-parity needs --order N: Relations of at most this order."),
        ("directional-parity", (), "directional-parity needs --directions NAME=MATRIX;...: For each fault"),
    ],
)
def test_an_option_that_a_method_needs_is_asked_for(
    name: str, options: tuple[str, ...], part: str, files: Path, tmp_path: Path, residua: Residua
) -> None:
    command = ("design", files / "gertler.toml", "-o", tmp_path / "m.json", "--method", name, *options)
    assert_error(residua(*command), part)


@pytest.mark.parametrize(
    ("name", "options", "part"),
    [
        ("primary-residuals", ("--form", "other"), "'other' is not one of ma, arma"),
        ("perfect-observer", ("--seed", "1.5"), "'1.5' is not a whole number"),
        ("matched-filters", ("--alike", "nan"), "'nan' is not a number"),
        ("fault-estimator", ("--bandwidth", "-1"), "must be positive"),
        ("unknown-input-observer", ("--H0", "1,2;3"), "is not a matrix"),
        ("directional-parity", ("--directions", "1,2"), "has no names"),
        ("directional-parity", ("--directions", "p1=1,2;3"), "has no '='"),
        ("structured-bank", ("--structure", "012"), "are not rows"),
        ("structured-bank", ("--structure", "01,10,0 1"), "'01' occurs twice"),
        ("directional-parity", ("--directions", "p1=1,2;p2=2,1; p1=3,1"), "'p1' occurs twice"),
        ("primary-residuals", ("--poles", "e1=0.5;e1=0.4"), "'e1' occurs twice"),
        ("luenberger-observer", ("--outputs", "y1,y1"), "'y1' occurs twice"),
    ],
)
def test_texts_that_say_nothing_are_usage_errors(
    name: str, options: tuple[str, str], part: str, files: Path, tmp_path: Path, residua: Residua
) -> None:
    status, out, err = residua("design", files / "gertler.toml", "-o", tmp_path / "m.json", "--method", name, *options)
    assert (status, out) == (2, "")
    said = " ".join(re.sub("[│╭╮╰╯─]", " ", err).split())
    assert options[0] in said
    assert part in said
    assert not list(tmp_path.iterdir())


def test_texts_of_options() -> None:
    assert parse_names(" a b ,c") == ("a b", "c")
    assert parse_number("-1e-3") == -1e-3
    assert parse_rate("2") == 2.0
    assert parse_whole("-3") == -3
    assert np.array(parse_matrix("1,2;3,4")).shape == (2, 2)
    for read, text in ((parse_rate, "0"), (parse_whole, "x"), (parse_matrix, ""), (parse_matrix, "1,,2")):
        with pytest.raises(ValueError, match=r"positive|not a whole|not a matrix|not a number"):
            read(text)


# --------------------------------------------------------------------- names and listing


def test_what_is_offered_is_decided_by_rule() -> None:
    beside = {one.name: methods.in_python_only(one) for one in registered()}
    assert beside["inverse_form_observer"] == "a monitor cannot run InverseFormObserver"
    assert beside["robust_l1_bank"] == "for an uncertain plant"
    assert beside["multi_model_parity"] == "for several plants"
    assert all((methods.method_name(one) in OFFERED) == (not beside[one.name]) for one in registered())


def test_the_methods_are_listed_with_what_they_need(residua: Residua) -> None:
    status, out, err = residua("design", "--methods")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert re.match(r"method +needs +exists when +options$", lines[0])
    assert [line.split()[0] for line in lines[1 : 1 + len(OFFERED)]] == list(OFFERED)
    assert "--scheme --observer --poles --margin --allow-missing" in out
    assert "in Python only: " in lines[-1]
    assert "robust_l1_bank, for an uncertain plant" in lines[-1]


def flowing(text: str) -> str:
    """Return a help on one line."""
    return " ".join(text.split())


@pytest.mark.parametrize("method", OFFERED)
def test_the_help_of_a_method_has_the_texts_of_its_options(
    method: str, residua: Residua, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    status, out, _ = residua("design", "--help", method)
    assert status == 0
    said = flowing(out)
    assert f"Design a monitor by {method}." in said
    own = {one.name: one for one in methods.offered()[method].options}
    for one in methods.options({"window"}):
        assert (f" {one.flags[0].partition('/')[0]} " in said) == (method in one.methods)
        assert method not in one.methods or flowing(in_plain_words(own[one.name].text)) in said
    assert not re.search(r"[\\…]|\^{|`", said)  # no raw formula, and no cut name


def test_the_help_of_a_method_is_found_wherever_it_is_named(residua: Residua) -> None:
    asked = [residua("design", *words) for words in (("matched_filters", "-h"), ("--method=matched-filters", "--help"))]
    assert asked[0] == asked[1] == residua("design", "--help", "matched-filters")
    assert "--steady" in asked[0][1]
    assert "--steady" not in residua("design", "--help")[1]


def test_the_help_of_design_is_short(residua: Residua, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = residua("design", "--help")
    assert len(out.splitlines()) <= 80
    assert "residua design --help METHOD" in flowing(out)


def test_what_is_chosen_from_the_plant_is_chosen_once(
    made: Path, tmp_path: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The choice of a coding set takes seconds: those that are tried after a refusal share it."""
    chosen, real = [], coding.choose

    def choose(*given: Any, **options: Any) -> Any:
        chosen.append(options)
        return real(*given, **options)

    monkeypatch.setattr("residua.design.banks.structured_bank.choose", choose)
    status, _, err = residua("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", "perfect-observer")
    assert status == 2
    assert "--method structured-bank" in err
    assert "--method structured-parity" in err
    assert chosen == [{"time_limit": methods.CHOICE_TIME}]


def test_methods_that_there_is_no_time_for_are_named(
    made: Path, tmp_path: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(methods, "TRYING_TIME", -1.0)
    outcome = residua("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", "perfect-observer")
    assert_error(outcome, "no other method exists", "not tried, for lack of time: luenberger-observer, ")


@pytest.mark.parametrize(
    ("name", "options", "part"),
    [
        ("unknown-input-observer", ("--poles", "0.3,0.3,0.3"), "got 3 poles for 2 states"),
        ("detection-filter", ("--poles", "1.5,0.2"), "pole 1.5 is not stable"),
        ("detection-filter", ("--poles", "1.5,0.2", "--scaling", "even"), "pole 1.5 is not stable"),
    ],
)
def test_an_option_that_is_in_the_way_is_named_and_no_other_method(
    name: str, options: tuple[str, ...], part: str, made: Path, tmp_path: Path, residua: Residua
) -> None:
    """The plant has this design with other poles: that says nothing about other methods."""
    refused = residua("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", name, *options)
    flags = " and ".join(sorted(one for one in options if one.startswith("--")))
    assert_error(refused, f"{name}: ", part, f"; without {flags} {name} exists for this plant")
    assert "--method" not in refused[2]


def test_an_option_that_is_needed_may_be_what_is_wrong(made: Path, tmp_path: Path, residua: Residua) -> None:
    command = ("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", "directional-parity")
    refused = residua(*command, "--directions", "leak=1,0.5; pump actuator=1,2,3")
    doubt = "all the same number: got [2, 3]; directional-parity needs --directions, and another value may do; methods"
    assert_error(refused, doubt)


def test_other_methods_are_tried_with_the_defaults_of_their_options(
    made: Path, tmp_path: Path, residua: Residua
) -> None:
    """Where the plant is refused, three poles say nothing of observers for two states."""
    command = ("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", "perfect-observer")
    plain, with_option = residua(*command), residua(*command, "--seed", "3")
    assert_error(plain, "methods that exist for this plant: ", "--method luenberger-observer", "--method kalman-filter")
    assert with_option == plain


def test_a_method_may_be_written_as_its_function(made: Path, tmp_path: Path, residua: Residua) -> None:
    outcomes = [
        residua("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", name)
        for name in ("kalman_filter", "kalman-filter")
    ]
    assert outcomes[0] == outcomes[1]
    assert outcomes[0][0] == 0


def test_the_nearest_method_is_suggested(made: Path, tmp_path: Path, residua: Residua) -> None:
    status, _, err = residua("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method", "kalman_filtr")
    assert status == 2
    assert "(did you mean 'kalman-filter'?)" in " ".join(re.sub("[│╭╮╰╯─]", " ", err).split())


def test_the_call_alone_needs_no_output(made: Path, residua: Residua) -> None:
    command = ("design", made / "plant.toml", "--method", "luenberger-observer", "--poles", "0.3, 0.2")
    status, out, err = residua(*command, "--show-call")
    assert (status, err) == (0, "")
    assert out == ("method: luenberger-observer\ncall: rs.design.luenberger_observer(plant, poles=(0.3, 0.2))\n")
    _, out, _ = residua(*command[:-1], "0.3+0.1j,0.3-0.1j", "--show-call")
    assert "poles=((0.3+0.1j), (0.3-0.1j))" in out
    _, out, _ = residua(*command[:3], "primary-residuals", "--poles", "e1=0.5", "--show-call")
    assert out.endswith("poles={'e1': (0.5,)})\n")
    status, out, err = residua(*command)
    assert (status, out) == (2, "")
    assert "--output" in err


def test_another_step_than_that_of_the_plant_is_refused(made: Path, tmp_path: Path, residua: Residua) -> None:
    command = ("design", made / "plant.toml", "-o", tmp_path / "m.json", "--dt")
    assert_error(residua(*command, "0.1"), "the plant is sampled every 1 s, and --dt is 0.1 s")
    assert not list(tmp_path.iterdir())
    assert residua(*command, "1")[0] == 0
