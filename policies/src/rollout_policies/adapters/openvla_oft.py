"""OpenVLA-OFT: two frames and the state in, eight actions out, no chance.

Every suite has its own weights, so a server serves one suite and refuses
episodes of another.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Mapping

import numpy as np

from ..catalogue import Entry
from ..description import Camera, Description
from ..episode import Episode, Observation
from ..policy import Policy
from ..processing import jpeg
from ..processing.actions import within_bounds
from ..processing.images import LANCZOS3, centre_crop, resize
from ..processing.robot import STATE_FIELDS, gripper_from_rlds, state_vector
from . import Options
from .upstream import UnusableCheckpoint, digest, require, require_suite

SCENE, WRIST = Camera("agentview"), Camera("robot0_eye_in_hand")
#: Side of the frames that the network takes, pixels.
SIDE = 224
#: Share of a frame's area that is left: it was trained on random crops.
CROP_AREA = 0.9
#: Actions in a chunk, all of which are executed.
CHUNK = 8
STATE_WIDTH = 8


def frame(turned: np.ndarray) -> np.ndarray:
    """A frame [256, 256, 3], turned by 180 degrees, as the network takes it:
    through a JPEG, Lanczos to 224, and the middle of that."""
    return centre_crop(resize(jpeg.round_trip(turned), SIDE, SIDE, LANCZOS3), CROP_AREA, SIDE)


def prompt(instruction: str) -> str:
    """What the language model completes."""
    return f"In: What action should the robot take to {instruction.lower()}?\nOut:"


def statistics_of(suite: str, all_statistics: Mapping[str, Any]) -> str:
    """The key of a suite's statistics: OpenVLA's data sets are called
    `libero_goal_no_noops` where steps without motion were dropped.

    Raises UnusableCheckpoint if there are none.
    """
    for key in (suite, f"{suite}_no_noops"):
        if key in all_statistics:
            return key
    raise UnusableCheckpoint(
        f"the checkpoint has no statistics of {suite}; it has those of"
        f" {', '.join(all_statistics) or 'nothing'}"
    )


def proprio(state: np.ndarray, statistics: Mapping[str, Any]) -> np.ndarray:
    """The state [8] between the first and the last percentile, as -1..1."""
    mask = statistics.get("mask", [True] * len(state))
    return within_bounds(state, statistics["q01"], statistics["q99"], mask)


@dataclass
class OftModel:
    """The network and what upstream keeps beside it."""

    network: Any
    processor: Any
    action_head: Any
    proprio_projector: Any
    statistics_key: str
    device: str

    @property
    def proprio_statistics(self) -> Mapping[str, Any]:
        """Percentiles of the state in the training data."""
        return self.network.norm_stats[self.statistics_key]["proprio"]

    @property
    def parameters(self) -> int:
        """How many numbers were learnt."""
        parts = (self.network, self.action_head, self.proprio_projector)
        return sum(number.numel() for part in parts for number in part.parameters())

    def chunk(
        self, scene: np.ndarray, wrist: np.ndarray, text: str, state: np.ndarray
    ) -> np.ndarray:
        """Eight actions in the world's units, but for the gripper: 0 closed,
        1 open."""
        import torch
        from PIL import Image

        def inputs_of(pixels: np.ndarray) -> Any:
            inputs = self.processor(text, Image.fromarray(pixels))
            return inputs.to(self.device, dtype=torch.bfloat16)

        inputs = inputs_of(scene)
        both = [inputs["pixel_values"], inputs_of(wrist)["pixel_values"]]
        inputs["pixel_values"] = torch.cat(both, dim=1)
        with torch.inference_mode():
            actions, _ = self.network.predict_action(
                **inputs,
                unnorm_key=self.statistics_key,
                do_sample=False,
                proprio=state,
                proprio_projector=self.proprio_projector,
                noisy_action_projector=None,
                action_head=self.action_head,
                use_film=False,
            )
        return np.asarray(actions, dtype=np.float64)


class OpenVlaOft(Policy):
    """A chunk per query, executed whole."""

    def __init__(
        self, entry: Entry, model: OftModel, *, suite: str, checkpoint: str, weights: str = ""
    ) -> None:
        self.entry = entry
        self.suite = suite
        self.model = model
        self.description = Description(
            name=entry.name,
            checkpoint=checkpoint,
            checkpoint_digest=weights,
            parameters=model.parameters,
            cameras=(SCENE, WRIST),
            state=STATE_FIELDS,
            horizon=CHUNK,
        )

    def reset(self, episode: Episode) -> None:
        require_suite(self.entry, self.suite, episode)

    def prepare(self, observation: Observation) -> tuple[np.ndarray, ...]:
        return tuple(frame(observation.rotated(camera.name)) for camera in (SCENE, WRIST))

    def infer(self, observation: Observation) -> np.ndarray:
        actions = self.model.chunk(
            *(observation.prepared or self.prepare(observation)),
            prompt(observation.episode.instruction),
            proprio(state_vector(observation), self.model.proprio_statistics),
        )
        return gripper_from_rlds(actions[:CHUNK])


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    listed = entry.checkpoint_for(options.suite)
    checkpoint = options.checkpoint or listed
    # Upstream's image library must come before its TensorFlow: the other way
    # round, importing it has been seen to crash the process.
    require("timm", entry)
    upstream = require("experiments.robot.openvla_utils", entry)
    settings = SimpleNamespace(
        pretrained_checkpoint=checkpoint,
        load_in_8bit=False,
        load_in_4bit=False,
        use_film=False,
        use_l1_regression=True,
        use_diffusion=False,
        use_proprio=True,
        num_images_in_input=2,
    )
    network = upstream.get_vla(settings)
    model = OftModel(
        network,
        upstream.get_processor(settings),
        upstream.get_action_head(settings, network.llm_dim),
        upstream.get_proprio_projector(settings, network.llm_dim, STATE_WIDTH),
        statistics_of(options.suite, network.norm_stats),
        str(upstream.DEVICE),
    )
    return OpenVlaOft(
        entry,
        model,
        suite=options.suite,
        checkpoint=checkpoint,
        weights=_digest(checkpoint, entry),
    )


def _digest(checkpoint: str, entry: Entry) -> str:
    folder = Path(checkpoint)
    if not folder.is_dir():
        folder = Path(require("huggingface_hub", entry).snapshot_download(checkpoint))
    return digest([*folder.glob("*.safetensors"), *folder.glob("*.pt")])
