"""The network's output shapes, and the conversion of its inputs."""

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import numpy as np

from training.network import Network, parameters, to_actions
from training.observations import instruction_rows, rotation, scaled, shrink


@pytest.fixture(scope="module")
def network() -> Network:
    torch.manual_seed(0)
    network = Network().eval()
    torch.nn.init.normal_(network.words.weight)
    return network


def queries(n: int) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(1)
    pictures = torch.rand(2, n, 3, 128, 128, generator=generator) * 2 - 1
    state = torch.randn(n, 14, generator=generator)
    rows, present = instruction_rows(["turn on the stove", "put the bowl on the plate", "stop"][:n])
    return pictures[0], pictures[1], state, torch.from_numpy(rows), torch.from_numpy(present)


def test_the_network_has_fewer_than_two_million_parameters(network: Network) -> None:
    assert parameters(network) == 1_976_184


def test_the_networks_tensors_are_those_of_the_weights_file(network: Network) -> None:
    shapes = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    assert shapes["words.weight"] == (4096, 48)
    assert shapes["wrist.stem.conv.weight"] == (32, 3, 3, 3)
    assert shapes["agentview.block2.film.weight"] == (192, 128)
    assert shapes["agentview.block3.skip.weight"] == (128, 96, 1, 1)
    assert shapes["agentview.points.bias"] == (64,)
    assert shapes["head1.weight"] == (512, 832)
    assert shapes["arm.weight"] == (48, 512) and shapes["gripper.weight"] == (8, 512)
    assert shapes["state_mean"] == shapes["state_std"] == (14,)
    assert shapes["wrist.fine.weight"] == (64, 48, 1, 1)
    assert len(shapes) == 83


def test_an_answer_does_not_depend_on_its_batch(network: Network) -> None:
    inputs = queries(3)
    together = network(*inputs)
    assert together.arm.shape == (3, 8, 6) and together.gripper.shape == (3, 8)
    order = torch.tensor([2, 0, 1])
    permuted = network(*(value[order] for value in inputs))
    torch.testing.assert_close(permuted.arm, together.arm[order], rtol=1e-4, atol=1e-5)
    alone = network(*(value[1:2] for value in inputs))
    torch.testing.assert_close(alone.gripper, together.gripper[1:2], rtol=1e-4, atol=1e-5)


def test_words_that_never_occur_in_training_have_no_effect() -> None:
    network = Network().eval()
    *views, _, _ = queries(2)
    outputs = [
        network(*views, *(torch.from_numpy(array) for array in instruction_rows(texts))).arm
        for texts in (["", ""], ["open it", "shut the microwave"])
    ]
    torch.testing.assert_close(outputs[0], outputs[1])


def test_actions_are_clipped_and_the_gripper_is_binary(network: Network) -> None:
    actions = to_actions(network(*queries(2)))
    assert actions.shape == (2, 8, 7)
    assert actions[..., :6].abs().max() <= 1
    assert set(actions[..., 6].unique().tolist()) <= {-1.0, 1.0}


def test_a_learned_point_is_at_the_maps_peak() -> None:
    """Columns and rows range from -1 to 1; the picture's top left is (-1, -1)."""
    encoder = Network().agentview.eval()
    inputs: list[torch.Tensor] = []

    class Peak(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            inputs.append(x)
            scores = torch.zeros(len(x), 64, 16, 16)
            scores[:, :, 3, 12] = 100.0
            return scores

    class FinePeak(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            scores = torch.zeros(len(x), 64, 32, 32)
            scores[:, :, 7, 24] = 50.0
            return scores

    encoder.points, encoder.fine = Peak(), FinePeak()
    out = encoder(torch.zeros(1, 3, 128, 128), torch.zeros(1, 128))[0]
    torch.testing.assert_close(out[:64], torch.full((64,), -1 + 2 * 24 / 31))
    torch.testing.assert_close(out[64:128], torch.full((64,), -1 + 2 * 7 / 31))
    torch.testing.assert_close(out[128:192], torch.full((64,), 150.0))
    torch.testing.assert_close(out[192:], inputs[0].mean(dim=(2, 3))[0])


def test_pictures_shrink_by_the_area_mean() -> None:
    pictures = torch.randint(0, 256, (2, 3, 8, 12, 3), dtype=torch.uint8)
    as_int64 = pictures.numpy().astype(np.int64)
    total = (
        as_int64[..., ::2, ::2, :]
        + as_int64[..., 1::2, ::2, :]
        + as_int64[..., ::2, 1::2, :]
        + as_int64[..., 1::2, 1::2, :]
    )
    assert np.array_equal(shrink(pictures).numpy(), (total + 2) // 4)
    assert shrink(torch.full((2, 2, 3), 255, dtype=torch.uint8)).tolist() == [[[255] * 3]]


def test_bytes_become_numbers_from_minus_one_to_one() -> None:
    picture = torch.zeros(1, 4, 4, 3, dtype=torch.uint8)
    picture[0, 1, 2, 0] = 255
    x = scaled(picture)
    assert x.shape == (1, 3, 4, 4) and x[0, 0, 1, 2] == 1 and x.sum() == 1 - 47


def test_a_quaternions_matrix_is_written_row_by_row() -> None:
    # A quarter turn about z, which turns x to y.
    quaternion = np.array([[0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    expected = [[0, -1, 0, 1, 0, 0, 0, 0, 1]]
    np.testing.assert_allclose(rotation(quaternion), expected, atol=1e-12)
