"""The robot and its ghost in RViz, beside a running bridge (`zarm up --ros`).

    ros2 launch deploy/ros/view.launch.py [urdf:=robots/doosan_m1013.urdf] [namespace:=]

The bridge publishes joints, obstacles and spheres; here two robot_state_publishers turn joints into frames, the ghost's
under `preview/`, and RViz shows both. It needs a ROS 2 Jazzy desktop.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).resolve().parent
ROBOTS = HERE.parents[1] / "robots"


def view(context, *_args, **_kwargs):
    """Everything that is started, for the arguments of this launch."""
    urdf = Path(LaunchConfiguration("urdf").perform(context))
    namespace = LaunchConfiguration("namespace").perform(context)
    base = LaunchConfiguration("base_link").perform(context)
    description = urdf.read_text()
    robot = {"robot_description": description}
    ghost = {"robot_description": description, "frame_prefix": "preview/"}
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[robot],
            remappings=[
                ("robot_description", "robot_state_publisher/robot_description")
            ],  # the bridge publishes that one
        ),
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=f"{namespace}/preview",
            parameters=[ghost],
            remappings=[("robot_description", "robot_state_publisher/robot_description")],
        ),
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            arguments=["--frame-id", base, "--child-frame-id", f"preview/{base}"],
        ),
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", str(HERE / "view.rviz"), "-f", base],
            remappings=[
                (topic, f"/{namespace}{topic}" if namespace else topic)
                for topic in (
                    "/robot_description",
                    "/preview/robot_description",
                    "/unified_planner/obstacles",
                    "/unified_planner/collision_spheres",
                )
            ],
        ),
    ]


def generate_launch_description():
    """What `ros2 launch` asks for."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("urdf", default_value=str(ROBOTS / "doosan_m1013.urdf")),
            DeclareLaunchArgument("base_link", default_value="base_link"),
            DeclareLaunchArgument(
                "namespace", default_value="", description="of the bridge, where it serves several robots"
            ),
            OpaqueFunction(function=view),
        ]
    )
