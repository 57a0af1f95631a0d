"""The robot and its controller, in robosuite's interface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from libero._absent import absent_attribute
from libero.libero.envs._rotations import quaternions_of
from libero.libero.envs._settings import OSC_POSE
from libero.libero.envs._sim import MjSim
from libero.libero.envs._simulation import SimulationHandle

F64 = NDArray[np.float64]

#: Joint positions of the arm's home posture, rad.
_HOME = (0.0, -0.161037389, 0.0, -2.44459747, 0.0, 2.2267522, np.pi / 4)
_DIMENSIONS = 6
_GRIP_SITE = "gripper0_grip_site"
_CONSTANTS = ("kp", "input_min", "input_max", "output_min", "output_max")


class Controller:
    """LIBERO's operational-space controller of the end-effector's pose.

    With `use_delta`, an action's first six numbers are relative, in units of 0.05 m and 0.5 rad;
    otherwise they are a position, m, and a rotation vector, rad, in the world frame. Each reset
    makes a new controller, with the `use_delta` of the environment's constructor."""

    name = "OSC_POSE"
    control_dim = _DIMENSIONS
    control_freq = 20
    use_ori = True
    impedance_mode = "fixed"
    uncoupling = True
    position_limits = None
    orientation_limits = None
    eef_name = _GRIP_SITE

    use_delta: bool

    def __init__(self, handle: SimulationHandle, use_delta: bool, posture: F64) -> None:
        # Stiffness, 1/s², damping, 1/s, range of an action, and its displacements, m and rad.
        constants = {name: _six(OSC_POSE[name]) for name in _CONSTANTS}
        damping = 2 * np.sqrt(constants["kp"]) * OSC_POSE["damping_ratio"]
        limits = constants["input_min"], constants["input_max"]
        vars(self).update(constants, kd=damping, control_limits=limits)
        vars(self).update(_handle=handle, _posture=posture)
        self.use_delta = use_delta

    @property
    def ee_pos(self) -> F64:
        """The end-effector's position [3], m, at the controller's last update."""
        return self._handle.get().controller_pose()[0]

    @property
    def ee_ori_mat(self) -> F64:
        """The end-effector's rotation matrix [3, 3] at the controller's last update."""
        return self._handle.get().controller_pose()[1]

    @property
    def initial_joint(self) -> F64:
        """The posture [7], rad, that the controller prefers among those with the hand's pose."""
        return self._posture.copy()

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute("the controller", name, "it has use_delta, ee_pos and ee_ori_mat")

    def __setattr__(self, name: str, value: Any) -> None:
        if name != "use_delta":
            raise AttributeError(
                f"the controller's {name} cannot be changed: its constants are LIBERO's; "
                "only use_delta can be set"
            )
        super().__setattr__(name, bool(value))


class Robot:
    dof = 8
    action_dim = _DIMENSIONS + 1
    has_gripper = True

    def __init__(
        self,
        name: str,
        handle: SimulationHandle,
        sim: MjSim,
        use_delta: bool,
        posture: F64 | None = None,
    ) -> None:
        """`posture` holds the arm's joint positions [7] at resets, rad; None selects LIBERO's."""
        self.name = name
        self.sim = sim
        self._posture = np.array(_HOME) if posture is None else posture
        self.controller = Controller(handle, use_delta, self._posture)
        joints = [f"robot0_joint{i}" for i in range(1, 8)]
        fingers = [f"gripper0_finger_joint{i}" for i in (1, 2)]
        self.robot_joints = joints
        self.gripper_joints = fingers
        self.joint_indexes = [sim.model.joint_name2id(joint) for joint in joints]
        self._ref_joint_pos_indexes = [sim.model.get_joint_qpos_addr(x) for x in joints]
        self._ref_joint_vel_indexes = [sim.model.get_joint_qvel_addr(x) for x in joints]
        self._ref_gripper_joint_pos_indexes = [sim.model.get_joint_qpos_addr(x) for x in fingers]
        self._ref_gripper_joint_vel_indexes = [sim.model.get_joint_qvel_addr(x) for x in fingers]
        self.eef_site_id = sim.model.site_name2id(_GRIP_SITE)

    @property
    def init_qpos(self) -> F64:
        """The arm's joint positions [7] at resets, rad."""
        return self._posture.copy()

    @property
    def base_pos(self) -> F64:
        """The base's position [3], m."""
        return self.sim.data.get_body_xpos("robot0_base")

    @property
    def base_ori(self) -> NDArray[np.float32]:
        """The base's orientation [4], x y z w."""
        return quaternions_of(self.sim.data.get_body_xmat("robot0_base")[np.newaxis])[0]

    @property
    def action_limits(self) -> tuple[F64, F64]:
        """Least and largest actions [7]."""
        return np.full(self.action_dim, -1.0), np.full(self.action_dim, 1.0)

    @property
    def torque_limits(self) -> tuple[F64, F64]:
        """Least and largest torques [7], Nm."""
        limits = self.sim.model.actuator_ctrlrange[: len(self.robot_joints)]
        return limits[:, 0], limits[:, 1]

    @property
    def _joint_positions(self) -> F64:
        return self.sim.data.qpos[self._ref_joint_pos_indexes]

    @property
    def _joint_velocities(self) -> F64:
        return self.sim.data.qvel[self._ref_joint_vel_indexes]

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            "the robot", name, "it has its controller, limits and joints; ask env.sim otherwise"
        )


def _six(value: Any) -> F64:
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (_DIMENSIONS,))
