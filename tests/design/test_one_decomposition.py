"""An answer about existence carries its decomposition, and the design goes on with it: nothing is decomposed twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.analysis import unknown_input

PARTS = ("even_plant", "output_free_form", "_ordinary_decoupling", "singular_decoupling", "with_equations_measured")
D = rs.design


def singular(outputs: int = 2) -> rs.Plant:
    """One algebraic equation; with one output it is needed as a measurement."""
    plant = rs.Plant(
        [[-1, 1, 0], [0, -2, 1], [1, 0, -3]], [[0], [1], [0]], np.eye(3)[[0, 2]][:outputs], E=np.diag([1, 1, 0])
    )
    return plant.with_disturbances({"gust": [1, 0, 0]}) if outputs > 1 else plant


def count(monkeypatch: pytest.MonkeyPatch, design: Callable[[], Any]) -> Counter[str]:
    """Return how often each part of the decomposition is computed, wherever it is called from."""
    calls: Counter[str] = Counter()

    def counting(name: str, right: Callable[..., Any]) -> Callable[..., Any]:
        def one(*args: Any, **options: Any) -> Any:
            calls[name] += 1
            return right(*args, **options)

        return one

    modules = [unknown_input]
    modules += [
        __import__(f"residua.design.{name}", fromlist=["_"])
        for name in (
            "observers.unknown_input_observer",
            "observers.inverse_form_observer",
            "detection_filters.detection_filter",
            "detection_filters.robust_detection_filter",
        )
    ]
    for name in PARTS:
        right = getattr(unknown_input, name)
        for module in modules:
            if hasattr(module, name):
                monkeypatch.setattr(module, name, counting(name, right))
    design()
    return calls


@pytest.mark.parametrize(
    "design",
    [
        lambda: D.unknown_input_observer(rs.library.jet_engine()),
        lambda: D.unknown_input_observer(rs.library.jet_engine()).residual_generator(),
        lambda: D.robust_detection_filter(rs.library.jet_engine(), poles=[-3, -3, -3]),
        lambda: D.inverse_form_observer(rs.library.vtol(), faults=["collective actuator", "cyclic actuator"]),
        lambda: D.fault_estimator(rs.library.vtol(), faults=["collective actuator", "cyclic actuator"]),
    ],
)
def test_an_ordinary_plant_is_decomposed_once(design: Callable[[], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    found = count(monkeypatch, design)
    assert found == {"even_plant": 1, "output_free_form": 1, "_ordinary_decoupling": 1}


def test_a_singular_plant_is_decomposed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found = count(monkeypatch, lambda: D.unknown_input_observer(singular()))
    assert found == {"even_plant": 1, "output_free_form": 1, "singular_decoupling": 1}


def test_and_once_more_with_its_equations_where_they_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    found = count(monkeypatch, lambda: D.unknown_input_observer(singular(outputs=1)))
    assert found == {"even_plant": 1, "output_free_form": 2, "singular_decoupling": 2, "with_equations_measured": 1}
