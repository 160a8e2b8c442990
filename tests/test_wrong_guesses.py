"""A wrong guess of a name gets an error that says what to use instead, and that exists."""

from __future__ import annotations

import copy
import pickle
import re
from functools import cache
from typing import Any

import pytest

import residua as rs
from residua.wrong_guesses import INSTEAD


@cache
def examples() -> dict[str, Any]:
    plant = rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    found = monitor.run([[0.0]] * 9, [[0.0]] * 9)
    return {"Plant": plant, "Monitor": monitor, "Diagnosis": found, "residua": rs, "residua.design": rs.design}


def guess(what: str) -> Any:
    owner, word = re.fullmatch(r"(.*?)\((\w*)\)", what).groups() if "(" in what else what.rsplit(".", 1)  # pyright: ignore
    if "(" not in what:
        return getattr(examples()[owner], word)
    function = {"Plant": rs.Plant, "Monitor": rs.Monitor, "kalman_filter": rs.design.kalman_filter}[owner]
    first = examples()["Plant"] if owner == "kalman_filter" else rs.design.kalman_filter(examples()["Plant"])
    return function(first, **{word: 1.0}) if word else function(first, **{"no such option": 1})


@pytest.mark.parametrize("what", INSTEAD)
def test_a_wrong_guess_is_answered(what: str) -> None:
    with pytest.raises(TypeError if "(" in what else AttributeError, match=re.escape(f"; {INSTEAD[what]}")):
        guess(what)


@pytest.mark.parametrize("what", [what for what in INSTEAD if re.fullmatch(r"[A-Z]\w+\.\w+", what)])
def test_a_wrong_guess_of_a_class_is_answered_too(what: str) -> None:
    owner, name = what.split(".")
    with pytest.raises(AttributeError, match=re.escape(f"'{owner}' has no attribute '{name}'; {INSTEAD[what]}")):
        getattr(getattr(rs, owner), name)


@pytest.mark.parametrize("what", INSTEAD)
def test_the_answer_names_only_things_that_exist(what: str) -> None:
    owners = examples() | {"plant": examples()["Plant"], "monitor": examples()["Monitor"]}
    owners |= {"diagnosis": examples()["Diagnosis"]}
    for path in re.findall(r"\b((?:residua|plant|monitor|diagnosis|Plant|Diagnosis|Monitor)(?:\.\w+)+)", INSTEAD[what]):
        first, *rest = path.split(".")
        value = owners[first]
        for name in rest:
            value = getattr(value, name)


def test_a_call_that_an_options_name_does_not_spoil_keeps_its_error() -> None:
    with pytest.raises(TypeError, match=r"^Monitor.__init__\(\) missing 1 required positional argument: 'generator'$"):
        rs.Monitor()  # pyright: ignore
    with pytest.raises(TypeError, match=r"use Plant\.from_state_space"):
        rs.Plant(rs.StateSpace([[0.5]], [[1.0]], [[1.0]]))  # pyright: ignore


def test_names_of_other_rooms_are_found_there() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'campaign'; use residua\.validate\.campaign$"):
        rs.campaign  # noqa: B018  # pyright: ignore
    with pytest.raises(AttributeError, match=r"has no attribute 'no_such_name'$"):
        rs.no_such_name  # noqa: B018  # pyright: ignore


@pytest.mark.parametrize("owner", ["Plant", "Monitor", "Diagnosis"])
def test_any_other_name_has_the_error_of_python_and_copies_are_made(owner: str) -> None:
    one = examples()[owner]
    with pytest.raises(AttributeError, match=f"^'{owner}' object has no attribute 'no_such_name'$"):
        one.no_such_name  # noqa: B018
    with pytest.raises(AttributeError, match=f"^type object '{owner}' has no attribute 'no_such_name'$"):
        type(one).no_such_name  # noqa: B018
    assert type(copy.deepcopy(one)) is type(pickle.loads(pickle.dumps(one))) is type(one)
