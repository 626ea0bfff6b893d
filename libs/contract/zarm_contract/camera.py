"""The cameras of a robot descriptor."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from zarm_contract.looking import looking
from zarm_contract.messages import Camera, Positive, Quaternion, Vector3
from zarm_contract.messages.perception import Pixels, Projection, TopicType
from zarm_contract.section import Section


class DescribedCamera(Section):
    """A depth camera or a LiDAR: its frame is fixed to a link. Optical, z forward, x right, y down, for `pinhole`; x forward, y left, z up for `spherical`."""

    link: str | None = None
    """The link that carries it. Left out: `base_link`."""
    position: Vector3
    """Where its frame is in the frame of the link (m)."""
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """How its frame is turned, as a quaternion."""
    look_at: Vector3 | None = None
    """Instead of the orientation: the point in the frame of the link (m) at which a `pinhole` camera looks, upright."""
    projection: Projection = "pinhole"
    """`pinhole`: a camera. `spherical`: columns are azimuths from left to right, rows elevations from top to bottom, as of a LiDAR."""
    width: Pixels | None = None
    """Pixels in a row. Left out, as all intrinsics: those of the `camera_info` beside the ROS topic of its images."""
    height: Pixels | None = None
    """Rows."""
    fx: Positive | None = None
    """Focal length along a row (pixels); of a `spherical` one pixels in a radian."""
    fy: Positive | None = None
    """Focal length along a column (pixels); of a `spherical` one pixels in a radian."""
    cx: float | None = None
    """Principal point in a row (pixels): the column that looks forward."""
    cy: float | None = None
    """Principal point in a column (pixels): the row that looks forward."""
    near: Positive = 0.15
    """Least depth that counts (m)."""
    far: Positive = 4.0
    """Greatest depth that counts (m)."""
    rate: Annotated[float, Field(gt=0, le=60)] = 10.0
    """Images in a second."""
    topic: Annotated[str, Field(min_length=1, max_length=255)] | None = None
    """ROS topic with its depth images or clouds, which the bridge takes. Left out: they come on Zenoh."""
    topic_type: TopicType = "sensor_msgs/msg/Image"
    """The type of the ROS topic."""
    color_topic: Annotated[str, Field(min_length=1, max_length=255)] | None = None
    """ROS topic with its colour or grey images, `rgb8`, `bgr8` or `mono8`, registered to the depth."""

    @model_validator(mode="after")
    def _checked(self) -> Self:
        if self.look_at is not None:
            if "orientation" in self.model_fields_set or self.projection == "spherical":
                raise ValueError("look_at is for a pinhole camera without an orientation; leave one of them out")
            looking(self.position, self.look_at)
        return self

    def message(self, name: str) -> Camera:
        """The camera of this name."""
        fields = self.model_dump(exclude={"look_at"})
        if self.look_at is not None:
            fields["orientation"] = looking(self.position, self.look_at)
        return Camera(name=name, **fields)
