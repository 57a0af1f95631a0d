"""Fast small environments with the built-in assets."""

import pytest

pytest.importorskip("rollout_libero", reason="rollout-libero is not installed")

import rollout_libero

TASK = "libero_goal/0"
SMALL = {"assets": "primitives", "height": 64, "width": 80, "settle_steps": 2}


def maker(kind, **defaults):
    """A fixture that creates small environments, and closes them after the test."""

    def fixture():
        created = []

        def make(task=TASK, num_envs=None, **options):
            if num_envs is not None:
                options["num_envs"] = num_envs
            created.append(kind(task, **{**SMALL, **defaults, **options}))
            return created[-1]

        yield make
        for environment in created:
            environment.close()

    return pytest.fixture(fixture)


make = maker(rollout_libero.Environment)
make_vector = maker(rollout_libero.VectorEnvironment, num_envs=3)


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
