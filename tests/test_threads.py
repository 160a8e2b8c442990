"""Designs run in one thread of BLAS, and the setting of the user comes back."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
import scipy.linalg  # noqa: F401  # brings a BLAS of its own
from threadpoolctl import ThreadpoolController

import residua as rs
from residua.errors import DesignError
from residua.threads import one_thread


def threads() -> list[int]:
    return [library["num_threads"] for library in ThreadpoolController().info() if library["user_api"] == "blas"]


@pytest.fixture
def two_threads() -> None:
    with ThreadpoolController().limit(limits=2, user_api="blas"):
        yield


@pytest.mark.usefixtures("two_threads")
def test_the_setting_of_the_user_comes_back() -> None:
    before = threads()
    assert set(before) == {2}
    with one_thread():
        assert set(threads()) == {1}
        with one_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {1}
    assert threads() == before
    rs.design.luenberger_observer(rs.library.vtol())
    with pytest.raises(DesignError, match="noise"):
        rs.design.kalman_filter(rs.library.vtol())
    assert threads() == before


@pytest.mark.usefixtures("two_threads")
def test_designs_in_threads_leave_it_too() -> None:
    before = threads()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: rs.design.luenberger_observer(rs.library.vtol()), range(40)))
    assert threads() == before


@pytest.mark.usefixtures("two_threads")
def test_a_design_runs_in_one_thread() -> None:
    seen = []

    @rs.design.method(exists_when="always", order="n", source="here")
    def asks_for_threads(plant: rs.Plant) -> rs.design.Observer:
        seen.extend(threads())
        return rs.design.luenberger_observer(plant)

    try:
        asks_for_threads(rs.library.vtol())
    finally:
        rs.design.catalogue.forget("asks_for_threads")
    assert set(seen) == {1}
