//! The whole design on a small part of the benchmark, run by real processes: all seven conditions
//! and two subsets, at all three levels, give a complete paired table.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use benchmark::{Axis, AxisSet, Condition, Level, ManifestRow, RolloutId};
use serde_json::{Value, json};
use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use tests::programs::{Campaigns, Process};

const NAME: &str = "all-axes";
const TASKS: [&str; 2] = ["libero_object/0", "libero_spatial/0"];
const SUBSETS: &str = "camera+language,robot+sensor+actuation";
/// Six axes alone, two subsets of them, and all of them together.
const CONDITIONS: usize = 9;
/// Number of rollouts: for one configuration of each task, its nominal rollout, and every condition
/// at every level.
const ROLLOUTS: usize = TASKS.len() * (1 + CONDITIONS * Level::PERTURBED.len());

#[test]
fn all_conditions_at_three_levels_give_a_complete_paired_table() {
    let data = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::start(data.path());
    let endpoint = &campaigns.gateway.url;
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", NAME, "--policy", "expert", "--endpoint", endpoint,
        "--tasks", &TASKS.join(","), "--axes", "all", "--subsets", SUBSETS, "--levels", "L1,L2,L3",
        "--configs", "0", "--nominal", "eval",
    ]);
    let _worker = Process::worker(&campaigns.coordinator.url, 2, "primitives");
    campaigns.wait_for_commits(NAME, None);

    check_export(&campaigns.outcomes(NAME));
    check_report(&campaigns.succeed(&["report", NAME, "--json"]));
    check_table(&campaigns.succeed(&["report", NAME, "--full"]));
    check_stored(&stored(data.path()));
}

/// Asserts that every rollout of the design has one row of `coordinator export`.
fn check_export(rows: &[String]) {
    assert_eq!(rows.len(), ROLLOUTS);
    let mut conditions: BTreeMap<(Condition, Level), usize> = BTreeMap::new();
    let mut ids = BTreeSet::new();
    for row in rows {
        let row: Value = serde_json::from_str(row).unwrap();
        let id: RolloutId = row["rollout_id"].as_str().unwrap().parse().unwrap();
        assert_eq!(row["axis"], json!(id.condition()));
        *conditions.entry((id.condition(), id.level())).or_default() += 1;
        ids.insert(id);
    }
    assert_eq!(ids.len(), ROLLOUTS);
    assert_eq!(conditions.len(), 1 + CONDITIONS * Level::PERTURBED.len());
    assert!(conditions.values().all(|count| *count == TASKS.len()), "{conditions:?}");
}

/// Asserts that the cells of all three levels are complete: each has the paired measures of the two
/// tasks' configurations.
fn check_report(report: &str) {
    let document: Value = serde_json::from_str(report).unwrap();
    let report = &document["reports"][0];
    assert_eq!(report["realisation"], "matched");
    assert_eq!(report["axes"], json!(Axis::ALL));
    assert_eq!(report["quarantined"], json!([]));
    assert_eq!(report["nominal"]["count"]["n"], TASKS.len());
    let cells = report["cells"].as_array().unwrap();
    let levels: Vec<&Value> = cells.iter().map(|cell| &cell["level"]).collect();
    assert_eq!(levels, ["L1", "L2", "L3"]);
    for cell in cells {
        let completeness = &cell["completeness"];
        assert_eq!(completeness["complete"], TASKS.len(), "{cell}");
        assert_eq!(completeness["expected"], TASKS.len(), "{cell}");
        assert_eq!(cell["simultaneous"]["n"], TASKS.len(), "{cell}");
        assert_eq!(cell["paired"]["n"], TASKS.len(), "{cell}");
        for axis in Axis::ALL {
            let alone = &cell["alone"][axis.name()]["count"];
            assert_eq!(alone["n"], TASKS.len(), "{axis}: {cell}");
        }
        for subset in SUBSETS.split(',') {
            assert_eq!(cell["subsets"][subset]["n"], TASKS.len(), "{subset}: {cell}");
        }
    }
}

fn check_table(table: &str) {
    for word in ["camera", "language", "R_e", "R_c", "realisation matched"] {
        assert!(table.contains(word), "no `{word}` in the report:\n{table}");
    }
    for word in ["no result yet", " missing"] {
        assert!(!table.contains(word), "`{word}` in the report:\n{table}");
    }
}

/// A committed rollout: its manifest row, which has the policy's instruction, and the realised
/// perturbation.
struct Stored {
    row: ManifestRow,
    realised: BTreeMap<String, serde_json::Value>,
}

/// Asserts that the policy got the canonical instruction or, where the language axis was perturbed,
/// the paraphrase of language alone at the same task, level and configuration, and that every axis
/// was realised in combinations as it was alone.
fn check_stored(stored: &BTreeMap<RolloutId, Stored>) {
    assert_eq!(stored.len(), ROLLOUTS);
    for (id, Stored { row, realised }) in stored {
        let canonical = id.task().instruction();
        let alone = |axis| {
            let config = id.config().unwrap();
            let condition = Condition::Single(axis);
            let alone = RolloutId::perturbed(id.task(), condition, id.level(), config);
            &stored[&alone.unwrap()]
        };
        let axes = id.condition().axes(AxisSet::ALL);
        if axes.contains(Axis::Language) {
            let language = &alone(Axis::Language).row;
            assert_ne!(row.instruction, canonical, "{id}");
            assert_eq!(row.instruction, language.instruction, "{id}");
            assert!(row.variant_id.is_some(), "{id}");
        } else {
            assert_eq!(row.instruction, canonical, "{id}");
        }
        let metric = axes.without(AxisSet::of(Axis::Language));
        assert_eq!(realised.len(), metric.len(), "{id}");
        for axis in metric.axes() {
            let name = axis.name();
            assert_eq!(realised[name], alone(axis).realised[name], "{id}: {axis}");
        }
    }
}

/// Reads the committed rollouts from the coordinator's database. The manifest row is the
/// one that was leased, and its instruction goes to the policy verbatim.
fn stored(data: &Path) -> BTreeMap<RolloutId, Stored> {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let rows: Vec<(String, String)> = runtime.block_on(async {
        let options =
            SqliteConnectOptions::new().filename(data.join("coordinator.sqlite")).read_only(true);
        let mut database = SqliteConnection::connect_with(&options).await.unwrap();
        let rows = sqlx::query_as(
            "SELECT j.manifest_row, r.outcome -> 'realised'
             FROM result r JOIN job j ON j.id = r.job_id",
        );
        rows.fetch_all(&mut database).await.unwrap()
    });
    let stored = rows.iter().map(|(row, realised)| {
        let row: ManifestRow = serde_json::from_str(row).unwrap();
        let realised = serde_json::from_str(realised).unwrap();
        (row.id, Stored { row, realised })
    });
    stored.collect()
}
