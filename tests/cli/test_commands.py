"""The whole way through files, and what each command prints and writes."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from cli_examples import DISTURBED, PLANT, Residua, assert_error, simulate, write_csv
from residua.cli.guard import in_cli_words
from residua.cli.option_types import parse_poles
from residua.design.core.evidence import format_pole
from residua.design.core.generator import for_monitor

# ------------------------------------------------------------------ the whole way


def test_run_names_the_faulty_sensor(made: Path, residua: Residua) -> None:
    status, out, err = residua("run", made / "monitor.json", made / "faulty.csv")
    assert (status, err) == (1, "")
    assert "Fault found: level 1 sensor" in out
    assert "end of recording" in out
    assert "Q" not in out.splitlines()[0]


def test_a_short_alarm_is_named_with_caution(made: Path, tmp_path: Path, residua: Residua) -> None:
    rows = simulate(400, 3, sensor=0.5, from_=200)
    rows[215:, 2] -= 0.5
    fit = ("fit", made / "design.json", made / "normal.csv", "-o", tmp_path / "m.json", "--false-alarm-rate", "1e-4")
    residua(*fit)
    status, out, _ = residua("run", tmp_path / "m.json", write_csv(tmp_path / "blip.csv", rows))
    assert status == 1
    assert "Fault found" not in out
    assert "too early to be sure of the name; so far level 1 sensor." in out.splitlines()[0]
    assert "too early" in out.splitlines()[2]
    assert "too early" not in residua("run", made / "monitor.json", made / "faulty.csv")[1]


def test_run_without_a_fault(made: Path, residua: Residua) -> None:
    status, out, err = residua("run", made / "monitor.json", made / "healthy.csv")
    assert (status, err) == (0, "")
    assert out.startswith("No fault found.")


def test_run_says_what_cannot_be_told_apart(made: Path, residua: Residua) -> None:
    _, out, _ = residua("run", made / "monitor.json", made / "faulty.csv")
    assert "pump actuator or leak" in out
    assert "pump actuator and leak" in out


def test_quiet_prints_nothing(made: Path, residua: Residua) -> None:
    assert residua("run", made / "monitor.json", made / "faulty.csv", "--quiet") == (1, "", "")
    assert residua("run", made / "monitor.json", made / "healthy.csv", "-q") == (0, "", "")


def test_run_and_its_file_count_the_same_samples(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = tmp_path / "alarms.jsonl"
    _, out, _ = residua("run", made / "monitor.json", made / "faulty.csv", "--alarms", path)
    first = json.loads(path.read_text().splitlines()[0])
    lines = out.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("alarm "))
    start = lines[at].index("samples")
    assert int(lines[at + 1][start:].split()[0]) == first["samples"]


def test_options_of_banks(made: Path, tmp_path: Path, residua: Residua) -> None:
    design = ("design", made / "plant.toml", "-o", tmp_path / "m.json", "--method")
    status, out, _ = residua(*design, "sensor-fault-bank", "--scheme", "dedicated", "--observer", "minimal")
    assert status == 0
    assert "only level 1" in out
    assert_error(
        residua(*design, "kalman-filter", "--scheme", "dedicated"),
        "--scheme is for --method actuator-fault-bank and sensor-fault-bank, not for kalman-filter",
    )
    plant = rs.Plant(np.diag([0.9, 0.8, 0.7]) + 0.1, np.ones((3, 1)), np.eye(3), dt=1.0).with_sensor_faults()
    plant.with_disturbances({"inflow": {"x1": 1.0}}).to_toml(tmp_path / "three.toml")
    disturbed = ("design", tmp_path / "three.toml", "-o", tmp_path / "m.json", "--method", "sensor-fault-bank")
    status, out, err = residua(*disturbed)
    assert status == 2
    assert "1 of 3 members of the bank do not exist: 'without y1'" in err
    assert "--allow-missing builds the bank without them" in err
    status, out, _ = residua(*disturbed, "--allow-missing")
    assert status == 0
    assert "without y2" in out
    assert "without y1" not in re.sub("(?m)^  note: no member 'without y1': .*$", "", out)
    assert "no member 'without y1': rank(CE)=0 < rank(E)=1" in out


def test_advice_is_for_the_command_line() -> None:
    assert in_cli_words("x; observer='minimal' does: try it") == "x; --observer minimal does: try it"
    told = in_cli_words("design on the sampled plant, plant.discretize(dt), to avoid it")
    assert told == "design on the sampled plant, by sample_time in the plant file, to avoid it"
    faults = "add some with with_sensor_faults, with_actuator_faults or with_faults; then"
    assert in_cli_words(faults) == "add some with [[faults]] in the plant file; then"
    assert in_cli_words("with_sensor_faults, with_faults") == "[[faults]] in the plant file"
    noise = "needs the noise of the plant: with_noise(process=..., measurement=...)"
    assert (
        in_cli_words(noise) == "needs the noise of the plant: [noise] in the plant file, with process and measurement"
    )
    assert in_cli_words("give it with plant.with_noise(...)").endswith(
        "[noise] in the plant file, with process and measurement"
    )
    assert in_cli_words("give poles=[...] or margin=, or dt=") == "give --poles or --margin, or --dt"
    assert in_cli_words("constant=True chooses") == "--constant chooses"


def test_advice_of_real_errors_is_for_the_command_line(made: Path, tmp_path: Path, residua: Residua) -> None:
    text = (made / "plant.toml").read_text()
    (tmp_path / "quiet.toml").write_text(re.sub(r"\[noise\][^\[]*", "", text))
    (tmp_path / "bare.toml").write_text(text[: text.index("[[faults]]")])
    out = ("-o", tmp_path / "out.json")
    assert residua("design", tmp_path / "quiet.toml", *out)[0] == 0
    for command in (
        ("run", tmp_path / "out.json", made / "faulty.csv"),
        ("design", tmp_path / "quiet.toml", *out, "--method", "kalman-filter"),
        ("design", tmp_path / "quiet.toml", *out, "--method", "matched-filters"),
        ("design", tmp_path / "bare.toml", *out, "--method", "structured-bank"),
        ("codes", tmp_path / "bare.toml"),
        ("analyze", tmp_path / "bare.toml"),
    ):
        status, _, err = residua(*command)
        assert status == 2
        assert not re.search(r"with_|fit\(|NormThreshold|=\.\.\.", err), err
        assert re.search(r"residua fit|\[noise\] in the plant file|\[\[faults\]\] in the plant file", err), err


def test_suggest_says_what_to_call(made: Path, residua: Residua) -> None:
    status, out, _ = residua("suggest", made / "plant.toml", "--want", "state")
    assert status == 0
    assert "two tanks: what to call for the state" in out
    assert_error(residua("suggest", made / "plant.toml", "--want", "luck"), "want must be one of")


def test_alarms_as_json_lines(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = tmp_path / "alarms.jsonl"
    residua("run", made / "monitor.json", made / "faulty.csv", "--alarms", path)
    alarms = [json.loads(line) for line in path.read_text().splitlines()]
    (alarm,) = [a for a in alarms if a["ended"] is None]
    assert 195 <= alarm["onset"] <= 205 <= alarm["raised"] <= 215
    assert alarm["candidates"][0]["faults"] == ["level 1 sensor"]
    assert alarm["candidates"][0]["score"] > alarm["candidates"][1]["score"]
    residua("run", made / "monitor.json", made / "healthy.csv", "--alarms", path)
    assert path.read_text() == ""


def test_residuals_as_csv_and_parquet(made: Path, tmp_path: Path, residua: Residua) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    for name in ("r.csv", "r.parquet"):
        residua("run", made / "monitor.json", made / "faulty.csv", "-q", "--residuals", tmp_path / name)
    rows = list(csv.DictReader((tmp_path / "r.csv").read_text().splitlines()))
    table = parquet.read_table(tmp_path / "r.parquet")
    assert len(rows) == table.num_rows == 400
    assert list(rows[0]) == table.column_names
    assert {"time", "r level 1", "r level 2", "statistic", "alarm"} < set(table.column_names)
    assert [float(row["r level 1"]) for row in rows] == table["r level 1"].to_pylist()
    assert rows[-1]["alarm"] == "1"


def test_report_page_and_no_leftovers(made: Path, tmp_path: Path, residua: Residua) -> None:
    status, out, _ = residua("run", made / "monitor.json", made / "faulty.csv", "--report", tmp_path / "page.html")
    assert status == 1
    assert f"written: {tmp_path / 'page.html'}" in out
    page = (tmp_path / "page.html").read_text()
    assert page.startswith("<!DOCTYPE html>")
    assert "level 1 sensor" in page
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.parametrize("ending", ["parquet", "npz", "mat"])
def test_other_formats_give_the_same(made: Path, tmp_path: Path, ending: str, residua: Residua) -> None:
    rows = np.loadtxt(made / "faulty.csv", delimiter=",", skiprows=1)
    path = tmp_path / f"faulty.{ending}"
    more: list[str] = []
    if ending == "parquet":
        pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        names = ["time", "pump", "level 1", "level 2"]
        parquet.write_table(pyarrow.table(dict(zip(names, rows.T, strict=True))), path)
    elif ending == "npz":
        np.savez(path, time=rows[:, 0], u=rows[:, 1:2], y=rows[:, 2:])
    else:
        import scipy.io

        scipy.io.savemat(path, {"fault08": rows[:, 1:], "other": np.ones((3, 3))})
        more = ["--read", "variable=fault08"]
    _, expected, _ = residua("run", made / "monitor.json", made / "faulty.csv")
    assert residua("run", made / "monitor.json", path, *more) == (1, expected, "")


def test_missing_values_are_counted(made: Path, tmp_path: Path, residua: Residua) -> None:
    lines = (made / "faulty.csv").read_text().splitlines()
    for k in (50, 51, 300):
        lines[k] = ",".join([*lines[k].split(",")[:3], ""])
    (tmp_path / "gaps.csv").write_text("\n".join(lines) + "\n")
    status, out, _ = residua("run", made / "monitor.json", tmp_path / "gaps.csv")
    assert status == 1
    assert "3 samples with missing values" in out


def test_time_column_by_name(made: Path, tmp_path: Path, residua: Residua) -> None:
    rows = np.loadtxt(made / "faulty.csv", delimiter=",", skiprows=1)
    path = write_csv(tmp_path / "named.csv", rows, "clock,pump,level 1,level 2")
    assert residua("run", made / "monitor.json", path, "--read", "time=clock", "-q")[0] == 1
    assert_error(residua("run", made / "monitor.json", path, "--read", "time=watch"), "'watch'", "clock")


def test_too_short_a_recording_is_no_verdict(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "short.csv", simulate(3, 5))
    status, _, err = residua("run", made / "monitor.json", path)
    assert status == 2
    assert "no sample could be judged" in err
    assert "settling takes" in err


def test_a_channel_without_a_value_is_blamed_not_the_settling(made: Path, tmp_path: Path, residua: Residua) -> None:
    lines = (made / "faulty.csv").read_text().splitlines()
    lines[1:] = [",".join([*line.split(",")[:3], ""]) for line in lines[1:]]
    (tmp_path / "without.csv").write_text("\n".join(lines) + "\n")
    status, _, err = residua("run", made / "monitor.json", tmp_path / "without.csv")
    assert status == 2
    assert "level 2 has no value in the whole recording" in err
    assert "settl" not in err


# ------------------------------------------------------------------------ analyze


def test_analyze_prints_groups_and_reasons(made: Path, residua: Residua) -> None:
    status, out, err = residua("analyze", made / "disturbed.toml")
    assert (status, err) == (0, "")
    assert "leak: same effect on the outputs as level 1 sensor, pump actuator, up to a filter" in out
    assert "unknown input observer exists" in out


def test_analyze_json(made: Path, residua: Residua) -> None:
    status, out, _ = residua("analyze", made / "plant.toml", "--json")
    found = json.loads(out)
    assert status == 0
    assert [fault["name"] for fault in found["faults"]] == ["level 1 sensor", "pump actuator", "leak"]
    assert found["faults"][2]["not_isolable_from"] == ["pump actuator"]
    assert found["groups"] == [["level 1 sensor"], ["pump actuator", "leak"]]
    assert found["unknown_input_observer"]["exists"] is True


# ------------------------------------------------------------------------- design


def design(made: Path, tmp_path: Path, residua: Residua, plant: str, *options: str) -> tuple[int, str, str]:
    return residua("design", made / plant, "-o", tmp_path / "out.json", *options)


def test_design_auto_says_what_and_why(made: Path, tmp_path: Path, residua: Residua) -> None:
    _, out, _ = design(made, tmp_path, residua, "plant.toml")
    assert "method: kalman-filter, because it sees lasting faults from these sizes on (in brackets: dev" in " ".join(
        out.split()
    )
    _, out, _ = design(made, tmp_path, residua, "disturbed.toml")
    assert "method: decoupled-residual, because it sees lasting faults from" in out
    bare = PLANT.replace("[noise]\nprocess = 1e-4\nmeasurement = 1e-3\n", "")
    (tmp_path / "bare.toml").write_text(bare)
    _, out, _ = residua("design", tmp_path / "bare.toml", "-o", tmp_path / "out.json")
    assert "method: kalman-filter, because" in out
    assert "the plant has no noise, so some is assumed" in out
    assert "no threshold yet: residua fit" in out


def test_design_auto_is_what_suggest_puts_first(made: Path, tmp_path: Path, residua: Residua) -> None:
    (tmp_path / "bare.toml").write_text(PLANT.replace("[noise]\nprocess = 1e-4\nmeasurement = 1e-3\n", ""))
    for path in (made / "plant.toml", made / "disturbed.toml", tmp_path / "bare.toml"):
        assert residua("design", path, "-o", tmp_path / "out.json")[0] == 0
        best = rs.suggest(rs.Plant.from_toml(path)).best
        assert best is not None
        assert f"call: {best.call}" in " ".join(residua("design", path, "--show-call")[1].split())
        saved = rs.Monitor.load(tmp_path / "out.json").design.system
        assert all((getattr(saved, k) == getattr(for_monitor(best.made).system, k)).all() for k in "ABCD")


def test_design_auto_samples_a_continuous_plant_first(tmp_path: Path, residua: Residua) -> None:
    continuous = PLANT.replace("dt = 1.0", "").replace("[[0.9, 0.05], [0.05, 0.8]]", "[[-1.0, 0.1], [0.1, -2.0]]")
    (tmp_path / "c.toml").write_text(continuous)
    status, out, _ = residua("design", tmp_path / "c.toml", "--dt", "0.1", "--show-call")
    assert status == 0
    assert "(plant.discretize(0.1))" in out


@pytest.mark.parametrize(
    "method",
    [
        "detection-filter",
        "unknown-input-observer",
        "kalman-filter",
        "luenberger-observer",
        "sensor-fault-bank",
        "actuator-fault-bank",
    ],
)
def test_design_by_each_method(made: Path, tmp_path: Path, method: str, residua: Residua) -> None:
    status, out, _ = design(made, tmp_path, residua, "plant.toml", "--method", method)
    assert status == 0
    assert f"method: {method}\n" in out
    assert "poles:" in out
    assert json.loads((tmp_path / "out.json").read_text())


TWO_SENSORS = PLANT.split("[[faults]]")[0] + "".join(
    f'[[faults]]\nkind = "sensor"\noutput = "level {k}"\n' for k in (1, 2)
)


def test_a_bank_names_by_code(made: Path, tmp_path: Path, residua: Residua) -> None:
    (tmp_path / "two.toml").write_text(TWO_SENSORS)
    options = ("--method", "sensor-fault-bank", "--persistence", "10", "--false-alarm-rate", "0.01")
    status, out, _ = residua("design", tmp_path / "two.toml", "-o", tmp_path / "bank.json", *options)
    assert status == 0
    assert re.search(r"^fault +without level 1 +without level 2 +cannot be told from$", out, flags=re.MULTILINE)
    assert re.search(r"^level 1 sensor +\. +x +-$", out, flags=re.MULTILINE)
    assert "thresholds: without level 1 " in out
    assert "1/2 of the rate of the whole bank" in out
    status, out, _ = residua("fit", tmp_path / "bank.json", made / "normal.csv", "-o", tmp_path / "bank.json")
    assert status == 0
    assert re.search(r"thresholds: without level 1 [\d.]+, without level 2 [\d.]+", out)
    files = ("--alarms", tmp_path / "a.jsonl", "--report", tmp_path / "r.html", "--residuals", tmp_path / "r.csv")
    status, out, _ = residua("run", tmp_path / "bank.json", made / "faulty.csv", *files)
    assert status == 1
    assert "Fault found: level 1 sensor, a good match by its code, alarm raised at " in out
    assert "Fired: without level 2; code of 'level 1 sensor' (exact)." in out
    line = json.loads((tmp_path / "a.jsonl").read_text().splitlines()[-1])
    assert line["code"]["fired"] == ["without level 2"]
    header = (tmp_path / "r.csv").read_text().splitlines()[0]
    assert "statistic without level 1,fired without level 1," in header
    assert "Codes" in (tmp_path / "r.html").read_text()


def test_two_faults_are_both_named(made: Path, tmp_path: Path, residua: Residua) -> None:
    (tmp_path / "two.toml").write_text(TWO_SENSORS)
    residua("design", tmp_path / "two.toml", "-o", tmp_path / "bank.json", "--method", "sensor-fault-bank")
    rows = simulate(400, 3, sensor=3.0, from_=200)
    rows[200:, -1] += 2.0
    both = write_csv(tmp_path / "both.csv", rows)
    status, out, _ = residua("run", tmp_path / "bank.json", both)
    assert status == 1
    assert "Fault found: either 2 at once, " in out
    assert "level 2 sensor (fired from " in out
    assert "level 1 sensor (fired from " in out
    assert "several, or not known" not in out


def test_an_estimator_tells_the_size(made: Path, tmp_path: Path, residua: Residua) -> None:
    options = ("--method", "fault-estimator", "--faults", "level 1 sensor", "--window", "20")
    status, _, _ = design(made, tmp_path, residua, "plant.toml", *options)
    assert status == 0
    status, out, _ = residua("run", tmp_path / "out.json", made / "faulty.csv", "--alarms", tmp_path / "a.jsonl")
    assert status == 1
    found = re.search(r"Estimated size of level 1 sensor: ([\d.]+) ", out)
    assert found is not None
    assert float(found[1]) == pytest.approx(0.5, abs=0.1)
    assert "estimated size" in out
    line = json.loads((tmp_path / "a.jsonl").read_text().splitlines()[-1])
    assert line["sizes"][0]["mean"] == pytest.approx(float(found[1]), abs=0.01)
    wrong = design(made, tmp_path, residua, "plant.toml", "--method", "sensor-fault-bank", "--faults", "leak")
    assert_error(wrong, "fault-estimator, not for sensor-fault-bank")
    assert_error(design(made, tmp_path, residua, "plant.toml", *options[:3], "nothing"), "nothing")


def test_design_reaches_the_poles_it_was_given(made: Path, tmp_path: Path, residua: Residua) -> None:
    options = ("--method", "detection-filter", "--poles", "0.3, 0.3")
    _, out, _ = design(made, tmp_path, residua, "plant.toml", *options)
    assert "poles: 0.3, 0.3" in out
    options = ("--method", "unknown-input-observer", "--poles", "0.3+0.2j,0.3-0.2j")
    _, out, _ = design(made, tmp_path, residua, "plant.toml", *options)
    assert "0.3+0.2i" in out
    assert "0.3-0.2i" in out


def test_design_that_does_not_exist_says_what_does(tmp_path: Path, residua: Residua) -> None:
    hidden = PLANT.replace("C = [[1.0, 0.0], [0.0, 1.0]]", "C = [[1.0, 0.0], [2.0, 0.0]]") + DISTURBED
    (tmp_path / "hidden.toml").write_text(hidden)
    command = ("design", tmp_path / "hidden.toml", "-o", tmp_path / "out.json")
    outcome = residua(*command, "--method", "robust-detection-filter")
    assert_error(outcome, "robust-detection-filter: ", "rank(CE)=0 < rank(E)=1", "--method kalman-filter")
    assert not (tmp_path / "out.json").exists()


def test_design_samples_a_continuous_plant(made: Path, tmp_path: Path, residua: Residua) -> None:
    continuous = PLANT.replace("dt = 1.0", "").replace("[[0.9, 0.05], [0.05, 0.8]]", "[[-1.0, 0.1], [0.1, -2.0]]")
    (tmp_path / "c.toml").write_text(continuous)
    for method in ("kalman-filter", "detection-filter"):
        options = ("-o", tmp_path / "out.json", "--dt", "0.1", "--method", method)
        status, _, _ = residua("design", tmp_path / "c.toml", *options)
        assert status == 0
    # Without the step, fit learns it from the recording.
    residua("design", tmp_path / "c.toml", "-o", tmp_path / "out.json", "--method", "detection-filter")
    rows = simulate(3000, 1)
    rows[:, 0] *= 0.1
    normal = write_csv(tmp_path / "normal.csv", rows)
    status, _, _ = residua("fit", tmp_path / "out.json", normal, "-o", tmp_path / "out.json")
    assert status == 0
    bare = write_csv(tmp_path / "bare.csv", rows[:, 1:], "pump,level 1,level 2")
    assert residua("run", tmp_path / "out.json", bare, "-q")[0] in (0, 1)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (("--method", "kalman-filter", "--poles", "0.3,0.3"), "fault-estimator, not for kalman-filter"),
        (("--method", "detection-filter", "--poles", "0.3+0.1j,0.3"), "conjugate"),
        (("--method", "detection-filter", "--poles", "1.3,0.3"), "stable"),
        (("--dt", "2.0"), "dt"),
    ],
)
def test_design_refuses(made: Path, tmp_path: Path, options: tuple[str, ...], part: str, residua: Residua) -> None:
    assert_error(design(made, tmp_path, residua, "plant.toml", *options), part)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "options",
    [
        ("--poles", "fast"),
        ("--poles", "nan,-1"),
        ("--method", "magic"),
        ("--false-alarm-rate", "2"),
        ("--dt", "-1"),
        ("--margin", "0"),
        ("--persistence", "0"),
        ("--window", "0"),
        ("--nonsense",),
    ],
)
def test_wrong_options_are_usage_errors(made: Path, tmp_path: Path, options: tuple[str, ...], residua: Residua) -> None:
    status, out, err = design(made, tmp_path, residua, "plant.toml", *options)
    assert (status, out) == (2, "")
    assert "Traceback" not in err
    assert options[0] in err
    assert not list(tmp_path.iterdir())


def test_poles_as_text() -> None:
    assert parse_poles("-3,-3") == (-3, -3)
    assert parse_poles(" -1+2j , -1-2i,-3e-1") == (-1 + 2j, -1 - 2j, -0.3)
    for text in ("", "a", "-3;-3", "inf", "-3,,-3"):
        with pytest.raises(ValueError, match="is not a pole"):
            parse_poles(text)


# ---------------------------------------------------------------------------- fit


def test_fit_says_in_one_line_how_rare_false_alarms_are(made: Path, tmp_path: Path, residua: Residua) -> None:
    status, out, err = residua("fit", made / "design.json", made / "normal.csv", "-o", tmp_path / "m.json")
    assert (status, err) == (0, "")
    first, line, *_ = out.splitlines()
    assert first.startswith("threshold: ")
    assert line == str(rs.Monitor.load(tmp_path / "m.json").fit_check)
    assert line.startswith("false alarms: 1 in 100 samples ")
    assert "held-out samples in alarm" in line
    assert "3000 over 2999 s" in out
    assert "this holds for days like the one that was fitted" in out
    assert line in residua("run", tmp_path / "m.json", made / "healthy.csv")[1].splitlines()


@pytest.mark.parametrize("samples", [60, 300, 3000])
@pytest.mark.parametrize("rate", ["0.3", "0.01", "0.0001"])
def test_a_fit_does_not_complain_of_a_rate_out_of_reach(
    made: Path, tmp_path: Path, residua: Residua, samples: int, rate: str
) -> None:
    path = write_csv(tmp_path / "normal.csv", simulate(samples, 4))
    status, out, err = residua("fit", made / "design.json", path, "-o", tmp_path / "m.json", "--false-alarm-rate", rate)
    assert (status, err) == (0, "")
    assert out.splitlines()[1].startswith("false alarms: 1 in ")


def test_a_fit_warns_where_the_held_out_part_contradicts(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "changed.csv", simulate(3000, 4, sensor=0.5, from_=2700))
    fit = ("fit", made / "design.json", path, "-o", tmp_path / "m.json")
    assert_error(residua(*fit), "--force")
    status, _, err = residua(*fit, "--force")
    assert status == 0
    assert err.startswith("warning: the fit: ")
    assert "held-out samples in alarm" in err


def test_fit_may_overwrite_its_monitor(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = tmp_path / "m.json"
    path.write_bytes((made / "design.json").read_bytes())
    before = path.read_text()
    assert residua("fit", path, made / "normal.csv", "-o", path)[0] == 0
    assert path.read_text() != before
    assert path.read_text() == (made / "monitor.json").read_text()


def test_fit_refuses_too_little_data(made: Path, tmp_path: Path, residua: Residua) -> None:
    path = write_csv(tmp_path / "short.csv", simulate(20, 5))
    assert_error(residua("fit", made / "design.json", path, "-o", tmp_path / "m.json"), "too few")
    assert not (tmp_path / "m.json").exists()


def test_a_pole_at_zero_is_a_zero(made: Path, tmp_path: Path, residua: Residua) -> None:
    assert [format_pole(p) for p in (0.0, -0.0, -1.221e-15, -3e-13 + 4e-13j, -0.5 + 1e-12j, 0.1 + 0.2j)] == [
        "0",
        "0",
        "-1.221e-15",
        "-3e-13+4e-13i",
        "-0.5",
        "0.1+0.2i",
    ]
    _, out, _ = residua("design", made / "plant.toml", "-o", tmp_path / "p.json", "--method", "structured-parity")
    assert re.search(r"^  poles: 0(, 0)*$", out, flags=re.MULTILINE)
