"""Recordings larger than memory: decisions of a monitor are written to disk, and judged from there.

The pieces of the recording go through ``run_block`` one by one, which gives the same bits as the whole; what it leaves
is written to files without a name, which vanish with the process, however that ends. Mapped into memory, those files
are the arrays of an ordinary :class:`residua.Diagnosis`: alarms, names, sizes and notes come from the same code.
"""

from __future__ import annotations

import mmap
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from residua.errors import FileFormatError
from residua.files import check_input
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fused import run_block
from residua.monitor.outcome import Recorded, compared_outputs, diagnosis_from
from residua.monitor.running import Decisions, initial_state
from residua.plant import Plant
from residua.recording.columns import ReadOptions, settled_step
from residua.recording.recording import read_recording
from residua.recording.streams import NotServedError, Stream, open_stream
from residua.recording.table_writer import check_table, write_table
from residua.recording.time_axis import regular_step, seconds_since

if TYPE_CHECKING:
    from residua.monitor.monitor import Monitor

#: Seconds after which pages that were read from the disk leave memory: the system would keep them while there is room.
_MOMENT = 0.02
Progress = Callable[[int, int], None]
#: Remark on a file that was not read piece by piece.
AT_ONCE = (
    "the file was read into memory at once: run_file reads Parquet, uncompressed .npz, and CSV with a header, plain "
)
AT_ONCE += "numbers and times in seconds piece by piece"


class _Column:
    """An array that is written piece by piece to an unnamed file; zeros take no room on the disk."""

    def __init__(self, folder: str | None) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (the spool closes it)
        self._map: mmap.mmap | None = None
        self._dtype: np.dtype = np.dtype(float)
        self._shape: tuple[int, ...] = ()
        self.rows = 0

    def append(self, values: NDArray) -> None:
        """Write the next rows."""
        self._dtype, self._shape = values.dtype, values.shape[1:]
        content = np.ascontiguousarray(values)
        self.rows += len(values)
        if not content.size:
            return
        try:
            octets = content.reshape(-1).view(np.uint8)
            if octets.any():
                self._file.write(octets.data)
            else:
                self._file.seek(content.nbytes, 1)
        except OSError as error:
            raise _no_room(error) from error

    def mapped(self) -> NDArray:
        """Return all rows as a memory map."""
        if not self.rows or not np.prod(self._shape):
            return np.zeros((self.rows, *self._shape), dtype=self._dtype)
        try:
            self._file.truncate()
            self._file.flush()
        except OSError as error:
            raise _no_room(error) from error
        self._map = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(self._map, dtype=self._dtype).reshape(self.rows, *self._shape)

    def forget(self) -> None:
        """Release the memory of the rows that were read."""
        if self._map is not None and sys.platform != "win32":
            self._map.madvise(mmap.MADV_DONTNEED)

    def close(self) -> None:
        """Release the room on the disk, once nothing shows the rows any more."""
        self._file.close()


def _no_room(error: OSError) -> FileFormatError:
    return FileFormatError(
        f"{tempfile.gettempdir()}: the decisions of the monitor cannot be stored there: "
        f"{error.strerror or error}; they take some 200 bytes a sample: set another folder by TMPDIR"
    )


class Spool:
    """Arrays of decisions that are written piece by piece, and read back by memory map."""

    def __init__(self, folder: str | None = None) -> None:
        self._folder = folder
        self._columns: dict[tuple[str, ...], _Column] = {}
        self._over = threading.Event()
        self._forgetting: threading.Thread | None = None

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        if self._forgetting is not None:
            self._forgetting.join()
        self.clear()

    def clear(self) -> None:
        """Release the room on the disk."""
        for column in self._columns.values():
            column.close()
        self._columns = {}

    def append(self, whole: Any, *place: str) -> None:
        """Write the next rows of an array, or of a dataclass of arrays."""
        if isinstance(whole, np.ndarray):
            column = self._columns.get(place)
            if column is None:
                column = self._columns[place] = _Column(self._folder)
            column.append(whole)
        elif is_dataclass(whole):
            for one in fields(whole):
                self.append(getattr(whole, one.name), *place, one.name)

    def mapped(self, template: Any, *place: str) -> Any:
        """Return everything that was written, as arrays in a structure like the template."""
        if isinstance(template, np.ndarray):
            return self._columns[place].mapped()
        if template is None:
            return None
        names = [one.name for one in fields(template)]
        return type(template)(**{name: self.mapped(getattr(template, name), *place, name) for name in names})

    def forget_now_and_then(self) -> None:
        """Bound the memory of the process for the files that it reads."""

        def forgetting() -> None:
            while not self._over.wait(_MOMENT):
                for column in self._columns.values():
                    column.forget()

        self._forgetting = threading.Thread(target=forgetting, daemon=True)
        self._forgetting.start()


@contextmanager
def judged_file(
    monitor: Monitor, path: Path, options: ReadOptions, progress: Progress | None = None
) -> Iterator[Diagnosis | None]:
    """Run a monitor over a file in constant memory; the arrays of the diagnosis are on disk, and end with the block.

    ``None``: the file is not read piece by piece, and must be read at once.

    Parameters
    ----------
    monitor : Monitor
    path : Path
    options : ReadOptions
    progress : callable, optional
        Called with (samples done, samples in all, as estimated by the part of the file that is read).

    Raises
    ------
    DataError
        As of :func:`residua.read_recording`.
    """
    with Spool() as spool:
        try:
            made = _judged(monitor, open_stream(path, options), options, spool, progress)
        except NotServedError:
            made = None
            spool.clear()
        yield made


def _judged(
    monitor: Monitor, stream: Stream, options: ReadOptions, spool: Spool, progress: Progress | None
) -> Diagnosis:
    source = stream.path.name
    step = settled_step(None, options, source) if stream.clock is None else 0.0
    if stream.clock is None:
        monitor._learn_step(step)
    elif monitor._generator is None:
        monitor._learn_step(settled_step(_step(spool, stream, options), options, source))
    generator, spec = monitor.generator, monitor._specification()
    state, rows, origin = initial_state(spec, 1), 0, None
    template: Decisions | None = None
    for piece in stream.pieces():
        data = monitor._block(piece.values[:, : stream.inputs], piece.values[:, stream.inputs :])
        state, part = run_block(spec, state, data)
        one = part.of(0)
        template = template or one
        spool.append(one, "decisions")
        spool.append(data[0], "signals")
        if piece.time is None:
            spool.append(np.arange(rows, rows + len(data[0]), dtype=np.float64) * step, "time")
        else:
            origin = _first(piece.time) if origin is None else origin
            spool.append(_since(piece.time, origin), "time")
        rows += len(data[0])
        if progress is not None:
            progress(rows, max(rows, int(rows / piece.done)) if piece.done else rows)
    if template is None or rows < 2:
        raise NotServedError("it has fewer than two rows")
    spool.forget_now_and_then()
    time = spool.mapped(np.zeros(0), "time")
    if stream.clock is not None:
        settled = settled_step(_regular(time, options, stream), options, source)
        monitor._learn_step(settled)
    monitor._go_on_from(state, spec)
    decisions, signals = spool.mapped(template, "decisions"), spool.mapped(np.zeros(0), "signals")
    told = (*monitor.notes, *(monitor._check.notes if monitor._check else ()), *stream.notes)
    recorded = Recorded(time, signals, source, _text(origin), compared_outputs(monitor.design))
    return diagnosis_from(decisions, recorded, spec, generator, state.filter, 0, told, monitor._bounds, monitor._check)


def _first(time: NDArray) -> Any:
    return time[0]


def _since(time: NDArray, origin: Any) -> NDArray[np.float64]:
    """Return times in seconds; dates count from the first one."""
    return seconds_since(time, origin) if time.dtype.kind == "M" else time


def _text(origin: Any) -> str:
    return str(np.datetime_as_string(origin, unit="auto")) if isinstance(origin, np.datetime64) else ""


def _step(spool: Spool, stream: Stream, options: ReadOptions) -> float:
    """Return the step of a recording from its times alone, for a generator that is not sampled yet."""
    origin = None
    for piece in stream.pieces():
        assert piece.time is not None
        origin = _first(piece.time) if origin is None else origin
        spool.append(_since(piece.time, origin), "times before")
    if origin is None:
        raise NotServedError("it has no rows")
    time = spool.mapped(np.zeros(0), "times before")
    if len(time) < 2:
        raise NotServedError("it has fewer than two rows")
    return _regular(time, options, stream)


def _regular(time: NDArray[np.float64], options: ReadOptions, stream: Stream) -> float:
    """Return the step of regular times; without the median if all steps are nearly equal."""
    low, high, last = np.inf, -np.inf, np.nan
    for start in range(0, len(time) - 1, 1 << 20):
        part = time[start : start + (1 << 20) + 1]
        steps = np.diff(part)
        low, high, last = min(low, float(steps.min())), max(high, float(steps.max())), float(part[-1])
    if np.isfinite([low, high, last]).all() and low > 0 and high - low < options.near * low:
        return float((time[-1] - time[0]) / (len(time) - 1))
    return regular_step(np.asarray(time), options.near, stream.first_row, stream.path.name)


def run_file(
    monitor: Monitor,
    path: str | Path,
    *,
    residuals: str | Path | None = None,
    alarms: str | Path | None = None,
    report: str | Path | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Run a monitor over a file that may be larger than memory, from a fresh start.

    Alarms, names, sizes and notes are those of :meth:`residua.Monitor.run`, to the last bit. Memory does not grow with
    the recording; decisions are stored on disk meanwhile, some 200 bytes a sample, in the folder for temporary
    files.

    Parameters
    ----------
    monitor : Monitor
    path : str or Path
        As :func:`residua.read_recording` reads it for the plant. Parquet, uncompressed .npz, and CSV with a header,
        plain numbers and times in seconds are read piece by piece; anything else at once, and a note says so.
    residuals : str or Path, optional
        Where to write time, residuals, statistic, alarm and scores of every sample: .csv or .parquet.
    alarms : str or Path, optional
        Where to write one JSON object per alarm and line.
    report : str or Path, optional
        Where to write the page.
    progress : callable, optional
        Called with (samples done, samples in all, an estimate until the last one).

    Returns
    -------
    Diagnosis
        Of a recording of more than 20,000 samples ``thinned``: its series are the extremes of bins of samples.

    Raises
    ------
    DataError
        As of :func:`residua.read_recording`, with the row; no output file is left then.
    FileFormatError
        If the file cannot be read, an output not be written, or the disk is full; no file is left half-written.

    Notes
    -----
    The state of the monitor afterwards is that at the end of the recording, as after ``run``.

    See Also
    --------
    residua.Monitor.run : the same in memory.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> import tempfile
    >>> from pathlib import Path
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> path = Path(tempfile.mkdtemp()) / "day.npz"
    >>> np.savez(path, valve=np.ones(200), level=np.where(np.arange(200) < 100, 1.0, 2.0))
    >>> monitor.run_file(path).onset
    100.0
    """
    path = Path(path)
    check_input(path, "recording")
    if residuals is not None:
        check_table(residuals)
    plant: Plant = monitor.design.plant
    options = ReadOptions(plant, None, None, None, None)
    with judged_file(monitor, path, options, progress) as whole:
        if whole is None:
            made = monitor.run(read_recording(path, plant), progress=progress)
            assert isinstance(made, Diagnosis)
            made = replace(made, notes=(*made.notes, AT_ONCE))
            write_outputs(made, report=report, alarms=alarms, residuals=residuals)
            return made
        write_outputs(whole, report=report, alarms=alarms, residuals=residuals)
        return whole.thinned_to_draw("" if residuals is None else str(residuals))


def write_outputs(
    diagnosis: Diagnosis,
    *,
    report: str | Path | None,
    alarms: str | Path | None,
    residuals: str | Path | None,
) -> list[Path]:
    """Write the requested page, alarms and residuals, each whole or not at all, and return the paths."""
    if report is not None:
        diagnosis.to_html(report)
    if alarms is not None:
        diagnosis.write_alarms(alarms)
    if residuals is not None:
        write_table(residuals, diagnosis.columns())
    return [Path(path) for path in (report, alarms, residuals) if path is not None]
