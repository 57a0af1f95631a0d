"""Compares the inferential statistics of reports with values computed by NumPy and SciPy only.

    python3 recompute.py campaigns.json

The file is a list of two kinds of entries. A campaign has a "name", its "report" (JSON), and:

- "levels": per level, a row per configuration and replicate,
  [suite, task, config, nominal or null, [each axis alone], simultaneous];
- "nominal": a row per nominal rollout, [suite, task, success];
- "published": the success rate that the gates compare with;
- "suites": each suite's name and number.

A comparison of two policies has a "name" and "compared": per row, its "name", "own_directions",
"difference", "progress" and "pairs": [suite, task, number, A, B, [goal of A, of B], [steps of A, of
B]], where a goal is [predicates that held, predicates].

Prints how many figures agree; fails if any does not, and names at most 20 of those. Shares no code
with the crate `paired`; the formulas are those of docs/dev/STATISTICS.md. Variances up to 1e-24
count as zero."""

import json
import sys

import numpy as np
from scipy.stats import t as student

AXES = ["camera", "lighting", "robot", "sensor", "actuation", "language"]
ALPHA = 0.05
MARGIN = 0.05
FINDING_ALPHA = 0.01
MIN_TASKS = 5
PERMUTATIONS = 1999
SIGNS = 4000
# Allows for the sampling error of two 95th percentiles of 4,000 draws each.
SIGNS_TOLERANCE = 0.06
TOLERANCE = 1e-9


def grouped(labels, rows=None):
    """Returns the rows of each label, among all or these rows."""
    labels, order = list(labels), {}
    for row in range(len(labels)) if rows is None else rows:
        order.setdefault(labels[row], []).append(row)
    return order


def summed(keys, values):
    """Returns the distinct keys, and the sum of each one's rows."""
    rows = grouped(keys)
    return list(rows), np.array([values[indices].sum(axis=0) for indices in rows.values()])


class Sample:
    """Rows of numbers, with the groups that a jackknife leaves out. `own_directions`: True if each
    task has its own directions of perturbation, False if all tasks share each configuration's.
    Rows with the same key, the replicates of a configuration, are added up."""

    def __init__(self, keys, values, own_directions=False):
        self.own_directions = own_directions
        keys, self.x = summed(keys, np.array(values, dtype=float))
        suites = [suite for suite, _, _ in keys]
        tasks = [(suite, task) for suite, task, _ in keys]
        if any(len({t for t, s in zip(tasks, suites) if s == suite}) < 2 for suite in set(suites)):
            suites = [0] * len(keys)
        rows = [[[row] for row in rows] for rows in grouped(suites).values()]
        tasks_by_suite = [list(grouped(tasks, rows).values()) for rows in grouped(suites).values()]
        self.tasks = len(set(tasks))
        self.in_task = self.leave_out([[[row] for row in rows] for rows in grouped(tasks).values()])
        self.by_task = self.leave_out(tasks_by_suite)
        self.by_row = self.leave_out(rows)
        by_direction = grouped(config for _, _, config in keys)
        self.by_direction = self.leave_out([list(by_direction.values())])

    def leave_out(self, strata):
        """Returns the sums after leaving out each group, with the rest of its stratum scaled by
        g / (g - 1), and the number g of groups in each stratum; None if a stratum has one group."""
        if any(len(groups) < 2 for groups in strata):
            return None
        total, parts = self.x.sum(axis=0), []
        for groups in strata:
            g = len(groups)
            sums = np.array([self.x[rows].sum(axis=0) for rows in groups])
            whole = sums.sum(axis=0)
            parts.append((total - whole + (whole - sums) * g / (g - 1)).T)
        sizes = np.array([len(groups) for groups in strata])
        return np.concatenate(parts, axis=1), sizes

    def jackknife(self, f, left_out):
        if left_out is None:
            return None
        sums, sizes = left_out
        theta = f(sums)
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        means = np.add.reduceat(theta, starts) / sizes
        squares = np.add.reduceat((theta - np.repeat(means, sizes)) ** 2, starts)
        variance = float(((sizes - 1) / sizes * squares).sum())
        return (variance, int((sizes - 1).sum())) if np.isfinite(variance) else None

    def estimate(self, f, scale):
        """`scale`: True for a share, False for a difference of shares, "product" for a product of
        shares, "mean" for a mean without bounds."""
        with np.errstate(all="ignore"):
            value = float(f(self.x.sum(axis=0)))
            if not np.isfinite(value):
                return None
            within = self.jackknife(f, self.in_task)
            new = self.jackknife(f, self.by_task)
            directions = self.jackknife(f, self.by_direction)
            rows = self.jackknife(f, self.by_row)
        both = None
        if new and directions and rows:
            variance = max(new[0] + directions[0] - rows[0], new[0], directions[0])
            parts = sum(v**2 / df for v, df in (new, directions, rows))
            df = variance**2 / parts if variance > 1e-24 else min(new[1], directions[1])
            both = (variance, df)
        if self.own_directions:
            both = new
        if self.tasks < MIN_TASKS:
            new = both = None
        interval = {"product": product_interval, "mean": unbounded_t_interval}.get(
            scale, wilson if scale else t_interval
        )
        has_spread = new is not None and new[0] > 1e-24
        return {
            "value": value,
            "these_tasks": interval(value, within, len(self.x)),
            "new_tasks": interval(value, new, self.tasks),
            "new_tasks_and_directions": interval(value, both, self.tasks),
            "standard_error": new[0] ** 0.5 if has_spread else None,
            "df": float(new[1]) if has_spread else None,
        }


def t_interval(value, variance, _, most=1.0):
    if variance is None or variance[0] <= 1e-24:
        return None
    half = student.isf(ALPHA / 2, variance[1]) * variance[0] ** 0.5
    return [max(value - half, -most), min(value + half, most)]


def unbounded_t_interval(value, variance, units):
    """Interval around a mean in a unit without bounds, such as steps: its ends are not clipped."""
    return t_interval(value, variance, units, np.inf)


def product_interval(value, variance, _):
    """Interval on the scale log(-log), on which a product of shares is the log of a sum."""
    if variance is None or variance[0] <= 1e-24 or not 0 < value < 1:
        return None
    centre = np.log(-np.log(value))
    half = student.isf(ALPHA / 2, variance[1]) * variance[0] ** 0.5 / (-value * np.log(value))
    return [float(np.exp(-np.exp(centre + sign * half))) for sign in (1, -1)]


def wilson(p, variance, units):
    if variance is None:
        return None
    z = student.isf(ALPHA / 2, variance[1])
    if 0 < p < 1:
        if variance[0] <= 1e-24:
            return None
        n = p * (1 - p) / variance[0]
    else:
        n = units
    # The roots of (p - q)^2 = z^2 q (1 - q) / n.
    a, b, c = 1 + z * z / n, -(2 * p + z * z / n), p * p
    root = max(b * b - 4 * a * c, 0) ** 0.5
    return [max((-b - root) / (2 * a), 0.0), min((-b + root) / (2 * a), 1.0)]


def sign_flip(net):
    """P(|sum of signs times net| >= |observed|), by convolution."""
    distribution = np.ones(1)
    for change in net:
        kernel = np.zeros(2 * abs(change) + 1)
        kernel[0] += 0.5
        kernel[-1] += 0.5
        distribution = np.convolve(distribution, kernel)
    reach = len(distribution) // 2
    is_extreme = np.abs(np.arange(-reach, reach + 1)) >= abs(sum(net))
    return float(distribution[is_extreme].sum())


def holm(p):
    p = np.array(p, dtype=float)
    order = np.argsort(p, kind="stable")
    stepped = np.minimum(p[order] * (len(p) - np.arange(len(p))), 1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.maximum.accumulate(stepped)
    return adjusted.tolist()


def two_sided(estimate):
    if estimate["standard_error"] is None:
        return None
    return float(
        2 * student.sf(abs(estimate["value"]) / estimate["standard_error"], estimate["df"])
    )


def equivalence(estimate):
    if estimate["standard_error"] is None:
        return None
    statistic = (MARGIN - abs(estimate["value"])) / estimate["standard_error"]
    return float(student.sf(statistic, estimate["df"]))


def net_by_task(keys, change):
    net = {}
    for (suite, task, _), value in zip(keys, change):
        net[suite, task] = net.get((suite, task), 0) + int(value)
    return list(net.values())


def loss(keys, nominal, success):
    sample = Sample(keys, np.column_stack([np.ones(len(keys)), nominal, success]))
    difference = sample.estimate(lambda s: (s[1] - s[2]) / s[0], False)
    return {
        "n": len(keys),
        "nominal": sample.estimate(lambda s: s[1] / s[0], True),
        "success": sample.estimate(lambda s: s[2] / s[0], True),
        "loss": difference,
        "nominal_only": int(((nominal == 1) & (success == 0)).sum()),
        "condition_only": int(((nominal == 0) & (success == 1)).sum()),
        "sign_flip_p": sign_flip(net_by_task(keys, nominal - success)),
        "equivalence_p": equivalence(difference),
    }


def excess(keys, y, placebo):
    """Excess over the placebo; `placebo` is (keys, outcomes), the last column simultaneous."""
    rows = {}
    for key, outcomes in zip(keys, y):
        alone = outcomes[:-1].all()
        row = [1, alone and not outcomes[-1], not alone and outcomes[-1], 0, 0, 0]
        rows[key] = np.add(rows.get(key, 0), np.array(row, dtype=float))
    for key, outcomes in zip(*placebo):
        m, chosen = len(outcomes), []
        # Every rollout takes the role of the simultaneous rollout in turn.
        for at in range(m):
            alone = np.delete(outcomes, at).all()
            chosen.append([alone and not outcomes[at], not alone and outcomes[at]])
        row = [0, 0, 0, 1, *np.mean(np.array(chosen, dtype=float), axis=0)]
        rows[key] = np.add(rows.get(key, 0), row)
    sample = Sample(list(rows), list(rows.values()))

    def estimates(statistic, is_share):
        weights = {"r_e": (1, 0), "r_c": (0, 1), "r_d": (1, 1), "i": (-1, 1)}
        return {
            name: sample.estimate(lambda s, w=w: statistic(s, *w), is_share and name != "i")
            for name, w in weights.items()
        }

    floor = lambda s, e, c: (e * s[4] + c * s[5]) / s[3]
    return {
        "n": len(y),
        "placebo": len(placebo[1]),
        "floor": estimates(floor, True),
        "excess": estimates(lambda s, e, c: (e * s[1] + c * s[2]) / s[0] - floor(s, e, c), False),
    }


def directions(keys, simultaneous):
    """Rates by direction, and the p-value from this script's own random permutations."""
    rng = np.random.default_rng(1)
    replicates = len(keys) / len(set(keys))
    keys, simultaneous = summed(keys, simultaneous)
    configs = np.array([config for _, _, config in keys])
    tasks = np.unique([suite * 100 + task for suite, task, _ in keys], return_inverse=True)[1]
    names = np.unique(configs)
    weights = (configs[:, None] == names).astype(float)
    sizes = weights.sum(axis=0) * replicates

    def spread(y):
        return ((y @ weights) ** 2 / sizes).sum(axis=-1)

    shuffled = np.tile(simultaneous, (PERMUTATIONS, 1))
    for task in range(tasks.max() + 1):
        columns = np.flatnonzero(tasks == task)
        shuffled[:, columns] = rng.permuted(shuffled[:, columns], axis=1)
    extreme = (spread(shuffled) >= spread(simultaneous) - 1e-9).sum()
    rates = simultaneous @ weights / sizes
    return dict(zip(map(str, names.tolist()), rates.tolist())), (extreme + 1) / (PERMUTATIONS + 1)


def inference(rows, placebo):
    keys = [tuple(row[:3]) for row in rows]
    alone = np.array([row[4] for row in rows], dtype=float)
    sim = np.array([row[5] for row in rows], dtype=float)
    conj = alone.all(axis=1).astype(float)
    e, c = conj * (1 - sim), (1 - conj) * sim
    columns = np.column_stack([np.ones(len(rows)), conj, sim, e, c, alone])
    sample = Sample(keys, columns)
    indep = lambda s: np.prod(s[5:] / s[0], axis=0)
    estimate = sample.estimate
    result = {
        "paired": {
            "s_indep": estimate(indep, "product"),
            "s_conj": estimate(lambda s: s[1] / s[0], True),
            "s_sim": estimate(lambda s: s[2] / s[0], True),
            "d": estimate(lambda s: s[1] / s[0] - indep(s), False),
            "i": estimate(lambda s: (s[2] - s[1]) / s[0], False),
            "r_e": estimate(lambda s: s[3] / s[0], True),
            "r_c": estimate(lambda s: s[4] / s[0], True),
            "r_d": estimate(lambda s: (s[3] + s[4]) / s[0], True),
        },
        "eligible": {
            "emergent": estimate(lambda s: s[3] / s[1], True),
            "compensated": estimate(lambda s: s[4] / (s[0] - s[1]), True),
        },
        "i_sign_flip_p": sign_flip(net_by_task(keys, sim - conj)),
        "relative": None,
        "losses": {},
    }
    if rows[0][3] is not None:
        nominal = np.array([row[3] for row in rows], dtype=float)
        sample = Sample(keys, np.column_stack([columns, nominal]))
        predicted = lambda s: s[-1] / s[0] * np.prod(s[5:-1] / s[-1], axis=0)
        result["relative"] = {
            "n": len(rows),
            "nominal": sample.estimate(lambda s: s[-1] / s[0], True),
            "prediction": sample.estimate(predicted, False),
            "difference": sample.estimate(lambda s: s[2] / s[0] - predicted(s), False),
        }
        conditions = dict(zip(AXES, alone.T)) | {"simultaneous": sim}
        losses = {name: loss(keys, nominal, y) for name, y in conditions.items()}
        adjusted = holm([row["sign_flip_p"] for row in losses.values()])
        for row, p in zip(losses.values(), adjusted):
            row["holm_p"] = p
        result["losses"] = losses
    if placebo is not None:
        stacked = lambda rows: np.array([row[4] + [row[5]] for row in rows], dtype=float)
        placebo_outcomes = ([tuple(row[:3]) for row in placebo], stacked(placebo))
        result["excess"] = excess(keys, stacked(rows), placebo_outcomes)
    else:
        result["excess"] = None
    return result, keys, sim


def progress(pairs, own_directions):
    """Differences in partial progress for one row, without Holm's p; None if unknown."""

    def change(values, scale):
        known = [(tuple(pair[:3]), v) for pair, v in zip(pairs, values) if None not in v]
        if not known:
            return None
        keys, ab = [key for key, _ in known], np.array([v for _, v in known], dtype=float)
        sample = Sample(keys, np.column_stack([np.ones(len(ab)), ab]), own_directions)
        estimate = sample.estimate(lambda s: (s[1] - s[2]) / s[0], scale)
        return {
            "n": len(ab),
            "tasks": sample.tasks,
            "mean_a": ab[:, 0].mean(),
            "mean_b": ab[:, 1].mean(),
            "difference": estimate,
            "p": two_sided(estimate),
        }

    goals = [[goal and goal[0] / goal[1] for goal in pair[5]] for pair in pairs]
    found = {"goal": change(goals, False), "steps": change([pair[6] for pair in pairs], "mean")}
    return found if found["goal"] or found["steps"] else None


def difference(pairs, own_directions):
    """One row of a comparison, without values that depend on other rows, and A - B by task."""
    keys = [tuple(pair[:3]) for pair in pairs]
    a, b = np.array([pair[3:5] for pair in pairs]).T
    ones = np.ones(len(pairs))
    sample = Sample(keys, np.column_stack([ones, a - b]), own_directions)
    estimate = sample.estimate(lambda s: s[1] / s[0], False)
    by_task = {}
    for (suite, task, _), change in zip(keys, a - b):
        by_task.setdefault((suite, task), []).append(change)
    by_task = {task: np.mean(changes) for task, changes in by_task.items()}
    better = np.array([(1 + np.sign(change)) / 2 for change in by_task.values()])
    profile = Sample(
        [(suite, task, 0) for suite, task in by_task],
        np.column_stack([np.ones(len(better)), better]),
        own_directions=True,
    )
    improvement = profile.estimate(lambda s: s[1] / s[0], True)
    if not own_directions:
        improvement["new_tasks_and_directions"] = None
    return {
        "n": len(pairs),
        "tasks": len(by_task),
        "s_a": a.mean(),
        "s_b": b.mean(),
        "difference": (a - b).mean(),
        "both": int((a & b).sum()),
        "a_only": int((a & ~b & 1).sum()),
        "b_only": int((b & ~a & 1).sum()),
        "neither": int((1 - (a | b)).sum()),
        "estimate": estimate,
        "sign_flip_p": sign_flip(net_by_task(keys, a - b)),
        "equivalence_p": equivalence(estimate),
        "profile": {
            "a_better": int((better == 1).sum()),
            "b_better": int((better == 0).sum()),
            "improvement": improvement,
        },
    }, by_task


def max_t(by_tasks):
    """Half-width, in standard errors, of simultaneous intervals for all rows, by random signs."""
    tasks = sorted(set().union(*by_tasks))
    strata = np.array([suite for suite, _ in tasks])
    if 1 in np.unique(strata, return_counts=True)[1]:
        strata[:] = 0
    u = np.zeros((len(by_tasks), len(tasks)))
    for row, by_task in zip(u, by_tasks):
        known = np.array([task in by_task for task in tasks])
        row[known] = [by_task[task] for task in tasks if task in by_task]
        for stratum in set(strata[known]):
            row[known & (strata == stratum)] -= row[known & (strata == stratum)].mean()
    u = u[(np.abs(u) > 1e-12).any(axis=1)]
    if len(tasks) < 2 or not len(u):
        return None
    signs = np.random.default_rng(2).choice([-1.0, 1.0], (SIGNS, len(tasks)))
    sums = signs @ u.T
    variance = np.zeros_like(sums)
    for stratum in set(strata):
        members = strata == stratum
        g = members.sum()
        squares = (u[:, members] ** 2).sum(axis=1)
        rest = squares - (signs[:, members] @ u[:, members].T) ** 2 / g
        variance += np.where(rest > 1e-12 * squares, rest, 0.0) * g / (g - 1)
    with np.errstate(all="ignore"):
        t = np.where(variance > 0, np.abs(sums) / np.sqrt(variance), np.inf)
    critical = np.quantile(t.max(axis=1), 0.95)
    return critical if np.isfinite(critical) else None


def compare_policies(campaign, comparison):
    rows = campaign["compared"]
    ours = [difference(row["pairs"], row["own_directions"]) for row in rows]
    adjusted = holm([measures["sign_flip_p"] for measures, _ in ours])
    critical = max_t([by_task for _, by_task in ours])
    for row, (measures, _), p in zip(rows, ours, adjusted):
        where, theirs = f"{campaign['name']} {row['name']}", row["difference"]
        comparison.check(where, measures | {"holm_p": p}, theirs)
        error, interval = measures["estimate"]["standard_error"], theirs["simultaneous_ci95"]
        if critical is None or error is None or interval is None:
            comparison.count(f"{where} max-t", critical and error, interval, interval is None)
        elif -1 < interval[0] and interval[1] < 1:
            half = (interval[1] - interval[0]) / 2
            comparison.check(f"{where} max-t", 1.0, half / error / critical, SIGNS_TOLERANCE)
    progresses = [progress(row["pairs"], row["own_directions"]) for row in rows]
    for name in ["goal", "steps"]:
        tested = [found[name] for found in progresses if found and found[name]]
        for change in tested:
            change["holm_p"] = None
        tested = [change for change in tested if change["p"] is not None]
        for change, p in zip(tested, holm([change["p"] for change in tested])):
            change["holm_p"] = p
    for row, found in zip(rows, progresses):
        comparison.check(f"{campaign['name']} {row['name']} progress", found, row["progress"])


class Comparison:
    def __init__(self):
        self.agreed, self.differences = 0, []

    def check(self, where, ours, theirs, tolerance=TOLERANCE):
        if isinstance(ours, dict) and theirs is not None:
            for name, value in ours.items():
                self.check(f"{where}.{name}", value, theirs[name], tolerance)
        elif isinstance(ours, list) and isinstance(theirs, list):
            for at, (a, b) in enumerate(zip(ours, theirs, strict=True)):
                self.check(f"{where}[{at}]", a, b, tolerance)
        elif ours is None or theirs is None or isinstance(ours, (bool, list, str)):
            self.count(where, ours, theirs, ours == theirs)
        else:
            self.count(where, ours, theirs, abs(ours - theirs) <= tolerance * max(1, abs(ours)))

    def count(self, where, ours, theirs, agrees):
        self.agreed += agrees
        if not agrees:
            self.differences.append(f"{where}: {ours} here, {theirs} in the report")


def claims(cells):
    """Returns the findings about simultaneity and directions that claim an effect, by level."""
    tested = {}
    for level, cell in cells.items():
        if level == "L0":
            continue
        found = cell["inference"]
        if found["excess"]:
            for name in ["r_e", "r_c"]:
                estimate = found["excess"]["excess"][name]
                p = two_sided(estimate)
                tested[level, name] = (1.0 if p is None else p, estimate["value"] > 0)
        else:
            tested[level, "i"] = (found["i_sign_flip_p"], found["paired"]["i"]["value"] < 0)
        if found["directions"]:
            tested[level, "directions"] = (found["directions"]["p"], True)
    adjusted = holm([p for p, _ in tested.values()])
    return {
        (level, "directions" if name == "directions" else "simultaneity")
        for ((level, name), (_, has_claimed_sign)), p in zip(tested.items(), adjusted)
        if p < FINDING_ALPHA and has_claimed_sign
    }


def gate(outcomes, published, enough):
    """Reproduction gate of nominal `outcomes` by task; `enough`: rollouts that a verdict needs."""
    n = sum(map(len, outcomes))
    if n == 0:
        return {"difference": None, "verdict": "undecided", "equivalence_p": None}
    change = sum(map(sum, outcomes)) / n - published
    verdict = "passed" if abs(change) <= MARGIN + 1e-9 else "failed"
    p = None
    if all(len(task) > 1 for task in outcomes):
        # The error of a mean of tasks' means, weighted by their rollouts.
        errors = [len(task) / n * np.std(task, ddof=1) / len(task) ** 0.5 for task in outcomes]
        error = np.hypot.reduce(errors)
        if error > 0:
            p = float(student.sf((MARGIN - abs(change)) / error, n - len(outcomes)))
    return {
        "published": published,
        "nominal": {"successes": sum(map(sum, outcomes)), "n": n},
        "difference": change,
        "verdict": verdict if n >= enough else "undecided",
        "equivalence_p": p,
    }


def compare_gates(campaign, comparison):
    by_task = {}
    for suite, task, success in campaign["nominal"]:
        by_task.setdefault((suite, task), []).append(success)
    report, published = campaign["report"], campaign["published"]
    ours = gate(list(by_task.values()), published, 2000)  # 40 tasks of 50 initial states
    comparison.check(f"{campaign['name']} gate", ours, report["gate"])
    theirs = {row["suite"]: row for row in report["suite_gates"]}
    for name, number in campaign["suites"]:
        outcomes = [task for (suite, _), task in by_task.items() if suite == number]
        where = f"{campaign['name']} gate of {name}"
        comparison.check(where, gate(outcomes, published, 500), theirs[name])  # 10 tasks


def components(rows):
    """Variance components of simultaneous success in a nested design; None if it is too small."""
    outcomes = {}
    for suite, task, config, success in rows:
        outcomes.setdefault((suite, task), {}).setdefault(config, []).append(success)
    k = max(len(y) for task in outcomes.values() for y in task.values())
    tasks = [np.array(list(task.values()), dtype=float) for task in outcomes.values()]
    n, t = sum(len(task) for task in tasks), len(tasks)
    if k < 2 or t < 2 or n <= t:
        return None
    y = np.concatenate(tasks)
    m = n / t
    ms_e = ((y - y.mean(axis=1, keepdims=True)) ** 2).sum() / (n * (k - 1))
    of_task = sum(((task.mean(axis=1) - task.mean()) ** 2).sum() for task in tasks)
    ms_c = k * of_task / (n - t)
    ms_t = k * sum(len(task) * (task.mean() - y.mean()) ** 2 for task in tasks) / (t - 1)
    sigma_c, sigma_t = max((ms_c - ms_e) / k, 0.0), max((ms_t - ms_c) / (k * m), 0.0)
    variance = (sigma_t + sigma_c / m + ms_e / (m * k)) / t
    independent = y.mean() * (1 - y.mean()) / y.size
    return {
        "replicates": k,
        "n": n,
        "tasks": sigma_t,
        "configurations": sigma_c,
        "replicate": ms_e,
        "design_effect": variance / independent if independent > 0 else None,
        "standard_error": variance**0.5,
    }


def compare_components(campaign, comparison):
    theirs = {row["level"]: row for row in campaign["report"]["components"]}
    for level, rows in campaign["levels"].items():
        where = f"{campaign['name']} {level} components"
        rows = [[*row[:3], row[5]] for row in rows]
        comparison.check(where, components(rows), theirs.get(level))


def compare(campaign, comparison):
    name, levels = campaign["name"], campaign["levels"]
    compare_gates(campaign, comparison)
    compare_components(campaign, comparison)
    cells = campaign["report"]["cells"]
    cells = {cell["level"]: cell for cell in cells}
    for level, rows in levels.items():
        placebo = levels.get("L0") if level != "L0" else None
        ours, keys, sim = inference(rows, placebo)
        theirs = cells[level]["inference"]
        comparison.check(f"{name} {level}", ours, theirs)
        if theirs["directions"] is not None:
            rates, p = directions(keys, sim)
            comparison.check(f"{name} {level} directions", rates, theirs["directions"]["rates"])
            # Both p-values are estimated from 1,999 random permutations.
            error = 5 * (2 * max(p * (1 - p), 1e-3) / PERMUTATIONS) ** 0.5
            comparison.check(f"{name} {level} directions p", p, theirs["directions"]["p"], error)
    kinds = {"simultaneity", "directions"}
    found = [finding for finding in campaign["report"]["findings"] if finding["claims"]]
    theirs = {(claim["level"], claim["kind"]) for claim in found if claim["kind"] in kinds}
    comparison.count(f"{name} claims", claims(cells), theirs, claims(cells) == theirs)


def main():
    comparison = Comparison()
    with open(sys.argv[1]) as file:
        campaigns = json.load(file)
    for campaign in campaigns:
        check = compare_policies if "compared" in campaign else compare
        check(campaign, comparison)
    for line in comparison.differences[:20]:
        print(line, file=sys.stderr)
    print(f"{comparison.agreed} figures of {len(campaigns)} campaigns agree")
    if comparison.differences:
        sys.exit(f"{len(comparison.differences)} figures differ")


main()
