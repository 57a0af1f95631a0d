"""Two thousand episodes: a server's memory and speed stay constant."""

import resource
import statistics
import sys
import time
from pathlib import Path

import pytest
from conftest import Client, running

EPISODES = 2_000
QUERIES = 2
#: Number of episodes between two memory measurements.
EPISODES_PER_MEASUREMENT = 20
#: Largest medians of memory and of latency in a later quarter of the run, relative to the first
#: quarter. If episodes never ended, memory would grow by the state of a thousand episodes.
MORE_MEMORY, MORE_LATENCY = 1.5, 3.0

POLICY = """
import numpy as np
from rollout_policies import Description, Policy, run

class Heavy(Policy):
    description = Description("heavy", stateful=True)

    def reset(self, episode):
        episode.memory = np.ones(1 << 20, dtype=np.uint8)

    def infer(self, observation):
        observation.episode.memory += 1
        return -np.ones(7) / observation.episode.memory[0]

run(Heavy)
"""


def resident_bytes(process_id):
    pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
    return pages * resource.getpagesize()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc to read memory from")
def test_memory_and_latency_are_level_over_two_thousand_episodes(tmp_path):
    script = tmp_path / "heavy_policy.py"
    script.write_text(POLICY)
    memory, latencies = [], []
    with running(sys.executable, str(script)) as (process, address):
        client = Client(address)
        for episode in range(EPISODES):
            name = f"goal/t0/clean/i{episode:04}#r0"
            client.reset(name)
            for query_index in range(QUERIES):
                sent = time.perf_counter()
                client.infer(name, query_index)
                latencies.append(time.perf_counter() - sent)
            client.end(name)
            if episode % EPISODES_PER_MEASUREMENT == 0:
                memory.append(resident_bytes(process.pid))
        client.channel.close()
    for measured, factor in ((memory, MORE_MEMORY), (latencies, MORE_LATENCY)):
        size = len(measured) // 4
        quarters = [statistics.median(measured[at * size :][:size]) for at in range(4)]
        print(quarters)
        assert max(quarters[1:]) <= factor * quarters[0], quarters
