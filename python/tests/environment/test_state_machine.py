"""The vector environment and a simple model of it agree under random operations."""

import json
import random
from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

import rollout_libero
from rollout_libero._library import native

from .conftest import diverge, open_the_drawer

TASKS = ("libero_goal/0", "libero_object/1", "libero_goal/0")
# For each environment: its rank among the environments of the same task, and their number.
RANKS, STRIDES = (0, 0, 1), (2, 1, 2)
# Initial states of a task, settling steps, and the budget of a rollout, control steps.
STATES, SETTLE, BUDGET = 50, 1, 4
# Smallest and largest number of operations: a test continues until it has seen every outcome.
LEAST_OPERATIONS, MOST_OPERATIONS = 50, 300
PERTURBATIONS = (None, "robot/L2/c01", "actuation/L3/c02", "language/L1/c03")
READINGS = ("eef_pos", "joint_pos", "joint_vel")


@dataclass
class ModelEnvironment:
    """An environment of the model: a separate simulation, stepped alone."""

    task: str
    rank: int
    stride: int
    random_states: bool
    simulation: Any
    generator: Any = None
    turn: int = 0
    perturbation: str | None = None
    steps: int = 0
    init_state: int | None = None
    instruction: str = ""
    begun: bool = False
    over: bool = False

    def begin(self, init_state=None):
        row = json.loads(native.nominal_row(self.task, 0))
        if self.perturbation is not None:
            stem = "/".join(row["rollout_id"].split("/")[:2])
            row = json.loads(native.configuration_row(f"{stem}/{self.perturbation}"))
            if init_state is not None:
                row["init_id"] = init_state
        else:
            if init_state is None and self.random_states:
                init_state = int(self.generator.integers(STATES))
            elif init_state is None:
                init_state = self.turn % STATES
                self.turn += self.stride
            row = json.loads(native.nominal_row(self.task, init_state))
        row["num_steps_wait"] = SETTLE
        self.simulation.begin(json.dumps(row))
        self.instruction, self.init_state = row["language"], row["init_id"]
        self.steps, self.begun, self.over = 0, True, False

    def step(self, actions):
        """Returns the number of executed steps, and whether the rollout succeeded, was truncated,
        and failed."""
        for taken, action in enumerate(actions):
            if self.steps == BUDGET:
                return taken, False, True, False
            try:
                success = self.simulation.step(action)
            except rollout_libero.SimulationError:
                self.over = True
                return taken, False, False, True
            self.steps += 1
            if success or self.steps == BUDGET:
                self.over = True
                return taken + 1, success, not success, False
        return len(actions), False, False, False


@dataclass
class Machine:
    """A vector environment with its model, and the operations on both."""

    mode: AutoresetMode
    init_states: str
    rng: random.Random
    outcomes: set[str] = field(default_factory=set)

    def __post_init__(self):
        self.real = rollout_libero.VectorEnvironment(
            TASKS, assets="primitives", cameras=[], init_states=self.init_states,
            settle_steps=SETTLE, max_steps=BUDGET, autoreset_mode=self.mode,
        )  # fmt: skip
        self.model = [
            ModelEnvironment(task, rank, stride, self.init_states == "random",
                native.Simulation(simulation.scene), turn=rank)
            for task, rank, stride, simulation
            in zip(TASKS, RANKS, STRIDES, self.real.simulations, strict=True)
        ]  # fmt: skip
        self.saved = None
        self.reset(seed=self.rng.randrange(1000))

    def close(self):
        self.real.close()
        for env in self.model:
            env.simulation.close()

    def compare(self, observation, infos, failed=()):
        for index, env in enumerate(self.model):
            assert infos["steps"][index] == env.steps, index
            assert infos["init_state"][index] == env.init_state, index
            assert infos["instruction"][index] == env.instruction, index
            if index in failed:
                continue
            readings = env.simulation.readings()
            for name in READINGS:
                observed = observation[name][index]
                np.testing.assert_array_equal(observed, readings[name], err_msg=name)

    # Operations.

    def reset(self, seed=None, mask=None, init_state=None):
        options = {} if mask is None else {"reset_mask": np.array(mask)}
        if init_state is not None:
            options["init_state"] = init_state
        observation, infos = self.real.reset(seed=seed, options=options)
        for index, env in enumerate(self.model):
            if mask is not None and not mask[index]:
                continue
            env_seed = None
            if seed is not None:
                env_seed = seed[index] if isinstance(seed, list) else seed + index
            if env_seed is not None:
                env.generator = seeding.np_random(env_seed)[0]
                env.turn = env_seed if isinstance(seed, list) else seed + env.rank
            env.begin(init_state)
        failed = [index for index, env in enumerate(self.model) if env.over]
        self.compare(observation, infos, failed)

    def reset_all(self):
        seeds = [self.rng.randrange(1000) for _ in TASKS]
        self.reset(seed=self.rng.choice([None, seeds[0], seeds]))

    def reset_some(self):
        mask = [self.rng.random() < (0.9 if env.over else 0.3) for env in self.model]
        if any(mask):
            self.reset(mask=mask, init_state=self.rng.choice([None, 7]))

    def refused_reset(self):
        seed = self.rng.randrange(1000)
        seeds, options = self.rng.choice([
            (seed, {"init_state": STATES}),
            ([seed, seed, -1], None),
            ([seed], None),
            (seed, {"reset_mask": np.ones(2, bool)}),
            (seed, {"reset_mask": np.zeros(3, bool)}),
        ])  # fmt: skip
        with pytest.raises((ValueError, gymnasium.error.Error)):
            self.real.reset(seed=seeds, options=options)

    def refused_step(self):
        good = np.zeros((len(TASKS), 2, 7))
        bad = good.copy()
        bad[self.rng.randrange(len(TASKS)), 1, 3] = np.nan
        actions, render, expert = self.rng.choice([
            (bad, "last", None),
            (good[:, :, :6], "last", None),
            (good[:2], "last", None),
            (good, "first", None),
            (good, "last", np.ones(3, bool)),
        ])  # fmt: skip
        with pytest.raises((ValueError, gymnasium.error.ResetNeeded)):
            self.real.step_chunk(actions, render, expert=expert)

    def refused_perturbation(self):
        with pytest.raises(ValueError):
            self.real.set_perturbation(self.rng.randrange(len(TASKS)), "camera/L9/c00")

    def perturb(self):
        index, chosen = self.rng.randrange(len(TASKS)), self.rng.choice(PERTURBATIONS)
        self.real.set_perturbation(index, chosen)
        self.model[index].perturbation = chosen

    def take_snapshot(self):
        state = [(env.simulation.snapshot(), replace(env)) for env in self.model]
        self.saved = self.real.snapshot(), state

    def restore_snapshot(self):
        if self.saved is None:
            return
        snapshot, state = self.saved
        self.real.restore(snapshot)
        for env, (simulation, earlier) in zip(self.model, state, strict=True):
            env.simulation.restore(simulation)
            for name in ("steps", "init_state", "instruction", "begun", "over"):
                setattr(env, name, getattr(earlier, name))

    def succeed_next(self):
        index = self.rng.choice([0, 2])
        for simulation in (self.real.simulations[index], self.model[index].simulation):
            open_the_drawer(simulation)

    def fail_next(self):
        index = self.rng.randrange(len(TASKS))
        for simulation in (self.real.simulations[index], self.model[index].simulation):
            diverge(simulation)

    def step(self):
        count = len(TASKS)
        chunk = self.rng.randint(1, 3)
        numbers = np.random.default_rng(self.rng.randrange(1 << 30))
        actions = numbers.uniform(-1.5, 1.5, (count, chunk, 7))
        over = [env.over for env in self.model]
        if any(over) and self.mode != AutoresetMode.NEXT_STEP:
            with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
                self.real.step_chunk(actions)
            self.outcomes.add("reset needed")
            return
        expected = []
        for env, env_actions, ended in zip(self.model, actions, over, strict=True):
            if ended:
                env.begin()
            expected.append((0, False, False, False) if ended else env.step(env_actions))
        taken, success, truncated, failed = map(list, zip(*expected, strict=True))
        last = [env.simulation.readings() for env in self.model]
        restarted = [False] * count
        if self.mode == AutoresetMode.SAME_STEP:
            restarted = [a or b for a, b in zip(success, truncated, strict=True)]
            for env, begins in zip(self.model, restarted, strict=True):
                if begins:
                    env.begin()
        failing = [index for index in range(count) if failed[index]]
        if failing:
            with pytest.raises(rollout_libero.SimulationError) as raised:
                self.real.step_chunk(actions)
            assert raised.value.environments == failing
            result = raised.value.result
            assert result[-1]["failed"].tolist() == failed
        else:
            result = self.real.step_chunk(actions)
        observation, rewards, terminations, truncations, infos = result
        assert infos["taken"].tolist() == taken
        assert rewards.tolist() == [float(value) for value in success]
        assert terminations.tolist() == success and truncations.tolist() == truncated
        self.compare(observation, infos, failing)
        if any(restarted):
            assert infos["_final_obs"].tolist() == restarted
            assert infos["final_info"]["success"][restarted].tolist() == [
                ended for ended, begins in zip(success, restarted, strict=True) if begins
            ]
            for index in np.flatnonzero(restarted):
                for name in READINGS:
                    final = infos["final_obs"][index][name]
                    np.testing.assert_array_equal(final, last[index][name])
        for name, flags in (("begins", over), ("succeeds", success), ("truncated", truncated),
                           ("fails", failed), ("begins at once", restarted)):
            if any(flags):
                self.outcomes.add(name)


# Operations with their weights in the random choice.
OPERATIONS = {
    "step": 12, "reset_all": 1, "reset_some": 3, "refused_reset": 2, "refused_step": 4,
    "perturb": 2, "refused_perturbation": 1, "take_snapshot": 1, "restore_snapshot": 1,
    "succeed_next": 3, "fail_next": 2,
}  # fmt: skip
# Outcomes that a test must see in each mode.
EXPECTED = {
    AutoresetMode.NEXT_STEP: {"begins", "succeeds", "truncated", "fails"},
    AutoresetMode.SAME_STEP: {"begins at once", "succeeds", "truncated", "fails", "reset needed"},
    AutoresetMode.DISABLED: {"reset needed", "succeeds", "truncated", "fails"},
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("init_states", ["cycle", "random"])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_environments_match_the_model_under_random_operations(mode, init_states, seed):
    machine = Machine(mode, init_states, random.Random(seed))
    operations = []
    try:
        while len(operations) < LEAST_OPERATIONS or not EXPECTED[mode] <= machine.outcomes:
            assert len(operations) < MOST_OPERATIONS, machine.outcomes
            (chosen,) = machine.rng.choices(list(OPERATIONS), OPERATIONS.values())
            operations.append(chosen)
            getattr(machine, chosen)()
    except BaseException:
        print("operations:", " ".join(operations))
        raise
    finally:
        machine.close()
