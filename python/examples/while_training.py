"""Judges a policy while it is trained, and ends the training once it is worse than a baseline.

    python while_training.py --against baseline

COORDINATOR_URL names a coordinator whose workers run on this machine, `--against` a finished
campaign. Replace the simulated network and the simulated states by your own.
"""

import argparse
import sys
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from rollout_client import Client
from rollout_policies import Description, Episode, Observation, Policy, State, start

#: Returns an action [7] for a state [8].
Act = Callable[[np.ndarray], np.ndarray]


class Checkpoint(Policy):
    """The weights of one step; they stay as they are, because the training waits."""

    def __init__(self, step: int, act: Act) -> None:
        state = (State.EEF_POS, State.EEF_AXIS_ANGLE, State.GRIPPER_POS)
        self.description = Description(f"step-{step}", state=state)
        self.act = act

    def reset(self, episode: Episode) -> None:
        """Does nothing: every answer depends only on its observation."""

    def infer(self, observation: Observation) -> np.ndarray:
        return self.act(observation.vector())


def judge(step: int, act: Act, against: str, **options: Any) -> dict[str, Any]:
    """Serves the weights until `Client.gate`, with its options, has decided. Returns the
    decision."""
    server = start(Checkpoint(step, act))
    try:
        endpoint = f"http://{server.address}"
        answer = Client().gate(f"step-{step}", against, endpoint=endpoint, **options)
    finally:
        server.stop()
    [decision] = answer["decisions"]
    return decision


def main() -> None:
    import torch  # Here, because the functions above suit every framework.

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", required=True, metavar="CAMPAIGN")
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--every", type=int, default=1_000, help="steps between two decisions")
    parser.add_argument("--budget", type=int, default=500, help="rollouts of a decision")
    arguments = parser.parse_args()

    logs: list[Callable[[str, float, int], object]] = []
    if find_spec("tensorboard"):
        from torch.utils.tensorboard import SummaryWriter

        logs.append(SummaryWriter().add_scalar)
    if find_spec("wandb"):
        import wandb

        wandb.init()
        logs.append(lambda name, value, step: wandb.log({name: value}, step=step))

    simulated_network = torch.nn.Linear(8, 7)
    optimizer = torch.optim.Adam(simulated_network.parameters())

    @torch.inference_mode()
    def act(state: np.ndarray) -> np.ndarray:
        return simulated_network(torch.from_numpy(state).float()).numpy()

    for step in range(1, arguments.steps + 1):
        simulated_states = torch.randn(64, 8)
        loss = simulated_network(simulated_states).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if step % arguments.every == 0:
            simulated_network.eval()
            decision = judge(step, act, arguments.against, budget=arguments.budget)
            simulated_network.train()
            print(f"step {step}: {decision['verdict']} after {decision['rollouts']} rollouts")
            for log in logs:
                for of in decision["conditions"]:
                    log(f"gate/{of['condition']}", of["difference"], step)
            if decision["verdict"] == "worse":
                sys.exit(f"the training ends: step {step} is worse than {arguments.against}")


if __name__ == "__main__":
    main()
