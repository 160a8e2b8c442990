"""Shapes of faults in time: what they are at each sample, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from residua import validate as v
from residua.errors import SettingError

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (v.step(at=2), [0, 0, 1, 1, 1, 1]),
        (v.step(at=2, until=4), [0, 0, 1, 1, 0, 0]),
        (v.step(at=1.5), [0, 0, 1, 1, 1, 1]),  # at the first sample from then on
        (v.ramp(slope=0.5, at=2), [0, 0, 0, 0.5, 1, 1]),
        (v.drift(slope=0.5, at=2), [0, 0, 0, 0.5, 1, 1.5]),
        (v.oscillation(period=4, at=1), [0, 0, 1, 0, -1, 0]),
        (v.stuck_at(at=4), [0, 0, 0, 0, 1, 1]),
        (v.loss_of_effectiveness(at=4), [0, 0, 0, 0, 1, 1]),
    ],
)
def test_the_share_of_the_size_at_each_sample(shape: v.Shape, expected: list[float]) -> None:
    first, share = shape.over(6, 1.0, RNG)
    np.testing.assert_allclose(share, expected, atol=1e-15)
    assert first == next(k for k in range(6) if k >= shape.latest)


def test_times_are_in_seconds() -> None:
    for dt in (0.1, 0.25, 3.0, 1e-6):
        first, share = v.step(at=12 * dt).over(20, dt, RNG)
        assert (first, share.sum()) == (12, 8)


def test_an_onset_of_its_own_for_each_run() -> None:
    shape = v.step(at=(10, 20))
    onsets = [shape.over(100, 0.5, np.random.default_rng(seed))[0] for seed in range(200)]
    assert min(onsets) >= 20
    assert max(onsets) <= 40
    assert len(set(onsets)) > 15


def test_an_intermittent_fault_is_there_for_the_share_of_its_mean_times() -> None:
    _, share = v.intermittent(on=3.0, off=6.0, at=0).over(60_000, 1.0, RNG)
    assert set(share) == {0.0, 1.0}
    assert share[0] == 1
    assert share.mean() == pytest.approx(1 / 3, abs=0.03)  # some 6,700 stretches


def test_growing_noise_has_its_size_as_standard_deviation() -> None:
    _, share = v.noise_growth(at=100).over(20_100, 1.0, RNG)
    assert not share[:100].any()
    assert share[100:].std() == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: v.step(at=-1), "0 s or later"),
        (lambda: v.step(at=np.nan), "finite number"),
        (lambda: v.step(at="soon"), "finite number"),
        (lambda: v.step(at=(5, 5)), "before the latest"),
        (lambda: v.step(at=(1, 2, 3)), "earliest and the latest"),
        (lambda: v.step(at=5, until=5), "after the onset"),
        (lambda: v.ramp(slope=0, at=5), "slope must be positive"),
        (lambda: v.drift(slope=-1, at=5), "the size of the scenario has the sign"),
        (lambda: v.intermittent(on=0, off=1, at=5), "on must be positive"),
        (lambda: v.oscillation(period=np.inf, at=5), "period must be a finite number"),
        (lambda: v.stuck_at(at=5, value=np.nan), "value must be a finite number"),
    ],
)
def test_what_no_shape_can_be(make, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        make()


def test_a_shape_says_what_it_is() -> None:
    assert str(v.ramp(slope=0.01, at=600)) == "ramp(slope=0.01, at=600)"
    assert str(v.drift(slope=0.01, at=(1, 2), until=9)) == "drift(slope=0.01, at=(1, 2), until=9)"
    assert str(v.stuck_at(at=5)) == "stuck at(at=5)"
