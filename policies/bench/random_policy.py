"""A policy of the size and shape of SmolVLA or π0.5 with random weights, for timing.

It is neither: no weights are loaded, and its answers mean nothing. Its cost is similar: frames are
enlarged and encoded; a prefix of frames, instruction and state passes through the language model
once per query; a smaller network, the action expert, turns noise into actions in ten steps of flow
matching, attending to the keys and values of the prefix. Weights are bfloat16 on a GPU. Sizes:

- `smolvla`: `configuration_smolvla.py` and `smolvlm_with_expert.py` of lerobot 0.6.1, and
  SmolVLM2-500M. Of its 450 M parameters, 47 M are a language head, which does not affect actions
  and is omitted.
- `pi05`: `gemma.py`, `siglip.py` and the configuration `pi05_libero` of openpi: 3.3 B parameters,
  the third frame empty but computed, the time of a flow step in every norm of the expert.

Needs PyTorch, NumPy and this package. On a GPU every served batch size is captured as a CUDA graph,
because launching its kernels one by one takes longer than running them."""

import argparse
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from rollout_policies import Camera, Description, Episode, Observation, Policy, State, serve

#: Width of an action and of the state inside the network.
WIDTH = 32
FLOW_STEPS = 10
#: Batch sizes that are captured; other batches are padded to the next size.
BATCHES = (1, 2, 4, 8, 16, 32)
CAMERAS = (Camera("agentview", 256, 256), Camera("robot0_eye_in_hand", 256, 256))
STATE = (State.EEF_POS, State.EEF_AXIS_ANGLE, State.GRIPPER_POS)


@dataclass(frozen=True)
class Size:
    #: Published number of parameters that affect actions; None for a size that is not published.
    published: int | None
    #: Images per query. The first two are the cameras'; a further one is empty.
    frames: int
    #: Sides of an enlarged frame and of a patch, pixels.
    side: int
    patch: int
    #: Side of the square of patches that becomes one token.
    merge: int
    vision_width: int
    vision_hidden: int
    vision_layers: int
    vision_head: int
    width: int
    hidden: int
    expert_width: int
    expert_hidden: int
    layers: int
    heads: int
    kv_heads: int
    #: Width of an attention head.
    head: int
    vocabulary: int
    #: Tokens of the instruction.
    words: int
    #: Actions in an answer, and how many of them LIBERO-CTRL executes.
    chunk: int
    execute: int
    #: Whether the time of a flow step scales, shifts and gates every layer of the expert (adaRMS).
    adaptive: bool


SIZES = {
    "smolvla": Size(
        403_000_000, 2, 512, 16, 4, 768, 3072, 12, 64, 960, 2560, 720, 2048, 16, 15, 5, 64, 49_280,
        words=48, chunk=50, execute=1, adaptive=False,
    ),
    "pi05": Size(
        3_300_000_000, 3, 224, 14, 1, 1152, 4304, 27, 72, 2048, 16_384, 1024, 4096, 18, 8, 1, 256,
        257_152, words=200, chunk=10, execute=10, adaptive=True,
    ),
    # For testing the programs on a CPU.
    "tiny": Size(
        None, 3, 64, 16, 2, 64, 256, 2, 16, 60, 160, 30, 80, 2, 3, 1, 16, 256,
        words=8, chunk=10, execute=5, adaptive=True,
    ),
}  # fmt: skip


class Meter:
    """Counts of a process, in a file that the measuring process reads."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.counts = {"answers": 0, "batches": 0, "forward_secs": 0.0}

    def add(self, **counts: float) -> None:
        for name, count in counts.items():
            self.counts[name] = self.counts.get(name, 0) + count
        if self.path:
            # A reader sees the file before or after, never half of it.
            partial = self.path.with_suffix(".partial")
            partial.write_text(json.dumps({"at": time.time(), **self.counts}))
            os.replace(partial, self.path)


class VisionLayer(nn.Module):
    """A transformer layer of the vision encoder, over a frame's patches."""

    def __init__(self, width: int, hidden: int, head: int) -> None:
        super().__init__()
        self.head = head
        self.norms = nn.ModuleList([nn.LayerNorm(width), nn.LayerNorm(width)])
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.mlp = nn.Sequential(
            nn.Linear(width, hidden), nn.GELU("tanh"), nn.Linear(hidden, width)
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

    def __init__(self, width: int, hidden: int, size: Size, adaptive: bool = False) -> None:
        super().__init__()
        self.size = size
        self.modulate = nn.Linear(width, 6 * width) if adaptive else None
        self.norms = nn.ModuleList([nn.RMSNorm(width), nn.RMSNorm(width)])
        self.query = nn.Linear(width, size.heads * size.head, bias=False)
        self.key_value = nn.Linear(width, 2 * size.kv_heads * size.head, bias=False)
        self.out = nn.Linear(size.heads * size.head, width, bias=False)
        self.gate_up = nn.Linear(width, 2 * hidden, bias=False)
        self.down = nn.Linear(hidden, width, bias=False)

    def forward(
        self, x: Tensor, before: Tensor | None = None, time: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Attends to the keys and values of `x`, and to those in `before` [2, batch, kv heads, n,
        head]. Returns the output, and the keys and values of `x`."""
        batch, count, _ = x.shape
        scale = shift = gate = (None, None)
        if self.modulate is not None:
            parts = self.modulate(time)[:, None].chunk(6, dim=-1)
            scale, shift, gate = parts[:2], parts[2:4], parts[4:]
        normed = modulated(self.norms[0](x), scale[0], shift[0])
        query = self.query(normed).view(batch, count, -1, self.size.head).transpose(1, 2)
        keys_values = self.key_value(normed).view(batch, count, 2, -1, self.size.head)
        keys_values = keys_values.permute(2, 0, 3, 1, 4)
        key, value = keys_values if before is None else torch.cat([before, keys_values], dim=3)
        mixed = functional.scaled_dot_product_attention(query, key, value, enable_gqa=True)
        mixed = self.out(mixed.transpose(1, 2).reshape(batch, count, -1))
        x = x + modulated(mixed, gate[0])
        opened, up = self.gate_up(modulated(self.norms[1](x), scale[1], shift[1])).chunk(2, dim=-1)
        return x + modulated(self.down(functional.silu(opened) * up), gate[1]), keys_values


def modulated(x: Tensor, scale: Tensor | None, shift: Tensor | None = None) -> Tensor:
    x = x if scale is None else x * (1 + scale)
    return x if shift is None else x + shift


class Network(nn.Module):
    """Maps frames, words and state to a chunk of actions."""

    def __init__(self, size: Size) -> None:
        super().__init__()
        self.size = size
        patches = (size.side // size.patch) ** 2
        self.patches = nn.Conv2d(3, size.vision_width, size.patch, size.patch)
        self.positions = nn.Parameter(torch.randn(patches, size.vision_width) * 0.02)
        self.vision = nn.ModuleList(
            VisionLayer(size.vision_width, size.vision_hidden, size.vision_head)
            for _ in range(size.vision_layers)
        )
        self.connect = nn.Linear(size.vision_width * size.merge**2, size.width, bias=False)
        self.words = nn.Embedding(size.vocabulary, size.width)
        self.state = nn.Linear(WIDTH, size.width)
        self.layers = nn.ModuleList(
            Layer(size.width, size.hidden, size) for _ in range(size.layers)
        )
        self.action_in = nn.Linear(WIDTH + 1, size.expert_width)
        self.expert = nn.ModuleList(
            Layer(size.expert_width, size.expert_hidden, size, size.adaptive)
            for _ in range(size.layers)
        )
        self.action_out = nn.Linear(size.expert_width, WIDTH)
        count = sum(weight.numel() for weight in self.parameters())
        if size.published and abs(count / size.published - 1) > 0.05:
            raise ValueError(f"{count} parameters, not about {size.published}: see SIZES")

    def forward(self, frames: Tensor, words: Tensor, state: Tensor, noise: Tensor) -> Tensor:
        """Takes frames uint8 [b, 2, h, w, 3], words [b, n], state [b, 32] and noise [b, chunk, 32].
        Returns actions [b, chunk, 32]."""
        batch = len(frames)
        empty = self.size.frames - frames.shape[1]
        frames = functional.pad(frames, (0, 0, 0, 0, 0, 0, 0, empty))
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
            condition = time[:, 0].expand(-1, self.size.expert_width)
            for layer, keys_values in zip(self.expert, layer_keys_values):
                x, _ = layer(x, keys_values, condition)
            actions = actions - self.action_out(x) / FLOW_STEPS
        return actions

    def encode_frames(self, frames: Tensor) -> Tensor:
        """Returns the tokens of frames, [b * frames, n, width]."""
        size = self.size
        frames = frames.flatten(0, 1).permute(0, 3, 1, 2).to(self.positions.dtype) / 127.5 - 1
        frames = functional.interpolate(frames, (size.side, size.side), mode="bilinear")
        x = self.patches(frames).flatten(2).transpose(1, 2) + self.positions
        for layer in self.vision:
            x = layer(x)
        side = size.side // size.patch // size.merge
        x = x.view(len(x), side, size.merge, side, size.merge, -1)
        return self.connect(x.permute(0, 1, 3, 2, 4, 5).reshape(len(x), side * side, -1))


class RandomPolicy(Policy):
    """The network behind the interface that authors of policies implement.

    `batches` are the batch sizes that are captured; others are padded to the next. `side` is the
    side of the frames that it gets."""

    def __init__(
        self,
        device: str,
        size: str,
        batches: Sequence[int] = (16,),
        side: int = 256,
        meter: Meter | None = None,
    ) -> None:
        torch.manual_seed(0)
        self.device = torch.device(device)
        self.size = SIZES[size]
        self.meter = meter or Meter()
        self.dtype = torch.float32 if self.device.type == "cpu" else torch.bfloat16
        # Created as bfloat16: single precision would double the GPU memory in use.
        torch.set_default_dtype(self.dtype)
        with self.device:
            self.network = Network(self.size).eval().requires_grad_(False)
        torch.set_default_dtype(torch.float32)
        self.description = Description(
            name=f"random-{size}-size",
            checkpoint="random weights",
            parameters=sum(weight.numel() for weight in self.network.parameters()),
            cameras=CAMERAS,
            state=STATE,
            horizon=self.size.chunk,
            execute=self.size.execute,
            stochastic=True,
            max_batch=max(batches),
        )
        self.graphs = {}
        if self.device.type == "cuda":
            self.graphs = {count: self._capture(count, side) for count in sorted(batches)}

    def reset(self, episode: Episode) -> None:
        episode.memory = self.words(episode.instruction)

    def words(self, instruction: str) -> np.ndarray:
        letters = instruction.encode()[: self.size.words].ljust(self.size.words)
        return np.frombuffer(letters, dtype=np.uint8).astype(np.int64)

    def prepare(self, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns frames, state and noise: copied here, while the GPU computes an earlier batch."""
        frames = np.stack([observation.rotated(camera.name) for camera in CAMERAS])
        noise = observation.rng.standard_normal((self.size.chunk, WIDTH), np.float32)
        return frames, observation.vector(), noise

    def infer(self, observation: Observation) -> np.ndarray:
        return self.infer_batch([observation])[0]

    def infer_batch(self, observations: Sequence[Observation]) -> Sequence[np.ndarray]:
        frames, states, noise = zip(*(each.prepared for each in observations))
        words = np.stack([each.episode.memory for each in observations])
        batch = torch.stack([torch.from_numpy(pair) for pair in frames])
        return list(self.answer(batch, words, np.stack(states), np.stack(noise)))

    def answer(
        self, frames: Tensor, words: np.ndarray, state: np.ndarray, noise: np.ndarray
    ) -> np.ndarray:
        """Takes frames uint8 [b, 2, h, w, 3], words [b, n], state [b, 8] and noise. Returns actions
        [b, chunk, 7], and adds them to the meter."""
        count = len(frames)
        # A batch is padded to a captured size.
        size = next(size for size in self.graphs if size >= count) if self.graphs else count
        rows = [*range(count), *[0] * (size - count)]
        inputs = [
            (frames if size == count else frames[rows]).to(self.device),
            torch.from_numpy(words[rows]).to(self.device),
            torch.from_numpy(np.pad(state[rows], ((0, 0), (0, WIDTH - 8)))).to(
                self.device, self.dtype
            ),
            torch.from_numpy(noise[rows]).to(self.device, self.dtype),
        ]
        if not self.graphs:
            began = time.perf_counter()
            answers = self.network(*inputs)
            forward_secs = time.perf_counter() - began
        else:
            graph, captured_inputs, answers, events = self.graphs[size]
            for tensor, value in zip(captured_inputs, inputs):
                tensor.copy_(value)
            events[0].record()
            graph.replay()
            events[1].record()
        actions = answers[:count, :, :7].float().clamp(-1, 1).cpu().numpy()
        if self.graphs:
            forward_secs = events[0].elapsed_time(events[1]) / 1e3
        self.meter.add(answers=count, batches=1, forward_secs=forward_secs)
        return actions

    def _capture(self, count: int, side: int):
        """Captures a CUDA graph of one batch size. Returns the graph with its input and output
        tensors, and two events to time it."""
        inputs = [
            torch.zeros(count, 2, side, side, 3, dtype=torch.uint8, device=self.device),
            torch.zeros(count, self.size.words, dtype=torch.int64, device=self.device),
            torch.zeros(count, WIDTH, dtype=self.dtype, device=self.device),
            torch.zeros(count, self.size.chunk, WIDTH, dtype=self.dtype, device=self.device),
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
        events = [torch.cuda.Event(enable_timing=True) for _ in range(2)]
        return graph, inputs, answer, events


def main() -> None:
    parser = argparse.ArgumentParser(description="Serve a policy with random weights.")
    parser.add_argument("--listen", default="127.0.0.1:0")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--size", choices=SIZES, default="smolvla")
    parser.add_argument("--max-batch", type=int, default=16)
    parser.add_argument("--meter", type=Path, help="file of what it has done, for cost.py")
    arguments = parser.parse_args()
    # Threads that stack frames would spin on cores on which workers simulate.
    torch.set_num_threads(1)
    batches = [count for count in BATCHES if count <= arguments.max_batch]
    meter = Meter(arguments.meter)
    policy = RandomPolicy(arguments.device, arguments.size, batches, meter=meter)
    serve(policy, arguments.listen)


if __name__ == "__main__":
    main()
