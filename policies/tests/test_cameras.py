"""Assignment of cameras to image slots."""

import pytest

from rollout_policies.adapters.cameras import camera_of_slot
from rollout_policies.adapters.upstream import UnusableCheckpoint, UnusableOption

SCENE, WRIST = "agentview", "robot0_eye_in_hand"


def slots(*names):
    return [f"observation.images.{name}" for name in names]


def by_name(*names, **arguments):
    """Returns the camera of each slot, by the slot's name without the common prefix."""
    cameras = camera_of_slot(slots(*names), **arguments)
    return {slot.removeprefix("observation.images."): camera for slot, camera in cameras.items()}


@pytest.mark.parametrize(
    ("scene", "wrist"),
    [
        ("image", "image2"), ("image", "wrist_image"), ("agentview", "robot0_eye_in_hand"),
        ("agentview_rgb", "eye_in_hand_rgb"), ("front", "wrist"), ("front", "cam_wrist"),
        ("static", "gripper"), ("scene", "hand"), ("base_0_rgb", "left_wrist_0_rgb"),
        ("camera1", "camera2"), ("Third-Person-View", "Wrist-Image"),
    ],
)  # fmt: skip
def test_known_names_get_their_cameras_in_any_order(scene, wrist):
    assert by_name(scene, wrist) == {scene: SCENE, wrist: WRIST}
    assert by_name(wrist, scene) == {scene: SCENE, wrist: WRIST}


def test_slots_that_were_never_in_the_training_data_stay_empty():
    assert by_name("camera3", "camera1", "empty_camera_0", "camera2") == {
        "camera1": SCENE,
        "camera2": WRIST,
    }
    assert by_name("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb") == {
        "base_0_rgb": SCENE,
        "left_wrist_0_rgb": WRIST,
    }


def test_a_single_camera_is_accepted():
    assert by_name("image") == {"image": SCENE}
    assert camera_of_slot(["observation.image"]) == {"observation.image": SCENE}


@pytest.mark.parametrize(
    "names", [("left", "right"), ("image", "depth"), ("image", "front"), ("empty_camera_0",), ()]
)
def test_unknown_or_ambiguous_slot_names_are_refused_with_the_flag_to_add(names):
    with pytest.raises(UnusableCheckpoint) as refused:
        by_name(*names)
    assert f"slots are {', '.join(names) or 'none'}" in str(refused.value)
    assert "--image-keys " in str(refused.value)
    if len(names) == 2:
        assert f"--image-keys scene={names[0]},wrist={names[1]}" in str(refused.value)


def test_image_keys_assign_slots_with_unknown_names():
    image_keys = {"scene": "right", "wrist": "observation.images.left"}
    assert by_name("left", "right", image_keys=image_keys) == {"right": SCENE, "left": WRIST}
    # The command line may contradict the names, and may leave a slot empty.
    image_keys = {"wrist": "image"}
    assert by_name("image", "image2", image_keys=image_keys) == {"image": WRIST}


@pytest.mark.parametrize("image_keys", [{"scene": "front"}, {"scene": "left", "wrist": "left"}])
def test_a_missing_slot_and_a_slot_given_twice_are_refused(image_keys):
    with pytest.raises(UnusableOption, match="--image-keys"):
        by_name("left", "right", image_keys=image_keys)


def test_recorded_renames_take_precedence_over_slot_names():
    wrist_first = {
        "observation.images.wrist_image": "observation.images.camera1",
        "observation.images.image": "observation.images.camera2",
    }
    assert by_name("camera1", "camera2", "camera3", renamed=wrist_first) == {
        "camera1": WRIST,
        "camera2": SCENE,
    }
    unknown = {"observation.images.second_image": "observation.images.camera2"}
    with pytest.raises(UnusableCheckpoint, match="camera2 is not a known name"):
        by_name("camera1", "camera2", renamed=unknown)
