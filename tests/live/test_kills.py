"""No kill, of the run, of the broker or of the database, loses an event or gives it another number."""

from __future__ import annotations

from pathlib import Path

import pytest

from live.brokers import running
from live.kills import BROKER, Campaign
from stores import Database

pytest.importorskip("paho.mqtt.client")

SQLITE = '[store]\nkind = "sqlite"\nfile = "live.db"\nhistory = 500\n'


@pytest.mark.parametrize(
    ("kills", "samples"), [(5, 2000), pytest.param(1000, 20_000, marks=pytest.mark.campaign)], ids=str
)
def test_kills_lose_no_event(tmp_path: Path, kills: int, samples: int) -> None:
    with running(tmp_path, BROKER) as broker:
        campaign = Campaign(tmp_path, broker, SQLITE, kills, samples)
        campaign.check(campaign.run())
    assert campaign.done == kills
    assert campaign.restarts


@pytest.mark.parametrize(
    ("kills", "samples"), [(3, 2000), pytest.param(100, 6000, marks=pytest.mark.campaign)], ids=str
)
def test_kills_lose_no_event_in_postgresql(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kills: int, samples: int
) -> None:
    database = Database()
    database.start()
    monkeypatch.setenv("RESIDUA_TEST_DSN", database.dsn)
    store = '[store]\nkind = "postgresql"\ndsn_env = "RESIDUA_TEST_DSN"\nhistory = 500\n'
    try:
        with running(tmp_path, BROKER) as broker:
            campaign = Campaign(tmp_path, broker, store, kills, samples)
            campaign.check(campaign.run())
    finally:
        database.stop()
