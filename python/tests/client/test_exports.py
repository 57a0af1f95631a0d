"""Archives read without a coordinator, and their exports to other tools."""

import contextlib
import gzip
import hashlib
import io
import json
import shutil
import sqlite3
import subprocess
import sys
import tarfile
import tracemalloc

import numpy as np
import pytest

from rollout_client.__main__ import main
from rollout_client.archive import MEMBERS, Archive, ArchiveError
from rollout_client.errors import SettingsError
from rollout_client.lerobot import export

from .conftest import specification


@pytest.fixture(scope="session")
def archive(serve, connect, gateway, programs, run, tmp_path_factory):
    """The archive of a campaign that a worker has run and recorded with actions, and the
    campaign."""
    server = serve()
    client = connect(f"http://{server.address}")
    fields = {"record": "transitions", "configs": [0]}
    campaign = client.create(specification("kept", f"http://{gateway.address}", **fields))
    run(server, campaign)
    file = tmp_path_factory.mktemp("archives") / "kept.tar.gz"
    command = [programs / "coordinator", "campaign", "archive", "kept", "--output", file]
    subprocess.run([*command, "--connect", f"http://{server.address}"], check=True)
    return file, campaign


def test_an_archive_has_the_results_and_the_motion_of_its_campaign(archive):
    file, campaign = archive
    results = campaign.results().set_index("rollout_id")
    with Archive(file) as opened:
        assert opened.name == "kept"
        assert opened.specification()["record"] == "transitions"
        assert opened.report()["reports"][0]["policy"] == "expert"
        rollouts = list(opened.rollouts())
    assert [rollout.rollout_id for rollout in rollouts] == list(results.index)
    for rollout in rollouts:
        result = results.loc[rollout.rollout_id]
        assert (rollout.success, rollout.steps) == (result.success, result.steps)
        assert (rollout.axis, rollout.level) == (result.axis, result.level)
        assert rollout.actions.shape == (rollout.steps, 7)
        assert rollout.path.shape == (rollout.steps + 1, 3)
        assert np.abs(rollout.actions).max() <= 1
        # In m: the end-effector stays within 3 m of the origin, and moves by more than 5 cm.
        assert np.abs(rollout.path).max() < 3
        assert np.ptp(rollout.path, axis=0).max() > 0.05
        assert rollout.instruction.startswith("pick up")


def test_an_incomplete_or_altered_archive_is_refused(archive, tmp_path):
    file, _ = archive
    whole = file.read_bytes()
    bad = tmp_path / "bad.tar.gz"
    for content in (whole[: len(whole) // 2], b"", b"text", gzip.compress(b"text")):
        bad.write_bytes(content)
        with pytest.raises(ArchiveError, match=r"bad\.tar\.gz"):
            Archive(bad)
    with pytest.raises(ArchiveError, match="no such file"):
        Archive(tmp_path / "nowhere.tar.gz")

    def alter(change):
        with tarfile.open(file) as tar, tarfile.open(bad, "w:gz") as out:
            for member in tar:
                content = change(member, tar.extractfile(member).read())
                member.size = len(content)
                out.addfile(member, io.BytesIO(content))

    def with_list(**fields):
        return lambda member, content: (
            json.dumps({**json.loads(content), **fields}).encode()
            if member.name == "archive.json"
            else content
        )

    alter(lambda member, content: content[:-1] + b"?" if "report" in member.name else content)
    with pytest.raises(
        ArchiveError, match=r"report\.json .*SHA-256 is not the one in archive\.json"
    ):
        Archive(bad)
    alter(with_list(format=2))
    with pytest.raises(ArchiveError, match="install the release that wrote it"):
        Archive(bad)
    outside = [{"name": "../outside", "bytes": 0, "sha256": ""}]
    alter(with_list(members=outside))
    with pytest.raises(ArchiveError, match="its members do not begin with"):
        Archive(bad)
    bad.write_bytes(whole + gzip.compress(bytes(2 << 20)))
    with pytest.raises(ArchiveError, match="data after its last member"):
        Archive(bad)


def pack(to, members):
    with tarfile.open(to, "w:gz", format=tarfile.GNU_FORMAT) as out:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            out.addfile(member, io.BytesIO(content))


def list_of(members, wrong_size_of=None):
    return [
        {
            "name": name,
            "bytes": 1 if name == wrong_size_of else len(content),
            "sha256": hashlib.sha256(content).hexdigest(),
        }
        for name, content in members.items()
    ]


def test_an_archive_with_malformed_json_is_refused(tmp_path, capsys):
    bad = tmp_path / "bad.tar.gz"
    deep = b"[" * 100_000

    def contents(members):
        fields = {"format": 1, "schema": 1, "campaign": "kept", "members": list_of(members)}
        return json.dumps(fields).encode()

    members = dict.fromkeys(MEMBERS, b"")
    for content in (contents({**members, 7: b""}), b"[]", b"7", b"{", deep):
        pack(bad, {"archive.json": content})
        with pytest.raises(ArchiveError, match=r"archive\.json .*it is not a list of members"):
            Archive(bad)
    assert main(["export", "lerobot", str(bad), "--output", str(tmp_path / "dataset")]) == 1
    assert capsys.readouterr().err.startswith("error: failed to read member archive.json")
    for content in (b"", b"[]", b"\xff", deep):
        members["specification.json"] = content
        pack(bad, {"archive.json": contents(members), **members})
        with Archive(bad) as opened:
            with pytest.raises(ArchiveError, match=r"specification\.json .*not a JSON object"):
                opened.specification()


def rewrite(file, to, films=(), sql="", wrong_size_of=None):
    """Writes a copy of an archive with added films and a changed database. The copy's list of
    members is correct, except for the size of the member `wrong_size_of`."""
    with tarfile.open(file) as tar:
        members = {member.name: tar.extractfile(member).read() for member in tar}
    contents = json.loads(members.pop("archive.json"))
    database = to.with_suffix(".sqlite")
    database.write_bytes(members["coordinator.sqlite"])
    with contextlib.closing(sqlite3.connect(database)) as connection:
        connection.executescript(f"PRAGMA journal_mode = DELETE; {sql}")
    members["coordinator.sqlite"] = database.read_bytes()
    members |= films
    contents["members"] = list_of(members, wrong_size_of)
    pack(to, {"archive.json": json.dumps(contents).encode(), **members})


def test_a_film_outside_the_archive_is_refused(archive, tmp_path):
    """Otherwise the export of an untrusted archive could publish any file of the machine."""
    pytest.importorskip("pyarrow")
    file, _ = archive
    secret = tmp_path / "secret"
    secret.write_text("hunter2")
    bad = tmp_path / "bad.tar.gz"
    filmed = """
        INSERT OR REPLACE INTO artifact (attempt_id, kind, path, size_bytes, stored_ms)
            SELECT attempt_id, 'video', '{path}', 7, 0 FROM result
    """
    for path in (secret, "coordinator.sqlite", "artifacts/kept/../../../secret", "secret"):
        rewrite(file, bad, sql=filmed.format(path=path))
        with Archive(bad) as opened:
            with pytest.raises(ArchiveError, match="which is not in the archive"):
                export(opened, tmp_path / "dataset", films=True)
        exported = [path for path in tmp_path.glob("dataset/**/*") if path.is_file()]
        assert all(b"hunter2" not in path.read_bytes() for path in exported)
    # A film with a name too long for a tar header is read like any other member.
    film = f"artifacts/kept/{'f' * 120}.mp4"
    rewrite(file, bad, films={film: b"a film"}, sql=filmed.format(path=film))
    with Archive(bad) as opened:
        assert {rollout.film.read_bytes() for rollout in opened.rollouts()} == {b"a film"}


def test_a_malicious_archive_takes_no_memory_or_disk_and_runs_no_code(archive, tmp_path):
    file, _ = archive
    expanded_bytes = 192 << 20
    bad = tmp_path / "bad.tar.gz"
    film = "artifacts/kept/film.mp4"
    for page in ("artifacts/kept/page.html", "artifacts/kept/../film.mp4", "artifacts/film.mp4"):
        rewrite(file, bad, films={page: b"<p>"})
        with pytest.raises(ArchiveError, match="no film of this campaign"):
            Archive(bad)
    tracemalloc.start()
    try:
        with gzip.open(bad, "wb", compresslevel=1) as out:
            name = tarfile.TarInfo("././@LongLink")
            name.type, name.size = tarfile.GNUTYPE_LONGNAME, expanded_bytes
            out.write(name.tobuf(tarfile.GNU_FORMAT))
            for _ in range(expanded_bytes >> 20):
                out.write(b"n" * (1 << 20))
        with pytest.raises(ArchiveError, match="not an archive of a campaign"):
            Archive(bad)
        assert tracemalloc.get_traced_memory()[1] < expanded_bytes / 4
    finally:
        tracemalloc.stop()
    rewrite(file, bad, films={film: bytes(expanded_bytes)})
    with pytest.raises(ArchiveError, match="it claims 192 MiB of members"):
        Archive(bad)
    rewrite(file, bad, films={film: bytes(expanded_bytes)}, wrong_size_of=film)
    with pytest.raises(ArchiveError, match="it has 201326592 bytes"):
        Archive(bad)
    # If the authorizer permitted views, this view would count without end.
    endless = """
        ALTER TABLE motion RENAME TO former;
        CREATE VIEW motion AS
            WITH RECURSIVE n(job_id) AS (SELECT 1 UNION ALL SELECT job_id + 1 FROM n)
            SELECT job_id, x'' AS path, x'' AS actions FROM n WHERE job_id < 0;
    """
    rewrite(file, bad, sql=endless)
    with Archive(bad) as opened, pytest.raises(ArchiveError, match="archive the campaign again"):
        list(opened.rollouts())
    assert not (tmp_path / "outside").exists()


def test_a_lerobot_dataset_has_an_episode_for_each_rollout(archive, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet", reason="pip install pyarrow")
    file, _ = archive
    folder = tmp_path / "dataset"
    assert main(["export", "lerobot", str(file), "--output", str(folder)]) == 0
    lines = {
        path.stem: [json.loads(line) for line in path.read_text().splitlines()]
        for path in (folder / "meta").glob("*.jsonl")
    }
    info = json.loads((folder / "meta/info.json").read_text())
    with Archive(file) as opened:
        rollouts = list(opened.rollouts())
    assert info["codebase_version"] == "v2.1"
    assert info["total_episodes"] == len(rollouts) == len(lines["episodes"])
    assert info["total_frames"] == sum(rollout.steps for rollout in rollouts)
    first = 0
    for index, rollout in enumerate(rollouts):
        name = info["data_path"].format(episode_chunk=0, episode_index=index)
        table = pq.read_table(folder / name)
        assert set(table.column_names) == set(info["features"])
        frame = table.to_pandas()
        assert np.array_equal(np.stack(frame["action"]), rollout.actions)
        assert np.array_equal(np.stack(frame["observation.state"]), rollout.path[:-1])
        assert list(frame["index"]) == list(range(first, first + rollout.steps))
        assert frame["next.success"].iloc[-1] == rollout.success
        assert not frame["next.done"].iloc[:-1].any()
        stats = lines["episodes_stats"][index]["stats"]["action"]
        assert stats["max"] == pytest.approx(rollout.actions.max(axis=0).tolist())
        assert lines["rollouts"][index]["rollout_id"] == rollout.rollout_id
        first += rollout.steps
    # A folder that is not empty is left unchanged.
    assert main(["export", "lerobot", str(file), "--output", str(folder)]) == 1
    # No rollout was filmed, so nothing is exported.
    assert main(["export", "lerobot", str(file), "--films", "--output", str(tmp_path / "f")]) == 1
    assert not (tmp_path / "f").exists()


def test_lerobot_doctor_accepts_the_dataset(archive, tmp_path):
    doctor = shutil.which("lerobot-doctor")
    if doctor is None:
        pytest.skip("lerobot-doctor is not installed")
    file, _ = archive
    folder = tmp_path / "dataset"
    assert main(["export", "lerobot", str(file), "--output", str(folder)]) == 0
    done = subprocess.run([doctor, folder], capture_output=True, text=True, check=False)
    assert "FAIL" not in done.stdout, done.stdout


def test_a_missing_package_is_named_with_the_command(archive, tmp_path, monkeypatch):
    file, _ = archive
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with Archive(file) as opened, pytest.raises(SettingsError, match="pip install pyarrow"):
        export(opened, tmp_path / "dataset")
