"""The table of what faults came to, at the end of a run."""

from __future__ import annotations

from collections.abc import Callable

import pytest

HEADER = ("fault", "strategy", "bound, s", "at rest after, s", "at most, rad/s^2", "says")
LINES = pytest.StashKey[list[tuple[str, ...]]]()


@pytest.fixture
def note(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Takes the cells of one line."""
    lines = request.config.stash.setdefault(LINES, [])
    return lambda *cells: lines.append(cells)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    lines = terminalreporter.config.stash.get(LINES, [])
    if lines:
        terminalreporter.section("faults")
        for cells in (HEADER, ("---",) * len(HEADER), *lines):
            terminalreporter.write_line(f"| {' | '.join(cells)} |")
