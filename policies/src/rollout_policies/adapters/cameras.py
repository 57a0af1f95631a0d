"""Assignment of the simulator's cameras to the image slots of a checkpoint.

Slots have the names that the images have in the data set of the checkpoint's training. If the
cameras are swapped, the policy sees the wrist camera's frames in place of the scene's, and every
task fails; so slots are assigned by known names or by the command line, never guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .upstream import UnusableCheckpoint, UnusableOption

SCENE, WRIST = "agentview", "robot0_eye_in_hand"
#: The two cameras by their names on the command line.
ROLES = {"scene": SCENE, "wrist": WRIST}
#: Names that occur in published checkpoints, data sets and evaluations of LIBERO.
NAMES = {
    SCENE: frozenset(
        "image agentview agentview_image agentview_rgb agentview_cam agent_view base base_0_rgb"
        " base_rgb base_image camera1 cam_high cam_scene exterior exterior_image_1_left external"
        " front front_image front_rgb cam_front full_image image_primary primary main main_image"
        " rgb_static scene scene_image static static_image third_person third_person_image"
        " third_person_view top cam_top".split()
    ),
    WRIST: frozenset(
        "image2 camera2 cam_hand cam_wrist eye_in_hand eye_in_hand_image eye_in_hand_rgb gripper"
        " gripper_image hand hand_camera hand_image image_wrist in_hand left_wrist_0_rgb"
        " rgb_gripper robot0_eye_in_hand robot0_eye_in_hand_image wrist wrist_0_rgb wrist_cam"
        " wrist_camera wrist_image wrist_rgb wrist_view".split()
    ),
}
#: Declared slots that no LIBERO data set fills. They get no image, not even zeros, because the
#: checkpoint was trained without one.
NEVER_FILLED = frozenset(["camera3", "image3", "right_wrist_0_rgb"])


def camera_of_slot(
    slots: Sequence[str],
    image_keys: Mapping[str, str] | None = None,
    renamed: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Returns the simulator's camera by slot, without the slots that stay empty.

    `image_keys` maps camera roles ("scene", "wrist") to slots, as on the command line. `renamed`
    maps image names of the data set to slots, as recorded in the checkpoint; the data set's names
    identify cameras better than slot names such as `camera1`.

    Raises UnusableOption if `image_keys` names an unknown role or slot, or one slot twice;
    UnusableCheckpoint, whose message has the flag to add, if the names do not determine the
    cameras."""
    if image_keys:
        return _assigned_by_flag(slots, image_keys)
    assigned: dict[str, str] = {}
    for slot in slots:
        cameras = {_camera(name) for name in _names_of(slot, renamed or {})}
        if len(cameras) != 1 or (camera := cameras.pop()) == "unknown":
            raise _unclear(slots, f"{short(slot)} is not a known name")
        if camera is None:
            continue
        if camera in assigned.values():
            raise _unclear(slots, "two of them have names of the same camera")
        assigned[slot] = camera
    if not assigned:
        raise _unclear(slots, "none of them has the name of a LIBERO camera")
    return assigned


def short(slot: str) -> str:
    """Returns a slot's name without the common prefix: `image` for `observation.images.image`."""
    return slot.rpartition(".")[2]


def _assigned_by_flag(slots: Sequence[str], image_keys: Mapping[str, str]) -> dict[str, str]:
    by_name = {**{short(slot): slot for slot in slots}, **{slot: slot for slot in slots}}
    assigned = {}
    for role, name in image_keys.items():
        if role not in ROLES or name not in by_name:
            unknown = name if role in ROLES else role
            raise UnusableOption(
                f"--image-keys: {unknown!r} is neither a camera (scene, wrist) nor an image slot"
                f" of this checkpoint, whose slots are {_listed(slots)}"
            )
        if by_name[name] in assigned:
            raise UnusableOption(f"--image-keys: two cameras are assigned to slot {name}")
        assigned[by_name[name]] = ROLES[role]
    return assigned


def _names_of(slot: str, renamed: Mapping[str, str]) -> list[str]:
    """Returns the names of the slot's images in the training data: the names that the checkpoint
    renames to the slot, or the slot's name if there are none."""
    return [source for source, target in renamed.items() if target == slot] or [slot]


def _camera(name: str) -> str | None:
    """Returns the camera of a slot name: None for a slot that no LIBERO data set fills, "unknown"
    for an unknown name."""
    key = short(name).lower().replace("-", "_")
    if key in NEVER_FILLED or key.startswith("empty"):
        return None
    return next((camera for camera, names in NAMES.items() if key in names), "unknown")


def _unclear(slots: Sequence[str], reason: str) -> UnusableCheckpoint:
    names = [short(slot) for slot in slots]
    example = ",".join(f"{role}={name}" for role, name in zip(ROLES, names))
    return UnusableCheckpoint(
        f"the cameras of the image slots are not clear: the checkpoint's slots are"
        f" {_listed(slots)}, and {reason}; assign them, for example --image-keys {example}"
    )


def _listed(slots: Sequence[str]) -> str:
    return ", ".join(short(slot) for slot in slots) or "none"
