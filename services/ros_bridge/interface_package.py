"""Turns definitions of ROS interfaces into Python packages, with the generators of rosidl that pip installed.

For each interface, rclpy on Fast DDS needs its Python class, its C structure, the type support of Fast DDS, and its
introspection description, with which a topic is registered. Only these are made; a CMake build makes eight libraries
and takes far longer. The code of an interface depends only on its own definition and on those that it refers to, so
each is cached by their content.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cached_property
from graphlib import TopologicalSorter
from importlib.metadata import version
from pathlib import Path

import numpy
from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl
from rosidl_cli.command.helpers import generate_visibility_control_file
from rosidl_generator_c import generate_c
from rosidl_generator_py import generate_py
from rosidl_generator_type_description import generate_type_hash
from rosidl_parser.definition import IdlContent, IdlLocator
from rosidl_parser.parser import parse_idl_file
from rosidl_pycommon import convert_camel_case_to_lower_case_underscore, expand_template
from rosidl_typesupport_c import generate_c as generate_dispatch
from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
from rosidl_typesupport_introspection_c import generate_c as generate_introspection

PREFIX = Path(sys.prefix)
SITE_PACKAGES = Path(sysconfig.get_path("purelib")).relative_to(PREFIX)
KINDS = {".msg": convert_msg_to_idl, ".srv": convert_srv_to_idl, ".action": convert_action_to_idl}
ENTRY_POINT = "rosidl_typesupport_c"
"""The type support that rclpy loads, which finds the others."""
TYPE_SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
_GENERATORS = (
    "adapter",
    "generator-c",
    "generator-py",
    "parser",
    "typesupport-c",
    "typesupport-fastrtps-c",
    "typesupport-introspection-c",
)
_IMPLIED = (
    "action_msgs",
    "builtin_interfaces",
    "service_msgs",
    "unique_identifier_msgs",
)  # in every service and action
_RUNTIME = ("rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_cpp", *TYPE_SUPPORTS)
_PARTS = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *TYPE_SUPPORTS)

Progress = Callable[[int, int, str], None]
"""`progress(done, all, name)`, after each interface that was not in the cache."""


@dataclass(frozen=True)
class Definition:
    """One `.msg`, `.srv` or `.action` file of a package."""

    package: str
    path: Path

    @property
    def place(self) -> Path:
        """Its path inside the package, like srv/AddObject.srv."""
        return self.path.relative_to(self.path.parents[1])

    @property
    def name(self) -> str:
        """As in `ros2 interface list`, like curobo_msgs/srv/AddObject."""
        return f"{self.package}/{self.place.with_suffix('')}"

    @property
    def stem(self) -> str:
        """The beginning of the names of generated files, like add_object."""
        return str(convert_camel_case_to_lower_case_underscore(self.path.stem))

    @cached_property
    def refers_to(self) -> frozenset[str]:
        """The messages that its fields are of, like geometry_msgs/msg/Pose."""
        lines = (line.partition("#")[0].split() for line in self.path.read_text().splitlines())
        types = (re.sub(r"\[.*\]$", "", words[0]) for words in lines if len(words) > 1)
        parts = (kind.rpartition("/") for kind in types if "/" in kind or kind[0].isupper())
        return frozenset(f"{package or self.package}/msg/{name}" for package, _, name in parts)


@dataclass(frozen=True)
class _Job:
    """An interface to be generated and compiled in `folder`, and the definitions that it refers to, these first."""

    definition: Definition
    needs: tuple[Definition, ...]
    folder: Path


def build(definitions: Iterable[Definition], cache: Path, progress: Progress) -> tuple[Path, dict[str, str]]:
    """Build the definitions, of one package or of several.

    Returns a folder in `cache` laid out like an installation prefix, and the definitions left out: the name of each,
    and the missing package that it refers to. Raises CalledProcessError if a compiler fails.
    """
    known = {one.name: one for one in definitions}
    left_out: dict[str, str] = {}
    wanted: dict[str, tuple[Definition, ...]] = {}
    for one in known.values():
        closure = _closure(one, known)
        if lacking := _lacking(closure, known):
            left_out[one.name] = lacking
        else:
            wanted[one.name] = closure
    tools = _tools()
    jobs = [_job(known[name], needs, cache, tools) for name, needs in wanted.items()]
    _compile(jobs, progress)
    tree = cache / "packages" / _digest(*sorted(job.folder.name for job in jobs), *left_out)
    if not tree.exists():
        with _made(tree) as folder:
            for package in _in_order(job.definition for job in jobs):
                _assemble(package, [job for job in jobs if job.definition.package == package], folder)
    return tree, left_out


def install(package: str, tree: Path, prefix: Path) -> None:
    """Copy what `build` made of a package to where Python and the ament index find it, replacing what was there."""
    for folder in (SITE_PACKAGES / package, Path("share", package)):
        shutil.rmtree(prefix / folder, ignore_errors=True)
        shutil.copytree(tree / folder, prefix / folder)
    for file in (*tree.glob(f"share/ament_index/resource_index/*/{package}"), *tree.glob(f"lib/lib{package}__*.so")):
        target = prefix / file.relative_to(tree)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        shutil.copy(file, target, follow_symlinks=False)


def _closure(one: Definition, known: Mapping[str, Definition]) -> tuple[Definition, ...]:
    """A definition and all those it refers to, directly or indirectly, each after what it refers to."""
    found: dict[str, Definition] = {}
    for name in sorted(one.refers_to):
        if name in known:
            found.update({need.name: need for need in _closure(known[name], known)})
    return (*found.values(), one)


def _lacking(closure: Sequence[Definition], known: Mapping[str, Definition]) -> str | None:
    """A package that is referred to but missing."""
    names = {name for one in closure for name in one.refers_to} - set(known)
    return next((package for package in sorted(name.split("/")[0] for name in names) if not _installed(package)), None)


def _installed(package: str) -> bool:
    return (PREFIX / "include" / package).is_dir()


def _tools() -> str:
    """The tools that generate and compile, since others produce other code."""
    compiler = subprocess.run(["c++", "--version"], check=True, capture_output=True, text=True).stdout  # noqa: S607
    generators = [version(f"ros-rosidl-{name}") for name in _GENERATORS]
    return _digest(compiler, *generators, sys.version, numpy.__version__, Path(__file__).read_text(), str(PREFIX))


def _job(one: Definition, needs: tuple[Definition, ...], cache: Path, tools: str) -> _Job:
    key = _digest(tools, *(part for need in needs for part in (need.name, need.path.read_text())))
    return _Job(one, needs, cache / "interfaces" / key)


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


@contextlib.contextmanager
def _made(folder: Path):  # type: ignore[no-untyped-def]
    """A folder to be filled, which is moved into place only when complete; two processes may make the same."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix="making-") as making:
        part = Path(making, "part")
        part.mkdir()
        yield part
        with contextlib.suppress(OSError):  # the other process was faster
            part.rename(folder)


def _compile(jobs: Sequence[_Job], progress: Progress) -> None:
    missing = [job for job in jobs if not job.folder.exists()]
    if not missing:
        return
    with ProcessPoolExecutor(min(len(missing), os.cpu_count() or 1)) as pool:
        running = {pool.submit(_interface, job): job for job in missing}
        for done, future in enumerate(as_completed(running), start=1):
            future.result()
            progress(done, len(missing), running[future].definition.name)


def _interface(job: _Job) -> None:
    """Generate and compile one interface: its objects, its Python module and its description are then in `job.folder`."""
    with _made(job.folder) as folder, contextlib.redirect_stdout(io.StringIO()):
        idl = {need.name: _idl(need, folder) for need in job.needs}
        for package in _in_order(job.needs):
            of_package = [need for need in job.needs if need.package == package]
            _generate_headers(folder, package, of_package, [idl[need.name] for need in of_package])
        one = job.definition
        generate_dispatch(
            _arguments(folder, "rosidl_typesupport_c", one.package, [idl[one.name]], folder / "dispatch"),
            list(TYPE_SUPPORTS),
        )
        python = folder / "python" / one.package
        generate_py(_arguments(folder, "rosidl_generator_py", one.package, [idl[one.name]], python), [])
        kind, stem = one.path.parent.name, one.stem
        detail = folder / "include" / one.package / kind / "detail"
        _compiled(
            folder,
            "interface.c",
            *(detail / f"{stem}__{part}.c" for part in ("description", "functions", "type_support")),
            folder / "introspection" / one.package / kind / "detail" / f"{stem}__type_support.c",
            python / kind / f"_{stem}_s.c",
        )
        _compiled(
            folder,
            "type_support.cpp",
            detail / f"{stem}__type_support_c.cpp",
            folder / "dispatch" / kind / f"{stem}__type_support.cpp",
        )


def _in_order(definitions: Iterable[Definition]) -> Iterable[str]:
    """Their packages, each after those that it refers to."""
    packages: dict[str, set[str]] = {}
    for one in definitions:
        packages.setdefault(one.package, set()).update(name.split("/")[0] for name in one.refers_to)
    return (
        package
        for package in TopologicalSorter(
            {package: needs - {package} for package, needs in packages.items()}
        ).static_order()
        if package in packages
    )


def _idl(one: Definition, folder: Path) -> str:
    """The definition in IDL, in the generators' form: root and path, separated by a colon."""
    root = folder / "share" / one.package
    KINDS[one.path.suffix](one.path.parents[1], one.package, one.place, root / one.place.parent)
    return f"{root}:{one.place.with_suffix('.idl')}"


def _generate_headers(folder: Path, package: str, definitions: Sequence[Definition], idl: Sequence[str]) -> None:
    """C structures, their wire format, and the description that tells types apart."""
    share, include = folder / "share", folder / "include" / package
    roots = {path.name: path for path in (*PREFIX.glob("share/*_*"), PREFIX / "share" / "builtin_interfaces")}
    roots.update({path.name: path for path in share.iterdir()})
    generate_type_hash(
        _arguments(
            folder,
            "rosidl_generator_type_description",
            package,
            idl,
            share / package,
            include_paths=[f"{name}:{path}" for name, path in roots.items()],
        )
    )
    described = {one.place.with_suffix(".idl"): share / package / one.place.with_suffix(".json") for one in definitions}
    generate_c(
        _arguments(
            folder,
            "rosidl_generator_c",
            package,
            idl,
            include,
            type_description_tuples=[f"{place}:{path}" for place, path in described.items()],
            ros_interface_files=[str(one.path) for one in definitions],
        )
    )
    fastrtps, introspection = TYPE_SUPPORTS
    generate_typesupport_fastrtps_c(_arguments(folder, fastrtps, package, idl, include))
    generate_introspection(_arguments(folder, introspection, package, idl, folder / "introspection" / package))
    for generator in ("rosidl_generator_c", *TYPE_SUPPORTS):
        header = f"{generator}__visibility_control.h"
        generate_visibility_control_file(
            package_name=package,
            template_path=PREFIX / "share" / generator / "resource" / f"{header}.in",
            output_path=include / "msg" / header,
        )


def _arguments(
    folder: Path, generator: str, package: str, idl: Sequence[str], output: Path, **more: Sequence[str]
) -> str:
    """The file of arguments that a generator reads."""
    output.mkdir(parents=True, exist_ok=True)
    file = folder / "arguments.json"
    file.write_text(
        json.dumps(
            {
                "package_name": package,
                "output_dir": str(output),
                "template_dir": str(PREFIX / "share" / generator / "resource"),
                "idl_tuples": list(idl),
                "ros_interface_dependencies": [],
                "target_dependencies": [],
                **more,
            }
        )
    )
    return str(file)


def _compiled(folder: Path, unit: str, *sources: Path) -> None:
    """Compile the sources as one unit: most of the compile time goes into headers that all of them include."""
    file = folder / unit
    file.write_text("".join(f'#include "{source}"\n' for source in sources))
    wheels = [PREFIX / "include", *(path for path in (PREFIX / "include").iterdir() if path.is_dir())]
    includes = (
        folder / "include",
        folder / "introspection",
        *wheels,
        sysconfig.get_path("include"),
        numpy.get_include(),
    )
    compiler = ["cc"] if file.suffix == ".c" else ["c++", "-std=c++17"]
    _run(*compiler, "-O1", "-w", "-fPIC", "-c", file, "-o", file.with_suffix(".o"), *(f"-I{path}" for path in includes))


def _run(*command: str | Path) -> None:
    subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)  # noqa: S603


def _assemble(package: str, jobs: Sequence[_Job], tree: Path) -> None:
    """The Python package of these interfaces, with one shared library, and its entry in the ament index."""
    site, share = tree / SITE_PACKAGES / package, tree / "share" / package
    jobs = sorted(jobs, key=lambda job: (job.definition.path.parent.name, job.definition.stem))
    content = IdlContent()
    for job in jobs:
        one = job.definition
        kind, place = one.path.parent.name, one.place.with_suffix(".idl")
        generated, described = job.folder / "python" / package / kind, job.folder / "share" / package
        content.elements += parse_idl_file(IdlLocator(described, place)).content.elements
        (site / kind).mkdir(parents=True, exist_ok=True)
        (share / kind).mkdir(parents=True, exist_ok=True)
        shutil.copy(generated / f"_{one.stem}.py", site / kind)
        with (site / kind / "__init__.py").open("a") as names:
            names.write((generated / "__init__.py").read_text())
        shutil.copy(one.path, share / kind)
        for file in (described / kind).glob(f"{one.path.stem}.*"):
            shutil.copy(file, share / kind)
    (site / "__init__.py").touch()
    with tempfile.TemporaryDirectory() as making:
        folder = Path(making)
        source = folder / "entry_point.c"
        template = PREFIX / "share" / "rosidl_generator_py" / "resource" / "_idl_pkg_typesupport_entry_point.c.em"
        expand_template(
            template, {"package_name": package, "content": content, "typesupport_impl": ENTRY_POINT}, str(source)
        )
        headers = [f"-I{job.folder / 'include'}" for job in jobs]
        wheels = [f"-I{path}" for path in (PREFIX / "include").iterdir() if path.is_dir()]
        python = f"-I{sysconfig.get_path('include')}"
        _run("cc", "-O1", "-w", "-fPIC", "-c", source, "-o", source.with_suffix(".o"), *headers, *wheels, python)
        objects = [job.folder / name for job in jobs for name in ("interface.o", "type_support.o")]
        _link(package, [source.with_suffix(".o"), *objects], _packages_of(jobs) - {package}, tree)
    index = tree / "share" / "ament_index" / "resource_index"
    places = sorted(
        f"{job.definition.place.with_suffix(end)}" for job in jobs for end in (".idl", job.definition.path.suffix)
    )
    for resource, text in (("packages", ""), ("rosidl_interfaces", "\n".join(places))):
        (index / resource).mkdir(parents=True, exist_ok=True)
        (index / resource / package).write_text(text)


def _packages_of(jobs: Iterable[_Job]) -> set[str]:
    """The packages whose messages these interfaces contain."""
    return {name.split("/")[0] for job in jobs for name in job.definition.refers_to} | set(_IMPLIED)


def _library(package: str) -> str:
    return f"{package}_s__{ENTRY_POINT}.so"


def _link(package: str, objects: Sequence[Path], needs: set[str], tree: Path) -> None:
    """One shared library with everything, which Python imports; `rosidl_typesupport_c` finds it by the names of type
    supports.
    """
    site = tree / SITE_PACKAGES
    built = [site / one / _library(one) for one in sorted(needs) if (site / one).is_dir()]
    wheels = [one for one in sorted(needs) if not (site / one).is_dir()]
    libraries = [f"-l{one}__{part}" for one in wheels for part in _PARTS] + [f"-l{one}" for one in _RUNTIME]
    _run(
        "c++",
        "-shared",
        "-o",
        site / package / _library(package),
        f"-Wl,-soname,{_library(package)}",
        *objects,
        *built,
        f"-L{PREFIX / 'lib'}",
        *libraries,
        "-lfastcdr",
        "-lrmw",
        "-lrcutils",
        f"-Wl,-rpath,{PREFIX / 'lib'}",
        *(f"-Wl,-rpath,$ORIGIN/../{library.parent.name}" for library in built),
    )
    for one in TYPE_SUPPORTS:
        (tree / "lib" / f"lib{package}__{one}.so").symlink_to(Path("..") / SITE_PACKAGES / package / _library(package))
