"""The shipped checks accept what is right and refuse what is not."""

from __future__ import annotations

from dataclasses import replace

import pytest

import residua as rs
from residua.errors import AccuracyError
from residua.testing import check_residual_generator


@pytest.mark.parametrize("dt", [0.0, 0.05])
def test_our_own_designs_pass(dt: float) -> None:
    engine = rs.library.jet_engine()
    engine = engine.discretize(dt) if dt else engine
    check_residual_generator(rs.design.robust_detection_filter(engine))
    check_residual_generator(rs.design.detection_filter(engine))
    check_residual_generator(rs.design.kalman_filter(engine.with_noise(process=1e-4, measurement=1e-3)))
    check_residual_generator(rs.design.unknown_input_observer(engine).residual_generator())


def test_sampled_continuous_designs_pass_with_what_sampling_costs() -> None:
    engine = rs.library.jet_engine()
    for dt in (0.001, 0.01, 0.1):
        check_residual_generator(rs.design.robust_detection_filter(engine).discretize(dt))


def test_wrong_ones_are_refused() -> None:
    good = rs.design.detection_filter(rs.library.gertler())
    for change, words in (
        ({"A": good.system.A * 3}, "not stable"),
        ({"B": good.system.B * 1.01}, "control inputs"),
    ):
        with pytest.raises(AccuracyError, match=words):
            check_residual_generator(replace(good, system=good.system.replaced(**change)))
    swapped = {"p1": good.subspaces["p2"], "p2": good.subspaces["p1"]}
    with pytest.raises(AccuracyError, match="leaves its subspace"):
        check_residual_generator(replace(good, subspaces=swapped))
    robust = rs.design.detection_filter(rs.library.jet_engine())
    with pytest.raises(AccuracyError, match="disturbance"):
        check_residual_generator(robust, decoupled=True)
