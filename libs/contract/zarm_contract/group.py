"""Joint groups of a robot: the joints that are planned together, as in MoveIt."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pydantic import Field

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import GroupName
from zarm_contract.section import Section
from zarm_contract.urdf import Urdf


class JointGroup(Section):
    """Joints that are planned together: those that move one tip, or those of several groups. The robot's other joints stand."""

    tip_link: str | None = None
    """The link whose pose a goal gives. Left out: the group has the tips of its `groups`."""
    joints: tuple[str, ...] | None = Field(default=None, min_length=1)
    """The joints that move, among those from `base_link` to `tip_link`. Left out: all of these."""
    groups: tuple[GroupName, ...] = ()
    """The groups that this one consists of, in place of `tip_link`: both arms, for example."""

    def moving(self, urdf: Urdf, base_link: str) -> tuple[str, ...]:
        """The joints that move its tip; none for one that consists of groups, or whose tip does not hang on `base_link`."""
        if self.joints is not None or self.tip_link is None:
            return self.joints or ()
        try:
            chain = urdf.chain(base_link, self.tip_link)
        except InvalidRequest:
            return ()
        return tuple(joint.name for joint in chain if joint.type != "fixed")

    def faults(self, groups: Mapping[str, JointGroup]) -> Iterator[tuple[str, str]]:
        """What is wrong beside the other groups, each as key and message."""
        if (self.tip_link is None) == (not self.groups):
            yield "tip_link", "give either the tip_link of the group, or the groups that it consists of"
        if self.joints is not None and self.groups:
            yield "joints", "a group of groups has their joints; leave this out"
        for part in self.groups:
            if part not in groups:
                yield "groups", f"there is no group {part}; the groups are {', '.join(groups)}"
            elif groups[part].groups:
                yield "groups", f"{part} consists of groups itself; name those that have a tip_link"
        if len(set(self.groups)) != len(self.groups):
            yield "groups", "a name appears twice"

    def faults_in(self, urdf: Urdf, base_link: str, joints: tuple[str, ...]) -> Iterator[tuple[str, str]]:
        """What is wrong beside the URDF and the joints of the robot, each as key and message."""
        if self.tip_link is None:
            return
        if self.tip_link not in urdf.links:
            yield (
                "tip_link",
                f"the link {self.tip_link} is not in the URDF; the links there are {', '.join(urdf.links)}",
            )
            return
        try:
            chain = [joint.name for joint in urdf.chain(base_link, self.tip_link) if joint.type != "fixed"]
        except InvalidRequest as error:
            yield "tip_link", error.problem.message
            return
        for joint in chain:
            if joint not in joints:
                yield "tip_link", f"{joint} moves {self.tip_link}, but is not in `joints`; list it there"
        for joint in self.joints or ():
            if joint not in chain:
                yield "joints", f"{joint} does not move {self.tip_link}; the joints that do are {', '.join(chain)}"
        if not chain:
            yield "tip_link", f"no joint moves {self.tip_link}"
