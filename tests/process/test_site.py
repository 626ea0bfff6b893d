"""The documentation: it builds, its links lead somewhere, and its pages load nothing from anywhere else."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.markdown import PAGES, ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it, of a copy, so that nothing appears in the working tree."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "docs", folder / "docs")
    (folder / "zensical.toml").write_text((ROOT / "zensical.toml").read_text())
    program = str(Path(sys.executable).with_name("zensical"))
    done = subprocess.run([program, "build", "--strict"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


def test_every_page_is_built_and_in_the_navigation(site: Path) -> None:
    pages = {path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")}
    built = {path.relative_to(site).with_suffix(".md") for path in site.rglob("index.html")}
    assert {path if path.name == "index.md" else path.with_suffix("") / "index.md" for path in pages} == built
    named = set(re.findall(r'"([\w/-]+\.md)"', (ROOT / "zensical.toml").read_text()))
    assert {str(path) for path in pages} == named


def test_the_pages_load_nothing_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text()
        loaded = re.findall(r'<(?:script|img|iframe|source)\b[^>]*\bsrc="?([^" >]+)', text)
        loaded += re.findall(
            r'<link\b[^>]*\brel="?(?:stylesheet|preload|preconnect|icon)"?[^>]*\bhref="?([^" >]+)', text
        )
        loaded += re.findall(
            r'<link\b[^>]*\bhref="?([^" >]+)"?[^>]*\brel="?(?:stylesheet|preload|preconnect|icon)', text
        )
        assert loaded
        assert [address for address in loaded if re.match(r"(https?:)?//", address)] == []
        assert "mermaid" not in text, f"{page}: its library would be fetched; use an image"


@pytest.mark.parametrize(
    "page", [path for path in PAGES if "docs" not in path.parts], ids=lambda path: str(path.relative_to(ROOT))
)
def test_the_links_of_a_readme_lead_somewhere(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([\w-]+))?\)", page.read_text()):
        linked = (page.parent / target).resolve() if target else page
        assert linked.exists(), target
        if anchor:
            assert anchor in {
                _anchor(heading) for heading in re.findall(r"^#+ (.*)$", linked.read_text(), re.MULTILINE)
            }


def _anchor(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")
