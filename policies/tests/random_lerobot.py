"""Small policies of lerobot with RANDOM weights, saved as checkpoints.

Their architecture is the real one, reduced in width and depth; their tokeniser knows a few words;
their statistics are synthetic. Their answers are meaningless, but lerobot's unchanged code computes
them.

    python policies/tests/random_lerobot.py smolvla FOLDER"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import PreTrainedTokenizerFast

WORDS = "pick up the butter and place it in basket open drawer Task State Action : ; , ?".split()
#: A fixed seed, so that repeated runs save the same weights.
SEED = 20260914


def visual(side: int = 256) -> PolicyFeature:
    return PolicyFeature(type=FeatureType.VISUAL, shape=(3, side, side))


def state(width: int = 8) -> PolicyFeature:
    return PolicyFeature(type=FeatureType.STATE, shape=(width,))


ACTIONS = {"action": PolicyFeature(type=FeatureType.ACTION, shape=(7,))}


def synthetic_statistics() -> dict[str, dict[str, torch.Tensor]]:
    """Returns statistics for normalisation by mean, by minimum and maximum, and by percentiles."""

    def statistics(width: int, spread: float) -> dict[str, torch.Tensor]:
        bounds = torch.full((width,), spread)
        return {
            "mean": torch.zeros(width),
            "std": bounds / 2,
            "min": -bounds,
            "max": bounds,
            "q01": -bounds,
            "q99": bounds,
        }

    # Actions have a small spread, because random weights leave much of a flow's noise unchanged,
    # and noise exceeds the range of actions, -1..1.
    return {"observation.state": statistics(8, 2.0), "action": statistics(7, 0.5)}


def tokeniser(folder: Path, extra: list[str], **special: str) -> PreTrainedTokenizerFast:
    """Saves a tokeniser with one token per known word into a folder; `special` maps names that
    transformers uses, such as `image_token`, to tokens."""
    tokens = ["<unk>", "<pad>", "<s>", "</s>", "\n", *WORDS, *map(str, range(256)), *extra]
    vocabulary = {token: index for index, token in enumerate(dict.fromkeys(tokens))}
    words = Tokenizer(models.WordLevel(vocabulary, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.Whitespace()
    saved = PreTrainedTokenizerFast(
        tokenizer_object=words,
        unk_token="<unk>",
        pad_token="<pad>",
        bos_token="<s>",
        eos_token="</s>",
        additional_special_tokens=extra,
        **special,
    )
    saved.save_pretrained(folder)
    return saved


def smolvla(folder: Path) -> None:
    """SmolVLA with two layers instead of sixteen, and a tenth of the width."""
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
    from transformers import (
        SmolVLMConfig,
        SmolVLMImageProcessor,
        SmolVLMProcessor,
        SmolVLMVideoProcessor,
    )

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
        # As in the released checkpoint, the third image slot never gets a frame.
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


@contextlib.contextmanager
def small_pi05() -> Iterator[None]:
    """Replaces π0.5's sizes, which are fixed in lerobot's code, by small ones."""
    from lerobot.policies.pi05 import modeling_pi05 as upstream
    from transformers import CONFIG_MAPPING

    def small_paligemma() -> Any:
        config = CONFIG_MAPPING["paligemma"]()
        config.vision_config.num_hidden_layers = 2
        return config

    def with_small_vocabulary(model_class: Callable[..., Any]) -> Callable[..., Any]:
        def create(config: Any) -> Any:
            config.get_text_config().vocab_size = 512
            return model_class(config=config)

        return create

    widths = {"gemma_2b": 2048, "gemma_300m": 256}
    # GemmaConfig takes width, depth, MLP width, heads, key-value heads and width of a head.
    replacements = {
        "get_gemma_config": lambda kind: upstream.GemmaConfig(widths[kind], 2, 512, 8, 1, 256),
        "CONFIG_MAPPING": {"paligemma": small_paligemma, "gemma": CONFIG_MAPPING["gemma"]},
    }
    for name in ("PaliGemmaForConditionalGenerationWithPiGemma", "PiGemmaForCausalLM"):
        replacements[name] = with_small_vocabulary(getattr(upstream, name))
    with mock.patch.multiple(upstream, **replacements):
        yield


def pi05(folder: Path) -> None:
    """π0.5 with two layers in the language models (instead of eighteen) and in the vision encoder
    (instead of twenty-seven), and frames of 56 x 56 instead of 224 x 224."""
    from lerobot.policies.pi05.configuration_pi05 import PI05Config

    words = folder / "words"
    tokeniser(words, [])
    config = PI05Config(
        chunk_size=10,
        n_action_steps=10,
        image_resolution=(56, 56),
        tokenizer_max_length=64,
        input_features={
            "observation.images.image": visual(),
            "observation.images.image2": visual(),
            "observation.images.empty_camera_0": visual(56),
            "observation.state": state(),
        },
        output_features=ACTIONS,
        device="cpu",
    )
    # The tokeniser's name is fixed in lerobot's code, too.
    with_saved_tokeniser = mock.patch(
        "lerobot.policies.pi05.processor_pi05.TokenizerProcessorStep", _with_tokeniser(str(words))
    )
    with small_pi05(), with_saved_tokeniser:
        save(config, folder)


def _with_tokeniser(name: str) -> Callable[..., Any]:
    from lerobot.processor import TokenizerProcessorStep

    def step(**fields: Any) -> Any:
        return TokenizerProcessorStep(**{**fields, "tokenizer_name": name})

    return step


def vla_jepa(folder: Path) -> None:
    """VLA-JEPA without its world model, with two layers and a thirtieth of the width."""
    from lerobot.policies.vla_jepa.configuration_vla_jepa import VLAJEPAConfig
    from transformers import (
        Qwen2VLImageProcessorFast,
        Qwen3VLConfig,
        Qwen3VLForConditionalGeneration,
        Qwen3VLProcessor,
        Qwen3VLVideoProcessor,
    )

    backbone = folder / "backbone"
    marks = ["start", "end"]
    special = [f"<|vision_{mark}|>" for mark in marks] + [f"<|im_{mark}|>" for mark in marks]
    special += ["<|image_pad|>", "<|video_pad|>"]
    # Seven actions of four tokens each, and the token from which actions are computed.
    actions = [*(f"<|action_{index}|>" for index in range(28)), "<|embodied_action|>"]
    words = tokeniser(backbone, [*special, *actions])
    tokens = dict(zip(special, words.convert_tokens_to_ids(special)))
    config = Qwen3VLConfig(
        text_config={
            "hidden_size": 64,
            "intermediate_size": 128,
            "num_hidden_layers": 2,
            "num_attention_heads": 4,
            "num_key_value_heads": 2,
            "head_dim": 16,
            "vocab_size": len(words),
            "rope_scaling": {"rope_type": "default", "mrope_section": [4, 2, 2]},
        },
        vision_config={
            "hidden_size": 32,
            "intermediate_size": 64,
            "depth": 2,
            "num_heads": 2,
            "out_hidden_size": 64,
            "deepstack_visual_indexes": [0],
        },
        image_token_id=tokens["<|image_pad|>"],
        video_token_id=tokens["<|video_pad|>"],
        vision_start_token_id=tokens["<|vision_start|>"],
        vision_end_token_id=tokens["<|vision_end|>"],
    )
    torch.manual_seed(SEED)
    Qwen3VLForConditionalGeneration(config).save_pretrained(backbone)
    Qwen3VLProcessor(
        Qwen2VLImageProcessorFast(patch_size=16),
        words,
        Qwen3VLVideoProcessor(),
        chat_template=(
            "{% for message in messages %}{% for part in message.content %}"
            "{% if part.type == 'image' %}<|vision_start|><|image_pad|><|vision_end|>"
            "{% else %}{{ part.text }}{% endif %}{% endfor %}{% endfor %}"
        ),
    ).save_pretrained(backbone)
    save(
        VLAJEPAConfig(
            qwen_model_name=str(backbone),
            enable_world_model=False,
            torch_dtype="float32",
            action_model_type="DiT-test",
            action_hidden_size=32,
            action_num_layers=2,
            resize_images_to=(224, 224),
            input_features={
                "observation.images.image": visual(),
                "observation.images.image2": visual(),
                "observation.state": state(),
            },
            output_features=ACTIONS,
            device="cpu",
        ),
        folder,
    )


def act(folder: Path) -> None:
    """lerobot's ACT, which averages overlapping chunks. Tests use it in place of MINERVA, whose
    package cannot be installed beside lerobot."""
    from lerobot.configs.types import NormalizationMode
    from lerobot.policies.act.configuration_act import ACTConfig

    modes = {"VISUAL": NormalizationMode.IDENTITY, "STATE": NormalizationMode.MEAN_STD}
    save(
        ACTConfig(
            chunk_size=16,
            n_action_steps=1,
            temporal_ensemble_coeff=0.5,
            normalization_mapping={**modes, "ACTION": NormalizationMode.MEAN_STD},
            pretrained_backbone_weights=None,
            dim_model=64,
            n_heads=2,
            dim_feedforward=64,
            n_encoder_layers=1,
            n_vae_encoder_layers=1,
            input_features={
                "observation.images.image": visual(),
                "observation.images.image2": visual(),
                "observation.state": state(),
            },
            output_features=ACTIONS,
            device="cpu",
        ),
        folder,
    )


def save(config, folder: Path) -> None:
    """Creates a policy with random weights, and saves it with its processors."""
    torch.manual_seed(SEED)
    network = get_policy_class(config.type)(config)
    network.save_pretrained(folder)
    for processor in make_pre_post_processors(config, dataset_stats=synthetic_statistics()):
        processor.save_pretrained(folder)


POLICIES = {"smolvla": smolvla, "pi05": pi05, "vla-jepa": vla_jepa, "act": act}

if __name__ == "__main__":
    POLICIES[sys.argv[1]](Path(sys.argv[2]))
