"""At least one example of every message class; together they set every field.

`python tests/support/message_examples.py` writes them to `tests/unit/contract/golden/<Message>.json`, which record the
wire format. A change there is a change of the contract: other versions of zarm and other programs on the bus read these
bytes.
"""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path

from zarm_contract import messages as m
from zarm_contract.codec import encode
from zarm_contract.errors import Problem
from zarm_contract.messages import Message

GOLDEN = Path(__file__).parents[1] / "unit" / "contract" / "golden"

_POSE = m.Pose(position=(0.4, -0.1, 0.25), orientation=(0.0, 0.6, 0.0, 0.8))
_TRAJECTORY = m.Trajectory(
    joint_names=("shoulder", "elbow"),
    time=(0.0, 0.5, 1.25),
    position=((0.0, 0.0), (0.1, -0.2), (0.3, -0.4)),
    velocity=((0.0, 0.0), (0.3, -0.5), (0.0, 0.0)),
    acceleration=((0.0, 0.0), (0.25, -0.125), (0.0, 0.0)),
)
_PROBLEM = Problem(
    code="tolerance_violated",
    message="elbow is 0.31 rad off its path, more than 0.2 rad; clear the way, then reset",
    field="path_tolerance",
    joint="elbow",
    fraction=0.75,
)
_TIMINGS = m.PlanTimings(ik=0.001, search=0.002, shortcut=0.004, timing=0.008, verify=0.016, optimize=0.02, total=0.052)
_TORQUE = m.PlanTorque(joint="joint_2", share=0.9, time=0.25, stretch=1.1)
_CAMERA = m.Camera(
    name="wrist",
    link="link_6",
    position=(0.05, 0.0, 0.1),
    orientation=(0.0, 0.6, 0.0, 0.8),
    width=640,
    height=480,
    fx=610.0,
    fy=611.0,
    cx=319.5,
    cy=239.5,
    near=0.2,
    far=3.0,
    rate=15.0,
    projection="spherical",
    topic="/camera/depth/image_rect_raw",
    topic_type="sensor_msgs/msg/PointCloud2",
    color_topic="/camera/color/image_rect",
)
_TEXTURE = m.Texture(name="table", image="iVBORw0KGgo=")
_TOOL_MOTION = m.ToolMotion(length=0.4, speed=0.1, rotational_speed=0.7, speed_share=0.875)
_TOO_NEAR = m.TooNear(pair=("link_3", "table"), distance=0.002, margin=0.03, time=0.75)
_CUBOID = m.Cuboid(
    kind="cuboid", name="table", position=(0.5, 0.0, -0.1), orientation=(0.0, 0.0, 0.6, 0.8), size=(1.0, 2.0, 0.2)
)
_SPHERE = m.Sphere(kind="sphere", name="ball.1", position=(0.1, 0.2, 0.3), radius=0.05)
_CAPSULE = m.Capsule(
    kind="capsule", name="pipe", position=(0.1, 0.2, 0.3), orientation=(0.6, 0.0, 0.0, 0.8), radius=0.02, length=0.5
)
_CYLINDER = m.Cylinder(
    kind="cylinder", name="can", position=(0.3, 0.2, 0.1), orientation=(0.0, 0.0, 0.0, 1.0), radius=0.03, length=0.12
)
_MESH = m.Mesh(
    kind="mesh",
    name="fixture",
    position=(0.3, 0.2, 0.1),
    orientation=(0.0, 0.0, 0.6, 0.8),
    file="fixtures/vice.stl",
    scale=(0.001, 0.001, 0.001),
    data="AAAA",
    sha256="5f" * 32,
)
_VOXELS = m.Voxels(
    kind="voxels",
    name="bin",
    position=(0.5, 0.0, 0.0),
    orientation=(0.0, 0.0, 0.6, 0.8),
    resolution=0.05,
    cells=((0, 0, 0), (0, -1, 2)),
)
_CLOUD = m.PointCloud(
    kind="cloud",
    name="depth",
    position=(0.5, 0.0, 0.0),
    orientation=(0.0, 0.0, 0.6, 0.8),
    resolution=0.05,
    points=((0.01, 0.02, 0.03), (0.5, -0.5, 0.25)),
)
_PACKED = m.PointCloud(kind="cloud", name="far", points="AAAAAAAA8D8AAAAAAAAAQAAAAAAAAAhA")
_OBJECTS = (_CUBOID, _SPHERE, _CAPSULE, _CYLINDER, _MESH, _VOXELS)
_ATTACHED = m.Attached(
    object=_CUBOID,
    touch_links=("finger_left",),
    parts=(_CUBOID,),
    link="left_tcp",
    mass=1.5,
    center=(0.0, 0.1, 0.02),
    tool="welder",
)
_ATTACH = m.AttachObject(
    op="attach",
    name="table",
    touch_links=("finger_left",),
    joints=(0.1, 0.2),
    link="left_tcp",
    mass=1.5,
    center=(0.0, 0.1, 0.02),
)
_MOUNT = m.MountTool(op="mount", tool="welder")
_UNMOUNT = m.UnmountTool(op="unmount", tool="welder")
_DETACH = m.DetachObject(op="detach", name="table", joints=(0.1, 0.2))
_LINKS = m.SetLinkCollision(op="links", names=("link_5",), enabled=False)
_OBJECTS_OFF = m.SetObjectCollision(op="objects", names=("table",), enabled=False)
_PAIRS_OFF = m.SetPairCollision(op="pairs", names=(("finger", "cube"),), enabled=False)
_ADD = m.AddObjects(op="add", objects=(*_OBJECTS, _CLOUD, _PACKED), replace=True)
_REMOVE = m.RemoveObjects(op="remove", names=("table", "ball.1"))
_BATCH = m.EditBatch(op="batch", edits=(_REMOVE, _PAIRS_OFF))
_REVISION = "12-5be0c1d2f3a4"
_CLEAR = m.ClearScene(op="clear")
_LOAD = m.LoadScene(op="load", objects=(_SPHERE,))
_POSE_GOAL = m.PoseGoal(kind="pose", position=(0.4, -0.1, 0.25), orientation=(0.0, 0.6, 0.0, 0.8))
_TOLERANCE = m.PoseTolerance(orientation=(0.1, 0.0, "free"), position=(0.01, "free", 0.0), frame="base")
_BALL = m.PoseTolerance(orientation=("free", "free", "free"), radius=0.05)
_TIP_FRAME = m.TipFrame(link="gripper", offset=_POSE)
_FREE_GOAL = m.PoseGoal(kind="pose", position=(0.4, -0.1, 0.25), tolerance=_TOLERANCE, tip=_TIP_FRAME)
_GROUP_GOAL = m.GroupGoal(group="left", goal=_POSE_GOAL)
_GOAL_SET = m.PoseGoal(kind="pose", position=(0.4, -0.1, 0.25), alternatives=(_POSE, _POSE))
_OFFSET = m.Offset(distance=0.1, direction=(0.0, 0.0, 1.0), frame="base", touch=("part",))
_TOUCH = m.Touch(objects=("part", "bin"), begin=0.5, end=1.25)
_WITH_WAYS = m.PoseGoal(kind="pose", position=(0.4, -0.1, 0.25), approach=_OFFSET, retreat=_OFFSET)
_SEGMENTS = (
    m.Move(kind="move", goal=_WITH_WAYS, name="pick", touch=("bin",), blend=0.02, group="torso+left"),
    m.Attach(
        kind="attach",
        object="part",
        touch_links=("finger",),
        name="grasp",
        link="left_tcp",
        mass=1.5,
        center=(0.0, 0.1, 0.02),
    ),
    m.Wait(kind="wait", duration=0.5, name="settle"),
    m.SpeedChange(kind="speed", velocity_scale=0.5, acceleration_scale=0.25, name="slow"),
    m.Grip(kind="grip", width=0.04),
    m.SetOutput(kind="set_output", output="vacuum", on=True, name="hold"),
    m.Detach(kind="detach", object="part", name="drop"),
)
_PROGRAM = m.ProgramRequest(
    segments=_SEGMENTS,
    start=(0.0, 0.0),
    request_id="weld-1",
    timeout=5.0,
    max_attempts=10,
    velocity_scale=0.5,
    acceleration_scale=0.25,
    margin=0.01,
    self_margin=0.02,
    seed=7,
    publish=False,
    partial=True,
    openings=(m.GripperOpening(gripper="hand", width=0.04),),
)
_GRIP = m.Grip(kind="grip", width=0.04, gripper="hand", force=20.0, speed=0.05, tolerance=0.002, name="close")
_PLANNED_GRIP = m.PlannedGrip(gripper="hand", width=0.04, force=20.0, speed=0.05, tolerance=0.002)
_OUTPUT = m.OutputRequest(output="vacuum", on=True)
_PLANNED_SEGMENT = m.PlannedSegment(
    action="grip", name="close", begin=0.0, end=1.25, grip=_PLANNED_GRIP, output=_OUTPUT
)
_ALONG_CURVE = {
    "speed": 0.1,
    "acceleration": 0.5,
    "rotational_speed": 0.7,
    "orienting": "tangent",
    "orientation_tolerance": (0.0, 0.1, "free"),
    "tip": _TIP_FRAME,
}
_ARC_VIA = m.ArcGoal(kind="arc", position=(0.4, 0.3, 0.25), via=(0.5, 0.1, 0.25), **_ALONG_CURVE)
_LINE = m.LineGoal(kind="line", position=(0.4, 0.3, 0.25), orientation=(0.0, 0.6, 0.0, 0.8), **_ALONG_CURVE)
_ARC_AROUND = m.ArcGoal(
    kind="arc", position=(0.4, 0.3, 0.25), orientation=(0.0, 0.0, 0.0, 1.0), center=(0.4, 0.1, 0.25)
)
_PATH = m.PathGoal(
    kind="path",
    points=(
        m.PathPoint(position=(0.4, 0.0, 0.25), orientation=(0.0, 0.6, 0.0, 0.8)),
        m.PathPoint(position=(0.4, 0.3, 0.25), blend=0.01, via=(0.4, 0.2, 0.3), center=(0.4, 0.1, 0.25)),
    ),
    shape="spline",
    blend=0.02,
    **_ALONG_CURVE,
)
_JOINT_GOAL = m.JointGoal(kind="joints", position=(0.3, -0.4))
_GROUPS_GOAL = m.GroupsGoal(kind="groups", goals=(_GROUP_GOAL, m.GroupGoal(group="right", goal=_JOINT_GOAL)))
_WAYPOINTS = m.WaypointsGoal(
    kind="waypoints", through=(_POSE_GOAL, _JOINT_GOAL), position_tolerance=0.01, angle_tolerance=0.05
)
_START_STATE = m.StartState(position=(0.1, -0.2), velocity=(0.3, -0.5), acceleration=(0.25, -0.125))
_PATH_CONSTRAINT = m.PathConstraint(
    axes=(True, True, False, False, False, True),
    frame="tool",
    position_tolerance=0.002,
    angle_tolerance=0.01,
    group="right",
    relative_to="left",
)
_OBSTRUCTION = m.Obstruction(object="table", link="link_5", time=1.1, avoidable=False)
_HOLD = m.Hold(reason="obstruction", obstruction=_OBSTRUCTION)
_TARGETS = (
    m.PoseTarget(
        kind="pose",
        frame="base",
        position=(0.4, -0.1, 0.25),
        orientation=(0.0, 0.6, 0.0, 0.8),
        linear=(0.1, 0.0, 0.0),
        angular=(0.0, 0.0, 0.2),
        tolerance=_BALL,
        group="left",
    ),
    m.TwistTarget(kind="twist", frame="tool", linear=(0.1, 0.0, 0.0), angular=(0.0, 0.0, 0.2), group="left"),
    m.JointSpeedTarget(kind="joint_speed", velocity=(0.1, -0.2)),
    m.JointTarget(kind="joints", position=(0.1, -0.2), velocity=(0.05, 0.0)),
)
_SESSION = m.ServoSession(
    goal_id="jog-1",
    limiting="slowing",
    link="link_5",
    object="table",
    distance=0.04,
    clearance=0.04,
    moving=True,
    planned=True,
    unreachable=_PROBLEM,
    position_error=0.002,
    orientation_error=0.01,
    joint_error=0.003,
    sequence=3,
    target_age=0.02,
    refused=_PROBLEM,
    cycles=250,
    late_cycles=1,
    computing=0.0012,
    chunk=7,
    lag=0.002,
)
_JOINT_POINTS = m.JointPoints(kind="joints", position=((0.1, -0.2), (0.2, -0.1)), velocity=((1.0, 1.0), (1.0, 1.0)))
_POSE_POINTS = m.PosePoints(
    kind="poses",
    pose=(m.Pose(position=(0.4, 0.1, 0.3)), m.Pose(position=(0.4, 0.2, 0.3), orientation=(0.0, 0.0, 1.0, 0.0))),
    group="left",
)
_CLIPPED = m.Clipped(joint="elbow", quantity="velocity", excess=0.2)
_EMULATOR = m.StrategyInfo(name="emulator", available=True, reason="it needs no robot")
_CHECKED = m.CheckResult(
    in_collision=False,
    within_limits=False,
    clearance=0.1,
    pair=("link_3", "table"),
    spheres=(0.1, 0.5),
    points=((0.5, 0.0, 0.1), (0.5, 0.0, 0.0)),
    holding=(m.HoldingTorque(torque=-12.5, effort=87.0), m.HoldingTorque(torque=3.0)),
)

EXAMPLES: tuple[Message, ...] = (
    _PROBLEM,
    # motion
    _POSE,
    m.JointState(
        stamp=1.75e9, joint_names=("shoulder", "elbow"), position=(0.1, -0.2), velocity=(0.0, 0.05), effort=(31.0, -8.5)
    ),
    _TRAJECTORY,
    # planner
    _POSE_GOAL,
    _GOAL_SET,
    _FREE_GOAL,
    _WITH_WAYS,
    _OFFSET,
    _TOUCH,
    *_SEGMENTS,
    _PROGRAM,
    _PLANNED_SEGMENT,
    _LINE,
    _ARC_VIA,
    _ARC_AROUND,
    _PATH,
    *_PATH.points,
    _TOLERANCE,
    _BALL,
    _TIP_FRAME,
    _JOINT_GOAL,
    _WAYPOINTS,
    _PATH_CONSTRAINT,
    m.PlanRequest(
        goal=_POSE_GOAL,
        group="left",
        start=(0.0, 0.0),
        planner="classic",
        path_constraint=_PATH_CONSTRAINT,
        request_id="request-1",
        timeout=2.5,
        max_attempts=3,
        optimize_s=0.5,
        velocity_scale=0.5,
        acceleration_scale=0.25,
        margin=0.03,
        self_margin=0.01,
        seed=7,
        publish=False,
        openings=(m.GripperOpening(gripper="hand", width=0.04),),
    ),
    _START_STATE,
    m.PlanRequest(goal=_JOINT_GOAL),
    m.PlanRequest(goal=_JOINT_GOAL, start_state=_START_STATE),
    m.PlanRequest(goal=_WAYPOINTS),
    _GROUP_GOAL,
    _GROUPS_GOAL,
    m.PlanRequest(goal=_GROUPS_GOAL),
    m.PlanRequest(goal=_JOINT_GOAL, group="right", concurrent=_TRAJECTORY),
    _TIMINGS,
    _TOO_NEAR,
    _TOOL_MOTION,
    _TORQUE,
    m.Plan(
        plan_id="plan-1",
        robot="arm_2",
        robot_hash="0123456789abcdef",
        scene_revision=_REVISION,
        trajectory=_TRAJECTORY,
        tip=_POSE,
        tool=_TOOL_MOTION,
        segments=(_PLANNED_SEGMENT,),
        touches=(_TOUCH,),
        openings=(m.GripperOpening(gripper="hand", width=0.04),),
        torque=_TORQUE,
        problem=_PROBLEM,
        goal_deviation=(0.0, 0.0, 1.5, 0.0, 0.0, -0.01),
        path_constraint=_PATH_CONSTRAINT,
        selected_goal_index=1,
        clearance=0.002,
        too_near=(_TOO_NEAR,),
        resolution=0.005,
        waypoint_times=(0.5, 1.25),
        path_length=0.5,
        timings=_TIMINGS,
    ),
    m.CancelPlan(request_id="request-1"),
    m.CancelledPlan(was_running=True),
    m.IkRequest(poses=(_POSE, _POSE), near=(0.0, 0.0), max_solutions=4, collision_free=False, device="cpu", seed=9),
    m.IkRequest(poses=(_POSE,), tolerance=_BALL, tip=_TIP_FRAME, group="left"),
    m.IkSolutions(solutions=(((0.1, 0.2), (0.3, 0.4)), ())),
    m.FkRequest(joints=((0.1, 0.2), (0.3, 0.4)), device="kernels", group="left", tip=_TIP_FRAME),
    m.FkPoses(poses=(_POSE,)),
    m.InverseDynamicsRequest(joints=((0.1, 0.2),), velocity=((0.5, 0.0),), acceleration=((1.0, -2.0),)),
    m.InverseDynamics(torque=((12.0, -3.5),), effort=(87.0, None)),
    m.CheckRequest(joints=((0.1, 0.2),), spheres=True, points=True, torque=True),
    m.HoldingTorque(torque=-12.5, effort=87.0),
    _CHECKED,
    m.CheckResults(results=(_CHECKED,)),
    m.PlannerSettings(
        planner="multi_point",
        timeout=3.0,
        max_attempts=5,
        optimize_s=0.1,
        velocity_scale=0.5,
        acceleration_scale=0.25,
        margin=0.01,
    ),
    m.Planners(names=("auto", "multi_point")),
    m.SettingsChange(
        planner="multi_point",
        timeout=3.0,
        max_attempts=5,
        optimize_s=0.1,
        velocity_scale=0.5,
        acceleration_scale=0.25,
        margin=0.01,
    ),
    # scene
    *_OBJECTS,
    m.OccupancyRequest(resolution=0.1),
    m.Occupancy(scene_revision=_REVISION, resolution=0.1, cells=((0, 0, 0), (1, -2, 3))),
    m.Scene(
        revision=_REVISION,
        objects=_OBJECTS,
        attached=(_ATTACHED,),
        ignored_links=("link_5",),
        ignored_objects=("table",),
        ignored_pairs=(("finger", "cube"),),
    ),
    _ADD,
    _REMOVE,
    _CLEAR,
    _LOAD,
    _CLOUD,
    _ATTACHED,
    _ATTACH,
    _MOUNT,
    _UNMOUNT,
    _DETACH,
    _LINKS,
    _OBJECTS_OFF,
    _PAIRS_OFF,
    _BATCH,
    m.SceneEdit(edit=_ADD),
    m.SceneEdit(edit=_REMOVE),
    m.SceneEdit(edit=_CLEAR),
    m.SceneEdit(edit=_LOAD),
    m.SceneEdit(edit=_ATTACH),
    m.SceneEdit(edit=_DETACH),
    m.SceneEdit(edit=_MOUNT),
    m.SceneEdit(edit=_UNMOUNT),
    m.SceneEdit(edit=_LINKS),
    m.SceneEdit(edit=_OBJECTS_OFF),
    m.SceneEdit(edit=_PAIRS_OFF),
    m.SceneEdit(edit=_BATCH),
    m.SceneEdited(revision=_REVISION, count=4, notes=("crate: a hole of at most 10 mm closed",)),
    # executor
    m.ExecuteRequest(plan_id="plan-1", preempt=True, goal_id="goal-1", replan=True),
    m.ExecuteRequest(
        trajectory=_TRAJECTORY,
        scene_revision=_REVISION,
        openings=(m.GripperOpening(gripper="hand", width=0.04),),
    ),
    m.ExecuteRequest(plan_id="plan-2", continues=m.Continuation(goal_id="goal-1", number=1, at=0.5)),
    m.Continuation(goal_id="goal-1", number=1, at=0.5),
    m.Accepted(goal_id="goal-1"),
    m.GoalState(
        goal_id="goal-1",
        plan_id="plan-1",
        status="aborted",
        progress=0.5,
        elapsed=0.6,
        duration=1.25,
        joint_command=(0.1, -0.2),
        problem=_PROBLEM,
        hold=_HOLD,
        tick_lateness=0.0003,
        lag=0.02,
        segment=2,
    ),
    m.GoalTrajectory(
        goal_id="goal-1",
        number=3,
        start=0.4,
        trajectory=_TRAJECTORY,
        scene_revision=_REVISION,
        replan=True,
        tip=_POSE,
        path_constraint=_PATH_CONSTRAINT,
        touches=(_TOUCH,),
        openings=(m.GripperOpening(gripper="hand", width=0.04),),
    ),
    m.ReplaceTrajectory(
        goal_id="goal-1",
        number=3,
        at=0.8,
        trajectory=_TRAJECTORY,
        scene_revision=_REVISION,
        until=3.0,
        openings=(m.GripperOpening(gripper="hand", width=0.04),),
    ),
    _HOLD,
    m.Hold(reason="no_guard"),
    _OBSTRUCTION,
    m.CancelRequest(goal_id="goal-1"),
    m.ExecutorState(
        mode="fault",
        strategy="emulator",
        goal_id="goal-1",
        problem=_PROBLEM,
        scene_changed=True,
        guarded=True,
        speed_scale=0.5,
        missed_ticks=2,
    ),
    _EMULATOR,
    m.Strategies(active="emulator", strategies=(_EMULATOR,)),
    m.StrategyRequest(strategy="joint_speed"),
    m.SpeedRequest(speed_scale=0.25),
    m.Speed(speed_scale=0.25),
    m.StreamChunk(
        goal_id="follow.1", sequence=2, start=0.4, trajectory=_TRAJECTORY, deadline=0.2, last=True, begin_at=1.25
    ),
    # servo
    m.Authority(
        servo="0a1b2c3d",
        sequence=7,
        goal_id="goal-1",
        trajectory=3,
        scene_revision=_REVISION,
        until=0.9,
        obstruction=_OBSTRUCTION,
    ),
    m.ObjectPose(
        stamp=1.75e9,
        position=(0.4, 0.1, 0.3),
        orientation=(0.0, 0.0, 1.0, 0.0),
        linear=(0.2, 0.0, 0.0),
        angular=(0.0, 0.0, 0.5),
        speed=0.1,
    ),
    m.Authority(servo="0a1b2c3d", sequence=8, scene_revision=_REVISION),
    m.ServoState(
        activity="guarding",
        goal_id="goal-1",
        scene_revision=_REVISION,
        scene_lost=True,
        until=0.9,
        obstruction=_OBSTRUCTION,
        problem=_PROBLEM,
        check=0.0008,
        lost_objects=("cart",),
        pose_refused=_PROBLEM,
        collision_detection="on",
    ),
    m.ExternalTorque(
        stamp=1.75e9,
        joint_names=("elbow", "shoulder"),
        torque=(0.4, -31.0),
        largest=(2.5, 31.0),
        goal_id="goal-1",
        joint="shoulder",
    ),
    m.JointDynamics(
        joint_names=("elbow", "shoulder"),
        friction=(3.0, 0.6),
        damping=(2.5, 0.5),
        armature=(0.38, 0.07),
        largest=(0.7, 0.2),
        states=30_000,
    ),
    m.ServoStart(goal_id="jog-1", take_over=True, margin=0.02, velocity_scale=0.5, acceleration_scale=0.25),
    m.ServoEnd(goal_id="jog-1"),
    *_TARGETS,
    *(m.ServoTarget(goal_id="jog-1", sequence=3, stamp=1.75e9, target=target) for target in _TARGETS),
    _SESSION,
    m.ServoChunk(
        goal_id="policy-1",
        sequence=4,
        stamp=1.75e9,
        start=1.75e9,
        observed=1.75e9,
        expiry=0.4,
        dt=0.1,
        points=_JOINT_POINTS,
        gripper="hand",
        opening=(0.04, 0.02),
    ),
    m.ServoChunk(
        goal_id="policy-1",
        sequence=5,
        stamp=1.75e9,
        time=(0.0, 0.25),
        points=_POSE_POINTS,
    ),
    _JOINT_POINTS,
    _POSE_POINTS,
    _CLIPPED,
    m.ChunkAccepted(
        late=0.02,
        lost=1,
        jump=0.01,
        clipped=(_CLIPPED,),
        observation_age=0.15,
        limiting="slowing",
        link="link_3",
        object="post",
        distance=0.05,
        lag=0.004,
    ),
    m.ServoState(activity="following", goal_id="jog-1", scene_revision=_REVISION, session=_SESSION),
    # agent
    m.AgentCall(stamp=1.75e9, tool="execute", arguments='{"plan_id": "plan-1"}', outcome="done"),
    m.AgentQuestion(question="3f2a", tool="execute", text="The agent wants to execute plan-1."),
    m.AgentAnswer(question="3f2a", approve=True),
    # driver
    m.DriverCommand(
        sequence=7,
        joint_names=("elbow", "shoulder"),
        based_on=1.75e9,
        expires_after=0.1001,
        time=(0.0, 0.02),
        position=((-0.2, 0.1), (-0.21, 0.106)),
        velocity=((-0.5, 0.3), (-0.5, 0.3)),
        acceleration=((-0.125, 0.25), (0.0, 0.0)),
    ),
    m.DriverCommand(
        sequence=8,
        joint_names=("elbow", "shoulder"),
        based_on=1.75e9,
        expires_after=0.1001,
        time=(0.0,),
        position=((-0.2, 0.1),),
    ),
    m.DriverCommand(sequence=9, joint_names=("elbow", "shoulder")),
    m.DriverSpeed(scale=0.4),
    m.GripperRequest(gripper="hand", width=0.04, force=20.0, speed=0.05, preempt=True, goal_id="grip-1"),
    m.GripperRequest(position=0.02),
    m.GripperCancel(gripper="hand"),
    _GRIP,
    _PLANNED_GRIP,
    m.GripperOpening(gripper="hand", width=0.04),
    m.GripperState(
        gripper="hand",
        status="aborted",
        widths=(0.0, 0.08),
        touch_links=("left_finger", "right_finger", "hand"),
        width=0.03,
        position=0.015,
        goal_id="grip-1",
        target=0.0,
        problem=_PROBLEM,
    ),
    m.DriverGripperCommand(gripper="hand", sequence=7, position=0.02, speed=0.05, force=20.0),
    m.DriverGripperState(
        gripper="hand", position=0.02, sequence=7, reached=True, stalled=True, problem="the gripper has no power"
    ),
    _OUTPUT,
    m.OutputState(output="vacuum", on=True, problem=_PROBLEM),
    m.SetOutput(kind="set_output", output="vacuum", on=True, name="hold"),
    m.DriverOutputCommand(output="vacuum", sequence=7, on=True),
    m.DriverOutputState(output="vacuum", sequence=7, problem="the valve has no power"),
    m.DriverProgress(sequence=7, fraction=0.5, problem="the controller is inactive"),
    m.DriverFault(
        stall=True,
        drop=0.5,
        delay=0.2,
        silent=True,
        die=True,
        jump=(0.1, -0.2),
        obstacle=0.03,
        output="vacuum",
        push=(0.0, 0.0, -50.0),
    ),
    # physics
    m.BodyPose(name="cube", position=(0.5, 0.0, 0.02), orientation=(0.0, 0.0, 0.0, 1.0)),
    m.Contact(first="panda_leftfinger", second="cube", position=(0.5, 0.02, 0.02), force=12.5, normal=(0.0, -1.0, 0.0)),
    _CAMERA,
    m.Cameras(cameras=(_CAMERA,)),
    m.CameraChange(add=_CAMERA),
    m.CameraChange(remove="wrist"),
    m.ImageHeader(stamp=1.75e9, width=640, height=480, encoding="16UC1"),
    m.CloudHeader(stamp=1.75e9, points=65536),
    m.ColorHeader(stamp=1.75e9, width=640, height=480, encoding="rgb8"),
    m.SavedMap(lower=(-1.0, -1.0, -0.25), resolution=0.02, shape=(2, 1, 1), states="eJxjAAAAAwAC"),
    m.LoadedMap(occupied=4921, outside=12),
    m.VoxelBlock(position=(-0.99, -0.99, -0.24), resolution=0.02, cells="gA" + "A" * 681 + "="),
    m.CameraState(name="wrist", images=12, age=0.05, took=0.008, valid=0.75, robot=0.125, problem="no images"),
    m.PerceptionState(
        cameras=(m.CameraState(name="wrist"),),
        lower=(-1.0, -1.0, -0.25),
        upper=(1.0, 1.0, 1.25),
        resolution=0.02,
        padding=0.03,
        unseen="occupied",
        occupied=4921,
        stale=True,
        stamp=1.75e9,
    ),
    m.DynamicObject(name="block", mass=0.2, friction=0.8),
    m.Conveyor(name="belt", speed=-0.1),
    m.MovingObjects(names=("visitor",), path=((0.0, 0.0, 0.0), (-1.5, 0.0, 0.0)), speed=0.8, once=True),
    m.LoadWorld(
        objects=(_CUBOID,),
        floor=-0.75,
        dynamic=(m.DynamicObject(name=_CUBOID.name, mass=0.2),),
        conveyors=(m.Conveyor(name="belt", speed=0.1),),
        moving=(m.MovingObjects(names=("visitor",), path=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), speed=0.5),),
        textures=(_TEXTURE,),
        add=True,
    ),
    _TEXTURE,
    m.PhysicsObjects(objects=(_CUBOID,)),
    m.PhysicsState(
        stamp=1700000000.25,
        time=12.5,
        real_time_factor=1.0,
        position=(0.1, -0.2),
        velocity=(0.0, 0.5),
        effort=(12.0, -3.5),
        bodies=(m.BodyPose(name="cube", position=(0.5, 0.0, 0.02), orientation=(0.0, 0.0, 0.0, 1.0)),),
        contacts=(
            m.Contact(first="floor", second="cube", position=(0.5, 0.0, 0.0), force=1.96, normal=(1.0, 0.0, 0.0)),
        ),
    ),
    # every service
    m.Nothing(),
    m.Requester(client="93ba8b5e23a74bca83fc0b3d1f94feb6", timeout=6.5),
    m.Health(
        service="planner",
        robot="arm_2",
        instance="0a1b2c3d",
        ready=False,
        activity="compiling kernels",
        version="0.1.0",
        contract="v4",
        robot_hash="0123456789abcdef",
        uptime=1.5,
        pid=4242,
        note="curobo_msgs of generation B",
    ),
)


def golden_text(examples: tuple[Message, ...]) -> str:
    """The content of a golden file: the payloads of one class's examples, formatted for diffs."""
    return json.dumps([json.loads(encode(example)) for example in examples], indent=2) + "\n"


def by_class() -> dict[type[Message], tuple[Message, ...]]:
    """The examples, class by class."""
    ordered = sorted(EXAMPLES, key=lambda example: type(example).__name__)
    return {cls: tuple(group) for cls, group in groupby(ordered, key=type)}


if __name__ == "__main__":
    for file in GOLDEN.glob("*.json"):
        file.unlink()
    for cls, examples in by_class().items():
        (GOLDEN / f"{cls.__name__}.json").write_text(golden_text(examples))
