"""What a plant carries of its identification: into files, into monitors, and to whoever asks what to design."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from recorded_plants import generated_plant, recorded
from residua.errors import FileFormatError, ModelError
from residua.plant import Identification, dumps_plant, loads_plant

NOTE = Identification("PBSID", 4000, ("y1",), ("u1",), (("y1", "u1"),))


def plant_with(note: Identification | None) -> rs.Plant:
    return rs.Plant([[0.9]], [[1.0]], [[1.0]], dt=1.0, identification=note).with_noise(process=0.1, measurement=0.1)


def of_too_low_an_order(seed: int = 0) -> tuple[rs.Plant, rs.identify.IdentifiedModel, np.ndarray, np.ndarray]:
    """Return a plant of order 4, a model of order 2 of it, and what that is from."""
    rng = np.random.default_rng(seed)
    truth = generated_plant(rng, 4, 1, 2, least=0.1)
    u, y = recorded(truth, rng, 4000, 20)
    return truth, rs.identify.subspace(u, y, order=2, max_order=6, dt=1.0), u, y


def test_a_given_plant_has_none_and_an_identified_one_keeps_it() -> None:
    model = of_too_low_an_order()[1]
    note = model.plant.identification
    assert (note.method, note.rows) == ("PBSID", model.report.samples)
    assert note.coloured == model.report.coloured == ("y1", "y2")
    assert model.plant.with_sensor_faults().with_noise(process=1.0, measurement=1.0).identification == note
    assert plant_with(None).identification is None


@pytest.mark.parametrize("note", [None, Identification("PBSID", 4000), NOTE])
def test_files_keep_it(note: Identification | None, tmp_path: Path) -> None:
    plant = plant_with(note).with_sensor_faults()
    assert loads_plant(dumps_plant(plant)).identification == note
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    monitor.save(tmp_path / "monitor.json")
    assert rs.Monitor.load(tmp_path / "monitor.json").generator.plant.identification == note
    text = (tmp_path / "monitor.json").read_text(encoding="utf-8")
    assert ('"identification": null' in text) == (note is None)


def test_a_file_that_says_it_wrongly_is_refused_by_its_entry() -> None:
    text = dumps_plant(plant_with(NOTE))
    for old, new, says in (
        ("rows = 4000", "rows = 0.5", "rows: must be a whole number"),
        ('coloured = ["y1"]', 'coloured = ["y7"]', "unknown identification: coloured output 'y7'"),
        ('coloured = ["y1"]', "coloured = [1]", "expected a list of texts"),
        ('[["y1", "u1"]]', '[["y1"]]', "expected pairs of texts"),
        ('[["y1", "u1"]]', '[["y1", 2]]', "expected pairs of texts"),
        ('[["y1", "u1"]]', '[["u1", "y1"]]', "unknown identification: uncertain gain of output 'u1'"),
        ('weak_inputs = ["u1"]', 'weak_inputs = ["y1"]', "unknown identification: weak input 'y1'"),
    ):
        assert old in text
        with pytest.raises(FileFormatError, match=says):
            loads_plant(text.replace(old, new))


def test_another_object_is_refused() -> None:
    with pytest.raises(ModelError, match="identification must be an Identification"):
        plant_with("PBSID")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"rows": 0}, "rows must be a whole number of at least one"),
        ({"rows": 1.5}, "rows must be a whole number"),
        ({"method": None}, "method must be a text"),
        ({"coloured": "y1"}, "coloured must hold names"),
        ({"coloured": (0,)}, "coloured must hold names"),
        ({"uncertain_gains": (("y1",),)}, "must be pairs"),
    ],
)
def test_what_no_file_would_bring_back_is_refused(wrong: dict[str, object], says: str) -> None:
    with pytest.raises(ModelError, match=says):
        plant_with(replace(NOTE, **wrong))  # pyright: ignore[reportArgumentType]


def test_lists_of_names_come_back_from_files_as_they_went() -> None:
    lists = Identification("PBSID", np.int64(40), ["y1"], ["u1"], [["y1", "u1"]])  # pyright: ignore[reportArgumentType]
    plant = plant_with(lists)
    assert loads_plant(dumps_plant(plant)).identification == plant.identification
    assert plant.identification == replace(NOTE, rows=40)


def test_suggest_tells_a_given_plant_from_an_identified_one() -> None:
    given = rs.suggest(plant_with(None).with_actuator_faults(), seconds=0).notes
    white = rs.suggest(plant_with(Identification("PBSID", 4000)).with_actuator_faults(), seconds=0).notes
    doubtful = rs.suggest(plant_with(NOTE).with_actuator_faults().with_sensor_faults(), seconds=0).notes
    assert not any("identified" in note for note in given)
    assert any("identified by PBSID from 4000 rows" in note for note in white)
    assert not any("multi_model_parity" in note or "hardly say" in note for note in white)
    assert any("errors of y1 are correlated" in note and "multi_model_parity" in note for note in doubtful)
    assert any("how u1 actuator would act" in note for note in doubtful)
    assert not any("y1 sensor would act" in note for note in doubtful)


def test_what_is_advised_for_coloured_errors_runs_and_lets_less_of_them_through() -> None:
    """With an input of another spectrum the errors of a plant of too low an order are alarms; the advice helps."""
    shares = np.array([shares_in_alarm(seed) for seed in range(3)])
    kalman, advised = shares.mean(axis=0)
    assert advised < 0.95 * kalman


def shares_in_alarm(seed: int) -> tuple[float, float]:
    """Return the share of fault-free samples in alarm, of a Kalman filter and of what is advised."""
    truth, model, u, y = of_too_low_an_order(seed)
    plant = model.plant.with_sensor_faults()
    [advice] = [note for note in rs.suggest(plant, seconds=0).notes if "multi_model_parity" in note]
    first, _, second = advice.partition("uncertain = ")[2].partition("; ")
    uncertain = eval(first, {"model": model, "plant": plant})
    insensitive = eval(second, {"rs": rs, "plant": plant, "uncertain": uncertain})
    slow = np.cumsum(np.random.default_rng(50 + seed).standard_normal((4000, 1)), axis=0) / 10
    answer = truth.system("control").simulate(slow)
    answer += y.std(axis=0) / 20 * np.random.default_rng(60 + seed).standard_normal(answer.shape)
    shares = []
    for design in (rs.design.kalman_filter(plant), insensitive):
        monitor = rs.Monitor(design, test=rs.decide.NormThreshold(window=10)).fit(u, y, false_alarm_rate=0.01)
        diagnosis = monitor.run(slow, answer)
        shares.append(float(np.mean(diagnosis.alarm)))
    return shares[0], shares[1]
