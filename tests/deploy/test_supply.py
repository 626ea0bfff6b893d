"""Nothing that anybody keeps to himself lies in a layer of an image, not even where a later layer removes it."""

from __future__ import annotations

import os
import secrets
import subprocess
import tomllib
from base64 import encodebytes
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.deploy.image_secrets import found_in
from support.paths import ROOT

VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
TAG = os.environ.get("ZARM_TAG", VERSION)
IMAGES = [f"zarm-{service}:{TAG}" for service in ("router", "planner", "servo", "executor", "ros-bridge", "leeloo-sim")]


def docker(*words: str, check: bool = True) -> int:
    return subprocess.run(["docker", *words], check=check, capture_output=True).returncode


@pytest.fixture(scope="module")
def images() -> list[str]:
    if missing := [image for image in IMAGES if docker("image", "inspect", image, check=False)]:
        pytest.skip(f"not built here: {', '.join(missing)}")
    return IMAGES


@pytest.fixture
def careless(tmp_path: Path) -> Iterator[str]:
    """An image whose maker emptied his key after use, wrote where his packages came from and set a token."""
    key = b"-----BEGIN PRIVATE KEY-----\n" + encodebytes(secrets.token_bytes(96)) + b"-----END PRIVATE KEY-----\n"
    (tmp_path / "used").write_bytes(key)
    (tmp_path / "pip.conf").write_text("[global]\ntimeout = 10\n")
    (tmp_path / "empty").touch()
    (tmp_path / "Dockerfile").write_text(
        "FROM scratch\nCOPY used /tmp/used\nCOPY empty /tmp/used\nCOPY pip.conf /etc/pip.conf\n"
        f"ENV UPLOAD_TOKEN={secrets.token_hex(8)}\n"
    )
    name = f"zarm-careless:{os.getpid()}"
    docker("build", "--force-rm", "--tag", name, str(tmp_path))
    yield name
    docker("image", "rm", name)


def test_no_layer_of_any_image_holds_a_secret(images: list[str], tmp_path: Path) -> None:
    assert list(found_in(images, tmp_path)) == []


def test_what_a_careless_maker_leaves_in_an_image_is_found(careless: str, tmp_path: Path) -> None:
    found = "\n".join(found_in([careless], tmp_path))
    assert "tmp/used: a private key or token" in found
    assert "etc/pip.conf: a file of this name" in found
    assert "UPLOAD_TOKEN" in found
