"""Arguments of an environment's constructor: checks, with a remedy for each unsupported value."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: robosuite's OSC_POSE with LIBERO's constants.
OSC_POSE: dict[str, Any] = {
    "type": "OSC_POSE",
    "input_max": 1,
    "input_min": -1,
    "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5],
    "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5],
    "kp": 150,
    "damping_ratio": 1,
    "impedance_mode": "fixed",
    "position_limits": None,
    "orientation_limits": None,
    "uncouple_pos_ori": True,
    "interpolation": None,
}
_SEGMENTATIONS = ("instance", "class", "element")

#: Arguments of LIBERO's environments for which this package permits few values: the permitted
#: values, and the reason.
_ONE_VALUE: dict[str, tuple[tuple[Any, ...], str]] = {
    "gripper_types": (("default",), "the Panda has its own gripper"),
    "initialization_noise": ((None,), "the arm starts at home, as in LIBERO's evaluations"),
    "has_renderer": ((False,), "there is no window: show the frames of the observations"),
    "render_collision_mesh": ((False,), "frames show what LIBERO's cameras show"),
    "render_visual_mesh": ((True,), "frames show what LIBERO's cameras show"),
    "renderer": (("mujoco", "default"), "frames are drawn in software, as MuJoCo draws them"),
    "renderer_config": ((None,), "frames are drawn in software, as MuJoCo draws them"),
    "env_configuration": (("default",), "there is one robot"),
    "use_latch": ((False,), "LIBERO does not use it"),
    "use_object_obs": ((True,), "leave keys out by `modify_observable(name, 'active', False)`"),
    "placement_initializer": ((None,), "objects are placed as the BDDL file says"),
    "object_property_initializers": ((None,), "joints are placed as the BDDL file says"),
    "scene_xml": ((None,), "the room is the one that the BDDL file's problem has"),
    "scene_properties": ((None,), "the room is the one that the BDDL file's problem has"),
}
#: Arguments that have no effect here. Some of them have no effect in LIBERO either.
_IGNORED = ("reward_shaping", "render_camera", "render_gpu_device_id")


@dataclass(frozen=True)
class Camera:
    """A camera whose frames are observed. Sizes are in pixels."""

    name: str
    height: int
    width: int
    depth: bool
    segmentations: tuple[str, ...]


@dataclass(frozen=True)
class Settings:
    """Checked arguments of an environment's constructor."""

    cameras: tuple[Camera, ...]
    horizon: int
    ignore_done: bool
    hard_reset: bool
    reward_scale: float | None
    use_delta: bool
    has_offscreen_renderer: bool

    @classmethod
    def check(
        cls,
        *,
        robots: Any,
        controller_configs: Any = None,
        use_camera_obs: bool = True,
        has_offscreen_renderer: bool = True,
        control_freq: float = 20,
        horizon: int = 1000,
        ignore_done: bool = False,
        hard_reset: bool = True,
        camera_names: Any = "agentview",
        camera_heights: Any = 256,
        camera_widths: Any = 256,
        camera_depths: Any = False,
        camera_segmentations: Any = None,
        reward_scale: float | None = 1.0,
        **others: Any,
    ) -> Settings:
        """Returns the checked settings. Raises NotImplementedError for features that only
        LIBERO has, TypeError for an argument that LIBERO does not have either, and
        ValueError for an invalid value."""
        if list(_listed(robots, 1)) != ["Panda"]:
            raise _unsupported("robots", robots, 'LIBERO\'s robot is robots=["Panda"]')
        if control_freq != 20:
            raise _unsupported("control_freq", control_freq, "LIBERO controls at 20 Hz")
        for name, value in others.items():
            if name in _ONE_VALUE:
                allowed, reason = _ONE_VALUE[name]
                if value not in allowed:
                    raise _unsupported(name, value, f"{reason}; leave it at {allowed[0]!r}")
            elif name not in _IGNORED:
                raise TypeError(f"there is no argument `{name}`: leave it out or correct its name")
        if use_camera_obs and not has_offscreen_renderer:
            raise ValueError(
                "frames need a renderer: leave has_offscreen_renderer at True, or give "
                "use_camera_obs=False"
            )
        cameras = (
            _cameras(
                camera_names, camera_heights, camera_widths, camera_depths, camera_segmentations
            )
            if use_camera_obs
            else ()
        )
        return cls(
            cameras=cameras,
            horizon=horizon,
            ignore_done=ignore_done,
            hard_reset=hard_reset,
            reward_scale=reward_scale,
            use_delta=_use_delta(_listed(controller_configs, 1)[0]),
            has_offscreen_renderer=has_offscreen_renderer,
        )


def controller_config(controller: str) -> dict[str, Any]:
    """Returns the constants of a controller by name."""
    if controller != "OSC_POSE":
        raise _unsupported(
            "controller", controller, 'LIBERO\'s policies act through controller="OSC_POSE"'
        )
    return {**OSC_POSE, "control_delta": True}


def existing_file(path: str | os.PathLike[str]) -> str:
    """Returns a BDDL file's path, if the file exists."""
    name = os.fspath(path)
    if not os.path.isfile(name):
        raise FileNotFoundError(
            f"there is no BDDL file {name}: take its path from a benchmark's "
            "get_task_bddl_file_path(i)"
        )
    return name


def _use_delta(config: Any) -> bool:
    if config is None:
        return True
    if not isinstance(config, Mapping):
        raise TypeError("controller_configs is a dictionary, or a list of one")
    for name, value in OSC_POSE.items():
        if name in config and config[name] != value:
            raise _unsupported(
                f"controller_configs['{name}']",
                config[name],
                f"OSC_POSE has LIBERO's constants, here {value!r}",
            )
    return bool(config.get("control_delta", True))


def _cameras(
    names: Any, heights: Any, widths: Any, depths: Any, segmentations: Any
) -> tuple[Camera, ...]:
    names = list(_listed(names, 1))
    count = len(names)
    lists = {
        "camera_heights": _listed(heights, count),
        "camera_widths": _listed(widths, count),
        "camera_depths": _listed(depths, count),
        "camera_segmentations": _segmentations(segmentations, count),
    }
    for argument, values in lists.items():
        if len(values) != count:
            raise ValueError(
                f"{argument} has {len(values)} values for {count} cameras: give one value, "
                "or one for each camera"
            )
    for argument in ("camera_heights", "camera_widths"):
        if any(int(size) != size or size < 1 for size in lists[argument]):
            raise ValueError(
                f"{argument} must be whole numbers of pixels, 1 or more, not {lists[argument]}"
            )
    return tuple(
        Camera(name, int(height), int(width), bool(depth), segmentation)
        for name, height, width, depth, segmentation in zip(names, *lists.values())
    )


def _segmentations(given: Any, count: int) -> list[tuple[str, ...]]:
    """Returns the kinds of segmentation of each camera. All kinds of a flat list apply to every
    camera whose entry in the list is not None, as in robosuite."""
    listed = _listed(given, count)
    if any(isinstance(kinds, (list, tuple)) for kinds in listed):
        by_camera = [() if kinds is None else tuple(_listed(kinds, 1)) for kinds in listed]
    else:
        all_kinds = tuple(dict.fromkeys(kind for kind in listed if kind is not None))
        # Cameras beyond the end of the list have all kinds.
        by_camera = [
            all_kinds if i >= len(listed) or listed[i] is not None else () for i in range(count)
        ]
    for kinds in by_camera:
        for kind in kinds:
            if kind not in _SEGMENTATIONS:
                raise ValueError(
                    f"there is no segmentation {kind!r}: choose one of {', '.join(_SEGMENTATIONS)}"
                )
    return by_camera


def _listed(value: Any, count: int) -> Sequence[Any]:
    return value if isinstance(value, (list, tuple)) else [value] * count


def _unsupported(argument: str, value: Any, remedy: str) -> NotImplementedError:
    return NotImplementedError(
        f"{argument}={value!r} is not supported by rollout-libero-shim: {remedy}"
    )
