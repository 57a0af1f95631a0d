//! `coordinator slurm`: scripts with which Slurm runs workers and a policy server for a
//! coordinator, filled in from the templates in `deploy/`.

mod checked;
mod scripts;
mod template;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use terminal::number;
use transport::{Role, SecurityError, ServerArguments, Tokens, parse_endpoint};

use super::command::{CommandError, failure, print, print_line, usage};
use checked::{absolute_path, one_line, path_text, sbatch_options, slurm_word};
use scripts::{Script, submit, write};
use template::{Values, fill, for_shell};

// Names of asset packs, as in `scene`, on which the coordinator does not depend; any other value of
// `--assets` is a folder.
const PRIMITIVES: &str = "primitives";
const LIBERO: &str = "libero";

// File name and template of each script.
const COORDINATOR: (&str, &str) =
    ("coordinator.sh", include_str!("../../../deploy/slurm/coordinator.sh"));
const GATEWAY: (&str, &str) =
    ("gateway.sbatch", include_str!("../../../deploy/slurm/gateway.sbatch"));
const WORKERS: (&str, &str) =
    ("workers.sbatch", include_str!("../../../deploy/slurm/workers.sbatch"));

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator slurm --connect http://keeper:7411 --assets primitives
  coordinator slurm --connect http://keeper:7411 --assets /shared/libero-assets \\
      --workers 16 --slots 8 --time 4:00:00 --into /shared/cluster --submit
  coordinator slurm --connect http://keeper:7411 --assets /shared/libero-assets \\
      --policy pi05=grpc://127.0.0.1:5000 --gpus 1 --policy-server 'python serve.py'";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct SlurmArguments {
    /// URL under which the nodes reach the coordinator: the name of the machine on
    /// which coordinator.sh will run, and a port.
    #[arg(long, value_name = "URL", env = "COORDINATOR_URL")]
    connect: String,
    /// Folder to write the scripts into; the jobs run and log there, so all nodes
    /// must share it. If omitted, the scripts are only shown.
    #[arg(long, value_name = "DIR")]
    into: Option<PathBuf>,
    /// Submit the written scripts.
    #[arg(long, requires = "into")]
    submit: bool,
    /// Folder of the programs, on all nodes. [default: this program's]
    #[arg(long, hide_short_help = true, value_name = "DIR")]
    programs: Option<PathBuf>,
    /// Folder of the coordinator's database and artifacts, on a disk of its machine.
    #[arg(long, value_name = "DIR", default_value = "campaigns")]
    data: PathBuf,
    /// Partition of the jobs. [default: the cluster's]
    #[arg(long, value_name = "NAME")]
    partition: Option<String>,
    /// Time limit of a job, as Slurm writes it: 4:00:00. Jobs that reach it are queued
    /// again. [default: the partition's]
    #[arg(long, value_name = "TIME")]
    time: Option<String>,
    /// Number of seconds before its time limit at which a job is signalled to end; Slurm may send
    /// the signal up to a minute earlier.
    #[arg(long, hide_short_help = true, value_name = "SECS", default_value_t = 60,
        value_parser = number(1..=65_535_u32, "seconds"))]
    ahead_secs: u32,
    #[command(flatten)]
    workers: WorkerArguments,
    #[command(flatten)]
    gateway: GatewayArguments,
    /// Certificate authority of the servers, PEM, for https:// addresses.
    #[arg(long, value_name = "FILE", env = "ROLLOUT_CA")]
    ca: Option<PathBuf>,
    #[command(flatten)]
    security: ServerArguments,
    /// Token file with a worker's line only, for the workers' jobs; needed if --token-file has
    /// lines of other roles.
    #[arg(long, value_name = "FILE", requires = "token_file")]
    worker_token_file: Option<PathBuf>,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Workers")]
struct WorkerArguments {
    /// Models of objects and rooms: `libero` (fetched into the cache folder of the
    /// workers' user at first use), `primitives`, or the path of a LIBERO assets folder
    /// that all nodes share.
    #[arg(long, value_name = "PACK_OR_PATH", default_value = LIBERO)]
    assets: String,
    /// Number of workers, one task of the array each.
    #[arg(long, value_name = "N", default_value_t = 4,
        value_parser = number(1..=100_000_u32, "workers"))]
    workers: u32,
    /// Slots of a worker, with one core each.
    #[arg(long, value_name = "N", default_value_t = 4,
        value_parser = number(1..=1_024_u32, "slots"))]
    slots: u32,
    /// Seconds that a worker has to finish its rollouts after the signal to end. It then gives the
    /// unfinished rollouts back, which takes up to ten seconds more. The sum of the two times must
    /// fit into Slurm's KillWait.
    #[arg(long, hide_short_help = true, value_name = "SECS", default_value_t = 15,
        value_parser = number(0..=86_400_u32, "seconds"))]
    drain_secs: u32,
    /// Seconds without work after which a worker ends.
    #[arg(long, hide_short_help = true, value_name = "SECS", default_value_t = 600,
        value_parser = number(1..=604_800_u32, "seconds"))]
    idle_secs: u32,
    /// Further sbatch option for the workers, such as `--worker-sbatch=--account=lab`, or
    /// `--worker-sbatch=--mem-per-cpu=4G` instead of 2G for a slot.
    /// (repeatable)
    #[arg(long, hide_short_help = true, value_name = "OPTION", allow_hyphen_values = true)]
    worker_sbatch: Vec<String>,
}

#[derive(Args, Debug)]
#[command(next_help_heading = "Gateway and policy server")]
struct GatewayArguments {
    /// Route of the gateway: the policy's name and its server, as for `policy-gateway --route`,
    /// such as `NAME=grpc://127.0.0.1:5000` for a server on that port of the same node. If omitted,
    /// no gateway is run.
    #[arg(long, value_name = "NAME=BACKEND")]
    policy: Option<String>,
    /// Command line that starts the policy's server on the gateway's node.
    #[arg(long, value_name = "COMMAND", requires = "policy")]
    policy_server: Option<String>,
    /// GPUs of the policy server, in sbatch's syntax: 1, or a100:2.
    #[arg(long, value_name = "GPUS", requires = "policy")]
    gpus: Option<String>,
    /// Partition of the gateway. [default: --partition]
    #[arg(long, hide_short_help = true, value_name = "NAME", requires = "policy")]
    gateway_partition: Option<String>,
    /// Port of the gateway; if it is taken on the node, the next free port is used.
    #[arg(long, hide_short_help = true, value_name = "PORT", default_value_t = 7412,
        value_parser = number(1..=65_535_u16, ""))]
    gateway_port: u16,
    /// Further sbatch option for the gateway, such as `--gateway-sbatch=--mem=64G`. (repeatable)
    #[arg(long, hide_short_help = true, value_name = "OPTION", allow_hyphen_values = true)]
    #[arg(requires = "policy")]
    gateway_sbatch: Vec<String>,
}

/// Prints the scripts or, with `--into`, writes them and with `--submit` submits them.
pub(super) fn slurm(arguments: &SlurmArguments) -> Result<(), CommandError> {
    let scripts = arguments.scripts()?;
    if arguments.into.is_none() {
        for script in &scripts {
            print(&format!("==> {} <==\n{}\n", script.path.display(), script.text))?;
        }
        return Ok(print_line(
            "Nothing was written. --into DIR writes the scripts, --submit submits them.",
        )?);
    }
    write(&scripts)?;
    for script in &scripts {
        print_line(&format!("wrote {}", script.path.display()))?;
    }
    match arguments.submit {
        true => submit(&scripts)?,
        false => print_line("To submit the scripts, repeat the command with --submit.")?,
    }
    let [coordinator, ..] = scripts.as_slice() else {
        unreachable!("there are always at least two scripts");
    };
    let path = for_shell(&coordinator.path.display().to_string());
    Ok(print_line(&format!(
        "The coordinator is run by `bash {path}` on its machine; workers wait for it."
    ))?)
}

impl SlurmArguments {
    /// Returns the coordinator's script, then the scripts of the jobs in order of submission.
    fn scripts(&self) -> Result<Vec<Script>, CommandError> {
        let values = self.values()?;
        let folder = absolute_path(self.into.as_deref().unwrap_or(Path::new(".")))?;
        let mut templates = vec![COORDINATOR];
        templates.extend(self.gateway.policy.is_some().then_some(GATEWAY));
        templates.push(WORKERS);
        let script = |(name, template): (&str, &str)| Script {
            path: folder.join(name),
            text: fill(template, &values),
        };
        Ok(templates.into_iter().map(script).collect())
    }

    fn values(&self) -> Result<Values, CommandError> {
        let (workers, gateway) = (&self.workers, &self.gateway);
        let mut values = Values::default();
        self.set_servers(&mut values)?;
        let folder = absolute_path(self.into.as_deref().unwrap_or(Path::new(".")))?;
        values.set("folder", one_line("--into", path_text(&folder)?)?);
        values.set("data", one_line("--data", path_text(&absolute_path(&self.data)?)?)?);
        let partition = slurm_word("--partition", self.partition.as_ref())?;
        let partition_of_gateway =
            slurm_word("--gateway-partition", gateway.gateway_partition.as_ref())?;
        values.set_all("gateway_partition", partition_of_gateway.or_else(|| partition.clone()));
        values.set_all("partition", partition);
        values.set_all("time", slurm_word("--time", self.time.as_ref())?);
        values.set("ahead_secs", self.ahead_secs);

        let assets = match workers.assets.as_str() {
            name @ (LIBERO | PRIMITIVES) => name.to_owned(),
            path => path_text(&absolute_path(Path::new(path))?)?,
        };
        values.set("assets", one_line("--assets", assets)?);
        values.set("workers", workers.workers);
        values.set("slots", workers.slots);
        values.set("drain_secs", workers.drain_secs);
        values.set("idle_secs", workers.idle_secs);
        let further_options = sbatch_options("--worker-sbatch", &workers.worker_sbatch)?;
        values.set_all("worker_options", further_options);

        values.set_all("route", gateway.route()?);
        let server = gateway.policy_server.clone();
        let server = server.map(|command| one_line("--policy-server", command)).transpose()?;
        values.set_all("policy_server", server);
        values.set_all("gpus", slurm_word("--gpus", gateway.gpus.as_ref())?);
        let further_options = sbatch_options("--gateway-sbatch", &gateway.gateway_sbatch)?;
        values.set_all("gateway_options", further_options);

        let mut programs = vec![("worker", "worker"), ("coordinator", "coordinator")];
        programs.extend(gateway.policy.is_some().then_some(("gateway", "policy-gateway")));
        let folder = self.programs_folder()?;
        for (name, program) in programs {
            let path = folder.join(program);
            if !path.is_file() {
                return Err(usage(anyhow!(
                    "find {}: name the folder of the programs with --programs",
                    path.display()
                )));
            }
            values.set(name, one_line("--programs", path_text(&path)?)?);
        }
        Ok(values)
    }

    fn set_servers(&self, values: &mut Values) -> Result<(), CommandError> {
        let endpoint = parse_endpoint(&self.connect).context("use --connect");
        let endpoint = endpoint.map_err(usage)?;
        let host = endpoint.uri().host().unwrap_or_default();
        let Some(port) = endpoint.uri().port_u16() else {
            return Err(usage(anyhow!(
                "use --connect {}: write the port, too, such as {}:7411",
                self.connect,
                self.connect.trim_end_matches('/')
            )));
        };
        if host == "localhost" || host.starts_with("127.") || host == "[::1]" {
            return Err(usage(anyhow!(
                "use --connect {}: no other machine can reach this address; write the name of the \
                 machine on which coordinator.sh will run",
                self.connect
            )));
        }
        let all_interfaces = SocketAddr::from(([0, 0, 0, 0], port));
        let security = self.security.security(all_interfaces);
        let security = security.map_err(|error| match error {
            SecurityError::Unguarded { .. } => usage(error),
            error => failure(error),
        })?;
        let scheme = endpoint.uri().scheme_str().unwrap_or_default();
        let expected = if security.is_encrypted() { "https" } else { "http" };
        if scheme != expected {
            return Err(usage(anyhow!(
                "use --connect {}: write a URL that begins with https:// if --tls-cert and \
                 --tls-key are given, and with http:// if not",
                self.connect
            )));
        }
        values.set("connect", &self.connect);
        values.set("scheme", scheme);
        values.set("coordinator_port", port);
        values.set("gateway_port", self.gateway.gateway_port);
        let mut security_flags = Vec::new();
        for (flag, file) in
            [("--tls-cert", &self.security.tls_cert), ("--tls-key", &self.security.tls_key)]
        {
            if let Some(file) = file {
                let path = path_text(&absolute_path(file)?)?;
                security_flags.extend([flag.to_owned(), one_line(flag, path)?]);
            }
        }
        security_flags.extend(self.security.insecure.then(|| "--insecure".to_owned()));
        values.set_all("guard", security_flags);
        let worker_tokens = self.worker_token_file()?;
        for (name, flag, file) in [
            ("token_file", "--token-file", &self.security.token_file),
            ("worker_token_file", "--worker-token-file", &worker_tokens),
            ("ca", "--ca", &self.ca),
        ] {
            let path = file.as_deref().map(absolute_path).transpose()?;
            let path = path.map(|path| path_text(&path)).transpose()?;
            values.set_all(name, path.map(|path| one_line(flag, path)).transpose()?);
        }
        Ok(())
    }

    /// Returns the token file of the worker jobs. Anyone with access to a job can read the file, so
    /// it must hold a worker token only; an operator token could delete campaigns.
    fn worker_token_file(&self) -> Result<Option<PathBuf>, CommandError> {
        let worker_file = self.worker_token_file.as_deref();
        let Some(file) = worker_file.or(self.security.token_file.as_deref()) else {
            return Ok(None);
        };
        let tokens = Tokens::read(file).map_err(failure)?;
        if tokens.has(Role::Operator) || tokens.has(Role::Viewer) || !tokens.has(Role::Worker) {
            return Err(usage(anyhow!(
                "give {} to the workers' jobs: the jobs must not have tokens of other roles; \
                 write the worker's line into a separate file (`grep ^worker TOKENS > \
                 worker-token`) and pass it with --worker-token-file",
                file.display()
            )));
        }
        Ok(Some(file.to_owned()))
    }

    fn programs_folder(&self) -> Result<PathBuf, CommandError> {
        if let Some(folder) = &self.programs {
            return absolute_path(folder);
        }
        let executable = std::env::current_exe().context("find this program's own file")?;
        Ok(executable.parent().unwrap_or(Path::new("/")).to_owned())
    }
}

impl GatewayArguments {
    fn route(&self) -> Result<Option<String>, CommandError> {
        let Some(route) = &self.policy else {
            return Ok(None);
        };
        let is_complete = |(name, backend): (&str, &str)| !name.is_empty() && !backend.is_empty();
        if !route.split_once('=').is_some_and(is_complete) {
            return Err(usage(anyhow!(
                "use --policy {route}: write NAME=BACKEND, such as \
                 openvla=grpc://127.0.0.1:5000"
            )));
        }
        one_line("--policy", route.clone()).map(Some)
    }
}
