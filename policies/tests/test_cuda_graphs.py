"""A compiled network with CUDA graphs, which only its creating thread can use.

Runs where PyTorch finds a GPU, and is skipped elsewhere."""

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import Client, running

from rollout_policies import Camera, Description, fake_observation
from rollout_policies.fake import to_message

torch = pytest.importorskip("torch")

POLICY = '''
import numpy as np
import torch
from rollout_policies import Camera, Description, Policy, run

class Compiled(Policy):
    """A random network, compiled to CUDA graphs."""

    description = Description(name="compiled", horizon=8, cameras=(Camera("agentview", 64, 64),))

    def __init__(self):
        torch.manual_seed(0)
        layers = torch.nn.Linear(64 * 64 * 3, 256), torch.nn.Tanh(), torch.nn.Linear(256, 56)
        self.network = torch.compile(torch.nn.Sequential(*layers).cuda(), mode="reduce-overhead")

    def reset(self, episode):
        pass

    def infer(self, observation):
        frame = torch.from_numpy(observation.rotated("agentview")).cuda()
        with torch.inference_mode():
            torch.compiler.cudagraph_mark_step_begin()
            return self.network(frame.float().reshape(1, -1) / 255).tanh().reshape(8, 7).cpu()

run(Compiled)
'''


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch finds no GPU here")
def test_a_network_with_cuda_graphs_answers_many_connections(tmp_path):
    program = tmp_path / "compiled.py"
    program.write_text(POLICY)
    with running(sys.executable, program) as (_, address):
        described = Description("compiled", cameras=(Camera("agentview", 64, 64),))
        observations = [to_message(fake_observation(described, seed)) for seed in range(4)]

        def episode(number):
            client = Client(address)
            client.reset(session=f"s{number}")
            return [
                client.infer(f"s{number}", query, observation)
                for query, observation in enumerate(observations)
            ]

        with ThreadPoolExecutor(16) as pool:
            episodes = list(pool.map(episode, range(48)))
    for answers in episodes[1:]:
        assert np.array_equal(answers, episodes[0])
    assert not np.array_equal(episodes[0][0], episodes[0][1])
