"""gymnasium's Reacher as a benchmark of vla-eval."""

from typing import Any

import faulty
import numpy as np
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import RAW


class Reacher(StepBenchmark):
    def __init__(self, max_steps: int) -> None:
        super().__init__()
        self.max_steps = max_steps
        self.env = faulty.Reacher()

    def get_tasks(self) -> list[dict[str, Any]]:
        return [{"name": "reach"}, {"name": "reach again"}]

    def reset(self, task: dict[str, Any]) -> Any:
        return self.env.reset(seed=task["episode_idx"])[0]

    def step(self, action: dict[str, Any]) -> StepResult:
        observation, reward, ended, truncated, info = self.env.step(action["actions"])
        return StepResult(observation, reward, bool(ended or truncated or info["is_success"]), info)

    def make_obs(self, raw_obs: Any, task: dict[str, Any]) -> dict[str, Any]:
        images = {"front": self.env.render()}
        return {"images": images, "states": np.array(raw_obs), "task_description": "touch the ball"}

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        return {"success": bool(step_result.info["is_success"])}

    def get_action_spec(self) -> dict[str, Any]:
        return {"torques": RAW}

    def get_metadata(self) -> dict[str, Any]:
        return {"max_steps": self.max_steps}
