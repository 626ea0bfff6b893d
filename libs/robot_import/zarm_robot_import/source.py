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

from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.urdf_document import UrdfDocument, parse_urdf

_ABOVE = 6
"""Number of folders above the source in which packages are searched."""
_ALIKE = 4
"""Least length of a folder's name that may match the beginning of a package's name."""
_PATHS = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
_MARKS = codecs.BOM_UTF8 + codecs.BOM_UTF16 + b"\0 \t\r\n"
"""What may stand before the first element, in any encoding."""
_ARGUMENT = re.compile(r"""<xacro:arg\s[^>]*?name\s*=\s*["']([^"']+)|\$\(arg\s+([^)\s]+)\s*\)""")
"""A xacro's argument, where it is declared or used."""
_NO_VALUE = re.compile(r"Undefined substitution argument (\w+)")


@dataclass(frozen=True)
class Source(UrdfDocument):
    """A robot's XML. For an expanded xacro the `lines` count in the expanded text, which nobody has, so that its `files` are searched
    for the name of what is at fault.
    """

    files: tuple[Path, ...]
    expanded: bool
    packages: tuple[Path, ...]

    def place(self, element: ET.Element) -> str:
        """`file:line`; for an expanded xacro the line that names the element, or what it is part of, if there is one."""
        if not self.expanded:
            return super().place(element)
        named = next((one for one in reversed(self._above(element)) if one.get("name")), None)
        if named is None:
            return f"{self.path}"
        text = f'name="{named.get("name")}"'
        for file in self.files:
            lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
            for number, line in enumerate(lines, 1):
                if f"<{named.tag}" in line and text in line:
                    return f"{file}:{number}"
        return f"{self.path} (in the expanded <{named.tag} {text}>)"

    def _above(self, element: ET.Element) -> list[ET.Element]:
        """The element and those around it, the outermost first."""
        parents = {child: parent for parent in self.root.iter() for child in parent}
        found = [element]
        while found[0] in parents:
            found.insert(0, parents[found[0]])
        return found[1:]

    @property
    def srdfs(self) -> list[Path]:
        """The SRDFs in the folders in which that of this robot may lie: in its own, or as in packages of descriptions and of MoveIt's configuration."""
        folders = [self.path.parent / place for place in (".", "../srdf", "../config")]
        return sorted({file.resolve() for folder in folders for file in folder.glob("*.srdf")})

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
    files: tuple[Path, ...] = (path,)
    expanded = b"xacro:" in text or b"${" in text or path.suffix == ".xacro"
    if expanded:
        text, files = _expanded(path, packages, arguments or {})
    elif arguments:
        raise InvalidRequest(f"{path} is no xacro file, so it takes no arguments", field="--arg")
    document = parse_urdf(path, text)
    return Source(document.path, document.root, document.lines, files, expanded, packages)


def fingerprint(path: Path) -> bytes:
    """Bytes that change with a URDF or xacro, its includes and the files that it names. Raises as `read_source`."""
    source = read_source(path)
    named = [mesh.get("filename", "") for mesh in source.root.iter("mesh")]
    named += [(parameters.text or "").strip() for parameters in source.root.iter("parameters")]
    files = {file for name in named if name and (file := source.file(name))} | {*source.srdfs}
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


def _expanded(path: Path, packages: Sequence[Path], arguments: Mapping[str, str]) -> tuple[bytes, tuple[Path, ...]]:
    """The expanded text, and the files that it is made of."""
    try:
        import xacro
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
        xacro.all_includes.clear()
        init_stacks(None)  # after a failure xacro would still search beside the previous file
        try:
            # xacro resolves an include without a folder in the working directory.
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()), chdir(path.parent):
                expanded = XacroDoc.from_file(str(path), subargs=dict(arguments), resolve_packages=False)
                text: str = expanded.to_urdf_string()
                included = (Path(name).resolve() for name in xacro.all_includes)
                files = tuple(dict.fromkeys((path, *(file for file in included if file.is_file()))))
            _check_arguments(path, files, arguments)
            return text.encode(), files
        except InvalidRequest:
            raise
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


def _check_arguments(path: Path, files: Sequence[Path], arguments: Mapping[str, str]) -> None:
    """Raise InvalidRequest for an argument that no file of a xacro has: xacro itself ignores it."""
    texts = [file.read_text(encoding="utf-8", errors="replace") for file in files]
    known = {declared or used for text in texts for declared, used in _ARGUMENT.findall(text)}
    for name in arguments:
        if name not in known:
            there = f"there are {', '.join(sorted(known))}" if known else "it takes none"
            raise InvalidRequest(f"{path} has no argument {name}; {there}", field="--arg")
