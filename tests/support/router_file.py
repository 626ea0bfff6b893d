"""Writes `deploy/router-secure.json5` from the table of `zarm_contract.access`: `python tests/support/router_file.py`."""

from __future__ import annotations

import json
import re
from pathlib import Path

from zarm_contract.access import access_control

FOLDER = Path(__file__).parents[2] / "deploy"
FILE = FOLDER / "router-secure.json5"
CERTIFICATES = "/certs"
"""Their folder in a container."""

_HEAD = """\
// Generated from router.json5 and the table in libs/contract/zarm_contract/access.py by tests/support/router_file.py.
// The router of a zarm bus with certificates and access control, for Zenoh's own router:
//     ZENOH_RUNTIME='(rx: (worker_threads: 16))' zenohd -c deploy/router-secure.json5 -l tls/0.0.0.0:7447
// `ZARM_SECURITY=on ZARM_CERTS=/certs zarm router` sets the same; a test compares the two. /certs is the folder made by
// `zarm certs`: a router needs only ca.pem, router.pem and router.key from it.
"""

_TLS = f"""\
      tls: {{
        root_ca_certificate: "{CERTIFICATES}/ca.pem",
        listen_certificate: "{CERTIFICATES}/router.pem",
        listen_private_key: "{CERTIFICATES}/router.key",
        // For links to routers of other machines.
        connect_certificate: "{CERTIFICATES}/router.pem",
        connect_private_key: "{CERTIFICATES}/router.key",
        verify_name_on_connect: true,
        // Only clients with a certificate of the same authority may connect.
        enable_mtls: true,
        // New connections need a valid certificate; existing ones stay open, so an expired certificate stops no moving robot.
        close_link_on_expiration: false,
      }},
"""


def text() -> str:
    """The required content of the file."""
    plain = (FOLDER / "router.json5").read_text()
    _, _, body = plain.partition("\n{\n")
    body = re.sub(r"  // Loopback.*\n", "  // Loopback, until -l says otherwise.\n", body).replace('"tcp/', '"tls/')
    body = body.replace("    link: {\n", f"    link: {{\n{_TLS}")
    rules = re.sub(r"\[[^\[\]{}]*\]", _on_one_line, json.dumps(access_control(), indent=2)).replace("\n", "\n  ")
    who = "// Who may send what, by the common name of the certificate. Everything else is denied.\n  "
    return f"{_HEAD}{{\n{body.removesuffix(chr(10)).removesuffix('}')}\n  {who}access_control: {rules},\n}}\n"


def _on_one_line(match: re.Match[str]) -> str:
    line = " ".join(match[0].split()).replace("[ ", "[").replace(" ]", "]")
    return line if len(line) < 100 else match[0]


if __name__ == "__main__":
    FILE.write_text(text())
