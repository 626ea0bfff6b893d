"""The source of an import: a URDF or xacro as XML with the line of each element, and the files that it names."""

from __future__ import annotations

import codecs
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from urllib.parse import unquote
from xml.parsers import expat

from zarm_contract.errors import InvalidRequest, Unavailable

_ABOVE = 6
"""Number of folders above the source in which packages are searched."""
_ALIKE = 4
"""Least length of a folder's name that may match the beginning of a package's name."""
_PATHS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
_MARKS = codecs.BOM_UTF8 + codecs.BOM_UTF16 + b"\0 \t\r\n"
"""What may stand before the first element, in any encoding."""
_NO_VALUE = re.compile(r"Undefined substitution argument (\w+)")


@dataclass(frozen=True)
class Source:
    """A robot's XML. `lines` are those of the elements; for an expanded xacro they count in the expanded text."""

    path: Path
    root: ET.Element
    lines: dict[ET.Element, int]
    expanded: bool
    packages: tuple[Path, ...]

    def fault(self, element: ET.Element, message: str) -> InvalidRequest:
        """An error with file, line and remedy."""
        return InvalidRequest(f"{self.place(element)}: {message}")

    def place(self, element: ET.Element) -> str:
        """`file:line`."""
        return f"{self.path}:{self.lines[element]}{' (of the expanded xacro)' if self.expanded else ''}"

    def file(self, name: str) -> Path | None:
        """The file that a URI in the XML names, None if there is none."""
        scheme, _, rest = name.rpartition("://")
        rest = unquote(rest)
        if scheme == "package" or scheme == "model":
            package, _, inside = rest.partition("/")
            folder = find_package(package, self.path, self.packages)
            # A package copied without its folder: its content is beside or above the source.
            folders = [folder] if folder else [*self.path.parents][:_ABOVE]
            candidates = [place / inside for place in folders] + [place / rest for place in folders]
        else:
            candidates = [Path("/") / rest if scheme == "file" else self.path.parent / rest]
            candidates += [place / rest.lstrip("/") for place in [*self.path.parents][1:_ABOVE]]
        return next((path for path in candidates if path.is_file()), None)


def read_source(path: Path, packages: Sequence[Path] = (), arguments: Mapping[str, str] | None = None) -> Source:
    """Read a URDF, or expand a xacro with `arguments`. Raises InvalidRequest with file and line, Unavailable without
    the package xacro.
    """
    path = path.resolve()
    packages = tuple(packages)
    for folder in packages:
        if not folder.is_dir():
            raise InvalidRequest(f"there is no folder {folder}; name one that holds ROS packages", field="--packages")
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InvalidRequest(f"cannot read {path}: {error.strerror or error}") from error
    if not text.strip():
        raise InvalidRequest(f"{path} is empty; name a URDF or xacro")
    if not text.lstrip(_MARKS).startswith(b"<"):
        raise InvalidRequest(f"{path} is no XML; name a URDF or xacro")
    expanded = b"xacro:" in text or b"${" in text or path.suffix == ".xacro"
    if expanded:
        text = _expanded(path, packages, arguments or {})
    elif arguments:
        raise InvalidRequest(f"{path} is no xacro file, so it takes no arguments", field="--arg")
    lines: dict[ET.Element, int] = {}
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text, True)
    except (LookupError, ValueError) as error:  # of an encoding that Python does not know
        raise InvalidRequest(f"{path}: {error}; save the file as UTF-8") from error
    except expat.ExpatError as error:
        raise InvalidRequest(
            f"{path}:{error.lineno}: not well-formed XML: {expat.ErrorString(error.code)}; correct this line"
        ) from error
    root = builder.close()
    source = Source(path, root, lines, expanded, packages)
    if root.tag != "robot":
        raise source.fault(root, f"a URDF starts with <robot>; this file starts with <{root.tag}>")
    return source


def fingerprint(path: Path) -> bytes:
    """Bytes that change with a URDF or xacro, its includes and the files that it names. Raises as `read_source`."""
    source = read_source(path)
    named = [mesh.get("filename", "") for mesh in source.root.iter("mesh")]
    named += [(parameters.text or "").strip() for parameters in source.root.iter("parameters")]
    files = {file for name in named if name and (file := source.file(name))}
    states = (f"{file} {(state := file.stat()).st_mtime_ns} {state.st_size}" for file in sorted(files))
    return "\n".join([ET.tostring(source.root, encoding="unicode"), *states]).encode()


def find_package(name: str, path: Path, packages: Sequence[Path]) -> Path | None:
    """The folder of a ROS package: in `packages`, in ROS's environment, or around the file `path`."""
    stated = [*packages]
    for variable in _PATHS:
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            stated += [Path(entry), Path(entry) / "share"]
    for folder in stated:
        if folder.name == name or _named(folder) == name:
            return folder
        if (folder / name).is_dir():
            return folder / name
        if found := _within(folder).get(name):
            return found
    for folder in [*path.parents][:_ABOVE]:
        if folder.name == name or _named(folder) == name:
            return folder
        if (folder / name).is_dir():
            return folder / name
    # A package whose folder has another name.
    for folder in [*path.parents][1:3]:
        if found := _within(folder).get(name):
            return found
    # A package without package.xml, in a folder with a similar name: kuka_kr6_support in kuka_kr6.
    for folder in [*path.parents][:_ABOVE]:
        if len(folder.name) >= _ALIKE and (folder.name.startswith(name) or name.startswith(folder.name)):
            return folder
    return None


@cache
def _within(folder: Path) -> dict[str, Path]:
    """Packages up to two folders below, by the name in their package.xml."""
    files = [*folder.glob("*/package.xml"), *folder.glob("*/*/package.xml")]
    return {name: file.parent for file in sorted(files, reverse=True) if (name := _named(file.parent))}


def _named(folder: Path) -> str | None:
    try:
        return ET.parse(folder / "package.xml").getroot().findtext("name")  # noqa: S314 - a file of the user's own
    except (OSError, ET.ParseError):
        return None


def _expanded(path: Path, packages: Sequence[Path], arguments: Mapping[str, str]) -> bytes:
    try:
        from xacro import init_stacks
        from xacrodoc import XacroDoc
        from xacrodoc import packages as finder
    except ImportError as error:
        raise Unavailable(
            f"{path} is a xacro file, which needs the package xacrodoc; `pip install zarm[import]`, or expand it with xacro"
        ) from error
    # If ROS is installed, xacrodoc asks its index, which fails without this variable; the folder is searched anyway.
    if not os.environ.get("AMENT_PREFIX_PATH"):
        os.environ["AMENT_PREFIX_PATH"] = str(path.parent.resolve())
    finder.reset()
    finder.look_in([str(folder) for folder in packages])
    while True:
        init_stacks(None)  # after a failure xacro would still search beside the previous file
        try:
            # xacro resolves an include without a folder in the working directory.
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()), chdir(path.parent):
                expanded = XacroDoc.from_file(str(path), subargs=dict(arguments), resolve_packages=False)
                text: str = expanded.to_urdf_string()
            return text.encode()
        except Exception as error:  # xacro raises whatever its expressions raise
            missing = getattr(error, "exc", error)  # the error in an xacro expression
            if isinstance(missing, finder.PackageNotFoundError):
                name = missing.args[0]
                if (folder := find_package(name, path, packages)) is None:
                    raise InvalidRequest(
                        f"{path}: there is no package {name} around this file; name the folder that holds it with --packages"
                    ) from error
                finder.update_package_cache({name: folder})
                continue
            reason = " ".join(str(error).split())
            remedy = (
                f"give its value with --arg {lacking[1]}:=VALUE"
                if (lacking := _NO_VALUE.search(reason))
                else "correct it there"
            )
            raise InvalidRequest(f"{path}: xacro cannot expand it: {reason}; {remedy}") from error
