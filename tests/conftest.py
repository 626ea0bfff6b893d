from __future__ import annotations

import gc
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from support.executor.client import Client
from support.harness import ServiceProcess, router
from support.pendulum import write_pendulum
from support.tiers import ESSENTIAL
from support.trajectories import KEYS
from zarm_runtime.bus import Bus

TESTS = Path(__file__).parent
IN_PROCESS = TESTS / "unit"
NOT_FAST = frozenset(("slow", "lengthy"))
NOT_ESSENTIAL = frozenset(("slow", "timed"))
ESSENTIAL_PATHS = tuple(TESTS / name for name in ESSENTIAL)
QUICK = "fast or essential"
SHARED = frozenset(("shared", "up"))
"""What the fixtures of a package that start something are called."""

settings.register_profile("quick", deadline=None, max_examples=10)  # nothing timed is asserted: machines differ
settings.register_profile("full", deadline=None, max_examples=30)
settings.load_profile("quick")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Imports no module that has none of the tests asked for: `fast` ones lie in one folder, `essential` ones in a few, and a module names
    `timed` where it has some.
    """
    asked, *_ = config.option.markexpr.split() or ("",)
    if config.option.markexpr in ("fast", QUICK):
        folders = (IN_PROCESS,) if config.option.markexpr == "fast" else (IN_PROCESS, *ESSENTIAL_PATHS)
        on_the_way = any(
            path.is_relative_to(collection_path) or collection_path.is_relative_to(path) for path in folders
        )
        shares = collection_path.name in ("__init__.py", "conftest.py")
        return None if on_the_way or shares else True
    if asked == "timed" and collection_path.name.startswith("test_"):
        return None if "pytest.mark.timed" in collection_path.read_text() else True
    return None


@pytest.hookimpl(tryfirst=True)  # xdist reads the groups when its turn comes
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What runs in the process of the tests is fast, but for what is marked slow or lengthy, and what lies in ESSENTIAL is essential, but for
    what is marked slow or timed. Each module runs in one process, and so do all tests that share what the fixtures of a package start: it starts once.
    """
    for item in items:
        shares = item.path.with_name("__init__.py").exists() and not SHARED.isdisjoint(
            getattr(item, "fixturenames", ())
        )
        group = item.path.parent if shares else item.path
        item.add_marker(pytest.mark.xdist_group(str(group.relative_to(TESTS))))
        if item.path.is_relative_to(IN_PROCESS) and NOT_FAST.isdisjoint(mark.name for mark in item.iter_markers()):
            item.add_marker("fast")
        if NOT_ESSENTIAL.isdisjoint(mark.name for mark in item.iter_markers()) and any(
            item.path.is_relative_to(path) for path in ESSENTIAL_PATHS
        ):
            item.add_marker("essential")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported and collected stays, so looking for garbage meanwhile would be in vain."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """What has been collected stays, and is not looked through for garbage: that takes up to 0.8 s, in which a test is deaf."""
    gc.freeze()


def pytest_runtest_setup() -> None:
    """The services of the tests before are no longer of interest."""
    ServiceProcess.started[:] = [one for one in ServiceProcess.started if one.process.poll() is None]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A test that fails shows what the services have logged that ran with it."""
    report = yield
    if report.failed:
        report.sections += [(f"Log of {one.service} {one.process.pid}", one.output()) for one in ServiceProcess.started]
    return report


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A router of this test's own."""
    with router() as address:
        yield address


@pytest.fixture
def bus(endpoint: str) -> Iterator[Bus]:
    """A client session on that router."""
    with Bus(endpoint) as session:
        yield session


@pytest.fixture
def executor(endpoint: str, bus: Bus, tmp_path: Path) -> Iterator[ServiceProcess]:
    """An executor with an emulated robot."""
    with ServiceProcess("executor", endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        yield process


@pytest.fixture
def client(executor: ServiceProcess, bus: Bus) -> Client:
    """A client of that executor."""
    return Client(bus)


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    """The descriptor of the smallest robot there is, to be used as it is or broken."""
    return write_pendulum(tmp_path)
