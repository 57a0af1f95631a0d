"""PredVLA: a recurrent network that corrects itself while it acts.

At every step the network runs ten iterations of Adam over its last forty steps, to infer the latent
variables that explain its observations. The object that does this, upstream's `ERBatch`, is called
a correction here. Upstream keeps one correction for all episodes; here each episode has its own,
created from the episode's instruction.

Frames are not turned. They are rendered at 256 x 256, as for every policy, because the campaign's
blur and noise are defined at that size, and reduced to 128 x 128, the size in training."""

from __future__ import annotations

import pickle
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..catalogue import Entry, NoCheckpoint
from ..description import Camera, Description, State
from ..episode import Episode, Observation
from ..policy import Policy
from ..processing.images import BILINEAR, resize
from . import Options, executed_actions
from .statistics import DIGITS
from .upstream import UnusableCheckpoint, UnusableOption, digest, precision, require, require_suite
from .weights import load_stored

SCENE, WRIST = Camera("agentview"), Camera("robot0_eye_in_hand")
#: Side of the frames in training, pixels.
SIDE = 128
#: The correction's settings, as published.
CORRECTION = {
    "window": 40,
    "n_itr": 10,
    "lr": 0.05,
    "er_w": 1.0,
    "er_opt": "adam",
    "er_lambda_v": 1.0,
    "er_lambda_q": 1.0,
    "a_init": "prior",
}
#: Number of compiled variants of a step that torch may keep, as upstream sets it.
COMPILED_VARIANTS = 32


def frame(raw: np.ndarray) -> np.ndarray:
    """Reduces a frame, as the simulator renders it, to 128 x 128."""
    return resize(raw, SIDE, SIDE, BILINEAR)


def uses_frames(step: int, stride: int) -> bool:
    """Returns True if this step uses frames: the first does, then every `stride`-th."""
    return step % stride == 0


@dataclass
class Memory:
    """One episode's correction and its progress."""

    correction: Any
    step: int = 0


@dataclass
class PredvlaModel:
    """The network, the frozen front end that encodes its inputs, and the class of corrections."""

    network: Any
    front: Any
    correction_class: Any
    #: Frames are used at steps whose number is a multiple of this.
    stride: int
    device: str
    #: Compiled replacement of a correction's `_roll`; None on a CPU.
    roll: Any = None

    @property
    def parameters(self) -> int:
        """Number of trained parameters, without the frozen front end."""
        return sum(tensor.numel() for tensor in self.network.parameters())

    def begin(self, instruction: str) -> Any:
        """Returns a new correction for this instruction only."""
        import torch

        language = torch.stack([self.front.lang(instruction).to(self.device)])
        correction = self.correction_class(
            self.network, language, device=self.device, vision_stride=self.stride, **CORRECTION
        )
        if self.roll is not None:
            correction._roll = types.MethodType(self.roll, correction)
        return correction

    def step(
        self, correction: Any, joints: np.ndarray, frames: tuple[np.ndarray, np.ndarray] | None
    ) -> np.ndarray:
        """Advances a correction by one step and returns the action [7]. `joints` has seven arm
        joints and two fingers; `frames` is None at a step that uses no frames."""
        import torch

        proprioception = self.front.q(
            {
                "robot0_joint_pos": joints[:7].astype(np.float32),
                "robot0_gripper_qpos": joints[7:].astype(np.float32),
            }
        )
        vision = torch.zeros(self.network.v_dim) if frames is None else self.front.v(*frames)
        has_frames = torch.full((1,), 0.0 if frames is None else 1.0, device=self.device)
        action = correction.step(
            vision.to(self.device)[None], proprioception.to(self.device)[None], has_frames
        )
        return np.asarray(action[0], dtype=np.float64)


class PredVla(Policy):
    """Answers one action per step."""

    def __init__(
        self,
        entry: Entry,
        model: PredvlaModel,
        *,
        suite: str,
        checkpoint: str,
        weights: str = "",
        settings: Mapping[str, str] | None = None,
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
            state=(State.JOINT_POS, State.GRIPPER_POS),
            stateful=True,
            settings={
                **(settings or {}),
                "image slots": f"agentview={SCENE.name}, eye={WRIST.name}",
                "state slots": "q=joint_pos, gripper_pos",
            },
        )

    def reset(self, episode: Episode) -> None:
        require_suite(self.entry, self.suite, episode)
        episode.memory = Memory(self.model.begin(episode.instruction))

    def infer(self, observation: Observation) -> np.ndarray:
        memory = observation.episode.memory
        frames = None
        if uses_frames(memory.step, self.model.stride):
            frames = tuple(frame(observation.images[camera.name]) for camera in (SCENE, WRIST))
        joints = observation.vector(State.JOINT_POS, State.GRIPPER_POS)
        action = self.model.step(memory.correction, joints, frames)
        memory.step += 1
        return action


def _read_checkpoint(torch: Any, file: Path) -> dict[str, Any]:
    """Returns the contents of a checkpoint file: tensors, numbers and text. Anything
    else is refused, because unpickling it could run code of its author."""
    try:
        saved: dict[str, Any] = torch.load(file, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise UnusableCheckpoint(
            f"checkpoint {file} holds more than tensors, numbers and text, and loading that would"
            f" run code of its author ({str(error).splitlines()[0]}); if you trust it, load it with"
            " torch.load(FILE, weights_only=False) and save its 'cfg' as plain dictionaries and"
            " its 'model' with torch.save"
        ) from error
    return saved


def load(entry: Entry, options: Options) -> Policy:
    """Loads the checkpoint; see `rollout_policies.adapters.load`."""
    checkpoint = entry.checkpoint_for(options.suite)
    checkpoint = options.checkpoint or checkpoint
    executed_actions(entry, options, chunk=1, from_checkpoint=1)
    if options.revision is not None:
        raise UnusableOption(
            f"--revision names a commit of the hub, but {entry.title}'s weights are files in its"
            " authors' repository: check out the commit in that repository"
        )
    torch = require("torch", entry)
    package = require("predvla.model", entry)
    home = Path(package.__file__).parents[1]
    file = _checkpoint_file(entry, checkpoint, home)
    correction = require("predvla.er_batch", entry).ERBatch
    saved = _read_checkpoint(torch, file)
    _require_trained_for(options.suite, saved["cfg"], checkpoint)
    network = package.PredVLA(saved["cfg"]).to(options.device).eval()
    load_stored(network, saved["model"], checkpoint)
    for tensor in network.parameters():
        tensor.requires_grad_(False)
    cache = Path(_statistics_path(saved["cfg"]["paths"]["cache_root"], home))
    statistics = sorted(cache.glob("*.npz"))
    if not statistics:
        raise UnusableCheckpoint(
            f"checkpoint {checkpoint} needs the statistics in {cache}, which has none:"
            f" unpack {entry.title}'s feature caches there"
        )
    front = require("predvla.frontend", entry).Frontend(str(cache), device=options.device)
    # An action takes four hundred steps of a small network. Compiled, these steps are several
    # times faster. Like upstream, this function compiles only for CUDA devices.
    compiled = options.device.startswith("cuda")
    if compiled:
        # Variants with and without gradients and states exceed the usual limit, beyond which torch
        # would silently return to the slow path.
        torch._dynamo.config.cache_size_limit = COMPILED_VARIANTS
    model = PredvlaModel(
        network,
        front,
        correction,
        int(saved["cfg"]["data"]["vision_stride"]),
        options.device,
        torch.compile(correction._roll, dynamic=False) if compiled else None,
    )
    return PredVla(
        entry,
        model,
        suite=options.suite,
        checkpoint=checkpoint,
        weights=digest([file]),
        settings={
            "statistics": f"{cache.name} {digest(statistics)[:DIGITS]}",
            **precision(options.device, network),
        },
    )


def _checkpoint_file(entry: Entry, name: str, home: Path) -> Path:
    """Returns a checkpoint's file, local or from the authors' repository."""
    for file in (Path(name).expanduser(), home / name):
        if file.is_file():
            return file
    raise NoCheckpoint(
        f"{entry.title}'s weights are a file, and there is no {name} here nor in {home}; name it"
        " with --checkpoint"
    )


def _require_trained_for(suite: str, config: Mapping[str, Any], checkpoint: str) -> None:
    """Refuses weights that were trained for another suite, which their configuration names."""
    trained = config["data"].get("suite", suite)
    if suite not in trained.split("+"):
        raise UnusableCheckpoint(
            f"checkpoint {checkpoint} was trained for {trained}, and --suite says {suite}"
        )


def _statistics_path(named: str, home: Path) -> str:
    """Returns the path of the front end's statistics. Checkpoints name it relative to a folder
    of their authors, whose contents are in `home` here."""
    path = Path(named)
    if path.is_absolute():
        return str(path)
    return str(home.joinpath(*(part for part in path.parts if part != "..")))
