"""`zarm certs`: a private authority, certificates for each role and the page, and their renewal."""

from __future__ import annotations

from datetime import timedelta
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from zarm_cli.output import out
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.roles import ROLES
from zarm_runtime.security import PAGE, RENEWAL_DAYS

if TYPE_CHECKING:
    from datetime import datetime

    from zarm_cli.certificate_authority import Authority


def certs(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder for certificates and keys.")],
    host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A name or address of a router or of the page; repeatable."),
    ] = None,
    authority: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder for the key of the authority.  [default: FOLDER-authority]"),
    ] = None,
) -> None:
    """Make certificates for ZARM_SECURITY=on. Run it again to renew those that end soon and to add hosts."""
    if find_spec("cryptography") is None:
        raise Unavailable(
            "certificates are made with the package cryptography; `pip install 'zarm[certs]'` installs it"
        )
    from zarm_cli.certificate_authority import today

    folder = folder.absolute()
    kept_in = authority.absolute() if authority is not None else folder.with_name(f"{folder.name}-authority")
    now = today()
    try:
        done = _make(folder, kept_in, host or [], now)
    except OSError as error:
        raise InvalidRequest(f"{error.filename}: {error.strerror}; name a FOLDER that can be written to") from error
    table = Table("for", "", "valid until", box=None)
    for name, did, until in done:
        table.add_row(name, did, f"{until:%Y-%m-%d}")
    out.print(table)
    out.print(
        f"Each machine needs ca.pem, and <role>.pem and <role>.key of what runs there, out of {folder}. No machine of the bus "
        f"needs {kept_in}: whoever has the key in it can become any role. page.pem and page.key are those of the page in the browser "
        "(`zarm view`): have the browser trust page.pem.",
        soft_wrap=True,
    )


def _make(folder: Path, kept_in: Path, hosts: list[str], now: datetime) -> list[tuple[str, str, datetime]]:
    """What was done for each role and for the page, and the end of validity. Raises InvalidRequest without changing
    anything.
    """
    from zarm_cli.certificate_authority import (
        Authority,
        hosts_of,
        load_certificate,
        vouching_for_itself,
        with_loopback,
        write_secret,
    )

    hosts = with_loopback(hosts)
    existing = {name: load_certificate(file) for name in (*ROLES, PAGE) if (file := folder / f"{name}.pem").exists()}
    found = _authority(folder, kept_in, now)
    if found is None:
        if existing:
            raise InvalidRequest(f"{folder} holds certificates of another authority; name its folder with --authority")
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
        found = Authority.make(kept_in, now)
    for name, certificate in existing.items():
        if name != PAGE and not found.made(certificate):
            raise InvalidRequest(
                f"{folder / name}.pem was not made by the authority in {kept_in}; name the one that made it with --authority, or "
                "another folder for new certificates"
            )
    (folder / "ca.pem").write_bytes(found.pem())
    done: list[tuple[str, str, datetime]] = []
    for name in (*ROLES, PAGE):
        old = existing.get(name)
        wanted = with_loopback([*(hosts_of(old) if old else ()), *hosts]) if name in ("router", PAGE) else []
        key = folder / f"{name}.key"
        if old is not None and key.exists() and _good(old.not_valid_after_utc, now) and set(wanted) <= {*hosts_of(old)}:
            done.append((name, "kept", old.not_valid_after_utc))
            continue
        new, secret = vouching_for_itself(PAGE, wanted, now) if name == PAGE else found.issue(name, wanted, now)
        write_secret(key, secret)
        (folder / f"{name}.pem").write_bytes(new)
        until = load_certificate(folder / f"{name}.pem").not_valid_after_utc
        done.append((name, "made" if old is None else "renewed", until))
    return done


def _good(end: datetime, now: datetime) -> bool:
    return end - now > timedelta(days=RENEWAL_DAYS)


def _authority(folder: Path, kept_in: Path, now: datetime) -> Authority | None:
    from zarm_cli.certificate_authority import Authority, load_certificate

    shared = folder / "ca.pem"
    if not (kept_in / "ca.key").exists():
        if shared.exists():
            raise InvalidRequest(
                f"{folder} has an authority whose key is not in {kept_in}; name its folder with --authority, or another FOLDER "
                "for new certificates"
            )
        return None
    found = Authority.load(kept_in)
    if shared.exists() and load_certificate(shared) != found.certificate:
        raise InvalidRequest(f"{shared} is not the authority in {kept_in}; name the right one with --authority")
    if not _good(found.certificate.not_valid_after_utc, now):
        raise InvalidRequest(
            f"the authority in {kept_in} ends on {found.certificate.not_valid_after_utc:%Y-%m-%d}; make new certificates in "
            "another folder, and give them to all machines at once"
        )
    return found
