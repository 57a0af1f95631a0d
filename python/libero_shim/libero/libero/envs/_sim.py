"""The simulation in the form of robosuite's `env.sim`: state, names, arrays, pictures."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from libero._absent import absent_attribute
from libero.libero.envs._simulation import SimulationHandle

F64 = NDArray[np.float64]

_KINDS = ("body", "joint", "geom", "site", "camera", "light", "actuator", "sensor")
#: MuJoCo's counts, each with an array that has this number of rows.
_COUNTS = {
    "nq": "qpos0", "nv": "dof_bodyid", "nu": "actuator_trntype", "nbody": "body_parentid",
    "njnt": "jnt_type", "ngeom": "geom_type", "nsite": "site_bodyid", "ncam": "cam_fovy",
    "nlight": "light_pos", "nsensor": "sensor_type",
}  # fmt: skip
#: Numbers of positions and of velocities of a joint, by MuJoCo's joint type.
_COORDINATES = {0: (7, 6), 1: (4, 3), 2: (1, 1), 3: (1, 1)}


class ReadOnlyArray(np.ndarray):
    """A copy of an array of the simulation. Writing raises, because it would not change the
    simulation."""

    _remedy = ""

    def __array_finalize__(self, parent: Any) -> None:
        self._remedy = getattr(parent, "_remedy", "")

    def __setitem__(self, key: Any, value: Any) -> None:
        if not self.flags.writeable:
            raise ValueError(
                "this is a copy of the simulation's array, which cannot be written to: "
                f"{self._remedy}"
            )
        super().__setitem__(key, value)


def _read_only(array: NDArray[Any], remedy: str) -> ReadOnlyArray:
    view = array.view(ReadOnlyArray)
    view._remedy = remedy
    view.flags.writeable = False
    return view


class MjSimState:
    """Time, s, and positions and velocities of all joints."""

    def __init__(self, time: float, qpos: F64, qvel: F64) -> None:
        self.time = time
        self.qpos = qpos
        self.qvel = qvel

    def flatten(self) -> F64:
        """Time, positions and velocities in one vector [1 + nq + nv]."""
        return np.concatenate([[self.time], self.qpos, self.qvel])


class _Constants:
    """Scalar values of the model."""

    def __init__(self, label: str, values: dict[str, Any]) -> None:
        self._label = label
        self._values = values

    def __getattr__(self, name: str) -> Any:
        try:
            return self._values[name]
        except KeyError:
            raise absent_attribute(self._label, name, f"it has {', '.join(self._values)}") from None


class MjModel:
    """The model's names and arrays, by MuJoCo's names. Arrays are copies."""

    def __init__(self, handle: SimulationHandle) -> None:
        simulation = handle.get()
        self._handle = handle
        self._names = {kind: tuple(simulation.names(kind)) for kind in _KINDS}
        self._ids = {
            kind: {name: i for i, name in enumerate(names) if name is not None}
            for kind, names in self._names.items()
        }
        # Addresses and types of the joints are read once: every reset needs them, and they never
        # change.
        arrays = ("jnt_qposadr", "jnt_dofadr", "jnt_type")
        columns = (simulation.model_array(array) for array in arrays)
        self._joints = list(zip(*(column.tolist() for column in columns)))

    def set(self, name: str, values: Any) -> None:
        """Writes one of cam_pos, cam_quat, light_pos, light_dir, light_diffuse,
        light_specular, site_rgba, body_pos and body_quat, in this environment alone.
        Call `sim.forward()` after changes of bodies."""
        self._handle.get().set_model_array(name, np.asarray(values))

    def get_joint_qpos_addr(self, name: str) -> Any:
        """The index of a joint's position, or (first, last + 1) if it has several."""
        return self._address(name, 0)

    def get_joint_qvel_addr(self, name: str) -> Any:
        """The index of a joint's velocity, or (first, last + 1) if it has several."""
        return self._address(name, 1)

    def __getattr__(self, name: str) -> Any:
        kind, _, suffix = name.partition("_")
        kind = "camera" if kind == "cam" and suffix in ("names",) else kind
        if kind in _KINDS and suffix == "names":
            return self._names[kind]
        if kind in _KINDS and suffix == "name2id":
            return lambda key: self._id(kind, key)
        if kind in _KINDS and suffix == "id2name":
            return lambda i: self._name(kind, i)
        if name in _COUNTS:
            return len(self._handle.get().model_array(_COUNTS[name]))
        if name in ("stat", "vis"):
            return _Constants(f"sim.model.{name}", self._constants()[name])
        if name.startswith("_"):
            raise absent_attribute("sim.model", name, "MuJoCo's own objects are not shown")
        return self._array(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in ("_handle", "_names", "_ids", "_joints"):
            super().__setattr__(name, value)
        else:
            raise AttributeError(
                f"sim.model.{name} cannot be assigned to: call sim.model.set({name!r}, values)"
            )

    def _constants(self) -> dict[str, Any]:
        extent, near, far = self._handle.get().planes()
        planes = _Constants("sim.model.vis.map", {"znear": near, "zfar": far})
        return {"stat": {"extent": extent}, "vis": {"map": planes}}

    def _array(self, name: str) -> ReadOnlyArray:
        try:
            array = self._handle.get().model_array(name)
        except (KeyError, ValueError) as error:
            raise absent_attribute("sim.model", name, str(error)) from error
        return _read_only(array, f"call sim.model.set({name!r}, values)")

    def _id(self, kind: str, name: str) -> int:
        try:
            return self._ids[kind][name]
        except KeyError:
            raise ValueError(
                f"the model has no {kind} `{name}`: it has {', '.join(self._ids[kind])}"
            ) from None

    def _name(self, kind: str, i: int) -> str | None:
        names = self._names[kind]
        if not 0 <= i < len(names):
            raise ValueError(f"the model has no {kind} {i}: it has {len(names)}")
        return names[i]

    def _address(self, joint: str, quantity: int) -> Any:
        """Returns the index or range of a joint's position (`quantity` 0) or velocity (1)."""
        *starts, kind = self._joints[self._id("joint", joint)]
        start, width = starts[quantity], _COORDINATES[kind][quantity]
        return start if width == 1 else (start, start + width)


class MjData:
    """The state's arrays, by MuJoCo's names, in the world frame, m and rad. They are copies of the
    current values; observations are a few milliseconds older."""

    def __init__(self, handle: SimulationHandle, model: MjModel) -> None:
        self._handle = handle
        self._model = model

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self._handle.get().state()[0])

    @property
    def ncon(self) -> int:
        return len(self._handle.get().contacts())

    @property
    def contact(self) -> list[Any]:
        """The contacts: geom1 and geom2 of each."""
        return [
            SimpleNamespace(geom1=int(first), geom2=int(second))
            for first, second in self._handle.get().contacts()
        ]

    def get_joint_qpos(self, name: str) -> Any:
        """A joint's position, or positions."""
        return self.qpos[_slice(self._model.get_joint_qpos_addr(name))]

    def get_joint_qvel(self, name: str) -> Any:
        """A joint's velocity, or velocities."""
        return self.qvel[_slice(self._model.get_joint_qvel_addr(name))]

    def set_joint_qpos(self, name: str, value: Any) -> None:
        """Sets a joint's position, or positions. Call `sim.forward()` after the last change."""
        self._write(1, self._model.get_joint_qpos_addr(name), value)

    def set_joint_qvel(self, name: str, value: Any) -> None:
        """Sets a joint's velocity, or velocities. Call `sim.forward()` after the last change."""
        self._write(1 + self._model.nq, self._model.get_joint_qvel_addr(name), value)

    def __getattr__(self, name: str) -> Any:
        # Such as get_body_xpos, get_site_xmat, get_geom_xpos and get_camera_xmat.
        parts = name.split("_")
        if len(parts) == 3 and parts[0] == "get" and parts[2] in ("xpos", "xmat", "xquat"):
            kind, quantity = parts[1:]
            prefix = {"body": "", "camera": "cam_"}.get(kind, f"{kind}_")
            return lambda key: self._pose(f"{prefix}{quantity}", kind, key)
        # mujoco-py's names of the bodies' arrays.
        if name in ("body_xpos", "body_xquat", "body_xmat"):
            name = name.removeprefix("body_")
        try:
            array = self._handle.get().data_array(name)
        except (KeyError, ValueError) as error:
            raise absent_attribute("sim.data", name, str(error)) from error
        return _read_only(
            array,
            "write with sim.data.set_joint_qpos, sim.set_state or sim.set_state_from_flattened",
        )

    def __setattr__(self, name: str, value: Any) -> None:
        if name in ("_handle", "_model"):
            super().__setattr__(name, value)
        else:
            raise AttributeError(
                f"sim.data.{name} cannot be assigned to: write with sim.set_state_from_flattened"
            )

    def _pose(self, array: str, kind: str, key: str) -> Any:
        value = getattr(self, array)[getattr(self._model, f"{kind}_name2id")(key)]
        return value.reshape(3, 3) if array.endswith("xmat") else value

    def _write(self, offset: int, address: Any, value: Any) -> None:
        simulation = self._handle.get()
        state = np.array(simulation.state())
        part = _slice(address)
        if isinstance(part, slice):
            part = slice(part.start + offset, part.stop + offset)
            value = np.asarray(value, dtype=np.float64)
            if value.shape != (part.stop - part.start,):
                raise ValueError(
                    f"the joint has {part.stop - part.start} coordinates, and an array of shape "
                    f"{value.shape} was given"
                )
        else:
            part += offset
        state[part] = value
        simulation.set_state(state)


class MjSim:
    """A simulation: `model`, `data`, its state as a vector, and pictures of it."""

    def __init__(self, handle: SimulationHandle) -> None:
        self._handle = handle
        self.model = MjModel(handle)
        self.data = MjData(handle, self.model)

    def get_state(self) -> MjSimState:
        state = self._handle.get().state()
        nq = self.model.nq
        return MjSimState(float(state[0]), state[1 : 1 + nq], state[1 + nq :])

    def set_state(self, value: MjSimState) -> None:
        """Writes a state. Call `forward` before reading values derived from it."""
        self.set_state_from_flattened(value.flatten())

    def set_state_from_flattened(self, value: Any) -> None:
        """Writes a state [1 + nq + nv]. Call `forward` before reading values derived from it.
        Raises ValueError for a state of another scene."""
        simulation = self._handle.get()
        state = np.ascontiguousarray(value, dtype=np.float64)
        expected = simulation.state().shape
        if state.shape != expected:
            raise ValueError(
                f"the scene's states have the shape {expected}, not {state.shape}: give a "
                "state of this task, as get_sim_state or get_task_init_states returns it"
            )
        simulation.set_state(state)

    def forward(self) -> None:
        """Computes the quantities derived from the state, such as poses and contacts."""
        self._handle.get().forward()

    def render(
        self,
        width: int,
        height: int,
        *,
        camera_name: str,
        depth: bool = False,
        mode: str = "offscreen",
        device_id: int = -1,
        segmentation: bool = False,
    ) -> Any:
        """Returns a picture of the current state, row 0 at the bottom: [height, width, 3] bytes.
        With `depth`, also returns the depth buffer [height, width], float32 in 0…1. With
        `segmentation`, returns instead [height, width, 2] int32: MuJoCo's object type and id, -1
        for the background."""
        if mode != "offscreen":
            raise ValueError("there is no window: leave mode at 'offscreen'")
        self.model.camera_name2id(camera_name)
        simulation = self._handle.get()
        # A simulation draws its last observation, so it must observe the current state first. This
        # would shift the times of later observations, so a snapshot is restored afterwards.
        snapshot = simulation.snapshot()
        simulation.observe_now()
        try:
            if segmentation:
                return simulation.segmentation(camera_name, width, height)
            picture = simulation.frame(camera_name, width, height)
            if depth:
                return picture, simulation.depth(camera_name, width, height)
            return picture
        finally:
            simulation.restore(snapshot)

    def __getattr__(self, name: str) -> Any:
        raise absent_attribute(
            "sim",
            name,
            "it has get_state, set_state, set_state_from_flattened, forward, "
            "render, model and data; simulate with the environment's step",
        )


def _slice(address: Any) -> Any:
    return slice(*address) if isinstance(address, tuple) else address
