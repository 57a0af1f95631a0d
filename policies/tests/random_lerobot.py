"""Small policies of lerobot with RANDOM weights, saved as checkpoints.

Their architecture is the real one, reduced in width and depth; their tokeniser
knows a few words; their statistics are made up. They answer nonsense, through
all of the real code.

    python policies/tests/random_lerobot.py smolvla FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import PreTrainedTokenizerFast

WORDS = "pick up the butter and place it in basket open drawer Task State Action : ; , ?".split()
#: A seed, so that two folders made alike hold the same weights.
SEED = 20260914


def visual(side: int = 256) -> PolicyFeature:
    return PolicyFeature(type=FeatureType.VISUAL, shape=(3, side, side))


def state(width: int = 8) -> PolicyFeature:
    return PolicyFeature(type=FeatureType.STATE, shape=(width,))


ACTIONS = {"action": PolicyFeature(type=FeatureType.ACTION, shape=(7,))}


def made_up_statistics() -> dict[str, dict[str, torch.Tensor]]:
    """Numbers of every kind that lerobot's normalisation may ask for."""

    def of(width: int, spread: float) -> dict[str, torch.Tensor]:
        ends = torch.full((width,), spread)
        return {
            "mean": torch.zeros(width),
            "std": ends / 2,
            "min": -ends,
            "max": ends,
            "q01": -ends,
            "q99": ends,
        }

    return {"observation.state": of(8, 2.0), "action": of(7, 1.0)}


def tokeniser(folder: Path, extra: list[str], **special: str) -> PreTrainedTokenizerFast:
    """One token per known word, saved into a folder; `special` names tokens
    that the tokeniser is asked for by name."""
    tokens = ["<unk>", "<pad>", "<s>", "</s>", "\n", *WORDS, *map(str, range(256)), *extra]
    vocabulary = {token: index for index, token in enumerate(dict.fromkeys(tokens))}
    words = Tokenizer(models.WordLevel(vocabulary, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    made = PreTrainedTokenizerFast(
        tokenizer_object=words,
        unk_token="<unk>",
        pad_token="<pad>",
        bos_token="<s>",
        eos_token="</s>",
        additional_special_tokens=extra,
        **special,
    )
    made.save_pretrained(folder)
    return made


def smolvla(folder: Path) -> None:
    """SmolVLA: two layers in place of sixteen, a tenth of the width."""
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
    from transformers import SmolVLMConfig, SmolVLMImageProcessor, SmolVLMProcessor
    from transformers import SmolVLMVideoProcessor

    backbone = folder / "backbone"
    special = ["<fake_token_around_image>", "<image>", "<global-img>", "<end_of_utterance>"]
    words = tokeniser(
        backbone,
        [*special, "<video>"],
        fake_image_token=special[0],
        image_token=special[1],
        global_image_token=special[2],
    )
    SmolVLMConfig(
        text_config={
            "model_type": "llama",
            "hidden_size": 96,
            "intermediate_size": 256,
            "num_hidden_layers": 2,
            "num_attention_heads": 3,
            "num_key_value_heads": 1,
            "head_dim": 32,
            "vocab_size": len(words),
        },
        vision_config={
            "hidden_size": 64,
            "intermediate_size": 128,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "image_size": 512,
            "patch_size": 64,
        },
        scale_factor=2,
        image_token_id=words.convert_tokens_to_ids("<image>"),
    ).save_pretrained(backbone)
    SmolVLMProcessor(
        SmolVLMImageProcessor(), words, SmolVLMVideoProcessor(), image_seq_len=16
    ).save_pretrained(backbone)
    config = SmolVLAConfig(
        vlm_model_name=str(backbone),
        num_vlm_layers=2,
        # As in the released checkpoint: a third camera that never comes.
        input_features={
            "observation.images.camera1": visual(),
            "observation.images.camera2": visual(),
            "observation.images.camera3": visual(),
            "observation.state": state(6),
        },
        output_features=ACTIONS,
        device="cpu",
    )
    save(config, folder)


def save(config, folder: Path) -> None:
    """Draws weights and saves them with their processors."""
    torch.manual_seed(SEED)
    network = get_policy_class(config.type)(config)
    network.save_pretrained(folder)
    for processor in make_pre_post_processors(config, dataset_stats=made_up_statistics()):
        processor.save_pretrained(folder)


POLICIES = {"smolvla": smolvla}

if __name__ == "__main__":
    POLICIES[sys.argv[1]](Path(sys.argv[2]))
