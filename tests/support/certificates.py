"""Certificates that `zarm certs` would not make: expired, of another authority, for any name."""

from __future__ import annotations

from pathlib import Path

from zarm_cli.certificate_authority import Authority, today
from zarm_contract.roles import Role


def issue(certificates: Path, to: Path, role: Role, **changes: object) -> None:
    """Put into `to` a certificate for a role by the authority of `certificates`."""
    authority = Authority.load(certificates.with_name(f"{certificates.name}-authority"))
    to.mkdir(exist_ok=True)
    (to / "ca.pem").write_bytes(authority.pem())
    arguments = {"role": role, "hosts": [], "now": today()} | changes
    pem, key = authority.issue(**arguments)  # type: ignore[arg-type]
    (to / f"{role}.pem").write_bytes(pem)
    (to / f"{role}.key").touch(mode=0o600)
    (to / f"{role}.key").write_bytes(key)
