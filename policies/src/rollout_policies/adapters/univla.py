"""UniVLA: the language model samples latent actions, and a small decoder turns
them into twelve real ones.

It is asked at every step, sees the scene's camera only, is told which latent
actions it took last, and averages what its last twelve chunks say about now.
Every suite has its own weights.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Iterable, Mapping

import numpy as np

from ..catalogue import Entry, NoCheckpoint
from ..description import Description
from ..episode import Episode, Observation
from ..policy import Policy
from ..processing.actions import Ensemble, from_bounds
from ..processing.robot import gripper_from_rlds
from . import Options
from .openvla_oft import SCENE, frame, prompt, statistics_of
from .upstream import digest, require, require_suite, seed_of

#: Actions in a chunk, and how fast old chunks lose their say.
CHUNK = 12
DECAY = 0.1
#: How latent actions are drawn.
TEMPERATURE = 0.75
TOP_P = 0.9
#: First token of the 32 latent actions, and how many of them make one step.
FIRST_TOKEN = 32001
LATENT_ACTIONS = 32
LATENT_STEPS = 4
#: Widths of the language model and of the decoder; its heads.
WIDTH, DECODER_WIDTH, HEADS = 4096, 512, 8


def prompt_after(instruction: str, history: str) -> str:
    """The prompt, with the last latent actions if there were any."""
    if not history:
        return prompt(instruction)
    return prompt(instruction).replace("?\nOut:", f"? History action {history}\nOut:")


def history_of(tokens: Iterable[int]) -> str:
    """Latent actions by name. Sampling may draw a token that is none (the end
    of the sentence, say); that one is left out."""
    steps = (int(token) - FIRST_TOKEN for token in tokens)
    return "".join(f"<ACT_{step}>" for step in steps if 0 <= step < LATENT_ACTIONS)


@dataclass
class Memory:
    """What an episode carries from query to query."""

    history: str = ""
    ensemble: Ensemble = field(default_factory=lambda: Ensemble(DECAY))


@dataclass
class UnivlaModel:
    """Language model and decoder."""

    network: Any
    processor: Any
    decoder: Any
    device: str

    @property
    def parameters(self) -> int:
        """How many numbers were learnt."""
        parts = (self.network, self.decoder)
        return sum(number.numel() for part in parts for number in part.parameters())

    def chunk(self, pixels: np.ndarray, text: str, seed: int) -> tuple[np.ndarray, list[int]]:
        """Twelve actions in -1..1 and the latent actions' tokens."""
        import torch
        from PIL import Image

        inputs = self.processor(text, Image.fromarray(pixels))
        torch.manual_seed(seed)
        with torch.inference_mode():
            latent, visual, tokens = self.network.predict_latent_action(
                **inputs.to(self.device, dtype=torch.bfloat16),
                do_sample=True,
                temperature=TEMPERATURE,
                top_p=TOP_P,
            )
            chunk = self.decoder(latent.float(), visual.float())
        return chunk.reshape(CHUNK, -1).cpu().numpy(), [int(token) for token in tokens[0]]


class UniVla(Policy):
    """One action per query, out of the chunks of this and earlier ones."""

    def __init__(
        self,
        entry: Entry,
        model: UnivlaModel,
        statistics: Mapping[str, Any],
        *,
        suite: str,
        checkpoint: str,
        weights: str = "",
    ) -> None:
        self.entry = entry
        self.suite = suite
        self.model = model
        self.statistics = statistics
        self.description = Description(
            name=entry.name,
            checkpoint=checkpoint,
            checkpoint_digest=weights,
            parameters=model.parameters,
            cameras=(SCENE,),
            stateful=True,
            stochastic=True,
        )

    def reset(self, episode: Episode) -> None:
        require_suite(self.entry, self.suite, episode)
        episode.memory = Memory()

    def prepare(self, observation: Observation) -> tuple[np.ndarray]:
        return (frame(observation.rotated(SCENE.name)),)

    def infer(self, observation: Observation) -> np.ndarray:
        memory = observation.episode.memory
        chunk, tokens = self.model.chunk(
            *(observation.prepared or self.prepare(observation)),
            prompt_after(observation.episode.instruction, memory.history),
            seed_of(observation),
        )
        memory.history = history_of(tokens)
        action = memory.ensemble.add(chunk)
        bounds = self.statistics
        return gripper_from_rlds(from_bounds(action, bounds["q01"], bounds["q99"], bounds["mask"]))


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    listed = entry.checkpoint_for(options.suite)
    folder = Path(options.checkpoint or listed)
    if not folder.is_dir():
        raise NoCheckpoint(
            f"{entry.title}'s weights are folders of one hub repository, and {folder} is no"
            f" folder; fetch it ({entry.install}) and name it with --checkpoint"
        )
    torch = require("torch", entry)
    network, processor = _language_model(entry, folder, options.device)
    decoder = _decoder(entry).to(options.device).eval()
    decoder.load_state_dict(torch.load(folder / "action_decoder.pt", map_location="cpu"))
    # What the model's own configuration holds are the pre-training's statistics.
    everything = json.loads((folder / "dataset_statistics.json").read_text("utf-8"))
    statistics = everything[statistics_of(options.suite, everything)]["action"]
    # The gripper was not normalised.
    statistics.setdefault("mask", [True] * 6 + [False])
    return UniVla(
        entry,
        UnivlaModel(network, processor, decoder, options.device),
        statistics,
        suite=options.suite,
        checkpoint=options.checkpoint or listed,
        weights=digest([*folder.glob("*.safetensors"), folder / "action_decoder.pt"]),
    )


def _language_model(entry: Entry, folder: Path, device: str) -> tuple[Any, Any]:
    torch = require("torch", entry)
    transformers = require("transformers", entry)
    configuration = require("prismatic.extern.hf.configuration_prismatic", entry)
    modeling = require("prismatic.extern.hf.modeling_prismatic", entry)
    processing = require("prismatic.extern.hf.processing_prismatic", entry)
    config = configuration.OpenVLAConfig
    transformers.AutoConfig.register("openvla", config)
    transformers.AutoImageProcessor.register(config, processing.PrismaticImageProcessor)
    transformers.AutoProcessor.register(config, processing.PrismaticProcessor)
    network = modeling.OpenVLAForActionPrediction.from_pretrained(
        folder, torch_dtype=torch.bfloat16, low_cpu_mem_usage=True
    )
    processor = transformers.AutoProcessor.from_pretrained(folder, trust_remote_code=True)
    return network.to(device).eval(), processor


def _decoder(entry: Entry) -> Any:
    """The decoder's network: two attention pools and a layer. The file of
    weights names its parts, so these are called as there."""
    from torch import nn

    pool = require("prismatic.models.policy.transformer_utils", entry).MAPBlock
    shape = {"n_latents": 1, "vis_dim": WIDTH, "embed_dim": DECODER_WIDTH, "n_heads": HEADS}

    class Decoder(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.latent_action_pool = pool(**shape)
            self.visual_pool = pool(**shape)
            self.proj = nn.Sequential(nn.Linear(DECODER_WIDTH, 7 * CHUNK), nn.Tanh())

        def forward(self, latent: Any, visual: Any) -> Any:
            seen = self.visual_pool(visual)
            return self.proj(self.latent_action_pool(latent[:, -LATENT_STEPS:], init_embed=seen))

    return Decoder()
