"""What OpenVLA's descendants have in common: a folder of transformers', which
their own clone of `prismatic` reads.

Upstream's helpers place everything on the first card, ask the hub about every
path and write into the checkpoint's folder; so the parts are put together here,
from upstream's classes.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..catalogue import Entry
from .statistics import ACTION_WIDTH, require_statistics
from .upstream import UnusableCheckpoint, UpstreamMissing, require
from .weights import require_loaded, stored_in

STATISTICS = "dataset_statistics.json"


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


def statistics_in(folder: Path, suite: str) -> tuple[dict[str, Any], str, str]:
    """All statistics beside a checkpoint, the key of a suite's, and how its
    actions are un-normalised, in short.

    Raises UnusableCheckpoint if a suite's actions have none.
    """
    file = folder / STATISTICS
    if not file.is_file():
        raise UnusableCheckpoint(
            f"checkpoint {folder} has no {STATISTICS}, without which its actions mean nothing:"
            " it was not fine-tuned on LIBERO, or the file was left behind"
        )
    # What the configuration holds are the pre-training's.
    everything = json.loads(file.read_text("utf-8"))
    key = statistics_of(suite, everything)
    actions = everything[key].get("action", {})
    brief = require_statistics("actions", "QUANTILES", actions, ACTION_WIDTH)
    return everything, key, f"{key}: {brief}"


def load_network(
    entry: Entry, folder: Path, checkpoint: str, device: str, *, causal: bool
) -> tuple[Any, Any]:
    """The network in bfloat16, and the processor of its inputs.

    `causal` is how its language model was trained: whether a token sees the later
    ones, too. Raises UnusableCheckpoint if weights are missing, UpstreamMissing if
    the installed transformers is another one than the policy's.
    """
    # timm must come before TensorFlow, which upstream imports: the other way
    # round, importing it has been seen to crash the process.
    require("timm", entry)
    torch = require("torch", entry)
    transformers = require("transformers", entry)
    modeling = require("prismatic.extern.hf.modeling_prismatic", entry)
    processing = require("prismatic.extern.hf.processing_prismatic", entry)
    network = modeling.OpenVLAForActionPrediction.from_pretrained(
        folder, torch_dtype=torch.bfloat16, low_cpu_mem_usage=True
    )
    with stored_in(folder.glob("*.safetensors")) as stored:
        require_loaded(network, stored, checkpoint)
    if _sees_ahead(network, torch, transformers) == causal:
        raise UpstreamMissing(
            f"the transformers that is installed ({transformers.__version__}) is another one than"
            f" {entry.title}'s: in its language models a token"
            f" {'sees' if causal else 'does not see'} the tokens behind it. OpenVLA-OFT brings a"
            f" transformers of its own, of the same version; install in an environment by itself:"
            f" {entry.install}"
        )
    processor = processing.PrismaticProcessor(
        processing.PrismaticImageProcessor.from_pretrained(folder),
        transformers.AutoTokenizer.from_pretrained(folder),
    )
    return network.to(device).eval(), processor


def _sees_ahead(network: Any, torch: Any, transformers: Any) -> bool:
    """Whether a token's output depends on later tokens, in a small language model
    of the network's kind."""
    config = copy.deepcopy(network.config.text_config)
    small = {"hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1, "vocab_size": 8}
    for name, value in {**small, "num_attention_heads": 1, "num_key_value_heads": 1}.items():
        setattr(config, name, value)
    config.pad_token_id = None
    with torch.random.fork_rng(devices=[]), torch.inference_mode():
        model = transformers.AutoModelForCausalLM.from_config(config).float().eval()
        one = torch.randn(1, 3, 8)
        other = torch.cat([one[:, :2], torch.randn(1, 1, 8)], dim=1)
        first, second = (
            model(inputs_embeds=each, attention_mask=torch.ones(1, 3, dtype=torch.long)).logits[
                :, 0
            ]
            for each in (one, other)
        )
    return not torch.equal(first, second)
