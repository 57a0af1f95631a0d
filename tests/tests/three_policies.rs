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
    let names = ["steady", "calm", "mortal"];
    let [steady, calm, mut mortal] = names.map(|name| server(name, "127.0.0.1:0"));
    let data = tempfile::tempdir().expect("a folder");
    let servers = [("steady", &steady), ("calm", &calm), ("mortal", &mortal)];
    let campaigns = behind_one_gateway(data.path(), &servers);
    // The campaign of the policy to be killed comes first, so that it is in progress by then.
    campaigns.create("mortal", "mortal", "libero_object/0", "0,1");
    let worker = campaigns.simulated_worker(2, &[]);
    campaigns.wait_for_commits("mortal", Some(1));
    mortal.signal("-KILL");
    let address = address(&mortal).to_owned();
    campaigns.create("steady", "steady", "libero_object/0", "0,1");
    campaigns.create("calm", "calm", "libero_object/0", "0,1");
    campaigns.wait_for_commits("steady", None);
    campaigns.wait_for_commits("calm", None);
    let status = campaigns.succeed(&["campaign", "status", "mortal"]);
    assert!(
        !status.contains("finished"),
        "finished without its policy: {status}"
    );
    assert!(status.contains("mortal"), "{status}");

    mortal = server("mortal", &address);
    campaigns.wait_for_commits("mortal", None);
    for name in names {
        assert_eq!(campaigns.outcomes(name).len(), ROLLOUTS, "{name}");
        for row in campaigns.succeed(&["jobs", "list", name]).lines() {
            assert!(
                !row.contains("charged") && !row.contains("quarantined"),
                "{row}"
            );
        }
    }
    drop((worker, mortal));
}
