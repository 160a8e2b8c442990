"""From a log file to a plant file, and in one command to a monitor; and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from cli_examples import Residua, assert_error, simulate, write_csv
from page_reader import words

#: The steady gains of the plant of the tests, from the pump to the two levels: ``C (I - A)^-1 B``.
GAINS = np.array([0.02, 0.005]) / 0.0175
#: The same model from arrays that lie otherwise in memory: the rounding of a factorisation.
ROUNDING = 1e-9
CHANNELS = ("--inputs", "pump", "--outputs", "level 1,level 2")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with fault-free recordings, and one in which a sensor fails, of two tanks."""
    folder = tmp_path_factory.mktemp("logs")
    write_csv(folder / "normal.csv", simulate(4000, 1))
    write_csv(folder / "other.csv", simulate(1500, 2))
    write_csv(folder / "healthy.csv", simulate(400, 5))
    write_csv(folder / "faulty.csv", simulate(400, 3, sensor=0.5, from_=200))
    return folder


def identified(logs: Path, path: Path, residua: Residua, *options: object) -> str:
    status, out, err = residua("identify", logs / "normal.csv", *CHANNELS, "-o", path, *options)
    assert (status, err) == (0, "")
    return out


# ------------------------------------------------------------------- identify


def test_identify_writes_a_plant_that_a_design_takes(logs: Path, tmp_path: Path, residua: Residua) -> None:
    out = identified(logs, tmp_path / "plant.toml", residua)
    assert out.startswith("model of order 2 by PBSID: 1 input, 2 outputs, 3000 rows at 1 s")
    assert "rows held out:" in out
    assert "faults: level 1 sensor, level 2 sensor and pump actuator" in out
    plant = rs.load_plant(tmp_path / "plant.toml")
    assert (plant.inputs, plant.outputs, plant.dt) == (("pump",), ("level 1", "level 2"), 1.0)
    gain = plant.C @ np.linalg.solve(np.eye(plant.n_states) - plant.A, plant.B)
    assert np.abs(gain[:, 0] - GAINS).max() < 0.05  # seven standard errors
    status, out, _ = residua("design", tmp_path / "plant.toml", "-o", tmp_path / "m.json")
    assert status == 0
    assert "method: kalman-filter" in out
    residua("fit", tmp_path / "m.json", logs / "other.csv", "-o", tmp_path / "m.json", "--false-alarm-rate", "0.001")
    assert residua("run", tmp_path / "m.json", logs / "healthy.csv")[0] == 0
    status, out, _ = residua("run", tmp_path / "m.json", logs / "faulty.csv")
    assert status == 1
    assert "level 1 sensor" in out.splitlines()[0]


def test_the_plant_file_keeps_everything_to_the_last_bit(logs: Path, tmp_path: Path, residua: Residua) -> None:
    identified(logs, tmp_path / "plant.toml", residua, "--model", "units=level 1=cm;pump=l/s", "--model", "name=tanks")
    recording = rs.read_recording(logs / "normal.csv")
    made = rs.identify.subspace(recording, inputs=["pump"], outputs=["level 1", "level 2"]).plant
    made = made.with_sensor_faults().with_actuator_faults()
    made.to_toml(tmp_path / "made.toml")
    again, plant = rs.load_plant(tmp_path / "made.toml"), rs.load_plant(tmp_path / "plant.toml")
    for key in ("A", "B", "C", "D", "Bf", "Df", "Bw", "Dw"):
        assert getattr(again, key).tobytes() == getattr(made, key).tobytes(), key
        assert np.allclose(getattr(plant, key), getattr(made, key), rtol=ROUNDING, atol=ROUNDING), key
    assert (plant.Bw @ plant.Dw.T).any()  # the noise of states and outputs goes together
    assert (again.operating_point, again.dt) == (made.operating_point, made.dt)
    assert np.allclose(plant.operating_point.outputs, made.operating_point.outputs, rtol=ROUNDING)
    assert (plant.name, plant.units["level 1"], plant.units["pump"]) == ("tanks", "cm", "l/s")


def test_the_same_plant_from_python(logs: Path, tmp_path: Path, residua: Residua) -> None:
    identified(
        logs, tmp_path / "plant.toml", residua, "--model", "order=3", "--model", "method=cva", "--model", "held_out=0.5"
    )
    recording = rs.read_recording(logs / "normal.csv")
    model = rs.identify.subspace(recording, inputs=["pump"], order=3, method="cva", held_out=0.5)
    assert np.allclose(rs.load_plant(tmp_path / "plant.toml").A, model.plant.A, rtol=ROUNDING, atol=ROUNDING)


def test_outputs_are_all_other_columns(logs: Path, tmp_path: Path, residua: Residua) -> None:
    assert residua("identify", logs / "normal.csv", "--inputs", "pump", "-o", tmp_path / "p.toml")[0] == 0
    assert rs.load_plant(tmp_path / "p.toml").outputs == ("level 1", "level 2")
    status, out, _ = residua(
        "identify", logs / "normal.csv", "--outputs", "level 2, level 1", "-o", tmp_path / "p.toml"
    )
    plant = rs.load_plant(tmp_path / "p.toml")
    assert (status, plant.inputs, plant.outputs) == (0, (), ("level 2", "level 1"))
    assert "faults: level 2 sensor and level 1 sensor" in out


@pytest.mark.parametrize(
    ("option", "faults"),
    [
        ("--no-faults", ()),
        ("--no-sensor-faults", ("pump actuator",)),
        ("--no-actuator-faults", ("level 1 sensor", "level 2 sensor")),
    ],
)
def test_which_faults_the_plant_gets(
    logs: Path, tmp_path: Path, residua: Residua, option: str, faults: tuple[str, ...]
) -> None:
    out = identified(logs, tmp_path / "plant.toml", residua, option)
    assert rs.load_plant(tmp_path / "plant.toml").faults == faults
    assert ("no faults in the plant" in out) == (not faults)


def test_an_input_without_effect_gets_no_fault(tmp_path: Path, residua: Residua) -> None:
    noise = np.random.default_rng(0).standard_normal((800, 2))
    path = write_csv(tmp_path / "white.csv", np.column_stack([np.arange(800), noise]), "time,a,b")
    for command in ("identify", "learn"):
        status, out, _ = residua(command, path, "--inputs", "a", "-o", tmp_path / "out")
        assert status == 0
        assert "model of order 0" in out
        assert "faults: b sensor; none of a, which has no effect in the model" in out


def test_a_known_delay_and_several_recordings(logs: Path, tmp_path: Path, residua: Residua) -> None:
    files = (logs / "normal.csv", logs / "other.csv")
    status, out, _ = residua(
        "identify", *files, *CHANNELS, "--model", "delays=pump=1", "-o", tmp_path / "p.toml", "--model", "order=2"
    )
    assert status == 0
    assert "4123 rows" in out  # three quarters of both, without the row that the delay takes from each
    assert rs.load_plant(tmp_path / "p.toml").n_states == 3


def test_columns_of_other_names_and_no_times(logs: Path, tmp_path: Path, residua: Residua) -> None:
    rows = simulate(2000, 1)[:, 1:]
    path = write_csv(tmp_path / "bare.csv", rows, "Pumpe,Stand 1,Stand 2")
    names = ("--read", "columns=pump=Pumpe;level 1=Stand 1;level 2=Stand 2", "-o", tmp_path / "p.toml")
    assert_error(residua("identify", path, *CHANNELS, *names), "give --read dt= in seconds")
    assert residua("identify", path, *CHANNELS, *names, "--read", "dt=60")[0] == 0
    plant = rs.load_plant(tmp_path / "p.toml")
    assert (plant.dt, plant.outputs) == (60.0, ("level 1", "level 2"))


def test_the_report_page(logs: Path, tmp_path: Path, residua: Residua) -> None:
    out = identified(
        logs, tmp_path / "p.toml", residua, "--report", tmp_path / "fit.html", "--model", "units=level 1=cm"
    )
    assert f"written: {tmp_path / 'fit.html'}" in out
    page = words((tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert "A model of order 2 predicts 2 outputs one step ahead" in page
    for heading in ("How good it is", "Measured and predicted", "Prediction errors in time", "Why this order"):
        assert heading in page


def test_the_report_page_asks_for_options_as_the_command_has_them(tmp_path: Path, residua: Residua) -> None:
    rng = np.random.default_rng(0)
    plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], [[1.0]], dt=1.0)
    u = rng.standard_normal((1500, 1))
    y = plant.system("control").simulate(u) + 0.1 * rng.standard_normal((1500, 1))
    rows = "\n".join(f"{k},{a},{b}" for k, (a, b) in enumerate(np.hstack([u, y]).tolist()))
    (tmp_path / "log.csv").write_text(f"time,pump,level\n{rows}\n", encoding="utf-8")
    options = ("--inputs", "pump", "--outputs", "level", "-o", tmp_path / "p.toml", "--report", tmp_path / "fit.html")
    assert residua("identify", tmp_path / "log.csv", *options)[0] == 0
    page = words((tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert "move together: --model feedthrough if the plant answers within a row" in page
    assert "feedthrough=True" not in page


# ---------------------------------------------------------------------- learn


def test_learn_makes_a_monitor_that_names_the_sensor(logs: Path, tmp_path: Path, residua: Residua) -> None:
    learn = ("learn", logs / "normal.csv", *CHANNELS, "-o", tmp_path / "m.json", "--false-alarm-rate", "0.001")
    status, out, err = residua(*learn)
    assert (status, err) == (0, "")
    assert "2000 rows at 1 s" in out  # the model is from the first half
    assert re.search(
        r"relations, \w+: .* of the rows held out in alarm, \d+ % of them with a fault put in  <- chosen", out
    )
    assert re.search(r"level 1 sensor +\S+ \(\S+ deviations\) +\S+ \(\S+ deviations\) +yes", out)
    alarmed, judged = re.findall(r"false alarms: 1 in 1,000 samples .*?(\d+) of (\d+) held-out samples in alarm", out)[
        0
    ]
    assert int(alarmed) <= 0.001 * int(judged)
    assert int(judged) > 950
    assert residua("run", tmp_path / "m.json", logs / "healthy.csv", "-q")[0] == 0
    status, out, _ = residua("run", tmp_path / "m.json", logs / "faulty.csv")
    assert status == 1
    assert "level 1 sensor" in out.splitlines()[0]


def test_learn_says_where_rows_are_few_and_every_run_repeats_it(logs: Path, tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "short.csv", simulate(400, 4))
    status, _, err = residua("learn", path, *CHANNELS, "-o", tmp_path / "m.json")
    assert status == 0
    assert "400 complete rows are few: 600 at least" in err
    _, out, _ = residua("run", tmp_path / "m.json", logs / "healthy.csv")
    assert out.startswith("400 complete rows are few")


def test_learn_warns_where_the_plant_changes_later(tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "changed.csv", simulate(2000, 4, sensor=0.5, from_=1600))
    learn = ("learn", path, *CHANNELS, "-o", tmp_path / "m.json")
    assert_error(residua(*learn), "a fault-free log: its last quarter is 6", "leave the faulty rows out", "--force")
    status, out, err = residua(*learn, "--force")
    assert status == 0  # 1 is an alarm of run
    assert re.search(r"(39|40)\d of 4[89]\d held-out samples in alarm", out)
    assert err.startswith("warning: the fit: the log does not cover normal operation: its last quarter is 6")
    assert "too many for 1 in " in err


def test_learn_guesses_inputs_and_says_so(logs: Path, tmp_path: Path, residua: Residua) -> None:
    status, out, _ = residua("learn", logs / "normal.csv", logs / "other.csv", "-o", tmp_path / "m.json")
    assert status == 0
    assert "inputs: pump (guessed: they keep their values; name them to be sure)" in out
    plant = rs.Monitor.load(tmp_path / "m.json").design.plant
    assert (plant.inputs, plant.outputs) == (("pump",), ("level 1", "level 2"))
    status, out, _ = residua("learn", logs / "normal.csv", "--inputs", "none", "-o", tmp_path / "m.json")
    assert status == 0
    assert "inputs: none" in out
    assert rs.Monitor.load(tmp_path / "m.json").design.plant.outputs == ("pump", "level 1", "level 2")


def test_learn_asks_for_inputs_that_a_controller_moves(tmp_path: Path, residua: Residua) -> None:
    rows = simulate(1000, 4)
    rows[1:, 1] = 3 - 0.5 * rows[1:, 2] + 0.2 * rows[:-1, 2]
    path = write_csv(tmp_path / "closed.csv", rows)
    told = "'pump' and 'level 1' follow from one another exactly", "name the columns that drive the plant, --inputs"
    assert_error(residua("learn", path, "-o", tmp_path / "m.json"), *told)


def test_learn_refuses_a_monitor_that_sees_nothing(tmp_path: Path, residua: Residua) -> None:
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.standard_normal((1500, 1)), axis=0)
    path = write_csv(tmp_path / "walk.csv", np.hstack([np.arange(1500.0)[:, None], walk]), "time,level")
    status, out, err = residua("learn", path, "-o", tmp_path / "m.json")
    assert (status, out) == (2, "")
    assert "detects no lasting fault" in err
    assert "--force" in err
    assert not (tmp_path / "m.json").exists()
    assert residua("learn", path, "-o", tmp_path / "m.json", "--force")[0] == 0
    quiet = write_csv(tmp_path / "quiet.csv", np.hstack([np.arange(900.0)[:, None], walk[:900]]), "time,level")
    status, out, _ = residua("run", tmp_path / "m.json", quiet)
    assert status == 0
    assert "Cannot tell: this monitor detects no lasting fault" in out
    assert residua("run", tmp_path / "m.json", quiet, "--strict")[0] == 4


# ------------------------------------------------------------------ bad input


@pytest.mark.parametrize("command", ["identify", "learn"])
def test_bad_channels_and_data_are_one_line_on_stderr(
    command: str, logs: Path, tmp_path: Path, residua: Residua
) -> None:
    def call(path: Path, *options: object) -> tuple[int, str, str]:
        return residua(command, path, "-o", tmp_path / "out", *options)

    normal = logs / "normal.csv"
    assert_error(
        call(normal, "--inputs", "valve"),
        "missing column 'valve'; there are: 'pump', 'level 1', 'level 2'; give --inputs the names of columns",
    )
    assert_error(call(normal, "--inputs", "pump", "--outputs", "level"), "missing column 'level'")
    both = ("--inputs", "pump,level 1", "--outputs", "level 1,level 2")
    assert_error(call(normal, *both), "level 1 cannot be an input and an output")
    assert_error(call(normal, "--inputs", "pump,level 1,level 2"), "every column is an input")
    assert_error(call(normal, *CHANNELS, "--model", "delays=level 1=2"), "'level 1' is no input")
    assert_error(call(normal, *CHANNELS, "--model", "units=level 3=cm"), "--model units=: no channel level 3")
    assert_error(
        call(normal, *CHANNELS, "--model", "order=900"), "a model of order 900", "the data are enough for order"
    )
    rows = simulate(600, 6)
    named = ("--inputs", "pump")
    flat = write_csv(
        tmp_path / "flat.csv", np.column_stack([rows, np.full(600, 3.0)]), "time,pump,level 1,level 2,flat"
    )
    assert_error(call(flat, *named, "--outputs", "level 1,flat"), "flat never moves", "leave it out")
    twice = write_csv(
        tmp_path / "twice.csv", np.column_stack([rows, 2 * rows[:, 2]]), "time,pump,level 1,level 2,again"
    )
    assert_error(call(twice, *named), "'level 1' and 'again' are the same signal, times a number")
    assert_error(call(write_csv(tmp_path / "short.csv", rows[:12]), *CHANNELS), "too few data", "a longer recording")
    rows[:, 3] = np.nan
    assert_error(call(write_csv(tmp_path / "nan.csv", rows), *CHANNELS), "'level 2' is missing in")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["identify", "learn"])
def test_bad_files_and_options(command: str, logs: Path, tmp_path: Path, residua: Residua) -> None:
    normal, out = logs / "normal.csv", ("-o", tmp_path / "out")
    assert_error(residua(command, tmp_path / "absent.csv", *out), "absent.csv: recording not found")
    assert_error(residua(command, normal, normal, *out), "is given twice")
    assert_error(residua(command, normal, "-o", normal), "is read by this command")
    for option in (
        ("--model", "delays=pump"),
        ("--inputs", "pump,"),
        ("--inputs", "a,a"),
        ("--model", "method=arx"),
        ("--model", "units=cm"),
    ):
        status, text, err = residua(command, normal, *CHANNELS, *out, *option)
        assert (status, text) == (2, "")
        assert "Usage:" in err
    assert not (tmp_path / "out").exists()


def test_held_out_is_a_fraction(logs: Path, tmp_path: Path, residua: Residua) -> None:
    assert residua("identify", logs / "normal.csv", "-o", tmp_path / "out", "--model", "held_out=1")[0] == 2
    out = identified(logs, tmp_path / "p.toml", residua, "--model", "held_out=0", "--report", tmp_path / "fit.html")
    assert "on the 39" in out  # all rows but those of the past
