"""Refusals of designs are counted, over all parameters of a test, and too many are a failure.

A test over generated plants meets some for which a design rightly raises. To skip or pass there in silence would also
pass if nothing worked any more. Such a test says how many it has seen::

    @pytest.mark.parametrize("seed", range(40))
    @pytest.mark.refusals(at_most=7)
    def test_something(seed: int, refused: Refused) -> None:
        try:
            made = design(plant(seed))
        except DesignError as error:
            refused.skip(error)   # or refused(error), and go on

The bound is what was measured when the test was written; it falls when less is refused, and does not rise. It holds for
the whole test, however its parameters are shared out among processes: the counts travel with the reports.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NoReturn

import pytest

KEY = "refused"


class Refused:
    """Counts what is refused in one run of a test."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        marker = request.node.get_closest_marker("refusals")
        if marker is None or set(marker.kwargs) != {"at_most"} or marker.args:
            raise pytest.UsageError(f"{request.node.nodeid}: say @pytest.mark.refusals(at_most=...)")
        self._noted = request.node.user_properties
        self._at_most = int(marker.kwargs["at_most"])

    def __call__(self, reason: object) -> None:
        """Count one."""
        self._noted.append((KEY, (self._at_most, str(reason))))

    def skip(self, reason: object) -> NoReturn:
        """Count one and end the test."""
        self(reason)
        pytest.skip(f"refused: {reason}")


@pytest.fixture
def refused(request: pytest.FixtureRequest) -> Refused:
    """What a test tells its refusals to."""
    return Refused(request)


class Tally:
    """Adds up the refusals of every test; one for each session, in the process that reports."""

    def __init__(self) -> None:
        self.reasons: dict[str, list[str]] = defaultdict(list)
        self.at_most: dict[str, int] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the refusals from a report."""
        if report.when == "teardown":  # the last one, which has them all
            for key, value in report.user_properties:
                if key == KEY:
                    test = report.nodeid.partition("[")[0]
                    self.at_most[test] = value[0]
                    self.reasons[test].append(value[1])

    def complaints(self) -> dict[str, str]:
        """Return for every test with too many refusals what to say."""
        return {
            test: f"{len(reasons)} refusals, expected at most {self.at_most[test]}; for example\n"
            + "\n".join(f"  {reason}" for reason in sorted(set(reasons))[:3])
            for test, reasons in sorted(self.reasons.items())
            if len(reasons) > self.at_most[test]
        }

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Report each complaint as a failed test of its own."""
        for test, words in self.complaints().items():
            report = pytest.TestReport(
                nodeid=f"{test}[refusals]",
                location=(test.partition("::")[0], None, test.partition("::")[2]),
                keywords={},
                outcome="failed",
                longrepr=words,
                when="call",
            )
            session.config.hook.pytest_runtest_logreport(report=report)
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_configure(config: pytest.Config) -> None:
    """Count in the process that reports, not in those that it has run the tests."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Tally(), "refusals")
