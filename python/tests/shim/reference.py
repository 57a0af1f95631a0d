"""The shim's references, in the folder `shared` beside the checkout. Tests that need the folder are
skipped without it."""

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import rollout_libero

SHARED = Path(__file__).resolve().parents[4] / "shared"


@functools.cache
def fetched_assets() -> Path | None:
    """Returns the folder of LIBERO's assets, or None if the assets cannot be fetched."""
    try:
        return rollout_libero.fetch_assets()
    except FileNotFoundError as error:
        print(f"skipped: {error}")
        return None


def put_into_basket(env: Any, observation: Any) -> Iterator[tuple[Any, Any]]:
    """Puts the object of a task of libero_object into the basket, in 144 steps: knows both
    positions. Yields each step's action and result."""
    target = env.obj_of_interest[0]
    position, basket = observation[f"{target}_pos"], observation["basket_1_pos"]
    open_, closed = -1.0, 1.0
    # Steps, position of the hand, m, and gripper.
    plan = [
        (22, position + [0, 0, 0.12], open_),
        (20, position, open_),
        (8, position, closed),
        (15, position + [0, 0, 0.25], closed),
        (30, basket + [0, 0, 0.3], closed),
        (10, basket + [0, 0, 0.2], closed),
        (39, basket + [0, 0, 0.2], open_),
    ]
    for steps, goal, gripper in plan:
        for _ in range(steps):
            towards = np.clip((goal - observation["robot0_eef_pos"]) / 0.05, -1, 1)
            # Clients convert actions to single precision.
            action = np.float32([*towards, 0, 0, 0, gripper])
            result = env.step(action)
            observation = result[0]
            yield action, result
