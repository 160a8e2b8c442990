"""A campaign cut into chunks, run by several processes, kept line by line so that it can be resumed."""

from __future__ import annotations

import json
import subprocess
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

from exact_campaign.examination import Failure, examine
from exact_campaign.kinds import KINDS

#: Plants of one chunk: what a stopped campaign may lose.
CHUNK = 5


@dataclass(frozen=True)
class Chunk:
    """Consecutive seeds of one kind."""

    kind: str
    first: int
    count: int

    @property
    def key(self) -> str:
        """Its name in the record."""
        return f"{self.kind}/{self.first}/{self.count}"


@dataclass(frozen=True)
class Outcome:
    """What became of a chunk: counts by function, units and outcome, and the failures."""

    key: str
    kind: str
    plants: int
    seconds: float
    counts: dict[str, int]
    failures: list[Failure]
    commit: str


def current_commit() -> str:
    """Return the name of the commit that is examined, with a plus where files differ from it."""
    described = subprocess.run(
        ["git", "describe", "--always", "--exclude=*", "--dirty=+"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
    )
    return described.stdout.strip() or "unknown"


def chunks(plants: int, seed: int) -> list[Chunk]:
    """Return the chunks of a campaign, all kinds alike, in turn."""
    each = -(-plants // len(KINDS))
    return [Chunk(kind, seed + first, min(CHUNK, each - first)) for first in range(0, each, CHUNK) for kind in KINDS]


def run_chunk(chunk: Chunk, commit: str) -> Outcome:
    """Return what becomes of the plants of a chunk at a commit."""
    start = time.process_time()
    counts: Counter[str] = Counter()
    failures: list[Failure] = []
    for seed in range(chunk.first, chunk.first + chunk.count):
        try:
            outcomes, failed = examine(chunk.kind, seed)
        except Exception:  # of the campaign itself: one plant must not end it
            text = traceback.format_exc(limit=-4)
            failed = [Failure(chunk.kind, seed, "base", "campaign", "crash", "campaign", text, "")]
            outcomes = {"campaign | base": "crash"}
        counts.update(f"{name} | {outcome}" for name, outcome in outcomes.items())
        failures += failed
    return Outcome(chunk.key, chunk.kind, chunk.count, time.process_time() - start, dict(counts), failures, commit)


def done(path: Path) -> set[str]:
    """Return the names of the chunks that a record holds; a torn last line is left out."""
    return {entry["key"] for entry in entries(path)}


def entries(path: Path) -> Iterator[dict]:
    """Return the lines of a record."""
    if not path.exists():
        return
    with path.open(encoding="utf-8") as lines:
        for line in lines:
            if line.endswith("\n"):
                yield json.loads(line)


def without_torn_line(path: Path) -> None:
    """Cut off what a killed campaign left of a line."""
    if path.exists():
        whole = path.read_bytes()
        path.write_bytes(whole[: whole.rfind(b"\n") + 1])


def run(plants: int, seed: int, workers: int, path: Path, *, seconds: float | None = None) -> None:
    """Run what of a campaign is not in the record yet, and add it there, for at most so long."""
    path.parent.mkdir(parents=True, exist_ok=True)
    without_torn_line(path)
    kept = done(path)
    missing = [chunk for chunk in chunks(plants, seed) if chunk.key not in kept]
    commit = current_commit()
    end = time.monotonic() + (float("inf") if seconds is None else seconds)
    with ProcessPoolExecutor(workers) as pool, path.open("a", encoding="utf-8") as out:
        todo = iter(missing)
        running = {pool.submit(run_chunk, chunk, commit) for chunk in islice(todo, 2 * workers)}
        count = 0
        while running:
            finished = next(as_completed(running))
            running.remove(finished)
            outcome = finished.result()
            out.write(json.dumps(asdict(outcome)) + "\n")
            out.flush()
            count += outcome.plants
            print(f"{count} plants, {len(outcome.failures)} failures in {outcome.key}", flush=True)
            following = next(todo, None) if time.monotonic() < end else None
            if following is not None:
                running.add(pool.submit(run_chunk, following, commit))
