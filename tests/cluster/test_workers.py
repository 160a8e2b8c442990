"""Workers of joblib, Dask and Ray give the alarms of one process; a worker that is killed loses and doubles nothing."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from cluster_examples import SAMPLES, expected, in_order, monitor, recordings
from residua.cluster import packed_table
from residua.cluster.workers import BatchEvents, Diagnosed, ShardColumn, diagnose_many
from residua.decide import Alarm
from residua.errors import DataError, MissingExtraError, NotFittedError

pytest.importorskip("pyarrow")
pytest.importorskip("joblib")

#: Engines start processes that go on after what started them is forgotten; none of it is ours.
pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(scope="module")
def dask() -> Iterator[Any]:
    """A cluster of two worker processes."""
    distributed = pytest.importorskip("distributed", reason="Dask is not installed (make test-cluster)")
    import dask as settings

    with (
        settings.config.set({"dataframe.convert-string": False}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def ray() -> Iterator[Any]:
    """Ray with two workers."""
    ray = pytest.importorskip("ray", reason="Ray is not installed (make test-cluster)")
    ray.init(num_cpus=2, include_dashboard=False, _node_ip_address="127.0.0.1", log_to_driver=False)
    yield ray
    ray.shutdown()


def alone() -> list[Diagnosed]:
    """Return what one process makes of the recordings."""
    made = [(name, monitor().run(*one)) for name, one in recordings().items()]
    return [Diagnosed(name, one.alarms, one.notes) for name, one in made if isinstance(one, rs.Diagnosis)]


def events_of(frame: Any) -> list[tuple[Any, ...]]:
    """Return the rows of a data frame of events as they are compared."""
    made = []
    for row in frame.to_dict("records"):
        ended = None if row["ended"] is None or np.isnan(row["ended"]) else row["ended"]
        names, scores = tuple(row["names"]), tuple(row["scores"])
        made.append((row["plant"], row["sample"], row["kind"], row["onset"], row["raised"], ended, names, scores))
    return in_order(made)


def deadly(function: Any, end: Any) -> Any:
    """Return a function of batches that ends the process that runs it, once; workers get it by value."""

    def run(batch: Any) -> Any:
        made = function(batch)
        end()
        return made

    return run


def deadly_array(values: np.ndarray, end: Any) -> Any:
    """Return an array: whoever reads it ends, once; workers get it by value."""

    class Deadly:
        def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
            end()
            return values

    return Deadly()


# ---------------------------------------------------------------------------- recordings


def as_files(folder: Path) -> list[Path]:
    """Return the recordings as files."""
    paths = []
    for name, (u, y) in recordings().items():
        paths.append(folder / f"{name}.npz")
        np.savez(paths[-1], pump=u[:, 0], low=y[:, 0], high=y[:, 1])
    return paths


def check_many(backend: str, folder: Path) -> None:
    """Run recordings as arrays and as files; what cannot be read is put aside."""
    bad = {"short": (np.zeros((9, 1)), np.zeros((8, 2))), "absent": folder / "none.npz"}
    made = diagnose_many({**recordings(), **bad}, monitor(), backend, workers=2, batch=3)
    assert made[:-2] == alone()
    assert [one.name for one in made[-2:]] == ["short", "absent"]
    assert all(one.reason and not one.alarms for one in made[-2:])
    paths = as_files(folder)
    made = diagnose_many(paths, monitor(), backend, workers=2, batch=8)
    assert [one.name for one in made] == paths
    assert [one.alarms for one in made] == [one.alarms for one in alone()]


def test_there_are_alarms_to_compare() -> None:
    alarms = [alarm for one in alone() for alarm in one.alarms]
    assert len(alarms) >= 10
    assert all(isinstance(alarm, Alarm) for alarm in alarms)


@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_joblib_gives_the_alarms_of_one_process(backend: str, tmp_path: Path) -> None:
    check_many(backend, tmp_path)


def test_dask_gives_the_alarms_of_one_process(dask: Any, tmp_path: Path) -> None:
    check_many("dask", tmp_path)


def test_ray_gives_the_alarms_of_one_process(ray: Any, tmp_path: Path) -> None:
    check_many("ray", tmp_path)


def check_killed(backend: str, end: Any, ended: Any) -> None:
    """A worker ends while it reads a recording in the middle."""
    deadly_one: Any = {name: (u, deadly_array(y, end)) if k == 11 else (u, y) for k, (name, (u, y)) in _numbered()}
    made = diagnose_many(deadly_one, monitor(), backend, workers=2)
    assert ended()
    assert made == alone()


def _numbered() -> Any:
    return enumerate(recordings().items())


def test_a_killed_worker_of_joblib_loses_nothing(ends_worker: Any, ended: Any) -> None:
    check_killed("loky", ends_worker(0), ended)


def test_a_killed_worker_of_dask_loses_nothing(dask: Any, ends_worker: Any, ended: Any) -> None:
    check_killed("dask", ends_worker(0), ended)


def test_a_killed_worker_of_ray_loses_nothing(ray: Any, ends_worker: Any, ended: Any) -> None:
    check_killed("ray", ends_worker(0), ended)


def test_a_worker_that_always_ends_is_an_error() -> None:
    """Work that ends whoever does it is not tried for ever."""
    u, y = recordings()[100]
    end = lambda: __import__("os").kill(__import__("os").getpid(), 9)  # noqa: E731
    with pytest.raises(BrokenExecutor):
        diagnose_many([(u, deadly_array(y, end))], monitor(), "loky", workers=2, retries=1)


# --------------------------------------------------------------------------- packed rows


def dask_frame(pieces: int) -> Any:
    dataframe = pytest.importorskip("dask.dataframe")
    table = packed_table(monitor(), recordings(), samples=13).to_pandas()
    shuffled = table.sample(frac=1.0, random_state=3)
    return dataframe.from_pandas(shuffled, npartitions=pieces, sort=False)


def test_partitions_of_dask_give_the_events_of_one_process(dask: Any) -> None:
    events = BatchEvents(monitor())
    for pieces in (2, 5):
        frame = dask_frame(4).shuffle("plant", npartitions=pieces)
        made = frame.map_partitions(events, meta=events(frame._meta)).compute()
        assert events_of(made) == expected()


def test_texts_in_place_of_arrays_are_refused() -> None:
    frame = packed_table(monitor(), recordings()).to_pandas()
    frame["values"] = frame["values"].astype(str)
    with pytest.raises(DataError, match=r"dataframe\.convert-string"):
        BatchEvents(monitor())(frame)


def test_a_killed_worker_of_dask_doubles_nothing(dask: Any, ends_worker: Any, ended: Any) -> None:
    events = BatchEvents(monitor())
    frame = dask_frame(4).shuffle("plant", npartitions=5)
    made = frame.map_partitions(deadly(events, ends_worker(0)), meta=events(frame._meta)).compute()
    assert ended()
    assert events_of(made) == expected()


def ray_shards(ray: Any, shards: int) -> Any:
    data = pytest.importorskip("ray.data")
    data.DataContext.get_current().enable_progress_bars = False
    table = packed_table(monitor(), recordings(), samples=13)
    rows = np.random.default_rng(3).permutation(len(table))
    dataset = data.from_arrow(table.take(rows)).repartition(3)
    return dataset.map_batches(ShardColumn(shards), batch_format="pyarrow").groupby("shard")


def test_batches_of_ray_give_the_events_of_one_process(ray: Any) -> None:
    made = ray_shards(ray, 4).map_groups(BatchEvents(monitor()), batch_format="pyarrow")
    assert events_of(made.to_pandas()) == expected()


def test_a_killed_worker_of_ray_doubles_nothing(ray: Any, ends_worker: Any, ended: Any) -> None:
    function = deadly(BatchEvents(monitor()), ends_worker(0))
    made = ray_shards(ray, 4).map_groups(function, batch_format="pyarrow")
    assert events_of(made.to_pandas()) == expected()
    assert ended()


def test_rows_whose_beginning_is_in_another_batch_are_put_aside() -> None:
    table = packed_table(monitor(), recordings(), samples=SAMPLES // 2)
    later = table.filter(table.column("start").to_numpy() > 0)
    causes = BatchEvents(monitor())(later).column("cause").to_pylist()
    assert causes == ["begin"] * len(later)
    assert "begin" not in BatchEvents(monitor(), from_zero=False)(later).column("cause").to_pylist()


# -------------------------------------------------------------------------------- refusals


def test_what_cannot_run_is_said() -> None:
    with pytest.raises(DataError, match="batch_format='pyarrow'"):
        BatchEvents(monitor())({"plant": np.zeros(1)})
    with pytest.raises(DataError, match="table of Arrow is expected"):
        ShardColumn(2)({"plant": np.zeros(1)})
    blank = rs.design.unknown_input_observer(rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1).with_sensor_faults())
    with pytest.raises(NotFittedError):
        diagnose_many([], rs.Monitor(blank.residual_generator()))


@pytest.mark.parametrize(
    ("package", "backend"), [("joblib", None), ("ray.util.joblib", "ray"), ("distributed", "dask")]
)
def test_an_engine_that_is_absent_is_named(package: str, backend: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(MissingExtraError, match=package.partition(".")[0]):
        diagnose_many(recordings(), monitor(), backend)
