"""Prints the rows of a campaign in Meta-World: nominal, sensor, actuation, both, and their placebo.

    python rows.py [TASK …] > rows.jsonl
"""

import json
import sys

RADII = (2, 4, 8)
SEEDS = range(10)

for task in sys.argv[1:] or ["reach-v3", "push-v3"]:
    for seed in SEEDS:
        row = {"simulator": "metaworld", "task": task, "seed": seed}
        print(json.dumps(row))
        for axes in (["sensor"], ["actuation"], ["sensor", "actuation"]):
            print(json.dumps({**row, "axes": axes, "radius": 0.02, "placebo": True}))
            for radius in RADII:
                print(json.dumps({**row, "axes": axes, "radius": radius}))
