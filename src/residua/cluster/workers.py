"""A monitor on the workers of Ray, Dask and joblib: whole recordings, and batches of packed rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from residua.cluster.monitor_text import monitor_of_text, text_of_monitor
from residua.cluster.packed_rows import PackedRows, checked_shards, shard_of
from residua.cluster.shard import LONGEST_GAP, Shard
from residua.decide.alarm import Alarm
from residua.decide.checks import check_samples
from residua.errors import DataError, FileFormatError, missing_extra
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.monitor import Monitor
from residua.visible import echo, shortened

#: Batches of recordings for a worker, after which results are safe from the end of another worker.
_BATCHES_TO_EACH = 8
#: The classes of errors that say that a worker has ended: of loky and processes, and of Ray. Dask tries again itself.
_ENDED = {"BrokenExecutor", "RayActorError", "WorkerCrashedError"}
#: Characters of a reason.
_MOST = 1000


@dataclass(frozen=True)
class Diagnosed:
    """Result of a worker on a recording.

    Attributes
    ----------
    name : object
        Of the recording: its key in a mapping, its path, or its number in a sequence.
    alarms : tuple of Alarm
        As :meth:`residua.Monitor.run` has them.
    notes : tuple of str
    reason : str
        Why the recording was put aside, if it was: it could not be read, or does not fit the plant. Empty otherwise.
    """

    name: Any
    alarms: tuple[Alarm, ...]
    notes: tuple[str, ...]
    reason: str = ""


def diagnose_many(
    recordings: Mapping[Any, Any] | Sequence[Any],
    monitor: Monitor,
    backend: str | None = None,
    *,
    workers: int | None = None,
    batch: int = 1,
    retries: int = 2,
) -> list[Diagnosed]:
    """Run a monitor over many recordings, on the workers of a backend of ``joblib``.

    Parameters
    ----------
    recordings : mapping or sequence of recordings
        Each the path of a file that the workers can read, a data frame, a :class:`residua.monitor.Recording`, or a pair
        ``(u, y)``.
    monitor : Monitor
        Fitted. It travels as its record in JSON.
    backend : str, optional
        ``"dask"``, where a ``distributed.Client`` is there; ``"ray"``; or ``"loky"``, ``"threading"``, ... of joblib.
        The one that ``joblib.parallel_config`` has set when omitted.
    workers : int, optional
        How many; all that the backend has when omitted.
    batch : int
        Recordings that go to a worker together: more of short ones.
    retries : int
        How often work is done again whose worker has ended, in all. Dask counts by itself (``allowed-failures``).

    Returns
    -------
    list of Diagnosed
        In the order of the recordings; each is there once, whatever happened to the workers.

    Raises
    ------
    NotFittedError
        If the monitor has no threshold.
    MissingExtraError
        If joblib, or the package of the backend, is not installed.

    Notes
    -----
    To run a recording changes nothing but what is returned, so that work that was lost can be done again.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> from residua.cluster.workers import diagnose_many
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> u, y = np.ones((80, 1)), np.where(np.arange(80) < 50, 1.0, 2.0)[:, None]
    >>> north, south = diagnose_many({"north": (u, y), "south": (u, y[:, :0])}, monitor, "threading")
    >>> north.name, north.alarms[0].raised
    ('north', 50.0)
    >>> south.reason
    'y must be (time, 1) ...'
    """
    joblib = _joblib(backend)
    text = text_of_monitor(monitor)
    check_samples(batch, "batch")
    check_samples(retries, "retries", least=0)
    if isinstance(recordings, Mapping):
        named = list(recordings.items())
    else:  # by their paths, or their numbers
        paths = [isinstance(one, str) or hasattr(one, "__fspath__") for one in recordings]
        named = [(one if paths[k] else k, one) for k, one in enumerate(recordings)]
    todo = [named[k : k + batch] for k in range(0, len(named), batch)]
    done: list[Diagnosed] = []
    config = {} if backend is None else {"backend": backend}
    with joblib.parallel_config(**config, n_jobs=-1 if workers is None else workers):
        at_once = max(1, joblib.effective_n_jobs()) * _BATCHES_TO_EACH
        while todo:
            now = todo[:at_once]
            try:
                parts = joblib.Parallel()(joblib.delayed(diagnosed)(text, part) for part in now)
            except Exception as error:
                if retries == 0 or not _has_ended(error):
                    raise
                retries -= 1
                continue
            done += [one for part in parts for one in part]
            todo = todo[at_once:]
    return done


def diagnosed(text: str, named: Sequence[tuple[Any, Any]]) -> list[Diagnosed]:
    """Run a monitor, given as text, over recordings with their names: the work of a worker."""
    monitor, out = monitor_of_text(text), []
    for name, recording in named:
        pair = isinstance(recording, tuple) and len(recording) == 2
        try:
            diagnosis = monitor.run(*recording) if pair else monitor.run(recording)
            if not isinstance(diagnosis, Diagnosis):
                raise DataError(f"a recording is of one plant, got {len(diagnosis)} at once")
        except (DataError, FileFormatError) as error:
            out.append(Diagnosed(name, (), (), shortened(str(error), _MOST)))
        else:
            out.append(Diagnosed(name, diagnosis.alarms, diagnosis.notes))
    return out


def _has_ended(error: BaseException) -> bool:
    """Tell whether an error means that a worker has ended."""
    return any(kind.__name__ in _ENDED for kind in type(error).__mro__)


def _joblib(backend: str | None) -> Any:
    """Return joblib, with the backend of another package registered."""
    joblib = _imported("joblib", "workers")
    if backend == "ray":
        _imported("ray.util.joblib", "ray").register_ray()
    if backend == "dask":
        _imported("distributed", "dask")
    return joblib


def _imported(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise missing_extra(module.partition(".")[0], extra) from error


# ---------------------------------------------------------------------------- packed rows


class BatchEvents:
    """Conversion of packed rows to events of alarms, for ``map_batches`` and ``map_groups`` of Ray Data, and
    for ``map_partitions`` of Dask.

    All rows of a plant must be in one batch. Rows whose beginning is elsewhere are put aside (``begin``).

    Parameters
    ----------
    monitor : Monitor
        Fitted. It travels as its record in JSON.
    plants : collection of ids, optional
        Those that are known; records of others are put aside.
    longest_gap : int
        Samples that did not come count as missing, as far as this; a record that is further ahead is put aside.
    from_zero : bool
        Whether a plant whose first record does not begin at its sample 0 is put aside.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> from residua.cluster import packed_table
    >>> from residua.cluster.workers import BatchEvents
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> u, y = np.ones((80, 1)), np.where(np.arange(80) < 50, 1.0, 2.0)[:, None]
    >>> table = packed_table(monitor, {"north": (u, y), "south": (u, np.ones((80, 1)))})
    >>> BatchEvents(monitor)(table).select(["kind", "plant", "onset", "raised"]).to_pylist()
    [{'kind': 'raised', 'plant': 'north', 'onset': 50.0, 'raised': 50.0}]
    """

    def __init__(
        self,
        monitor: Monitor,
        *,
        plants: Collection[Any] | None = None,
        longest_gap: int = LONGEST_GAP,
        from_zero: bool = True,
    ) -> None:
        self.__name__ = type(self).__name__  # Ray asks a function for it
        self._text = text_of_monitor(monitor)
        self._settings: dict[str, Any] = {
            "plants": None if plants is None else frozenset(plants),
            "longest_gap": longest_gap,
            "from_zero": from_zero,
        }

    def __call__(self, batch: Any) -> Any:
        """Return the events of a table of Arrow as another table, or of a data frame of pandas as a data frame."""
        if isinstance(batch, Mapping):
            raise DataError("packed rows come as tables: batch_format='pyarrow' or 'pandas'")
        shard = Shard(monitor_of_text(self._text), **self._settings)
        if hasattr(batch, "schema"):
            whole = str(batch.schema.field("plant").type).startswith("int")
            return shard.take(PackedRows.of_arrow(batch)).arrow(whole)
        whole = batch["plant"].dtype.kind in "if"
        return shard.take(PackedRows.of_columns(batch)).arrow(whole).to_pandas()


class ShardColumn:
    """Addition of its plant's shard to each packed row, for ``map_batches`` of Ray Data, by which to group.

    Parameters
    ----------
    shards : int

    Examples
    --------
    >>> import pyarrow as pa
    >>> from residua.cluster.workers import ShardColumn
    >>> ShardColumn(4)(pa.table({"plant": ["north", "south"]})).to_pydict()
    {'plant': ['north', 'south'], 'shard': [2, 0]}
    """

    def __init__(self, shards: int) -> None:
        self._shards = checked_shards(shards)

    def __call__(self, batch: Any) -> Any:
        """Return a table of Arrow with one more column."""
        if not hasattr(batch, "append_column"):
            raise DataError(f"a table of Arrow is expected (batch_format='pyarrow'), got {echo(type(batch).__name__)}")
        numbers = [0 if plant is None else shard_of(plant, self._shards) for plant in batch.column("plant").to_pylist()]
        return batch.append_column("shard", [numbers])


__all__ = ["BatchEvents", "Diagnosed", "ShardColumn", "diagnose_many"]
