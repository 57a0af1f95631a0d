//! Display of explanations in the report, on the page, as a table and in films, and interactions of
//! the axes in campaigns that ran all subsets.

use std::collections::BTreeSet;
use std::time::Duration;

use benchmark::RolloutId;
use proto::coordinator as wire;
use serde_json::Value;

use crate::explain::{create_with, explained, outcome};
use crate::films::{take_films, upload};
use crate::json::{documented, keys};
use crate::page::http;
use crate::process::{Serve, fail, fits_a_terminal, succeed};
use crate::search::run_all;

async fn page(serve: &Serve, path: &str) -> String {
    let answer = http(&serve.url, &format!("GET {path}")).await;
    assert_eq!(answer.code, 200, "{path}");
    answer.text()
}

fn printed(serve: &Serve, arguments: &[&str]) -> String {
    succeed(serve.command(arguments))
}

#[tokio::test(flavor = "multi_thread")]
async fn report_page_and_table_show_the_explanation() {
    let (folder, serve) = Serve::anew();
    create_with(&serve, &[]);
    let mut worker = serve.worker("w").await;
    run_all(&mut worker, outcome).await;
    // Before the explanation, the page shows the command that starts it. A configuration other than
    // those below is requested, since a page is cached for a second.
    let unexplained = "/campaigns/first/configurations/object/t1/simultaneous/L2/c00";
    let hint = page(&serve, unexplained).await;
    assert!(hint.contains("coordinator explain first"), "{hint}");
    let findings = explained(&serve, &[]).await;

    let words = printed(&serve, &["report", "first-explained"]);
    assert!(words.contains("6 of 6 transitions explained"), "{words}");
    fits_a_terminal(&words);
    let json = printed(&serve, &["report", "first-explained", "--json"]);
    let json: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["reports"][0]["explanation"], findings);

    let csv = folder.path().join("subsets.csv");
    let parquet = folder.path().join("subsets.parquet");
    let html = folder.path().join("report.html");
    let [csv, parquet, html] = [csv, parquet, html].map(|path| path.to_string_lossy().into_owned());
    #[rustfmt::skip]
    printed(&serve, &[
        "report", "first-explained", "--table", &csv, "--table", &parquet, "--html", &html,
    ]);
    let table = std::fs::read_to_string(&csv).expect("written");
    // Five tasks have one minimal subset, and one task has two.
    assert_eq!(table.lines().count(), 1 + 7, "{table}");
    assert!(
        table.contains("libero_object,4,0,compensated,robot,camera+robot,2,true,0,"),
        "{table}"
    );
    assert!(std::fs::metadata(&parquet).expect("written").len() > 0);
    let html = std::fs::read_to_string(&html).expect("written");
    for shown in ["Minimal subsets of the axes", "Emergent failures", "Compensated successes"] {
        assert!(html.contains(shown), "{shown}");
    }
    assert!(!html.contains("Paired outcomes"), "the campaign runs only parts of configurations");

    let emergent = "/campaigns/first/configurations/object/t0/simultaneous/L2/c00";
    let campaign = page(&serve, "/campaigns/first-explained").await;
    assert!(campaign.contains(&format!("href=\"{emergent}\"")), "{campaign}");
    let bar = "camera+robot: 2 configurations, established in 2";
    assert!(campaign.contains(bar), "{campaign}");
    // The pages show the outcomes of both campaigns, and mark minimal subsets with a ring.
    let subset = "/campaigns/first-explained/configurations/object/t0/camera+robot/L2/c00";
    for place in [emergent, subset] {
        let page = page(&serve, place).await;
        assert!(page.contains("camera+robot: fails; minimal"), "{place}");
        assert!(page.contains("robot+sensor: succeeds"), "{place}");
        assert!(page.contains(&format!("href=\"{subset}#camera+robot\"")), "{place}");
        assert!(page.contains("camera and robot together"), "{place}");
        assert!(page.contains("--record transitions"), "the remedy for missing films is shown");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn explaining_rollouts_are_filmed_and_shown_side_by_side() {
    let (_folder, serve) = Serve::anew();
    create_with(&serve, &["--record", "transitions"]);
    explained(&serve, &[]).await;
    let mut worker = serve.worker("films").await;
    let all = take_films(&mut worker).await;
    let id = |film: &wire::Film| -> RolloutId {
        let row: Value = serde_json::from_str(&film.manifest_row).expect("a row");
        let id = row["rollout_id"].as_str().or(row["id"].as_str());
        id.expect("an id").parse().expect("an id")
    };
    // The minimal subset of the third task has three axes. This subset and its pairs are filmed.
    let filmed_conditions: BTreeSet<String> = all
        .iter()
        .filter(|film| film.campaign == "first-explained" && id(film).task().index() == 2)
        .map(|film| id(film).condition().to_string())
        .collect();
    let expected =
        ["camera+lighting", "camera+lighting+sensor", "camera+sensor", "lighting+sensor"];
    assert_eq!(filmed_conditions, expected.map(str::to_owned).into());

    // The page shows exactly one command that makes the films, with an address that can be pasted.
    let subset = "/campaigns/first/configurations/object/t2/simultaneous/L2/c00";
    let before = page(&serve, subset).await;
    let command = "worker film --connect <span data-origin>http://127.0.0.1:7411</span>";
    assert_eq!(before.matches(command).count(), 1, "{before}");
    assert!(!before.contains("--connect URL"), "{before}");
    for film in &all {
        upload(&mut worker, &film.attempt_id).await;
    }
    // A page is cached for a second.
    tokio::time::sleep(Duration::from_millis(1100)).await;
    let page = page(&serve, subset).await;
    for set in expected {
        let video = format!("/campaigns/first-explained/videos/object/t2/{set}/L2/c00?replicate=0");
        assert!(page.contains(&video), "{set}");
    }
    assert!(!page.contains("Not all of these rollouts"), "a film is missing");
}

#[tokio::test(flavor = "multi_thread")]
async fn interactions_add_up_to_simultaneous_success() {
    let (_folder, serve) = Serve::anew();
    create_with(&serve, &[]);
    let error = &fail(serve.command(&["interactions", "first"]), 1);
    assert!(error.contains("--subsets all") && error.contains("`first`"), "{error}");

    #[rustfmt::skip]
    printed(&serve, &[
        "campaign", "create", "--name", "whole", "--policy", "p",
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object", "--axes", "all",
        "--subsets", "all", "--levels", "L2", "--configs", "0",
    ]);
    let mut worker = serve.worker("w").await;
    run_all(&mut worker, outcome).await;
    let json = printed(&serve, &["interactions", "whole", "--json"]);
    let json: Value = serde_json::from_str(&json).expect("JSON");
    let mut printed_keys = BTreeSet::new();
    keys(&json, "", &mut printed_keys);
    assert_eq!(printed_keys, documented("interactions"));
    let level = &json["levels"][0];
    assert_eq!((&level["n"], &level["left_out"]), (&10.into(), &0.into()));
    let sum = |list: &str, value: &str| -> i64 {
        let entries = level[list].as_array().expect("a list").iter();
        entries.filter_map(|row| row[value]["numerator"].as_i64()).sum()
    };
    let report = printed(&serve, &["report", "whole", "--json"]);
    let report: Value = serde_json::from_str(&report).expect("JSON");
    let s_sim = report["paired"]["p"]["L2"]["s_sim"].as_f64().expect("a rate");
    // All ten nominal rollouts succeed. Shapley values are counted in sixtieths of a rollout.
    let simultaneous = 10 + sum("subsets", "moebius");
    assert_eq!(simultaneous as f64 / 10.0, s_sim);
    assert_eq!(10 + sum("sizes", "moebius"), simultaneous);
    assert_eq!(600 + sum("shares", "shapley"), 60 * simultaneous);
    assert_eq!(report["reports"][0]["interactions"], json);

    let words = printed(&serve, &["interactions", "whole"]);
    fits_a_terminal(&words);
    assert!(words.contains("camera+lighting+robot+sensor+actuation+language"));
    let page = page(&serve, "/campaigns/whole").await;
    assert!(page.contains("Interactions of the axes"));
    let lattice = "/campaigns/whole/configurations/object/t6/simultaneous/L2/c00";
    let lattice = self::page(&serve, lattice).await;
    assert!(lattice.contains("64 of 64 subsets have an outcome"));

    // The output warns if only transitions were run.
    let _ = explained(&serve, &["--exhaustive"]).await;
    let partial_interactions = printed(&serve, &["interactions", "first-explained"]);
    assert!(
        partial_interactions.contains("These configurations were picked"),
        "{partial_interactions}"
    );
}
