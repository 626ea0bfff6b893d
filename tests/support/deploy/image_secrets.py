"""Secrets in an image, in any of its layers: what one layer adds and the next removes is still published."""

from __future__ import annotations

import re
import subprocess
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path

FORMS = {
    b"PRIVATE KEY": rb"-----BEGIN (?:[A-Z]+ )*PRIVATE KEY(?: BLOCK)?-----\s+[\w+/=:,\s-]{64}",
    b"AKIA": rb"\bAKIA[0-9A-Z]{16}\b",  # Amazon
    **{b"gh%c_" % kind: rb"\bgh[pousr]_[A-Za-z0-9]{36}" for kind in b"pousr"},
    b"github_pat_": rb"\bgithub_pat_\w{60}",
    b"glpat-": rb"\bglpat-[\w-]{20}",
    b"npm_": rb"\bnpm_[A-Za-z0-9]{36}\b",
    b"pypi-AgE": rb"\bpypi-AgE[\w-]{50}",
    b"xox": rb"\bxox[abprs]-[0-9]{8,}-",  # Slack
}
"""Private keys, and tokens with a distinctive form, by a word that they contain."""

WORDS = re.compile(rb"""://[^/\s"'@]+:[^/\s"'@]+@|(?i:password|passwd|secret|token)[\w-]*=[^\s"'$]""")
"""A password in an address or in the environment, in the history of the image."""

FILES = re.compile(
    r"(^|/)(\.?pip\.conf|\.netrc|\.pypirc|\.npmrc|\.env|\.git-credentials|\.docker/config\.json|id_(rsa|ecdsa|ed25519))$"
    r"|\.(key|p12|pfx|jks)$|(^|/)\.git/|^certs/.|^root/\.(ssh|gnupg|aws)/."
)
"""Names of files that contain credentials, or the origin of packages."""


PROGRAM = b"\x7fELF"
"""Magic number of programs and libraries; those of cryptography contain keys for self-tests."""


def found_in(images: Sequence[str], folder: Path) -> Iterator[str]:
    """Places in `images`, saved to `folder` meanwhile, that look like a secret."""
    archive = folder / "images.tar"
    subprocess.run(["docker", "save", "--output", str(archive), *images], check=True)
    try:
        with tarfile.open(archive) as saved:
            for entry in saved:
                if entry.isfile():
                    yield from _in_entry(saved, entry)
    finally:
        archive.unlink()


def _in_entry(saved: tarfile.TarFile, entry: tarfile.TarInfo) -> Iterator[str]:
    try:
        with tarfile.open(fileobj=saved.extractfile(entry)) as layer:
            yield from _in_layer(layer)
    except tarfile.ReadError:  # not a layer, but the description of the image
        description = _contents(saved, entry)
        if _holds_secret(description) or WORDS.search(description):
            yield f"{entry.name}: a secret in how the image was made: {description.decode(errors='replace')}"


def _in_layer(layer: tarfile.TarFile) -> Iterator[str]:
    for file in layer:
        if not file.isfile():
            continue
        name = file.name.removeprefix("./")
        if FILES.search(name) and file.size:
            yield f"{name}: a file of this name"
        contents = _contents(layer, file)
        if not contents.startswith(PROGRAM) and _holds_secret(contents):
            yield f"{name}: a private key or token"


def _contents(archive: tarfile.TarFile, file: tarfile.TarInfo) -> bytes:
    opened = archive.extractfile(file)
    assert opened
    with opened:
        return opened.read()


def _holds_secret(contents: bytes) -> bool:
    return any(word in contents and re.search(form, contents) for word, form in FORMS.items())
