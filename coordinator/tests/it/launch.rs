//! Scripts that `coordinator slurm` shows and writes, and arguments that it refuses. The
//! package `tests` runs the scripts on a real cluster.

use std::path::Path;
use std::process::{Command, Output};

use crate::assertions::assert_contains;
use crate::authority::write_private;
use crate::process::{coordinator, fail, succeed, text};

const SCRIPTS: [&str; 3] = ["coordinator.sh", "gateway.sbatch", "workers.sbatch"];

fn programs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for name in ["coordinator", "worker", "policy-gateway"] {
        std::fs::write(folder.path().join(name), "").expect("a file");
    }
    folder
}

fn launch(programs: &Path, arguments: &[&str]) -> Output {
    let programs = programs.to_str().expect("UTF-8");
    let common = ["slurm", "--assets", "primitives", "--programs", programs];
    coordinator(&[&common, arguments].concat())
}

/// Flags for a coordinator without TLS and tokens.
const INSECURE: [&str; 3] = ["--connect", "http://login1:7411", "--insecure"];

#[test]
fn scripts_are_shown_and_written_only_with_into() {
    let programs = programs();
    let scripts = &succeed(launch(programs.path(), &INSECURE));
    assert_contains(
        scripts,
        &[
            "serve --data",
            "--listen 0.0.0.0:7411 --insecure",
            "#SBATCH --array=1-4\n",
            "#SBATCH --signal=B:USR1@60\n",
            "COORDINATOR_URL=http://login1:7411\n",
            "Nothing was written",
        ],
    );
    // A flag that is not given adds no line, and without a policy there is no gateway.
    for words in ["{{", "--partition", "--time", "ROLLOUT_TOKEN_FILE", "gateway"] {
        assert!(!scripts.contains(words), "{words:?} in {scripts}");
    }
}

#[test]
fn written_scripts_are_valid_bash_for_any_values() {
    let (programs, folder) = (programs(), tempfile::tempdir().expect("a folder"));
    let into = folder.path().join("a \"lab's\" $(cluster) #1");
    let into = into.to_str().expect("UTF-8");
    let server = "serve 'a b' && echo \"$HOME\"; # done";
    #[rustfmt::skip]
    let more = [
        "--into", into, "--partition", "low,high", "--time", "4:00:00",
        "--workers", "7", "--slots", "2", "--policy", "mine=grpc://127.0.0.1:5000",
        "--policy-server", server, "--gpus", "a100:1", "--gateway-partition", "gpu",
        "--worker-sbatch=--constraint=avx2&ib", "--worker-sbatch=--exclude=n[1-3]",
    ];
    let arguments = [&INSECURE[..], &more].concat();
    // The second run finds the scripts with the same content, which is no error.
    for _ in 0..2 {
        let output = launch(programs.path(), &arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }
    let read = |name: &str| std::fs::read_to_string(Path::new(into).join(name)).expect(name);
    for name in SCRIPTS {
        let path = Path::new(into).join(name);
        let check = Command::new("bash").arg("-n").arg(path).output();
        let check = check.expect("bash runs");
        assert!(check.status.success(), "{name}: {}", text(&check.stderr));
    }
    let gateway = read("gateway.sbatch");
    for words in [
        "#SBATCH --gpus=a100:1\n",
        "#SBATCH --partition=gpu\n",
        "bash -c 'serve '\\''a b'\\'' && echo \"$HOME\"; # done' &\n",
    ] {
        assert!(gateway.contains(words), "no {words:?} in {gateway}");
    }
    let workers = read("workers.sbatch");
    assert_contains(
        &workers,
        &[
            "#SBATCH --array=1-7\n",
            "#SBATCH --partition=low,high\n",
            "#SBATCH \"--constraint=avx2&ib\"\n#SBATCH \"--exclude=n[1-3]\"\n",
            "a \\\"lab's\\\" $(cluster) #1\"\n",
        ],
    );

    // An edited script is never overwritten.
    let edited = Path::new(into).join("workers.sbatch");
    std::fs::write(&edited, "mine").expect("edited");
    let message = &fail(launch(programs.path(), &arguments), 1);
    assert!(message.contains("workers.sbatch: the file exists with other content"), "{message}");
    assert_eq!(read("workers.sbatch"), "mine");
}

#[test]
fn tokens_are_named_by_their_file_and_never_written_out() {
    let (programs, folder) = (programs(), tempfile::tempdir().expect("a folder"));
    let file = |name: &str, content: &str| {
        let path = folder.path().join(name);
        write_private(&path, content);
        path.to_str().expect("UTF-8").to_owned()
    };
    let secret = "0123456789abcdef0123456789abcdef";
    let tokens = file("tokens", &format!("worker {secret}\noperator {secret}0\n"));
    let pem = file("cert.pem", "");
    #[rustfmt::skip]
    let guarded = [
        "--connect", "https://login1:7411", "--token-file", &tokens, "--tls-cert", &pem,
        "--tls-key", &pem, "--ca", &pem, "--policy", "mine=builtin:student",
    ];
    // Anyone who gains access to a worker's job must not find an operator's token there.
    let wrong: [&[&str]; 2] = [&[], &["--worker-token-file", &tokens]];
    for more in wrong {
        let message = &fail(launch(programs.path(), &[&guarded[..], more].concat()), 2);
        assert!(message.contains("--worker-token-file"), "{message}");
    }
    let worker_token = file("worker-token", &format!("worker {secret}\n"));
    let more = ["--worker-token-file", &worker_token];
    let scripts = &succeed(launch(programs.path(), &[&guarded[..], &more].concat()));
    let (servers, workers) = scripts.split_once("workers.sbatch").expect("the workers' script");
    let named = |file: &str| format!("ROLLOUT_TOKEN_FILE={file}\n");
    assert!(servers.contains(&named(&tokens)), "{scripts}");
    assert!(workers.contains(&named(&worker_token)), "{scripts}");
    assert!(!workers.contains(&named(&tokens)), "{scripts}");
    assert_contains(
        scripts,
        &[&format!("ROLLOUT_CA={pem}\n"), &format!("--tls-cert {pem} --tls-key {pem}")],
    );
    assert!(!scripts.contains(secret) && !scripts.contains("--insecure"), "{scripts}");
}

#[test]
fn wrong_flags_are_refused_with_the_remedy() {
    let programs = programs();
    let refused = |arguments: &[&str], words: &str| {
        let output = launch(programs.path(), arguments);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(words), "{arguments:?}: {message}");
        assert!(output.stdout.is_empty());
    };
    let newline = ["--policy", "a=b", "--policy-server", "a\nb"];
    refused(&[&INSECURE[..], &newline].concat(), "on one line");
    refused(&[&INSECURE[..], &["--programs", "/nowhere"]].concat(), "--programs");
}
