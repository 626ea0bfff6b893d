"""`zarm certs`: what it makes, renews, and does not overwrite."""

from __future__ import annotations

import stat
import subprocess
from datetime import timedelta
from pathlib import Path

import pytest

from support.certificates import issue
from support.command_line import the_one_line, zarm
from support.harness import free_endpoint
from zarm_cli.certificate_authority import Authority, hosts_of, load_certificate, today
from zarm_contract.errors import InvalidRequest
from zarm_contract.roles import ROLES, Role
from zarm_runtime.certificates import Certificates
from zarm_runtime.security import RENEWAL_DAYS
from zarm_runtime.session import open_client, open_router


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def made(folder: Path, *arguments: str) -> str:
    result = zarm("certs", str(folder), *arguments)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_each_role_gets_its_certificate_and_a_private_key(certificates: Path) -> None:
    for role in ROLES:
        assert f"CN={role}" in load_certificate(certificates / f"{role}.pem").subject.rfc4514_string()
        assert stat.S_IMODE((certificates / f"{role}.key").stat().st_mode) == 0o600


def test_the_authority_s_key_is_in_a_folder_others_cannot_enter(certificates: Path) -> None:
    kept = certificates.with_name("certs-authority")
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700
    assert stat.S_IMODE((kept / "ca.key").stat().st_mode) == 0o600
    assert not list(certificates.glob("ca.key"))


def test_run_again_it_changes_nothing_that_is_good(tmp_path: Path) -> None:
    made(tmp_path / "certs")
    before = contents(tmp_path / "certs")
    assert made(tmp_path / "certs").count("kept") == len(ROLES) + 1  # and the page
    assert contents(tmp_path / "certs") == before


def test_run_again_it_adds_hosts_to_what_is_connected_to_alone(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    made(folder, "--host", "workstation")
    before = contents(folder)
    made(folder, "--host", "192.168.7.5")
    assert {name for name, content in contents(folder).items() if before[name] != content} == {
        "router.pem",
        "router.key",
        "page.pem",
        "page.key",
    }
    for name in ("router", "page"):
        hosts = hosts_of(load_certificate(folder / f"{name}.pem"))
        assert {"localhost", "127.0.0.1", "workstation", "192.168.7.5"} <= {*hosts}


def test_the_page_s_certificate_is_not_a_router_s(certificates: Path) -> None:
    authority = Authority.load(certificates.with_name(f"{certificates.name}-authority"))
    assert authority.made(load_certificate(certificates / "router.pem"))
    assert not authority.made(load_certificate(certificates / "page.pem"))
    assert stat.S_IMODE((certificates / "page.key").stat().st_mode) == 0o600


def test_run_again_it_renews_what_is_about_to_end(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    made(folder)
    issue(folder, folder, "planner", lasts=timedelta(days=RENEWAL_DAYS - 1))
    before = contents(folder)
    assert "renewed" in made(folder)
    assert {name for name, content in contents(folder).items() if before[name] != content} == {
        "planner.pem",
        "planner.key",
    }


def test_certificates_of_another_authority_are_not_overwritten(tmp_path: Path) -> None:
    made(tmp_path / "certs")
    before = contents(tmp_path / "certs")
    refused = zarm("certs", str(tmp_path / "certs"), "--authority", str(tmp_path / "elsewhere"))
    assert refused.returncode == 1
    assert "--authority" in the_one_line(refused.stderr)
    made(tmp_path / "other")
    (tmp_path / "certs" / "ca.pem").unlink()
    refused = zarm("certs", str(tmp_path / "certs"), "--authority", str(tmp_path / "other-authority"))
    assert refused.returncode == 1
    assert "was not made by the authority" in the_one_line(refused.stderr)
    before.pop("ca.pem")
    assert contents(tmp_path / "certs") == before


def test_an_invalid_host_name_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    refused = zarm("certs", str(tmp_path / "certs"), "--host", "tcp/10.0.0.1:7447")
    assert refused.returncode == 1
    assert "neither a host name nor an address" in the_one_line(refused.stderr)
    assert not list(tmp_path.iterdir())


def test_openssl_finds_the_chain_good(certificates: Path) -> None:
    for role in ROLES:
        subprocess.run(
            ["openssl", "verify", "-x509_strict", "-CAfile", certificates / "ca.pem", certificates / f"{role}.pem"],
            check=True,
            capture_output=True,
        )


def test_unusable_certificates_are_refused_with_the_remedy(
    certificates: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reason(folder: Path, role: Role) -> str:
        monkeypatch.setenv("ZARM_CERTS", str(folder))
        with pytest.raises(InvalidRequest) as refusal:
            Certificates(role)
        return str(refusal.value)

    monkeypatch.delenv("ZARM_CERTS", raising=False)
    with pytest.raises(InvalidRequest, match="zarm certs FOLDER"):
        Certificates("planner")
    here = tmp_path / "here"
    issue(certificates, here, "planner")
    assert f"{here}/viewer.pem is missing; copy it to this machine" in reason(here, "viewer")
    issue(certificates, here, "planner", now=today() - timedelta(days=20), lasts=timedelta(days=10))
    assert "planner.pem has ended" in reason(here, "planner")
    issue(certificates, here, "planner", now=today() + timedelta(days=20))
    assert "planner.pem is not valid yet" in reason(here, "planner")
    issue(certificates, here, "planner")
    (here / "viewer.pem").write_bytes((here / "planner.pem").read_bytes())
    (here / "viewer.key").write_bytes((here / "planner.key").read_bytes())
    assert "everybody on this machine may read" in reason(here, "viewer")
    (here / "viewer.key").chmod(0o600)
    assert "made for the role planner, not viewer" in reason(here, "viewer")
    (here / "viewer.key").write_bytes((certificates / "viewer.key").read_bytes())
    assert "does not belong to" in reason(here, "viewer")
    (here / "viewer.key").write_text("nonsense")
    assert "cannot be used with" in reason(here, "viewer")
    made(tmp_path / "other")
    (here / "ca.pem").write_bytes((tmp_path / "other" / "ca.pem").read_bytes())
    assert "was not made by the authority" in reason(here, "planner")
    (here / "ca.pem").write_text("nonsense")
    assert "holds no certificate" in reason(here, "planner")


def test_every_certificate_that_was_made_can_be_used(secured: Path) -> None:
    for role in ROLES:
        assert Certificates(role).days_left > RENEWAL_DAYS


@pytest.mark.parametrize("role", ROLES)
def test_every_role_may_connect(role: Role, secured: Path) -> None:
    endpoint = free_endpoint()
    with open_router(endpoint), open_client(endpoint, role=role) as session:
        assert list(session.info.routers_zid())


@pytest.mark.parametrize("command", ["router", "up"])
def test_listening_beyond_localhost_without_certificates_warns(command: str, certificates: Path) -> None:
    elsewhere = "tcp/192.0.2.1:7447"  # no address of this machine's: nothing is opened, and the command ends
    with_security = {"ZARM_SECURITY": "on", "ZARM_CERTS": str(certificates)}
    warned = zarm(command, "--listen", elsewhere)
    silent = zarm(command, "--listen", elsewhere, **with_security)
    assert (warned.returncode, silent.returncode) == (3, 3)
    assert f"anyone who reaches {elsewhere} from another machine can move the robot" in warned.stderr
    assert "zarm certs" in warned.stderr
    assert "anyone" not in silent.stderr
