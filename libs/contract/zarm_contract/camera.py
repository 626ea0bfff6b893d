"""The cameras of a robot descriptor."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from zarm_contract.messages import Camera, Positive, Quaternion, Vector3
from zarm_contract.messages.perception import Pixels
from zarm_contract.section import Section


class DescribedCamera(Section):
    """A depth camera: its optical frame, z forward, x right, y down, is fixed to a link."""

    link: str | None = None
    """The link that carries it. Left out: `base_link`."""
    position: Vector3
    """Where its optical frame is in the frame of the link (m)."""
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """How its optical frame is turned, as a quaternion."""
    width: Pixels
    """Pixels in a row."""
    height: Pixels
    """Rows."""
    fx: Positive
    """Focal length along a row (pixels)."""
    fy: Positive
    """Focal length along a column (pixels)."""
    cx: float
    """Principal point in a row (pixels)."""
    cy: float
    """Principal point in a column (pixels)."""
    near: Positive = 0.15
    """Least depth that counts (m)."""
    far: Positive = 4.0
    """Greatest depth that counts (m)."""
    rate: Annotated[float, Field(gt=0, le=60)] = 10.0
    """Images in a second."""
    topic: Annotated[str, Field(min_length=1, max_length=255)] | None = None
    """ROS topic with its depth images, of type `sensor_msgs/msg/Image`, which the bridge takes. Left out: images come on Zenoh."""

    def message(self, name: str) -> Camera:
        """The camera of this name."""
        return Camera(name=name, **self.model_dump())
