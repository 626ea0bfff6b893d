"""A policy of LeRobot moves a robot of zarm, whose camera `front` has images of 64 x 48 pixels: `lerobot_policy.py <router> <seconds>`. Prints what
LeRobot sees, as JSON.

The real lerobot package is used, with nothing behind what it imports for training and cameras.
"""

from __future__ import annotations

import json
import math
import sys
import time

from lerobot_left_out import DATA_SETS, OTHERS, leave_out

leave_out(OTHERS | DATA_SETS)


def main() -> None:
    """Swing the first joint, and half close the gripper."""
    from lerobot.cameras import CameraConfig
    from lerobot.robots import RobotConfig, make_robot_from_config
    from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
    from lerobot.utils.import_utils import register_third_party_plugins

    endpoint, seconds = sys.argv[1], float(sys.argv[2])
    register_third_party_plugins()
    front = CameraConfig.get_choice_class("zarm")(
        camera="front", connect=endpoint, name="panda", width=64, height=48, fps=10
    )
    config = RobotConfig.get_choice_class("zarm")(
        robot="panda", connect=endpoint, name="panda", cameras={"front": front}
    )
    robot = make_robot_from_config(config)
    teleop = make_teleoperator_from_config(
        TeleoperatorConfig.get_choice_class("zarm")(robot="panda", connect=endpoint, name="panda")
    )
    features = [*robot.observation_features], [*robot.action_features]
    refused = ""
    with robot, teleop:
        before = robot.get_observation()
        image = before.pop("front")
        begun = time.monotonic()
        while (passed := time.monotonic() - begun) < seconds:
            action = dict(before)
            action["panda_joint1.pos"] += 0.2 * (1.0 - math.cos(2.0 * passed)) / 2.0
            action["hand.pos"] = 0.04
            action["panda_joint2.pos"] = 100.0 if passed > seconds - 0.05 else action["panda_joint2.pos"]
            sent = robot.send_action(action)
            time.sleep(1 / 30)
        observed = teleop.get_action()
        try:
            robot.send_action({"panda_joint1.pos": 0.0})
        except Exception as error:
            refused = str(error)
    watching = make_robot_from_config(
        RobotConfig.get_choice_class("zarm")(robot="panda", connect=endpoint, name="panda", operated=True)
    )
    with watching:
        there = watching.get_observation()
        watching.send_action({**there, "panda_joint1.pos": there["panda_joint1.pos"] + 0.5})
        time.sleep(0.5)
        moved = watching.get_observation()["panda_joint1.pos"] - there["panda_joint1.pos"]
    json.dump(
        {
            "features": features,
            "before": before,
            "sent": sent,
            "observed": observed,
            "refused": refused,
            "moved": moved,
            "type": robot.name,
            "image": [list(image.shape), image[0, 0].tolist(), robot.observation_features["front"]],
        },
        sys.stdout,
    )


if __name__ == "__main__":
    main()
