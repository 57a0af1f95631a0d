//! Commands with wrong input: exit code, message, and nothing written.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use crate::{PROGRAMS, UNUSED_ADDRESS, compare, session};

/// Files that the commands below read.
const FILES: [(&str, &str); 11] = [
    ("bad-line.jsonl", "{\"rollout_id\": \"goal/t0/camera/L2/c01\", \"success\": true}\n{\n"),
    ("row.jsonl", "{\"rollout_id\": \"goal/t0/camera/L2/c01\", \"success\": true}\n"),
    ("empty.jsonl", ""),
    ("no-row.jsonl", "{}\n"),
    ("no-json.jsonl", "[[\n"),
    ("spec.json", "{\"name\": \"first\", \"task\": []}"),
    ("suite.json", "{\"name\": \"mine\", \"tasks\": 3}"),
    ("no.toml", "policy = ["),
    ("key.toml", "[policy.x]\nreplica = [\"grpc://127.0.0.1:9\"]\n"),
    ("type.toml", "[policy.x]\nreplicas = 3\n"),
    ("readable-token", "secret\n"),
];

/// Start of the commands that lack a design.
const CREATE: &str = "coordinator campaign create --name c --policy p --endpoint {url} --tasks";

/// Commands by case. `{url}` is an address at which no server listens, `{create}` is [`CREATE`], and
/// `~` a blank within a value.
const CASES: [(&str, &[&str]); 16] = [
    (
        "coordinator-values",
        &[
            "coordinator serve --data d --lease-secs 0",
            "coordinator serve --data d --min-free-mib x",
            "coordinator serve --data d --listen there",
            "coordinator jobs c --limit 0",
            "coordinator campaign status --retry-secs=-1",
            "coordinator campaign status --connect 127.0.0.1:9",
            "coordinator campaign status --connect ftp://h:1",
            "coordinator export c --format xml",
            "coordinator export c --format csv",
            "coordinator jobs c a b",
            "coordinator compare one",
            "coordinator report",
            "coordinator manifest --version v0.1 --spec x",
        ],
    ),
    (
        "coordinator-designs",
        &[
            "coordinator campaign create --name a/b --policy p --endpoint {url} --tasks libero_goal/0",
            "coordinator campaign create --name c --policy p --endpoint {url}",
            "coordinator campaign create --name c --policy p --endpoint nowhere --tasks libero_object/0",
            "coordinator campaign create --name c --policy p --endpoint ws://h:1 --tasks libero_object/0",
            "{create} libero_object/99",
            "{create} libero_object/8-11",
            "{create} libero_none",
            "{create} libero_goal/0 --axes wind",
            "{create} libero_goal/0 --levels L9",
            "{create} libero_goal/0 --levels r0",
            "{create} libero_goal/0 --configs 5-1",
            "{create} libero_goal/0 --configs 998-1000",
            "{create} libero_goal/0 --realisation other",
            "{create} libero_goal/0 --execution dawdle:3",
            "{create} libero_goal/0 --execution dawdle:@f.json",
            "{create} libero_goal/0 --execution overlap:201",
            "{create} libero_goal/0 --nominal some",
            "{create} libero_goal/0 --replicates 0",
            "coordinator campaign create --spec spec.json",
            "coordinator campaign create --spec missing.json",
            "coordinator campaign create --name c --policy p --endpoint {url} --suite-file suite.json",
        ],
    ),
    (
        "coordinator-sets",
        &[
            "{create} libero_goal/0 --subsets camera",
            "{create} libero_goal/0 --subsets camera+lighting+robot+sensor+actuation",
            "{create} libero_goal/0 --axes camera,robot,sensor --subsets camera+lighting",
            "{create} libero_goal/0 --subsets camera+camera",
            "{create} libero_goal/0 --subsets camera+robto",
            "{create} libero_goal --stop soon",
            "{create} libero_goal --stop difference~excludes~0",
            "{create} libero_goal --stop I~excludes~0 --axes camera",
            "{create} libero_goal --stop I~excludes~0 --replicates 2",
            "{create} libero_goal --stop-seed 7",
            "{create} libero_goal --placebo-configs 0",
            "{create} libero_goal --levels L0,L1 --placebo-configs 77",
        ],
    ),
    (
        "coordinator-slurm",
        &[
            "coordinator slurm --connect http://login1:7411",
            "coordinator slurm --connect http://login1 --insecure",
            "coordinator slurm --connect https://login1:1 --insecure",
            "coordinator slurm --connect http://127.0.0.1:7411 --insecure",
            "coordinator slurm --connect http://login1:7411 --insecure --partition a~b",
            "coordinator slurm --connect http://login1:7411 --insecure --gpus 1",
            "coordinator slurm --connect http://login1:7411 --insecure --policy mine",
            "coordinator slurm --connect http://login1:7411 --insecure --worker-sbatch avx2",
            "coordinator slurm --connect http://login1:7411 --insecure --submit",
        ],
    ),
    (
        "coordinator-files",
        &[
            "coordinator check missing",
            "coordinator check empty.jsonl",
            "coordinator manifest missing.jsonl",
            "coordinator manifest empty.jsonl",
            "coordinator manifest no-row.jsonl",
            "coordinator manifest no-json.jsonl",
            "coordinator manifest --version v9",
            "coordinator manifest --version v0.1 --output missing/manifest.jsonl",
            "coordinator serve --data spec.json/data --listen 127.0.0.1:0",
            "coordinator report ./missing",
            "coordinator report ./no-row.jsonl",
            "coordinator report ./bad-line.jsonl",
            "coordinator report ./row.jsonl --table table.xlsx",
            "coordinator report ./row.jsonl --published other=97.1",
            "coordinator report ./row.jsonl --published p=971",
            "coordinator report ./row.jsonl --published p=0.971",
            "coordinator campaign import missing.tar --connect {url} --retry-secs 0",
        ],
    ),
    (
        "coordinator-security",
        &[
            "coordinator serve --data d --listen 0.0.0.0:0",
            "coordinator serve --data d --token-file missing",
            "coordinator serve --data d --token-file readable-token",
            "coordinator serve --data d --tls-cert missing.pem --tls-key missing.pem",
            "coordinator serve --data d --tls-cert missing.pem",
            "coordinator campaign status --connect {url} --retry-secs 0 --token-file readable-token",
            "coordinator campaign status --connect {url} --retry-secs 0 --ca missing.pem",
        ],
    ),
    (
        "coordinator-unreachable",
        &[
            "coordinator campaign status --connect {url} --retry-secs 0",
            "coordinator campaign status --connect {url} --retry-secs 1",
        ],
    ),
    (
        "worker-values",
        &[
            "worker --slots 0",
            "worker --connect 127.0.0.1:9 --assets primitives",
            "worker preview --task 10",
            "worker preview --config 10",
            "worker rollout --id nonsense",
            "worker rollout --id object/t0/nominal/i99",
            "worker rollout --id spatial/t0/camra/L2/c00 --endpoint {url} --output out",
            "worker --connect {url} --renderer gl:card",
            "worker --renderer paint",
            "worker --look old",
        ],
    ),
    (
        "worker-files",
        &[
            "worker --connect {url} --assets missing",
            "worker --connect {url} --assets primitives --sources missing",
            "worker rollout --id object/t0/nominal/i00 --endpoint {url} --assets missing --output out",
        ],
    ),
    (
        "gateway-values",
        &[
            "policy-gateway --listen localhost",
            "policy-gateway --route nonsense",
            "policy-gateway --route a=builtin:none",
            "policy-gateway --route a=ftp://h:1",
            "policy-gateway --route a=builtin:noop --route a=builtin:expert",
            "policy-gateway --route a=grpc://h",
            "policy-gateway --listen 0.0.0.0:0 --route expert=builtin:expert",
            "policy-gateway record --max-mib 0",
            "policy-gateway check nowhere",
        ],
    ),
    (
        "gateway-files",
        &[
            "policy-gateway --config missing.toml",
            "policy-gateway --config no.toml",
            "policy-gateway --config key.toml",
            "policy-gateway --config type.toml",
            "policy-gateway --route p=replay:missing",
        ],
    ),
    (
        "gateway-unreachable",
        &[
            "policy-gateway compare grpc://127.0.0.1:9 grpc://127.0.0.1:9",
            "policy-gateway check grpc://127.0.0.1:9",
        ],
    ),
    (
        "variables",
        &[
            "ROLLOUT_LISTEN=here coordinator serve --data d",
            "ROLLOUT_INSECURE=perhaps coordinator serve --data d",
            "ROLLOUT_LISTEN=127.0.0.1:0 coordinator serve --data d --listen there",
            "ROLLOUT_SLOTS=many worker --connect http://h:1",
            "ROLLOUT_ASSETS=missing COORDINATOR_URL=http://127.0.0.1:9 ROLLOUT_SLOTS=2 worker",
            "ROLLOUT_ROUTE=nonsense policy-gateway --listen 127.0.0.1:0",
        ],
    ),
    ("coordinator-usage", &["coordinator", "coordinator serve", "coordinator --nonsense"]),
    ("worker-usage", &["worker", "worker nonsense"]),
    ("gateway-usage", &["policy-gateway"]),
];

fn files(folder: &Path) -> Vec<std::ffi::OsString> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> = entries.map(|entry| entry.expect("an entry").file_name()).collect();
    names.sort();
    names
}

#[test]
fn every_refusal_has_the_reviewed_words_and_writes_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in FILES {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        std::fs::set_permissions(&path, Permissions::from_mode(0o644)).expect("readable");
    }
    let before = files(folder.path());
    for (name, lines) in CASES {
        let mut sessions = Vec::new();
        for line in lines {
            let line = line.replace("{create}", CREATE);
            let line = line.replace("{url}", &format!("http://{UNUSED_ADDRESS}"));
            let mut words: Vec<&str> = line.split(' ').collect();
            let program = words.iter().position(|word| PROGRAMS.contains(word));
            let after = words.split_off(program.expect("a program"));
            let variables = words.iter().map(|word| word.split_once('=').expect("a variable"));
            let variables: Vec<_> = variables.collect();
            let arguments: Vec<String> =
                after[1..].iter().map(|word| word.replace('~', " ")).collect();
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            let text = session(after[0], &arguments, &variables, folder.path());
            assert!(text.contains("[exit code "), "it succeeds: {text}");
            assert_eq!(files(folder.path()), before, "written by {line}");
            sessions.push(text);
        }
        compare(&format!("error-{name}"), &sessions.join("\n"));
    }
}

/// Commands that lack a server's options ignore their variables, which a systemd unit may set.
#[test]
fn other_commands_ignore_the_variables_of_servers() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let variables = ["LISTEN", "SLOTS", "ROUTE", "RENDERER", "INSECURE"];
    let variables = variables.map(|name| (format!("ROLLOUT_{name}"), "nonsense"));
    let variables = variables.each_ref().map(|(name, value)| (name.as_str(), *value));
    for name in PROGRAMS {
        let text = session(name, &["manual", "share"], &variables, folder.path());
        assert!(!text.contains("[exit code"), "{text}");
    }
}
