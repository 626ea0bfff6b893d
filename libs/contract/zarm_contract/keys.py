"""Every key expression of the bus, built here and nowhere else: `zarm/<robot>/<service>/<noun-or-verb>`."""

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
        """PlanRequest -> Plan."""
        return self._key("planner", "plan")

    @property
    def plan_cancel(self) -> str:
        """CancelPlan -> CancelledPlan."""
        return self._key("planner", "cancel")

    @property
    def ik(self) -> str:
        """IkRequest -> IkSolutions."""
        return self._key("planner", "ik")

    @property
    def fk(self) -> str:
        """FkRequest -> FkPoses."""
        return self._key("planner", "fk")

    @property
    def check(self) -> str:
        """CheckRequest -> CheckResults."""
        return self._key("planner", "check")

    @property
    def occupancy(self) -> str:
        """OccupancyRequest -> Occupancy."""
        return self._key("planner", "occupancy")

    @property
    def settings(self) -> str:
        """SettingsChange -> PlannerSettings; latched."""
        return self._key("planner", "settings")

    @property
    def plans(self) -> str:
        """Plan; every successful one; latched."""
        return self._key("planner", "plans")

    # scene, owned by the planner service
    @property
    def scene(self) -> str:
        """Scene; latched."""
        return self._key("scene")

    def scene_object(self, name: str) -> str:
        """SceneObject; query. `name` may be `*`."""
        return self._key("scene", "object", name)

    @property
    def scene_revision(self) -> str:
        """SceneEdited; the present revision alone, for those who need no more; latched."""
        return self._key("scene", "revision")

    @property
    def scene_edit(self) -> str:
        """SceneEdit -> SceneEdited."""
        return self._key("scene", "edit")

    # executor
    @property
    def execute(self) -> str:
        """ExecuteRequest -> Accepted."""
        return self._key("executor", "execute")

    def goal(self, goal_id: str) -> str:
        """GoalState; latched. `goal_id` may be `*`."""
        return self._key("executor", "goal", goal_id)

    @property
    def cancel(self) -> str:
        """CancelRequest -> ExecutorState."""
        return self._key("executor", "cancel")

    @property
    def stop(self) -> str:
        """Nothing -> ExecutorState, at once; the robot decelerates to rest."""
        return self._key("executor", "stop")

    @property
    def pause(self) -> str:
        """Nothing -> ExecutorState."""
        return self._key("executor", "pause")

    @property
    def resume(self) -> str:
        """Nothing -> ExecutorState."""
        return self._key("executor", "resume")

    @property
    def reset(self) -> str:
        """Nothing -> ExecutorState: leave `fault`."""
        return self._key("executor", "reset")

    @property
    def strategy(self) -> str:
        """StrategyRequest -> Strategies; latched."""
        return self._key("executor", "strategy")

    @property
    def speed(self) -> str:
        """SpeedRequest -> Speed; latched."""
        return self._key("executor", "speed")

    @property
    def stream(self) -> str:
        """StreamChunk; published by a closed-loop planner."""
        return self._key("executor", "stream")

    @property
    def executor_state(self) -> str:
        """ExecutorState; latched."""
        return self._key("executor", "state")

    # driver: what a robot's driver takes from the executor, and tells it
    @property
    def driver_command(self) -> str:
        """DriverCommand; published by the executor."""
        return self._key("driver", "command")

    @property
    def driver_progress(self) -> str:
        """DriverProgress; published by the driver."""
        return self._key("driver", "progress")

    @property
    def driver_joint_states(self) -> str:
        """JointState; published by the driver, joints in whatever order it has."""
        return self._key("driver", "joint_states")

    @property
    def simulated_fault(self) -> str:
        """DriverFault -> Nothing; what a simulated driver is to suffer."""
        return self._key("leeloo_sim", "fault")

    # robot and ghost
    @property
    def joint_states(self) -> str:
        """JointState; the measured robot, whatever the strategy."""
        return self._key("joint_states")

    @property
    def preview_trajectory(self) -> str:
        """Trajectory; what the ghost plays."""
        return self._key("preview", "trajectory")

    @property
    def preview_joint_states(self) -> str:
        """JointState; the ghost."""
        return self._key("preview", "joint_states")

    # every service
    def health(self, service: str) -> str:
        """Nothing -> Health."""
        return self._key(service, "health")

    def reread(self, service: str) -> str:
        """Nothing -> Health: take the robot's file as it is now, and start anew where it has changed."""
        return self._key(service, "reread")

    def alive(self, service: str, instance: str) -> str:
        """Liveliness token. `service` and `instance` may be `*`."""
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
        raise ValueError(f"{key} is no liveliness token")
    return chunks[1], chunks[2], chunks[4]
