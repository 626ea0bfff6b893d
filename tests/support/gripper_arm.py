"""An M1013 with a parallel gripper at its flange: 80 mm wide open, boxes for the hand and the fingers."""

from __future__ import annotations

from pathlib import Path

import yaml

from zarm_contract.collision import CollisionCuboid
from zarm_contract.robot import ROBOTS
from zarm_geometry.shapes import link_shape
from zarm_geometry.sphere_cover import sphere_cover

_HAND = ((0.0, 0.0, 0.03), (0.08, 0.12, 0.06))
_FINGER = ((0.0, 0.0, 0.03), (0.02, 0.012, 0.06))
_JOINT = (
    '<joint name="{0}_joint" type="{1}"><parent link="{2}"/><child link="{0}"/><origin xyz="{3}"/><axis xyz="{4}"/>'
    '<limit lower="0" upper="0.04" velocity="0.1" effort="60"/>{5}</joint>'
)
_FOLLOWS = '<mimic joint="left_finger_joint"/>'
_BALLS = 12


def m1013_with_gripper(folder: Path) -> Path:
    """Its descriptor, in `folder`."""
    more = (
        *(f'<link name="{name}"/>' for name in ("hand", "left_finger", "right_finger", "grasp_point")),
        _JOINT.format("hand", "fixed", "link_6", "0 0 0", "0 0 1", ""),
        _JOINT.format("left_finger", "prismatic", "hand", "0 0.006 0.06", "0 1 0", ""),
        _JOINT.format("right_finger", "prismatic", "hand", "0 -0.006 0.06", "0 -1 0", _FOLLOWS),
        _JOINT.format("grasp_point", "fixed", "hand", "0 0 0.11", "0 0 1", ""),
    )
    urdf = (ROBOTS / "doosan_m1013.urdf").read_text().replace("</robot>", f"{''.join(more)}</robot>")
    (folder / "doosan_m1013.urdf").write_text(urdf)
    data = yaml.safe_load((ROBOTS / "doosan_m1013.yaml").read_text())
    data["tip_link"] = "grasp_point"
    for link, (center, size) in {"hand": _HAND, "left_finger": _FINGER, "right_finger": _FINGER}.items():
        box = CollisionCuboid(kind="cuboid", center=center, size=size)
        data["collision"][link] = [{"kind": "cuboid", "center": list(center), "size": list(size)}]
        data["spheres"][link] = [
            {"center": ball[:3], "radius": ball[3]} for ball in sphere_cover(link_shape(link, box), _BALLS).tolist()
        ]
    data["self_collision_ignore"].append(["link_5", "hand"])
    data["grippers"] = {
        "claw": {
            "joint": "left_finger_joint",
            "positions": [0.0, 0.04],
            "widths": [0.0, 0.08],
            "pads": ["left_finger", "right_finger"],
            "speed": 0.2,
            "force": 60.0,
        }
    }
    descriptor = folder / "doosan_m1013.yaml"
    descriptor.write_text(yaml.safe_dump(data))
    return descriptor
