"""Results of archives, read without a coordinator."""

import gzip
import hashlib
import io
import json
import subprocess
import tarfile
import tracemalloc

import numpy as np
import pytest

from rollout_client.archive import MEMBERS, ArchiveError, results

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
    expected, read = campaign.results(), results(file)
    for column in ("rollout_id", "replicate", "success", "steps", "axis", "level"):
        assert list(read[column]) == list(expected[column]), column
    assert read["success"].dtype == "bool" and read["committed_at"].dt.tz is not None
    for rollout in read.itertuples():
        assert rollout.actions.shape == (rollout.steps, 7)
        assert rollout.path.shape == (rollout.steps + 1, 3)
        assert np.abs(rollout.actions).max() <= 1
        # In m: the end-effector stays within 3 m of the origin, and moves by more than 5 cm.
        assert np.abs(rollout.path).max() < 3
        assert np.ptp(rollout.path, axis=0).max() > 0.05
        assert rollout.instruction.startswith("pick up")


def refused(file, match):
    with pytest.raises(ArchiveError, match=match):
        results(file)


def test_an_incomplete_or_altered_archive_is_refused(archive, tmp_path):
    file, _ = archive
    whole = file.read_bytes()
    bad = tmp_path / "bad.tar.gz"
    for content in (whole[: len(whole) // 20], b"", b"text", gzip.compress(b"text")):
        bad.write_bytes(content)
        refused(bad, r"bad\.tar\.gz")
    refused(tmp_path / "nowhere.tar.gz", "no such file")

    def alter(change):
        with tarfile.open(file) as tar:
            pack(bad, {one.name: change(one.name, tar.extractfile(one).read()) for one in tar})

    def with_list(**fields):
        return lambda name, content: (
            json.dumps({**json.loads(content), **fields}).encode()
            if name == "archive.json"
            else content
        )

    alter(lambda name, content: content[:-1] + b"?" if "report" in name else content)
    refused(bad, r"report\.json .*SHA-256 is not the one in archive\.json")
    alter(with_list(format=1))
    refused(bad, "install the release that wrote it")
    alter(with_list(members=[{"name": "../outside", "bytes": 0, "sha256": ""}]))
    refused(bad, "its members do not begin with")


def pack(to, members):
    with tarfile.open(to, "w:gz", format=tarfile.GNU_FORMAT) as out:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            out.addfile(member, io.BytesIO(content))


def list_of(members, sizes=()):
    sizes = dict(sizes)
    return [
        {
            "name": name,
            "bytes": sizes.get(name, len(content)),
            "sha256": hashlib.sha256(content).hexdigest(),
        }
        for name, content in members.items()
    ]


def test_an_archive_with_a_malformed_list_is_refused(tmp_path):
    bad = tmp_path / "bad.tar.gz"
    members = [*list_of(dict.fromkeys(MEMBERS[:3], b"")), 7]
    contents = json.dumps({"format": 2, "campaign": "kept", "members": members})
    for content in (contents.encode(), b"[]", b"7", b"{", b"[" * 100_000):
        pack(bad, {"archive.json": content})
        refused(bad, r"archive\.json .*it is not a list of members")


def rewrite(file, to, sizes=(), **changed):
    """Writes a copy of an archive with changed members. The copy's list of members is correct,
    except for these sizes."""
    with tarfile.open(file) as tar:
        members = {member.name: tar.extractfile(member).read() for member in tar}
    contents = json.loads(members.pop("archive.json"))
    members |= {name.replace("_", "."): content for name, content in changed.items()}
    contents["members"] = list_of(members, sizes)
    pack(to, {"archive.json": json.dumps(contents).encode(), **members})


def test_a_malicious_archive_takes_no_memory_or_disk(archive, tmp_path):
    file, _ = archive
    expanded_bytes = 192 << 20
    bad = tmp_path / "bad.tar.gz"
    tracemalloc.start()
    try:
        with gzip.open(bad, "wb", compresslevel=1) as out:
            name = tarfile.TarInfo("././@LongLink")
            name.type, name.size = tarfile.GNUTYPE_LONGNAME, expanded_bytes
            out.write(name.tobuf(tarfile.GNU_FORMAT))
            for _ in range(expanded_bytes >> 20):
                out.write(b"n" * (1 << 20))
        refused(bad, "not an archive of a campaign")
        assert tracemalloc.get_traced_memory()[1] < expanded_bytes / 4
    finally:
        tracemalloc.stop()
    rewrite(file, bad, report_json=bytes(expanded_bytes))
    refused(bad, "it claims 192 MiB of members")
    rewrite(file, bad, report_json=bytes(expanded_bytes), sizes={"report.json": 1})
    refused(bad, "not of 1 bytes")
    rewrite(file, bad, sizes={"report.json": -1})
    refused(bad, "it claims")
    # A list is no rollout, and a deep one exceeds Python's stack.
    for rollout in (b"[]\n", b"{\n", b"[" * 100_000, b" " * (17 << 20)):
        rewrite(file, bad, rollouts_jsonl=b"{}\n" + rollout)
        refused(bad, r"rollouts\.jsonl .*archive the campaign again")
