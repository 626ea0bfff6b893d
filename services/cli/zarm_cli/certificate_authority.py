"""A private X.509 authority: one certificate for each role, with the role as its common name."""

from __future__ import annotations

import ipaddress
import os
import re
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from zarm_contract.errors import InvalidRequest

AUTHORITY_LASTS = timedelta(days=3650)
CERTIFICATE_LASTS = timedelta(days=730)
"""Two years: shorter than a robot's life, so that a lost key does not stay valid for ever; long enough for a lab."""
_BEFORE = timedelta(days=1)
"""Certificates are valid from one day ago, for machines whose clock is slow."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9_-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9_-]*[A-Za-z0-9])?)*")


@dataclass(frozen=True)
class Authority:
    """Anyone with its key can take any role: the robots' administrator keeps it, and no service needs it."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def make(cls, folder: Path, now: datetime) -> Authority:
        """A new authority, its `ca.pem` and `ca.key` in `folder`, which only its owner can access."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"zarm authority {secrets.token_hex(4)}")
        certificate = (
            _builder(name, name, key.public_key(), now, now + AUTHORITY_LASTS)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_secret(folder / "ca.key", _pem_key(key))
        (folder / "ca.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
        return cls(certificate, key)

    @classmethod
    def load(cls, folder: Path) -> Authority:
        """The authority in `folder`. Raises InvalidRequest if it is damaged."""
        try:
            key = load_pem_private_key((folder / "ca.key").read_bytes(), None)
        except (OSError, ValueError, TypeError) as error:
            raise InvalidRequest(f"the authority's key {folder / 'ca.key'} cannot be read: {error}") from error
        certificate = load_certificate(folder / "ca.pem")
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise InvalidRequest(
                f"{folder / 'ca.key'} is not the key of {folder / 'ca.pem'}; restore both from a backup"
            )
        return cls(certificate, key)

    def pem(self) -> bytes:
        """Its certificate, which is public and which everyone needs."""
        return self.certificate.public_bytes(Encoding.PEM)

    def made(self, certificate: x509.Certificate) -> bool:
        """Whether it issued this certificate."""
        try:
            certificate.verify_directly_issued_by(self.certificate)
        except (ValueError, TypeError, InvalidSignature):
            return False
        return True

    def issue(
        self, role: str, hosts: Sequence[str], now: datetime, lasts: timedelta = CERTIFICATE_LASTS
    ) -> tuple[bytes, bytes]:
        """A certificate for `role` and its new key, PEM; for a role that accepts connections, valid for these `hosts`."""
        key = ec.generate_private_key(ec.SECP256R1())
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
        end = min(now + lasts, self.certificate.not_valid_after_utc)
        builder = (
            _builder(_name(role), self.certificate.subject, key.public_key(), now, end)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key()), critical=False)
        )
        if hosts:
            builder = builder.add_extension(_names(hosts), critical=False)
        return builder.sign(self.key, hashes.SHA256()).public_bytes(Encoding.PEM), _pem_key(key)


def vouching_for_itself(name: str, hosts: Sequence[str], now: datetime) -> tuple[bytes, bytes]:
    """A self-signed server certificate for these `hosts` and its new key, PEM: on the bus it is not accepted as a
    router's.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    return (
        _builder(_name(name), _name(name), key.public_key(), now, now + CERTIFICATE_LASTS)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(_names(hosts), critical=False)
        .sign(key, hashes.SHA256())
        .public_bytes(Encoding.PEM)
    ), _pem_key(key)


def load_certificate(file: Path) -> x509.Certificate:
    """The certificate in a PEM file. Raises InvalidRequest."""
    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except (OSError, ValueError) as error:
        raise InvalidRequest(f"the certificate {file} cannot be read: {error}; restore it, or move it away") from error


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """The names and addresses that a certificate is valid for."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))]


def with_loopback(hosts: Iterable[str]) -> list[str]:
    """Hosts for a server certificate, this machine's own names first. Raises InvalidRequest for an invalid host."""
    return list(dict.fromkeys((*_LOOPBACK, *(str(_host(host).value) for host in hosts))))


def write_secret(file: Path, content: bytes) -> None:
    """Write a key that only its owner can read, replacing an old one atomically."""
    new = file.with_name(f"{file.name}.{secrets.token_hex(4)}")
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
        stream.write(content)
    new.replace(file)


def today() -> datetime:
    """Now, in UTC."""
    return datetime.now(UTC)


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        if not _HOST.fullmatch(host):
            raise InvalidRequest(f"{host!r} is neither a host name nor an address", field="--host") from None
        return x509.DNSName(host.lower())


def _names(hosts: Sequence[str]) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([_host(host) for host in hosts])


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now: datetime, end: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BEFORE)
        .not_valid_after(end)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _pem_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
