"""Compiled modules that are missing: one warning, none where they are switched off."""

from __future__ import annotations

import warnings

import pytest

from residua import kernels


def test_missing_kernels_are_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "_is_warned", False)
    with pytest.warns(RuntimeWarning, match=r"without its compiled kernels .*_absent.* times as long. Install a wheel"):
        assert kernels.kernel("residua._absent") is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kernels.kernel("residua._absent") is None


def test_kernels_that_are_switched_off_are_not_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "_is_warned", False)
    monkeypatch.setenv("RESIDUA_NO_COMPILED", "1")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kernels.kernel("residua.live._rows") is None
