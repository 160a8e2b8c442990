"""Residuals that someone else computed, run by a monitor as those of a model are."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.decide import NormThreshold, Structured
from residua.errors import DataError, ModelError

CODES = np.array([[1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 0, 0]])
FAULTS = ["pump", "valve", "sensor"]


def samples(seed: int, time: int, exponent: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.standard_normal((time, 4)) + 3) * 2.0 ** (exponent * np.linspace(-1, 1, 4)).round()


def test_the_residuals_are_the_data_to_the_last_bit() -> None:
    made, data = rs.identify.given_residuals(4), samples(1, 50)
    np.testing.assert_array_equal(made.run(None, data), data)
    assert made.residuals == ("r1", "r2", "r3", "r4")
    assert made.faults == ()
    assert rs.Monitor(made).settling_samples <= 1


def test_a_matrix_and_a_mapping_are_the_same() -> None:
    names = ["a", "b", "c", "d"]
    one = rs.identify.given_residuals(names, CODES, faults=FAULTS, dt=0.1)
    by_name = {fault: [n for n, on in zip(names, CODES[:, j], strict=True) if on] for j, fault in enumerate(FAULTS)}
    other = rs.identify.given_residuals(names, by_name, dt=0.1)
    assert one.codes is not None
    np.testing.assert_array_equal(one.codes, other.codes)
    np.testing.assert_array_equal(one.structure, CODES.astype(bool))
    assert one.faults == other.faults == tuple(FAULTS)
    assert one.dt == 0.1


@pytest.mark.parametrize("exponent", [-20, 0, 20])
@pytest.mark.parametrize("fault", range(3))
def test_a_fault_is_named_by_its_column(fault: int, exponent: int) -> None:
    units = 2.0 ** (exponent * np.linspace(-1, 1, 4)).round()
    monitor = rs.Monitor(rs.identify.given_residuals(4, CODES, faults=FAULTS))
    assert isinstance(monitor.isolate, Structured)
    data = samples(3, 300, exponent)
    data[100:] += 9 * CODES[:, fault] * units
    diagnosis = monitor.fit(None, samples(2, 3000, exponent)).run(None, data)
    assert diagnosis.candidates[0].name == FAULTS[fault]
    assert diagnosis.onset == pytest.approx(100, abs=5)


def test_it_is_saved_and_shown(tmp_path) -> None:
    monitor = rs.Monitor(rs.identify.given_residuals(4, CODES, faults=FAULTS), test=NormThreshold(window=5))
    monitor.fit(None, samples(2, 600)).save(tmp_path / "monitor.json")
    loaded = rs.Monitor.load(tmp_path / "monitor.json")
    data = samples(4, 100) + 9 * CODES[:, 1]
    one, other = monitor.run(None, data), loaded.run(None, data)
    np.testing.assert_array_equal(one.statistic, other.statistic)
    one.to_html(tmp_path / "page.html")
    assert "not by how much" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("structure", "options", "error", "match"),
    [
        (CODES[:3], {}, DataError, "a row for each residual"),
        (CODES * 2, {}, DataError, "0 or 1"),
        (CODES * [[1, 1, 0]], {}, ModelError, "no residual answers to 'f3'"),
        (CODES, {"faults": ["one"]}, ModelError, "expected 3"),
        ({"pump": ["r9"]}, {}, ModelError, "r9"),
        ({"pump": ["r1"]}, {"faults": ["pump"]}, ModelError, "names the faults itself"),
        (None, {"faults": ["pump"]}, ModelError, "no structure"),
    ],
)
def test_what_does_not_fit_is_refused(structure: object, options: dict, error: type, match: str) -> None:
    with pytest.raises(error, match=match):
        rs.identify.given_residuals(4, structure, **options)  # pyright: ignore
