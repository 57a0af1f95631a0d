//! Three policies behind one gateway, each with a campaign of its own. One server is killed midway
//! and restarted: the other campaigns do not wait for it, the campaign of its policy resumes
//! automatically, and no attempt is charged.

use std::path::Path;
use std::process::Command;

use tests::programs::{Campaigns, Process, program};

/// Rollouts of each campaign: two configurations of one task, each under five single axes and under
/// all of them, and their two nominal rollouts.
const ROLLOUTS: usize = 14;

/// Starts a policy's server at an address: a gateway that serves one built-in policy.
fn server(name: &str, address: &str) -> Process {
    let route = format!("{name}=builtin:noop");
    let mut server = Command::new(program("policy-gateway"));
    Process::serve(server.args(["--listen", address, "--route", &route]))
}

fn address(server: &Process) -> &str {
    server.url.trim_start_matches("http://")
}

/// Starts a coordinator, and one gateway with a route for each server.
fn behind_one_gateway(data: &Path, servers: &[(&str, &Process)]) -> Campaigns {
    let mut gateway = Command::new(program("policy-gateway"));
    gateway.args(["--listen", "127.0.0.1:0"]);
    for (name, server) in servers {
        let route = format!("{name}=grpc://{}", address(server));
        gateway.args(["--route", &route]);
    }
    let mut campaigns = Campaigns::start(data);
    campaigns.gateway = Process::serve(&mut gateway);
    campaigns
}

#[test]
fn a_restarted_policy_delays_only_its_own_campaign() {
    let names = ["one", "two", "killed"];
    let [one, two, mut killed] = names.map(|name| server(name, "127.0.0.1:0"));
    let data = tempfile::tempdir().expect("a folder");
    let servers = [("one", &one), ("two", &two), ("killed", &killed)];
    let campaigns = behind_one_gateway(data.path(), &servers);
    // The campaign of the policy to be killed comes first, so that it is in progress by then.
    campaigns.create("killed", "killed", "libero_object/0", "0,1");
    let worker = campaigns.simulated_worker(2, &[]);
    campaigns.wait_for_commits("killed", Some(1));
    killed.signal("-KILL");
    let address = address(&killed).to_owned();
    campaigns.create("one", "one", "libero_object/0", "0,1");
    campaigns.create("two", "two", "libero_object/0", "0,1");
    campaigns.wait_for_commits("one", None);
    campaigns.wait_for_commits("two", None);
    let status = campaigns.succeed(&["campaign", "status", "killed"]);
    assert!(!status.contains("finished"), "finished without its policy: {status}");
    assert!(status.contains("killed"), "{status}");

    killed = server("killed", &address);
    campaigns.wait_for_commits("killed", None);
    for name in names {
        assert_eq!(campaigns.outcomes(name).len(), ROLLOUTS, "{name}");
        for row in campaigns.succeed(&["jobs", name]).lines() {
            assert!(!row.contains("charged") && !row.contains("quarantined"), "{row}");
        }
    }
    drop((worker, killed));
}
