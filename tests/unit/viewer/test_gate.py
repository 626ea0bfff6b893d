"""Who is let in to the page."""

from __future__ import annotations

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from zarm_contract.errors import InvalidRequest
from zarm_viewer.gate import Gate


def request(path: str = "/", **headers: str) -> Request:
    """One of a browser."""
    return Request(path, Headers({name.capitalize(): value for name, value in headers.items()}))


def status(gate: Gate, asked: Request) -> int | None:
    refusal = gate.check(asked)
    return refusal.status_code if refusal else None


@pytest.mark.parametrize("host", ["127.0.0.1:8017", "localhost:8017", "[::1]:8017"])
def test_this_machine_opens_the_page_on_loopback_without_a_token(host: str) -> None:
    gate = Gate.at("127.0.0.1:8017")
    assert gate.token is None
    assert status(gate, request(host=host)) is None
    assert status(gate, request(host=host, origin=f"http://{host}")) is None


def test_a_page_from_elsewhere_in_the_same_browser_is_refused() -> None:
    gate = Gate.at("127.0.0.1:8017")
    assert status(gate, request(host="127.0.0.1:8017", origin="http://elsewhere.example")) == 403
    assert status(gate, request(host="127.0.0.1:8017", origin="http://127.0.0.1:9")) == 403
    assert status(gate, request(host="127.0.0.1:8017", origin="null")) == 403


def test_a_name_that_leads_here_by_a_trick_of_its_dns_is_refused() -> None:
    assert status(Gate.at("127.0.0.1:8017"), request(host="elsewhere.example:8017")) == 403
    assert status(Gate.at("127.0.0.1:8017"), request()) == 403


def test_beyond_loopback_the_address_needs_its_token() -> None:
    gate = Gate.at("0.0.0.0:8017")
    assert gate.token
    assert len(gate.token) >= 32
    assert gate.address(8017).endswith(f":8017/{gate.token}/")
    assert status(gate, request(host="10.0.0.7:8017")) == 401
    assert status(gate, request(f"/{gate.token[:-1]}/", host="10.0.0.7:8017")) == 401
    assert status(gate, request(f"/{gate.token}é/", host="10.0.0.7:8017")) == 401
    asked = request(f"/{gate.token}/index.html", host="10.0.0.7:8017")
    assert status(gate, asked) is None
    assert asked.path == "/index.html"


@pytest.mark.parametrize("listen", ["8017", ":8017", "127.0.0.1", "127.0.0.1:x", "127.0.0.1:70000"])
def test_what_is_no_address_is_refused(listen: str) -> None:
    with pytest.raises(InvalidRequest, match=r"like 127\.0\.0\.1:8080"):
        Gate.at(listen)
