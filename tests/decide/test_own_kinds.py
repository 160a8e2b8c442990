"""A test and an isolation of a user's own, in one file outside of the package: everything works with them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from guards import changed, trips
from residua.decide import (
    Block,
    FaultFreeRun,
    Isolation,
    IsolationSettings,
    NormThreshold,
    ResidualTest,
    Scores,
    Statement,
    Tested,
    TestSettings,
    Watched,
    calibrated_test,
    register,
)
from residua.decide.kinds import ISOLATIONS, TESTS
from residua.errors import AccuracyError, DataError, FileFormatError, SettingError
from residua.recording.clock import Clock
from residua.testing import check_isolation, check_test
from residua.testing.kinds import _generator, _recording


@dataclass(frozen=True, eq=False)
class Sums:
    """Of each residual, to either side, what it has moved beyond what is tolerated."""

    up: NDArray[np.float64]
    down: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PageHinkleyTest(ResidualTest):
    """Sums of what exceeds a tolerated change; the largest is the statistic."""

    center: NDArray[np.float64]
    scale: NDArray[np.float64]
    tolerated: float
    threshold: float
    basis: str

    def start(self, plants: int) -> Sums:
        nothing = np.zeros((plants, len(self.center)))
        return Sums(nothing, nothing)

    def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
        usable = block.usable
        z = np.where(usable[..., None], (block.residuals - self.center) / self.scale, 0.0)
        up, down, statistic = state.up, state.down, np.full(usable.shape, np.nan)
        for k in range(usable.shape[1]):
            seen = usable[:, k, None]
            up = np.where(seen, np.maximum(0.0, up + z[:, k] - self.tolerated), up)
            down = np.where(seen, np.maximum(0.0, down - z[:, k] - self.tolerated), down)
            statistic[:, k] = np.where(usable[:, k], np.maximum(up, down).max(axis=1), np.nan)
        over = usable & (np.nan_to_num(statistic) > self.threshold)
        nobody = np.zeros((*usable.shape, 0))
        tested = Tested(usable, statistic, over, over, over.astype(np.int64), z, nobody, nobody.astype(bool))
        return Sums(up, down), tested


@register
@dataclass(frozen=True)
class PageHinkley(TestSettings):
    """Page's test with Hinkley's tolerated change, in standard deviations."""

    kind: ClassVar[str] = "own-page-hinkley"
    makes: ClassVar[type[ResidualTest]] = PageHinkleyTest

    tolerated: float = 0.5
    false_alarm_rate: float = 1e-3

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> ResidualTest:
        rows = run.residuals[run.usable]
        blank = PageHinkleyTest(rows.mean(axis=0), rows.std(axis=0), self.tolerated, np.inf, "")
        return calibrated_test(blank, run, rate)


@dataclass(frozen=True, eq=False)
class NearestTest(Isolation):
    """Groups with the centroid of the whitened residual of each."""

    groups: tuple[tuple[str, ...], ...]
    unjudged: tuple[str, ...]
    centroids: NDArray[np.float64]

    def start(self, plants: int) -> None:
        return None

    def run(self, state: None, block: Block, tested: Tested) -> tuple[None, Scores]:
        distance = np.linalg.norm(tested.whitened[..., None, :] - self.centroids, axis=-1)
        return None, Scores(np.where(tested.usable[..., None], 1.0 / (1.0 + distance), np.nan))

    def statement(self, alarm: rs.monitor.Alarm, clock: Clock, window: int) -> Statement:
        said = super().statement(alarm, clock, window)
        return replace(said, headline=f"Nearest of all: {alarm.candidates[0].name}.", lines=("by its centroid",))


@register
@dataclass(frozen=True)
class NearestCentroid(IsolationSettings):
    """Name the fault whose centroid, that of a step of a size, is nearest to the residual."""

    kind: ClassVar[str] = "own-nearest-centroid"
    makes: ClassVar[type[Isolation]] = NearestTest

    size: float = 1.0

    def isolation(self, generator: rs.design.ResidualGenerator, test: ResidualTest) -> NearestTest:
        steady = np.array([generator.steady_directions[name] for name in generator.faults])
        groups = tuple((name,) for name in generator.faults)
        return NearestTest(groups, (), self.size * steady @ test.metric)


@pytest.fixture(scope="module")
def monitor() -> rs.Monitor:
    generator = _generator()
    made = rs.Monitor(generator, test=PageHinkley(), isolate=NearestCentroid(size=0.8))
    return made.fit(*_recording(generator, np.random.default_rng(1), 4000))


def faulty(seed: int = 2) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return _recording(_generator(), np.random.default_rng(seed), 400, faulty=True)


def test_they_hold_what_monitors_ask_for() -> None:
    check_test(PageHinkley())
    check_isolation(NearestCentroid(size=0.8))


def test_a_fault_is_found_and_named(monitor: rs.Monitor) -> None:
    found = monitor.run(*faulty())
    assert isinstance(found, rs.Diagnosis)
    assert found.named == (("y1 sensor",),)
    assert found.onset is not None
    assert 198 <= found.onset <= 215
    assert "PageHinkleyTest" in found.settings["test"]
    assert found.settings["isolation"] == "NearestTest"
    assert "1. y1 sensor" in str(found)


def test_step_is_run(monitor: rs.Monitor) -> None:
    u, y = faulty()
    whole = monitor.run(u, y)
    assert isinstance(whole, rs.Diagnosis)
    monitor.reset()
    for k in range(len(u)):
        now = monitor.step(u[k], y[k])
        assert now.alarm == whole.alarm[k]
        assert now.statistic == whole.statistic[k] or np.isnan(whole.statistic[k])
        if now.alarm:
            assert now.candidates[0].score == np.nanmax(whole.scores[k])


def test_a_saved_monitor_goes_on(monitor: rs.Monitor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = faulty()
    monitor.reset()
    monitor.update(u[:210], y[:210])
    monitor.save(tmp_path / "m.json")
    loaded = rs.Monitor.load(tmp_path / "m.json")
    assert loaded.test == PageHinkley()
    assert loaded.isolate == NearestCentroid(size=0.8)
    one, other = monitor.update(u[210:], y[210:]), loaded.update(u[210:], y[210:])
    np.testing.assert_array_equal(one.statistic, other.statistic)
    np.testing.assert_array_equal(one.scores, other.scores)
    monkeypatch.delitem(TESTS, "own-page-hinkley")
    with pytest.raises(FileFormatError, match=r"test\.kind: .*own-page-hinkley.*import the module"):
        rs.Monitor.load(tmp_path / "m.json")
    monkeypatch.delitem(ISOLATIONS, "own-nearest-centroid")
    assert "own-nearest-centroid" not in ISOLATIONS


def test_page_and_pictures(monitor: rs.Monitor, tmp_path: Path) -> None:
    plt = pytest.importorskip("matplotlib.pyplot")
    found = monitor.run(*faulty())
    assert isinstance(found, rs.Diagnosis)
    page = found.to_html(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Nearest of all: y1 sensor." in page
    assert "signature" not in found.statement(found.alarms[0]).sentences[0], "angles are of another kind"
    assert "\n  by its centroid\n" in str(found)
    assert "NaN" not in page.split("<script")[0]
    figure = found.plot()
    figure.savefig(tmp_path / "found.png")
    plt.close(figure)
    assert len(found.to_frame()) == 400
    assert found.columns()["score y1 sensor"].shape == (400,)


def test_a_fleet(monitor: rs.Monitor) -> None:
    u, y = faulty()
    found = monitor.run(np.stack([u, u]), np.stack([y, y]))
    assert isinstance(found, list)
    assert [one.named for one in found] == [(("y1 sensor",),)] * 2


def test_a_block_within_a_block_is_refused() -> None:
    """It was called interrupted, or, after an error, was begun again and again until the stack had no room."""
    u, y = faulty()
    made = rs.Monitor(_generator(), test=NormThreshold(threshold=3.0), isolate=NearestCentroid(size=0.8))
    fleet = rs.Fleet(rs.Monitor(_generator(), test=PageHinkley()).fit(u[:150], y[:150]), plants=["one"])

    def stepping(*arguments: Any) -> None:
        made.step(u[0], y[0])

    def ticking(*arguments: Any) -> None:
        fleet.tick(None, u[:1], y[:1])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NearestTest, "run", stepping)
        patch.setattr(PageHinkleyTest, "run", ticking)
        for _ in range(3):
            with pytest.raises(DataError, match="a block is under way"):
                made.update(u[:10], y[:10])
            with pytest.raises(DataError, match="a block is under way"):
                fleet.tick(None, u[:1], y[:1])
    made.step(u[0], y[0])  # what was refused left no trace
    fleet.tick(None, u[:1], y[:1])
    assert made._state is not None
    assert made._state.count == 1
    assert fleet._blocks[""].state.count == 1


# ------------------------------------------------------------------ what its author is told


class _Wrong:
    """Ways to get it wrong."""

    @dataclass(frozen=True, eq=False)
    class Forgets(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            return super().run(self.start(len(block.usable)), block)

    @dataclass(frozen=True, eq=False)
    class SaysSomethingOfGaps(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            state, tested = super().run(state, block)
            return state, replace(tested, statistic=np.nan_to_num(tested.statistic))

    @dataclass(frozen=True, eq=False)
    class SaysNothing(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            state, tested = super().run(state, block)
            return state, replace(tested, statistic=np.full_like(tested.statistic, np.nan))

    @dataclass(frozen=True, eq=False)
    class OverInGaps(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            state, tested = super().run(state, block)
            return state, replace(tested, exceeded=tested.exceeded | ~tested.usable)

    @dataclass(frozen=True, eq=False)
    class OfAnotherKind(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            state, tested = super().run(state, block)
            return state, replace(tested, up=tested.up.astype(float))

    @dataclass(frozen=True, eq=False)
    class Blind(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            state, tested = super().run(state, block)
            never = np.zeros_like(tested.alarm)
            return state, replace(tested, alarm=never, exceeded=never)

    @dataclass(frozen=True, eq=False)
    class AlwaysOn(PageHinkleyTest):
        def run(self, state: Sums, block: Block) -> tuple[Sums, Tested]:
            state, tested = super().run(state, block)
            return state, replace(tested, alarm=tested.usable, exceeded=tested.usable)


@pytest.mark.parametrize(
    ("cls", "words"),
    [
        pytest.param(_Wrong.Forgets, "running in pieces", marks=trips("testing.kinds:_check_same")),
        pytest.param(_Wrong.SaysSomethingOfGaps, "must be NaN", marks=trips("testing.kinds:_check_shapes:2")),
        pytest.param(_Wrong.OfAnotherKind, "must be of shape", marks=trips("testing.kinds:_check_shapes:1")),
        pytest.param(_Wrong.SaysNothing, "must be a number", marks=trips("testing.kinds:_check_shapes:3")),
        pytest.param(_Wrong.OverInGaps, "nothing can be over", marks=trips("testing.kinds:_check_shapes:4")),
        pytest.param(_Wrong.Blind, "raises no alarm", marks=trips("testing.kinds:_check_running:2")),
        pytest.param(_Wrong.AlwaysOn, "fault-free samples are in alarm", marks=trips("testing.kinds:check_test:2")),
    ],
)
def test_what_is_wrong_with_a_test_is_said(cls: type[Any], words: str) -> None:
    @dataclass(frozen=True)
    class Settings(PageHinkley):
        def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> ResidualTest:
            test = super().fitted(watched, run, rate)
            assert isinstance(test, PageHinkleyTest)
            return cls(test.center, test.scale, test.tolerated, test.threshold, test.basis)

    with pytest.raises(AccuracyError, match=words):
        check_test(Settings())


@trips("testing.kinds:check_isolation:2", "testing.kinds:check_test:1", "testing.kinds:check_isolation:1")
def test_what_is_wrong_with_an_isolation_is_said() -> None:
    @dataclass(frozen=True)
    class OfNobody(NearestCentroid):
        def isolation(self, generator: rs.design.ResidualGenerator, test: ResidualTest) -> NearestTest:
            return replace(super().isolation(generator, test), groups=(("somebody",), ("y2 sensor",)))

    with pytest.raises(AccuracyError, match="must be the faults"):
        check_isolation(OfNobody())
    with pytest.raises(AccuracyError, match=r"subclass of residua\.decide\.TestSettings"):
        check_test(NearestCentroid())  # pyright: ignore[reportArgumentType]
    with pytest.raises(AccuracyError, match=r"subclass of residua\.decide\.IsolationSettings"):
        check_isolation(PageHinkley())  # pyright: ignore[reportArgumentType]


@trips("testing.kinds:_check_frozen")
def test_settings_that_can_be_changed_are_refused() -> None:
    class Loose(PageHinkley):
        """A subclass that is no dataclass of its own is frozen still."""

    check_test(Loose())

    class Open(TestSettings):
        """No dataclass at all."""

        def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> ResidualTest:
            return PageHinkley().fitted(watched, run, rate)

    with pytest.raises(AccuracyError, match="frozen dataclass"):
        check_test(Open())


@trips("testing.kinds:_made")
def test_settings_that_no_monitor_takes_are_refused() -> None:
    @dataclass(frozen=True)
    class Unwilling(PageHinkley):
        def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> ResidualTest:
            raise SettingError("not today")

    with pytest.raises(AccuracyError, match="cannot be made with it: not today"):
        check_test(Unwilling())


@trips("testing.kinds:_check_running:1")
def test_data_that_are_changed_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    update = rs.Monitor.update

    def overwriting(self: rs.Monitor, u: Any, y: Any) -> Any:
        found = update(self, u, y)
        y[0] = 0.0
        return found

    monkeypatch.setattr(rs.Monitor, "update", overwriting)
    with pytest.raises(AccuracyError, match="data that it was given are changed"):
        check_test(PageHinkley())


@trips("testing.kinds:_check_running:3")
def test_settings_that_files_do_not_know_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("residua.testing.kinds.json.loads", lambda text: {"test": {"kind": ""}})
    with pytest.raises(AccuracyError, match="must have a kind"):
        check_test(PageHinkley())


@trips("testing.kinds:check_isolation:3")
def test_a_column_of_scores_too_many_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    changed(monkeypatch, "testing.kinds:_check_running", lambda found: _with_scores(found, found.scores[..., :1]))
    with pytest.raises(AccuracyError, match="scores have 1 columns"):
        check_isolation(NearestCentroid(size=0.8))


@trips("testing.kinds:check_isolation:4")
def test_a_score_over_the_best_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    changed(monkeypatch, "testing.kinds:_check_running", lambda found: _with_scores(found, found.scores + 1.0))
    with pytest.raises(AccuracyError, match="the best is 1"):
        check_isolation(NearestCentroid(size=0.8))


def _with_scores(found: Any, scores: NDArray[np.float64]) -> Any:
    return SimpleNamespace(scores=scores)


@trips("testing.kinds:check_isolation:5")
def test_a_candidate_that_is_no_group_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    candidate = SimpleNamespace(faults=("somebody",))
    told = SimpleNamespace(alarms=[SimpleNamespace(candidates=[candidate])])
    changed(monkeypatch, "testing.kinds:Monitor.run", lambda found: told)
    with pytest.raises(AccuracyError, match="is not a group"):
        check_isolation(NearestCentroid(size=0.8))


@pytest.mark.parametrize(
    ("said", "words"),
    [
        pytest.param(None, "must return a residua.decide.Statement", marks=trips("testing.kinds:_check_statement:1")),
        pytest.param(Statement(""), "headline of a statement must be", marks=trips("testing.kinds:_check_statement:2")),
        pytest.param(
            Statement("A fault.", sentences="abc"),  # pyright: ignore[reportArgumentType]
            "sentences of a statement must be a tuple",
            marks=trips("testing.kinds:_check_statement:3"),
        ),
    ],
)
def test_what_cannot_be_shown_is_said(said: Any, words: str) -> None:
    @dataclass(frozen=True, eq=False)
    class Says(NearestTest):
        def statement(self, alarm: rs.monitor.Alarm, clock: Clock, window: int) -> Statement:
            return said

    @dataclass(frozen=True)
    class Settings(NearestCentroid):
        kind: ClassVar[str] = "own-says"
        makes: ClassVar[type[Isolation]] = Says

        def isolation(self, generator: rs.design.ResidualGenerator, test: ResidualTest) -> NearestTest:
            nearest = super().isolation(generator, test)
            return Says(nearest.groups, nearest.unjudged, nearest.centroids)

    register(Settings)
    try:
        with pytest.raises(AccuracyError, match=words):
            check_isolation(Settings())
    finally:
        del ISOLATIONS["own-says"]


def test_a_kind_belongs_to_one() -> None:
    @dataclass(frozen=True)
    class Other(NormThreshold):
        pass

    with pytest.raises(SettingError, match="the kind 'norm' is that of"):
        register(Other)
    with pytest.raises(SettingError, match="takes a subclass"):
        register(int)  # pyright: ignore[reportArgumentType]
    with pytest.raises(SettingError, match="must have a kind"):
        register(type("Nameless", (NormThreshold,), {"kind": ""}))
