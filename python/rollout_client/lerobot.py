"""LeRobot dataset, format v2.1, with an episode for each rollout that has recorded actions.

The dataset lacks the data that a campaign does not keep: joints, the gripper's state, the
end-effector's orientation, and the pictures that the policy received. Its videos are the campaign's
films, which show both cameras side by side and are compressed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .archive import Archive, ArchiveError, Rollout
from .errors import SettingsError

#: Control steps, and pictures of a film, per second.
FPS = 20

#: Episodes per folder.
CHUNK = 1_000

#: Size of a film's pictures: both cameras, 256 pixels each.
HEIGHT, WIDTH = 256, 512

FILM = "observation.images.both"
DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"

#: Displacements and rotations of the end-effector, and the gripper (-1 opens).
ACTION = ["x", "y", "z", "roll", "pitch", "yaw", "gripper"]


def export(archive: Archive, folder: str | os.PathLike[str], *, films: bool = False) -> int:
    """Writes an archive's rollouts that have actions into an empty or new folder; returns their
    number.

    films: exports only rollouts that were filmed, with their films. Raises ArchiveError if there is
    no such rollout, and SettingsError if the folder is not empty or pyarrow is missing."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise SettingsError(
            "failed to export: pyarrow is not installed; run pip install pyarrow"
        ) from None
    target = Path(folder)
    if target.exists() and any(target.iterdir()):
        raise SettingsError(f"failed to export into {target}: it is not empty; name a new folder")
    writer = _DatasetWriter(target, films)
    for rollout in archive.rollouts():
        # Only campaigns that record transitions keep actions.
        if len(rollout.actions) > 0 and (rollout.film or not films):
            writer.add(rollout)
    if writer.episodes == 0:
        required = "a film and recorded actions" if films else "recorded actions"
        raise ArchiveError(
            f"failed to export campaign {archive.name}: no rollout has {required}; create campaigns"
            " with --record transitions to keep actions"
        )
    writer.finish(archive)
    return writer.episodes


class _DatasetWriter:
    """Writer of a dataset, episode by episode."""

    def __init__(self, folder: Path, films: bool) -> None:
        self.folder, self.films = folder, films
        self.episodes = self.frames = 0
        self.tasks: dict[str, int] = {}
        self.lines: dict[str, list[dict[str, Any]]] = {
            "episodes": [],
            "episodes_stats": [],
            "rollouts": [],
        }

    def add(self, rollout: Rollout) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        index, length = self.episodes, len(rollout.actions)
        task = self.tasks.setdefault(rollout.instruction, len(self.tasks))
        steps = np.arange(length)
        columns: dict[str, np.ndarray[Any, Any]] = {
            # Position of the end-effector when the action was chosen.
            "observation.state": rollout.path[:length],
            "action": rollout.actions,
            "next.done": steps == length - 1,
            "next.success": (steps == length - 1) & rollout.success,
            "timestamp": (steps / FPS).astype(np.float32),
            "frame_index": steps,
            "episode_index": np.full(length, index),
            "index": self.frames + steps,
            "task_index": np.full(length, task),
        }
        arrays = {
            name: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
            if values.ndim == 2
            else pa.array(values)
            for name, values in columns.items()
        }
        path = self._path(DATA_PATH, index)
        pq.write_table(pa.table(arrays), path)
        if self.films and rollout.film is not None:
            shutil.copyfile(rollout.film, self._path(VIDEO_PATH, index, video_key=FILM))
        self.lines["episodes"].append(
            {"episode_index": index, "tasks": [rollout.instruction], "length": length}
        )
        stats = {name: _stats(values) for name, values in columns.items()}
        self.lines["episodes_stats"].append({"episode_index": index, "stats": stats})
        self.lines["rollouts"].append(
            {
                "episode_index": index,
                "rollout_id": rollout.rollout_id,
                "replicate": rollout.replicate,
                "task": rollout.task,
                "axis": rollout.axis,
                "level": rollout.level,
                "success": rollout.success,
                "steps": rollout.steps,
            }
        )
        self.episodes += 1
        self.frames += length

    def finish(self, archive: Archive) -> None:
        """Writes the metadata of all episodes."""
        tasks = [{"task_index": index, "task": task} for task, index in self.tasks.items()]
        for name, lines in {**self.lines, "tasks": tasks}.items():
            _write(self.folder / "meta" / f"{name}.jsonl", map(json.dumps, lines))
        info = {
            "codebase_version": "v2.1",
            "robot_type": "panda",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "total_videos": self.episodes if self.films else 0,
            "total_chunks": -(-self.episodes // CHUNK),
            "chunks_size": CHUNK,
            "fps": FPS,
            "splits": {"train": f"0:{self.episodes}"},
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH if self.films else None,
            "features": self._features(),
        }
        _write(self.folder / "meta" / "info.json", [json.dumps(info, indent=2)])
        provenance = {"archive": archive.contents, "specification": archive.specification()}
        _write(self.folder / "meta" / "campaign.json", [json.dumps(provenance, indent=2)])

    def _features(self) -> dict[str, Any]:
        def numbers(dtype: str, names: list[str] | None = None) -> dict[str, Any]:
            return {"dtype": dtype, "shape": [len(names) if names else 1], "names": names}

        features = {
            "observation.state": numbers("float32", ["x", "y", "z"]),
            "action": numbers("float32", ACTION),
            "next.done": numbers("bool"),
            "next.success": numbers("bool"),
            "timestamp": numbers("float32"),
            "frame_index": numbers("int64"),
            "episode_index": numbers("int64"),
            "index": numbers("int64"),
            "task_index": numbers("int64"),
        }
        if self.films:
            features[FILM] = {
                "dtype": "video",
                "shape": [HEIGHT, WIDTH, 3],
                "names": ["height", "width", "channels"],
                "info": {
                    "video.fps": float(FPS),
                    "video.height": HEIGHT,
                    "video.width": WIDTH,
                    "video.channels": 3,
                    "video.codec": "h264",
                    "video.pix_fmt": "yuv420p",
                    "video.is_depth_map": False,
                    "has_audio": False,
                },
            }
        return features

    def _path(self, template: str, index: int, **names: str) -> Path:
        name = template.format(episode_chunk=index // CHUNK, episode_index=index, **names)
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def _stats(values: np.ndarray[Any, Any]) -> dict[str, list[float]]:
    rows = values.reshape(len(values), -1).astype(np.float64)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }


def _write(path: Path, lines: Iterable[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
