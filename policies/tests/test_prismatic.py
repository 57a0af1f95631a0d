"""Loading of OpenVLA-OFT and UniVLA, with PyTorch and small replacements for upstream's classes.
Skipped where PyTorch or transformers is not installed.

The replacements load as transformers does: tensors that do not fit stay unchanged."""

import json
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from test_adapters import later_query, observation

torch = pytest.importorskip("torch", reason="PyTorch is not installed")
transformers = pytest.importorskip("transformers", reason="transformers is not installed")
from safetensors.torch import load_file, save_file  # noqa: E402

from rollout_policies.adapters import Options, load, prismatic, univla  # noqa: E402
from rollout_policies.adapters.upstream import UnusableCheckpoint, UpstreamMissing  # noqa: E402
from rollout_policies.catalogue import entry  # noqa: E402

WIDTH = 16
LANGUAGE_MODEL = transformers.LlamaConfig(
    hidden_size=WIDTH, intermediate_size=16, num_hidden_layers=1, num_attention_heads=2,
    num_key_value_heads=2, vocab_size=32,
)  # fmt: skip


class Network(torch.nn.Module):
    """Replaces OpenVLAForActionPrediction. Its answer is one of its weights."""

    def __init__(self):
        super().__init__()
        self.inner = torch.nn.Linear(WIDTH, WIDTH)
        self.vision_backbone = SimpleNamespace(set_num_images_in_input=self.set_image_count)
        self.llm_dim = WIDTH
        self.config = SimpleNamespace(text_config=LANGUAGE_MODEL)

    def set_image_count(self, images):
        self.images = images

    @classmethod
    def from_pretrained(cls, folder, torch_dtype, low_cpu_mem_usage):
        network = cls().to(torch_dtype)
        for file in folder.glob("*.safetensors"):
            network.load_state_dict(load_file(file), strict=False)
        return network

    def predict_action(self, action_head, proprio_projector, pixel_values, proprio, **_):
        tensors = [self.inner.weight, pixel_values, *action_head.parameters()]
        tensors += proprio_projector.parameters()
        assert len({tensor.device for tensor in tensors}) == 1
        return np.full((8, 7), float(self.inner.weight[0, 0])), None


class Processor:
    def __init__(self, images, words):
        pass

    def __call__(self, text, image):
        frames = torch.from_numpy(np.asarray(image)).float()[None]
        return transformers.BatchFeature({"pixel_values": frames})


def module_of(**parts):
    module = ModuleType("upstream")
    vars(module).update(parts)
    return module


@pytest.fixture
def upstream(monkeypatch):
    """Replaces upstream's modules for the duration of a test."""
    image_processor = SimpleNamespace(from_pretrained=lambda folder: None)
    modules = {
        "timm": {},
        "prismatic.extern.hf.modeling_prismatic": {"OpenVLAForActionPrediction": Network},
        "prismatic.extern.hf.processing_prismatic": {
            "PrismaticProcessor": Processor,
            "PrismaticImageProcessor": image_processor,
        },
        "prismatic.vla.constants": {"NUM_ACTIONS_CHUNK": 8},
        "prismatic.models.action_heads": {
            "L1RegressionActionHead": lambda input_dim, hidden_dim, action_dim: torch.nn.Linear(
                input_dim, action_dim
            )
        },
        "prismatic.models.projectors": {
            "ProprioProjector": lambda llm_dim, proprio_dim: torch.nn.Linear(proprio_dim, llm_dim)
        },
    }
    for name, parts in modules.items():
        monkeypatch.setitem(sys.modules, name, module_of(**parts))
    monkeypatch.setattr(transformers.AutoTokenizer, "from_pretrained", lambda folder: None)
    # Reports that tokens attend to later tokens, as in OpenVLA-OFT's own transformers.
    monkeypatch.setattr(prismatic, "_attends_to_later_tokens", lambda *_: True)


@pytest.fixture
def oft(tmp_path, upstream):
    """Makes a small OpenVLA-OFT checkpoint with random weights."""
    torch.manual_seed(1)
    save_file(Network().state_dict(), tmp_path / "model-00001-of-00001.safetensors")
    for part, module in {
        "action_head": torch.nn.Linear(WIDTH, 7),
        "proprio_projector": torch.nn.Linear(8, WIDTH),
    }.items():
        stored = {f"module.{name}": tensor for name, tensor in module.state_dict().items()}
        torch.save(stored, tmp_path / f"{part}--50000_checkpoint.pt")
    numbers = {
        key: {"q01": [-1.0] * width, "q99": [1.0] * width}
        for key, width in (("action", 7), ("proprio", 8))
    }
    statistics = {"libero_goal_no_noops": numbers}
    (tmp_path / "dataset_statistics.json").write_text(json.dumps(statistics))
    return tmp_path


def served(folder, name="openvla-oft", **options):
    given = {"checkpoint": str(folder), "suite": "libero_goal", "device": "cpu", **options}
    return load(name, Options(**given))


def test_all_parts_of_openvla_oft_are_loaded_onto_the_chosen_device(oft):
    policy = served(oft)
    first_query = observation()
    policy.reset(first_query.episode)
    assert (
        policy.infer(first_query).shape == policy.infer(later_query(first_query, 1)).shape == (8, 7)
    )
    assert policy.model.network.images == 2
    settings = policy.description.settings
    assert (settings["device"], settings["precision"]) == ("cpu", "bfloat16")
    assert settings["statistics"].startswith("libero_goal_no_noops: actions QUANTILES ")
    # The device "meta", whose tensors hold no numbers, stands for a device other than upstream's.
    parts = (policy.model.action_head, policy.model.proprio_projector, policy.model.network)
    on_meta = served(oft, device="meta").model
    for part in (on_meta.network, on_meta.action_head, on_meta.proprio_projector):
        assert {tensor.device.type for tensor in part.parameters()} == {"meta"}
    assert {tensor.device.type for part in parts for tensor in part.parameters()} == {"cpu"}


def test_a_network_that_lacks_a_tensor_is_refused(oft):
    [file] = oft.glob("*.safetensors")
    stored = load_file(file)
    del stored["inner.bias"]
    save_file(stored, file)
    with pytest.raises(UnusableCheckpoint, match=r"1 missing in the file \(inner.bias\)"):
        served(oft)


@pytest.mark.parametrize("part", ["action_head", "proprio_projector"])
def test_a_part_that_lacks_a_tensor_is_refused(oft, part):
    file = oft / f"{part}--50000_checkpoint.pt"
    stored = torch.load(file, weights_only=True)
    del stored["module.bias"]
    torch.save(stored, file)
    with pytest.raises(UnusableCheckpoint, match=rf"of {part}: 1 missing in the file \(bias\)"):
        served(oft)


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("noisy_action_projector--1_checkpoint.pt", "was trained with diffusion"),
        ("vision_backbone--1_checkpoint.pt", "was trained with FiLM"),
        ("action_head--2_checkpoint.pt", "has 2 files of its action_head"),
    ],
)
def test_parts_that_are_not_served_are_refused(oft, file, words):
    (oft / file).write_bytes(b"")
    with pytest.raises(UnusableCheckpoint, match=words):
        served(oft)


def test_a_checkpoint_without_proprio_statistics_is_refused(oft):
    file = oft / "dataset_statistics.json"
    statistics = json.loads(file.read_text())
    del statistics["libero_goal_no_noops"]["proprio"]
    file.write_text(json.dumps(statistics))
    with pytest.raises(UnusableCheckpoint, match="no statistics of the state"):
        served(oft)


def test_another_robot_s_chunk_is_refused(oft):
    sys.modules["prismatic.vla.constants"].NUM_ACTIONS_CHUNK = 25
    with pytest.raises(UnusableCheckpoint, match="chunks of 25 actions, but LIBERO needs 8"):
        served(oft)


def test_openvla_oft_refuses_the_standard_transformers(oft, monkeypatch):
    # The standard transformers and OpenVLA-OFT's have the same version number, but a token attends
    # to later tokens only in OpenVLA-OFT's.
    monkeypatch.undo()
    network = Network()
    assert not prismatic._attends_to_later_tokens(network, torch, transformers)
    attention = transformers.models.llama.modeling_llama.LlamaModel.forward

    def without_causal_mask(self, *arguments, **named):
        width = named["inputs_embeds"].shape[1]
        named["attention_mask"] = torch.zeros(1, 1, width, width)
        return attention(self, *arguments, **named)

    monkeypatch.setattr(
        transformers.models.llama.modeling_llama.LlamaModel, "forward", without_causal_mask
    )
    assert prismatic._attends_to_later_tokens(network, torch, transformers)


def test_a_transformers_with_another_attention_is_refused(oft, monkeypatch):
    monkeypatch.setattr(prismatic, "_attends_to_later_tokens", lambda *_: False)
    with pytest.raises(UpstreamMissing, match="does not see later tokens.*environment"):
        served(oft)


class Pool(torch.nn.Linear):
    """Replaces MAPBlock, with other widths."""

    def __init__(self, n_latents, vis_dim, embed_dim, n_heads):
        super().__init__(2, 2)


@pytest.fixture
def univla_checkpoint(oft, monkeypatch):
    """Makes a small UniVLA checkpoint with random weights."""
    monkeypatch.setattr(prismatic, "_attends_to_later_tokens", lambda *_: False)
    pools = module_of(MAPBlock=Pool)
    monkeypatch.setitem(sys.modules, "prismatic.models.policy.transformer_utils", pools)
    torch.save(univla._decoder(entry("univla")).state_dict(), oft / "action_decoder.pt")
    return oft


def test_univla_s_decoder_must_fit_exactly(univla_checkpoint):
    policy = served(univla_checkpoint, "univla")
    assert policy.description.settings["evaluation"] == "upstream"
    file = univla_checkpoint / "action_decoder.pt"
    stored = torch.load(file, weights_only=True)
    stored["extra"] = stored.pop("visual_pool.bias")
    torch.save(stored, file)
    with pytest.raises(UnusableCheckpoint, match="of the decoder: .*visual_pool.bias.*extra"):
        served(univla_checkpoint, "univla")
    file.unlink()
    with pytest.raises(UnusableCheckpoint, match="no action_decoder.pt.*pre-trained"):
        served(univla_checkpoint, "univla")


def test_univlas_random_numbers_continue_across_queries(univla_checkpoint):
    model = univla.UnivlaModel(
        SimpleNamespace(
            predict_latent_action=lambda **_: (
                torch.rand(1, 4, WIDTH),
                torch.rand(1, 1, WIDTH),
                torch.randint(32001, 32033, (1, 4)),
            )
        ),
        Processor(None, None),
        lambda latent, visual: latent.new_zeros(1, 84),
        "cpu",
    )
    pixels = np.zeros((4, 4, 3), dtype=np.uint8)

    def draw_tokens(generator):
        _, tokens, state_afterwards = model.chunk(pixels, "text", generator)
        return tokens, state_afterwards

    first, after_first = draw_tokens(7)
    second, _ = draw_tokens(after_first)
    torch.rand(1)
    assert draw_tokens(7)[0] == first != second
    assert draw_tokens(after_first)[0] == second
