"""A trained student as a policy."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from torch import Tensor

from training.network import Network, to_actions
from training.observations import Observation, frames, instruction_rows, robot_state, scaled

FORMAT = "rollout-student/2"
IN_SINGLE_PRECISION = ("state_mean", "state_std")


def save_weights(tensors: Mapping[str, Tensor], file: Path, name: str, look: str = "") -> None:
    """Writes a weights file in half precision, the state's mean and deviation in single. ``look``
    is the look of the pictures that the student learned from.

    The file is replaced atomically, so that a running collection reads complete weights."""
    rounded = {
        key: (value.float() if key in IN_SINGLE_PRECISION else value.half()).cpu().contiguous()
        for key, value in tensors.items()
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(file.name + ".part")
    metadata = {"format": FORMAT, "name": name} | ({"look": look} if look else {})
    save_file(rounded, part, metadata=metadata)
    # safetensors makes files that only their owner can read.
    part.chmod(0o644)
    os.replace(part, file)


def load_network(file: Path, device: torch.device) -> Network:
    """Returns the network with the weights of a file, in single precision."""
    network = Network()
    network.load_state_dict({key: value.float() for key, value in load_file(file).items()})
    return network.eval().requires_grad_(False).to(device)


class Student:
    """Answers queries with the weights of a file."""

    def __init__(self, file: Path, device: torch.device) -> None:
        self._device = device
        self._network = load_network(file, device)

    def act(self, observation: Observation, instructions: Sequence[str]) -> NDArray[np.float64]:
        """Returns eight actions for each of n observations, [n, 8, 7]."""
        state = torch.from_numpy(robot_state(observation)).to(self._device)
        return self.act_on(frames(observation, self._device), state, instructions)

    @torch.inference_mode()
    def act_on(
        self, pictures: Tensor, state: Tensor, instructions: Sequence[str]
    ) -> NDArray[np.float64]:
        """Returns eight actions, [n, 8, 7], for each of n pairs of pictures, uint8
        [n, 2, 128, 128, 3], with the robot's state, [n, 14], and an instruction."""
        rows, present = (
            torch.from_numpy(array).to(self._device) for array in instruction_rows(instructions)
        )
        views = scaled(pictures[:, 0]), scaled(pictures[:, 1])
        actions = to_actions(self._network(*views, state, rows, present))
        return actions.double().cpu().numpy()
