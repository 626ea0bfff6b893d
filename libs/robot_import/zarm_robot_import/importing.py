"""Imports a URDF or xacro: all steps, in order."""

from __future__ import annotations

import re
import tempfile
import time
import unicodedata
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_robot_import.chain import Chain, choose_chain
from zarm_robot_import.contacts import Contacts
from zarm_robot_import.description import Description, describe
from zarm_robot_import.fitting import fit
from zarm_robot_import.gripper import ImportedGripper, find_gripper
from zarm_robot_import.home import choose_home
from zarm_robot_import.inertia import unphysical
from zarm_robot_import.limits import limits_of
from zarm_robot_import.meshes import Surface, doubted, link_surface
from zarm_robot_import.picture import draw
from zarm_robot_import.report import Report
from zarm_robot_import.ros_control import trajectory_controller
from zarm_robot_import.self_collision import Pair, Pairs
from zarm_robot_import.source import read_source
from zarm_robot_import.spheres import BUDGET
from zarm_robot_import.srdf import Srdf, srdf_beside
from zarm_robot_import.visual_meshes import without_contradictions
from zarm_robot_import.writing import descriptor_text, urdf_text


@dataclass(frozen=True)
class Options:
    """The user's options; see `zarm robot import --help`."""

    name: str | None = None
    base: str | None = None
    tip: str | None = None
    joints: Sequence[str] = ()
    packages: Sequence[Path] = ()
    arguments: Mapping[str, str] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    geometry: str = "auto"
    spheres: int = BUDGET
    right_size: Collection[str] = ()
    """Links whose size is right, however large they are beside the arm."""
    overwrite: bool = False
    srdf: Path | None = None
    """Names groups and grippers, and says where home is; by default the one beside the URDF."""


def import_robot(
    file: Path, folder: Path, options: Options, progress: Callable[[str, float], None] = lambda step, share: None
) -> tuple[Path, Report]:
    """Make `<name>.yaml`, `.urdf`, `.md` and `.png` in `folder` from a URDF or xacro; returns the descriptor's path.

    `progress` is called with the step and the completed share. Raises InvalidRequest with the fault in the file and the
    remedy, Unavailable if a package is missing; then nothing is written.
    """
    with _draft_of(folder) as work:
        descriptor, report = _imported(file, folder, work, options, progress)
        folder.mkdir(parents=True, exist_ok=True)
        for made in sorted(work.iterdir()):
            made.replace(folder / made.name)
    progress("done", 1.0)
    return folder / descriptor, report


@contextmanager
def _draft_of(folder: Path) -> Iterator[Path]:
    """A folder for files on their way to `folder`, which need not exist yet. Raises InvalidRequest where nothing can be written."""
    standing = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
    try:
        draft = tempfile.TemporaryDirectory(dir=standing, prefix=".import-")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InvalidRequest(
            f"cannot write into {standing}: {reason}; name another folder with --output", field="--output"
        ) from error
    with draft as name:
        yield Path(name)


def _imported(
    file: Path, folder: Path, work: Path, options: Options, progress: Callable[[str, float], None]
) -> tuple[str, Report]:
    """Make the files in the folder `work` as they are to stand in `folder`; returns the name of the descriptor."""
    begun = time.process_time()
    progress("reading", 0.0)
    robot = describe(read_source(file, options.packages, options.arguments))
    srdf, unused = _semantics(robot, options)
    chain = srdf.renamed(_chain(robot, options, srdf))
    limits = limits_of(robot, chain.joints)
    controller = trajectory_controller(robot, [joint.name for joint in chain.joints])
    name = _checked(options.name) if options.name else _name(robot.name)
    if (folder / f"{name}.urdf").resolve() == file.resolve():
        raise InvalidRequest(f"{file} would be overwritten; choose another --output or --name")
    if (folder / f"{name}.yaml").exists() and not options.overwrite:
        raise InvalidRequest(
            f"{folder / name}.yaml exists already, and may have been corrected; replace it with --overwrite, or choose another --output or "
            "--name"
        )
    surfaces = []
    left_out: list[str] = []
    suspect: list[str] = []
    for index, mounted in enumerate(chain.mounted):
        progress(f"meshes of {mounted.link}", 0.2 * index / len(chain.mounted))
        link = robot.links[mounted.link]
        if unphysical(link.inertia):
            suspect.append(f"{link.name}: no body has the inertia that its <inertial> states; correct it in the URDF")
        if surface := link_surface(robot.source, link, options.geometry):
            if mounted.link not in options.right_size and (doubt := doubted(surface, chain.reach, mounted.body > 0)):
                raise robot.source.fault(link.element, doubt)
            surfaces.append(surface)
        elif link.collision or link.visual:
            if mounted.link not in options.right_size and any(
                one.kind == "mesh" for one in (*link.collision, *link.visual)
            ):
                raise robot.source.fault(
                    link.element,
                    f"link {link.name} is smaller than 1 mm: is the scale of its mesh applied twice? Correct scale= in its <mesh>; if its "
                    f"size is right, say --right-size {link.name}",
                )
            left_out.append(
                f"{link.name}: its geometry is smaller than 1 mm, so it is left out; check its size and scale"
            )
    if not surfaces:
        raise robot.source.fault(
            robot.source.root,
            left_out[-1]
            if left_out
            else "no link of the arm has geometry; zarm needs <collision> or <visual> elements",
        )
    contacts = Contacts(chain, limits, surfaces)
    surfaces = without_contradictions(surfaces, contacts)
    fitted_links = 0

    def counted(link: str) -> None:
        nonlocal fitted_links
        fitted_links += 1
        progress(f"geometry of {link}", 0.2 + 0.5 * fitted_links / len(surfaces))

    fitted = fit(surfaces, options.spheres * len(chain.tips), contacts.body, counted)
    grippers = _grippers(robot, chain, surfaces, options, srdf)
    meshes = {surface.link: surface.triangles for surface in surfaces}
    (work / f"{name}.urdf").write_text(urdf_text(robot, chain, limits, folder, grippers), encoding="utf-8")
    descriptor = work / f"{name}.yaml"

    def write(home: Sequence[float], pairs: Sequence[Pair]) -> RobotModel:
        text = descriptor_text(name, file, chain, limits, fitted, home, pairs, controller, grippers)
        descriptor.write_text(text, encoding="utf-8")
        return RobotModel.of(load_robot(str(descriptor)))

    middle = [min(max(0.0, limit.lower), limit.upper) for limit in limits]
    progress("pairs of links", 0.7)
    travel = {link: far for gripper in grippers.values() for link, far in gripper.travel.items()}
    pairs = Pairs(contacts, fitted, travel).judged()
    progress("home", 0.9)
    stated, arms = (
        srdf.home([joint.name for joint in chain.joints]),
        [group.name for group in chain.groups if group.arm],
    )
    home = choose_home(write(middle, pairs), arms, stated)
    if stated is not None and home != stated:
        unused.append("the home of the SRDF is outside of the joints' ranges, or the robot collides with itself there")
    model = write(home, pairs)
    progress("picture", 0.95)
    draw(work / f"{name}.png", model, home, meshes, fitted)
    source = file.name
    report = Report(
        name,
        source,
        chain,
        surfaces,
        fitted,
        limits,
        pairs,
        home,
        [*unused, *left_out, *suspect, *robot.notes],
        time.process_time() - begun,
        controller,
        grippers,
    )
    (work / f"{name}.md").write_text(report.markdown(), encoding="utf-8")
    return descriptor.name, report


def _semantics(robot: Description, options: Options) -> tuple[Srdf, list[str]]:
    """What an SRDF says, an empty one if there is none; and a note if the one beside the URDF cannot be used. Raises InvalidRequest for one that is given."""
    if options.srdf is not None:
        return Srdf.read(options.srdf, robot), []
    try:
        beside = srdf_beside(robot)
        return (Srdf({}, ()) if beside is None else Srdf.read(beside, robot)), []
    except InvalidRequest as error:
        return Srdf({}, ()), [f"the SRDF is not used: {error}"]


def _chain(robot: Description, options: Options, srdf: Srdf) -> Chain:
    """The joints of the arm; where the structure leaves a choice, those of the arm of the SRDF. Raises InvalidRequest."""
    try:
        return choose_chain(robot, options.base, options.tip, options.fixed, options.joints)
    except InvalidRequest:
        if not options.tip and not options.joints and (arm := srdf.arm(robot)) is not None:
            with suppress(InvalidRequest):
                chain = choose_chain(robot, options.base, None, options.fixed, arm[1])
                return replace(chain, chosen=f"The group `{arm[0]}` of the SRDF")
        raise


def _grippers(
    robot: Description, chain: Chain, surfaces: Sequence[Surface], options: Options, srdf: Srdf
) -> dict[str, ImportedGripper]:
    """The gripper behind each arm, by its name in the SRDF, the name of its group, or as `gripper` behind the only one."""
    arms = {"gripper": chain}
    if chain.groups:
        arms = {
            group.name: choose_chain(robot, chain.base, group.tip, options.fixed) for group in chain.groups if group.arm
        }
    found = {
        f"{name}_gripper" if chain.groups else name: find_gripper(robot, arm, surfaces, options.fixed)
        for name, arm in arms.items()
    }
    grippers = {name: gripper for name, gripper in found.items() if gripper is not None}
    named = {
        srdf.gripper_of(gripper.joint.name, gripper.followers) or name: gripper for name, gripper in grippers.items()
    }
    return named if len(named) == len(grippers) else grippers


def _name(text: str) -> str:
    """The robot's name in a form that a descriptor accepts."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    plain = re.sub(r"[^a-z0-9]+", "_", plain).strip("_")
    return (plain if plain[:1].isalpha() else f"robot_{plain}".rstrip("_"))[:64]


def _checked(name: str) -> str:
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,63}", name):
        raise InvalidRequest(
            f"{name!r} is not a robot name; use lower case letters, digits and _, a letter first", field="--name"
        )
    return name
