"""Measures rollouts of one framework with one simulator, and prints a line of JSON.

`compare.py` runs this program for each simulator in turn, with the simulator in `PYTHONPATH`.
Options: --help."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from stand_ins import prepare

# Spawned processes import this file as well, and unpickle classes of the frameworks.
prepare()

#: Arms of the comparison: variants of a simulator, which the docstring of `compare.py` describes.
ARMS = ("O", "O'", "S", "S+", "V")


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("framework", choices=["rlinf", "simplevla"])
    parser.add_argument("arm", choices=ARMS)
    parser.add_argument("task")
    parser.add_argument("--environments", type=int, default=16)
    parser.add_argument("--chunk", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--policies", nargs="+", default=["none"])
    parser.add_argument("--shared-reset", action="store_true")
    flags = parser.parse_args()
    print(json.dumps(measure(flags)))


def measure(flags: argparse.Namespace) -> dict[str, Any]:
    """Runs rollouts with each policy. Returns the measurements of this process and of each
    policy."""
    from policies import Policy

    policies = [Policy(name) for name in flags.policies]
    # PyTorch and the accelerator's context belong to the policy, so they are loaded before the
    # environments' memory is measured.
    importlib.import_module("torch")
    memory, on_card = pss_mib(), _card_mib()
    begun = time.perf_counter()
    rollouts = _construct(flags)
    constructed = time.perf_counter() - begun
    actions = _actions(flags)
    results: dict[str, Any] = {}
    resets: list[float] = []
    try:
        # Measured separately: the first rollout compiles, fills caches, and starts processes.
        warm = time.perf_counter()
        rollouts.reset()
        rollouts.chunk(actions[0])
        warm = time.perf_counter() - warm
        for policy in policies:
            if not resets or not flags.shared_reset:
                begun = time.perf_counter()
                rollouts.reset()
                resets.append(time.perf_counter() - begun)
            results[policy.name] = {**_run(rollouts, policy, actions), "reset_s": resets[-1]}
        memory_each = (pss_mib() - memory) / flags.environments
        card = None if on_card is None else (_card_mib() or 0.0) - on_card
    finally:
        rollouts.close()
    for result in results.values():
        lasted = result.pop("lasted_s")
        result["steps_per_second"] = flags.environments * len(actions) * flags.chunk / lasted
        result["trajectories_per_second"] = flags.environments / (result["reset_s"] + lasted)
    return {
        "loop": rollouts.loop,
        "construct_s": constructed,
        "first_s": warm,
        "pss_mib": memory_each,
        "card_mib": card,
        "cpu_s": sum(resource.getrusage(who).ru_utime for who in _CPU_USERS),
        "policies": results,
    }


#: Processes whose CPU time is counted.
_CPU_USERS = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)


def _construct(flags: argparse.Namespace) -> Any:
    from rollouts import RLinf, Rows, SimpleVLA

    if flags.framework == "rlinf":
        return RLinf(flags.task, flags.environments, flags.steps, together=flags.arm == "V")
    if flags.arm == "V":
        return Rows(flags.task, flags.environments)
    return SimpleVLA(flags.task, flags.environments, every_frame=flags.arm == "S")


def _run(rollouts: Any, policy: Any, actions: np.ndarray) -> dict[str, float]:
    """Executes chunks of actions, each after an answer of the policy. Returns durations; for the
    policy `busy`, also the rate of its matrix products."""
    answered_and_simulated, simulated = [], []
    with policy:
        products, start = policy.products(), time.perf_counter()
        for chunk in actions:
            begun = time.perf_counter()
            policy.answer()
            answered = time.perf_counter()
            rollouts.chunk(chunk)
            end = time.perf_counter()
            answered_and_simulated.append(1e3 * (end - begun))
            simulated.append(1e3 * (end - answered))
        lasted = time.perf_counter() - start
        products = policy.products() - products
    result = {
        "chunk_ms_p50": float(np.percentile(answered_and_simulated, 50)),
        "chunk_ms_p95": float(np.percentile(answered_and_simulated, 95)),
        "simulation_ms_p50": float(np.percentile(simulated, 50)),
        "lasted_s": lasted,
    }
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
