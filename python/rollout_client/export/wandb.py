"""Exports a Weights & Biases run: success curves, results as a table, and the report."""

from __future__ import annotations

import os
from pathlib import Path

from ..archive import Archive
from . import import_package
from .rates import points

COLUMNS = ["rollout_id", "replicate", "task", "axis", "level", "success", "steps", "wall_secs"]


def export(archive: Archive, folder: str | os.PathLike[str], *, project: str = "rollout") -> int:
    """Writes a run into a folder without using the network; `wandb sync` uploads the run.
    Returns the run's number of points. Raises SettingsError if wandb is missing."""
    wandb = import_package("wandb")
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    run = wandb.init(
        project=project,
        name=archive.name,
        dir=str(target),
        mode="offline",
        config=archive.specification(),
        settings=wandb.Settings(silent=True),
    )
    count = 0
    try:
        run.define_metric("results/*")
        for point in points(archive):
            steps = f"results/{point.condition}"
            rate = f"success_rate/{point.condition}"
            if point.results == 1:
                run.define_metric(rate, step_metric=steps)
            run.log({rate: point.rate, steps: point.results})
            count += 1
        rows = [[getattr(rollout, name) for name in COLUMNS] for rollout in archive.rollouts()]
        run.log({"rollouts": wandb.Table(columns=COLUMNS, data=rows)})
        run.summary["report"] = archive.report()
    finally:
        run.finish()
    return count
