"""How much of a test runs on every day, and how much in the campaign only."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def cases(values: Iterable[Any], usual: int) -> list[Any]:
    """Return the parameters of a test, of which the campaign runs those beyond the first few."""
    return [v if k < usual else pytest.param(v, marks=pytest.mark.campaign) for k, v in enumerate(values)]


def rounds(usual: int, campaign: int) -> list[Any]:
    """Return how many plants, or recordings, a test goes through by itself: on every day, and in the campaign."""
    return cases((usual, campaign), 1)
