"""Blocks that are interrupted between two steps of Python, or get no threads, happen whole or not at all."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.decide import CUSUM, Directional, NormThreshold
from residua.errors import DataError
from residua.monitor import fused

#: Of the steps of a block, each so manieth is tried: a prime number, so that in time all kinds of steps are.
STRIDE = 41
WHERE = str(Path(rs.__file__).parent / "monitor")


def plant() -> rs.Plant:
    made = rs.Plant([[0.8, 0.1], [0, 0.6]], [[0.2], [0.4]], np.eye(2), dt=2.0, inputs=["pump"], outputs=["low", "high"])
    return made.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)


NORM = rs.Monitor(rs.design.kalman_filter(plant()), test=NormThreshold(persistence=2), isolate=Directional(window=3))
SUMS = rs.Monitor(rs.design.kalman_filter(plant()), test=CUSUM(threshold=4.0), isolate=None)


def data(plants: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return signals of which some are missing at the end, while sensors fail."""
    rng = np.random.default_rng(3)
    u, noise = rng.standard_normal((plants, samples, 1)), rng.standard_normal((plants, samples, len(plant().noises)))
    y = np.stack(
        [plant().system(("control", "noise")).simulate(np.hstack(pair)) for pair in zip(u, noise, strict=True)]
    )
    y[::3, -6:, 0] += 3.0
    y[1::3, -2, 1] = np.nan
    y[2, -2] = 1e300
    return u, y


def of_one_monitor(threads: int = 1) -> rs.Fleet:
    fleet = rs.Fleet(NORM, plants=range(7), threads=threads)
    u, y = data(9, 60)
    for k in range(57):
        fleet.tick(None, u[:7, k], y[:7, k])
    fleet.add([7, 8])  # which start with the sample to come: there is no room for that
    return fleet


def of_two_monitors() -> rs.Fleet:
    fleet = rs.Fleet({"norm": (NORM, range(5)), "sums": (SUMS, range(5, 9))})
    u, y = data(9, 60)
    for k in range(57):
        fleet.tick(range(9), u[:, k], y[:, k])
    return fleet


def whole(fleet: rs.Fleet, u: np.ndarray, y: np.ndarray) -> None:
    fleet.tick(None, u[:, 57], y[:, 57])


def missing(fleet: rs.Fleet, u: np.ndarray, y: np.ndarray) -> None:
    fleet.tick(None, u[:, 58], y[:, 58])


def several(fleet: rs.Fleet, u: np.ndarray, y: np.ndarray) -> None:
    ids = [3, 0, 3, 5, 0, 1, 3, 8]
    fleet.tick(ids, u[ids, 58], y[ids, 58])


def block(fleet: rs.Fleet, u: np.ndarray, y: np.ndarray) -> None:
    fleet.update(u[:, 55:], y[:, 55:])


def followed(fleet: rs.Fleet, u: np.ndarray, y: np.ndarray) -> None:
    fleet.follow(range(9), u[:, 55:], y[:, 55:])


CASES: dict[str, tuple[Callable[[], rs.Fleet], Callable[..., None]]] = {
    "a tick": (of_one_monitor, whole),
    "missing values": (of_one_monitor, missing),
    "two threads": (lambda: of_one_monitor(2), missing),
    "several records": (of_one_monitor, several),
    "two monitors": (of_two_monitors, missing),
    "a block": (of_one_monitor, block),
    "a block that is followed": (of_one_monitor, followed),
}


class Interruption:
    """Raises an error before a step of Python in the package's monitors; none where ``at`` is None."""

    def __init__(self, error: type[BaseException], at: int | None) -> None:
        self.error, self.at, self.seen = error, at, 0

    def call(self, action: Callable[[], object]) -> bool:
        """Call something, and return whether it was interrupted."""
        before = sys.gettrace()
        try:
            sys.settrace(self._begin)
            action()
        except self.error:
            return True
        finally:
            sys.settrace(before)
        return False

    def _begin(self, frame: FrameType, event: str, argument: Any) -> Any:
        if not frame.f_code.co_filename.startswith(WHERE):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return self._step

    def _step(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "opcode":
            self.seen += 1
            if self.seen - 1 == self.at:
                raise self.error
        return self._step


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("case", CASES)
def test_a_block_happens_whole_or_not_at_all(
    case: str, compiled: bool, error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next tick wrote through a null pointer: plants had started, and the room for that was not made any longer."""
    if not compiled:
        monkeypatch.setattr(fused, "_kernel", None)
    make, action = CASES[case]
    monitors: Any = {"norm": NORM, "sums": SUMS} if make is of_two_monitors else NORM
    u, y = data(9, 60)
    before = make().snapshot()
    expected = restored(before, monitors, case)
    steps = Interruption(error, None)
    assert not steps.call(lambda: action(expected, u, y))
    after = expected.snapshot()
    missing(expected, u, y)
    outcomes = set()
    for at in range(0, steps.seen, STRIDE if compiled else 5 * STRIDE):
        fleet, given = restored(before, monitors, case), (u.copy(), y.copy())
        interruption = Interruption(error, at)
        if interruption.call(lambda fleet=fleet, given=given: action(fleet, *given)):
            for one in given:
                one[...] = 7.0  # what a caller may do with them by then
        found = fleet.snapshot()
        outcomes.add(found == after)
        assert found in (before, after), f"interrupted at step {at}"
        if found == before:
            action(fleet, u, y)
        missing(fleet, u, y)
        assert fleet.snapshot() == expected.snapshot(), f"interrupted at step {at}"
        assert fleet.alarms == expected.alarms
    assert outcomes == {True, False}


def restored(content: bytes, monitors: Any, case: str) -> rs.Fleet:
    return rs.Fleet.restore(content, monitors, threads=2 if case == "two threads" else 1)


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
@pytest.mark.parametrize("plants", [1, 3])
def test_a_stream_goes_on_from_a_whole_block(plants: int) -> None:
    u, y = data(9, 60)
    u, y = u[:plants], y[:plants]
    expected = rs.Monitor(NORM.design, test=NORM.test, isolate=Directional(window=3))
    steps = Interruption(KeyboardInterrupt, None)
    begins = expected.update(u[:, :57], y[:, :57])
    steps.call(lambda: expected.update(u[:, 57:], y[:, 57:]))
    last = expected.update(u, y)
    for at in range(0, steps.seen, STRIDE):
        monitor = rs.Monitor(NORM.design, test=NORM.test, isolate=Directional(window=3))
        assert monitor.update(u[:, :57], y[:, :57]).statistic.tobytes() == begins.statistic.tobytes()
        Interruption(KeyboardInterrupt, at).call(lambda monitor=monitor: monitor.update(u[:, 57:], y[:, 57:]))
        assert monitor._state is not None
        count = monitor._state.count
        assert set(count.tolist()) in ({57}, {60})
        if count[0] == 57:
            monitor.update(u[:, 57:], y[:, 57:])
        assert monitor.update(u, y).statistic.tobytes() == last.statistic.tobytes()


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
def test_what_was_interrupted_twice_before_its_signals_were_saved_is_not_guessed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    u, y = data(9, 60)
    before = of_one_monitor().snapshot()
    steps = Interruption(KeyboardInterrupt, None)
    after = rs.Fleet.restore(before, NORM)
    steps.call(lambda: missing(after, u, y))

    def again(self: fused.Job) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(fused.Job, "own", again)
    refused = 0
    for at in range(0, steps.seen, STRIDE):
        fleet = rs.Fleet.restore(before, NORM)
        Interruption(KeyboardInterrupt, at).call(lambda fleet=fleet: missing(fleet, u, y))
        if not fleet._worker._jobs:
            continue
        with suppress(DataError):
            assert fleet.snapshot() in (before, after.snapshot())
            continue
        refused += 1
        with pytest.raises(DataError, match="interrupted, and again"):
            missing(fleet, u, y)
    assert refused


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
def test_a_thread_that_goes_on_after_two_interruptions_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The state was taken for what it had been before the block, and some plants had their sample after that."""
    u, y = data(9, 60)
    fleet = rs.Fleet.restore(of_one_monitor().snapshot(), NORM, threads=2)
    run, there, on = fused._Parts._run, threading.Event(), threading.Event()

    def interrupted(*arguments: Any) -> None:
        if threading.current_thread() is threading.main_thread():
            assert there.wait(60)
            raise KeyboardInterrupt
        there.set()
        assert on.wait(60)
        run(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(fused._Parts, "_run", interrupted)
        patch.setattr(fused._Parts, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            missing(fleet, u, y)
    threading.Timer(0.2, on.set).start()
    with pytest.raises(DataError, match="interrupted, and again"):
        fleet.snapshot()


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
@pytest.mark.parametrize("started", [0, 1])
def test_without_threads_the_calling_one_does_it_all(started: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parts of the threads that did start had been run, and an error left the others as they were."""
    u, y = data(9, 60)
    before, start, left = of_one_monitor().snapshot(), threading.Thread.start, [started]

    def refused(self: threading.Thread) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise RuntimeError("can't start new thread")
        start(self)

    expected, fleet = rs.Fleet.restore(before, NORM), rs.Fleet.restore(before, NORM, threads=4)
    monkeypatch.setattr(threading.Thread, "start", refused)
    for one in (expected, fleet):
        missing(one, u, y)
        block(one, u, y)
    assert left[0] < 0
    assert fleet.snapshot() == expected.snapshot()


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
def test_a_start_without_room_is_run_all_the_same() -> None:
    """Nothing in a state may make the kernel write where there is no room."""
    fleet = of_one_monitor()
    for k in range(57):
        fleet.tick(None, *(one[:, k] for one in data(9, 60)))
    run = fleet._blocks[""]._run
    assert run is not None
    assert not run.has_room_for_starts
    run.state.filter.starting[:] = True
    run.state.filter.age[:] = 0
    missing(fleet, *data(9, 60))


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
def test_what_alarms_did_in_a_block_that_was_interrupted_comes_with_the_next_one() -> None:
    """It was lost; and an alarm that had ended was said to have begun with the next one of its plant."""
    u, y = data(9, 60)
    y[0, 55:57, 0] += 3.0  # an alarm that stands ends, and another one is raised, which ends too
    y[0, 57:, 0] -= 3.0
    first, second = slice(50, 57), slice(57, 60)
    before = of_one_monitor().snapshot()
    ids = list(range(9))

    def begun() -> rs.Fleet:
        fleet = rs.Fleet.restore(before, NORM)
        up = y[:, 40:50].copy()
        up[0, -4:, 0] += 3.0
        fleet.follow(ids, u[:, 40:50], up)
        return fleet

    expected, steps = begun(), Interruption(KeyboardInterrupt, None)
    events: list[Any] = []
    steps.call(lambda: events.extend(expected.follow(ids, u[:, first], y[:, first])))
    then = expected.follow(ids, u[:, second], y[:, second])
    assert {"raised", "ended"} == {event.kind for event in events if event.plant == 0}
    assert then
    late = 0
    for at in range(0, steps.seen, STRIDE):
        fleet = begun()
        found: list[Any] = []
        if Interruption(KeyboardInterrupt, at).call(
            lambda fleet=fleet, found=found: found.extend(fleet.follow(ids, u[:, first], y[:, first]))
        ):
            block = fleet._blocks[""]
            if block.state.count[0] == begun()._blocks[""].state.count[0]:
                found += fleet.follow(ids, u[:, first], y[:, first])
            late += not found
        found += fleet.follow(ids, u[:, second], y[:, second])
        assert found == events + then, f"interrupted at step {at}"
    assert late


@pytest.mark.parametrize(
    "change",
    [
        lambda fleet: fleet,
        lambda fleet: fleet.add(["new"]),
        lambda fleet: fleet.remove([8]),
        lambda fleet: rs.Fleet.joined(fleet.split(3)),
    ],
    ids=["none", "added", "removed", "split and joined"],
)
def test_what_alarms_did_in_an_interrupted_block_is_told_when_plants_have_come_and_gone(
    change: Callable[[rs.Fleet], rs.Fleet | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was lost with the block that the plants were in before."""
    u, y = data(9, 60)
    y[0, 55:57, 0] += 3.0
    before, ids = of_one_monitor().snapshot(), list(range(9))
    interrupted, whole = (rs.Fleet.restore(before, NORM) for _ in range(2))
    events = whole.follow(ids, u[:, 40:57], y[:, 40:57])
    with monkeypatch.context() as patch:

        def interrupts(*_: Any) -> None:
            raise KeyboardInterrupt

        patch.setattr(interrupted._blocks[""], "_follow_skipped", interrupts)
        with pytest.raises(KeyboardInterrupt):
            interrupted.follow(ids, u[:, 40:57], y[:, 40:57])
    fleet = change(interrupted) or interrupted
    assert {"raised", "ended"} <= {event.kind for event in events}
    told = [event for event in events if event.plant in fleet.plants]
    assert fleet.follow([0], u[:1, 57:], y[:1, 57:]) == told + whole.follow([0], u[:1, 57:], y[:1, 57:])


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_block_is_undone_where_an_isolation_in_numpy_raises(
    error: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each later call raised too, until ``reset()``."""
    u, y = data(9, 60)
    made = [rs.Monitor(NORM.design, test=NORM.test, isolate=Directional(window=3)) for _ in range(2)]
    for monitor in made:
        isolation = monitor._specification().isolation
        monkeypatch.setattr(type(isolation), "compiled", None)
    expected, monitor = made
    run = type(isolation).run
    for one in made:
        one.update(u[0, :57], y[0, :57])
    with monkeypatch.context() as patch:

        def raises(*_: Any) -> None:
            raise error

        patch.setattr(type(isolation), "run", raises)
        for _ in range(2):
            with pytest.raises(error):
                monitor.update(u[0, 57:], y[0, 57:])
        assert monitor._state is not None
        assert monitor._state.count[0] == 57
    assert type(isolation).run is run
    for part in (slice(57, 59), slice(59, 60)):
        found, wanted = (one.update(u[0, part], y[0, part]) for one in (monitor, expected))
        for name in ("statistic", "scores", "alarm"):
            assert getattr(found, name).tobytes() == getattr(wanted, name).tobytes()
