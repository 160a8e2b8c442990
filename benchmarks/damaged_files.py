"""Damaged files of every kind that the package reads: each is read as it was, or refused, and no monitor is blind.

Run it, all kinds with 100,000 files each, or fewer::

    .venv/bin/python benchmarks/damaged_files.py
    .venv/bin/python benchmarks/damaged_files.py --count 2000 --kinds monitor mat

It writes the counts of these kinds to ``docs/data/damaged_files.csv``, and ends with status 1 when a file ended
otherwise. With ``--seconds`` a kind ends after so long, and the table says how many files were read.
"""

from __future__ import annotations

# ruff: noqa: E402
import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import csv
import hashlib
import io
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

for _folder in (Path(__file__).parent, Path(__file__).parent.parent / "tests"):
    sys.path.insert(0, str(_folder))  # for whoever imports this file from elsewhere

from damage import LONG, damaged_bytes, damaged_table, damaged_text

import residua as rs
from residua.decide import Directional, NormThreshold, Structured
from residua.design import GeneticSearch
from residua.errors import ResiduaError
from residua.monitor.saving import EDITED
from residua.plant import dumps_plant, load_plant
from residua.plant.plant_writer import differences
from residua.recording import array_child, csv_arrow, mat_files, recording
from residua.recording.unpacked import MAX_UNPACKED

TABLE = Path(__file__).resolve().parent.parent / "docs" / "data" / "damaged_files.csv"
HEADER = ("kind of file", "damaged files", "read, the same", "read, other content", "refused", "reader ended", "wrong")
SEED = 20261122
#: Longest message; what it repeats of a file is at most 200 characters of any one entry.
LONGEST = 3000
#: Seconds that reading one file may take, on a busy machine.
PATIENCE = 120.0


@dataclass
class Outcome:
    """What became of the damaged files of one kind."""

    counts: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    wrong: list[tuple[str, bytes]] = field(default_factory=list)
    slowest: float = 0.0


@dataclass(frozen=True)
class Kind:
    """A kind of file: whole ones, what damages them, and what reading one comes to.

    ``read`` returns a word for what was read, or raises; an ``AssertionError`` is a wrong answer.
    """

    name: str
    ending: str
    samples: tuple[bytes, ...]
    damages: tuple[Callable[[random.Random, bytes], bytes], ...]
    read: Callable[[Path, bytes], str]


SAME, OTHER = "read, the same", "read, other content"


# ----------------------------------------------------------------- plants and monitors


def plant() -> rs.Plant:
    """Return two tanks with three faults, one of them a leak, and noise."""
    two = rs.Plant(
        [[0.9, 0.05], [0.05, 0.8]],
        [[0.1], [0.0]],
        [[1.0, 0.0], [0.0, 1.0]],
        dt=1.0,
        inputs=["pump"],
        outputs=["level 1", "level 2"],
        name="two tanks",
        units={"pump": "l/s"},
    ).with_operating_point(inputs=[2.0], outputs=[10.0, 5.0])
    two = two.with_sensor_faults().with_actuator_faults().with_faults({"leak": [-0.3, 0.0]}, component="tank 1")
    return two.with_noise(process=1e-4, measurement=1e-3)


def signals(steps: int, seed: int, fault: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return a recording of these tanks; the fault is an offset of the first sensor over its second half."""
    model, rng = plant(), np.random.default_rng(seed)
    u = 0.5 * np.sign(np.sin(0.05 * np.arange(steps)))[:, None]
    x, y = np.zeros(2), np.zeros((steps, 2))
    for k in range(steps):
        y[k] = x + 0.03 * rng.standard_normal(2)
        x = model.A @ x + model.B @ u[k] + 0.01 * rng.standard_normal(2)
    y[steps // 2 :, 0] += fault
    return u + 2.0, y + [10.0, 5.0]


def monitors() -> Iterator[rs.Monitor]:
    """Yield fitted monitors in the middle of their work, one for each way to test and to name."""
    model = plant()
    test = NormThreshold(window=3, persistence=2, false_alarm_rate=0.01)
    made: list[rs.Monitor] = [
        rs.Monitor(rs.design.kalman_filter(model), test=test, isolate=Directional(window=5)),
        rs.Monitor(rs.design.sensor_fault_bank(model), test=test, isolate=Structured(window=5)),
        rs.Monitor(
            rs.design.matched_filters(model, window=4), test=NormThreshold(persistence=2, false_alarm_rate=0.01)
        ),
        rs.Monitor(rs.design.detection_filter(model), test=rs.decide.PeakThreshold(window=5, false_alarm_rate=0.01)),
    ]
    for monitor in made:
        monitor.fit(*signals(3000, 1))
        monitor.update(*signals(30, 2, fault=0.5))
        yield monitor


def designs() -> Iterator[rs.Monitor]:
    """Yield monitors of which there is nothing but the design: without a threshold, or without a step."""
    model = plant()
    yield rs.Monitor(rs.design.detection_filter(model), test=NormThreshold(whiten="data"))
    continuous = rs.Plant([[-1.0, 0.2], [0.1, -2.0]], [[1.0], [0.0]], np.eye(2)).with_sensor_faults()
    yield rs.Monitor(rs.design.detection_filter(continuous))
    yield rs.Monitor(
        rs.design.unknown_input_observer(continuous.with_disturbances([[1.0], [0.0]])).residual_generator()
    )


def saved(monitor: rs.Monitor) -> bytes:
    """Return the file of a monitor."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.json"
        monitor.save(path)
        return path.read_bytes()


def edited(content: bytes) -> bytes:
    """Return the file of a monitor that says that it was edited."""
    return json.dumps(json.loads(content) | {"checksum": None}).encode()


FAULTY = signals(60, 3, fault=0.5)


def loaded_whole(path: Path, whole: bytes) -> str:
    """Read a monitor that has a checksum: nothing but what was saved."""
    monitor, table = rs.Monitor.load(path), json.loads(path.read_bytes())
    if table["checksum"] is None:  # the very damage that says that it was edited
        assert EDITED in monitor.notes, "it was edited, and does not say so"
        return OTHER
    assert table == json.loads(whole), "blind: another content was taken for what was saved"
    return SAME


def loaded_unchecked(path: Path, whole: bytes) -> str:
    """Read a monitor without a checksum: every number may be one, so what runs on clean data is finite, and it runs."""
    monitor = rs.Monitor.load(path)
    table = json.loads(path.read_bytes())
    if "checksum" in table:
        assert EDITED in monitor.notes, "it was edited, and does not say so"
    if json.loads(whole) == table:
        return SAME
    if monitor.is_fitted and monitor._generator is not None:
        channels = (len(monitor.generator.plant.inputs), monitor.generator.plant.n_outputs)
        assert channels == (1, 2), "it has other channels than its plant"
        spec = monitor._specification()
        if monitor._state is not None:
            assert_sees(monitor.update(*FAULTY), spec)
        monitor.reset()
        assert_sees(monitor.update(*FAULTY), spec)
    return OTHER


def assert_sees(found: Any, spec: Any) -> None:
    """Raise where a monitor has judged a sample by something that is no number, or judges none though it should."""
    assert np.isfinite(found.residuals[~found.missing]).all(), "blind: a residual is no number"
    assert np.isfinite(found.statistic[found.usable]).all(), "blind: a statistic is no number"
    if np.count_nonzero(~found.missing) > spec.settle + 1:  # what is out of a plausible range is missing, and counted
        assert found.usable.any(), "blind: no sample is judged"


def read_plant(path: Path, whole: bytes) -> str:
    """Read a plant file; what is read can be written, and is then read as the same."""
    found = load_plant(path)
    again = rs.plant.loads_plant(dumps_plant(found))
    assert not differences(found, again), "another plant comes back"
    return SAME if path.read_bytes() == whole else OTHER


# ------------------------------------------------------------------------- recordings

SHORT = signals(40, 4)
MODEL = plant()


def columns() -> dict[str, np.ndarray]:
    """Return a recording by column."""
    u, y = SHORT
    return {"time": np.arange(40.0), "pump": u[:, 0], "level 1": y[:, 0], "level 2": y[:, 1]}


def read_recording(path: Path, whole: bytes) -> str:
    """Read a recording; it fits the plant, its times go forward, and what is missing is counted."""
    found = rs.read_recording(path, MODEL)
    assert found.u.shape == (len(found), 1)
    assert found.y.shape == (len(found), 2)
    assert found.u.dtype == found.y.dtype == found.time.dtype == np.float64
    assert np.isfinite(found.time).all()
    assert (np.diff(found.time) > 0).all()
    assert 0 < found.dt < np.inf
    assert found.n_missing == int((~np.isfinite(found.u)).sum() + (~np.isfinite(found.y)).sum())
    same = np.array_equal(found.u, SHORT[0]) and np.array_equal(found.y, SHORT[1])
    return SAME if same else OTHER


def csv_files() -> tuple[bytes, ...]:
    """Return recordings as text: with commas, with semicolons and decimal commas, with dates, with quotes."""
    named = columns()
    rows = [[repr(float(x)) for x in row] for row in zip(*named.values(), strict=True)]
    plain = "\n".join([",".join(named), *(",".join(row) for row in rows)]) + "\n"
    european = "\r\n".join([";".join(named), *(";".join(row).replace(".", ",") for row in rows)]) + "\r\n"
    dates = "\n".join(
        [",".join(named), *(",".join([f"2026-11-22T10:00:{k:02d}", *row[1:]]) for k, row in enumerate(rows))]
    )
    quoted = "\n".join([",".join(f'"{n}"' for n in named), *(",".join(f'"{x}"' for x in row) for row in rows)])
    return tuple(text.encode() for text in (plain, european, dates, quoted))


def parquet_files() -> tuple[bytes, ...]:
    """Return recordings as Parquet, packed in several ways."""
    import pyarrow
    import pyarrow.parquet

    out = []
    for options in ({}, {"compression": "none"}, {"compression": "gzip", "use_dictionary": False}):
        file = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.table(columns()), file, **options)
        out.append(file.getvalue())
    return tuple(out)


def mat_versions() -> tuple[bytes, ...]:
    """Return recordings as .mat files: of versions 4 and 5, packed or not, also with cells and structures."""
    import scipy.io

    u, y = SHORT
    more = {"c": np.array([[np.arange(3.0)], ["text"]], dtype=object), "s": {"a": 1.0, "b": np.eye(2)}, "w": "words"}
    out = []
    for content, options in (
        ({"u": u, "y": y}, {"do_compression": True}),
        ({"u": u, "y": y}, {}),
        ({"u": u, "y": y}, {"format": "4"}),
        ({"u": u, "y": y, **more}, {"do_compression": True}),
        ({"u": u, "y": y, **more}, {}),
    ):
        file = io.BytesIO()
        scipy.io.savemat(file, content, **options)
        out.append(file.getvalue())
    return tuple(out)


def npz_files() -> tuple[bytes, ...]:
    """Return recordings as .npz files, packed or not."""
    u, y = SHORT
    out = []
    for save in (np.savez, np.savez_compressed):
        file = io.BytesIO()
        save(file, u=u, y=y)
        out.append(file.getvalue())
    return tuple(out)


class MatWorker:
    """The process that reads .mat files, kept for the next one as long as it lives: starting it takes the longest."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None
        self.ended = 0

    def read(self, path: Path) -> dict[str, np.ndarray]:
        """Return what :func:`residua.recording.mat_files.read_mat` would return."""
        if self.process is None:
            command = [sys.executable, __file__, "--read-mat-files"]
            pipe = subprocess.PIPE
            self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        target = path.with_name("arrays.npz")
        process.stdin.write(f"{path}\t{target}\n")
        process.stdin.flush()
        answer = process.stdout.readline()
        if not answer:
            self.close()
            self.ended += 1
            return mat_files.read_mat(path)  # which says how it ended, as every user's call does
        return mat_files.arrays_of(target, answer.strip(), path.name)

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


WORKER = MatWorker()


def read_mat(path: Path, whole: bytes) -> str:
    """Read a .mat file by a process that stays."""
    before = WORKER.ended
    try:
        return read_recording(path, whole)
    except ResiduaError:
        if WORKER.ended > before:
            return "reader ended"
        raise


def read_mat_files() -> None:
    """Answer for one path after the other: the program of :class:`MatWorker`."""
    array_child._die_quietly()
    for line in sys.stdin:
        path, target = line.rstrip("\n").split("\t")
        print(ascii(array_child.answer(path, MAX_UNPACKED, target))[1:-1], flush=True)


def read_both_ways(path: Path, whole: bytes) -> str:
    """Read text by the reader of large files and by the package's own: the same numbers, or the same refusal."""
    outcomes, usual = [], csv_arrow.LARGE
    for least in (0, sys.maxsize):
        csv_arrow.LARGE = least
        try:
            found = rs.read_recording(path, MODEL)
            outcomes.append((found.u.tobytes(), found.y.tobytes(), found.time.tobytes()))
        except ResiduaError as error:
            outcomes.append(str(error))
        finally:
            csv_arrow.LARGE = usual
    assert outcomes[0] == outcomes[1], f"the two readers differ: {outcomes}"[:400]
    return read_recording(path, whole)


# ------------------------------------------------------------------- snapshots of fleets

_FLEETS: dict[bytes, rs.Monitor] = {}


def snapshots() -> tuple[bytes, ...]:
    """Return snapshots of fleets in the middle of their work, one for each way to test and to name."""
    for monitor in monitors():
        fleet = rs.Fleet(monitor, plants=["north", "south", "east"])
        u, y = FAULTY
        fleet.update(np.stack([u] * 3), np.stack([y, y[::-1], y[:, ::-1]]))
        _FLEETS[fleet.snapshot()] = monitor
    return tuple(_FLEETS)


def restored_whole(path: Path, whole: bytes) -> str:
    """Restore a snapshot: nothing but what was taken."""
    found = rs.Fleet.restore(path.read_bytes(), _FLEETS[whole])
    assert found.snapshot() == whole, "blind: another content was taken for the snapshot"
    return SAME


def resealed(rng: random.Random, content: bytes) -> bytes:
    """Return a damaged snapshot with a checksum that fits, as somebody who makes one up would."""
    body = damaged_bytes(rng, content[:-32])
    return body + hashlib.sha256(body).digest()


def restored_unchecked(path: Path, whole: bytes) -> str:
    """Restore a snapshot that somebody made up: what is taken runs, and can be taken and restored again."""
    content = path.read_bytes()
    monitor, (u, y) = _FLEETS[whole], FAULTY
    found = rs.Fleet.restore(content, monitor)
    with np.errstate(all="ignore"):  # any number may stand for what a plant remembers
        found.tick(None, np.tile(u[0], (len(found), 1)), np.tile(y[0], (len(found), 1)))
        again = rs.Fleet.restore(found.snapshot(), monitor)
    assert again.plants == found.plants
    return SAME if content == whole else OTHER


# ------------------------------------------------------------------------ checkpoints

SEARCH = GeneticSearch(population=6, generations=2, polish=False)


def searched(path: Path) -> Any:
    """Return what a search finds that goes on from a checkpoint."""
    return SEARCH.minimise(lambda x: ((x - 0.3) ** 2).sum(axis=1), [-1, -1], [1, 1], checkpoint=path)


def checkpoint() -> bytes:
    """Return a checkpoint."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "search.json"
        searched(path)
        return path.read_bytes()


FOUND: dict[bytes, Any] = {}


def read_checkpoint(path: Path, whole: bytes) -> str:
    """Go on with a search; its outcome is that of the whole file."""
    if whole not in FOUND:
        damaged = path.read_bytes()
        path.write_bytes(whole)
        FOUND[whole] = searched(path)
        path.write_bytes(damaged)
    found = searched(path)
    assert np.array_equal(found.x, FOUND[whole].x), "another outcome"
    assert np.array_equal(found.history, FOUND[whole].history), "another course"
    return SAME


# ---------------------------------------------------------------------------- the run


def kinds() -> dict[str, Callable[[], Kind]]:
    """Return how each kind is made."""

    def keep_edited(rng: random.Random, content: bytes) -> bytes:
        return damaged_table(rng, content, lambda table: table.update(checksum=None))

    whole = lambda: tuple(map(saved, monitors()))  # noqa: E731
    text = (damaged_bytes, damaged_text)
    tables = (damaged_bytes, damaged_text, damaged_table, damaged_table)
    plants = lambda: (dumps_plant(plant()).encode(), dumps_plant(rs.library.three_tank()).encode())  # noqa: E731
    made = (
        ("plant (TOML)", ".toml", plants, text, read_plant),
        ("monitor (JSON)", ".json", whole, tables, loaded_whole),
        ("monitor, said to be edited", ".json", lambda: tuple(map(edited, whole())), (keep_edited,), loaded_unchecked),
        ("design (JSON)", ".json", lambda: tuple(map(saved, designs())), tables, loaded_whole),
        ("checkpoint (JSON)", ".json", lambda: (checkpoint(),), tables, read_checkpoint),
        ("CSV", ".csv", csv_files, text, read_recording),
        ("Parquet", ".parquet", parquet_files, (damaged_bytes,), read_recording),
        ("CSV, by both readers", ".csv", csv_files, text, read_both_ways),
        (".npz", ".npz", npz_files, (damaged_bytes,), read_recording),
        (".mat", ".mat", mat_versions, (damaged_bytes,), read_mat),
        ("snapshot of a fleet", ".snapshot", snapshots, (damaged_bytes,), restored_whole),
        ("snapshot with a checksum that fits", ".snapshot", snapshots, (resealed,), restored_unchecked),
    )
    return {
        name: lambda n=name, e=ending, s=samples, d=damages, r=read: Kind(n, e, s(), d, r)
        for name, ending, samples, damages, read in made
    }


def run(kind: Kind, count: int, seed: int = SEED, seconds: float = np.inf) -> Outcome:
    """Damage and read that many files, each by a seed of its own, for at most so long."""
    outcome, began = Outcome(), time.monotonic()
    usual = recording.read_mat
    if kind.ending == ".mat":
        recording.read_mat = WORKER.read
    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("error")
            path = Path(folder) / f"file{kind.ending}"
            for number in range(count):
                if time.monotonic() - began > seconds:
                    break
                _one(kind, random.Random(f"{seed} {kind.name} {number}"), path, outcome)
    finally:
        recording.read_mat = usual
        WORKER.close()
    return outcome


def _one(kind: Kind, rng: random.Random, path: Path, outcome: Outcome) -> None:
    whole = rng.choice(kind.samples)
    content = rng.choice(kind.damages)(rng, whole)
    path.write_bytes(content)
    began = time.monotonic()
    try:
        with ended():
            word = kind.read(path, whole)
    except ResiduaError as error:
        word = "refused"
        outcome.errors[type(error).__name__] += 1
        if fault := wrong_message(str(error)):
            word = "wrong"
            outcome.wrong.append((f"{fault}: {error}"[:500], content))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        word = "wrong"
        outcome.wrong.append((traceback.format_exc()[-1500:], content))
    outcome.slowest = max(outcome.slowest, time.monotonic() - began)
    outcome.counts[word] += 1


class HangError(BaseException):
    """Reading a file has taken too long."""


@contextmanager
def ended() -> Iterator[None]:
    """End what takes longer than ``PATIENCE``, where there are alarm clocks."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def ring(*_: object) -> None:
        raise HangError(f"not read after {PATIENCE:g} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def wrong_message(text: str) -> str:
    """Return what is wrong with a message, nothing where it is well."""
    if len(text) > LONGEST:
        return f"{len(text)} characters"
    if LONG[:201] in text:
        return "it repeats more than 200 characters"
    if any(ord(letter) < 32 and letter != "\n" for letter in text):
        return "it holds a control character"
    return ""


def row(name: str, outcome: Outcome) -> list[object]:
    """Return a row of the table."""
    return [name, sum(outcome.counts.values()), *(outcome.counts[word] for word in HEADER[2:])]


def written(rows: list[list[object]], path: Path) -> None:
    """Write the table: of kinds that were not run now, the rows that are there."""
    old: dict[str, list[object]] = {}
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            old = {line[0]: list(line) for line in list(csv.reader(file))[1:]}
    old |= {str(new[0]): new for new in rows}
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *(old[name] for name in kinds() if name in old)])


def main() -> int:
    """Run the campaign and write its table."""
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--count", type=int, default=100_000)
    options.add_argument("--seconds", type=float, default=np.inf)
    options.add_argument("--seed", type=int, default=SEED)
    options.add_argument("--kinds", nargs="*", default=list(kinds()))
    options.add_argument("--table", type=Path, default=TABLE)
    options.add_argument("--keep", type=Path, help="folder for the files that ended otherwise")
    chosen = options.parse_args()
    wrong = 0
    for name, make in kinds().items():
        if not any(name.startswith(word) for word in chosen.kinds):
            continue
        began = time.monotonic()
        kind = make()
        outcome = run(kind, chosen.count, chosen.seed, chosen.seconds)
        written([row(name, outcome)], chosen.table)
        print(dict(zip(HEADER, row(name, outcome), strict=True)), dict(outcome.errors), flush=True)
        print(f"  {time.monotonic() - began:.0f} s, slowest file {outcome.slowest:.2f} s", flush=True)
        wrong += len(outcome.wrong)
        for number, (text, content) in enumerate(outcome.wrong):
            if number < 3:
                print(text, flush=True)
            if chosen.keep is not None:
                (chosen.keep / f"{kind.name[:4].strip('.')}{number}{kind.ending}").write_bytes(content)
    return 1 if wrong else 0


if __name__ == "__main__":
    if "--read-mat-files" in sys.argv:
        read_mat_files()
    else:
        sys.exit(main())
