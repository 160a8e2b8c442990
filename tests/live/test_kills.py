"""No kill, of the run, of the broker or of the database, loses an event or gives it another number."""

from __future__ import annotations

from pathlib import Path

import pytest

from live.brokers import running
from live.kills import BROKER, Campaign
from stores import Database

pytest.importorskip("paho.mqtt.client")

SQLITE = '[store]\nkind = "sqlite"\nfile = "live.db"\nhistory = 500\n'


#: Kills, samples and seed: a few every day, a thousand in the campaign.
DAILY, LONG = (3, 2000, 0), [pytest.param(50, 4000, seed, marks=pytest.mark.campaign) for seed in range(1, 21)]


@pytest.mark.parametrize(("kills", "samples", "seed"), [DAILY, *LONG])
def test_kills_lose_no_event(tmp_path: Path, kills: int, samples: int, seed: int) -> None:
    with running(tmp_path, BROKER) as broker:
        campaign = Campaign(tmp_path, broker, SQLITE, kills, samples, seed)
        campaign.check(campaign.run())
    assert campaign.done == kills
    assert campaign.restarts


@pytest.mark.parametrize(("kills", "samples", "seed"), [DAILY, *LONG[:2]])
def test_kills_lose_no_event_in_postgresql(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kills: int, samples: int, seed: int
) -> None:
    database = Database()
    database.start()
    monkeypatch.setenv("RESIDUA_TEST_DSN", database.dsn)
    store = '[store]\nkind = "postgresql"\ndsn_env = "RESIDUA_TEST_DSN"\nhistory = 500\n'
    try:
        with running(tmp_path, BROKER) as broker:
            campaign = Campaign(tmp_path, broker, store, kills, samples, seed)
            campaign.check(campaign.run())
    finally:
        database.stop()
