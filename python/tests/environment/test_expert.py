"""The scripted expert with environments: demonstrations and labels."""

import numpy as np
import pytest

TASK = "libero_object/0"


def test_the_expert_solves_sampled_scenes(make_vector):
    environments = make_vector(TASK, 1, init_states="sampled", cameras=[])
    environments.reset(seed=1)
    whole = environments.max_steps[0]
    no_actions, drives = np.zeros((1, whole, 7)), np.ones((1, whole), bool)
    *_, terminated, _, infos = environments.step_chunk(no_actions, "none", expert=drives)
    assert terminated.all() and 50 < infos["taken"][0] < whole


def test_labels_are_the_experts_actions_whether_it_drives_or_not(make_vector):
    environments = make_vector(TASK, 2, init_states=[0], cameras=[])
    environments.reset()
    drives = np.array([[True] * 5, [False] * 5])
    no_actions = np.zeros((2, 5, 7))
    *_, infos = environments.step_chunk(no_actions, "none", expert=drives)
    labels = infos["expert_action"]
    # Both environments start in the same state. Then the first follows the expert, and the second
    # stands still.
    np.testing.assert_array_equal(labels[0, 0], labels[1, 0])
    assert np.abs(labels[0] - labels[1]).max() > 0.0
    assert np.abs(labels).max() <= 1.0
    actions = np.repeat(labels[:1], 2, axis=0)
    environments.reset(seed=0)
    *_, infos = environments.step_chunk(actions, "none", expert=np.zeros((2, 5), bool))
    np.testing.assert_allclose(infos["expert_action"], actions, atol=1e-12)


def test_noise_is_added_to_the_experts_actions(make_vector):
    environments = make_vector(TASK, 2, init_states=[0], cameras=[])
    environments.reset()
    noise = np.zeros((2, 4, 7))
    noise[1, :, 0] = 0.7
    observation, *_ = environments.step_chunk(noise, "none", expert=np.ones((2, 4), bool))
    assert observation["eef_pos"][1, 0] > observation["eef_pos"][0, 0] + 0.02


def test_labels_end_with_the_rollout(make_vector):
    environments = make_vector(TASK, 1, init_states=[0], cameras=[], max_steps=3)
    environments.reset()
    *_, infos = environments.step_chunk(np.zeros((1, 5, 7)), "none", expert=np.ones((1, 5), bool))
    assert infos["taken"].tolist() == [3]
    assert np.isfinite(infos["expert_action"][0, :3]).all()
    assert np.isnan(infos["expert_action"][0, 3:]).all()


def test_sampled_scenes_may_be_perturbed(make_vector):
    environments = make_vector(TASK, 2, init_states="sampled")
    environments.set_perturbation(1, "camera/L3/c12")
    observation, infos = environments.reset(seed=[7, 7])
    assert infos["init_state"].tolist() == [None, None]
    # Only the camera differs.
    np.testing.assert_allclose(observation["eef_pos"][0], observation["eef_pos"][1], atol=1e-9)
    assert (observation["agentview"][0] != observation["agentview"][1]).mean() > 0.1
    environments.set_perturbation(1, None)
    observation, _ = environments.reset(seed=[7, 7])
    assert (observation["agentview"][0] != observation["agentview"][1]).mean() < 0.02


def test_a_snapshot_includes_the_experts_state(make_vector):
    environments = make_vector(TASK, 1, init_states=[0], cameras=[])
    environments.reset()
    drives, no_actions = np.ones((1, 60), bool), np.zeros((1, 60, 7))
    environments.step_chunk(no_actions, "none", expert=drives)
    snapshot = environments.snapshot()
    labels = []
    for _ in range(2):
        *_, infos = environments.step_chunk(no_actions[:, :20], "none", expert=drives[:, :20])
        labels.append(infos["expert_action"])
        environments.restore(snapshot)
    np.testing.assert_array_equal(*labels)
    # Another environment, whose expert has no history, returns the same labels.
    other = make_vector(TASK, 1, init_states=[3], cameras=[])
    other.reset()
    other.restore(snapshot)
    *_, infos = other.step_chunk(no_actions[:, :20], "none", expert=drives[:, :20])
    np.testing.assert_array_equal(infos["expert_action"], labels[0])


def test_the_expert_foresees_its_actions_and_changes_nothing(make_vector):
    environments = make_vector("libero_spatial/0", 2, autoreset_mode="Disabled")
    environments.reset(seed=0)
    # After steps of another driver, the expert foresees what it does when it takes over.
    environments.step_chunk(np.full((2, 10, 7), 0.3), "none", expert=np.zeros((2, 10), bool))
    foreseen, progresses = environments.foresee(60)
    again, _ = environments.foresee(60)
    *_, infos = environments.step_chunk(np.zeros((2, 60, 7)), "none", expert=np.ones((2, 60), bool))
    np.testing.assert_array_equal(foreseen, again)
    np.testing.assert_array_equal(foreseen, infos["expert_action"])
    assert progresses.all()


def test_invalid_expert_arguments_are_refused(make_vector):
    environments = make_vector(TASK, 2, cameras=[])
    environments.reset()
    with pytest.raises(ValueError, match=r"`expert` has shape \[2\]; expected .*\[2, 4\]"):
        environments.step_chunk(np.zeros((2, 4, 7)), expert=[True, True])
    absolute = make_vector(TASK, 1, cameras=[], control="absolute")
    absolute.reset()
    with pytest.raises(ValueError, match="displacements"):
        absolute.step_chunk(np.zeros((1, 1, 7)), expert=[[True]])
