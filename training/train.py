"""Trains a student on the collected data.

    python -m training.train --data data/plain --run runs/first --seconds 300
    python -m training.train --data data/plain data/driven --run runs/second --seconds 300 \\
        --start-from runs/first/student.safetensors

The same command resumes an interrupted run at its last checkpoint.
"""

import argparse
import copy
import math
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from training.augment import PictureChange, Wordings, apply_changes, draw_changes
from training.network import ARM, Network, parameters
from training.observations import scaled
from training.store import FRAME_BYTES, Batch, Library
from training.student import load_network, save_weights

CHECKPOINT = "checkpoint.pt"
WEIGHTS = "student.safetensors"
GRIPPER_WEIGHT = 0.1
"""Weight of the gripper's loss; the arm's is 1."""
WARM_UP = 200
"""Steps in which the learning rate rises to its maximum."""
EMA = 0.999
"""Decay of the exponential moving average of the network's weights, per step; smaller in the first
steps, see ``_update_mean``."""
MAX_GRADIENT = 1.0
"""Largest norm of the gradient, which is clipped."""
REPORT_SECONDS = 20.0
CHECKPOINT_SECONDS = 20.0
WATCH_SECONDS = 10.0
"""Time between two searches for new shards, seconds."""
HELD_OUT_FRAMES = 4_096
"""Largest number of frames for validation."""
GPU_SHARE = 0.7
"""Share of the free memory of a GPU that frames may take."""


class Losses(nn.Module):
    """The network and its loss in one module, so that ``torch.compile`` compiles both."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, batch: Batch, change: PictureChange, rows: Tensor, present: Tensor) -> Tensor:
        """Returns the loss of a batch: L1 of the arm plus weighted cross-entropy of the gripper."""
        views = apply_changes(batch.pictures, change)
        output = self.network(*views, batch.state, rows, present)
        valid = batch.valid
        total = valid.sum().clamp(min=1.0)
        arm = (output.arm - batch.targets[:, :, :ARM]).abs().mean(dim=2)
        closes = (batch.targets[:, :, ARM] > 0).float()
        gripper = functional.binary_cross_entropy_with_logits(
            output.gripper, closes, reduction="none"
        )
        loss: Tensor = ((arm + GRIPPER_WEIGHT * gripper) * valid).sum() / total
        return loss


class Trainer:
    """One training run: a network, the running mean of its weights, and an optimizer, which are
    written to checkpoints with the time spent."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._device = torch.device(arguments.device)
        self._run: Path = arguments.run
        self.step = 0
        self.trained_seconds = 0.0
        self.spent_seconds = 0.0
        """Time spent on loading, seconds, summed over all resumptions of the run."""
        self._network = Network().to(self._device)
        self._network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._mean = copy.deepcopy(self._network).requires_grad_(False).eval()
        self._optimizer = self._make_optimizer()
        self._losses: Callable[..., Any] = Losses(self._network)
        self._is_compiled = False
        self._has_scale = False
        self._load()

    def prepare(self, library: Library) -> None:
        """Computes the state's scale from the data, unless loaded weights contain it, and compiles
        the loss if requested."""
        if not self._has_scale:
            mean, deviation = library.training.state_scale()
            for network in (self._network, self._mean):
                network.state_mean.copy_(mean)
                network.state_std.copy_(deviation)
            self._has_scale = True
        if self._arguments.compile:
            self._losses = torch.compile(self._losses, dynamic=False)
            self._is_compiled = True

    def train_step(self, library: Library, wordings: Wordings, fraction: float) -> Tensor:
        """Makes one optimizer step and returns the loss. The learning rate follows from `fraction`,
        the spent share of the training time."""
        rate = self._arguments.learning_rate * _schedule(self.step, fraction)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        batch = library.training.draw(self._arguments.batch)
        change = draw_changes(len(batch.task), self._device)
        rows, present = wordings.draw(batch.task)
        loss = self._loss(batch, change, rows, present)
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self._network.parameters(), MAX_GRADIENT)
        self._optimizer.step()
        self.step += 1
        self._update_mean()
        return loss.detach()

    @torch.inference_mode()
    def validate(self, library: Library, wordings: Wordings) -> tuple[float, float]:
        """Returns L1 of the arm and the gripper's accuracy, for the mean weights on held-out
        episodes."""
        store = library.held_out
        distance = correct = total = torch.zeros((), device=self._device)
        for first in range(0, store.count, 512):
            last = min(first + 512, store.count)
            batch = store.batch(torch.arange(first, last, device=self._device))
            views = scaled(batch.pictures[:, 0]), scaled(batch.pictures[:, 1])
            with self._precision():
                output = self._mean(*views, batch.state, *wordings.canonical(batch.task))
            arm = (output.arm.clamp(-1, 1) - batch.targets[:, :, :ARM]).abs().mean(dim=2)
            agrees = (output.gripper > 0) == (batch.targets[:, :, ARM] > 0)
            distance = distance + (arm * batch.valid).sum()
            correct = correct + (agrees * batch.valid).sum()
            total = total + batch.valid.sum()
        return (distance / total).item(), (correct / total).item()

    def save(self, *, finished: bool = False) -> None:
        """Writes the checkpoint, and the running mean as a weights file."""
        self._run.mkdir(parents=True, exist_ok=True)
        state = {
            "network": self._network.state_dict(),
            "mean": self._mean.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "step": self.step,
            "trained_seconds": self.trained_seconds,
            "spent_seconds": self.spent_seconds,
            "finished": finished,
        }
        part = self._run / (CHECKPOINT + ".part")
        torch.save(state, part)
        os.replace(part, self._run / CHECKPOINT)
        save_weights(self._mean.state_dict(), self._run / WEIGHTS, self._arguments.name)

    def _load(self) -> None:
        """Resumes from the run's own checkpoint, or starts from another run's weights."""
        checkpoint = self._run / CHECKPOINT
        if checkpoint.exists():
            state = torch.load(checkpoint, map_location=self._device, weights_only=True)
            if state["finished"]:
                raise SystemExit(
                    f"{self._run} has finished; to train further, name another --run, and add "
                    f"--start-from {self._run / WEIGHTS}"
                )
            self._network.load_state_dict(state["network"])
            self._mean.load_state_dict(state["mean"])
            self._optimizer.load_state_dict(state["optimizer"])
            self.step, self.trained_seconds = state["step"], state["trained_seconds"]
            self.spent_seconds = state["spent_seconds"]
            print(f"resumes at step {self.step:,}, after {self.trained_seconds:.0f} s")
        elif self._arguments.start_from is not None:
            weights = load_network(self._arguments.start_from, self._device).state_dict()
            self._network.load_state_dict(weights)
            self._mean.load_state_dict(weights)
            print(f"starts from {self._arguments.start_from}")
        else:
            return
        self._has_scale = True

    def _make_optimizer(self) -> torch.optim.AdamW:
        """Returns an AdamW optimizer, whose weight decay excludes norms, biases and word
        vectors."""
        with_decay: list[nn.Parameter] = []
        without_decay: list[nn.Parameter] = []
        for name, parameter in self._network.named_parameters():
            is_embedding = name == "words.weight"
            excluded = parameter.ndim < 2 or is_embedding
            (without_decay if excluded else with_decay).append(parameter)
        return torch.optim.AdamW(
            [
                {"params": with_decay, "weight_decay": self._arguments.weight_decay},
                {"params": without_decay, "weight_decay": 0.0},
            ],
            lr=self._arguments.learning_rate,
            fused=self._device.type == "cuda",
        )

    def _loss(self, *inputs: Any) -> Tensor:
        try:
            return self._compute_loss(*inputs)
        except Exception as error:
            if not self._is_compiled or self.step > 0:
                raise
            # Any error of the first step is attributed to the compiler; other errors recur in the
            # retry. Training without the compiler is slower, with the same result.
            print(f"trains without torch.compile: {type(error).__name__}: {str(error)[:300]}")
            self._losses, self._is_compiled = Losses(self._network), False
            return self._compute_loss(*inputs)

    def _compute_loss(self, *inputs: Any) -> Tensor:
        with self._precision():
            loss: Tensor = self._losses(*inputs)
        return loss

    def _precision(self) -> Any:
        if self._device.type == "cuda":
            return torch.autocast("cuda", dtype=torch.bfloat16)
        return nullcontext()

    @torch.no_grad()
    def _update_mean(self) -> None:
        """Moves the running mean towards the network's weights, faster in the first steps."""
        keep = min(EMA, (1 + self.step) / (10 + self.step))
        torch._foreach_lerp_(
            list(self._mean.parameters()), list(self._network.parameters()), 1 - keep
        )


def _schedule(step: int, fraction: float) -> float:
    """Returns the factor on the learning rate: a warm-up over steps, and a cosine decay over
    time."""
    return min(1.0, (step + 1) / WARM_UP) * 0.5 * (1 + math.cos(math.pi * min(1.0, fraction)))


def _capacity(arguments: argparse.Namespace, device: torch.device) -> int:
    """Returns the requested number of frames, else the number that the GPU can hold, else 20,000,
    which take 2 GB."""
    if arguments.capacity:
        return int(arguments.capacity)
    if device.type == "cuda":
        free, _ = torch.cuda.mem_get_info(device)
        return int(GPU_SHARE * free) // FRAME_BYTES
    return 20_000


def train(arguments: argparse.Namespace) -> None:
    """Trains until ``--seconds`` or ``--stop-after`` have passed."""
    start, seconds = time.monotonic(), arguments.seconds
    device = torch.device(arguments.device)
    torch.manual_seed(arguments.seed)
    # This must run before CUDA is initialised, because it forks processes, which draw wordings.
    wordings = Wordings(arguments.wordings, arguments.seed, device, arguments.processes)
    trainer = Trainer(arguments)
    held_out = min(HELD_OUT_FRAMES, arguments.capacity or HELD_OUT_FRAMES)
    library = Library(arguments.data, _capacity(arguments, device), held_out, device)
    library.refresh()
    while arguments.watch and not library.training.count and time.monotonic() - start < seconds:
        time.sleep(1.0)
        library.refresh()
    if not library.training.count:
        folders = ", ".join(map(str, arguments.data))
        raise SystemExit(f"nothing to train on in {folders}: run training.collect first")
    print(
        f"{parameters(Network()):,} parameters; {library.training.count:,} frames "
        f"({library.training.count * FRAME_BYTES / 1e9:.1f} GB), by suite "
        f"{library.by_suite.tolist()}, "
        f"{library.held_out.count:,} held out, room for {library.training.capacity:,}",
        flush=True,
    )
    trainer.prepare(library)
    # The time of loading is subtracted from the training time, so that a run ends after --seconds.
    earlier = trainer.trained_seconds
    trainer.spent_seconds += time.monotonic() - start
    length = max(seconds - trainer.spent_seconds - earlier, 1.0)
    stop = start + (arguments.stop_after or math.inf)
    first = reported = saved = watched = time.monotonic()
    reported_step = trainer.step
    loss = torch.zeros((), device=device)
    while (now := time.monotonic()) - first < length and now < stop:
        fraction = (earlier + now - first) / (earlier + length)
        loss = trainer.train_step(library, wordings, fraction)
        trainer.trained_seconds = earlier + now - first
        if arguments.watch and now - watched > WATCH_SECONDS:
            library.refresh()
            watched = time.monotonic()
        if now - reported > REPORT_SECONDS:
            value = loss.item()
            if not math.isfinite(value):
                raise SystemExit(
                    f"the loss is {value} at step {trainer.step}; lower --learning-rate, and "
                    f"remove {arguments.run} or name another --run"
                )
            speed = (trainer.step - reported_step) / (time.monotonic() - reported)
            report(trainer, library, wordings, value, speed)
            reported, reported_step = time.monotonic(), trainer.step
        if now - saved > CHECKPOINT_SECONDS:
            trainer.save()
            saved = time.monotonic()
    trainer.save(finished=time.monotonic() < stop)
    report(trainer, library, wordings, loss.item(), trainer.step / max(trainer.trained_seconds, 1))


def report(
    trainer: Trainer, library: Library, wordings: Wordings, loss: float, speed: float
) -> None:
    """Validates the mean weights and prints a progress line."""
    distance, correct = (
        trainer.validate(library, wordings) if library.held_out.count else (np.nan,) * 2
    )
    print(
        f"{trainer.trained_seconds:4.0f} s  step {trainer.step:,} ({speed:.1f}/s)  "
        f"loss {loss:.4f}  held out: arm {distance:.4f}, gripper {100 * correct:.2f} %  "
        f"{library.training.count:,} frames",
        flush=True,
    )


def main() -> None:
    cuda = torch.cuda.is_available()
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, nargs="+", required=True, help="folders of shards")
    parser.add_argument("--run", type=Path, required=True, help="folder of checkpoint and weights")
    parser.add_argument(
        "--seconds", type=float, default=300.0,
        help="total time of a run, with start-up, summed over interruptions",
    )  # fmt: skip
    parser.add_argument(
        "--stop-after", type=float, metavar="SECONDS",
        help="stop after this time with a checkpoint, from which the same command resumes",
    )  # fmt: skip
    parser.add_argument(
        "--watch", action="store_true", help="wait for shards, and load new shards during training"
    )
    parser.add_argument(
        "--start-from", type=Path, metavar="WEIGHTS", help="file of the initial weights"
    )
    parser.add_argument("--name", default="student", help="name in the weights file")
    parser.add_argument("--batch", type=int, default=1024, help="frames per step")
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--weight-decay", type=float, default=1e-3)
    parser.add_argument("--wordings", type=int, default=4_000, help="wordings per task")
    parser.add_argument(
        "--capacity", type=int,
        help="largest number of frames; by default as many as fit on the GPU, without one 20,000",
    )  # fmt: skip
    parser.add_argument(
        "--processes", type=int, default=min(8, len(os.sched_getaffinity(0))),
        help="processes that draw the wordings at the start",
    )  # fmt: skip
    parser.add_argument(
        "--compile", action=argparse.BooleanOptionalAction, default=cuda,
        help="compile the network with torch.compile",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if cuda else "cpu")
    train(parser.parse_args())


if __name__ == "__main__":
    main()
