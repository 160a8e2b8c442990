"""Run the campaign: ``PYTHONPATH=src:tests python -m exact_campaign --plants 100000 --workers 2 --out campaign``."""

from __future__ import annotations

import argparse
import gc
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded, which the workers inherit

from exact_campaign.ledger import add
from exact_campaign.results import write_results
from exact_campaign.runs import run

#: New objects until circles among them are looked for, and how often until older ones are looked at too, and all.
#: Plants leave hardly a circle: by Python's own numbers 4 % of the time would go into looking for some. After a hundred
#: plants a worker takes 250 MB this way, and 220 MB by those numbers; neither grows on.
_COLLECTED_AFTER = (200_000, 50, 100)


def main() -> None:
    """Run, then write the counts and the failures."""
    parser = argparse.ArgumentParser(prog="exact_campaign", description=__doc__)
    parser.add_argument("--plants", type=int, default=360, help="over all kinds")
    parser.add_argument("--seed", type=int, default=0, help="the first seed of each kind")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=None, help="stop taking up plants after so long")
    parser.add_argument(
        "--out", type=Path, default=Path("campaign"), help="folder of the record; resumed when it is there"
    )
    parser.add_argument(
        "--tables", type=Path, default=None, help="folder of tables to which the record is added in the end"
    )
    options = parser.parse_args()
    record = options.out / "record.jsonl"
    gc.collect()
    gc.freeze()  # what is imported, and inherited by the workers, is looked through no more
    gc.set_threshold(*_COLLECTED_AFTER)  # of the workers too
    run(options.plants, options.seed, options.workers, record, seconds=options.seconds)
    write_results(record, options.out)
    if options.tables is not None:
        add(record, options.tables)


if __name__ == "__main__":
    main()
