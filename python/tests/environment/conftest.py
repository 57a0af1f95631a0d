"""Fast small environments with the built-in assets."""

import pytest

pytest.importorskip("rollout_libero", reason="rollout-libero is not installed")

import rollout_libero

TASK = "libero_goal/0"


@pytest.fixture
def make():
    """Creates environments, and closes them after the test."""
    created = []

    def make(task=TASK, **options):
        small = {"assets": "primitives", "height": 64, "width": 80, "settle_steps": 2}
        environment = rollout_libero.Environment(task, **{**small, **options})
        created.append(environment)
        return environment

    yield make
    for environment in created:
        environment.close()


@pytest.fixture
def make_vector():
    """Creates vector environments, and closes them after the test."""
    created = []

    def make(tasks=TASK, num_envs=3, **options):
        small = {"assets": "primitives", "height": 64, "width": 80, "settle_steps": 2}
        environments = rollout_libero.VectorEnvironment(tasks, num_envs, **{**small, **options})
        created.append(environments)
        return environments

    yield make
    for environments in created:
        environments.close()


def diverge(simulation):
    """Makes the physics of the next control step diverge."""
    state = simulation.state().copy()
    state[1:8] = 1e9  # Angles of the arm, rad.
    simulation.set_state(state)


def open_the_drawer(simulation):
    """Makes the goal of TASK hold from the next control step on."""
    state = simulation.state().copy()
    names = simulation.names("joint")
    drawer = names.index("wooden_cabinet_1_middle_level")
    state[1 + simulation.model_array("jnt_qposadr")[drawer]] = -0.15  # m, open
    simulation.set_state(state)
