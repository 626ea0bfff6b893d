"""The table of what faults came to, at the end of a run."""

from __future__ import annotations

from collections.abc import Callable

import pytest

HEADER = ("fault", "strategy", "bound, s", "at rest after, s", "at most, rad/s^2", "says")
LINE = "line of the table of faults"


@pytest.fixture
def note(record_property: Callable[[str, object], None]) -> Callable[..., None]:
    """Takes the cells of one line."""
    return lambda *cells: record_property(LINE, cells)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.getreports(outcome)]
    lines = [
        cells for report in reports if report.when == "call" for name, cells in report.user_properties if name == LINE
    ]
    if lines:
        terminalreporter.section("faults")
        for cells in (HEADER, ("---",) * len(HEADER), *lines):
            terminalreporter.write_line(f"| {' | '.join(cells)} |")
