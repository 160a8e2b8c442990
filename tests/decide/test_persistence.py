"""The alarm logic against a plain loop."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

from residua.decide.persistence import alarm_logic


def by_hand(exceeded: list[bool], usable: list[bool], persistence: int, release: int) -> list[bool]:
    up = down = 0
    alarm, out = False, []
    for over, valid in zip(exceeded, usable, strict=True):
        if valid:
            up, down = (up + 1, 0) if over else (0, down + 1)
            if over and up >= persistence:
                alarm = True
            if not over and down >= release:
                alarm = False
        out.append(alarm)
    return out


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.booleans(), st.booleans()), max_size=40),
    st.integers(1, 4),
    st.integers(1, 4),
    st.integers(0, 40),
)
def test_it_equals_the_loop_for_any_cut(
    samples: list[tuple[bool, bool]], persistence: int, release: int, cut: int
) -> None:
    exceeded = np.array([a and b for a, b in samples], dtype=bool)[None]
    usable = np.array([b for _, b in samples], dtype=bool)[None]
    zero, off = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    up, down, alarm, found = zero, zero, off, []
    for piece in (slice(0, cut), slice(cut, None)):
        if exceeded[:, piece].shape[1] == 0:
            continue
        on, ups, downs = alarm_logic(exceeded[:, piece], usable[:, piece], up, down, alarm, persistence, release)
        up, down, alarm = ups[:, -1], downs[:, -1], on[:, -1]
        found += on[0].tolist()
    assert found == by_hand(exceeded[0].tolist(), usable[0].tolist(), persistence, release)
