"""A policy of SmolVLA's size and shape with random weights, for timing.

It is not SmolVLA: no weights are loaded, and its answers mean nothing. Its cost is
similar: two frames enlarged to 512 x 512 and encoded to 64 tokens each; a prefix of
frames, instruction and state through sixteen layers, once per query; a smaller network,
the action expert, that turns noise into 50 actions, attending to the prefix, in ten
steps of flow matching. Sizes are those of the publications of SmolVLM2 (500 M) and
SmolVLA: 399 M parameters, in bfloat16. The 450 M of SmolVLA include a language head,
which does not affect actions and is omitted here.

Needs PyTorch, NumPy and this package. On a GPU every served batch size is
captured as a CUDA graph, because launching its kernels one by one takes longer
than running them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from rollout_policies import Camera, Description, Episode, Observation, Policy, State, serve

#: Number of actions in an answer, and width of an action inside the network.
CHUNK, WIDTH = 50, 32
FLOW_STEPS = 10
LANGUAGE_TOKENS = 48
#: Batch sizes that are captured; other batches are padded to the next size.
BATCHES = (1, 2, 4, 8, 16, 32)
CAMERAS = (Camera("agentview", 256, 256), Camera("robot0_eye_in_hand", 256, 256))
STATE = (State.EEF_POS, State.EEF_AXIS_ANGLE, State.GRIPPER_POS)


@dataclass(frozen=True)
class Size:
    """Dimensions of the network."""

    #: Sides of an enlarged frame and of a patch, pixels.
    side: int = 512
    patch: int = 16
    #: Side of the square of patches that becomes one token.
    merge: int = 4
    vision_width: int = 768
    vision_layers: int = 12
    width: int = 960
    expert_width: int = 720
    layers: int = 16
    heads: int = 15
    kv_heads: int = 5
    #: Width of an attention head.
    head: int = 64
    vocabulary: int = 49_280


#: A small size for testing the programs on a CPU.
TINY = Size(
    side=128,
    patch=16,
    merge=4,
    vision_width=64,
    vision_layers=2,
    width=60,
    expert_width=30,
    layers=2,
    heads=3,
    kv_heads=1,
    head=16,
    vocabulary=256,
)


class VisionLayer(nn.Module):
    """A transformer layer of the vision encoder, over a frame's patches."""

    def __init__(self, width: int, head: int) -> None:
        super().__init__()
        self.head = head
        self.norms = nn.ModuleList([nn.LayerNorm(width), nn.LayerNorm(width)])
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.mlp = nn.Sequential(
            nn.Linear(width, 4 * width), nn.GELU("tanh"), nn.Linear(4 * width, width)
        )

    def forward(self, x: Tensor) -> Tensor:
        batch, count, width = x.shape
        qkv = self.qkv(self.norms[0](x)).view(batch, count, 3, -1, self.head)
        query, key, value = qkv.permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        x = x + self.out(mixed.transpose(1, 2).reshape(batch, count, width))
        return x + self.mlp(self.norms[1](x))


class Layer(nn.Module):
    """A transformer layer of the language model or of the action expert."""

    def __init__(self, width: int, size: Size) -> None:
        super().__init__()
        self.size = size
        # As in SmolLM2, whose layers of width 960 have 2,560 hidden units.
        hidden = 8 * width // 3
        self.norms = nn.ModuleList([nn.RMSNorm(width), nn.RMSNorm(width)])
        self.query = nn.Linear(width, size.heads * size.head, bias=False)
        self.key_value = nn.Linear(width, 2 * size.kv_heads * size.head, bias=False)
        self.out = nn.Linear(size.heads * size.head, width, bias=False)
        self.gate_up = nn.Linear(width, 2 * hidden, bias=False)
        self.down = nn.Linear(hidden, width, bias=False)

    def forward(self, x: Tensor, before: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Attends to the keys and values of `x`, and to those in `before` [2, batch, kv heads, n,
        head]. Returns the output, and the keys and values of `x`."""
        batch, count, _ = x.shape
        normed = self.norms[0](x)
        query = self.query(normed).view(batch, count, -1, self.size.head).transpose(1, 2)
        keys_values = self.key_value(normed).view(batch, count, 2, -1, self.size.head)
        keys_values = keys_values.permute(2, 0, 3, 1, 4)
        key, value = keys_values if before is None else torch.cat([before, keys_values], dim=3)
        heads_per_kv_head = self.size.heads // self.size.kv_heads
        key, value = (tensor.repeat_interleave(heads_per_kv_head, dim=1) for tensor in (key, value))
        mixed = functional.scaled_dot_product_attention(query, key, value)
        x = x + self.out(mixed.transpose(1, 2).reshape(batch, count, -1))
        gate, up = self.gate_up(self.norms[1](x)).chunk(2, dim=-1)
        return x + self.down(functional.silu(gate) * up), keys_values


class Network(nn.Module):
    """Maps frames, words and state to a chunk of actions."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.size = size
        patches = (size.side // size.patch) ** 2
        self.patches = nn.Conv2d(3, size.vision_width, size.patch, size.patch)
        self.positions = nn.Parameter(torch.randn(patches, size.vision_width) * 0.02)
        self.vision = nn.ModuleList(
            VisionLayer(size.vision_width, min(64, size.vision_width))
            for _ in range(size.vision_layers)
        )
        self.connect = nn.Linear(size.vision_width * size.merge**2, size.width, bias=False)
        self.words = nn.Embedding(size.vocabulary, size.width)
        self.state = nn.Linear(WIDTH, size.width)
        self.layers = nn.ModuleList(Layer(size.width, size) for _ in range(size.layers))
        self.action_in = nn.Linear(WIDTH + 1, size.expert_width)
        self.expert = nn.ModuleList(Layer(size.expert_width, size) for _ in range(size.layers))
        self.action_out = nn.Linear(size.expert_width, WIDTH)

    def forward(self, frames: Tensor, words: Tensor, state: Tensor, noise: Tensor) -> Tensor:
        """Takes frames uint8 [b, 2, h, w, 3], words [b, n], state [b, 32] and noise [b, 50, 32].
        Returns actions [b, 50, 32]."""
        batch = len(frames)
        images = self.encode_frames(frames).view(batch, -1, self.size.width)
        prefix = torch.cat([images, self.words(words), self.state(state)[:, None]], dim=1)
        layer_keys_values = []
        for layer in self.layers:
            prefix, keys_values = layer(prefix)
            layer_keys_values.append(keys_values)
        actions = noise
        for step in range(FLOW_STEPS):
            time = torch.full_like(actions[..., :1], 1 - step / FLOW_STEPS)
            x = self.action_in(torch.cat([actions, time], dim=-1))
            for layer, keys_values in zip(self.expert, layer_keys_values):
                x, _ = layer(x, keys_values)
            actions = actions - self.action_out(x) / FLOW_STEPS
        return actions

    def encode_frames(self, frames: Tensor) -> Tensor:
        """Returns the tokens of frames, [2 b, n, width]."""
        size = self.size
        frames = frames.flatten(0, 1).permute(0, 3, 1, 2).to(self.positions.dtype) / 127.5 - 1
        frames = functional.interpolate(frames, (size.side, size.side), mode="bilinear")
        x = self.patches(frames).flatten(2).transpose(1, 2) + self.positions
        for layer in self.vision:
            x = layer(x)
        side = size.side // size.patch // size.merge
        x = x.view(len(x), side, size.merge, side, size.merge, -1)
        return self.connect(x.permute(0, 1, 3, 2, 4, 5).reshape(len(x), side * side, -1))


class SimulatedSmolvla(Policy):
    """The network behind the interface that authors of policies implement."""

    def __init__(self, device: str, max_batch: int, tiny: bool = False) -> None:
        torch.manual_seed(0)
        self.device = torch.device(device)
        with self.device:
            network = Network(TINY if tiny else Size())
        dtype = torch.float32 if self.device.type == "cpu" else torch.bfloat16
        self.network = network.to(dtype).eval().requires_grad_(False)
        self.dtype = dtype
        self.graphs = {}
        self.description = Description(
            name="simulated_smolvla",
            checkpoint="random weights",
            parameters=sum(weight.numel() for weight in network.parameters()),
            cameras=CAMERAS,
            state=STATE,
            horizon=CHUNK,
            execute=1,
            stochastic=True,
            max_batch=max_batch,
        )
        if self.device.type == "cuda":
            self.graphs = {count: self._capture(count) for count in BATCHES if count <= max_batch}

    def reset(self, episode: Episode) -> None:
        letters = episode.instruction.encode()[:LANGUAGE_TOKENS].ljust(LANGUAGE_TOKENS)
        episode.memory = np.frombuffer(letters, dtype=np.uint8).astype(np.int64)

    def infer(self, observation: Observation) -> np.ndarray:
        return self.infer_batch([observation])[0]

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        count = len(observations)
        # A batch is padded to a captured size.
        size = next(size for size in BATCHES if size >= count) if self.graphs else count
        padded = [*observations, *[observations[0]] * (size - count)]
        answers = self._run(self._inputs(padded))[:count, :, :7]
        return list(answers.float().clamp(-1, 1).cpu().numpy())

    def _inputs(self, observations: Sequence[Observation]) -> list[Tensor]:
        frames = np.stack(
            [
                [observation.rotated(camera.name) for camera in CAMERAS]
                for observation in observations
            ]
        )
        words = np.stack([observation.episode.memory for observation in observations])
        state = np.zeros((len(observations), WIDTH), dtype=np.float32)
        for row, observation in zip(state, observations):
            row[:8] = observation.vector()
        noise = np.stack(
            [
                observation.rng.standard_normal((CHUNK, WIDTH), dtype=np.float32)
                for observation in observations
            ]
        )
        return [
            torch.from_numpy(frames).to(self.device),
            torch.from_numpy(words).to(self.device),
            torch.from_numpy(state).to(self.device, self.dtype),
            torch.from_numpy(noise).to(self.device, self.dtype),
        ]

    def _run(self, inputs: list[Tensor]) -> Tensor:
        captured = self.graphs.get(len(inputs[0]))
        if captured is None:
            return self.network(*inputs)
        graph, captured_inputs, answer = captured
        for tensor, value in zip(captured_inputs, inputs):
            tensor.copy_(value)
        graph.replay()
        return answer

    def _capture(self, count: int):
        """Captures a CUDA graph of one batch size. Returns the graph with its input and output
        tensors."""
        inputs = [
            torch.zeros(count, 2, 256, 256, 3, dtype=torch.uint8, device=self.device),
            torch.zeros(count, LANGUAGE_TOKENS, dtype=torch.int64, device=self.device),
            torch.zeros(count, WIDTH, dtype=self.dtype, device=self.device),
            torch.zeros(count, CHUNK, WIDTH, dtype=self.dtype, device=self.device),
        ]
        # Libraries choose their kernels at the first calls, which must precede the capture.
        warm_up_stream = torch.cuda.Stream()
        warm_up_stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(warm_up_stream):
            for _ in range(3):
                self.network(*inputs)
        torch.cuda.current_stream().wait_stream(warm_up_stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            answer = self.network(*inputs)
        return graph, inputs, answer


def main() -> None:
    parser = argparse.ArgumentParser(description="Serve simulated_smolvla.")
    parser.add_argument("--listen", default="127.0.0.1:0")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--max-batch", type=int, default=16)
    parser.add_argument("--tiny", action="store_true", help="a small network, for a CPU")
    arguments = parser.parse_args()
    policy = SimulatedSmolvla(arguments.device, arguments.max_batch, arguments.tiny)
    serve(policy, arguments.listen)


if __name__ == "__main__":
    main()
