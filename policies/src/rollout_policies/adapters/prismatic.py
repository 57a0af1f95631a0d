"""Code shared by OpenVLA's descendants, whose checkpoints are folders in transformers' format. Each
policy's repository has its own version of the package `prismatic`, which reads them.

Upstream's helpers place everything on the first GPU, query the hub for every path and write into
the checkpoint's folder. This module therefore assembles the parts from upstream's classes."""

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
    """Returns the prompt that the language model completes."""
    return f"In: What action should the robot take to {instruction.lower()}?\nOut:"


def statistics_key(suite: str, all_statistics: Mapping[str, Any]) -> str:
    """Returns the key of a suite's statistics. OpenVLA's data sets are named `libero_goal_no_noops`
    if steps without motion were removed.

    Raises UnusableCheckpoint if there are none."""
    for key in (suite, f"{suite}_no_noops"):
        if key in all_statistics:
            return key
    raise UnusableCheckpoint(
        f"the checkpoint has no statistics of {suite}; it has those of"
        f" {', '.join(all_statistics) or 'no suite'}"
    )


def statistics_in(folder: Path, suite: str) -> tuple[dict[str, Any], str, str]:
    """Returns all statistics beside a checkpoint, a suite's key in them, and a short text on how
    its actions are un-normalised.

    Raises UnusableCheckpoint if the suite's actions have no statistics."""
    file = folder / STATISTICS
    if not file.is_file():
        raise UnusableCheckpoint(
            f"checkpoint {folder} has no {STATISTICS}, without which its actions mean nothing:"
            " it was not fine-tuned on LIBERO, or the file was not copied"
        )
    # The statistics in the configuration are those of the pre-training.
    all_statistics = json.loads(file.read_text("utf-8"))
    key = statistics_key(suite, all_statistics)
    actions = all_statistics[key].get("action", {})
    summary = require_statistics("actions", "QUANTILES", actions, ACTION_WIDTH)
    return all_statistics, key, f"{key}: {summary}"


def load_network(
    entry: Entry, folder: Path, checkpoint: str, device: str, *, causal: bool
) -> tuple[Any, Any]:
    """Returns the network in bfloat16 and the processor of its inputs.

    `causal` says that the network's language model was trained with causal attention: a token does
    not see later ones. Raises UnusableCheckpoint if weights are missing, UpstreamMissing if the
    installed transformers is not the policy's."""
    # timm must be imported before TensorFlow, which upstream imports: the reverse order has crashed
    # the process.
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
    if _attends_to_later_tokens(network, torch, transformers) == causal:
        raise UpstreamMissing(
            f"the installed transformers ({transformers.__version__}) is not the one that"
            f" {entry.title} needs: in its language models a token"
            f" {'sees' if causal else 'does not see'} later tokens. OpenVLA-OFT has its own"
            f" transformers, with the same version number; install in a separate environment:"
            f" {entry.install}"
        )
    processor = processing.PrismaticProcessor(
        processing.PrismaticImageProcessor.from_pretrained(folder),
        transformers.AutoTokenizer.from_pretrained(folder),
    )
    return network.to(device).eval(), processor


def _attends_to_later_tokens(network: Any, torch: Any, transformers: Any) -> bool:
    """Returns True if a token's output depends on later tokens, in a small
    language model of the network's kind."""
    config = copy.deepcopy(network.config.text_config)
    small = {"hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1, "vocab_size": 8}
    for name, value in {**small, "num_attention_heads": 1, "num_key_value_heads": 1}.items():
        setattr(config, name, value)
    config.pad_token_id = None
    with torch.random.fork_rng(devices=[]), torch.inference_mode():
        model = transformers.AutoModelForCausalLM.from_config(config).float().eval()
        tokens = torch.randn(1, 3, 8)
        other_end = torch.cat([tokens[:, :2], torch.randn(1, 1, 8)], dim=1)
        mask = torch.ones(1, 3, dtype=torch.long)
        first, second = (
            model(inputs_embeds=inputs, attention_mask=mask).logits[:, 0]
            for inputs in (tokens, other_end)
        )
    return not torch.equal(first, second)
