"""Functional Mock-up Units: valid, with the bits of the monitor, in steps, states and instances as FMI has them."""

from __future__ import annotations

import contextlib
import doctest
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from effort import cases
from export_examples import expected, exported
from fused_examples import ISOLATIONS, MARKS, ORDERS, TESTS, recording, specification
from guards import trips
from residua.errors import AccuracyError, DataError, NotFittedError, SettingError
from residua.export.fmu import pack
from residua.export.fmu_variables import names_in_unit
from residua.monitor.running import initial_state, run_reference
from running_fmus import RunningFMU

pytest.importorskip("fmpy", reason="there is no FMPy")
needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
needs_cppcheck = pytest.mark.skipif(shutil.which("cppcheck") is None, reason="there is no cppcheck")
VERSIONS = ("2.0", "3.0")
both = pytest.mark.parametrize("version", VERSIONS)


def problems(path: Path) -> list[str]:
    from fmpy.validation import validate_fmu

    return list(validate_fmu(str(path)))


def tank(**more: Any) -> rs.Plant:
    about: dict[str, Any] = {
        "dt": 0.1, "inputs": ["valve"], "outputs": ["level", "flow"], "units": {"level": "cm", "flow": "l/min"},
        "name": "Tank 7 (east)",
    }  # fmt: skip
    plant = rs.Plant([[0.9, 0.05], [0.0, 0.8]], [[0.1], [0.2]], np.eye(2), **(about | more))
    plant = plant.with_operating_point(inputs=[2.0], outputs=[30.0, 4.0]).with_sensor_faults()
    return plant.with_noise(process=1e-4 * np.eye(2), measurement=1e-2 * np.eye(2))


def watch(plant: rs.Plant | None = None, **more: Any) -> rs.Monitor:
    return rs.Monitor(rs.design.kalman_filter(tank() if plant is None else plant), **more)


def samples(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    data = np.hstack([2.0 + rng.standard_normal((count, 1)), [30.0, 4.0] + 0.3 * rng.standard_normal((count, 2))])
    data[count // 2 :, 1] += 3.0
    return data


def wanted(monitor: rs.Monitor, data: np.ndarray) -> np.ndarray:
    """Return what the decisions of a monitor leave, missing values held."""
    spec = replace(monitor._specification(), partial=None)
    _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
    return expected(spec, decisions)


@contextlib.contextmanager
def running(path: Path, **more: Any) -> Iterator[RunningFMU]:
    one = RunningFMU(path, **more)
    try:
        yield one
    finally:
        one.close()


@pytest.fixture(scope="module", params=VERSIONS)
def unit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One unit of each version."""
    if shutil.which("gcc") is None:
        pytest.skip("there is no gcc")
    folder = tmp_path_factory.mktemp("fmu")
    made = rs.export.to_fmu(watch(), folder, version=request.param, missing="hold", binary=True)
    assert made.path == folder / "tank_7_east.fmu"
    return made.path


@needs_compiler
@both
@pytest.mark.parametrize("seed", cases(range(200), 2))
def test_units_are_valid_and_have_the_bits_of_the_monitor(seed: int, version: str, tmp_path: Path) -> None:
    """Of generated monitors of every kind, with missing values, infinities and overflows."""
    rng = np.random.default_rng(seed)
    order = int(rng.choice([*ORDERS, 40]))
    test = list(TESTS)[seed % len(TESTS) if order or seed % len(TESTS) != len(TESTS) - 1 else 0]
    isolation, method = str(rng.choice(list(ISOLATIONS))), ("kalman", "observer")[seed // len(TESTS) % 2]
    spec = replace(specification(test, isolation, order, int(rng.choice([1, 2, 3, 5])), method), partial=None)
    channels = spec.B.shape[1]
    made = pack(exported(spec, int(rng.integers(channels))), tmp_path / "one.fmu", "one", version, True)
    assert problems(made.path) == []
    with running(made.path) as fmu:
        for data in recording(spec, rng, 300, [*MARKS]):
            _, decisions = run_reference(spec, initial_state(spec, 1), data[None])
            assert np.array_equal(fmu.run(data), expected(spec, decisions))
            fmu.fmu.reset()
            fmu.setup()


def test_the_demos_steps_are_those_of_the_monitor(unit: Path) -> None:
    """By :meth:`Monitor.step` itself, where nothing is missing."""
    data, monitor = samples(300), watch()
    with running(unit) as fmu:
        for one, row in zip(data, fmu.run(data), strict=True):
            decision = monitor.step(one[:1], one[1:])
            assert np.array_equal(row[:2], decision.residual)
            assert row[2] == (decision.statistic if decision.decided else 0.0)
            assert tuple(row[3:6]) == (not decision.missing, decision.decided, decision.alarm)
    assert decision.alarm


def test_fmpy_simulates_it_from_a_table(unit: Path) -> None:
    import fmpy

    data = samples(200)
    data[20, 2] = np.nan
    table = np.array(
        [(0.1 * k, *one) for k, one in enumerate(data)], dtype=[(n, float) for n in ("time", "valve", "level", "flow")]
    )
    out = fmpy.simulate_fmu(str(unit), input=table, stop_time=0.1 * len(data))
    assert len(out) == len(data) + 1
    assert not out["known"][0]  # nothing is decided before the first step
    names = ["residual_1", "residual_2", "statistic", "known", "decided", "alarm", "best", "score_1", "score_2"]
    assert np.array_equal(np.column_stack([out[name][1:] for name in names]).astype(float), wanted(watch(), data))


# ---------------------------------------------------------------------------- steps


def test_outputs_belong_to_the_inputs_at_the_beginning_of_the_step(unit: Path) -> None:
    data = samples(50)
    with running(unit) as fmu:
        rows = []
        for one in data:
            fmu.set(one)
            fmu.go()
            rows.append(fmu.get(*fmu.columns))
            fmu.set(np.full(3, 1e9))  # no part in the outputs of the step before
            assert fmu.get(*fmu.columns) == rows[-1]
    assert np.array_equal(rows, wanted(watch(), data))


@pytest.mark.parametrize("parts", [2, 3, 7])
def test_smaller_steps_take_no_samples_between(unit: Path, parts: int) -> None:
    data = samples(60)
    with running(unit, start=-3.7) as fmu:
        rows = []
        for one in data:
            fmu.set(one)
            for _ in range(parts):
                fmu.go(0.1 / parts)
                fmu.set(np.full(3, np.nan))
            rows.append(fmu.get(*fmu.columns))
    assert np.array_equal(rows, wanted(watch(), data))


def test_a_step_over_a_sample_is_refused_and_changes_nothing(unit: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = samples(40)
    with running(unit) as fmu:
        before = fmu.run(data[:20])
        for size in (0.2, 0.15, 1e9, -0.1, np.nan, np.inf):
            with pytest.raises(Exception, match=r"(?i)doStep"):
                fmu.fmu.doStep(currentCommunicationPoint=fmu.time, communicationStepSize=size)
        with pytest.raises(Exception, match=r"(?i)doStep"):
            fmu.fmu.doStep(currentCommunicationPoint=fmu.time + 0.05, communicationStepSize=0.1)
        assert fmu.get(*fmu.columns) == list(before[-1])
        after = fmu.run(data[20:])
    assert np.array_equal(np.vstack([before, after]), wanted(watch(), data))
    assert "samples are 0.1 s apart from the start on" in "".join(capfd.readouterr())


def test_larger_steps_hold_their_inputs_where_that_is_asked_for(unit: Path) -> None:
    data = np.repeat(samples(20), 3, axis=0)
    with running(unit, hold=True) as fmu:
        rows = []
        for one in data[::3]:
            fmu.set(one)
            fmu.go(0.3)
            rows.append(fmu.get(*fmu.columns))
        with pytest.raises(Exception, match=r"(?i)setBoolean"):
            fmu.fmu.setBoolean([fmu.reference("hold_inputs")], [False])
    assert np.array_equal(rows, wanted(watch(), data)[2::3])


# --------------------------------------------------------------- states and instances


def test_a_state_is_gone_back_to_and_kept_as_bytes(unit: Path) -> None:
    data = samples(90)
    right = wanted(watch(), data)
    with running(unit) as fmu, running(fmu.folder, name="two") as other:
        fmu.run(data[:40])
        state, time = fmu.fmu.getFMUState(), fmu.time
        first = fmu.run(data[40:])
        fmu.fmu.setFMUState(state)
        fmu.time = time
        assert np.array_equal(fmu.run(data[40:]), first)
        assert np.array_equal(first, right[40:])
        kept = fmu.fmu.serializeFMUState(state)
        fmu.fmu.freeFMUState(state)
        restored = (other.fmu.deSerializeFMUstate if fmu.version == "2.0" else other.fmu.deserializeFMUState)(kept)
        other.fmu.setFMUState(restored)
        other.time = time
        assert np.array_equal(other.run(data[40:]), first)
        other.fmu.freeFMUState(restored)


def test_bytes_that_are_no_state_of_it_are_refused(unit: Path, tmp_path: Path) -> None:
    another = rs.export.to_fmu(
        watch(test=rs.decide.NormThreshold(threshold=9.0)), tmp_path, version="2.0", missing="hold", binary=True
    )
    with running(unit) as fmu, running(another.path) as other:
        take = fmu.fmu.deSerializeFMUstate if fmu.version == "2.0" else fmu.fmu.deserializeFMUState
        kept = fmu.fmu.serializeFMUState(fmu.fmu.getFMUState())
        foreign = other.fmu.serializeFMUState(other.fmu.getFMUState())
        damaged = bytearray(kept)
        damaged[len(kept) // 2] ^= 4
        for wrong in (foreign, bytes(damaged), kept[:-1], kept + b"\0", b""):
            with pytest.raises(Exception, match=r"(?i)deserialize"):
                take(wrong)
        take(kept)


def test_two_instances_share_nothing(unit: Path) -> None:
    one, two = samples(60, seed=1), samples(60, seed=2)
    with running(unit) as first, running(first.folder, name="two") as second:
        rows = [(first.run(a[None])[0], second.run(b[None])[0]) for a, b in zip(one, two, strict=True)]
    assert np.array_equal([row for row, _ in rows], wanted(watch(), one))
    assert np.array_equal([row for _, row in rows], wanted(watch(), two))


def test_a_reset_is_a_new_start(unit: Path) -> None:
    data = samples(60)
    with running(unit) as fmu:
        once = fmu.run(data)
        fmu.fmu.terminate()
        fmu.fmu.reset()
        fmu.setup(start=5.0)
        assert np.array_equal(fmu.run(data), once)


def test_values_that_are_missing_infinite_or_never_set(unit: Path) -> None:
    for value in (np.nan, np.inf, -np.inf):
        data = np.vstack([samples(30), np.full((30, 3), value), samples(30)])
        with running(unit) as fmu:
            assert np.array_equal(fmu.run(data), wanted(watch(), data))
    data = np.tile([2.0, 30.0, 4.0], (30, 1))
    with running(unit) as fmu:  # inputs start at the operating point
        for _ in data:
            fmu.go()
        assert fmu.get(*fmu.columns) == list(wanted(watch(), data)[-1])


def test_functions_in_another_order_are_refused(unit: Path) -> None:
    with running(unit) as fmu:
        for name in ("enterInitializationMode", "exitInitializationMode"):
            with pytest.raises(Exception, match=r"(?i)initialization"):
                getattr(fmu.fmu, name)()
        with pytest.raises(Exception, match=r"(?i)set(Real|Float64)"):
            (fmu.fmu.setReal if fmu.version == "2.0" else fmu.fmu.setFloat64)([fmu.reference("statistic")], [1.0])
        with pytest.raises(Exception, match=r"(?i)get(Real|Float64)"):
            (fmu.fmu.getReal if fmu.version == "2.0" else fmu.fmu.getFloat64)([10**6])
        fmu.fmu.terminate()
        with pytest.raises(Exception, match=r"(?i)doStep"):
            fmu.go()


def test_another_units_token_is_refused(unit: Path) -> None:
    import fmpy
    from fmpy import fmi2, fmi3

    with running(unit) as fmu:
        kind = fmi2.FMU2Slave if fmu.version == "2.0" else fmi3.FMU3Slave
        about = fmpy.read_model_description(str(unit))
        other: Any = kind(
            guid="{0}", unzipDirectory=str(fmu.folder), instanceName="x",
            modelIdentifier=about.coSimulation.modelIdentifier,
        )  # fmt: skip
        with pytest.raises(Exception, match=r"(?i)instantiate"):
            other.instantiate()


# ---------------------------------------------------------------------- what is inside


def test_the_description_names_signals_units_and_the_step(unit: Path) -> None:
    import fmpy

    about = fmpy.read_model_description(str(unit))
    names = {one.name: one for one in about.modelVariables}
    assert [(n, names[n].unit, float(names[n].start)) for n in ("valve", "level", "flow")] == [
        ("valve", None, 2.0), ("level", "cm", 30.0), ("flow", "l/min", 4.0),
    ]  # fmt: skip
    assert float(about.defaultExperiment.stepSize) == 0.1
    assert all(one.dependencies == [] for one in about.outputs)
    assert float(names["threshold"].start) == watch()._specification().test.compiled.threshold  # pyright: ignore
    assert "level sensor" in names["score_1"].description
    page = zipfile.ZipFile(unit).read("documentation/index.html").decode()
    assert "its last value is held" in page
    assert "without a certificate" in page
    files = zipfile.ZipFile(unit).namelist()
    assert not any(name.endswith(("fmi2Functions.h", "fmi3Functions.h")) for name in files)
    assert "documentation/licenses/fmi_headers.txt" in files


@needs_compiler
@both
def test_odd_names_are_kept_or_mapped_with_a_table(version: str, tmp_path: Path) -> None:
    odd = ["T_1 (°C) */", 'p "x" & <y> ??/', "alarm", "time", "res\tidual_1", "residual_1"]
    plant = rs.Plant([[0.9]], np.zeros((1, 0)), np.arange(1.0, 7.0)[:, None], dt=1, outputs=odd, name='Ofen */ "<3>" ü')
    plant = plant.with_units({"alarm": 'm³ "/<h>'}) if hasattr(plant, "with_units") else plant
    plant = plant.with_sensor_faults().with_noise(process=1e-3, measurement=1e-2)
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    made = rs.export.to_fmu(monitor, tmp_path / "Ofen 3.fmu", version=version, missing="hold", binary=True)
    assert made.renamed == {
        "alarm": "alarm_1", "time": "time_1", "res\tidual_1": "res_idual_1", "residual_1": "residual_1_1",
    }  # fmt: skip
    assert problems(made.path) == []
    assert "<td>alarm_1</td><td>alarm</td>" in zipfile.ZipFile(made.path).read("documentation/index.html").decode()
    data = np.random.default_rng(0).standard_normal((80, 6))
    with running(made.path) as fmu:
        assert np.array_equal(fmu.run(data), wanted(monitor, data))


def test_names_in_a_unit_are_printable_and_differ() -> None:
    made = names_in_unit(["a", "a", "", " ", "b\n", "b\x1b", "x"], {"x", "x_1"})
    assert made == ["a", "a_1", "signal", "signal_1", "b_", "b__1", "x_2"]


@needs_compiler
@both
def test_a_monitor_from_a_file_gives_the_same_bytes(version: str, tmp_path: Path) -> None:
    monitor = watch(test=rs.decide.CUSUM(mean_time_between_false_alarms=1e4))
    monitor.save(tmp_path / "monitor.json")
    made = [
        rs.export.to_fmu(one, tmp_path / name / "w.fmu", version=version, missing="hold")
        for name, one in (("a", monitor), ("b", rs.Monitor.load(tmp_path / "monitor.json")))
    ]
    assert made[0].path.read_bytes() == made[1].path.read_bytes()


@needs_compiler
@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@both
def test_the_sources_alone_build_the_same_unit(version: str, tmp_path: Path) -> None:
    """As an importer does it: by FMPy, with its own headers."""
    from fmpy import extract
    from fmpy.build import build_platform_binary

    data = samples(60)
    made = rs.export.to_fmu(watch(), tmp_path / "w.fmu", version=version, missing="hold", binary=False)
    assert made.platform is None
    assert problems(made.path) == []
    extract(str(made.path), str(tmp_path / "out"))
    (tmp_path / "build").mkdir()
    build_platform_binary(tmp_path / "out", build_dir=tmp_path / "build", cmake_options={})
    with running(tmp_path / "out") as fmu:
        assert np.array_equal(fmu.run(data), wanted(watch(), data))


STRICT = ("-std=c99", "-pedantic-errors", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror")


def sources(unit: Path, folder: Path) -> Path:
    """Unpack the sources, with the headers of FMI beside them."""
    with zipfile.ZipFile(unit) as archive:
        archive.extractall(folder)
    headers = Path(rs.__file__).parent / "export" / "fmi" / "headers"
    for one in headers.iterdir():
        shutil.copy(one, folder)
    return folder / "sources"


def test_its_c_compiles_without_a_warning(unit: Path, tmp_path: Path) -> None:
    folder = sources(unit, tmp_path)
    for one in folder.glob("*.c"):
        command = ["gcc", *STRICT, "-O2", "-isystem", str(tmp_path), "-c", one.name, "-o", f"{one.stem}.o"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


#: Advisory rules of MISRA C:2012 that the code of a unit does not follow: casts from the pointers to void that FMI
#: hands over (11.5), macros that only callers use (2.5), constants of one function beside it (8.9), parentheses (12.1).
ADVISORY = {"2.5", "8.9", "11.5", "12.1"}
#: Required ones, which only the functions of FMI break: their names are macros in the headers of FMI (5.5), and there
#: is no memory but that of calloc, malloc and free (21.3).
BY_INTERFACE = {"5.5", "21.3"}


@needs_cppcheck
def test_misra_finds_no_required_rule_broken_but_by_the_interface(unit: Path, tmp_path: Path) -> None:
    folder = sources(unit, tmp_path)
    files = sorted(one.name for one in folder.glob("*.c"))
    command = ["cppcheck", "--addon=misra", "--std=c99", f"-I{tmp_path}", *files]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if "misra" in done.stderr and "misra-c2012" not in done.stderr:
        pytest.skip("this cppcheck has no addon for MISRA")
    lines = [one for one in done.stderr.splitlines() if re.match(r"[\w.]+\.[ch]:", one)]
    broken = [(one[: one.index(":")], found[1]) for one in lines if (found := re.search(r"misra-c2012-([\d.]+)", one))]
    functions = {f"fmi{version}.c" for version in "23"}
    assert {rule for name, rule in broken if name.startswith("tank_7_east")} <= ADVISORY
    assert {rule for name, rule in broken if name in functions} <= ADVISORY | BY_INTERFACE
    assert broken


_UNDER_SANITIZERS = """
import sys
import numpy as np
from pathlib import Path
sys.path.insert(0, {tests!r})
from running_fmus import RunningFMU
fmu = RunningFMU(Path({folder!r}))
other = RunningFMU(Path({folder!r}), name="two")
rng = np.random.default_rng(0)
data = rng.standard_normal((400, 3)) + [2.0, 30.0, 4.0]
data[100:120] = np.nan
data[200:203, 1] = np.inf
data[250:260, 2] = 1e300
rows = fmu.run(data)
state = fmu.fmu.getFMUState()
kept = fmu.fmu.serializeFMUState(state)
again = (other.fmu.deSerializeFMUstate if fmu.version == "2.0" else other.fmu.deserializeFMUState)(kept)
other.fmu.setFMUState(again)
for one in (state, again):
    fmu.fmu.freeFMUState(one)
for bad in (b"", kept[:40]):
    try:
        (fmu.fmu.deSerializeFMUstate if fmu.version == "2.0" else fmu.fmu.deserializeFMUState)(bad)
    except Exception:
        pass
fmu.fmu.reset()
fmu.setup()
assert np.array_equal(fmu.run(data), rows)
for one in (fmu, other):
    one.fmu.terminate()
    one.fmu.fmi2FreeInstance(one.fmu.component) if one.version == "2.0" else one.fmu.fmi3FreeInstance(one.fmu.component)
print("all steps taken")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sanitizers are loaded as on Linux")
def test_sanitizers_find_nothing(unit: Path, tmp_path: Path) -> None:
    folder = sources(unit, tmp_path)
    (library,) = (tmp_path / "binaries").glob("*/*.so")
    flags = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fPIC", "-shared"]
    files = sorted(one.name for one in folder.glob("*.c"))
    done = subprocess.run(
        ["gcc", *flags, f"-I{tmp_path}", *files, "-o", str(library), "-lm"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        pytest.skip("this compiler has no sanitizers")
    asan = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    tests = str(Path(__file__).parent.parent)
    script = _UNDER_SANITIZERS.format(tests=tests, folder=str(tmp_path))
    environment = os.environ | {"LD_PRELOAD": asan.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0"}
    out = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False
    )  # fmt: skip
    assert out.returncode == 0, out.stderr[-4000:]
    assert "all steps taken" in out.stdout


# ---------------------------------------------------------------------------- bad input


def test_where_there_is_no_compiler_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    made = rs.export.to_fmu(watch(), tmp_path / "w.fmu", missing="hold")
    assert (made.platform, made.why) == (None, "there is no C compiler (cc, gcc, clang, or what CC names)")
    assert problems(made.path) == []
    assert made.why in zipfile.ZipFile(made.path).read("documentation/index.html").decode()
    assert not any(name.startswith("binaries") for name in zipfile.ZipFile(made.path).namelist())
    with pytest.raises(SettingError, match="no binary to put into the unit: there is no C compiler"):
        rs.export.to_fmu(watch(), tmp_path / "none.fmu", missing="hold", binary=True)
    assert not (tmp_path / "none.fmu").exists()


@needs_compiler
@trips("export.fmu_binary:_check")
def test_a_compiler_that_computes_otherwise_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc -Dsqrt=fabs")
    with pytest.raises(AccuracyError, match=r"has not the bits of the monitor \(FAILED: 400 samples"):
        rs.export.to_fmu(watch(), tmp_path / "none.fmu", missing="hold")
    monkeypatch.setenv("CC", "gcc -fno-such-option")
    with pytest.raises(SettingError, match="the C compiler fails"):
        rs.export.to_fmu(watch(), tmp_path / "none.fmu", missing="hold")
    assert not (tmp_path / "none.fmu").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"version": "1.0"}, "version must be '2.0' or '3.0', got '1.0'"),
        ({"version": 2}, "version must be"),
        ({"binary": "yes"}, "binary must be True, False or None"),
        ({"name": "2 tanks"}, "'monitor_2_tanks' would do"),
        ({"missing": "guess"}, "missing must be"),
    ],
)
def test_bad_options(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=said):
        rs.export.to_fmu(watch(), tmp_path / "none", **({"missing": "hold"} | options))
    assert not (tmp_path / "none").exists()


def test_what_it_cannot_hold_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="cannot be exported"):
        rs.export.to_fmu(watch(test=rs.decide.SPRT()), tmp_path / "none.fmu", missing="hold")
    with pytest.raises(SettingError, match="goes on through missing outputs"):
        rs.export.to_fmu(watch(), tmp_path / "none.fmu")
    plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1).with_sensor_faults()
    unfitted = rs.Monitor(rs.design.unknown_input_observer(plant).residual_generator())
    with pytest.raises(NotFittedError):
        rs.export.to_fmu(unfitted, tmp_path / "none.fmu")
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_there_are_not_overwritten_unless_asked(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "w.fmu"
    rs.export.to_fmu(watch(), target, missing="hold", binary=False)
    before = target.read_bytes()
    for where in (target, target.parent):
        with pytest.raises(DataError, match=r"w\.fmu is there already: name another file, or ask to overwrite"):
            rs.export.to_fmu(watch(), where, name="w", missing="hold", binary=False)
    assert target.read_bytes() == before
    rs.export.to_fmu(watch(test=rs.decide.EWMA()), target, missing="hold", binary=False, overwrite=True)
    assert target.read_bytes() != before
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"does not end in \.fmu"):
        rs.export.to_fmu(watch(), tmp_path / "file", missing="hold", binary=False)
    with pytest.raises(DataError, match="name a folder that can be made"):
        rs.export.to_fmu(watch(), tmp_path / "file" / "w.fmu", missing="hold", binary=False)
    (tmp_path / "folder.fmu").mkdir()
    with pytest.raises(DataError, match="is a folder: name a file"):
        rs.export.to_fmu(watch(), tmp_path / "folder.fmu", missing="hold", binary=False)


@needs_compiler
def test_the_commands_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``docs/fmu.rst``: its Python leaves what its commands read, and both come to the same answers."""
    page = Path(__file__).parent.parent.parent / "docs" / "fmu.rst"
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert tried
    assert not failed
    commands = re.findall(r"^   \$ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert [one.split()[:2] for one in commands] == [["residua", "export"], ["fmpy", "validate"], ["fmpy", "simulate"]]
    for one in commands:
        program, *arguments = one.split()
        module = {"residua": "residua", "fmpy": "fmpy"}[program]
        done = subprocess.run([sys.executable, "-m", module, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    answers = np.genfromtxt(tmp_path / "answers.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    data = np.genfromtxt(tmp_path / "day.csv", delimiter=",", skip_header=1)[:, 1:]
    monitor = rs.Monitor.load(tmp_path / "monitor.json")
    decisions = [monitor.step(one[:2], one[2:]) for one in data]
    assert len(answers) == len(decisions) + 1
    assert np.array_equal(answers["alarm"][1:].astype(bool), [one.alarm for one in decisions])
    assert np.allclose(answers["statistic"][1:], [one.statistic if one.decided else 0.0 for one in decisions])
