"""Every key of the bus, declared only here: `zarm/<robot>/<service>/<noun-or-verb>`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

from zarm_contract.key import BinaryTopic, Family, Key, Latched, OfService, Query, Setting, Token, Topic
from zarm_contract.messages import (
    Accepted,
    AgentAnswer,
    AgentCall,
    AgentQuestion,
    Authority,
    CameraChange,
    Cameras,
    CancelledPlan,
    CancelPlan,
    CancelRequest,
    CheckRequest,
    CheckResults,
    ChunkAccepted,
    CloudHeader,
    ColorHeader,
    DriverCommand,
    DriverFault,
    DriverGripperCommand,
    DriverGripperState,
    DriverOutputCommand,
    DriverOutputState,
    DriverProgress,
    DriverSpeed,
    ExecuteRequest,
    ExecutorState,
    ExternalTorque,
    FkPoses,
    FkRequest,
    GoalState,
    GoalTrajectory,
    GripperCancel,
    GripperRequest,
    GripperState,
    Health,
    IkRequest,
    IkSolutions,
    ImageHeader,
    InverseDynamics,
    InverseDynamicsRequest,
    JointDynamics,
    JointState,
    LoadedMap,
    LoadWorld,
    Message,
    Nothing,
    ObjectPose,
    Occupancy,
    OccupancyRequest,
    OutputRequest,
    OutputState,
    PerceptionState,
    PhysicsObjects,
    PhysicsState,
    Plan,
    Planners,
    PlannerSettings,
    PlanRequest,
    ProgramRequest,
    ReplaceTrajectory,
    SavedMap,
    Scene,
    SceneEdit,
    SceneEdited,
    SceneObject,
    ServoChunk,
    ServoEnd,
    ServoStart,
    ServoState,
    ServoTarget,
    SettingsChange,
    Speed,
    SpeedRequest,
    Strategies,
    StrategyRequest,
    StreamChunk,
    Trajectory,
    VoxelBlock,
)
from zarm_contract.roles import ACTS, DRIVES, EVERYONE, SERVICE_ROLES

_ROBOT = re.compile(r"[a-z][a-z0-9_]{0,63}")
_OBJECTS = get_args(get_args(SceneObject)[0])


@dataclass(frozen=True)
class Keys:
    """The keys of one robot instance. Raises ValueError for a name that cannot be a chunk of a key."""

    robot: str

    def __post_init__(self) -> None:
        if not _ROBOT.fullmatch(self.robot):
            raise ValueError(
                f"robot name {self.robot!r}: use lower case letters, digits and _, beginning with a letter"
            )

    # planner
    plan = Query(
        "planner/plan",
        PlanRequest,
        Plan,
        "Plan a verified motion; nothing moves.",
        to="planner",
        by=(*ACTS, "servo"),  # which replans around obstacles
    )
    program = Query(
        "planner/program",
        ProgramRequest,
        Plan,
        "Plan the segments of a program as one verified motion; nothing moves.",
        to="planner",
        by=ACTS,
    )
    plan_cancel = Query(
        "planner/cancel", CancelPlan, CancelledPlan, "End the planning of one request.", to="planner", by=ACTS
    )
    ik = Query("planner/ik", IkRequest, IkSolutions, "Inverse kinematics of up to 1000 poses.", to="planner", by=ACTS)
    fk = Query(
        "planner/fk",
        FkRequest,
        FkPoses,
        "Forward kinematics of up to 1000 joint vectors.",
        to="planner",
        by=EVERYONE,  # for the tip's pose
    )
    inverse_dynamics = Query(
        "planner/inverse_dynamics",
        InverseDynamicsRequest,
        InverseDynamics,
        "The torques of up to 1000 states of motion, with what the robot carries.",
        to="planner",
        by=EVERYONE,  # for plots
    )
    check = Query(
        "planner/check",
        CheckRequest,
        CheckResults,
        "Exact distances of joint vectors to the scene and of the robot to itself.",
        to="planner",
        by=EVERYONE,  # for clearances
    )
    occupancy = Query(
        "planner/occupancy",
        OccupancyRequest,
        Occupancy,
        "The grid cells that objects of the scene reach into.",
        to="planner",
        by=DRIVES,
    )
    settings = Setting(
        "planner/settings",
        SettingsChange,
        PlannerSettings,
        "Defaults for plan requests; an empty request reads them.",
        of="planner",
        by=DRIVES,
    )
    planners = Latched("planner/planners", Planners, "The planners that a request may name.", of="planner")
    plans = Latched("planner/plans", Plan, "Every successful plan.", of="planner", recorded="value and changes")

    # scene, owned by the planner service
    scene = Latched("scene", Scene, "The whole scene.", of="planner", recorded="with the scene")
    scene_object = Family(
        Latched(
            "scene/object/<name>",
            Message,
            "One object of the scene; `name` may be `*`.",
            of="planner",
            subclasses=_OBJECTS,
        )
    )
    object_pose = Family(
        Topic(
            "scene/object/<name>/pose",
            ObjectPose,
            "Where an object of the scene is and how it moves, at up to 100 Hz; `name` may be `*`.",
            by=DRIVES,  # like edits of the scene
            realtime=True,
        )
    )
    scene_revision = Latched(
        "scene/revision",
        SceneEdited,
        "Only the present revision, for clients that need no more.",
        of="planner",
        recorded="value and changes",
    )
    scene_edit = Query(
        "scene/edit",
        SceneEdit,
        SceneEdited,
        "Change the scene; an edit is applied as a whole or not at all.",
        to="planner",
        by=ACTS,
    )

    # executor
    execute = Query(
        "executor/execute",
        ExecuteRequest,
        Accepted,
        "Start a goal: the last plan, a plan by its id, or any trajectory.",
        to="executor",
        by=ACTS,
    )
    goal = Family(
        Latched(
            "executor/goal/<goal_id>",
            GoalState,
            "One goal, from acceptance to its end; `goal_id` may be `*`.",
            of="executor",
            recorded="changes",
        )
    )
    cancel = Query(
        "executor/cancel",
        CancelRequest,
        ExecutorState,
        "Cancel one goal, or whichever runs; the robot brakes to rest.",
        to="executor",
        by=ACTS,
    )
    stop = Query(
        "executor/stop",
        Nothing,
        ExecutorState,
        "Brake to rest now; also ends goals that have not started yet.",
        to="executor",
        by=EVERYONE,  # who sees that a robot must stop may stop it, even a viewer
    )
    pause = Query(
        "executor/pause", Nothing, ExecutorState, "Brake to rest and keep the goal.", to="executor", by=DRIVES
    )
    resume = Query("executor/resume", Nothing, ExecutorState, "Continue the paused goal.", to="executor", by=DRIVES)
    reset = Query("executor/reset", Nothing, ExecutorState, "Leave `fault`.", to="executor", by=DRIVES)
    strategy = Setting(
        "executor/strategy",
        StrategyRequest,
        Strategies,
        "Switch the control strategy; an empty request reads it.",
        of="executor",
        by=DRIVES,
        recorded="value and changes",
    )
    speed = Setting(
        "executor/speed",
        SpeedRequest,
        Speed,
        "Scale the speed, also in motion; an empty request reads it.",
        of="executor",
        by=ACTS,
        recorded="value and changes",
    )
    stream = Topic(
        "executor/stream",
        StreamChunk,
        "The next motion from a closed-loop planner.",
        by=(*DRIVES, "servo", "executor"),  # that of a robot of several robots
        realtime=True,
        recorded="changes",
    )
    authority = Topic(
        "executor/authority",
        Authority,
        "How far the running goal may go, from the servo.",
        by=("servo",),
        realtime=True,
        recorded="changes",
    )
    replace = Query(
        "executor/replace",
        ReplaceTrajectory,
        Accepted,
        "Go on along another trajectory to the same goal, in motion or from rest; asked by the servo.",
        to="executor",
        by=("servo",),
    )
    goal_trajectory = Latched(
        "executor/trajectory", GoalTrajectory, "The trajectory that is followed, from the last goal on.", of="executor"
    )
    executor_state = Latched(
        "executor/state",
        ExecutorState,
        "Mode, active goal and problem of the executor.",
        of="executor",
        recorded="value and changes",
    )

    gripper = Query(
        "executor/gripper",
        GripperRequest,
        Accepted,
        "Move a gripper to an opening, and hold.",
        to="executor",
        by=(*ACTS, "servo", "executor"),  # for the chunks that it follows, and for a robot of several robots
    )
    gripper_cancel = Query(
        "executor/gripper/cancel", GripperCancel, GripperState, "Stop a gripper where it is.", to="executor", by=ACTS
    )
    gripper_state = Family(
        Latched(
            "executor/gripper/<name>/state",
            GripperState,
            "One gripper: its opening and its goal; `name` may be `*`.",
            of="executor",
            recorded="value and changes",
        )
    )
    output = Query(
        "executor/output", OutputRequest, OutputState, "Switch an output on or off.", to="executor", by=DRIVES
    )
    output_state = Family(
        Latched(
            "executor/output/<name>/state",
            OutputState,
            "One output, as it was switched last; `name` may be `*`.",
            of="executor",
            recorded="value and changes",
        )
    )

    # servo
    servo_start = Query(
        "servo/start",
        ServoStart,
        Accepted,
        "Open a session, in which the robot follows a live target.",
        to="servo",
        by=DRIVES,
    )
    servo_end = Query(
        "servo/end", ServoEnd, Nothing, "Bring the robot to rest and end the session.", to="servo", by=DRIVES
    )
    servo_target = Topic("servo/target", ServoTarget, "The live target of the session.", by=DRIVES, realtime=True)
    servo_chunk = Query(
        "servo/chunk",
        ServoChunk,
        ChunkAccepted,
        "The next piece of motion of the session, from a policy or a program.",
        to="servo",
        by=DRIVES,
    )
    servo_state = Latched(
        "servo/state", ServoState, "What the servo does, and in which scene.", of="servo", recorded="changes"
    )

    joint_dynamics = Query(
        "servo/joint_dynamics",
        Nothing,
        JointDynamics,
        "The friction of the joints and the inertia of their motors, identified from the motions since the servo began.",
        to="servo",
        by=EVERYONE,  # it only reads
    )
    external_torque = Topic(
        "servo/external_torque",
        ExternalTorque,
        "What pushes the robot, by the efforts of its joints; of a collision, at once.",
        by=("servo",),
        realtime=True,
        recorded="changes",
    )

    # agent: a program that moves the robot through `zarm mcp`
    agent_call = Topic(
        "agent/call", AgentCall, "What an agent asked for, and what became of it.", by=("agent",), recorded="changes"
    )
    agent_question = Topic(
        "agent/question",
        AgentQuestion,
        "What an agent wants, and a person has to approve.",
        by=("agent",),
        recorded="changes",
    )
    agent_answer = Topic("agent/answer", AgentAnswer, "A person's answer to that.", by=DRIVES, recorded="changes")

    # driver: what a robot's driver takes from the executor, and tells it
    driver_command = Topic(
        "driver/command",
        DriverCommand,
        "Exactly what the executor sends to the driver.",
        by=("executor",),
        realtime=True,
        recorded="changes",
    )
    driver_progress = Topic(
        "driver/progress",
        DriverProgress,
        "How much of the command the driver has played.",
        by=("driver", "bridge"),
        realtime=True,
        droppable=False,
        recorded="changes",
    )
    driver_speed = Topic(
        "driver/speed",
        DriverSpeed,
        "How fast the robot lets itself be moved by its own controls.",
        by=("driver", "bridge"),
        realtime=True,
        droppable=False,
        recorded="changes",
    )
    driver_joint_states = Topic(
        "driver/joint_states",
        JointState,
        "What the driver measures, in its own joint order.",
        by=("driver", "bridge"),
        realtime=True,
        recorded="changes",
    )
    driver_gripper_command = Topic(
        "driver/gripper/command",
        DriverGripperCommand,
        "What the executor sends to the driver of a gripper.",
        by=("executor",),
        realtime=True,
        droppable=False,
        recorded="changes",
    )
    driver_gripper_state = Topic(
        "driver/gripper/state",
        DriverGripperState,
        "What the driver of a gripper measures, and what became of its command.",
        by=("driver", "bridge"),
        realtime=True,
        droppable=False,
        recorded="changes",
    )
    driver_output_command = Topic(
        "driver/output/command",
        DriverOutputCommand,
        "What the executor sends to the driver of an output.",
        by=("executor",),
        realtime=True,
        droppable=False,
        recorded="changes",
    )
    driver_output_state = Topic(
        "driver/output/state",
        DriverOutputState,
        "What became of a command to an output.",
        by=("driver", "bridge"),
        realtime=True,
        droppable=False,
        recorded="changes",
    )
    simulated_fault = Query(
        "leeloo_sim/fault",
        DriverFault,
        Nothing,
        "Give the simulated driver a fault; an empty request ends all faults.",
        to="driver",
        by=("operator",),
    )

    physics_world = Query(
        "physics/world",
        LoadWorld,
        Nothing,
        "Replace the world of a simulation with physics.",
        to="driver",
        by=("operator",),
    )
    physics_objects = Latched(
        "physics/objects",
        PhysicsObjects,
        "The objects of a simulation with physics, for displays.",
        of="driver",
        readers=("operator", "viewer"),
        recorded="with the scene",
    )
    physics_state = Topic(
        "physics/state",
        PhysicsState,
        "The ground truth of a simulation with physics, 50 times a second, for tests and displays.",
        by=("driver",),
        readers=("operator", "viewer"),
        droppable=True,
        recorded="with the scene",
    )

    # perception
    cameras = Setting(
        "perception/cameras",
        CameraChange,
        Cameras,
        "The cameras that make the voxel map; a request adds, replaces or removes one.",
        of="perception",
        by=DRIVES,
    )
    depth = Family(
        BinaryTopic(
            "perception/depth/<camera>",
            ImageHeader,
            "Depth images of a camera: the header as a line of JSON, then the pixels.",
            by=("perception", "driver", "bridge", "operator"),
            droppable=True,
        )
    )
    color = Family(
        BinaryTopic(
            "perception/color/<camera>",
            ColorHeader,
            "Colour images of a camera, registered to the depth: the header as a line of JSON, then the pixels.",
            by=("perception", "driver", "bridge", "operator"),
            droppable=True,
        )
    )
    mask = Family(
        BinaryTopic(
            "perception/mask/<camera>",
            ColorHeader,
            "What the map makes of a depth image, twice a second, thinned out to 160 columns: 255 where a pixel counts, 128 where it is the robot, 0 where it has no depth or is noise.",
            by=("perception",),
            droppable=True,
        )
    )
    cloud = Family(
        BinaryTopic(
            "perception/cloud/<camera>",
            CloudHeader,
            "Clouds of a camera or a LiDAR: the header as a line of JSON, then the points.",
            by=("perception", "driver", "bridge", "operator"),
            droppable=True,
        )
    )
    voxels = Family(
        Latched(
            "perception/map/<block>",
            VoxelBlock,
            "The voxel map in blocks, of which those are published that have changed.",
            of="perception",
            recorded="with the scene",
        )
    )
    perception_state = Latched(
        "perception/state",
        PerceptionState,
        "What the cameras see, and whether they do; twice a second.",
        of="perception",
        recorded="changes",
    )
    perception_clear = Query(
        "perception/clear", Nothing, Nothing, "Forget what the cameras have seen.", to="perception", by=DRIVES
    )
    perception_save = Query(
        "perception/save", Nothing, SavedMap, "The voxel map, to be saved.", to="perception", by=DRIVES
    )
    perception_load = Query(
        "perception/load",
        SavedMap,
        LoadedMap,
        "Make a saved voxel map the map; cameras change it from then on.",
        to="perception",
        by=DRIVES,
    )

    # robot and ghost
    joint_states = Topic(
        "joint_states",
        JointState,
        "The measured robot, whatever the strategy.",
        by=("executor",),
        realtime=True,
        recorded="changes",
    )
    preview_trajectory = Topic("preview/trajectory", Trajectory, "What the ghost plays.", by=("executor",))
    preview_joint_states = Topic("preview/joint_states", JointState, "The ghost.", by=("executor",))

    # every service
    health = OfService(
        Query(
            "<service>/health",
            Nothing,
            Health,
            "What the service is and whether it is ready.",
            by=EVERYONE,
            readable=True,
        )
    )
    reread = OfService(
        Query(
            "<service>/reread",
            Nothing,
            Health,
            "Read the robot's files again; the service restarts itself where they have changed.",
            by=DRIVES,
        )
    )
    alive = OfService(
        Token(
            "<service>/@alive/<instance>",
            "It exists as long as the service runs; `service` and `instance` may be `*`.",
        )
    )


def declared() -> dict[str, Key]:
    """Each attribute of `Keys` as the key of any robot and, where it contains a name, of any name."""
    return {
        name: member.key if isinstance(member, Family) else member
        for name, member in vars(Keys).items()
        if isinstance(member, Key | Family)
    }


def every_key() -> Iterator[Key]:
    """The keys of any robot, with those of each service."""
    for member in vars(Keys).values():
        if isinstance(member, OfService):
            others = ["*"] * (member.key.path.count("<") - 1)
            yield from (member(service, *others) for service in SERVICE_ROLES)
        elif isinstance(member, Key | Family):
            yield member.key if isinstance(member, Family) else member


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
