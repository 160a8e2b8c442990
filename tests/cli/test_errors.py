"""Every kind of bad input, and how runs end otherwise than well."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cli_examples import PLANT, Residua, assert_error, simulate, write_csv
from residua import __version__

# ---------------------------------------------------------------------- bad input


def test_missing_and_unreadable_files(made: Path, tmp_path: Path, residua: Residua) -> None:
    absent = tmp_path / "absent"
    assert_error(residua("analyze", absent), "absent: plant file not found")
    assert_error(residua("analyze", tmp_path), "is a folder")
    assert_error(residua("run", absent, made / "faulty.csv"), "absent: monitor not found")
    assert_error(residua("run", made / "monitor.json", absent), "absent: recording not found")
    (tmp_path / "bad.json").write_text("{")
    assert_error(residua("run", tmp_path / "bad.json", made / "faulty.csv"), "bad.json")
    (tmp_path / "bad.json").write_text("{}")
    assert_error(residua("run", tmp_path / "bad.json", made / "faulty.csv"), "bad.json")
    content = json.loads((made / "monitor.json").read_text()) | {"version": 99}
    (tmp_path / "bad.json").write_text(json.dumps(content))
    assert_error(residua("run", tmp_path / "bad.json", made / "faulty.csv"), "99")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (("[0.05, 0.8]]", "[0.05]]"), ("A",)),
        (("[0.05, 0.8]]", "[0.05, nan]]"), ("A",)),
        (('output = "level 1"', 'output = "level 9"'), ("level 9",)),
        (("residua-plant/1", "residua-plant/99"), ("residua-plant/99",)),
        (("[matrices]", "[matrices"), ("TOML",)),
    ],
)
def test_bad_plant_files(tmp_path: Path, change: tuple[str, str], parts: tuple[str, ...], residua: Residua) -> None:
    (tmp_path / "bad.toml").write_text(PLANT.replace(*change, 1))
    assert_error(residua("analyze", tmp_path / "bad.toml"), "bad.toml", *parts)


def test_bad_recordings(made: Path, tmp_path: Path, residua: Residua) -> None:
    rows = simulate(100, 4)
    path = tmp_path / "bad.csv"
    run = ("run", made / "monitor.json", path)
    write_csv(path, rows[:, :3], "time,pump,level 1")
    assert_error(residua(*run), "level 2")
    path.write_text("")
    assert_error(residua(*run), "bad.csv")
    path.write_text("time,pump,level 1,level 2\n")
    assert_error(residua(*run), "no data")
    irregular = rows.copy()
    irregular[50:, 0] += 3.0
    write_csv(path, irregular)
    assert_error(residua(*run), "bad.csv")
    slower = rows.copy()
    slower[:, 0] *= 2.0
    write_csv(path, slower)
    assert_error(residua(*run), "2 s")
    path.write_text("time,pump,level 1,level 2\n0,1,2,3\n1,1,high,3\n")
    assert_error(residua(*run), "high")
    path.rename(tmp_path / "bad.xlsx")
    assert_error(residua("run", made / "monitor.json", tmp_path / "bad.xlsx"), ".xlsx")


def test_monitor_without_threshold(made: Path, tmp_path: Path, residua: Residua) -> None:
    options = ("-o", tmp_path / "m.json", "--method", "detection-filter")
    residua("design", made / "plant.toml", *options)
    monitor = json.loads((tmp_path / "m.json").read_text())
    assert monitor["fitted"] is not None  # the noise of the plant gives a first threshold
    bare = PLANT.replace("[noise]\nprocess = 1e-4\nmeasurement = 1e-3\n", "")
    (tmp_path / "bare.toml").write_text(bare)
    residua("design", tmp_path / "bare.toml", *options)
    assert_error(residua("run", tmp_path / "m.json", made / "faulty.csv"), "no threshold")


def test_outputs_are_checked_before_any_work(made: Path, tmp_path: Path, residua: Residua) -> None:
    run = ("run", made / "monitor.json", made / "faulty.csv")
    assert_error(residua(*run, "--report", tmp_path / "no" / "page.html"), "does not exist")
    assert_error(residua(*run, "--report", tmp_path), "is a folder")
    assert_error(residua(*run, "--residuals", made / "faulty.csv"), "is read by this command")
    assert_error(residua(*run, "--residuals", tmp_path / "r.xlsx"), ".csv or .parquet")
    both = ("--alarms", tmp_path / "same.csv", "--residuals", tmp_path / "same.csv")
    assert_error(residua(*run, *both), "two outputs")
    assert_error(residua("design", made / "plant.toml", "-o", made / "plant.toml"), "is read by this command")
    assert not list(tmp_path.iterdir())


def test_failed_output_leaves_the_old_file(
    made: Path, tmp_path: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)  # the last step of writing
    path = tmp_path / "alarms.jsonl"
    path.write_text("old")
    assert_error(residua("run", made / "monitor.json", made / "faulty.csv", "--alarms", path), "No space left")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["alarms.jsonl"]


def test_links_and_modes_survive(made: Path, tmp_path: Path, residua: Residua) -> None:
    target, link = tmp_path / "target.jsonl", tmp_path / "link.jsonl"
    target.write_text("")
    target.chmod(0o640)
    link.symlink_to(target)
    residua("run", made / "monitor.json", made / "faulty.csv", "-q", "--alarms", link)
    assert link.is_symlink()
    assert target.read_text()
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(not os.path.exists("/dev/null"), reason="needs /dev/null")
def test_devices_are_written_to_not_replaced(made: Path, residua: Residua) -> None:
    residua("run", made / "monitor.json", made / "faulty.csv", "-q", "--alarms", "/dev/null")
    assert not Path("/dev/null").is_file()


# ------------------------------------------------------------- errors and signals


def test_unexpected_errors_are_not_a_fault(made: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: Path) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr("residua.cli.analyze_command.load_plant", broken)
    assert_error(residua("analyze", made / "plant.toml"), "unexpected RuntimeError: two lines", "RESIDUA_TRACEBACK")
    monkeypatch.setenv("RESIDUA_TRACEBACK", "1")
    status, _, err = residua("analyze", made / "plant.toml")
    assert status == 2
    assert "Traceback" in err


def test_interrupt(made: Path, residua: Residua, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("residua.cli.analyze_command.load_plant", interrupted)
    assert residua("analyze", made / "plant.toml") == (130, "", "interrupted\n")


def process(*argv: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, argv)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)  # pyright: ignore


def test_as_a_process(made: Path) -> None:
    done = process("-m", "residua", "--version")
    assert (done.returncode, done.stdout) == (0, f"residua {__version__}\n")
    done = process("-m", "residua", "run", made / "monitor.json", made / "faulty.csv", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "")
    assert process("-m", "residua").returncode == 2
    assert process("-m", "residua", "nonsense").returncode == 2


def test_reader_that_goes_away(made: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "residua", "analyze", str(made / "plant.toml"), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdout.close()
        assert running.stderr.read() == ""
    assert running.returncode == 141


def test_without_typer_it_says_what_to_install() -> None:
    code = "import sys; sys.modules['typer'] = None; from residua.cli import main; sys.exit(main())"
    done = process("-c", code)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert "residua[cli]" in done.stderr


def test_names_that_look_like_markup(tmp_path: Path, residua: Residua) -> None:
    odd = PLANT.replace('name = "leak"', 'name = "[red]leak[/red] :fire:"')
    (tmp_path / "odd.toml").write_text(odd)
    _, out, _ = residua("analyze", tmp_path / "odd.toml")
    assert "[red]leak[/red] :fire:" in out


def test_progress_bar_appears_only_when_it_takes_long(monkeypatch: pytest.MonkeyPatch) -> None:
    from residua.cli import screen

    with screen.progress() as bar:
        bar(1, 2)
        assert bar.bar is None
        monkeypatch.setattr(screen, "_PATIENCE", -1.0)
        bar(1, 2)
        assert bar.bar is not None
        bar(2, 2)
