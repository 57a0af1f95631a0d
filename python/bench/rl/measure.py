"""Measures rollouts of one framework with one simulator, and prints a line of JSON.

`compare.py` runs this program for each simulator in turn, with the simulator in `PYTHONPATH`.
Options: --help."""

import argparse
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

# Spawned processes import this file as well, and unpickle classes of the frameworks.
from rollouts import RLinf, Rows, SimpleVLA

#: Side of the multiplied matrices.
_SIDE = 8192


class Policy:
    """A policy by name: `none`, `sleep:MS`, `card:MS`, `busy`.

    `none` answers at once, and `sleep:MS` after MS milliseconds; `card:MS` multiplies matrices on
    the accelerator for MS milliseconds. With `busy`, another process multiplies matrices without a
    pause, like a policy that answers another worker's environments."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.kind, _, ms = name.partition(":")
        if self.kind not in ("none", "sleep", "card", "busy"):
            raise ValueError(f"policy {name}: choose none, sleep:MS, card:MS or busy")
        self.seconds = float(ms or 0) / 1e3
        self._busy_process: Any = None
        self._products: Any = None
        if self.kind == "card":
            self._left, self._right = _matrices()
            _multiply(self._left, self._right)

    def __enter__(self) -> "Policy":
        if self.kind == "busy":
            context = multiprocessing.get_context("spawn")
            self._products = context.Value("L", 0)
            self._busy_process = context.Process(
                target=_keep_busy, args=(self._products,), daemon=True
            )
            self._busy_process.start()
            while not self._products.value:
                if not self._busy_process.is_alive():
                    raise RuntimeError("the process that keeps the accelerator busy has ended")
                time.sleep(0.05)
        return self

    def __exit__(self, *_error: Any) -> None:
        if self._busy_process is not None:
            self._busy_process.terminate()
            self._busy_process.join()
            self._busy_process = None

    def answer(self) -> None:
        """Blocks for the duration of an answer."""
        if self.kind == "sleep":
            time.sleep(self.seconds)
        elif self.kind == "card":
            end = time.perf_counter() + self.seconds
            while time.perf_counter() < end:
                _multiply(self._left, self._right)

    def products(self) -> int:
        """Returns the number of matrix products that the busy process has computed."""
        return self._products.value if self._products is not None else 0


def _matrices() -> tuple[Any, Any]:
    import torch

    device = "cuda" if torch.cuda.is_available() else "cpu"
    side = _SIDE if device == "cuda" else 256
    dtype = torch.bfloat16 if device == "cuda" else torch.float32
    return tuple(torch.randn(side, side, device=device, dtype=dtype) for _ in range(2))  # type: ignore[return-value]


def _multiply(left: Any, right: Any) -> None:
    import torch

    left @ right
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def _keep_busy(products: Any) -> None:
    left, right = _matrices()
    while True:
        _multiply(left, right)
        products.value += 1


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("framework", choices=["rlinf", "simplevla"])
    parser.add_argument("arm", choices=["O", "S", "V"])
    parser.add_argument("task")
    parser.add_argument("--environments", type=int, default=16)
    parser.add_argument("--chunk", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--policies", nargs="+", default=["none"])
    flags = parser.parse_args()
    print(json.dumps(measure(flags)))


def measure(flags: argparse.Namespace) -> dict[str, Any]:
    """Runs rollouts with each policy. Returns the measurements of this process and of each
    policy."""
    policies = [Policy(name) for name in flags.policies]
    # PyTorch and the accelerator's context belong to the policy, so they are loaded before the
    # environments' memory is measured.
    importlib.import_module("torch")
    memory, on_card = pss_mib(), _card_mib()
    rollouts = _construct(flags)
    actions = _actions(flags)
    results: dict[str, Any] = {}
    try:
        # The first rollout compiles, fills caches, and starts processes.
        rollouts.reset()
        rollouts.chunk(actions[0])
        for policy in policies:
            begun = time.perf_counter()
            rollouts.reset()
            reset = time.perf_counter() - begun
            results[policy.name] = {"reset_s": reset, **_run(rollouts, policy, actions)}
        memory_each = (pss_mib() - memory) / flags.environments
        card = None if on_card is None else (_card_mib() or 0.0) - on_card
    finally:
        rollouts.close()
    for result in results.values():
        lasted = result.pop("lasted_s")
        result["steps_per_second"] = flags.environments * len(actions) * flags.chunk / lasted
        result["trajectories_per_second"] = flags.environments / (result["reset_s"] + lasted)
    return {"pss_mib": memory_each, "card_mib": card, "policies": results}


def _construct(flags: argparse.Namespace) -> Any:
    if flags.framework == "rlinf":
        return RLinf(flags.task, flags.environments, flags.steps, together=flags.arm == "V")
    if flags.arm == "V":
        return Rows(flags.task, flags.environments)
    return SimpleVLA(flags.task, flags.environments)


def _run(rollouts: Any, policy: Any, actions: np.ndarray) -> dict[str, float]:
    """Executes chunks of actions, each after an answer of the policy. Returns durations; for the
    policy `busy`, also the rate of its matrix products."""
    with policy:
        products, start = policy.products(), time.perf_counter()
        for chunk in actions:
            policy.answer()
            rollouts.chunk(chunk)
        lasted = time.perf_counter() - start
        products = policy.products() - products
    result = {"lasted_s": lasted}
    if policy.kind == "busy":
        result["products_per_second"] = products / lasted
    return result


def _actions(flags: argparse.Namespace) -> np.ndarray:
    """Returns a smooth motion in the air, [chunks, environments, steps of a chunk, 7]."""
    chunks = max(1, flags.steps // flags.chunk)
    phase = np.linspace(0, 3, chunks * flags.chunk)[:, None] + np.arange(7)
    amplitudes = np.linspace(0.2, 0.4, flags.environments)[:, None, None]
    moves = amplitudes * np.sin(phase)
    return moves.reshape(flags.environments, chunks, flags.chunk, 7).swapaxes(0, 1)


def pss_mib() -> float:
    """Returns the memory of this process and its descendants, shared pages counted once, MiB."""
    total = 0
    for process in _with_descendants(os.getpid()):
        try:
            lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total / 1024


def _with_descendants(root: int) -> list[int]:
    """Returns the ids of a process and of all its descendants."""
    children: dict[int, list[int]] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        children.setdefault(int(fields[1]), []).append(int(status.parent.name))
    processes = [root]
    for process in processes:
        processes += children.get(process, [])
    return processes


def _card_mib() -> float | None:
    """Returns the memory in use on the first accelerator, MiB; None without one."""
    command = ["nvidia-smi", "--id=0", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
    try:
        query = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return float(query.stdout)


if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    main()
