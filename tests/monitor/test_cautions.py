"""What a diagnosis says of its own names: faults that leak into the residuals of others, data in other units."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from dedicated_examples import dedicated_bank, recording
from residua.decide import NormThreshold, PeakThreshold
from residua.design import DifferentialEvolution
from residua.errors import DataError, FileFormatError
from residua.linear import StateSpace
from robust_loops import random_loop

LOOP = random_loop(1, most_states=3)
START = 400


@pytest.fixture(scope="module")
def bank() -> rs.design.RobustL1Bank:
    quick = DifferentialEvolution(population=20, generations=6, polish=False)
    return rs.design.robust_l1_bank(LOOP, search=quick, method="centred", progress=False)


def measured(sizes: Mapping[str, float], corner: int = 0, seed: int = 0) -> np.ndarray:
    """Outputs of a member at a corner of the set, under disturbances of length one, with faults that come as steps."""
    plant, rng = LOOP.member(LOOP.vertex_values()[corner]), np.random.default_rng(seed)
    w = rng.standard_normal((2 * START, 2))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    f = np.zeros((len(w), len(plant.faults)))
    for name, size in sizes.items():
        f[START:, plant.faults.index(name)] = size
    B, D = np.hstack([plant.Bd, plant.Bf]), np.hstack([plant.Dd, plant.Df])
    return StateSpace(plant.A, B, plant.C, D, dt=plant.dt).simulate(np.hstack([w, f]))


def run(monitor: rs.Monitor, y: np.ndarray) -> rs.Diagnosis:
    found = monitor.run(None, y)
    assert isinstance(found, rs.Diagnosis)
    return found


@pytest.mark.parametrize("corner", range(4))
@pytest.mark.parametrize("times", [10.0, 1000.0])
def test_a_large_fault_that_leaks_is_told_as_the_possible_cause_of_all(
    bank: rs.design.RobustL1Bank, corner: int, times: float
) -> None:
    """Whatever else fires in a member of the set, the one fault that is there is said to suffice for it."""
    for name, size in bank.smallest_faults.items():
        found = run(rs.Monitor(bank), measured({name: times * size}, corner))
        others = {member for alarm in found.alarms if alarm.reading for member in alarm.reading.fired} - {name}
        for other in others:
            assert f"what fires '{other}' may be '{name}' alone" in " ".join(found.notes)


def test_the_numbers_are_those_of_the_certificates(bank: rs.design.RobustL1Bank, tmp_path: Path) -> None:
    monitor = rs.Monitor(bank)
    one, other = "sensor 1", "sensor 2"
    found = run(monitor, measured({one: 10 * bank.smallest_faults[one]}))
    assert found.named[:2] == ((one,), (other,))
    leaky, own = bank.estimators[other], bank.estimators[one]
    peaks = np.nanmax(found.parts.statistics[found.alarms[0].start : found.alarms[0].stop], axis=0)
    needed = (peaks[1] - leaky.certificate.disturbances.bound) / leaky.leakage[one]
    allowed = (peaks[0] + own.certificate.disturbances.bound) / own.sensitivity.bound
    assert needed <= 10 * bank.smallest_faults[one] <= allowed
    assert (
        f"what fires '{other}' may be '{one}' alone, if that reaches {needed:.3g} or more "
        f"(its own residual allows up to {allowed:.3g} of a lasting one)"
    ) in str(found)
    monitor.save(tmp_path / "m.json")
    loaded = rs.Monitor.load(tmp_path / "m.json")
    assert run(loaded, measured({one: 10 * bank.smallest_faults[one]})).notes == found.notes
    content = json.loads((tmp_path / "m.json").read_text())
    content["checksum"] = None
    content["bounds"] = {"sensor 1": {"disturbances": 1.0, "response": 1.0, "leakage": {}}}
    (tmp_path / "bad.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="bounds must have each member once"):
        rs.Monitor.load(tmp_path / "bad.json")


def test_no_other_fault_is_suspected_where_its_own_residual_excludes_it(bank: rs.design.RobustL1Bank) -> None:
    both = {name: 3 * size for name, size in bank.smallest_faults.items()}
    assert "may be" not in str(run(rs.Monitor(bank), measured({"sensor 2": both["sensor 2"]})))
    small = run(rs.Monitor(bank), measured({}))
    assert (small.alarms, small.notes) == ((), ())
    fitted = rs.Monitor(bank, test=NormThreshold()).fit(
        None, np.vstack([measured({}, seed=k)[:START] for k in range(5)])
    )
    assert "may be" not in str(run(fitted, measured({"sensor 1": 100.0})))  # its statistics are whitened


def test_a_bank_of_one_cannot_exclude_faults_that_it_does_not_watch(bank: rs.design.RobustL1Bank) -> None:
    quick = DifferentialEvolution(population=20, generations=6, polish=False)
    alone = rs.design.robust_l1_bank(LOOP, ["sensor 2"], search=quick, method="centred", progress=False)
    found = run(rs.Monitor(alone), measured({"sensor 1": 100 * bank.smallest_faults["sensor 1"]}))
    assert found.named == (("sensor 2",),)
    assert "what fires 'sensor 2' may be 'sensor 1' alone" in str(found)
    assert "no member sees it" in str(found)


# ------------------------------------------------------------------------ other units


@pytest.mark.parametrize("spoil", [lambda y: 1000 * y, lambda y: y + 50.0], ids=["units", "operating point"])
def test_data_that_never_fit_are_doubted_as_data(spoil: Callable[[np.ndarray], np.ndarray]) -> None:
    made = dedicated_bank()
    found = run(rs.Monitor(made), spoil(recording(20.0)))
    (note,) = found.notes
    assert note.startswith("from the first judged sample on every residual is far over its threshold (")
    assert "units" in note
    assert note in str(found)
    with pytest.raises(DataError, match="in other units"):
        rs.Monitor(made).fit(None, spoil(recording(20.0)))
    whole = run(rs.Monitor(made.generator, test=PeakThreshold(0.2), isolate=None), spoil(recording(20.0)))
    assert whole.notes[0].startswith("from the first judged sample on the residual is far over its threshold (")


def test_faults_are_not_taken_for_other_units() -> None:
    made, monitor = dedicated_bank(), rs.Monitor(dedicated_bank())
    late = recording(20.0)
    late[1000:] += 50.0
    assert run(monitor, late).notes == ()
    one = recording(20.0, drifts={made.generator.faults[0]: (0.0, 50.0)})
    assert run(monitor, one).notes == (), "the other residuals are below their thresholds"
    fitted = rs.Monitor(made.generator).fit(None, recording(20.0))
    notes = run(fitted, 1000 * recording(20.0)).notes
    assert not any("from the first judged sample" in note for note in notes), "what is fitted has seen the data"
    assert all("is unlike the recordings that the monitor was fitted on" in note for note in notes if "units" in note)
    assert any("units" in note for note in notes)


def test_thresholds_of_a_linearised_set_are_told_as_such_wherever_a_diagnosis_is_read(tmp_path: Path) -> None:
    """Certified for the affine form only: said once, by a monitor that was loaded too."""

    def tank(v: Mapping[str, float]) -> rs.Plant:
        plant = rs.Plant([[-v["outflow"] / v["area"]]], [[]], [[1.0], [1.0]], outputs=["one", "other"])
        plant = plant.with_disturbances([[0.1, 0, 0]], output=[[0, 0.1, 0], [0, 0, 0.1]])
        return plant.with_sensor_faults()

    loop = rs.UncertainPlant.from_parameters(tank, {"outflow": (0.9, 1.1), "area": (0.9, 1.1)}).discretize(0.1)
    assert loop.linearisation is not None
    assert not loop.linearisation.exact
    quick = DifferentialEvolution(population=10, generations=3, polish=False)
    monitor = rs.Monitor(rs.design.robust_l1_bank(loop, search=quick, progress=False))
    monitor.save(tmp_path / "tank.json")
    for one in (monitor, rs.Monitor.load(tmp_path / "tank.json")):
        told = [note for note in run(one, np.zeros((300, 2))).notes if "affine form" in note]
        assert told == [f"certified for the affine form of the set: {loop.linearisation}"]
