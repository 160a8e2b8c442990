"""Many short recordings, and modes whose values are nearly the same: nothing is lost without a word."""

import numpy as np
import pytest

import residua as rs
from residua.errors import DataError
from residua.identify.segments import gather


def test_a_part_of_many_short_recordings_still_has_rows_after_the_past():
    recordings = [np.arange(60.0).reshape(30, 2) + k for k in range(100)]
    gathered = gather(recordings)
    part = gathered.shortened(600, least=25)
    assert all(len(one) >= 25 for one in part.segments)
    assert 300 <= part.n_samples <= 1200
    assert part.segments[-1].recording > 50  # from all over, not from the first ones only
    assert [len(one) for one in gathered.shortened(600).segments] == [6] * 100


def test_arx_does_not_take_another_past_than_was_asked_for_where_that_is_not_determined():
    rng = np.random.default_rng(0)
    first = np.zeros(2000)
    for k, e in enumerate(rng.standard_normal(1999), 1):
        first[k] = 0.8 * first[k - 1] + e
    y = np.column_stack([first[1:], first[:-1]])  # the second is the first, a row later
    for held_out in (0.25, 0.0):
        with pytest.raises(DataError, match="is not determined"):
            rs.identify.arx(None, y, order=2, past_of="all", held_out=held_out)


def test_modes_of_nearly_the_same_value_have_names_of_their_own():
    rng = np.random.default_rng(0)
    fan = np.repeat([0.3, 1.0, 0.1 + 0.2, 1.0], 300)
    air = rng.standard_normal(1200)
    rows = np.column_stack([fan, air, air + 0.1 * rng.standard_normal(1200)])
    made = rs.identify.regimes(rows, outputs=["fan", "air", "supply"], by=["fan"], transient=0)
    assert list(made.modes) == ["fan = 0.3", "fan = 0.30000000000000004", "fan = 1"]
    assert sum(one.samples for one in made.modes.values()) == 1200
    assert rs.RegimeMonitor(made).fit(None, rows).run(None, rows).decided.sum() > 1190


@pytest.mark.parametrize("method", ["subspace", "arx", "principal_components", "parity_from_data", "regression"])
def test_one_row_is_too_short_and_no_standstill(method: str) -> None:
    with pytest.raises(DataError, match=r"1 complete row of 3 channels: too few|too few data"):
        getattr(rs.identify, method)(np.ones((1, 1)), np.ones((1, 2)))


def test_several_channels_are_left_out_as_them() -> None:
    y = np.random.default_rng(0).standard_normal((100, 3)) * [1, 0, 0]
    with pytest.raises(DataError, match=r"y2, y3 never move: .* leave them out"):
        rs.identify.principal_components(y)
    with pytest.raises(DataError, match=r"y2 never moves: .* leave it out"):
        rs.identify.principal_components(y[:, :2])
