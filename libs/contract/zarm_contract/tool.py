"""The tools of a robot descriptor: what can be mounted on the robot at run time."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Annotated

from pydantic import Field

from zarm_contract.collision import CollisionPrimitive
from zarm_contract.messages import MAX_TOOL_SHAPES, Positive, Quaternion, Vector3
from zarm_contract.rpy import rpy_of
from zarm_contract.section import Section
from zarm_contract.urdf import Joint, Urdf


class ToolTip(Section):
    """The tool centre point: the frame that the robot moves while the tool is mounted."""

    position: Vector3
    """Where it is in the frame of the link (m)."""
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """How it is turned, as a quaternion."""


class Payload(Section):
    """What a link carries besides what its URDF states: a tool, a camera, cables."""

    mass: Positive
    """Its mass (kg)."""
    center: Vector3 = (0.0, 0.0, 0.0)
    """Its centre of mass in the frame of the link (m)."""


class Tool(Section):
    """A tool that is mounted and taken off while zarm runs. Its name is that of its tip's frame."""

    link: str | None = None
    """The link on which it is mounted. Left out: `tip_link`. While it is there, its tip takes the place of that of the robot, and of each group with this `tip_link`."""
    tip: ToolTip
    """Its tool centre point."""
    collision: Annotated[tuple[CollisionPrimitive, ...], Field(min_length=1, max_length=MAX_TOOL_SHAPES)]
    """Its exact geometry, in the frame of the link."""
    touch_links: tuple[str, ...] = ()
    """Links of the robot that it may touch, besides the one that carries it and those that are fixed to that."""
    payload: Payload | None = None
    """Its mass, with its centre in the frame of the link. Left out: it weighs nothing in torques."""

    def frame(self, name: str, tip_link: str) -> Joint:
        """The fixed joint that carries the frame of the tip, the link `name`."""
        return Joint(
            name=f"{name}_mount",
            type="fixed",
            parent=self.link or tip_link,
            child=name,
            xyz=self.tip.position,
            rpy=rpy_of(self.tip.orientation),
            axis=(1.0, 0.0, 0.0),
            lower=None,
            upper=None,
        )

    def faults_in(self, name: str, urdf: Urdf, links: Collection[str]) -> Iterator[tuple[str, str]]:
        """What is wrong beside the URDF and the `links` with geometry, each as key and message."""
        if name in urdf.links:
            yield "tip", f"{name} is a link of the URDF; give the tool another name"
        if self.link is not None and self.link not in urdf.links:
            yield "link", f"the link {self.link} is not in the URDF; the links there are {', '.join(urdf.links)}"
        for touched in self.touch_links:
            if touched not in links:
                yield "touch_links", f"{touched} is not a link with collision geometry; those are {', '.join(links)}"
