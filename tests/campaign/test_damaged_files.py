"""A hundred thousand damaged files of every kind: read as they were or refused, no crash, no blind monitor.

Run with ``make campaign``. The same as ``benchmarks/damaged_files.py``, which writes the table of the documentation.
"""

from __future__ import annotations

import pytest

from damaged import FILES, assert_nothing_wrong

COUNT = 100_000


@pytest.mark.campaign
@pytest.mark.parametrize("name", FILES.kinds())
def test_damaged_files_are_read_as_they_were_or_refused(name: str) -> None:
    outcome = FILES.run(FILES.kinds()[name](), COUNT)
    print(name, dict(outcome.counts), dict(outcome.errors))
    assert_nothing_wrong(outcome, COUNT)
