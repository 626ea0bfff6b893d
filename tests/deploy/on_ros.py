"""A client of the ROS bridge that knows nothing of zarm: plans, executes, and prints what it was told as JSON."""

import json
import sys

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose, Quaternion
from rclpy.action import ActionClient

from curobo_msgs.action import SendTrajectory
from curobo_msgs.srv import TrajectoryGeneration

TARGET = Pose(position=Point(x=0.5, y=0.2, z=0.4), orientation=Quaternion(x=0.0, y=1.0, z=0.0, w=0.0))

rclpy.init()
node = rclpy.create_node("client")


def answer(future):
    rclpy.spin_until_future_complete(node, future, timeout_sec=60)
    return future.result()


planning = node.create_client(TrajectoryGeneration, "/unified_planner/generate_trajectory")
action = ActionClient(node, SendTrajectory, "/unified_planner/execute_trajectory")
if not (planning.wait_for_service(60) and action.wait_for_server(60)):
    sys.exit("the bridge was not found")
plan = answer(planning.call_async(TrajectoryGeneration.Request(target_pose=TARGET)))
reported = []
sent = answer(
    action.send_goal_async(SendTrajectory.Goal(), feedback_callback=lambda one: reported.append(one.feedback.state))
)
ended = answer(sent.get_result_async())
print(
    json.dumps(
        {
            "planned": plan.success,
            "points": len(plan.trajectory),
            "states": sorted(set(reported)),
            "succeeded": ended.status == GoalStatus.STATUS_SUCCEEDED,
        }
    )
)
