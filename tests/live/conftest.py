"""Fixtures of the tests of live data."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from live.brokers import Mosquitto, running


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[Mosquitto]:
    """An MQTT broker that is running."""
    with running(tmp_path, "max_queued_messages 0") as broker:
        yield broker
