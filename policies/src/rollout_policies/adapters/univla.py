"""UniVLA: the language model samples latent actions, and a small decoder turns them into twelve
actions of the robot.

It is queried at every step. Its inputs are the scene camera's frame and its last latent actions. It
averages the predictions of its last twelve chunks for the current step. Every suite has its own
weights.

The LIBERO-CTRL study evaluated it differently from its authors: frames were reduced without
antialiasing and cropped to whole pixels, and every episode used the same seed. Both protocols are
available; the authors' is the default."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..catalogue import Entry
from ..episode import Episode, Observation
from ..policy import Policy
from ..processing.actions import Ensemble, from_bounds
from ..processing.images import resize_bilinear
from ..processing.robot import gripper_from_rlds
from . import Options, executed_actions
from .fetch import fetch
from .of_suite import PolicyOfSuite
from .openvla_oft import CROP_AREA, SCENE, SIDE, frame
from .prismatic import load_network, prompt, statistics_in
from .upstream import UnusableCheckpoint, digest, precision, require, seed_of
from .weights import load_stored

#: Actions in a chunk, and the decay of older chunks' weights.
CHUNK = 12
DECAY = 0.1
#: Sampling parameters of latent actions.
TEMPERATURE = 0.75
TOP_P = 0.9
#: Token of the first latent action, number of different latent actions, and number of sampled
#: latent actions that the decoder reads.
FIRST_TOKEN = 32001
LATENT_ACTIONS = 32
LATENT_STEPS = 4
#: Widths of the language model and of the decoder, and the number of heads.
WIDTH, DECODER_WIDTH, HEADS = 4096, 512, 8
#: Seed of every episode in the study.
STUDY_SEED = 7
DECODER = "action_decoder.pt"


def study_frame(turned: np.ndarray) -> np.ndarray:
    """Converts a frame [256, 256, 3], turned by 180 degrees, to the study's input: bilinear
    resize to 224 without antialiasing, crop of the centre to whole pixels, bilinear resize to 224
    again."""
    small = resize_bilinear(turned, SIDE, SIDE)
    side = round(SIDE * CROP_AREA**0.5)
    start = (SIDE - side) // 2
    return resize_bilinear(small[start : start + side, start : start + side], SIDE, SIDE)


#: Conversion of a frame to the network's input, by evaluation protocol.
FRAMES: dict[str, Callable[[np.ndarray], np.ndarray]] = {"upstream": frame, "study": study_frame}


def prompt_after(instruction: str, history: str) -> str:
    """Returns the prompt, with the last latent actions if there are any."""
    if not history:
        return prompt(instruction)
    return prompt(instruction).replace("?\nOut:", f"? History action {history}\nOut:")


def history_of(tokens: Iterable[int]) -> str:
    """Returns the names of latent actions. Sampling may draw a token of another kind (such as
    the end of the sentence), which is left out."""
    steps = (int(token) - FIRST_TOKEN for token in tokens)
    return "".join(f"<ACT_{step}>" for step in steps if 0 <= step < LATENT_ACTIONS)


@dataclass
class Memory:
    """State of an episode between queries."""

    history: str = ""
    ensemble: Ensemble = field(default_factory=lambda: Ensemble(DECAY))
    #: Seed, and then state, of the generator in the study's protocol. The authors' protocol reseeds
    #: the generator at every query.
    generator: Any = None


@dataclass
class UnivlaModel:
    network: Any
    processor: Any
    decoder: Any
    device: str

    @property
    def parameters(self) -> int:
        parts = (self.network, self.decoder)
        return sum(tensor.numel() for part in parts for tensor in part.parameters())

    def chunk(
        self, pixels: np.ndarray, text: str, generator: Any
    ) -> tuple[np.ndarray, list[int], Any]:
        """Returns twelve actions in -1..1, the latent actions' tokens, and the
        generator's state afterwards. `generator` is a seed or such a state."""
        import torch
        from PIL import Image

        inputs = self.processor(text, Image.fromarray(pixels))
        self._set_generator(generator)
        with torch.inference_mode():
            latent, visual, tokens = self.network.predict_latent_action(
                **inputs.to(self.device, dtype=torch.bfloat16),
                do_sample=True,
                temperature=TEMPERATURE,
                top_p=TOP_P,
            )
            chunk = self.decoder(latent.float(), visual.float())
        token_ids = [int(token) for token in tokens[0]]
        return chunk.reshape(CHUNK, -1).cpu().numpy(), token_ids, self._generator_state()

    def _set_generator(self, generator: Any) -> None:
        import torch

        if isinstance(generator, int):
            torch.manual_seed(generator)
            return
        cpu_state, gpu_state = generator
        torch.set_rng_state(cpu_state)
        if gpu_state is not None:
            torch.cuda.set_rng_state(gpu_state, self.device)

    def _generator_state(self) -> tuple[Any, Any]:
        import torch

        on_gpu = self.device.startswith("cuda")
        return torch.get_rng_state(), torch.cuda.get_rng_state(self.device) if on_gpu else None


class UniVla(PolicyOfSuite):
    """One action per query, averaged from the current and earlier chunks."""

    def __init__(
        self,
        entry: Entry,
        model: UnivlaModel,
        statistics: Mapping[str, Any],
        *,
        evaluation: str = "upstream",
        **loaded: Any,
    ) -> None:
        self.statistics = statistics
        self.frame = FRAMES[evaluation]
        self.follows_study = evaluation == "study"
        slots = {
            "image slots": f"first={SCENE.name}",
            "state slots": "none",
            "chunk": f"{CHUNK}, averaged to 1",
            "evaluation": evaluation,
        }
        # In the study, every episode draws the same random numbers.
        kind = {"stateful": True, "stochastic": not self.follows_study}
        super().__init__(entry, model, slots, cameras=(SCENE,), **kind, **loaded)

    def reset(self, episode: Episode) -> None:
        super().reset(episode)
        episode.memory = Memory(generator=STUDY_SEED)

    def prepare(self, observation: Observation) -> tuple[np.ndarray]:
        return (self.frame(observation.rotated(SCENE.name)),)

    def infer(self, observation: Observation) -> np.ndarray:
        memory = observation.episode.memory
        chunk, tokens, memory.generator = self.model.chunk(
            *(observation.prepared or self.prepare(observation)),
            prompt_after(observation.episode.instruction, memory.history),
            memory.generator if self.follows_study else seed_of(observation),
        )
        memory.history = history_of(tokens)
        action = memory.ensemble.add(chunk)
        bounds = self.statistics
        return gripper_from_rlds(from_bounds(action, bounds["q01"], bounds["q99"], bounds["mask"]))


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    listed = entry.checkpoint_for(options.suite)
    checkpoint = options.checkpoint or listed
    executed_actions(entry, options, chunk=1, from_checkpoint=1)
    fetched = fetch(entry, checkpoint, options.revision)
    folder = fetched.folder
    if not (folder / DECODER).is_file():
        raise UnusableCheckpoint(
            f"checkpoint {checkpoint} has no {DECODER}, which turns latent actions into the robot's"
            " actions: it was pre-trained, but not fine-tuned on LIBERO"
        )
    all_statistics, key, summary = statistics_in(folder, options.suite)
    statistics = all_statistics[key]["action"]
    # The gripper is not normalised.
    statistics.setdefault("mask", [True] * 6 + [False])
    network, processor = load_network(entry, folder, checkpoint, options.device, causal=True)
    torch = require("torch", entry)
    decoder = _decoder(entry)
    stored = torch.load(folder / DECODER, map_location="cpu", weights_only=True)
    load_stored(decoder, stored, checkpoint, "the decoder")
    decoder.to(options.device).eval()
    return UniVla(
        entry,
        UnivlaModel(network, processor, decoder, options.device),
        statistics,
        suite=options.suite,
        checkpoint=checkpoint,
        weights=digest([*folder.glob("*.safetensors"), folder / DECODER]),
        evaluation=options.evaluation,
        settings={
            "statistics": summary,
            **precision(options.device, network, decoder),
            **fetched.settings,
        },
    )


def _decoder(entry: Entry) -> Any:
    """Returns the decoder's network: two attention pools and a linear layer. The attributes have
    the names that the weights file uses."""
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
            pooled = self.visual_pool(visual)
            return self.proj(self.latent_action_pool(latent[:, -LATENT_STEPS:], init_embed=pooled))

    return Decoder()
