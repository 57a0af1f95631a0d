//! Files that users provide, other than those of a scene. Checks that accepted data can be used,
//! that manifests and specifications survive a round trip, and that no error contains a token.

use std::io::{Cursor, Write};
use std::path::Path;

use benchmark::{CampaignSpec, Design, SuiteFile, manifest as manifests};
use policy_backends::recording::{self, Pair};
use policy_gateway::config as gateway;
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use transport::{Role, Tokens};
use worker::single::RecordedActions;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

const SEED_ROWS: usize = 20;
/// Extensions of files with recorded actions; an input's first byte selects one.
const ENDINGS: [&str; 3] = [".npz", ".npy", ".jsonl"];

/// Parses a manifest or a suite file, whose rows are a manifest.
pub(crate) fn manifest(input: &[u8]) -> bool {
    let rows = |text| match SuiteFile::from_json(text) {
        Ok(file) => Ok(file.rows()),
        Err(_) => manifests::parse(text),
    };
    let Some(Ok(rows)) = text(input).map(rows) else {
        return false;
    };
    let written = manifests::to_text(&rows);
    let parsed = manifests::parse(&written).expect("a written manifest");
    assert_eq!(parsed, rows, "{written}");
    true
}

pub(crate) fn campaign_spec(input: &[u8]) -> bool {
    let Some(Ok(spec)) = text(input).map(CampaignSpec::from_json) else {
        return false;
    };
    let written = serde_json::to_string(&spec).expect("JSON");
    let parsed = CampaignSpec::from_json(&written);
    assert_eq!(parsed.as_ref(), Ok(&spec), "{written}");
    true
}

/// Parses `rollouts.jsonl` of LIBERO-CTRL's released code or of an export.
pub(crate) fn result_rows(input: &[u8]) -> bool {
    imports(input, b"{}")
}

pub(crate) fn about_file(input: &[u8]) -> bool {
    imports(ROWS.as_bytes(), input)
}

pub(crate) fn recorded_actions(input: &[u8]) -> bool {
    let Some((kind, bytes)) = input.split_first() else {
        return false;
    };
    let ending = ENDINGS[usize::from(*kind) % ENDINGS.len()];
    with_file(ending, bytes, |path| {
        let actions = RecordedActions::read(path);
        actions.is_ok_and(|actions| {
            assert!(actions.count() > 0);
            true
        })
    })
}

pub(crate) fn gateway_file(input: &[u8]) -> bool {
    with_file(".toml", input, |path| {
        gateway::read(path).is_ok_and(|config| {
            assert!(!config.routes().is_empty());
            true
        })
    })
}

pub(crate) fn recording(input: &[u8]) -> bool {
    with_file(".recording", input, |path| {
        let Ok(mut reader) = recording::Reader::open(path) else {
            return false;
        };
        loop {
            match reader.pair() {
                Ok(Some(_)) => {}
                Ok(None) => return true,
                Err(_) => return false,
            }
        }
    })
}

pub(crate) fn token_file(input: &[u8]) -> bool {
    with_file("", input, |path| match Tokens::read(path) {
        Ok(tokens) => {
            assert!(tokens.for_role(&Role::ALL).is_some());
            assert_eq!(tokens.role_of(""), None);
            true
        }
        Err(error) => {
            // An error must not quote a word of the file that is long enough to be a token.
            let message = error.to_string().replace(&path.display().to_string(), "");
            let words = String::from_utf8_lossy(input);
            let secrets = words.split_whitespace();
            let mut secrets = secrets.filter(|word| word.len() >= transport::MIN_TOKEN_BYTES);
            assert!(!secrets.any(|secret| message.contains(secret)), "{message}");
            false
        }
    })
}

/// Two results: one in the format of LIBERO-CTRL's released code, one in the format of an export.
const ROWS: &str = concat!(
    r#"{"rollout_id": "goal/t0/camera/L2/c01", "success": true, "steps": 113, "axis": "camera", "#,
    r#""level": "L2", "suite": "libero_goal", "task_id": 0, "init_id": 6, "config": 1, "#,
    r#""policy": "p", "wall_s": 7.2, "ik_res_mm": 0.12}"#,
    "\n",
    r#"{"rollout_id":"goal/t0/nominal/i06","success":false,"init_id":6,"replicate":1}"#,
    "\n",
);

pub(crate) fn manifest_seeds() -> Vec<Vec<u8>> {
    let rows = Design::v0_1().expand().expect("v0.1");
    let suite_file = r#"{"name":"f","folder":"d","start":"reset","prompt":"bddl","seed":1,"waits":2,
        "budget":3,"trials":4,"suites":[{"name":"s","bddl":"*.bddl","states":"*.npz","budget":5,
        "tasks":["a",{"name":"b","prompt":"p","view":[1,2,3,4,5],"posture":[0,0,0,0,0,0,0],
        "noise":6}]}]}"#;
    vec![manifests::to_text(rows.iter().take(SEED_ROWS)).into(), suite_file.into()]
}

pub(crate) fn campaign_spec_seeds() -> Vec<Vec<u8>> {
    let short = r#"{"name":"c","policy":{"name":"p","endpoint":"http://127.0.0.1:1"},
        "tasks":["libero_object/0"],"axes":["camera"],"levels":["L1"],"configs":[0],
        "nominal":"eval"}"#;
    let spec = CampaignSpec::from_json(short).expect("a specification");
    // Has the fields that are always written: `realisation`, `replicates`, `record`.
    let written = serde_json::to_vec(&spec).expect("JSON");
    vec![short.into(), written]
}

pub(crate) fn result_rows_seeds() -> Vec<Vec<u8>> {
    vec![ROWS.into()]
}

pub(crate) fn about_file_seeds() -> Vec<Vec<u8>> {
    let about = r#"{"policy":"p","source":"s","realisation":"reference",
        "published_nominal":0.97,"nominal":{"successes":19,"n":20}}"#;
    vec![about.into()]
}

pub(crate) fn recorded_actions_seeds() -> Vec<Vec<u8>> {
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 7), }";
    let mut array = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    array.extend(format!("{header:<117}\n").as_bytes());
    array.extend([0; 2 * 7 * 8]);
    let lines = b"[0,0,0,0,0,0,-1]\n[0.5,0,1e-3,0,0,0,1]\n";
    let zipped = zipped("actions.npy", &array);
    let files = [&zipped[..], &array, lines];
    (0..).zip(files).map(|(kind, file)| [&[kind], file].concat()).collect()
}

pub(crate) fn gateway_file_seeds() -> Vec<Vec<u8>> {
    let file = "[policy.one]\nreplicas = [\"grpc://a:1\", \"grpc://b:1/pi05\"]\n\
        batching = \"deterministic\"\nanswer_within_secs = 0.5\n\
        [policy.two.suites]\nlibero_goal = [\"ws://a:2\"]\n\
        [policy.three]\nreplicas = [\"https://c:1\"]\nca = \"ca.pem\"\ntoken_file = \"t\"\n\
        [policy.four]\nreplicas = [\"builtin:expert\"]\n";
    vec![file.into()]
}

pub(crate) fn recording_seeds() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (described, reset) = (DescribeResponse::default(), ResetRequest::default());
    let writer = recording::Writer::begin(folder.path(), &described, &reset);
    let mut writer = writer.expect("written");
    let pair = Pair {
        query: InferRequest::default(),
        answer: InferResponse { actions: vec![0.5; 7], action_width: 7 },
    };
    writer.add(&pair).expect("written");
    let file = writer.finish().expect("written");
    vec![std::fs::read(file).expect("a recording")]
}

pub(crate) fn token_file_seeds() -> Vec<Vec<u8>> {
    let file = "# who\nworker 0123456789abcdef\n\nviewer fedcba9876543210\n";
    vec![file.into()]
}

/// Returns an uncompressed zip with one member, as NumPy and PyTorch write it.
pub(crate) fn zipped(name: &str, bytes: &[u8]) -> Vec<u8> {
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file(name, stored).expect("a name");
    zip.write_all(bytes).expect("written");
    zip.finish().expect("a zip").into_inner()
}

/// Imports a folder with these files. Accepted results must have records and be serialisable.
fn imports(rows: &[u8], about: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("rollouts.jsonl"), rows).expect("written");
    std::fs::write(folder.path().join("about.json"), about).expect("written");
    let Ok(subject) = report::import(folder.path()) else {
        return false;
    };
    assert!(!subject.records.is_empty());
    assert!(serde_json::to_vec(&subject).is_ok());
    true
}

fn with_file(ending: &str, bytes: &[u8], check: impl FnOnce(&Path) -> bool) -> bool {
    let file = tempfile::Builder::new().suffix(ending).tempfile();
    let mut file = file.expect("a temporary file");
    file.write_all(bytes).expect("written");
    check(file.path())
}

fn text(input: &[u8]) -> Option<&str> {
    std::str::from_utf8(input).ok()
}
