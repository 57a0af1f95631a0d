"""Writes a run's weights in the released format, and reference answers for tests.

    python -m training.export --run runs/second --name student --into student.safetensors \\
        --reference queries.safetensors

Run it with the same ``ROLLOUT_LOOK`` as the collection: the file says which look was learned. The
file of `--reference` has four queries, each in a scene that LIBERO's samplers place, and the
answers of the rounded weights, computed in single precision on the CPU.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from training.observations import RENDERED, frames, instruction_rows, robot_state, rotation, scaled
from training.student import load_network, save_weights
from training.train import CHECKPOINT
from training.wordings import canonical, draw

REFERENCE_TASKS = ("libero_spatial/0", "libero_object/3", "libero_goal/5", "libero_10/9")
REFERENCE_SEED = 2_000_003
REFERENCE_STEPS = 24
"""Steps of the expert before the queries, so that the arm's position differs between queries."""


def export(run: Path, name: str, into: Path) -> None:
    """Writes the running mean of a run's weights to the file ``into``, in half precision."""
    from rollout_libero.files import look

    state = torch.load(run / CHECKPOINT, map_location="cpu", weights_only=True)
    save_weights(state["mean"], into, name, look())
    print(f"{into}: {into.stat().st_size:,} bytes, step {state['step']:,}")


def write_reference(weights: Path, into: Path, assets: str) -> None:
    """Writes queries, and the answers that a student with these weights gives."""
    from gymnasium.vector import AutoresetMode

    import rollout_libero

    env = rollout_libero.VectorEnvironment(
        REFERENCE_TASKS,
        len(REFERENCE_TASKS),
        assets,
        height=RENDERED,
        width=RENDERED,
        orientation="upright",
        init_states="sampled",
        autoreset_mode=AutoresetMode.DISABLED,
    )
    n = len(REFERENCE_TASKS)
    env.reset(seed=[REFERENCE_SEED + index for index in range(n)])
    # The arm moves a little further in each environment than in the environment before.
    sizes = np.linspace(0.0, 1.0, n)[:, np.newaxis, np.newaxis]
    no_actions = np.zeros((n, REFERENCE_STEPS, 7))
    by_expert = np.ones((n, REFERENCE_STEPS), bool)
    _, _, _, _, info = env.step_chunk(no_actions, "none", expert=by_expert)
    actions = np.nan_to_num(info["expert_action"][:, -8:]) * sizes
    observation, *_ = env.step_chunk(actions)
    env.close()
    instructions = [
        canonical(task) if index == 0 else draw(task, 2, REFERENCE_SEED)[1]
        for index, task in enumerate(REFERENCE_TASKS)
    ]

    cpu = torch.device("cpu")
    network = load_network(weights, cpu)
    pictures = frames(observation, cpu)
    rows, present = (torch.from_numpy(array) for array in instruction_rows(instructions))
    state = torch.from_numpy(robot_state(observation))
    with torch.inference_mode():
        output = network(scaled(pictures[:, 0]), scaled(pictures[:, 1]), state, rows, present)
    matrix = rotation(np.asarray(observation["eef_quat"], np.float64)).astype(np.float32)
    save_file(
        {
            "agentview": torch.from_numpy(observation["agentview"]).contiguous(),
            "wrist": torch.from_numpy(observation["robot0_eye_in_hand"]).contiguous(),
            "eef_pos": torch.from_numpy(observation["eef_pos"].astype(np.float32)),
            "eef_rotation": torch.from_numpy(matrix),
            "gripper_pos": torch.from_numpy(observation["gripper_pos"].astype(np.float32)),
            "arm": output.arm.clamp(-1.0, 1.0).contiguous(),
            "gripper_logits": output.gripper.contiguous(),
        },
        into,
        metadata={"instructions": json.dumps(instructions), "weights": weights.name},
    )
    into.chmod(0o644)
    print(f"{into}: {n} queries; the arm's actions are clamped to -1..1")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--run", type=Path, required=True, help="folder that training.train wrote")
    parser.add_argument("--name", default="student", help="name of the student")
    parser.add_argument("--into", type=Path, required=True, help="weights file to write")
    parser.add_argument("--reference", type=Path, help="file for queries and answers")
    parser.add_argument("--assets", default="libero", help="asset pack or its folder")
    arguments = parser.parse_args()
    export(arguments.run, arguments.name, arguments.into)
    if arguments.reference:
        write_reference(arguments.into, arguments.reference, arguments.assets)


if __name__ == "__main__":
    main()
