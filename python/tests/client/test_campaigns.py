"""Campaigns of a real coordinator: creation, lists, pauses and status."""

import json
import os
import signal
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path

import pandas as pd
import pytest

from rollout_client.errors import NoSuchCampaignError, RefusedError, SettingsError

from .conftest import in_a_process, specification


def test_a_coordinator_without_campaigns_gives_an_empty_frame_with_typed_columns(client):
    campaigns = client.campaigns()
    assert len(campaigns) == 0
    assert campaigns["name"].dtype == "string"
    assert campaigns["total"].dtype == "int64"
    assert campaigns["is_finished"].dtype == "bool"
    assert isinstance(campaigns["created_at"].dtype, pd.DatetimeTZDtype)


def test_a_campaign_is_created_from_fields_and_from_a_file(client, tmp_path):
    client.create(specification("fields"), priority=7)
    path = tmp_path / "spec.json"
    path.write_text(json.dumps(specification("file", replicates=2)))
    client.create(path)
    campaigns = client.campaigns().set_index("name")
    assert list(campaigns.index) == ["fields", "file"]
    assert campaigns.loc["fields", "total"] == 8
    assert campaigns.loc["file", "total"] == 16
    assert campaigns.loc["fields", "priority"] == 7
    assert pd.isna(campaigns.loc["fields", "rate_per_sec"])
    age = datetime.now(timezone.utc) - campaigns.loc["fields", "created_at"]
    assert 0 <= age.total_seconds() < 600


def test_campaigns_and_jobs_equal_the_command_lines_output(client, programs):
    client.create(specification("first"))
    printed = client._program.run(
        *client._program.with_connection("campaign", "status", "first", "--json")
    )
    printed = json.loads(printed)["campaigns"][0]
    listed = client.campaigns().iloc[0]
    assert printed.pop("early_stop") is None
    assert listed[["stop_rule", "stopped_after", "saved"]].isna().all()
    for key, value in {**printed, **printed["rollouts"]}.items():
        if key == "created_at":
            assert listed[key] == pd.Timestamp(value)
        elif key != "rollouts":
            assert pd.isna(listed[key]) if value is None else listed[key] == value, key


def test_the_status_has_the_stop_rule(client):
    client.create(specification("early", stop={"rule": "I excludes 0", "seed": 3}))
    status = client.campaign("early").status()
    assert status.stop_rule == "I excludes 0"
    assert (status.stopped_after, status.saved, status.is_finished) == (None, None, False)


def test_an_equal_specification_is_the_same_campaign_and_a_different_one_is_refused(client):
    spec = specification("first")
    assert client.create(spec).name == client.create(spec).name == "first"
    with pytest.raises(RefusedError, match="they differ in `configs`"):
        client.create({**spec, "configs": [3]})
    assert client.campaign("first").spec()["configs"] == [0, 1]


def test_an_invalid_specification_is_refused_with_the_coordinators_message(client, tmp_path):
    with pytest.raises(RefusedError, match="`color`"):
        client.create(specification("first", color="red"))
    with pytest.raises(RefusedError, match="libero_object/99"):
        client.forecast(specification("first", tasks=["libero_object/99"]))
    with pytest.raises(SettingsError, match="absent.json"):
        client.create(tmp_path / "absent.json")
    assert len(client.campaigns()) == 0


def test_a_forecast_counts_rollouts_of_each_suite_and_creates_nothing(client):
    tasks = ["libero_object/0", "libero_goal/1", "libero_goal/2"]
    forecast = client.forecast(specification("first", tasks=tasks, replicates=3))
    assert forecast.rollouts == {"libero_goal": 48, "libero_object": 24}
    assert forecast.total == 72
    assert (forecast.workers, forecast.secs) == (0, None)
    assert forecast.useful_slots is None
    assert len(client.campaigns()) == 0


def test_rows_are_forecast_created_and_appended(client):
    design = specification("first", replicates=2)
    text = client._program.run("manifest", "--spec", "-", text=json.dumps(design))
    rows = [json.loads(line) for line in text.splitlines()]
    of_rows = {"name": "rows", **{key: design[key] for key in ("policy", "replicates")}}
    for spec, total in [(design, 16), ({**of_rows, "rows": rows[:5]}, 10)]:
        assert client.forecast(spec).total == client.create(spec).status().total == total
    assert client.create(of_rows, rows=rows[:5]).status().total == 10
    assert [client.append("rows", rows[4:]), client.append("rows", rows)] == [6, 0]
    with pytest.raises(RefusedError, match="max_steps 7, but 280"):
        client.append("rows", [{**rows[0], "max_steps": 7}])
    with pytest.raises(RefusedError, match="`tasks` and `rows`"):
        client.create(design, rows=rows)


def test_the_example_adds_the_rollouts_of_solved_tasks(serve, connect, gateway, run, tmp_path):
    server = serve()
    client = connect(f"http://{server.address}")
    text = json.dumps(specification("first", configs=[0]))
    path = tmp_path / "rows.jsonl"
    path.write_text(client._program.run("manifest", "--spec", "-", text=text))
    example = Path(__file__).resolve().parents[2] / "examples" / "perturb_solved.py"
    command = (sys.executable, example, path, "expert", f"http://{gateway.address}")
    url, packages = client._connection.access.url, os.pathsep.join(filter(None, sys.path))
    environment = {**os.environ, "COORDINATOR_URL": url, "PYTHONPATH": packages}
    with subprocess.Popen(
        list(map(str, command)), env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        while process.poll() is None and client.campaigns().empty:
            time.sleep(0.1)
        run(server, client.campaign("solved"))
        assert process.communicate(timeout=60)[0].endswith("were added: 3\n")
    assert client.campaign("solved").status().total == 4


def test_a_campaign_is_paused_resumed_and_cancelled(client):
    campaign = client.create(specification("first"))
    assert campaign.status().state == "running"
    assert campaign.pause().state == "paused"
    assert campaign.resume().state == "running"
    ended = campaign.cancel()
    assert (ended.state, ended.is_finished) == ("cancelled", True)
    with pytest.raises(RefusedError, match="cancelled"):
        campaign.resume()


def test_following_ends_when_the_campaign_does(client):
    campaign = client.create(specification("first"))
    states = []
    for status in campaign.follow(every=0.01):
        states.append(status.state)
        if len(states) == 3:
            campaign.cancel()
    assert states == ["running"] * 3 + ["cancelled"]


FOLLOW = """
import sys
from rollout_client import Client
campaign = Client(sys.argv[1]).campaign("first")
for status in campaign.follow(every=60):
    print("followed", flush=True)
print("then", campaign.status().state, flush=True)
"""


def test_ctrl_c_ends_following_and_leaves_the_campaign_running(client):
    client.create(specification("first"))
    with in_a_process(FOLLOW, client._connection.access.url) as process:
        assert process.stdout.readline() == "followed\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    assert printed == "then running\n", errors
    assert "Traceback" not in errors


def test_errors_name_a_missing_campaign_and_the_new_name_of_a_renamed_campaign(client):
    with pytest.raises(NoSuchCampaignError, match="`nope`.*has no such campaign"):
        client.campaign("nope")
    campaign = client.create(specification("first"))
    program = client._program
    program.run(*program.with_connection("campaign", "set", "first", "--name", "second"))
    for method in (campaign.status, campaign.results, campaign.report, campaign.pause):
        with pytest.raises(NoSuchCampaignError, match="second"):
            method()


def test_jobs_are_listed_in_pages_and_filtered(client, monkeypatch):
    campaign = client.create(specification("first"))
    whole = campaign.jobs()
    monkeypatch.setattr("rollout_client.campaign.PAGE", 3)
    pages = campaign.jobs()
    pd.testing.assert_frame_equal(pages, whole)
    assert len(whole) == 8
    assert set(whole["state"]) == {"queued"}
    assert whole["steps"].isna().all() and whole["steps"].dtype == "Int64"
    assert len(campaign.jobs(condition="camera")) == 2
    assert len(campaign.jobs(state="quarantined")) == 0
    with pytest.raises(RefusedError, match="sleepy"):
        campaign.jobs(state="sleepy")
