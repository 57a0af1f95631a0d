"""Prints the rows of a campaign in Meta-World: nominal, sensor, actuation, both.

    python rows.py [--seeds N] [--radii R,…] [--placebo] [TASK …] > rows.jsonl
"""

import argparse
import json

from metaworld.policies import ENV_POLICY_MAP

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("tasks", nargs="*", default=sorted(ENV_POLICY_MAP))
parser.add_argument("--seeds", type=int, default=10)
parser.add_argument("--radii", default="32")
parser.add_argument("--placebo", action="store_true", help="with the three conditions at L0")
options = parser.parse_args()
levels = [{"radius": float(radius)} for radius in options.radii.split(",")]
if options.placebo:
    levels.append({"radius": 0.02, "placebo": True})

for task in options.tasks:
    for seed in range(options.seeds):
        row = {"simulator": "metaworld", "task": task, "seed": seed}
        print(json.dumps(row))
        for axes in (["sensor"], ["actuation"], ["sensor", "actuation"]):
            for level in levels:
                print(json.dumps({**row, "axes": axes, **level}))
