"""Writes expected.json: results of NumPy and SciPy for random data sets and the example data, with
which tests/reference.rs compares the crate's results. Shares no code with the crate, and resamples
with another random generator.

    python3 -m venv venv && venv/bin/pip install numpy==2.4.6 scipy==1.17.1
    venv/bin/python crates/paired/tests/it/reference/expected.py

Takes a few seconds. A data set is one text per task, two hexadecimal digits per configuration: bits
0 to 5 are the success under camera, lighting, robot, sensor, actuation and language alone, bit 6 is
the success under simultaneous perturbation. A data set of two policies has one digit per rollout:
bit 0 is the success of A, bit 1 that of B."""

import json
from pathlib import Path

import numpy as np
import scipy
from scipy.stats import binomtest

HERE = Path(__file__).parent
EXAMPLE = HERE / "../../../../../examples/openvla_oft/rollouts.jsonl"
AXES = ["camera", "lighting", "robot", "sensor", "actuation", "language"]
DATA_SETS = 20
PAIRED_SETS = 12
RESAMPLINGS = 100_000
INTERVALS = ["d", "i", "r_e", "r_c", "r_d"]


def measures(y):
    """Returns all measures of an array of outcomes, configurations x 7."""
    alone, simultaneous = y[:, :6], y[:, 6]
    conjunction = alone.all(axis=1)
    s_axis = alone.mean(axis=0)
    return {
        "n": len(y),
        "b": int((conjunction & ~simultaneous).sum()),
        "c": int((~conjunction & simultaneous).sum()),
        "s_axis": dict(zip(AXES, s_axis.tolist())),
        "s_indep": float(np.prod(s_axis)),
        "s_conj": float(conjunction.mean()),
        "s_sim": float(simultaneous.mean()),
        "d": float(conjunction.mean() - np.prod(s_axis)),
        "i": float(simultaneous.mean() - conjunction.mean()),
        "r_e": float((conjunction & ~simultaneous).mean()),
        "r_c": float((~conjunction & simultaneous).mean()),
        "r_d": float((conjunction != simultaneous).mean()),
    }


def resampled(tasks, rng):
    """Returns the measures with an interval, for every resampling of whole tasks."""
    sums = np.array(
        [
            [
                len(y),
                *y.sum(axis=0),
                y[:, :6].all(axis=1).sum(),
                (y[:, :6].all(axis=1) & ~y[:, 6]).sum(),
                (~y[:, :6].all(axis=1) & y[:, 6]).sum(),
            ]
            for y in tasks
        ],
        dtype=float,
    )
    drawn = rng.integers(len(tasks), size=(RESAMPLINGS, len(tasks)))
    total = np.zeros((RESAMPLINGS, sums.shape[1]))
    for column in drawn.T:
        total += sums[column]
    rates = total[:, 1:] / total[:, :1]
    alone, simultaneous, conjunction, r_e, r_c = (
        rates[:, :6],
        rates[:, 6],
        rates[:, 7],
        rates[:, 8],
        rates[:, 9],
    )
    d = conjunction - alone.prod(axis=1)
    return dict(zip(INTERVALS, [d, simultaneous - conjunction, r_e, r_c, r_e + r_c]))


def expected(tasks, rng):
    """Returns the measures, with their intervals by resampling whole tasks."""
    y = np.concatenate(tasks)
    result = measures(y)
    for name, values in resampled(tasks, rng).items():
        result[f"{name}_ci95"] = np.percentile(values, [2.5, 97.5]).tolist()
        result[f"{name}_deviation"] = float(values.std())
    b, c = result["b"], result["c"]
    result["mcnemar_p"] = float(binomtest(b, b + c, 0.5).pvalue) if b + c else 1.0
    return result


def random_tasks(rng):
    """Returns random outcomes of tasks. Tasks differ in difficulty, failures of the axes are
    correlated, and simultaneous perturbation is harder or easier than the axes alone."""
    ease = rng.normal(rng.uniform(0.5, 2.5), 0.8, size=rng.integers(4, 41))
    shift = rng.uniform(-1.5, 1.0)
    tasks = []
    for task_ease in ease:
        config_ease = rng.normal(task_ease, 0.7, size=rng.integers(1, 11))[:, None]
        logit = config_ease + rng.normal(0.8, 0.8, size=(1, 7))
        logit[:, 6] += shift
        tasks.append(rng.random(logit.shape) < 1 / (1 + np.exp(-logit)))
    return tasks


def text(y):
    """Returns the outcomes of one task in the form of a data set."""
    return "".join(f"{sum(int(v) << k for k, v in enumerate(row)):02x}" for row in y)


def random_pairs(rng):
    """Returns outcomes of two policies with correlated task difficulties and unequal numbers of
    rollouts."""
    ease = rng.normal(rng.uniform(-1.0, 2.0), 1.0, size=rng.integers(10, 41))
    shift = rng.uniform(-1.0, 1.0)
    tasks = []
    for task_ease in ease:
        gap = rng.normal(shift, 0.8)
        rollout_ease = rng.normal(task_ease, 0.8, size=rng.integers(1, 31))
        logit = np.stack([rollout_ease + gap / 2, rollout_ease - gap / 2], axis=1)
        tasks.append(rng.random(logit.shape) < 1 / (1 + np.exp(-logit)))
    return tasks


def difference(tasks, rng):
    """Returns A - B over the same rollouts, with its interval by resampling whole tasks."""
    y = np.concatenate(tasks)
    a, b = y[:, 0], y[:, 1]
    net = np.array([float(t[:, 0].sum()) - float(t[:, 1].sum()) for t in tasks])
    size = np.array([len(t) for t in tasks], dtype=float)
    times = rng.multinomial(len(tasks), np.full(len(tasks), 1 / len(tasks)), size=RESAMPLINGS)
    values = (times @ net) / (times @ size)
    a_only, b_only = int((a & ~b).sum()), int((b & ~a).sum())
    test = binomtest(a_only, a_only + b_only, 0.5).pvalue if a_only + b_only else 1.0
    return {
        "n": len(y),
        "tasks": len(tasks),
        "both": int((a & b).sum()),
        "a_only": a_only,
        "b_only": b_only,
        "neither": int((~a & ~b).sum()),
        "s_a": float(a.mean()),
        "s_b": float(b.mean()),
        "difference": float(a.mean() - b.mean()),
        "difference_ci95": np.percentile(values, [2.5, 97.5]).tolist(),
        "difference_deviation": float(values.std()),
        "mcnemar_p": float(test),
    }


def pairs_text(y):
    """Returns the outcomes of two policies in one task in the form of a data set."""
    return "".join(str(int(a) + 2 * int(b)) for a, b in y)


def example(level):
    """Returns the outcomes of the example data at a level, an array per task."""
    rows = {}
    for line in EXAMPLE.read_text().splitlines():
        row = json.loads(line)
        suite, task, condition, row_level, config = row["rollout_id"].split("/")
        if row_level == level:
            rows[suite, task, condition, config] = row["success"]
    columns = [*AXES, "combination"]
    tasks = sorted({key[:2] for key in rows})
    configs = sorted({key[3] for key in rows})
    return [
        np.array([[rows[(*task, column, config)] for column in columns] for config in configs])
        for task in tasks
    ]


def in_lines(value):
    """Returns a value as JSON; a list of objects with a line for each of them."""
    if not (isinstance(value, list) and isinstance(value[0], dict)):
        return json.dumps(value)
    return "[\n" + ",\n".join(f"  {json.dumps(entry)}" for entry in value) + "\n ]"


def main():
    rng = np.random.default_rng(20260904)
    data_sets = []
    for _ in range(DATA_SETS):
        tasks = random_tasks(rng)
        data_sets.append({"tasks": [text(y) for y in tasks], "expected": expected(tasks, rng)})
    counts = [(0, 0), (0, 1), (0, 5), (5, 5), (1, 9), (12, 3), (54, 55), (28, 57), (65, 14),
              (91, 47), (0, 400), (700, 900), (2000, 2100)]
    samples = [rng.normal(size=n) for n in [1, 2, 3, 10, 101]]
    shares = [0, 0.025, 0.3, 0.5, 0.975, 1]
    # A separate generator, so that the data sets above do not depend on the number of pairs.
    pairs_rng = np.random.default_rng(20260905)
    paired_sets = []
    for _ in range(PAIRED_SETS):
        tasks = random_pairs(pairs_rng)
        paired_sets.append(
            {
                "tasks": [pairs_text(y) for y in tasks],
                "expected": difference(tasks, pairs_rng),
            }
        )
    document = {
        "made_with": {"numpy": np.__version__, "scipy": scipy.__version__},
        "resamplings": RESAMPLINGS,
        "mcnemar": [
            {"b": b, "c": c, "p": float(binomtest(b, b + c, 0.5).pvalue) if b + c else 1.0}
            for b, c in counts
        ],
        "quantiles": [
            {
                "sorted": sorted(sample.tolist()),
                "shares": shares,
                "values": np.percentile(sample, [100 * share for share in shares]).tolist(),
            }
            for sample in samples
        ],
        "data_sets": data_sets,
        "openvla_oft": {level: expected(example(level), rng) for level in ["L1", "L2", "L3"]},
        "paired_sets": paired_sets,
    }
    entries = (f" {json.dumps(name)}: {in_lines(value)}" for name, value in document.items())
    (HERE / "expected.json").write_text("{\n" + ",\n".join(entries) + "\n}\n")


main()
