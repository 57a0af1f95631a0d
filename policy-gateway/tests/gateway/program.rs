//! The program itself: its one line of output, its exit codes, its signals.

use std::{
    io::{BufRead, BufReader},
    net::SocketAddr,
    process::{Child, Command, Stdio},
};

use crate::support::{client, describe};

fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_policy-gateway"));
    command
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn address(child: &mut Child) -> SocketAddr {
    let mut line = String::new();
    let stdout = child.stdout.as_mut().expect("stdout is piped");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    let address = line
        .trim_end()
        .strip_prefix("listening on ")
        .expect("the announced line");
    address.parse().expect("an address")
}

// Two threads: the client must see the connection close while the test waits
// for the program to end.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_program_names_its_port_serves_and_stops_on_sigterm() {
    let mut child = program(&["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"])
        .spawn()
        .expect("the program starts");
    let address = address(&mut child);
    assert_ne!(address.port(), 0);
    let described = client(address)
        .await
        .describe(describe("noop"))
        .await
        .expect("a description");
    assert_eq!(described.get_ref().name, "noop");

    let killed = Command::new("kill")
        .arg(child.id().to_string())
        .status()
        .expect("kill runs");
    assert!(killed.success());
    assert!(child.wait().expect("the program ends").success());
}

#[test]
fn usage_errors_exit_with_2_and_say_what_to_write() {
    let cases: [(&[&str], &str); 5] = [
        (&[], "--route"),
        (&["--route", "x"], "NAME=BACKEND"),
        (&["--route", "x=builtin:nope"], "noop and expert"),
        (
            &["--route", "x=builtin:noop", "--route", "x=builtin:expert"],
            "two routes named x",
        ),
        (
            &["--route", "x=builtin:noop", "--listen", "nowhere"],
            "--listen",
        ),
    ];
    for (arguments, expected) in cases {
        let output = program(arguments).output().expect("the program runs");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
        assert!(stderr.contains(expected), "{arguments:?}: {stderr}");
        assert!(output.stdout.is_empty());
    }
}

#[tokio::test]
async fn a_port_that_is_taken_exits_with_1_and_names_it() {
    let holder = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let taken = holder.local_addr().expect("a bound address").to_string();
    let output = program(&["--listen", &taken, "--route", "x=builtin:noop"])
        .output()
        .expect("the program runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(
        stderr.contains(&format!("failed to listen on {taken}")),
        "{stderr}"
    );
}
