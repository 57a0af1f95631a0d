"""OpenVLA-OFT: two frames and the state in, eight actions out, deterministic.

Every suite has its own weights, so a server serves one suite and refuses episodes of another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..catalogue import Entry
from ..description import Camera
from ..episode import Observation
from ..policy import Policy
from ..processing import jpeg
from ..processing.actions import within_bounds
from ..processing.images import LANCZOS3, centre_crop, resize
from ..processing.robot import STATE_FIELDS, gripper_from_rlds, state_vector
from . import Options, executed_actions
from .fetch import fetch
from .of_suite import PolicyOfSuite
from .prismatic import load_network, prompt, statistics_in
from .statistics import STATE_WIDTH, require_statistics
from .upstream import UnusableCheckpoint, digest, precision, require
from .weights import load_stored

SCENE, WRIST = Camera("agentview"), Camera("robot0_eye_in_hand")
#: Side of the network's input frames, pixels.
SIDE = 224
#: Share of a frame's area that is kept: training used random crops.
CROP_AREA = 0.9
#: Actions in a chunk.
CHUNK = 8
#: Parts of the model that have files of their own.
HEAD, PROJECTOR = "action_head", "proprio_projector"
#: Parts that only unsupported checkpoints have, with the training method that each indicates.
NOT_SERVED = {"noisy_action_projector": "diffusion", "vision_backbone": "FiLM"}


def frame(turned: np.ndarray) -> np.ndarray:
    """Converts a frame [256, 256, 3], turned by 180 degrees, to the network's
    input: JPEG round trip, Lanczos to 224, centre crop."""
    return centre_crop(resize(jpeg.round_trip(turned), SIDE, SIDE, LANCZOS3), CROP_AREA, SIDE)


def proprio(state: np.ndarray, statistics: Mapping[str, Any]) -> np.ndarray:
    """Scales the state [8]: its 1st percentile to -1, its 99th to 1. Clips to -1..1."""
    mask = statistics.get("mask", [True] * len(state))
    return within_bounds(state, statistics["q01"], statistics["q99"], mask)


@dataclass
class OftModel:
    """The network and the parts that upstream stores beside it."""

    network: Any
    processor: Any
    action_head: Any
    proprio_projector: Any
    statistics_key: str
    device: str

    @property
    def proprio_statistics(self) -> Mapping[str, Any]:
        """The percentiles of the state in the training data."""
        return self.network.norm_stats[self.statistics_key]["proprio"]

    @property
    def parameters(self) -> int:
        parts = (self.network, self.action_head, self.proprio_projector)
        return sum(tensor.numel() for part in parts for tensor in part.parameters())

    def chunk(
        self, scene: np.ndarray, wrist: np.ndarray, text: str, state: np.ndarray
    ) -> np.ndarray:
        """Returns eight actions, un-normalised, [8, 7]. The gripper is 0 closed, 1 open."""
        import torch
        from PIL import Image

        def inputs_of(pixels: np.ndarray) -> Any:
            inputs = self.processor(text, Image.fromarray(pixels))
            return inputs.to(self.device, dtype=torch.bfloat16)

        inputs = inputs_of(scene)
        pixels_of_cameras = [inputs["pixel_values"], inputs_of(wrist)["pixel_values"]]
        inputs["pixel_values"] = torch.cat(pixels_of_cameras, dim=1)
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


class OpenVlaOft(PolicyOfSuite):
    """Answers one chunk per query."""

    def __init__(
        self, entry: Entry, model: OftModel, *, execute: int = CHUNK, **loaded: Any
    ) -> None:
        slots = {
            "image slots": f"first={SCENE.name}, second={WRIST.name}",
            "state slots": "proprio=eef_pos, eef_axis_angle, gripper_pos",
        }
        inputs = {"cameras": (SCENE, WRIST), "state": STATE_FIELDS}
        super().__init__(entry, model, slots, horizon=CHUNK, execute=execute, **inputs, **loaded)

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
    checkpoint = entry.checkpoint_for(options.suite)
    checkpoint = options.checkpoint or checkpoint
    execute = executed_actions(entry, options, chunk=CHUNK, from_checkpoint=CHUNK)
    fetched = fetch(entry, checkpoint, options.revision)
    folder = fetched.folder
    parts = _part_files(folder, checkpoint)
    statistics, key, summary = statistics_in(folder, options.suite)
    state = statistics[key].get("proprio", {})
    state_summary = require_statistics("the state", "QUANTILES", state, STATE_WIDTH)
    network, processor = load_network(entry, folder, checkpoint, options.device, causal=False)
    network.norm_stats = statistics
    network.vision_backbone.set_num_images_in_input(2)
    constants = require("prismatic.vla.constants", entry)
    if constants.NUM_ACTIONS_CHUNK != CHUNK:
        raise UnusableCheckpoint(
            f"prismatic/vla/constants.py has chunks of {constants.NUM_ACTIONS_CHUNK} actions, but"
            f" LIBERO needs {CHUNK}: it searches the command line for a robot's name, so remove"
            " other robots' names from arguments and paths"
        )
    width = network.llm_dim
    heads = require("prismatic.models.action_heads", entry)
    projectors = require("prismatic.models.projectors", entry)
    model = OftModel(
        network,
        processor,
        heads.L1RegressionActionHead(input_dim=width, hidden_dim=width, action_dim=7),
        projectors.ProprioProjector(llm_dim=width, proprio_dim=STATE_WIDTH),
        key,
        options.device,
    )
    torch = require("torch", entry)
    for part, module in ((HEAD, model.action_head), (PROJECTOR, model.proprio_projector)):
        stored = torch.load(parts[part], map_location="cpu", weights_only=True)
        # A part that was trained on several GPUs has prefixed names.
        stored = {name.removeprefix("module."): tensor for name, tensor in stored.items()}
        load_stored(module.to(torch.bfloat16), stored, checkpoint, part)
        module.to(options.device).eval()
    return OpenVlaOft(
        entry,
        model,
        suite=options.suite,
        checkpoint=checkpoint,
        weights=digest([*folder.glob("*.safetensors"), *parts.values()]),
        execute=execute,
        settings={
            "statistics": f"{summary}; {state_summary}",
            **precision(options.device, network, model.action_head),
            **fetched.settings,
        },
    )


def _part_files(folder: Path, checkpoint: str) -> dict[str, Path]:
    """Returns the files of the action head and the projector, by part."""
    files = {
        part: sorted(folder.glob(f"*{part}*checkpoint*")) for part in (HEAD, PROJECTOR, *NOT_SERVED)
    }
    for part, method in NOT_SERVED.items():
        if files[part]:
            raise UnusableCheckpoint(
                f"checkpoint {checkpoint} was trained with {method} (it has"
                f" {files[part][0].name}), which this adapter does not serve"
            )
    for part in (HEAD, PROJECTOR):
        if len(files[part]) != 1:
            raise UnusableCheckpoint(
                f"checkpoint {checkpoint} has {len(files[part]) or 'no'} files of its {part}"
                " (*checkpoint.pt), and exactly one is needed"
            )
    return {part: files[part][0] for part in (HEAD, PROJECTOR)}
