"""The process of the perception service."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import CameraChange, Cameras, PerceptionState, VoxelBlock
from zarm_geometry.gripper_openings import GripperOpenings
from zarm_geometry.robot_model import RobotModel
from zarm_perception.joint_history import JointHistory
from zarm_perception.mapping import Mapping
from zarm_perception.voxel_map import MAX_VOXELS, VoxelMap
from zarm_perception.warm_up import warm_up
from zarm_runtime.service import Service, run_service, service_parser

_BOX = "-1,-1,-0.25,1,1,1.25"


@contextmanager
def start(service: Service) -> Iterator[None]:
    """The map, from the first image to the last."""
    bus, keys, options = service.bus, service.keys, service.options
    model = RobotModel.of(service.robot)
    voxels = _map(options)
    service.starting("loading the voxel map")
    warm_up()
    history, grippers = JointHistory(service.robot.descriptor.joints), GripperOpenings(service.robot.descriptor)
    blocks, states, cameras = (
        bus.latched(keys.voxels("*")),
        bus.latched(keys.perception_state),
        bus.publisher(keys.cameras),
    )
    masks = cache(lambda camera: bus.publisher(keys.mask(camera)))

    def publish(name: str, block: VoxelBlock) -> None:
        blocks.set(block, key=keys.voxels(name))

    def report(state: PerceptionState) -> None:
        service.note = "; ".join(f"{camera.name}: {camera.problem}" for camera in state.cameras if camera.problem)
        states.set(state)

    def show(camera: str, payload: bytes) -> None:
        masks(camera).put_encoded(payload)

    mapping = Mapping(model, voxels, options.padding, history, grippers, publish, report, show)
    for name, described in service.robot.descriptor.cameras.items():
        mapping.add(described.message(name))

    def change(request: CameraChange) -> Cameras:
        answer = mapping.change(request)
        if request != CameraChange():
            cameras.put(answer)
        return answer

    with mapping:
        bus.subscribe(keys.joint_states, history.receive)
        bus.watch(keys.gripper_state("*"), grippers.receive)
        bus.watch(keys.scene, mapping.on_scene)
        bus.serve(keys.cameras, change, workers=1)
        bus.serve(keys.perception_clear, mapping.clear, workers=1)
        bus.serve(keys.perception_save, mapping.save, workers=1)
        bus.serve(keys.perception_load, mapping.load, workers=1)
        bus.listen(keys.depth("*"), mapping.on_image)
        bus.listen(keys.cloud("*"), mapping.on_cloud)
        service.impairment = lambda: None if mapping.alive else "it takes no images any more; see its log"
        service.ready()
        yield


def _map(options: argparse.Namespace) -> VoxelMap:
    try:
        numbers = [float(word) for word in options.box.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 6 or not all(a < b for a, b in zip(numbers[:3], numbers[3:], strict=True)):
        raise InvalidRequest("a box is its least x, y, z and its greatest x, y, z in m, as in " + _BOX, field="--box")
    if not 0.005 <= options.resolution <= 0.1:
        raise InvalidRequest(f"{options.resolution:g} m is no resolution; choose 0.005 to 0.1", field="--resolution")
    if not 0.0 <= options.padding <= 0.3:
        raise InvalidRequest(f"{options.padding:g} m is no padding; choose 0 to 0.3", field="--padding")
    lower, upper = np.array(numbers[:3]), np.array(numbers[3:])
    if np.prod((upper - lower) / options.resolution) > MAX_VOXELS:
        raise InvalidRequest(
            "the box has too many voxels; choose a smaller one, or a larger --resolution", field="--box"
        )
    return VoxelMap(lower, upper, options.resolution, unseen_occupied=options.unseen == "occupied")


def main() -> int:
    """Run the perception of one robot until SIGTERM or SIGINT; the exit code."""
    parser = service_parser("perception")
    parser.add_argument(
        "--box",
        default=_BOX,
        metavar="X,Y,Z,X,Y,Z",
        help="the box of the map in the base frame: its least and its greatest x, y, z in m (default: -1,-1,-0.25,1,1,1.25)",
    )
    parser.add_argument(
        "--resolution", type=float, default=0.02, metavar="M", help="width of a voxel, 0.005 to 0.1 m (default: 0.02)"
    )
    parser.add_argument(
        "--padding",
        type=float,
        default=0.03,
        metavar="M",
        help="what is as near as this to the robot counts as the robot, 0 to 0.3 m (default: 0.03)",
    )
    parser.add_argument(
        "--unseen",
        choices=("free", "occupied"),
        default="free",
        help="what voxels are that no camera has seen through (default: free)",
    )
    return run_service("perception", parser, start)


if __name__ == "__main__":
    sys.exit(main())
