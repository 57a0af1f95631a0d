"""Synthetic observations: any input that a policy can request, with the right shape and
plausible values, reproducible from a seed."""

from __future__ import annotations

import numpy as np

from .description import Camera, Description, State
from .episode import Episode, Observation
from .proto import policy_pb2 as pb

#: The suites, each with the canonical instruction of one of its tasks.
TASKS = {
    "libero_object": "pick up the butter and place it in the basket",
    "libero_spatial": (
        "pick up the black bowl between the plate and the ramekin and place it on the plate"
    ),
    "libero_goal": "open the middle drawer of the cabinet",
    "libero_10": "put both the alphabet soup and the tomato sauce in the basket",
}
#: Number of objects on the table of a frame.
OBJECTS = 6
#: The Panda's rest posture, rad.
JOINTS = (0.0, -0.16, 0.0, -2.44, 0.0, 2.23, 0.785)
#: Numbers of a reading that only a simulator defines; larger than that of most.
NAMED_SIZE = 64
#: Spread of readings around the rest posture: m and rad; joint velocities, rad/s.
SPREAD = 0.05


def fake_episode(
    suite: str = "libero_object", seed: int = 0, session: str = "synthetic"
) -> Episode:
    """Returns an episode of a task of this suite, or of `libero_object` if the suite is unknown."""
    return Episode(session, suite, TASKS.get(suite, TASKS["libero_object"]), seed)


def fake_observation(
    description: Description, seed: int = 0, query_index: int = 0, episode: Episode | None = None
) -> Observation:
    """Returns an observation as the description requests it, drawn from (seed, query_index).

    Frames show a table with coloured objects; readings are near those of the arm's rest posture.
    Without `episode`, an episode is generated, too."""
    rng = np.random.default_rng([seed, query_index])
    readings = fake_readings(rng)
    return Observation(
        episode or fake_episode(seed=seed),
        query_index,
        {camera.name: fake_frame(camera, rng) for camera in description.cameras},
        {field: readings[field] for field in description.state},
        {name: np.zeros(NAMED_SIZE) for name in description.readings},
    )


def fake_frame(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """Returns a frame uint8 [height, width, 3], bottom row first."""
    height, width = camera.height, camera.width
    up = np.linspace(0.0, 1.0, height)[:, None, None]
    wood, wall = rng.uniform([120, 90, 60], [200, 150, 110]), rng.uniform(150, 230, 3)
    frame = np.where(up < 0.7, wood * (0.7 + 0.4 * up), np.broadcast_to(wall, (height, width, 3)))
    for _ in range(OBJECTS):
        bottom, left = rng.uniform(0.05, 0.55), rng.uniform(0.0, 0.85)
        tall, wide = rng.uniform(0.05, 0.2, 2)
        rows = slice(int(bottom * height), int((bottom + tall) * height) + 1)
        columns = slice(int(left * width), int((left + wide) * width) + 1)
        frame[rows, columns] = rng.uniform(0, 255, 3)
    frame += rng.normal(0.0, 4.0, frame.shape)
    return np.clip(np.round(frame), 0, 255).astype(np.uint8)


def fake_readings(rng: np.random.Generator) -> dict[State, np.ndarray]:
    """Returns every kind of reading. The orientations are of one hand, whose fingers point down and
    which is turned about the vertical; the others are drawn independently near the rest posture."""
    turn = rng.uniform(-SPREAD, SPREAD)
    # The orientation is a half turn about a horizontal axis at the angle `turn / 2`.
    axis = np.array([np.cos(turn / 2), np.sin(turn / 2), 0.0])
    opening = rng.uniform(0.03, 0.04)
    return {
        State.EEF_POS: np.array([-0.15, 0.0, 0.25]) + rng.uniform(-SPREAD, SPREAD, 3),
        State.EEF_QUAT_XYZW: np.append(axis, 0.0),
        State.EEF_AXIS_ANGLE: np.pi * axis,
        State.EEF_ROTATION: (2 * np.outer(axis, axis) - np.eye(3)).ravel(),
        State.JOINT_POS: np.array(JOINTS) + rng.uniform(-SPREAD, SPREAD, 7),
        State.JOINT_VEL: rng.uniform(-SPREAD, SPREAD, 7),
        State.GRIPPER_POS: np.array([opening, -opening]),
        State.GRIPPER_VEL: np.zeros(2),
    }


def to_message(observation: Observation) -> pb.Observation:
    return pb.Observation(
        images=[
            pb.Image(
                camera=camera, width=frame.shape[1], height=frame.shape[0], rgb=frame.tobytes()
            )
            for camera, frame in observation.images.items()
        ],
        state=[
            pb.StateReading(field=reading.value, values=values)
            for reading, values in observation.state.items()
        ]
        + [
            pb.StateReading(name=name, values=values)
            for name, values in observation.readings.items()
        ],
    )
