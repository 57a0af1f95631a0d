//! Creating, following and exporting campaigns.

use benchmark::attempt::IkResidual;
use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use queue::{DATABASE_FILE, OpenError, Store, newest_known_schema};
use serde_json::{Value, json};
use tonic::Code;

use crate::assertions::assert_refused;
use crate::harness::{Bench, small_spec, with};

#[tokio::test]
async fn creating_a_campaign_twice_adds_nothing_and_another_specification_is_refused() {
    let bench = Bench::start().await;
    let spec = small_spec("same");
    let first = bench.create(&spec).await.expect("created");
    assert_eq!((first.jobs_added, first.jobs_total), (4, 4));
    // The order in which a set is written does not make the specification a different one.
    let reordered = with(spec.clone(), json!({"axes": ["sensor", "camera"]}));
    let second = bench.create(&reordered).await.expect("the same");
    assert_eq!((second.jobs_added, second.jobs_total), (0, 4));

    let different = with(spec, json!({"levels": ["L2"], "configs": [0, 1]}));
    assert_refused(bench.create(&different).await, Code::AlreadyExists, &["`configs`, `levels`"]);
    assert_eq!(bench.count("SELECT count(*) FROM job").await, 4);
}

#[tokio::test]
async fn a_specification_that_cannot_run_is_refused_and_nothing_is_written() {
    let bench = Bench::start().await;
    let check = async |changes: Value, words: &[&str]| {
        let refused = bench.create(&with(small_spec("bad"), changes)).await;
        let refused = refused.expect_err("a refusal");
        assert_eq!(refused.code(), Code::InvalidArgument);
        for word in words {
            assert!(refused.message().contains(word), "{refused}");
        }
    };
    check(json!({"tasks": ["libero_objects"]}), &["libero_objects", "libero_object,"]).await;
    check(json!({"tasks": ["libero_object/10"]}), &["libero_object/10", "libero_object/9"]).await;
    check(json!({"axes": ["camrea"]}), &["camrea", "camera, lighting"]).await;
    check(json!({"name": "../up"}), &["../up"]).await;
    check(json!({"name": "x".repeat(1_000_000)}), &["1 to 80"]).await;
    for table in ["SELECT count(*) FROM campaign", "SELECT count(*) FROM policy"] {
        assert_eq!(bench.count(table).await, 0);
    }
}

#[tokio::test]
async fn a_status_has_counts_and_rate() {
    let bench = Bench::with(&small_spec("paced")).await;
    let before = bench.status("paced").await;
    assert_eq!((before.rollouts.total(), before.rollouts.queued, before.live_workers), (4, 4, 0));
    assert_eq!((before.rate_per_sec, before.remaining_secs), (None, None));
    assert!(before.waiting_reason.expect("a reason").contains("no worker"));

    let mut worker = bench.worker("a").await;
    for success in [true, false] {
        let lease = worker.claim_one().await;
        bench.advance(10).await;
        let report = worker.report_altered(&lease, success, |of| of.result.wall_secs = 10.0);
        assert_eq!(worker.commit_request(report).await.0, Verdict::Accepted);
    }
    let status = bench.status("paced").await;
    assert_eq!(
        (status.rollouts.committed, status.rollouts.succeeded, status.rollouts.queued),
        (2, 1, 2)
    );
    assert_eq!(status.live_workers, 1);
    assert_eq!(status.rate_per_sec, Some(0.1));
    assert_eq!(status.remaining_secs, Some(20.0));

    let unknown = wire::GetCampaignRequest { campaign: "nobody".to_owned() };
    let refused = bench.operator().await.get_campaign(unknown).await;
    assert_refused(refused, Code::NotFound, &[]);
}

#[tokio::test]
async fn results_are_exported_as_reference_rows_in_a_stable_order() {
    let spec = with(small_spec("out"), json!({"axes": ["robot"], "replicates": 2}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let mut leases = worker.claim(4).await;
    leases.reverse();
    for lease in &leases {
        let ik = IkResidual { residual_mm: 0.125, residual_deg: 0.0, clamped_joints: 0 };
        let report = worker.report_altered(lease, true, |of| {
            of.result.ik = lease.manifest_row.contains("robot").then_some(ik);
        });
        assert_eq!(worker.commit_request(report).await.0, Verdict::Accepted);
    }
    let request = wire::ExportRequest { campaign: "out".to_owned() };
    let mut stream = bench.operator().await.export(request).await.expect("a stream").into_inner();
    let mut lines = Vec::new();
    while let Some(line) = stream.message().await.expect("a line") {
        lines.push(line.json);
    }
    let init_id = 16;
    let nominal = format!(
        r#"{{"rollout_id":"object/t0/nominal/i{init_id}","success":true,"steps":120,"axis":"nominal","level":"L0","suite":"libero_object","task_id":0,"init_id":{init_id},"config":null,"policy":"expert","wall_s":1.5"#
    );
    let robot = format!(
        r#"{{"rollout_id":"object/t0/robot/L1/c00","success":true,"steps":120,"axis":"robot","level":"L1","suite":"libero_object","task_id":0,"init_id":{init_id},"config":0,"policy":"expert","wall_s":1.5,"ik_res_mm":0.125"#
    );
    let replicate = |k: u32| format!(r#","replicate":{k}"#);
    let [first_replicate, second_replicate] = [0, 1].map(replicate);
    let goal = r#","goal_predicates":2,"goal_at_end":2,"goal_at_most":2"#;
    let expected = [
        format!("{nominal}{first_replicate}{goal}}}"),
        format!("{nominal}{second_replicate}{goal}}}"),
        format!("{robot}{first_replicate}{goal}}}"),
        format!("{robot}{second_replicate}{goal}}}"),
    ];
    assert_eq!(lines, expected);
}

#[tokio::test]
async fn a_database_of_another_schema_is_refused_untouched() {
    let newer = "INSERT INTO _sqlx_migrations
        (version, description, success, checksum, execution_time)
        VALUES (4711, 'from the future', 1, x'00', 0)";
    let up_to = format!("up to {}", newest_known_schema());
    let older = ["older checkout", "empty folder", "--data"];
    for (change, words) in [
        (newer, ["4711", &up_to, "newer program"]),
        ("UPDATE _sqlx_migrations SET checksum = x'00'", older),
        ("UPDATE _sqlx_migrations SET version = 13", older),
    ] {
        let bench = Bench::with(&small_spec("kept")).await;
        let pool = bench.database().await;
        sqlx::query(change).execute(&pool).await.expect("changed");
        pool.close().await;
        let folder = bench.stop().await;
        let path = folder.path().join(DATABASE_FILE);
        let before = std::fs::read(&path).expect("a database");

        let error = Store::open(folder.path()).await.expect_err("another schema");
        let text = error.to_string();
        let path_text = path.to_str().expect("UTF-8");
        for word in words.into_iter().chain([path_text]) {
            assert!(text.contains(word), "{text}");
        }
        assert_eq!(std::fs::read(&path).expect("a database"), before);
    }
}

#[tokio::test]
async fn a_second_coordinator_cannot_open_a_data_folder_in_use() {
    let bench = Bench::start().await;
    // Whatever is removed beside the database, only one coordinator may write to it.
    for file in std::fs::read_dir(bench.folder.path()).expect("a folder") {
        let file = file.expect("a file").path();
        if !file.display().to_string().contains(DATABASE_FILE) {
            std::fs::remove_file(file).expect("removed");
        }
    }
    let error = Store::open(bench.folder.path()).await.expect_err("in use");
    assert!(matches!(error, OpenError::InUse { .. }));
    let folder = bench.stop().await;
    Store::open(folder.path()).await.expect("free again");
}
