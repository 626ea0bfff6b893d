"""What the images hold may be shipped with software under Apache-2.0; `make licences` brings the list up to date."""

from __future__ import annotations

import re

import pytest

from support.paths import ROOT

DEPLOY = ROOT / "deploy"
INSTALLED = ("executor", "planner", "ros_bridge", "viewer")
LISTED = dict(re.findall(r"^\| ([\w.-]+) \| ([^|]+ \| [^|]+) \|", (DEPLOY / "LICENCES.md").read_text(), re.MULTILINE))

PERMISSIVE = re.compile(r"0BSD|Apache|BSD|CC0|ISC|MIT|PSF|Python Software Foundation|zlib", re.IGNORECASE)
"""Licences that ask for no more than that they be named."""

EITHER = "Eclipse Public License 2.0 (EPL-2.0)"
"""What eclipse-zenoh may be used under instead of Apache-2.0."""

UNCHANGED = {"certifi", "tqdm"}
"""Under MPL-2.0, which asks only for the source of files that were changed: the images hold them as they are published."""


def pins(file: str) -> dict[str, str]:
    text = (DEPLOY / "requirements" / f"{file}.txt").read_text()
    return dict(re.findall(r"^([\w.-]+)==(\S+)", text, re.MULTILINE))


@pytest.mark.parametrize("file", INSTALLED)
def test_every_package_of_an_image_is_listed_in_its_version(file: str) -> None:
    listed = {name: row.split(" | ")[0] for name, row in LISTED.items()}
    assert pins(file) == {name: listed.get(name) for name in pins(file)}


def test_nothing_is_listed_that_no_image_holds() -> None:
    assert set(LISTED) - {"package"} == {name for file in INSTALLED for name in pins(file)}


def test_every_licence_asks_nothing_of_its_users() -> None:
    def asks_nothing(licence: str) -> bool:
        parts = re.split(r" AND |; ", licence)
        return all(PERMISSIVE.search(part) or EITHER in part for part in parts) and licence != EITHER

    listed = {
        name: row.split(" | ")[1].strip() for name, row in LISTED.items() if name != "package" and name not in UNCHANGED
    }
    assert {name: licence for name, licence in listed.items() if not asks_nothing(licence)} == {}
