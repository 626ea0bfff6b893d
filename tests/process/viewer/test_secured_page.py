"""The page where strangers could reach it: TLS, a token, foreign hosts and origins, and a router that refuses."""

from __future__ import annotations

import re
import ssl
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import viser
from playwright.sync_api import Browser, expect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from support.command_line import zarm
from support.harness import PATIENCE
from support.trajectories import moved, rest_to_rest
from support.viewer import Cell, cell_of, drawn_tip, opened

PROGRAM = Path(__file__).parents[2] / "support" / "programs" / "page_without_rights.py"
TOKEN = "a-token-of-these-tests"


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("secured") / "certs"
    made = zarm("certs", str(folder))
    assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture(scope="module")
def cell(certificates: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """An executor on a bus with access control."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ZARM_SECURITY", "on")
        patch.setenv("ZARM_CERTS", str(certificates))
        with cell_of(tmp_path_factory.mktemp("cell"), "executor") as started:
            yield started


@pytest.fixture(scope="module")
def address(cell: Cell) -> str:
    """That of a page which has every button, and whose process is a viewer."""
    return cell.serve("--role", "viewer", script=PROGRAM, ZARM_VIEW_TOKEN=TOKEN)


@pytest.fixture(scope="module")
def tls(certificates: Path) -> ssl.SSLContext:
    """That of a browser which trusts the page's certificate, and looks whether it is this host's."""
    return ssl.create_default_context(cafile=certificates / "page.pem")


def status(address: str, tls: ssl.SSLContext, **headers: str) -> int:
    request = urllib.request.Request(address, headers=headers)
    try:
        with urllib.request.urlopen(request, context=tls, timeout=PATIENCE) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_the_page_opens_for_who_has_its_whole_address(address: str, tls: ssl.SSLContext) -> None:
    assert address.startswith("https://")
    assert address.endswith(f"/{TOKEN}/")
    assert status(address, tls) == 200
    assert status(address.removesuffix(f"{TOKEN}/"), tls) == 401
    assert status(address.replace(TOKEN, TOKEN[:-1]), tls) == 401


def test_pages_from_elsewhere_cannot_speak_to_it(address: str, tls: ssl.SSLContext) -> None:
    assert status(address, tls, Host="elsewhere.example") == 403
    assert status(address, tls, Origin="https://elsewhere.example") == 403
    socket, own = address.replace("https", "wss"), f"https://{urlsplit(address).netloc}"
    protocol = [Subprotocol(f"viser-v{viser.__version__}")]
    with connect(socket, ssl=tls, origin=Origin(own), subprotocols=protocol, open_timeout=PATIENCE) as page:
        assert page.recv()
    for place, origin, code in ((socket, "https://elsewhere.example", 403), (socket.replace(TOKEN, "x"), own, 401)):
        with pytest.raises(InvalidStatus) as refused:
            connect(place, ssl=tls, origin=Origin(origin), subprotocols=protocol, open_timeout=PATIENCE)
        assert refused.value.response.status_code == code


@pytest.mark.slow
def test_a_viewer_may_stop_and_nothing_else(address: str, cell: Cell, chromium: Browser) -> None:
    page = opened(chromium, address)
    page.wait_for_function("() => Object.keys(window.__viserMutable?.nodeRefFromName ?? {}).length > 0")
    goal = cell.robot.start(rest_to_rest(moved(1.0), slower=40.0))
    expect(page.get_by_text("running").first).to_be_visible()
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_text(re.compile("Pause: ")).first).to_be_visible()
    assert cell.robot.state().mode == "running"
    assert drawn_tip(page) is not None
    page.get_by_role("button", name="STOP").first.click()
    assert cell.robot.follow(goal, timeout=PATIENCE).status == "cancelled"
    page.close()
