"""Recordings: the library's own simulations, and those that others made, where they are present."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

import residua as rs
from residua.decide import Directional, NormThreshold, PeakThreshold, Structured
from residua.monitor import read_recording
from same_results.designs import note_design
from same_results.ledger import Ledger
from same_results.monitors import Watch

REPOSITORY = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("RESIDUA_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))


def measure_recordings(watch: Watch) -> None:
    """Measure them all."""
    _jet_engine(watch)
    _three_tank(watch)
    _degrading_engine(watch)
    _benchmark_tank(watch)
    _many_sensors(watch)
    _engine_residuals(watch)
    _files(watch.ledger)


def _monitored(watch: Watch, case: str, made: Any, normal: Any, runs: dict[str, Any], **options: Any) -> None:
    """Fit one monitor, and run it over several recordings; the first one with page and files."""
    monitor = watch.ledger.attempt(case, lambda: rs.Monitor(made, **options))
    if monitor is None:
        return
    note_design(watch.ledger, case, made)
    for k, (name, run) in enumerate(runs.items()):
        watch.monitor(f"{case}/{name}", monitor, normal if k == 0 else None, run, page=k == 0, files=k == 0)


def _jet_engine(watch: Watch) -> None:
    """The jet engine of the literature, continuous, with the faults of its three sensors."""
    engine = rs.library.jet_engine().without_faults("fuel actuator")
    u = np.where(np.arange(2400) >= 200, 0.2, 0.0)
    runs = {}
    for fault in (None, *engine.faults):
        faults = {} if fault is None else {fault: np.where(np.arange(2400) >= 1400, 0.02, 0.0)}
        made = rs.library.simulate_jet_engine(u, dt=0.005, faults=faults, noise=1e-4, seed=5)
        runs[fault or "none"] = (made.u, made.y)
    normal = rs.library.simulate_jet_engine(u, dt=0.005, noise=1e-4, seed=6)
    for name, design in (
        ("Beard", rs.design.detection_filter(engine, poles=[-3.0] * 3)),
        ("robust", rs.design.robust_detection_filter(engine, poles=[-3.0] * 3, H0=np.zeros((3, 6)))),
        ("estimator", rs.design.fault_estimator(engine, faults=engine.faults[:1])),
    ):
        _monitored(watch, f"jet engine/{name}", design, (normal.u, normal.y), runs, dt=0.005)


def _three_tank(watch: Watch) -> None:
    """The three tanks, with leaks, clogs and sensors that fail."""
    plant = rs.library.three_tank()
    normal = rs.library.simulate_three_tank(3000, seed=1)
    runs = {}
    for number in (4, 7, 9, 11):
        made = rs.library.simulate_three_tank(1200, faults=rs.library.three_tank_fault(number, 1200), seed=number)
        runs[f"fault {number}"] = (made.u, made.y)
    for name, design, options in _tank_monitors(plant):
        _monitored(watch, f"three tank/{name}", design, (normal.u, normal.y), runs, **options)


def _tank_monitors(plant: rs.Plant) -> list[tuple[str, Any, dict[str, Any]]]:
    kalman, bank = rs.design.kalman_filter(plant), rs.design.sensor_fault_bank(plant, observer="minimal")
    return [
        ("direction", kalman, {"isolate": Directional(window=300)}),
        ("peak", kalman, {"test": PeakThreshold(window=30)}),
        ("each", kalman, {"test": NormThreshold(groups="each", window=10, persistence=5)}),
        ("bank", bank, {"test": NormThreshold(window=30, persistence=10)}),
        ("bank, peak", bank, {"test": PeakThreshold(window=30), "isolate": Structured(window=100)}),
        ("matched", rs.design.matched_filters(plant, window=60), {}),
        ("parity", rs.design.parity_relations(plant), {"test": NormThreshold(window=10)}),
    ]


def _degrading_engine(watch: Watch) -> None:
    """The engine of the robust bounds, with a dedicated bank: sensors that drift one after the other."""
    loop = rs.library.degrading_jet_engine().in_closed_loop(rs.library.degrading_jet_engine_controller())
    plant = loop.nominal.without_disturbances()
    names = plant.faults
    drifts = {name: rs.library.drift(5.0 + 5 * k, 0.5) for k, name in enumerate(names)}
    normal = rs.library.simulate_degrading_jet_engine(20.0, seed=1)
    faulty = rs.library.simulate_degrading_jet_engine(20.0, faults=drifts, seed=2)
    rows = ["".join("1" if i == j else "0" for i in range(len(names))) for j in range(len(names))]
    bank = watch.ledger.attempt("degrading engine", lambda: rs.design.structured_bank(plant, rows))
    if bank is None:
        return
    for name, test in (("norm", NormThreshold()), ("peak", PeakThreshold(window=60)), ("given", PeakThreshold(2.0))):
        runs = {"drifts": (None, faulty.y)}
        _monitored(watch, f"degrading engine/{name}", bank, (None, normal.y), runs, test=test)


def _benchmark_tank(watch: Watch) -> None:
    """The recordings of the three-tank benchmark that others made."""
    folder = DATA / "three_tank_dts200"
    if not folder.is_dir():
        return
    content = scipy.io.loadmat(folder / "test_5ch.mat") | scipy.io.loadmat(folder / "train_5ch.mat")
    normal = content["normal"][:4000]
    runs = {f"fault{n:02d}": (content[f"fault{n:02d}"][:, :2], content[f"fault{n:02d}"][:, 2:]) for n in range(1, 13)}
    for name, design, options in _tank_monitors(rs.library.three_tank()):
        case = f"three_tank_dts200/{name}"
        _monitored(watch, case, design, (normal[:, :2], normal[:, 2:]), runs, **options)


def _many_sensors(watch: Watch) -> None:
    """The chemical plant, of which there is no model: 52 channels less their means."""
    folder = DATA / "tep"
    if not folder.is_dir():
        return
    normal = np.loadtxt(folder / "d00_te.dat")
    plant = rs.Plant(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((52, 0)), dt=180.0).with_sensor_faults()
    center, spread = normal.mean(axis=0), normal.std(axis=0)
    runs = {f"d{n:02d}": (None, (np.loadtxt(folder / f"d{n:02d}_te.dat") - center) / spread) for n in (1, 4, 5, 11, 14)}
    for name, test in (
        ("whole", NormThreshold()),
        ("each", NormThreshold(groups="each", persistence=2)),
        ("peak", PeakThreshold(window=20)),
    ):
        made = watch.ledger.attempt(f"tep/{name}/design", lambda: rs.design.parity_relations(plant))
        if made is not None:
            _monitored(watch, f"tep/{name}", made, (None, (normal - center) / spread), runs, test=test)


def _engine_residuals(watch: Watch) -> None:
    """Residuals of a real engine, which fired and how they are read."""
    path = DATA / "engine_frisk_residuals" / "data.mat"
    if not path.exists():
        return
    modes, res, mode, codes = scipy.io.loadmat(path, squeeze_me=True)["data"].item()
    codes, faults = np.asarray(codes[:, 1:], dtype=bool), [str(name) for name in modes[1:]]
    fired = np.abs(np.asarray(res, dtype=float)[:: max(1, len(res) // 2000)]) > 1
    index, readings = rs.decide.read_codes(fired, codes, faults)
    watch.ledger.note("engine_frisk", "readings", index, *readings)
    watch.ledger.note("engine_frisk", "likelihoods", *rs.decide.code_likelihoods(fired, codes))
    watch.ledger.note("engine_frisk", "modes", mode)


def _files(ledger: Ledger) -> None:
    """Files of others, as they are read."""
    calls: list[tuple[Path, Callable[[Path], Any]]] = []
    gaps: dict[str, Any] = {"fill_gaps": True}
    calls += [(path, lambda p: read_recording(p, **gaps)) for path in sorted((DATA / "skab").glob("*/*.csv"))[::4]]
    calls += [(DATA / "lbnl_ahu" / "SZVAV.csv", lambda p: read_recording(p, **gaps))]
    calls += [
        (path, lambda p: read_recording(p, dt=180.0, transpose=p.name == "d00.dat"))
        for path in sorted((DATA / "tep").glob("d0*.dat"))[::3]
    ]
    names = ["time", "P1", "P2", "T", "F", "CV", "X", "PV", "F74", "P74", "T74"]
    calls += [
        (path, lambda p: read_recording(p, columns=names, transpose=True))
        for path in sorted((DATA / "damadics").glob("*.mat"))
    ]
    for path, read in calls:
        if path.exists():
            note_file(ledger, path, read)


def note_file(ledger: Ledger, path: Path, read: Callable[[Path], Any]) -> None:
    """Keep what is read of a file."""
    case = f"file/{path.parent.name}/{path.name}"
    made = ledger.attempt(case, lambda: read(path))
    if made is not None:
        ledger.note(case, "signals", made.time, made.u, made.y)
        ledger.note(case, "facts", made.dt, sorted(made.columns.items()), made.origin, made.n_missing, made.notes)
