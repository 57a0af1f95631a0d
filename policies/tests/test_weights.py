"""Comparison of a network with its files, tensor by tensor, in both directions."""

import numpy as np
import pytest

from rollout_policies.adapters import weights
from rollout_policies.adapters.upstream import UnusableCheckpoint
from rollout_policies.adapters.weights import Exceptions, compare

NO_EXCEPTIONS = Exceptions()


def compare_arrays(network, stored, exceptions=NO_EXCEPTIONS):
    return compare(network, stored, np.array_equal, exceptions)


def tensors(**shapes):
    return {name: np.full(shape, len(name)) for name, shape in shapes.items()}


def test_equal_tensors_have_no_differences():
    network = tensors(weight=(3, 4), bias=(3,))
    assert str(compare_arrays(network, dict(reversed(network.items())))) == ""


def test_every_kind_of_difference_is_named():
    network = tensors(missing=(2,), shape=(2, 3), content=(2,), same=(4,))
    stored = {**tensors(unknown=(2,), shape=(3, 2), same=(4,)), "content": np.zeros(2)}
    differences = compare_arrays(network, stored)
    assert differences.missing == ["missing"]
    assert differences.unknown == ["unknown"]
    assert differences.shape == ["shape: [2, 3], in the file [3, 2]"]
    assert differences.content == ["content"]


def test_the_first_differences_and_their_number_are_shown():
    network = tensors(**{f"layer{index}": (1,) for index in range(9)})
    assert str(compare_arrays(network, {})) == "9 missing in the file (layer0, layer1, layer2, ...)"


def test_tied_tensors_are_compared_under_either_name():
    tied = Exceptions(tied={"embed": "head"})
    both_names, head_only = tensors(embed=(2,), head=(2,)), {"head": np.full(2, 5)}
    both_names["head"] = both_names["embed"]
    assert str(compare_arrays(both_names, head_only, tied)) == ""
    assert str(compare_arrays({"embed": np.full(2, 5)}, both_names, tied)) == ""
    # The network's "embed" must equal the file's "head".
    differing = {**both_names, "embed": np.zeros(2)}
    assert compare_arrays(differing, head_only, tied).content == ["embed"]
    assert compare_arrays(both_names, head_only).missing == ["embed"]


def test_unused_and_skipped_tensors_may_be_missing_on_one_side():
    exceptions = Exceptions(unused=("*.head",), skipped=("video.*",))
    network, stored = tensors(a=(1,)), tensors(a=(1,))
    network["text.head"], stored["video.encoder"] = np.ones(1), np.ones(1)
    assert str(compare_arrays(network, stored, exceptions)) == ""
    assert compare_arrays(network, stored).missing == ["text.head"]
    assert compare_arrays(network, stored).unknown == ["video.encoder"]
    computed = {**tensors(a=(1,)), "text.rotary_emb.inv_freq": np.ones(1)}
    assert str(compare_arrays(tensors(a=(1,)), computed)) == ""
    # Different content is still refused.
    differing = {**stored, "text.head": np.zeros(1)}
    assert compare_arrays(network, differing, exceptions).content == ["text.head"]


def torch_network():
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    torch.manual_seed(1)
    network = torch.nn.Sequential(torch.nn.Linear(300, 50), torch.nn.BatchNorm1d(50))
    return torch, network.to(torch.bfloat16)


@pytest.mark.parametrize("count", [1, 7_000, 1 << 24])
def test_files_are_compared_in_parts_of_any_size(tmp_path, monkeypatch, count):
    _, network = torch_network()
    from safetensors.torch import save_file

    monkeypatch.setattr(weights, "COMPARED_NUMBERS", count)
    file = tmp_path / "model.safetensors"
    # Files may have a higher precision than the network.
    stored = {f"old.{name}": tensor.float() for name, tensor in network.state_dict().items()}
    stored["old.0.weight"] += 1e-6 * stored["old.0.weight"]
    save_file(stored, file)

    def require_loaded():
        with weights.stored_in([file], lambda name: name.removeprefix("old.")) as renamed:
            weights.require_loaded(network, renamed, "mine")

    require_loaded()
    stored["old.0.weight"][-1, -1] += 1
    save_file(stored, file)
    with pytest.raises(UnusableCheckpoint, match=r"1 with other content \(0.weight\)"):
        require_loaded()


def test_a_file_is_never_read_whole(tmp_path, monkeypatch):
    _, network = torch_network()
    from safetensors.torch import save_file

    save_file(network.state_dict(), tmp_path / "model.safetensors")
    monkeypatch.setattr(weights, "COMPARED_NUMBERS", 3_000)
    largest = 0
    inner = weights._StoredTensor.__getitem__

    def watched(self, rows):
        nonlocal largest
        part = inner(self, rows)
        largest = max(largest, part.numel())
        return part

    monkeypatch.setattr(weights._StoredTensor, "__getitem__", watched)
    with weights.stored_in(tmp_path.glob("*.safetensors")) as stored:
        weights.require_loaded(network, stored, "mine")
    assert 0 < largest <= 3_000


def test_parts_that_an_adapter_loads_must_fit_exactly():
    torch, network = torch_network()
    stored = {name: tensor.clone() + 1 for name, tensor in network.state_dict().items()}
    weights.load_stored(network, stored, "mine", "the decoder")
    assert torch.equal(network[0].weight, stored["0.weight"])
    del stored["0.bias"]
    stored["extra"] = torch.zeros(1)
    stored["1.weight"] = torch.zeros(49)
    with pytest.raises(UnusableCheckpoint) as refused:
        weights.load_stored(network, stored, "mine", "the decoder")
    for words in ("checkpoint mine", "of the decoder", "(0.bias)", "(extra)", "1.weight: [50]"):
        assert words in str(refused.value)
