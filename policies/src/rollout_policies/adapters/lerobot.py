"""What the policies that lerobot runs have in common.

`LerobotModel` is the only code here that touches lerobot and torch. lerobot's
own processors normalise, tokenise, resize and un-normalise, with the statistics
that lie beside the checkpoint: doing that again here would be doing it twice.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

import numpy as np

from ..catalogue import Entry
from ..description import Camera
from ..episode import Observation
from ..processing.images import unit_planes
from ..processing.robot import STATE_FIELDS, state_vector
from . import Options
from .upstream import UnusableCheckpoint, digest, require

IMAGES = "observation.images."
STATE = "observation.state"
WEIGHTS = "model.safetensors"
#: In the order in which checkpoints declare their slots.
CAMERAS = (Camera("agentview"), Camera("robot0_eye_in_hand"))
FIELDS = STATE_FIELDS
#: Tensors up to this size are compared with the file after loading.
COMPARED_NUMBERS = 1 << 20


def camera_of_slot(slots: Sequence[str]) -> dict[str, str]:
    """Which camera goes into which of a checkpoint's image slots.

    By name, the first slot gets the view of the scene and the second the
    wrist's, whatever they are called; further ones and those called "empty"
    get nothing at all. A checkpoint may declare a third camera that never was
    in its training data, and zeros in its place are something it never saw.
    """
    real = sorted(slot for slot in slots if not slot.removeprefix(IMAGES).startswith("empty"))
    return {slot: camera.name for slot, camera in zip(real, CAMERAS)}


def batch_of(
    observations: Sequence[Observation], slots: Mapping[str, str], with_state: bool = True
) -> dict[str, Any]:
    """Observations as lerobot takes them before its processors.

    Frames float32 [batch, 3, height, width] in 0..1, turned by 180 degrees; the
    state float32 [batch, 8], whatever width the checkpoint declares; the
    instructions, verbatim.
    """
    batch: dict[str, Any] = {
        slot: np.stack([unit_planes(one.rotated(camera)) for one in observations])
        for slot, camera in slots.items()
    }
    if with_state:
        batch[STATE] = np.stack([state_vector(one) for one in observations]).astype(np.float32)
    batch["task"] = [one.episode.instruction for one in observations]
    return batch


@dataclass
class LerobotModel:
    """A policy of lerobot between its processors."""

    network: Any
    before: Any
    after: Any
    #: Camera by image slot.
    slots: dict[str, str]
    with_state: bool
    checkpoint: str
    checkpoint_digest: str

    @classmethod
    def load(
        cls, entry: Entry, options: Options, *, kind: str | None = None, **settings: Any
    ) -> LerobotModel:
        """Loads a checkpoint from a folder or a hub, which must be of this kind
        of lerobot's; `settings` replace what its configuration says."""
        name = options.checkpoint or entry.checkpoint_for(options.suite)
        configs = require("lerobot.configs.policies", entry)
        factory = require("lerobot.policies.factory", entry)
        folder = _fetch(name, entry)
        config = configs.PreTrainedConfig.from_pretrained(folder)
        config.device = options.device
        config.pretrained_path = folder
        unknown = [field for field in settings if not hasattr(config, field)]
        if unknown or kind not in (None, config.type):
            raise UnusableCheckpoint(
                f"checkpoint {name} is a policy of kind {config.type!r}, not {entry.title};"
                " name another with --checkpoint"
            )
        for field, value in settings.items():
            setattr(config, field, value)
        network = factory.get_policy_class(config.type).from_pretrained(folder, config=config)
        network.to(options.device).eval()
        _require_loaded(network, Path(folder) / WEIGHTS, name)
        before, after = factory.make_pre_post_processors(
            config,
            pretrained_path=str(folder),
            preprocessor_overrides={
                "device_processor": {"device": options.device},
                # Frames go straight into the slots that the checkpoint declares.
                "rename_observations_processor": {"rename_map": {}},
            },
        )
        return cls(
            network,
            before,
            after,
            camera_of_slot(list(config.image_features)),
            STATE in config.input_features,
            name,
            digest([Path(folder) / "config.json", Path(folder) / WEIGHTS]),
        )

    @property
    def config(self) -> Any:
        """lerobot's configuration of the policy."""
        return self.network.config

    @property
    def parameters(self) -> int:
        """How many numbers were learnt."""
        return sum(parameter.numel() for parameter in self.network.parameters())

    def chunks(
        self, observations: Sequence[Observation], noise: np.ndarray | None = None
    ) -> np.ndarray:
        """Chunks of actions [batch, n, 7], in the world's units.

        `noise` is where the flow starts, [batch, n, width]; without it the
        network draws from torch's generator.
        """
        import torch

        batch = self._prepared(observations)
        given = {}
        if noise is not None:
            device = next(self.network.parameters()).device
            given["noise"] = torch.from_numpy(noise.astype(np.float32)).to(device)
        with torch.inference_mode():
            chunks = self.network.predict_action_chunk(batch, **given)
            flat = self.after(chunks.reshape(-1, chunks.shape[-1]))
        return flat.float().cpu().numpy().reshape(tuple(chunks.shape[:2]) + (-1,))

    def seed(self, seed: int) -> None:
        """Sets torch's generators."""
        import torch

        torch.manual_seed(seed)

    def fresh_memory(self) -> dict[str, Any]:
        """What the network keeps between the queries of an episode, new: all of
        its attributes but the weights and the configuration."""
        import torch

        self.network.reset()
        kept = vars(self.network)
        others = {"config", *vars(torch.nn.Module())}
        return copy.deepcopy({key: kept[key] for key in kept if key not in others})

    def act(self, observation: Observation, memory: dict[str, Any]) -> np.ndarray:
        """The next action [7] of an episode, whose memory is advanced.

        lerobot keeps an episode's queues inside the policy, as if there were
        one episode at a time; here they are put in for the call.
        """
        import torch

        vars(self.network).update(memory)
        with torch.inference_mode():
            action = self.after(self.network.select_action(self._prepared([observation])))
        memory.update({key: vars(self.network)[key] for key in memory})
        return action.float().cpu().numpy()[0]

    def _prepared(self, observations: Sequence[Observation]) -> dict[str, Any]:
        import torch

        batch = batch_of(observations, self.slots, self.with_state)
        return self.before(
            {
                key: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
                for key, value in batch.items()
            }
        )


def _fetch(name: str, entry: Entry) -> str:
    """The folder of a checkpoint, fetched from the hub unless it is one."""
    if Path(name).is_dir():
        return name
    return require("huggingface_hub", entry).snapshot_download(name)


def _require_loaded(network: Any, weights: Path, name: str) -> None:
    """Compares the network with the file of its weights.

    lerobot's π0.5 prints a warning when weights do not fit, and goes on with
    random ones; such a policy moves, and fails every task.
    """
    from safetensors import safe_open

    own = network.state_dict()
    compared = 0
    with safe_open(str(weights), framework="pt") as file:
        for key in file.keys():
            mine = own.get(key, own.get(f"model.{key}"))
            if mine is None or mine.numel() > COMPARED_NUMBERS:
                continue
            theirs = file.get_tensor(key).to(mine.dtype)
            if theirs.shape != mine.shape or not theirs.equal(mine.cpu()):
                raise UnusableCheckpoint(
                    f"checkpoint {name} was not loaded: {key!r} of the network is not what"
                    f" {weights.name} holds"
                )
            compared += 1
    if compared == 0:
        raise UnusableCheckpoint(
            f"checkpoint {name} was not loaded: {weights.name} has no tensor of the network"
        )
