"""Results, reports and comparisons of a campaign run by a real worker, and of
published outcomes."""

import json
import os
import runpy
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rollout_client.errors import NoSuchCampaignError, ProgramError, RefusedError

from .conftest import specification

PUBLISHED = Path(__file__).resolve().parents[3] / "examples" / "openvla_oft"
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def test_results_are_the_exported_rows_with_types(measured):
    results = measured.campaign("measured").results()
    program = measured._program
    exported = program.run(*program.with_connection("export", "measured", "--format", "jsonl"))
    rows = [json.loads(line) for line in exported.splitlines()]
    assert len(results) == len(rows) == 8
    for key in rows[0]:
        expected = [row[key] for row in rows]
        assert [None if pd.isna(value) else value for value in results[key]] == expected, key
    assert set(results["axis"]) == {"nominal", "camera", "actuation", "simultaneous"}
    assert results["success"].dtype == "bool"
    assert results["config"].dtype == "Int64"
    assert (results["replicate"] == 0).all()
    assert (results["wall_s"] > 0).all()


def test_the_status_of_a_finished_campaign_and_its_worker(measured):
    status = measured.campaign("measured").status()
    assert status.is_finished and status.committed == status.total == 8
    results = measured.campaign("measured").results()
    assert status.succeeded == results["success"].sum()
    workers = measured.workers()
    assert list(workers["slots"]) == [2]
    assert list(workers["asset_pack"]) == ["primitives"]
    assert list(workers["has_signed_off"]) == [True]


def test_rates_of_a_report_are_those_of_the_results(measured):
    campaign = measured.campaign("measured")
    results, success = campaign.results(), campaign.report().success
    result_counts = results.groupby(["level", "axis"])["success"].agg(["sum", "count"])
    report_counts = success.set_index(["level", "condition"])
    assert set(report_counts.index) == set(result_counts.index)
    for condition, row in report_counts.iterrows():
        assert row["successes"] == result_counts.loc[condition, "sum"]
        assert row["n"] == result_counts.loc[condition, "count"]
    assert (success["missing"] == 0).all()


def test_a_gate_returns_what_it_decided(measured):
    # The campaign is compared with itself, so that nothing need be run.
    decided = measured.gate("expert", "measured", name="measured")
    assert decided["first_worse"] is None
    assert [decision["verdict"] for decision in decided["decisions"]] == ["undecided"]
    with pytest.raises(RefusedError, match="nobody"):
        measured.gate("expert", "published:nobody")


def test_the_example_judges_a_policy_while_it_is_trained(
    serve, connect, gateway, run, working, programs, monkeypatch
):
    pytest.importorskip("rollout_policies", reason="pip install ./policies")
    server = serve()
    url = f"http://{server.address}"
    endpoint = f"http://{gateway.address}"
    client = connect(url)
    design = specification("baseline", endpoint, axes=["camera"], configs=[0], nominal="all")
    rows = client._program.run("manifest", "--spec", "-", text=json.dumps(design)).splitlines()
    nominal = [row for row in map(json.loads, rows) if row["level"] == "L0"]
    policy = {"name": "expert", "endpoint": endpoint}
    run(server, client.create({"name": "baseline", "policy": policy}, rows=nominal[:16]))
    monkeypatch.setenv("COORDINATOR_URL", url)
    monkeypatch.setenv("PATH", str(programs), prepend=os.pathsep)
    judge = runpy.run_path(str(EXAMPLES / "while_training.py"))["judge"]
    with working(server):
        decision = judge(1000, lambda state: np.zeros(7), "baseline")
    assert (decision["policy"], decision["verdict"]) == ("step-1000", "worse")
    assert decision["conditions"][0]["difference"] == -1


def test_the_notebook_makes_the_tables_of_a_paper(programs, monkeypatch):
    root = PUBLISHED.parents[1]
    monkeypatch.chdir(root)
    monkeypatch.setenv("PATH", str(programs), prepend=os.pathsep)
    cells = json.loads((root / "python" / "examples" / "paper_tables.ipynb").read_text())["cells"]
    names = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    by_suite, by_axis = names["by_suite"], names["by_axis"]
    at_l2 = by_suite.loc[("OpenVLA-OFT", "L2", "simultaneous")]
    assert at_l2["libero_goal"] == 50 and at_l2["all"] == 57.75
    assert by_axis.loc[("OpenVLA-OFT", "L2"), "simultaneous"] == "57.8 [51.2, 64.1]"


def test_a_report_has_a_row_per_configuration_with_its_outcomes(measured):
    report = measured.campaign("measured").report()
    assert len(report.configurations) == 2
    results = measured.campaign("measured").results()
    camera = results[results["axis"] == "camera"].set_index("config")["success"]
    for row in report.configurations.itertuples():
        assert row.camera == camera[row.config]
        assert row.conjunction == (row.camera and row.actuation)
    assert report.configurations["lighting"].isna().all()
    assert report.paired.loc[0, "no_interval"] == "too_few_tasks"
    assert pd.isna(report.paired.loc[0, "i_ci95_low"])


def test_a_campaign_without_results_has_a_report_that_says_what_is_missing(client):
    report = client.create(specification("first")).report()
    assert len(report.paired) == 0
    assert report.success["n"].sum() == 0
    assert report.success["rate"].isna().all()
    assert report.success["missing"].sum() == 8
    assert any("8 of 8 rollouts have no result yet" in note for note in report.notes)
    assert (report.configurations["transition"].isna()).all()
    assert len(report.emergent) == len(report.compensated) == 0


def test_emergent_and_compensated_configurations_are_as_many_as_the_paired_table_counts(connect):
    # Result files need no coordinator.
    report = connect("http://127.0.0.1:1").report(PUBLISHED)
    paired = report.paired.set_index("level")
    assert list(paired.index) == ["L1", "L2", "L3"]
    assert dict(report.emergent.groupby("level").size()) == dict(paired["b"])
    assert dict(report.compensated.groupby("level").size()) == dict(paired["c"])
    assert report.emergent["conjunction"].all() and not report.emergent["simultaneous"].any()
    assert (paired["i_ci95_low"] <= paired["i"]).all()
    assert (paired["i"] <= paired["i_ci95_high"]).all()
    json_rows = report.json["paired"]["OpenVLA-OFT"]
    for level, row in paired.iterrows():
        assert row["s_robot"] == json_rows[level]["s_axis"]["robot"]
        assert [row["r_e_ci95_low"], row["r_e_ci95_high"]] == json_rows[level]["r_e_ci95"]


def published_rows():
    text = (PUBLISHED / "rollouts.jsonl").read_text()
    return [json.loads(line) for line in text.splitlines()]


def test_successes_of_published_outcomes_are_those_of_their_file(connect):
    counted = Counter()
    for row in published_rows():
        _, _, published, level, _ = row["rollout_id"].split("/")
        condition = {"combination": "simultaneous"}.get(published, published)
        counted[level, condition, row["success"]] += 1
    success = connect("http://127.0.0.1:1").report(PUBLISHED).success
    cells = success[success["level"] != "L0"]
    assert len(cells) == 3 * 7
    for cell in cells.itertuples():
        successes = counted[cell.level, cell.condition, True]
        assert cell.successes == successes
        assert cell.n == successes + counted[cell.level, cell.condition, False]
        assert cell.rate == cell.successes / cell.n


def test_a_difference_is_the_first_rate_minus_the_second(connect, tmp_path):
    rows = published_rows()
    solved = [row for row in rows if "/robot/L2/" in row["rollout_id"] and row["success"]]
    for row in solved[:30]:
        row["success"] = False
    (tmp_path / "rollouts.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n")
    comparison = connect("http://127.0.0.1:1").compare(PUBLISHED, tmp_path)
    cells = comparison.cells.set_index(["level", "condition"])
    cell = cells.loc["L2", "robot"]
    assert (cell["n"], cell["a_only"], cell["b_only"]) == (400, 30, 0)
    assert cell["difference"] == pytest.approx(30 / 400)
    assert cell["s_a"] - cell["s_b"] == pytest.approx(30 / 400)
    assert 0 < cell["difference_ci95_low"] < 30 / 400 < cell["difference_ci95_high"]
    assert cells.loc["L1", "robot"]["a_only"] == 0
    assert comparison.a != comparison.b


def test_a_report_covers_several_campaigns_and_files(measured):
    report = measured.report("measured", PUBLISHED)
    assert set(report.success["policy"]) == {"expert", "OpenVLA-OFT"}
    assert set(report.configurations["policy"]) == {"expert", "OpenVLA-OFT"}


def test_a_campaign_compared_with_itself_differs_in_nothing(measured):
    campaign = measured.campaign("measured")
    comparison = campaign.compare(campaign)
    cells = comparison.cells.set_index(["level", "condition"])
    assert set(cells.index) == {
        ("L0", "nominal"),
        ("L1", "camera"),
        ("L1", "actuation"),
        ("L1", "simultaneous"),
    }
    assert (cells["n"] == 2).all()
    assert (cells["difference"] == 0).all()
    assert (cells["a_only"] + cells["b_only"] == 0).all()
    assert (cells["no_interval"] == "too_few_tasks").all()
    assert not comparison.unpaired


def test_an_impossible_comparison_is_refused_with_the_programs_message(measured, tmp_path):
    campaign = measured.campaign("measured")
    with pytest.raises(RefusedError, match="realisation"):
        campaign.compare(PUBLISHED)
    with pytest.raises(RefusedError, match="absent"):
        measured.compare("measured", tmp_path / "absent")
    with pytest.raises(NoSuchCampaignError, match="`nope`"):
        campaign.compare("nope")


def test_without_the_program_reports_fail_with_a_remedy_and_results_are_read(
    measured, connect, monkeypatch, tmp_path
):
    url = measured._connection.access.url
    monkeypatch.setenv("PATH", str(tmp_path))
    for program, words in [(None, "put its folder on PATH"), (tmp_path / "none", "tmp|none")]:
        campaign = connect(url, program=program).campaign("measured")
        with pytest.raises(ProgramError, match=words) as failed:
            campaign.report()
        assert "Client(program=" in str(failed.value)
        assert len(campaign.results()) == 8
