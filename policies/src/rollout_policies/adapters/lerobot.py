"""Code shared by the policies that lerobot runs.

Only `LerobotModel` uses lerobot and torch. lerobot's own processors normalise, tokenise, resize and
un-normalise, with the statistics stored beside the checkpoint; this module does not repeat that
processing. It refuses two faults that lerobot ignores silently: weights that do not fit, and
missing statistics."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..catalogue import Entry
from ..description import Camera
from ..episode import Observation, UnderWay
from ..processing.images import unit_planes
from ..processing.robot import STATE_FIELDS, state_vector
from . import Options
from .cameras import ROLES, camera_of_slot, short
from .fetch import fetch, naming_downloads
from .statistics import ACTION_WIDTH, STATE_WIDTH, require_statistics
from .upstream import UnusableCheckpoint, digest, precision, require
from .weights import COMPUTED, Exceptions, require_loaded, stored_in

STATE, ACTION = "observation.state", "action"
WEIGHTS, CONFIG, PREPROCESSOR = "model.safetensors", "config.json", "policy_preprocessor.json"
#: Contents of the state vector, in order.
STATE_CONTENT = "eef_pos, eef_axis_angle, gripper_pos"
#: Policies that can run with an empty image slot; others fail at the first query.
LEAVE_SLOTS_EMPTY = ("smolvla", "pi05")
_LANGUAGE_MODEL = "model.paligemma_with_expert.paligemma"
#: Permitted differences of the weights, by lerobot's policy type.
EXCEPTIONS = {
    # The released checkpoint's file holds one of the tied tensors, and lerobot copies it. The heads
    # of both language models are never used.
    "pi05": Exceptions(
        tied={
            f"{_LANGUAGE_MODEL}.model.language_model.embed_tokens.weight": (
                f"{_LANGUAGE_MODEL}.lm_head.weight"
            )
        },
        unused=(
            f"{_LANGUAGE_MODEL}.lm_head.weight",
            "model.paligemma_with_expert.gemma_expert.lm_head.weight",
        ),
    ),
    "smolvla": Exceptions(unused=("model.vlm_with_expert.vlm.lm_head.weight",)),
    # The world model is used in training only.
    "vla_jepa": Exceptions(
        tied={
            "model.qwen.model.model.language_model.embed_tokens.weight": (
                "model.qwen.model.lm_head.weight"
            )
        },
        skipped=(*COMPUTED, "model.video_encoder.*", "model.video_predictor.*"),
    ),
}


def batch_of(
    observations: Sequence[Observation], slots: Mapping[str, str], with_state: bool = True
) -> dict[str, Any]:
    """Returns observations in the form that lerobot's processors take.

    Frames are float32 [batch, 3, height, width] in 0..1, turned by 180 degrees; the state is
    float32 [batch, 8] whatever width the checkpoint declares; the instructions are verbatim."""
    batch: dict[str, Any] = {
        slot: np.stack([unit_planes(each.rotated(camera)) for each in observations])
        for slot, camera in slots.items()
    }
    if with_state:
        batch[STATE] = np.stack([state_vector(each) for each in observations]).astype(np.float32)
    batch["task"] = [each.episode.instruction for each in observations]
    return batch


@dataclass
class LerobotModel:
    """A lerobot policy with the processors of its inputs and of its actions."""

    network: Any
    preprocessor: Any
    postprocessor: Any
    #: The camera of each image slot.
    slots: dict[str, str]
    with_state: bool
    checkpoint: str
    checkpoint_digest: str
    #: Resolved settings, for the policy's description.
    settings: dict[str, str] = field(default_factory=dict)

    @classmethod
    def load(
        cls, entry: Entry, options: Options, *, kind: str | None = None, **overrides: Any
    ) -> LerobotModel:
        """Loads a checkpoint of lerobot's policy type `kind` (of any type if None) from a folder or
        the hub; `overrides` replaces values of the checkpoint's configuration. Raises
        UnusableCheckpoint if the policy would not run as it was trained."""
        name = options.checkpoint or entry.checkpoint_for(options.suite)
        configs = require("lerobot.configs.policies", entry)
        factory = require("lerobot.policies.factory", entry)
        fetched = fetch(entry, name, options.revision)
        folder = fetched.folder
        _require_files(folder, name)
        config = configs.PreTrainedConfig.from_pretrained(str(folder))
        unknown = [name for name in overrides if not hasattr(config, name)]
        if unknown or kind not in (None, config.type):
            raise UnusableCheckpoint(
                f"checkpoint {name} is a policy of kind {config.type!r}, not {entry.title};"
                " name another with --checkpoint"
            )
        config.device = options.device
        config.pretrained_path = str(folder)
        for attribute, value in overrides.items():
            setattr(config, attribute, value)
        steps = json.loads((folder / PREPROCESSOR).read_text("utf-8"))["steps"]
        slots = _slots(config, steps, options.image_keys)
        with naming_downloads(_downloads(entry, config, steps)):
            network = factory.get_policy_class(config.type).from_pretrained(
                str(folder), config=config
            )
            preprocessor, postprocessor = factory.make_pre_post_processors(
                config,
                pretrained_path=str(folder),
                preprocessor_overrides={
                    "device_processor": {"device": options.device},
                    # Frames are put into the checkpoint's own slots: nothing is renamed.
                    "rename_observations_processor": {"rename_map": {}},
                },
            )
        network.to(options.device).eval()
        _require_weights(network, folder / WEIGHTS, name)
        with_state = STATE in config.input_features
        statistics = _statistics(config, preprocessor, postprocessor, slots, with_state)
        sources = {slot: slots.get(slot, "nothing") for slot in config.image_features}
        settings = {
            "image slots": ", ".join(f"{short(slot)}={sources[slot]}" for slot in sorted(sources)),
            "state slots": f"{STATE}={STATE_CONTENT}" if with_state else "none",
            "statistics": "; ".join(statistics),
            "lerobot": getattr(require("lerobot", entry), "__version__", "unknown"),
            **precision(options.device, network),
            **fetched.settings,
        }
        return cls(
            network,
            preprocessor,
            postprocessor,
            slots,
            with_state,
            name,
            digest([folder / CONFIG, folder / WEIGHTS]),
            settings,
        )

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras that the policy uses, the scene's first."""
        return tuple(Camera(name) for name in ROLES.values() if name in self.slots.values())

    @property
    def fields(self) -> tuple[Any, ...]:
        """The readings that make up the state."""
        return STATE_FIELDS if self.with_state else ()

    @property
    def config(self) -> Any:
        return self.network.config

    @property
    def parameters(self) -> int:
        return sum(parameter.numel() for parameter in self.network.parameters())

    @property
    def chunks_in_real_time(self) -> bool:
        """True if chunks can continue the actions that are executed during inference."""
        config = getattr(self.config, "rtc_config", None)
        return config is not None and config.enabled

    def enable_real_time_chunking(self) -> None:
        """Enables real-time chunking if lerobot's policy supports it: guidance of the flow makes a
        chunk continue the actions that are executed during inference. Uses the checkpoint's
        settings, else lerobot's. Answers to queries without such actions keep the same bits."""
        if not hasattr(self.config, "rtc_config") or not hasattr(
            self.network, "init_rtc_processor"
        ):
            return
        if self.config.rtc_config is None:
            from lerobot.policies.rtc.configuration_rtc import RTCConfig

            self.config.rtc_config = RTCConfig()
        self.config.rtc_config.enabled = True
        self.network.init_rtc_processor()

    def chunks(
        self,
        observations: Sequence[Observation],
        noise: np.ndarray | None = None,
        under_way: UnderWay | None = None,
    ) -> np.ndarray:
        """Returns chunks of actions, un-normalised, [batch, n, 7].

        `noise` is the flow's initial noise, [batch, n, width]; without it the network draws from
        torch's generator. `under_way` has the actions that are executed during inference; the batch
        must then hold one query, whose chunk continues them."""
        import torch

        batch = self._prepared(observations, under_way)
        arguments: dict[str, Any] = {}
        if noise is not None:
            device = next(self.network.parameters()).device
            arguments["noise"] = torch.from_numpy(noise.astype(np.float32)).to(device)
        if under_way is not None:
            # The actions are normalised and start at this observation's step, as lerobot requires
            # of the last chunk's actions that are not executed yet.
            arguments["prev_chunk_left_over"] = batch.pop(ACTION)
            arguments["inference_delay"] = under_way.delay
            guided_steps = self.config.rtc_config.execution_horizon
            arguments["execution_horizon"] = max(guided_steps, under_way.delay)
        # Guidance needs a gradient, which inference mode does not compute.
        with torch.inference_mode() if under_way is None else torch.no_grad():
            chunks = self.network.predict_action_chunk(batch, **arguments)
            flat = self.postprocessor(chunks.reshape(-1, chunks.shape[-1]))
        return flat.float().cpu().numpy().reshape(tuple(chunks.shape[:2]) + (-1,))

    def seed(self, seed: int) -> None:
        """Seeds torch's generators."""
        import torch

        torch.manual_seed(seed)

    def fresh_memory(self) -> dict[str, Any]:
        """Resets the network, and returns a copy of the state that it keeps between an
        episode's queries: all attributes except the weights and the configuration."""
        import torch

        self.network.reset()
        attributes = vars(self.network)
        excluded = {"config", *vars(torch.nn.Module())}
        return copy.deepcopy({key: attributes[key] for key in attributes if key not in excluded})

    def act(self, observation: Observation, memory: dict[str, Any]) -> np.ndarray:
        """Returns the next action [7] of an episode and advances its memory.

        lerobot's network holds the action queues of one episode; here each call first puts the
        queues of its own episode into the network."""
        import torch

        vars(self.network).update(memory)
        with torch.inference_mode():
            action = self.postprocessor(self.network.select_action(self._prepared([observation])))
        memory.update({key: vars(self.network)[key] for key in memory})
        return action.float().cpu().numpy()[0]

    def _prepared(
        self, observations: Sequence[Observation], under_way: UnderWay | None = None
    ) -> dict[str, Any]:
        import torch

        batch = batch_of(observations, self.slots, self.with_state)
        if under_way is not None:
            # lerobot's processor normalises actions in a batch, as in training.
            scheduled = under_way.actions[: self.config.chunk_size]
            batch[ACTION] = np.array(scheduled, dtype=np.float32)[np.newaxis]
        return self.preprocessor(
            {
                key: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
                for key, value in batch.items()
            }
        )


def _require_files(folder: Path, name: str) -> None:
    """Refuses a folder that lacks the files of a policy's checkpoint."""
    lacking = [file for file in (CONFIG, WEIGHTS, PREPROCESSOR) if not (folder / file).is_file()]
    if not lacking:
        return
    remedy = "name a folder that lerobot's save_pretrained wrote"
    if (folder / "adapter_config.json").is_file():
        remedy = "it is a LoRA without its base model: merge it into the model and save the result"
    elif (folder / "pretrained_model").is_dir():
        remedy = f"name {folder / 'pretrained_model'}"
    elif lacking == [PREPROCESSOR]:
        remedy = (
            "it was saved before lerobot kept statistics in separate files: convert it with"
            " python -m lerobot.processor.migrate_policy_normalization"
        )
    raise UnusableCheckpoint(f"checkpoint {name} has no {' and no '.join(lacking)}; {remedy}")


def _slots(
    config: Any, steps: Sequence[Mapping[str, Any]], image_keys: Mapping[str, str] | None
) -> dict[str, str]:
    """Returns the camera of each image slot. Slots may be empty only if the policy permits it."""
    renamed = {
        source: slot
        for step in steps
        for source, slot in step.get("config", {}).get("rename_map", {}).items()
    }
    declared = list(config.image_features)
    slots = camera_of_slot(declared, image_keys, renamed)
    empty = [short(slot) for slot in declared if slot not in slots]
    if empty and config.type not in LEAVE_SLOTS_EMPTY:
        raise UnusableCheckpoint(
            f"the checkpoint needs an image in every slot, and LIBERO has none for"
            f" {', '.join(empty)}: it was trained with other cameras"
        )
    return slots


def _downloads(entry: Entry, config: Any, steps: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Returns the downloads from the hub that loading a checkpoint requires, by
    name. They may differ from those of the released checkpoint."""
    named = {getattr(config, name, None) for name in ("vlm_model_name", "qwen_model_name")}
    named |= {step.get("config", {}).get("tokenizer_name") for step in steps}
    names = sorted(name for name in named if name and not Path(name).is_dir())
    return {name: entry.downloads.get(name, "the checkpoint names it") for name in names}


def _require_weights(network: Any, weights: Path, name: str) -> None:
    tensors = network.state_dict()

    def rename(stored: str) -> str:
        # lerobot's pi05 loader also accepts openpi's names, which have no prefix and differ for two
        # layers.
        renamed_layer = stored.replace("action_time_mlp_", "time_mlp_")
        candidates = (stored, f"model.{stored}", f"model.{renamed_layer}")
        return next((candidate for candidate in candidates if candidate in tensors), stored)

    with stored_in([weights], rename) as stored:
        require_loaded(network, stored, name, EXCEPTIONS.get(network.config.type, Exceptions()))


def _statistics(
    config: Any, preprocessor: Any, postprocessor: Any, slots: Mapping[str, str], with_state: bool
) -> list[str]:
    """Returns a short text for each normalised feature and its statistics. Raises
    UnusableCheckpoint if the actions are relative to the state or of another width, or if
    statistics are missing: lerobot would leave such a feature's numbers unchanged."""
    relative_steps = [step for step in preprocessor.steps if _is_of_type(step, "Relative")]
    if any(getattr(step, "enabled", False) for step in relative_steps):
        raise UnusableCheckpoint(
            "the checkpoint's actions are relative to the state (use_relative_actions), and"
            " this server passes actions to LIBERO's robot unchanged"
        )
    width = config.action_feature.shape[0]
    if width != ACTION_WIDTH:
        raise UnusableCheckpoint(
            f"the checkpoint's actions are {width} numbers, and LIBERO's are {ACTION_WIDTH}:"
            " it was trained for another robot, or for none"
        )
    summaries = [
        _feature_summary(ACTION, "ACTION", config, postprocessor, "Unnormalizer", ACTION_WIDTH)
    ]
    if with_state:
        summaries.append(
            _feature_summary(STATE, "STATE", config, preprocessor, "Normalizer", STATE_WIDTH)
        )
    images = [
        _feature_summary(slot, "VISUAL", config, preprocessor, "Normalizer")
        for slot in sorted(slots)
    ]
    return summaries + [text for text in images if not text.endswith("not normalised")]


def _feature_summary(
    key: str, kind: str, config: Any, pipeline: Any, step_name: str, width: int | None = None
) -> str:
    """Returns the summary of one feature's statistics, from `require_statistics`."""
    title = {"ACTION": "actions", "STATE": "the state"}.get(kind, f"images of {short(key)}")
    config_modes = {
        _enum_value(feature_type): _enum_value(mode)
        for feature_type, mode in config.normalization_mapping.items()
    }
    mode = config_modes.get(kind, "IDENTITY")
    statistics: dict[str, Any] = {}
    for step in pipeline.steps:
        # A step normalises every action, but of the observation's features only those that it
        # lists.
        if _is_of_type(step, step_name) and (kind == "ACTION" or key in step.features):
            step_modes = {
                _enum_value(feature_type): _enum_value(mode)
                for feature_type, mode in step.norm_map.items()
            }
            mode = step_modes.get(kind, mode)
            for name, tensor in step.state_dict().items():
                feature, _, statistic = name.rpartition(".")
                if feature == key:
                    statistics[statistic] = tensor.float().cpu().numpy()
    return require_statistics(title, mode, statistics, width)


def _is_of_type(step: Any, prefix: str) -> bool:
    return type(step).__name__.startswith(prefix)


def _enum_value(value: Any) -> str:
    """Returns an enumeration's value. Configurations may also hold the value as plain text."""
    return str(getattr(value, "value", value))
