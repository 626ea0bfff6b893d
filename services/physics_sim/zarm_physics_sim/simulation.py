"""The simulated world: a robot with mass among things, in steps of 1 ms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from zarm_contract.gripper import Gripper
from zarm_contract.messages import Attached, Quaternion, Vector3
from zarm_contract.robot import RobotDescription
from zarm_geometry.inertia import stances, stated_limits, usable_inertials
from zarm_physics_sim.looks import looks_of
from zarm_physics_sim.robot_body import LINK, UNSEEN, add_mass, add_robot, link_body, payload_name
from zarm_physics_sim.shapes import wxyz
from zarm_physics_sim.world import World, add_object, body_name, is_object, object_name
from zarm_trajectory.arrays import Array

STEP = 0.001
"""Time step, s."""
_STIFF = (4.0 * STEP, 1.0)
"""Time constant (s) and damping of contacts: hard, so that light fingers do not sink into what they hold."""
_ACCELERATION = 400.0
"""The acceleration (rad/s²) of a motor with its gear alone, by the largest torque: so much inertia has its rotor."""
_VISIBLE = np.array([group < UNSEEN for group in range(mujoco.mjNGROUP)], dtype=np.uint8)
"""The groups of geoms that are seen."""
_MORE_GEOMS = 100
"""What a renderer may draw besides the bodies."""
_FINGER_ARMATURE = 0.05
"""The same of grippers, as the mass that the opening has (kg)."""


@dataclass(frozen=True)
class Contact:
    """Two bodies that touch at `position` (3,), with this force (N) along the `normal` (3,) from the first to the second."""

    first: str
    second: str
    position: Array
    force: float
    normal: Array


@dataclass(frozen=True)
class Finger:
    """A joint of a gripper, which follows the gripper's driven joint with `multiplier` and `offset`."""

    joint: str
    multiplier: float
    offset: float
    gripper: Gripper

    def at(self, position: float) -> float:
        """Where the joint is with the driven one at `position`."""
        return self.multiplier * position + self.offset

    def stiffness(self, robot: RobotDescription) -> float:
        """The stiffness of the joint if that of the opening is 1, and all joints of the gripper have their share of it."""
        return 1.0 / (self.gripper.joint_speed**2 * self._joints(robot))

    def force(self, robot: RobotDescription) -> float:
        """The force or torque on the joint, with that on the fingers 1: with all joints they do the same work."""
        return abs(self.multiplier) / (self.gripper.joint_speed * self._joints(robot))

    def _joints(self, robot: RobotDescription) -> float:
        return sum(multiplier**2 for multiplier, _ in self.gripper.joints(robot.urdf).values())


class Simulation:
    """The robot at `position` (J,), in the descriptor's order, in a world. `faults` say what of the URDF is not used as stated, and
    `assumed` are the links whose inertia is that of their geometry.

    `limit` (J,) are the largest torques (Nm, N), infinite where the URDF's effort cannot hold the arm; `largest` (J,) are
    assumptions there. Links without a stated inertia get `density` (kg/m³). `carried` are objects that are attached to a link; one that is also in the world is
    welded to it.
    """

    def __init__(
        self,
        robot: RobotDescription,
        world: World,
        position: Array,
        *,
        density: float = 1000.0,
        carried: Sequence[Attached] = (),
    ) -> None:
        self.robot, self.world, self._density, self._carried = robot, world, density, tuple(carried)
        self._welds: list[Attached] = []
        self._loaded = 0.0
        inertials, self.faults = usable_inertials(robot)
        self.assumed = [link for link in robot.descriptor.collision if link not in inertials and _moves(robot, link)]
        spec = mujoco.MjSpec()
        spec.compiler.degree, spec.compiler.autolimits = False, False
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # what is held slides less
        spec.option.impratio = 10.0
        add_robot(spec, robot, inertials, density, looks_of(robot.urdf_path))
        world.add_to(spec)
        # A tool's mass is that of one of its shapes.
        self._weighed = {item.tool for item in carried if item.tool is not None and item.mass is not None}
        for item in carried:
            self._carry(spec, item)
        self._model = spec.compile()
        self._model.geom_solref[:] = self._model.eq_solref[:] = _STIFF
        self._data = mujoco.MjData(self._model)
        walking = [name for walk in world.walks for name in walk.names]
        self._mocap = {name: self._model.body(body_name(name)).mocapid[0] for name in walking}
        self._places = {name: np.array(world.objects[name].position) for name in walking}
        self._tip = self._model.body(link_body(robot.descriptor.tip_link)).id
        self._joints = _Joints.of(self._model, robot.descriptor.joints)
        self._square = np.ix_(self._joints.speeds, self._joints.speeds)
        grippers = robot.descriptor.grippers.values()
        self.fingers = tuple(
            Finger(name, *follows, gripper)
            for gripper in grippers
            for name, follows in gripper.joints(robot.urdf).items()
        )
        self._fingers = _Joints.of(self._model, [finger.joint for finger in self.fingers])
        self._data.qpos[self._fingers.positions] = [finger.at(finger.gripper.positions[-1]) for finger in self.fingers]
        self._model.dof_armature[self._fingers.speeds] = [
            _FINGER_ARMATURE * finger.stiffness(robot) for finger in self.fingers
        ]
        payloads = [self._model.body(payload_name(link)).id for link in robot.descriptor.payloads]
        masses = self._model.body_mass[payloads]
        self._model.body_mass[payloads] = 0.0  # efforts have to bear the arm alone
        holding = np.array([self._held_at(stance) for stance in stances(robot)])
        self._model.body_mass[payloads] = masses
        self.limit = stated_limits(robot, holding)
        self.largest: Array = np.where(np.isfinite(self.limit), self.limit, 2.0 * holding.max(axis=0) + 10.0)
        self._model.dof_armature[self._joints.speeds] = self.largest / _ACCELERATION
        self.place(position)

    def _held_at(self, position: Array) -> Array:
        """The torques (J,) that hold the arm at `position` (J,)."""
        self.place(position)
        return np.abs(self.bias)

    def _carry(self, spec: mujoco.MjSpec, item: Attached) -> None:
        link = item.link or self.robot.descriptor.tip_link
        if item.object.name in self.world.dynamic:
            self._welds.append(item)
            thing = body_name(item.object.name)
            kind, bodies = mujoco.mjtEq.mjEQ_WELD, mujoco.mjtObj.mjOBJ_BODY
            spec.add_equality(name=thing, type=kind, objtype=bodies, name1=link_body(link), name2=thing)
            return
        weightless = item.center is not None or item.tool in self._weighed
        body = add_object(
            spec.body(link_body(link)),
            item.object,
            None,
            0.0 if weightless else self._density,
            None if weightless else item.mass,
        )
        if item.mass is not None and item.center is not None:
            add_mass(body, payload_name(body.name), item.mass, item.center)
        for touched in {link, *item.touch_links}:
            spec.add_exclude(bodyname1=link_body(touched), bodyname2=body.name)

    def _gripped(self, item: Attached) -> bool:
        """Whether an attached object is between the fingers of a gripper, which hold it by friction."""
        return any(
            not {*gripper.pads}.isdisjoint(item.touch_links) for gripper in self.robot.descriptor.grippers.values()
        )

    def in_world(self, world: World, carried: Sequence[Attached]) -> Simulation:
        """This robot in another world, to be used after `go_on_from`; itself if it is in that world already."""
        # Between the fingers is what the world has there, whatever the scene calls it.
        carried = tuple(item for item in carried if world.believed or not self._gripped(item))
        if world is self.world and carried == self._carried:
            return self
        return Simulation(self.robot, world, self.position, density=self._density, carried=carried)

    def go_on_from(self, before: Simulation) -> None:
        """Take over where everything is, and how it moves, from another simulation of the robot."""
        old, new = before._model, self._model
        self._loaded = before._loaded if self.world.walks is before.world.walks else before.time
        for k in range(new.njnt):
            name = new.joint(k).name
            if is_object(name) and not self._stays(object_name(name), before):
                continue
            j = mujoco.mj_name2id(old, mujoco.mjtObj.mjOBJ_JOINT, name)
            if j >= 0 and old.jnt_type[j] == new.jnt_type[k]:
                self._data.joint(name).qpos[:] = before._data.joint(name).qpos
                self._data.joint(name).qvel[:] = before._data.joint(name).qvel
        self._data.time = before._data.time
        self._model.dof_frictionloss[self._joints.speeds] = old.dof_frictionloss[before._joints.speeds]
        self._model.dof_damping[self._joints.speeds] = old.dof_damping[before._joints.speeds]
        mujoco.mj_forward(new, self._data)
        for item in self._welds:
            self._weld(item)

    def _stays(self, name: str, before: Simulation) -> bool:
        """Whether a thing is that of the world before; another one begins as it is described."""
        return self.world.objects[name] is before.world.objects.get(name)

    def _weld(self, item: Attached) -> None:
        """Hold a thing where it is in the frame of its link."""
        link, thing = (
            self._data.body(link_body(item.link or self.robot.descriptor.tip_link)),
            self._data.body(body_name(item.object.name)),
        )
        back, turn, place = np.zeros(4), np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(back, link.xquat)
        mujoco.mju_rotVecQuat(place, thing.xpos - link.xpos, back)
        mujoco.mju_mulQuat(turn, back, thing.xquat)
        self._model.equality(body_name(item.object.name)).data[:11] = [0.0, 0.0, 0.0, *place, *turn, 1.0]

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self._data.time)

    @property
    def position(self) -> Array:
        """True joint positions (J,)."""
        return np.array(self._data.qpos[self._joints.positions])

    @property
    def velocity(self) -> Array:
        """True joint velocities (J,)."""
        return np.array(self._data.qvel[self._joints.speeds])

    @property
    def mass(self) -> Array:
        """The mass matrix (J, J) of the arm, kg m²."""
        whole = np.zeros((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, self._data, whole)
        return whole[self._square]

    @property
    def bias(self) -> Array:
        """The torques (J,) of gravity and speed."""
        return np.array(self._data.qfrc_bias[self._joints.speeds])

    @property
    def torque(self) -> Array:
        """The torques (J,) of the drives."""
        return np.array(self._data.qfrc_applied[self._joints.speeds])

    @property
    def finger_position(self) -> Array:
        """Where the joints of the `fingers` are (F,)."""
        return np.array(self._data.qpos[self._fingers.positions])

    @property
    def finger_velocity(self) -> Array:
        """How fast the joints of the `fingers` move (F,)."""
        return np.array(self._data.qvel[self._fingers.speeds])

    def set_friction(self, dry: Array, viscous: Array) -> None:
        """Friction of the joints: dry (J,), Nm, and per speed (J,), Nm s."""
        self._model.dof_frictionloss[self._joints.speeds] = dry
        self._model.dof_damping[self._joints.speeds] = viscous

    def place(self, position: Array) -> None:
        """Put the arm at rest at `position` (J,)."""
        self._data.qpos[self._joints.positions] = position
        self._data.qvel[self._joints.speeds] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def step(self, torque: Array, finger_force: Array, push: Vector3 | None = None) -> None:
        """Let `STEP` seconds pass with these torques (J,) on the joints, and these (F,) on those of the `fingers`; `push` (N, base
        frame) acts on the tip.
        """
        self._data.qfrc_applied[self._joints.speeds] = torque
        if self.fingers:
            self._data.qfrc_applied[self._fingers.speeds] = finger_force
        for walk in self.world.walks:
            moved = walk.at(self.time - self._loaded)
            for name in walk.names:
                self._data.mocap_pos[self._mocap[name]] = self._places[name] + moved
        self._data.xfrc_applied[self._tip] = 0.0 if push is None else self._wrench(push)
        mujoco.mj_step(self._model, self._data)

    def _wrench(self, force: Vector3) -> Array:
        """A force on the tip as force and torque (6,) on the centre of mass of its body."""
        arm = self._data.xpos[self._tip] - self._data.xipos[self._tip]
        return np.concatenate([force, np.cross(arm, force)])

    def snapshot(self) -> Any:
        """A copy of the state, for `frame` and `renderer`."""
        data = mujoco.MjData(self._model)
        data.qpos[:], data.mocap_pos[:] = self._data.qpos, self._data.mocap_pos
        mujoco.mj_kinematics(self._model, data)
        return data

    def renderer(self, width: int, height: int, near: float, far: float) -> Any:
        """A renderer of images (height, width), to be used in one thread; what is nearer or farther (m) is not seen.

        There are no shadows: memory for these would keep all other threads waiting while it is made, for 70 ms.
        """
        self._model.vis.quality.shadowsize = 0
        self._model.vis.map.znear, self._model.vis.map.zfar = (each / self._model.stat.extent for each in (near, far))
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = max(width, 640), max(height, 480)
        return mujoco.Renderer(self._model, height, width, max_geom=self._model.ngeom + _MORE_GEOMS)

    def frame(self, data: Any, link: str | None, position: Vector3, orientation: Quaternion) -> tuple[Array, Array]:
        """Where a frame on a link, by default the base, is in the state `data`: its origin (3,) and its axes (3, 3)."""
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.array(wxyz(orientation)))
        if link is None or link == self.robot.descriptor.base_link:
            return np.array(position), turn.reshape(3, 3)
        body = data.body(link_body(link))
        carried = body.xmat.reshape(3, 3)
        return np.asarray(body.xpos + carried @ position), np.asarray(carried @ turn.reshape(3, 3))

    def cast(self, data: Any, place: Array, rays: Array, cutoff: float) -> Array:
        """How far (n,) in m each of the `rays` (n, 3), unit vectors, gets from `place` (3,) in the state `data`: -1 where it meets nothing up to `cutoff`."""
        distances, met = np.full(len(rays), -1.0), np.full(len(rays), -1, np.int32)
        mujoco.mj_multiRay(
            self._model, data, place, rays.ravel(), _VISIBLE, True, -1, met, distances, None, len(rays), cutoff
        )
        return distances

    def contacts(self) -> Iterator[Contact]:
        """Links, objects and the floor that press on each other."""
        force = np.zeros(6)
        for k in range(self._data.ncon):
            contact = self._data.contact[k]
            mujoco.mj_contactForce(self._model, self._data, k, force)
            if force[0] > 0.0:
                yield Contact(
                    self._name(contact.geom1),
                    self._name(contact.geom2),
                    np.array(contact.pos),
                    float(force[0]),
                    np.array(contact.frame[:3]),
                )

    def poses(self) -> Mapping[str, tuple[Array, Array]]:
        """Position (3,) and orientation `[x, y, z, w]` of everything in the world that moves."""
        found = {}
        for name in self.world.dynamic:
            x, y, z, w, *turn = self._data.joint(body_name(name)).qpos
            found[name] = (np.array([x, y, z]), np.array([*turn, w]))
        for name, k in self._mocap.items():
            w, *turn = self._data.mocap_quat[k]
            found[name] = (np.array(self._data.mocap_pos[k]), np.array([*turn, w]))
        return found

    def _name(self, geom: int) -> str:
        body = self._model.geom_bodyid[geom]
        return "floor" if body == 0 else object_name(self._model.body(body).name.removeprefix(LINK))


@dataclass(frozen=True)
class _Joints:
    """Indices of joints in the positions and the speeds of MuJoCo."""

    positions: NDArray[np.intp]
    speeds: NDArray[np.intp]

    @classmethod
    def of(cls, model: Any, names: Sequence[str]) -> _Joints:
        joints = [model.joint(name) for name in names]
        return cls(
            np.array([joint.qposadr[0] for joint in joints], dtype=np.intp),
            np.array([joint.dofadr[0] for joint in joints], dtype=np.intp),
        )


def _moves(robot: RobotDescription, link: str) -> bool:
    """Whether a joint moves the link."""
    return any(joint.type != "fixed" for joint in robot.urdf.chain(robot.descriptor.base_link, link))
