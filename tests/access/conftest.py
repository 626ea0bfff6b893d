"""One private authority for all of these tests, and stacks on a bus with access control."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.command_line import zarm


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `zarm certs` made."""
    folder = tmp_path_factory.mktemp("access") / "certs"
    made = zarm("certs", str(folder))
    assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture
def secured(certificates: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Sessions and processes of this test speak TLS; the folder of their certificates."""
    monkeypatch.setenv("ZARM_SECURITY", "on")
    monkeypatch.setenv("ZARM_CERTS", str(certificates))
    return certificates
