"""The certificates of this process, checked before a session opens, and Zenoh's settings for them.

Loaded only with ZARM_SECURITY on, because the standard library's ssl is slow to load.
"""

from __future__ import annotations

import os
import socket
import ssl
import stat
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from zarm_contract.errors import InvalidRequest
from zarm_contract.roles import Role
from zarm_runtime.security import PAGE

_DAY = 86400.0
_PROBE_SECONDS = 2.0


class Certificates:
    """The authority's certificate, and certificate and key of one role, in the folder `ZARM_CERTS`.

    Raises InvalidRequest with the remedy for a file that is missing, unreadable, inconsistent, expired, or made by
    another authority or for another role, and for a key that everyone may read.
    """

    def __init__(self, role: Role) -> None:
        folder = os.environ.get("ZARM_CERTS")
        if not folder:
            raise InvalidRequest(
                "ZARM_SECURITY=on needs ZARM_CERTS, the folder with the certificates; `zarm certs FOLDER` makes one",
                field="ZARM_CERTS",
            )
        self.folder = Path(folder).absolute()
        self.role = role
        self.authority = self.folder / "ca.pem"
        self.certificate = self.folder / f"{role}.pem"
        self.key = self.folder / f"{role}.key"
        for file in (self.authority, self.certificate, self.key):
            _require_readable(file, self.folder)
        if self.key.stat().st_mode & stat.S_IRWXO:
            raise InvalidRequest(
                f"everybody on this machine may read {self.key}; `chmod 600 {self.key}`", field="ZARM_CERTS"
            )
        self.days_left = (self._end() - time.time()) / _DAY

    def of_page(self) -> ssl.SSLContext:
        """TLS for a page opened in browsers, with its own certificate, which no authority of the bus has signed."""
        certificate, key = self.folder / f"{PAGE}.pem", self.folder / f"{PAGE}.key"
        for file in (certificate, key):
            _require_readable(file, self.folder)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(certificate, key)
        except ssl.SSLError:
            raise InvalidRequest(
                f"{key} does not belong to {certificate}; move both away, and `zarm certs {self.folder}` makes new ones",
                field="ZARM_CERTS",
            ) from None
        return context

    def settings(self) -> dict[str, object]:
        """Zenoh's settings for a client, and for a router, which is a client on its links."""
        tls: dict[str, object] = {
            "root_ca_certificate": str(self.authority),
            "enable_mtls": True,
            "verify_name_on_connect": True,
            # New connections need a valid certificate; no robot in motion is stopped by an expiry date.
            "close_link_on_expiration": False,
        }
        for side in ("connect", "listen") if self.role == "router" else ("connect",):
            tls |= {f"{side}_certificate": str(self.certificate), f"{side}_private_key": str(self.key)}
        return {f"transport/link/tls/{name}": value for name, value in tls.items()}

    def why_not(self, host: str, port: int) -> str | None:
        """Why a router at this address is not acceptable; None if the fault is not one of certificates."""
        context = self._context(ssl.PROTOCOL_TLS_CLIENT)
        try:
            with (
                socket.create_connection((host, port), _PROBE_SECONDS) as plain,
                context.wrap_socket(plain, server_hostname=host),
            ):
                return None
        except ssl.SSLCertVerificationError as error:
            if error.verify_code in _OTHER_NAME:
                return (
                    f"the certificate of the router there does not hold the name {host}; run "
                    f"`zarm certs {self.folder} --host {host}` on the machine with its authority's key to add it"
                )
            return (
                f"the certificate of the router there is not to be trusted ({error.verify_message}); {_ONE_AUTHORITY}"
            )
        except ssl.SSLError:
            return "what listens there does not speak TLS; start the router with ZARM_SECURITY=on too"
        except OSError:
            return None

    def _context(self, protocol: int) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        try:
            context.load_verify_locations(self.authority)
        except ssl.SSLError:
            raise self._unusable(f"{self.authority} holds no certificate") from None
        try:
            context.load_cert_chain(self.certificate, self.key)
        except ssl.SSLError as error:
            reason = "does not belong to" if error.reason == "KEY_VALUES_MISMATCH" else "cannot be used with"
            raise self._unusable(f"{self.key} {reason} {self.certificate}") from None
        return context

    def _end(self) -> float:
        """When the certificate ends (Unix seconds), as a peer sees it: by a handshake with oneself."""
        server = self._context(ssl.PROTOCOL_TLS_SERVER)
        server.verify_mode = ssl.CERT_REQUIRED
        client = self._context(ssl.PROTOCOL_TLS_CLIENT)
        client.check_hostname, client.verify_mode = False, ssl.CERT_NONE
        to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
        shows = client.wrap_bio(to_client, to_server)
        sees = server.wrap_bio(to_server, to_client, server_side=True)
        try:
            for end in (shows, sees, shows, sees):
                with suppress(ssl.SSLWantReadError):
                    end.do_handshake()
        except ssl.SSLCertVerificationError as error:
            if error.verify_code in _TIMES:
                raise InvalidRequest(
                    f"{self.certificate} {_TIMES[error.verify_code]}; run `zarm certs {self.folder}` on the machine with its "
                    "authority's key to renew it (and check the clock of this machine)",
                    field="ZARM_CERTS",
                ) from None
            raise self._unusable(f"{self.certificate} was not made by the authority of {self.authority}") from None
        shown: Any = sees.getpeercert() or {}
        names = dict(pair for part in shown["subject"] for pair in part)
        if names.get("commonName") != self.role:
            raise self._unusable(f"{self.certificate} was made for the role {names.get('commonName')}, not {self.role}")
        return ssl.cert_time_to_seconds(shown["notAfter"])

    def _unusable(self, reason: str) -> InvalidRequest:
        return InvalidRequest(f"{reason}; {_ONE_AUTHORITY}", field="ZARM_CERTS")


_ONE_AUTHORITY = "take ca.pem, certificates and keys of one authority, as `zarm certs` made them"
_TIMES = {9: "is not valid yet", 10: "has ended"}  # OpenSSL's X509_V_ERR_CERT_NOT_YET_VALID and _HAS_EXPIRED
_OTHER_NAME = (62, 64)  # X509_V_ERR_HOSTNAME_MISMATCH and _IP_ADDRESS_MISMATCH


def _require_readable(file: Path, folder: Path) -> None:
    try:
        file.open("rb").close()
    except FileNotFoundError:
        raise InvalidRequest(
            f"{file} is missing; copy it to this machine, or make it with `zarm certs {folder}`",
            field="ZARM_CERTS",
        ) from None
    except OSError as error:
        raise InvalidRequest(
            f"{file} cannot be read ({error.strerror}); it must belong to the user of the process, with mode 600 for a key",
            field="ZARM_CERTS",
        ) from None
