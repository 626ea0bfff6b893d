"""Every key expression of the bus, built only here: `zarm/<robot>/<service>/<noun-or-verb>`."""

from __future__ import annotations

import re
from dataclasses import dataclass

_ROBOT = re.compile(r"[a-z][a-z0-9_]{0,63}")


@dataclass(frozen=True)
class Keys:
    """The keys of one robot instance. Raises ValueError for a name that cannot be a chunk of a key."""

    robot: str

    def __post_init__(self) -> None:
        if not _ROBOT.fullmatch(self.robot):
            raise ValueError(
                f"robot name {self.robot!r}: use lower case letters, digits and _, beginning with a letter"
            )

    def _key(self, *chunks: str) -> str:
        return "/".join(("zarm", self.robot, *chunks))

    # planner: queries
    @property
    def plan(self) -> str:
        """PlanRequest -> Plan. Plan a verified motion; nothing moves."""
        return self._key("planner", "plan")

    @property
    def plan_cancel(self) -> str:
        """CancelPlan -> CancelledPlan. End the planning of one request."""
        return self._key("planner", "cancel")

    @property
    def ik(self) -> str:
        """IkRequest -> IkSolutions. Inverse kinematics of up to 1000 poses."""
        return self._key("planner", "ik")

    @property
    def fk(self) -> str:
        """FkRequest -> FkPoses. Forward kinematics of up to 1000 joint vectors."""
        return self._key("planner", "fk")

    @property
    def check(self) -> str:
        """CheckRequest -> CheckResults. Exact distances of joint vectors to the scene and of the robot to itself."""
        return self._key("planner", "check")

    @property
    def occupancy(self) -> str:
        """OccupancyRequest -> Occupancy. The grid cells that objects of the scene reach into."""
        return self._key("planner", "occupancy")

    @property
    def settings(self) -> str:
        """SettingsChange -> PlannerSettings. Defaults for plan requests; an empty request reads them."""
        return self._key("planner", "settings")

    @property
    def planners(self) -> str:
        """Planners. The planners that a request may name."""
        return self._key("planner", "planners")

    @property
    def plans(self) -> str:
        """Plan. Every successful plan."""
        return self._key("planner", "plans")

    # scene, owned by the planner service
    @property
    def scene(self) -> str:
        """Scene. The whole scene."""
        return self._key("scene")

    def scene_object(self, name: str) -> str:
        """Cuboid, Sphere, Capsule, Cylinder, Mesh or Voxels. One object of the scene; `name` may be `*`."""
        return self._key("scene", "object", name)

    def object_pose(self, name: str) -> str:
        """ObjectPose. Where an object of the scene is and how it moves, at up to 100 Hz; `name` may be `*`."""
        return self._key("scene", "object", name, "pose")

    @property
    def scene_revision(self) -> str:
        """SceneEdited. Only the present revision, for clients that need no more."""
        return self._key("scene", "revision")

    @property
    def scene_edit(self) -> str:
        """SceneEdit -> SceneEdited. Change the scene; an edit is applied as a whole or not at all."""
        return self._key("scene", "edit")

    # executor
    @property
    def execute(self) -> str:
        """ExecuteRequest -> Accepted. Start a goal: the last plan, a plan by its id, or any trajectory."""
        return self._key("executor", "execute")

    def goal(self, goal_id: str) -> str:
        """GoalState. One goal, from acceptance to its end; `goal_id` may be `*`."""
        return self._key("executor", "goal", goal_id)

    @property
    def cancel(self) -> str:
        """CancelRequest -> ExecutorState. Cancel one goal, or whichever runs; the robot brakes to rest."""
        return self._key("executor", "cancel")

    @property
    def stop(self) -> str:
        """Nothing -> ExecutorState. Brake to rest now; also ends goals that have not started yet."""
        return self._key("executor", "stop")

    @property
    def pause(self) -> str:
        """Nothing -> ExecutorState. Brake to rest and keep the goal."""
        return self._key("executor", "pause")

    @property
    def resume(self) -> str:
        """Nothing -> ExecutorState. Continue the paused goal."""
        return self._key("executor", "resume")

    @property
    def reset(self) -> str:
        """Nothing -> ExecutorState. Leave `fault`."""
        return self._key("executor", "reset")

    @property
    def strategy(self) -> str:
        """StrategyRequest -> Strategies. Switch the control strategy; an empty request reads it."""
        return self._key("executor", "strategy")

    @property
    def speed(self) -> str:
        """SpeedRequest -> Speed. Scale the speed, also in motion; an empty request reads it."""
        return self._key("executor", "speed")

    @property
    def stream(self) -> str:
        """StreamChunk. The next motion from a closed-loop planner."""
        return self._key("executor", "stream")

    @property
    def authority(self) -> str:
        """Authority. How far the running goal may go, from the servo."""
        return self._key("executor", "authority")

    @property
    def replace(self) -> str:
        """ReplaceTrajectory -> Accepted. Go on along another trajectory to the same goal, in motion or from rest; asked by the servo."""
        return self._key("executor", "replace")

    @property
    def goal_trajectory(self) -> str:
        """GoalTrajectory. The trajectory that is followed, from the last goal on."""
        return self._key("executor", "trajectory")

    @property
    def executor_state(self) -> str:
        """ExecutorState. Mode, active goal and problem of the executor."""
        return self._key("executor", "state")

    # servo
    @property
    def servo_start(self) -> str:
        """ServoStart -> Accepted. Open a session, in which the robot follows a live target."""
        return self._key("servo", "start")

    @property
    def servo_end(self) -> str:
        """ServoEnd -> Nothing. Bring the robot to rest and end the session."""
        return self._key("servo", "end")

    @property
    def servo_target(self) -> str:
        """ServoTarget. The live target of the session."""
        return self._key("servo", "target")

    @property
    def servo_state(self) -> str:
        """ServoState. What the servo does, and in which scene."""
        return self._key("servo", "state")

    # driver: what a robot's driver takes from the executor, and tells it
    @property
    def driver_command(self) -> str:
        """DriverCommand. Exactly what the executor sends to the driver."""
        return self._key("driver", "command")

    @property
    def driver_progress(self) -> str:
        """DriverProgress. How much of the command the driver has played."""
        return self._key("driver", "progress")

    @property
    def driver_joint_states(self) -> str:
        """JointState. What the driver measures, in its own joint order."""
        return self._key("driver", "joint_states")

    @property
    def simulated_fault(self) -> str:
        """DriverFault -> Nothing. Give the simulated driver a fault; an empty request ends all faults."""
        return self._key("leeloo_sim", "fault")

    # robot and ghost
    @property
    def joint_states(self) -> str:
        """JointState. The measured robot, whatever the strategy."""
        return self._key("joint_states")

    @property
    def preview_trajectory(self) -> str:
        """Trajectory. What the ghost plays."""
        return self._key("preview", "trajectory")

    @property
    def preview_joint_states(self) -> str:
        """JointState. The ghost."""
        return self._key("preview", "joint_states")

    # every service
    def health(self, service: str) -> str:
        """Nothing -> Health. What the service is and whether it is ready."""
        return self._key(service, "health")

    def reread(self, service: str) -> str:
        """Nothing -> Health. Read the robot's files again; the service restarts itself where they have changed."""
        return self._key(service, "reread")

    def alive(self, service: str, instance: str) -> str:
        """Liveliness token. It exists as long as the service runs; `service` and `instance` may be `*`."""
        return self._key(service, "@alive", instance)


ALL_ALIVE = "zarm/*/*/@alive/*"
"""Every liveliness token on the bus; `parse_alive` reads one."""


ALL_CLIENTS = "zarm/@clients/*"
"""The liveliness tokens of those who ask; `client_token` makes one."""


def client_token(client: str) -> str:
    """The liveliness token of the session with this id."""
    return ALL_CLIENTS.replace("*", client)


def parse_alive(key: str) -> tuple[str, str, str]:
    """`(robot, service, instance)` of a liveliness token's key; ValueError for any other key."""
    chunks = key.split("/")
    if len(chunks) != 5 or chunks[0] != "zarm" or chunks[3] != "@alive":
        raise ValueError(f"{key} is not a liveliness token")
    return chunks[1], chunks[2], chunks[4]
