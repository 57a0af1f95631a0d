//! Coordinator process with TLS and tokens, and the operator commands against it.

use std::fs::{File, Permissions};
use std::net::{SocketAddr, TcpListener};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use serde_json::Value;
use transport::{Access, Role};

/// Time limit for the coordinator to start or to exit.
const PATIENCE: Duration = Duration::from_secs(120);

/// Running coordinator, killed on drop.
pub(crate) struct Server {
    folder: PathBuf,
    address: SocketAddr,
    child: Child,
    starts: u32,
}

/// Address and credentials for clients of the coordinator.
#[derive(Clone)]
pub(crate) struct CoordinatorAccess {
    /// `https://localhost:PORT`.
    pub(crate) url: String,
    pub(crate) worker: Access,
    pub(crate) operator: Access,
    pub(crate) viewer: Access,
    pub(crate) data: PathBuf,
}

impl Server {
    pub(crate) fn start(folder: &Path) -> Result<Server> {
        let lines: Vec<String> = ["worker", "operator", "viewer"]
            .map(|role| format!("{role} {role}-secret-of-the-soak"))
            .into();
        write_private(&folder.join("tokens"), &(lines.join("\n") + "\n"))?;
        for (role, line) in ["worker", "operator", "viewer"].iter().zip(&lines) {
            write_private(&folder.join(role), &format!("{line}\n"))?;
        }
        let mut params = CertificateParams::new(Vec::new())?;
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let issuer = CertifiedIssuer::self_signed(params, KeyPair::generate()?)?;
        std::fs::write(folder.join("ca.pem"), issuer.pem())?;
        let key = KeyPair::generate()?;
        let certificate = CertificateParams::new(["localhost".to_owned()])?;
        let certificate = certificate.signed_by(&key, &issuer)?;
        std::fs::write(folder.join("cert.pem"), certificate.pem())?;
        write_private(&folder.join("key.pem"), &key.serialize_pem())?;
        // The port is chosen here, since the coordinator must listen on the same port after each
        // restart.
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        let folder = folder.to_owned();
        let mut server = Server { child: spawn(&folder, address, 0)?, folder, address, starts: 1 };
        server.wait_until_listening()?;
        Ok(server)
    }

    pub(crate) fn access(&self) -> CoordinatorAccess {
        let access = |role: Role, file: &str| {
            let (ca, token) = (self.folder.join("ca.pem"), self.folder.join(file));
            let access = Access::from_files(Some(&ca), Some(&token), &[role]);
            access.expect("files that were just written")
        };
        CoordinatorAccess {
            url: self.url(),
            worker: access(Role::Worker, "worker"),
            operator: access(Role::Operator, "operator"),
            viewer: access(Role::Viewer, "viewer"),
            data: self.folder.join("data"),
        }
    }

    pub(crate) fn process_id(&self) -> u32 {
        self.child.id()
    }

    /// Returns the log file of the current process.
    pub(crate) fn log(&self) -> PathBuf {
        self.folder.join(format!("log.{}", self.starts - 1))
    }

    pub(crate) fn kill_and_start(&mut self) -> Result<()> {
        self.child.kill().context("kill the coordinator")?;
        self.child.wait()?;
        self.start_again()
    }

    pub(crate) fn back_up(&self) -> Result<PathBuf> {
        let backup = self.folder.join("backup.sqlite");
        let path = backup.display().to_string();
        self.command(&["backup", "--output", &path])?;
        Ok(backup)
    }

    /// Kills the coordinator, replaces the database by the backup and starts the coordinator again.
    pub(crate) fn restore(&mut self, backup: &Path) -> Result<()> {
        self.child.kill().context("kill the coordinator")?;
        self.child.wait()?;
        let database = self.folder.join("data/coordinator.sqlite");
        for suffix in ["", "-wal", "-shm"] {
            // The WAL files exist only because the process was killed.
            let _ = std::fs::remove_file(format!("{}{suffix}", database.display()));
        }
        std::fs::copy(backup, &database).context("restore the backup")?;
        self.start_again()
    }

    pub(crate) fn create(&self, spec: &Value, priority: i32) -> Result<String> {
        let file = self.folder.join("spec.json");
        std::fs::write(&file, spec.to_string())?;
        let (file, priority) = (file.display().to_string(), format!("--priority={priority}"));
        let printed = self.command(&["campaign", "create", "--spec", &file, &priority])?;
        Ok(printed.lines().next().unwrap_or_default().to_owned())
    }

    /// Returns name and rollout counts of each campaign that is neither finished nor stopped.
    pub(crate) fn unfinished(&self, names: &[&str]) -> Result<Vec<String>> {
        let mut unfinished = Vec::new();
        for name in names {
            let status = self.command(&["campaign", "status", name, "--json"])?;
            let status: Value = serde_json::from_str(&status)?;
            let status = &status["campaigns"][0];
            if status["is_finished"] != true && status["state"] != "stopped" {
                unfinished.push(format!("{name}: {}", status["rollouts"]));
            }
        }
        Ok(unfinished)
    }

    /// Sends SIGTERM and waits for the coordinator to exit.
    pub(crate) fn stop(&mut self) -> Result<()> {
        let id = self.child.id().to_string();
        Command::new("kill").args(["-TERM", &id]).status()?;
        let began = Instant::now();
        while self.child.try_wait()?.is_none() {
            ensure!(began.elapsed() < PATIENCE, "stop the coordinator: it still runs");
            std::thread::sleep(Duration::from_millis(100));
        }
        Ok(())
    }

    /// Runs `coordinator check` on the database and returns its output.
    pub(crate) fn check(&self) -> Result<String> {
        let data = self.folder.join("data");
        let output = Command::new(program()?).arg("check").arg(data).output()?;
        let printed = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        ensure!(output.status.success(), "verify the database: {printed}");
        Ok(printed)
    }

    fn url(&self) -> String {
        format!("https://localhost:{}", self.address.port())
    }

    fn start_again(&mut self) -> Result<()> {
        self.child = spawn(&self.folder, self.address, self.starts)?;
        self.starts += 1;
        self.wait_until_listening()
    }

    fn wait_until_listening(&mut self) -> Result<()> {
        let began = Instant::now();
        while std::net::TcpStream::connect(self.address).is_err() {
            let exit_status = self.child.try_wait()?;
            ensure!(exit_status.is_none(), "start the coordinator; see {}", self.log().display());
            ensure!(began.elapsed() < PATIENCE, "start the coordinator: it does not listen");
            std::thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }

    fn command(&self, arguments: &[&str]) -> Result<String> {
        let output = Command::new(program()?)
            .args(arguments)
            .args(["--connect", &self.url(), "--ca"])
            .arg(self.folder.join("ca.pem"))
            .arg("--token-file")
            .arg(self.folder.join("operator"))
            .output()?;
        let error_text = String::from_utf8_lossy(&output.stderr).into_owned();
        ensure!(output.status.success(), "run `coordinator {}`: {error_text}", arguments.join(" "));
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // The process may have exited already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn spawn(folder: &Path, address: SocketAddr, number: u32) -> Result<Child> {
    let log = File::create(folder.join(format!("log.{number}")))?;
    Command::new(program()?)
        .args(["serve", "--listen", &address.to_string(), "--data"])
        .arg(folder.join("data"))
        .arg("--token-file")
        .arg(folder.join("tokens"))
        .arg("--tls-cert")
        .arg(folder.join("cert.pem"))
        .arg("--tls-key")
        .arg(folder.join("key.pem"))
        .env_remove("RUST_LOG")
        .stdout(Stdio::null())
        .stderr(log)
        .spawn()
        .context("start the coordinator")
}

/// Returns the path of the coordinator program, one folder above the examples' in `target`.
fn program() -> Result<PathBuf> {
    let executable = std::env::current_exe()?;
    let folder =
        executable.parent().and_then(Path::parent).context("find this program's folder")?;
    let program = folder.join("coordinator");
    let remedy = "build it with `cargo build --package coordinator`, in the same profile";
    ensure!(program.is_file(), "find {}: {remedy}", program.display());
    Ok(program)
}

/// Writes a file that only its owner may read.
fn write_private(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text)?;
    Ok(std::fs::set_permissions(path, Permissions::from_mode(0o600))?)
}
