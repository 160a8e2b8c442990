"""Plant files: round trip to the last bit, and errors that point at the entry."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

from plant_examples import example, random_plant
from residua.errors import FileFormatError
from residua.library import gertler, jet_engine, three_tank, twardy
from residua.plant import OperatingPoint, Plant, dumps_plant, load_plant, loads_plant
from residua.plant.plant_writer import differences

REPOSITORY = Path(__file__).resolve().parents[2]

TANK = """
format = "residua-plant/1"
name = "tanks"
dt = 0.0

[states]
names = ["a", "b", "c"]

[inputs]
names = ["pump"]
units = ["m3/s"]
operating_point = [2]

[outputs]
names = ["level", "flow"]
units = {level = "m"}
operating_point = {flow = 1.5}

[matrices]
A = [[-1, 0, 0], [1, -2, 0], [0, 1, -3]]
B = [[1], [0], [0]]
C = [[1, 0, 0], [0, 0, 1]]

[[disturbances]]
name = "rain"
state = {a = 0.1, b = 0.2}

[[faults]]
kind = "actuator"
input = "pump"

[[faults]]
kind = "sensor"
output = "level"
component = "gauge"

[[faults]]
name = "leak"
state = [0, -1, 0]

[noise]
process = 0.01
measurement = {flow = 0.2}
"""


def plants() -> list[Plant]:
    special = example(units={"pump": "m³/s", "a": "m"}, name='a "quoted"\n\\name\x7f', description="ß → 1")
    special = special.with_operating_point(inputs=[0.1 + 0.2, -0.0], outputs=[1e-300, 1e99])
    special = special.with_faults({"odd name.": {"b": 1 / 3}, "by output": ([0, 0, 0], [0, np.pi])}, component="x y")
    special = special.with_faults({"drift": ([1, 0, 0], [1, 0])}, kind="sensor")
    special = special.with_disturbances([[1], [0], [0]]).with_disturbances({"again": [2, 0, 0]})
    return [
        example(),
        special,
        example(E=np.diag([1.0, 2.0, 0.0])),
        three_tank(),
        three_tank(dt=0),
        jet_engine(),
        jet_engine(corrected=False, disturbances=False),
        twardy(),
        gertler(sensor_faults=True),
        Plant(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[1, 2], [3, 4]], dt=0.5).with_sensor_faults(),
        *(random_plant(seed) for seed in range(5)),
        *(random_plant(seed).discretize(0.1) for seed in range(5)),
        *(correlated(random_plant(seed), seed) for seed in range(3)),
    ]


def correlated(plant: Plant, seed: int) -> Plant:
    """The plant with noise that states and outputs share."""
    rng = np.random.default_rng(seed)
    L = rng.standard_normal((plant.n_states + plant.n_outputs, 4))
    W, S, V = ((L @ L.T)[a, b] for a, b in parts(plant.n_states))
    return plant.with_noise(process=W, measurement=V, cross=S)


def parts(n: int) -> list[tuple[slice, slice]]:
    """Where process, cross and measurement noise stand in their joint covariance."""
    states, outputs = slice(None, n), slice(n, None)
    return [(states, states), (states, outputs), (outputs, outputs)]


@pytest.mark.parametrize("k", range(len(plants())))
def test_round_trip_is_exact(k: int, tmp_path: Path) -> None:
    plant = plants()[k]
    plant.to_toml(tmp_path / "plant.toml")
    again = Plant.from_toml(tmp_path / "plant.toml")
    assert differences(plant, again) == []
    assert dumps_plant(again) == dumps_plant(plant)


def test_what_a_file_says() -> None:
    plant = loads_plant(TANK)
    assert plant.faults == ("pump actuator", "level sensor", "leak")
    assert plant.fault_kinds == ("actuator", "sensor", "component")
    assert plant.fault_components == ("pump", "gauge", "leak")
    np.testing.assert_array_equal(plant.Bf, [[1, 0, 0], [0, 0, -1], [0, 0, 0]])
    np.testing.assert_array_equal(plant.Df, [[0, 1, 0], [0, 0, 0]])
    np.testing.assert_array_equal(plant.Bd.ravel(), [0.1, 0.2, 0])
    assert plant.disturbances == ("rain",)
    assert plant.units == {"pump": "m3/s", "level": "m"}
    assert plant.operating_point == OperatingPoint((2.0,), (0.0, 1.5))
    np.testing.assert_allclose(plant.process_noise, 0.01 * np.eye(3), rtol=1e-15)
    np.testing.assert_allclose(plant.measurement_noise, np.diag([0, 0.2]), rtol=1e-15)


def test_sample_time_samples_the_matrices_and_then_takes_the_noise_per_sample() -> None:
    continuous = loads_plant(TANK)
    sampled = loads_plant(TANK.replace("dt = 0.0", "sample_time = 0.5"))
    expected = continuous.discretize(0.5).with_noise(process=0.01, measurement={"flow": 0.2})
    assert differences(sampled, expected) == []


@pytest.mark.parametrize("name", ["three_tank", "jet_engine"])
def test_examples_are_what_the_library_has(name: str) -> None:
    plant = {"three_tank": three_tank, "jet_engine": jet_engine}[name]()
    example = load_plant(REPOSITORY / "examples" / f"{name}.toml")
    for key in differences(example, plant):  # exponentials and factors differ in the last bit between machines
        np.testing.assert_allclose(getattr(example, key), getattr(plant, key), rtol=1e-11, atol=1e-14)


def documented() -> str:
    page = (REPOSITORY / "docs" / "plant-file.rst").read_text(encoding="utf-8")
    block = re.search(r"\.\. code-block:: toml\n   :name: two-tanks\n\n((?:    .*\n|\n)+)", page)
    assert block
    return textwrap.dedent(block[1])


def test_the_example_in_the_documentation_has_the_stated_defaults() -> None:
    plant = loads_plant(documented(), source="two_tanks.toml")
    assert plant.faults == ("pump actuator", "lower sensor", "leak")
    assert plant.fault_components == ("pump", "lower", "upper tank")
    assert plant.operating_point == OperatingPoint((30.0,), (41.0, 32.0))
    assert (plant.dt, plant.disturbances) == (1.0, ("rain",))
    np.testing.assert_array_equal(plant.measurement_noise, 0.02 * np.eye(2))
    assert differences(plant, loads_plant(dumps_plant(plant))) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("state = {upper = -1.8}", "state = [1, 2, 3]"),
        ('output = "lower"', 'output = "lower"\ncomponnet = "gauge"'),
        ('name = "two tanks"', "name = two tanks"),
    ],
)
def test_the_errors_in_the_documentation_are_those_of_the_example(old: str, new: str) -> None:
    page = (REPOSITORY / "docs" / "plant-file.rst").read_text(encoding="utf-8")
    with pytest.raises(FileFormatError) as refused:
        loads_plant(documented().replace(old, new, 1), source="two_tanks.toml")
    assert str(refused.value).split("known here")[0] in page


def edited(old: str, new: str) -> str:
    assert old in TANK
    return TANK.replace(old, new, 1)


BAD_FILES = {
    "syntax": (edited('name = "tanks"', "name = tanks"), r"not valid TOML: .*line 3, column 8"),
    "key twice": (edited("dt = 0.0", "dt = 0.0\ndt = 1.0"), r"not valid TOML: .*line 5"),
    "empty": ("", "not a plant file"),
    "other format": (edited("residua-plant/1", "residua-plant/2"), "format: expected 'residua-plant/1'"),
    "unknown key": (edited("[noise]", "[noises]"), r"noises: unknown entry 'noises' \(did you mean 'noise'\?\)"),
    "unknown key inside": (edited("component =", "componnet ="), r"faults\[1\].componnet: .*'component'"),
    "no A": (edited("A = [[-1, 0, 0], [1, -2, 0], [0, 1, -3]]", ""), r"matrices.A: this matrix is required"),
    "no matrices": ('format = "residua-plant/1"', r"matrices.A: this matrix is required"),
    "A not square": (edited("A = [[-1, 0, 0], [1, -2, 0], [0, 1, -3]]", "A = [[1, 2]]"), "matrices.A: must be square"),
    "ragged": (edited("[1, -2, 0]", "[1, -2]"), r"matrices.A\[1\]: expected 3 numbers .*, got 2"),
    "B rows": (
        edited("B = [[1], [0], [0]]", "B = [[1], [0]]"),
        r"matrices.B: expected 3 rows \(one per state\), got 2",
    ),
    "D columns": (edited("C = [[1, 0, 0]", "D = [[1, 0], [0, 1]]\nC = [[1, 0, 0]"), "matrices.D: expected 1 columns"),
    "text in a matrix": (edited("[0, 1, -3]", '[0, 1, "x"]'), r"matrices.A\[2\]\[2\]: expected a number, got 'x'"),
    "true in a matrix": (edited("[0, 1, -3]", "[0, 1, true]"), r"matrices.A\[2\]\[2\]: expected a number, got True"),
    "nan": (edited("[0, 1, -3]", "[0, 1, nan]"), r"matrices.A\[2\]\[2\]: every number must be finite, got nan"),
    "inf": (
        edited("state = [0, -1, 0]", "state = [0, -inf, 0]"),
        r"faults\[2\].state\[1\]: every number must be finite",
    ),
    "huge": (edited("[0, 1, -3]", "[0, 1, 1" + 400 * "0" + "]"), "must be finite"),
    "vector for a matrix": (
        edited("B = [[1], [0], [0]]", "B = [1, 0, 0]"),
        "matrices.B: expected a matrix as a list of rows",
    ),
    "names too few": (edited('names = ["a", "b", "c"]', 'names = ["a"]'), r"states.names: expected 3 texts .*got 1"),
    "name twice": (edited('["a", "b", "c"]', '["a", "b", "b"]'), "'b' occurs twice"),
    "name a number": (edited('["a", "b", "c"]', '["a", "b", 3]'), "states.names: expected a list of texts"),
    "operating point too long": (edited("[2]", "[2, 3]"), r"inputs.operating_point: expected 1 numbers"),
    "operating point of nobody": (edited("{flow = 1.5}", "{flw = 1.5}"), r"operating_point.flw: .*'flow'\?"),
    "unit of nobody": (edited('{level = "m"}', '{lvl = "m"}'), r"outputs.units.lvl: unknown entry 'lvl'"),
    "unit a number": (edited('{level = "m"}', "{level = 3}"), "outputs.units.level: expected text"),
    "negative step": (edited("dt = 0.0", "dt = -1.0"), "dt: must be 0"),
    "step in words": (edited("dt = 0.0", 'dt = "1 s"'), "dt: expected a number, got '1 s'"),
    "sampled twice": (edited("dt = 0.0", "dt = 1.0\nsample_time = 1.0"), "sample_time: the matrices are sampled"),
    "sample time zero": (edited("dt = 0.0", "sample_time = 0"), "sample_time: must be a positive step"),
    "fault of wrong length": (
        edited("state = [0, -1, 0]", "state = [0, -1]"),
        r"faults\[2\].state: expected 3 numbers \(one per state\), got 2 \(in 'leak'\)",
    ),
    "fault without effect": (edited("state = [0, -1, 0]", "state = [0, 0, 0]"), r"faults\[2\].state: it has no effect"),
    "fault without direction": (edited("state = [0, -1, 0]", ""), r"faults\[2\].state: say how it enters"),
    "fault without name": (edited('name = "leak"', ""), r"faults\[2\].name: this entry is required"),
    "fault twice": (edited('name = "leak"', 'name = "level sensor"'), r"faults\[2\]: .*occurs twice"),
    "unknown kind": (edited('"actuator"', '"actor"'), r"faults\[0\].kind: expected one of .*got 'actor'"),
    "unknown input": (edited('input = "pump"', 'input = "pmp"'), r"faults\[0\].input: unknown input 'pmp' .*'pump'"),
    "unknown output": (edited('output = "level"', 'output = "x"'), r"faults\[1\].output: unknown output 'x'; known"),
    "unknown state": (edited("{a = 0.1, b = 0.2}", "{d = 1}"), r"disturbances\[0\].state.d: unknown name .*a, b, c"),
    "input and state": (
        edited('input = "pump"', 'input = "pump"\nstate = [1, 0, 0]'),
        r"faults\[0\].state: not together with input",
    ),
    "input of a component": (
        edited('name = "leak"', 'name = "leak"\ninput = "pump"'),
        r"faults\[2\].input: only for kind = 'actuator'",
    ),
    "faults not tables": (edited("[noise]", "") + "", "unknown entry 'process'"),
    "faults a table": (
        'format = "residua-plant/1"\nfaults = 3\n[matrices]\nA=[[1]]\nC=[[1]]',
        r"faults: expected tables",
    ),
    "negative variance": (edited("process = 0.01", "process = -1"), "noise: .*no negative eigenvalue"),
    "covariance not symmetric": (
        edited("process = 0.01", "process = [[1, 1, 0], [0, 1, 0], [0, 0, 1]]"),
        "noise: .*symmetric",
    ),
    "noise of nobody": (edited("{flow = 0.2}", "{flw = 0.2}"), "noise.measurement.flw: unknown name 'flw'"),
    "noise twice": (
        edited("process = 0.01", "process = 0.01\nstate = [[1], [0], [0]]"),
        "noise.process: give",
    ),
    "cross of wrong size": (
        edited("process = 0.01", "process = 0.01\ncross = [[0.1, 0.0], [0, 0]]"),
        r"noise.cross: expected 3 rows",
    ),
    "cross too large": (
        edited("process = 0.01", "process = 0.01\ncross = [[0, 0], [0, 1], [0, 0]]"),
        r"noise: cross: state 'b' and output 'flow' cannot have the covariance 1",
    ),
    "cross and directions": (
        edited(
            "process = 0.01\nmeasurement = {flow = 0.2}", "cross = [[0, 0], [0, 1], [0, 0]]\nstate = [[1], [0], [0]]"
        ),
        "noise.cross: give",
    ),
    "noise columns": (
        edited("process = 0.01\nmeasurement = {flow = 0.2}", "state = [[1], [0], [0]]\noutput = [[1, 2], [3, 4]]"),
        r"noise.output: expected 1 columns",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_get_an_error_that_points_at_the_entry(case: str, tmp_path: Path) -> None:
    text, message = BAD_FILES[case]
    path = tmp_path / "tanks.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"^tanks\.toml: .*" + message):
        load_plant(path)


def test_files_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(FileFormatError, match="UTF-8"):
        load_plant(path)
    path.write_bytes(b"\xef\xbb\xbf" + TANK.encode())  # what Windows editors put in front
    assert load_plant(path).name == "tanks"
    path.write_text("a = " + "[" * 100_000, encoding="utf-8")
    with pytest.raises(FileFormatError, match="not valid TOML"):
        load_plant(path)
    with pytest.raises(FileFormatError, match="plant file not found"):
        load_plant(tmp_path / "absent.toml")


def test_a_component_fault_may_point_at_an_output_by_name_only_as_a_sensor() -> None:
    text = edited('kind = "sensor"\noutput = "level"', 'name = "x"\noutput = "level"')
    with pytest.raises(FileFormatError, match=r"faults\[1\].output: expected a list of numbers"):
        loads_plant(text)
