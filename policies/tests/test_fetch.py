"""Checkpoints from folders and from a simulated hub."""

import sys
from types import SimpleNamespace

import pytest

from rollout_policies.adapters.fetch import fetch, naming_downloads
from rollout_policies.adapters.upstream import UnusableCheckpoint, UnusableOption
from rollout_policies.catalogue import NoCheckpoint, entry

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A hub with one repository; it records its requests."""
    snapshot = tmp_path / "models--me--mine" / "snapshots" / COMMIT
    (snapshot / "ckpt" / "small").mkdir(parents=True)
    requests = []

    def snapshot_download(repository, revision=None, **given):
        requests.append((repository, revision, given))
        if repository != "me/mine":
            raise OSError("401 Client Error\nRepository Not Found")
        return str(snapshot)

    fake = SimpleNamespace(snapshot_download=snapshot_download)
    monkeypatch.setitem(sys.modules, "huggingface_hub", fake)
    return SimpleNamespace(requests=requests, snapshot=snapshot)


def test_a_revision_is_requested_and_the_commit_is_recorded(hub):
    fetched = fetch(entry("smolvla"), "me/mine", "v2")
    assert hub.requests == [("me/mine", "v2", {})]
    assert fetched.folder == hub.snapshot
    assert fetched.settings == {"revision": COMMIT}


def test_a_local_folder_has_no_revision(hub, tmp_path):
    fetched = fetch(entry("smolvla"), str(tmp_path))
    assert (fetched.folder, fetched.settings, hub.requests) == (tmp_path, {}, [])
    with pytest.raises(UnusableOption, match="--revision names a commit of the hub"):
        fetch(entry("smolvla"), str(tmp_path), "v2")
    # A folder in the hub's cache is named after its commit.
    assert fetch(entry("smolvla"), str(hub.snapshot)).revision == COMMIT


def test_a_folder_of_a_repository_is_found_in_it(hub):
    fetched = fetch(entry("minerva"), "me/mine/small")
    assert fetched.folder == hub.snapshot / "ckpt" / "small"
    assert hub.requests[0][2] == {"allow_patterns": ["small/*", "*/small/*"]}
    with pytest.raises(
        UnusableCheckpoint, match="has no folder named large; its top folders are ckpt"
    ):
        fetch(entry("minerva"), "me/mine/large")


@pytest.mark.parametrize("name", ["./ckpt", "/no/such/folder", "~/none", "weights"])
def test_a_name_that_is_neither_folder_nor_hub_name_is_refused_without_a_request(hub, name):
    with pytest.raises(NoCheckpoint, match="there is no folder"):
        fetch(entry("smolvla"), name)
    assert hub.requests == []


def test_the_error_for_a_missing_hub_repository_lists_all_downloads(hub):
    with pytest.raises(UnusableCheckpoint) as refused:
        fetch(entry("vla-jepa"), "me/none", "v2")
    for words in (
        "there is no folder me/none here",
        "did not provide me/none at v2: 401 Client Error",
        "Qwen/Qwen3-VL-2B-Instruct",
        "HF_HUB_OFFLINE=1",
    ):
        assert words in str(refused.value)


def test_a_missing_download_is_refused_with_the_list():
    with pytest.raises(UnusableCheckpoint, match="Cannot reach it.*paligemma.*HF_HUB_OFFLINE"):
        with naming_downloads(entry("pi05").downloads):
            raise OSError("\nCannot reach it.\nmore")
