"""Runs the nominal rollouts of a manifest, then all rollouts of the tasks that were solved.

    coordinator manifest --version v0.1 --output rows.jsonl
    COORDINATOR_URL=http://127.0.0.1:7411 \
        python perturb_solved.py rows.jsonl student http://127.0.0.1:7412
"""

import json
import sys
from pathlib import Path

from rollout_client import Client

path, policy, endpoint = sys.argv[1:]
rows = [json.loads(line) for line in Path(path).read_text().splitlines()]
client = Client()
spec = {"name": "solved", "policy": {"name": policy, "endpoint": endpoint}}
campaign = client.create(spec, rows=[row for row in rows if row["config"] is None])
for status in campaign.follow():
    print(status.committed, "of", status.total)
results = campaign.results()
tasks = results.loc[results["success"], ["suite", "task_id"]]
solved = set(tasks.itertuples(index=False, name=None))
added = client.append("solved", [row for row in rows if (row["suite"], row["task_id"]) in solved])
print(f"solved {len(solved)} tasks, whose other rollouts were added: {added}")
