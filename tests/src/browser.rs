//! Headless Chromium, driven over its DevTools protocol through a pair of pipes, without
//! a port or a driver program. For end-to-end tests of the live page.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Debian's name of the program.
pub const CHROMIUM: &str = "chromium";
/// Timeout of all waits, generous because the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(120);
const POLL_INTERVAL: Duration = Duration::from_millis(100);

pub struct Browser {
    child: Child,
    commands: ChildStdin,
    messages: Receiver<Value>,
    last_command: u64,
    session: String,
    console_errors: Vec<String>,
    requests: Vec<String>,
}

#[derive(Clone, Copy, Debug)]
pub struct Screen {
    /// Width of the window, CSS pixels.
    pub width: u32,
    /// Height of the window, CSS pixels.
    pub height: u32,
    /// True if the reader prefers a dark page.
    pub is_dark: bool,
}

/// Returns true if the browser is installed; otherwise prints that the test is skipped.
pub fn is_installed(test: &str) -> bool {
    let is_installed = Command::new(CHROMIUM).arg("--version").output().is_ok();
    if !is_installed {
        println!("skipped {test}: no {CHROMIUM} (Debian: `apt-get install {CHROMIUM}`)");
    }
    is_installed
}

impl Browser {
    /// Starts the browser with its profile in a folder.
    pub fn start(profile: &Path) -> Self {
        // The browser expects its pipes at file descriptors 3 and 4.
        let mut child = Command::new("sh")
            .args([
                "-c",
                r#"exec "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null 2>&1"#,
            ])
            .arg(CHROMIUM)
            .args(["--headless", "--remote-debugging-pipe"])
            // The sandbox and /dev/shm are unavailable to root in a container.
            .args(["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"])
            .args(["--no-first-run", "--disable-sync", "--disable-extensions"])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
            ])
            .args(["--hide-scrollbars", "--mute-audio"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the browser starts");
        let commands = child.stdin.take().expect("a pipe");
        let answers = child.stdout.take().expect("a pipe");
        let (sender, messages) = channel();
        thread::spawn(move || {
            for message in BufReader::new(answers).split(0) {
                let Ok(message) = message else { break };
                let message = serde_json::from_slice(&message).expect("the browser sends JSON");
                if sender.send(message).is_err() {
                    break;
                }
            }
        });
        let mut browser = Self {
            child,
            commands,
            messages,
            last_command: 0,
            session: String::new(),
            console_errors: Vec::new(),
            requests: Vec::new(),
        };
        browser.open_page();
        browser
    }

    /// Navigates to a URL and waits until the page is loaded.
    pub fn go(&mut self, url: &str) {
        let answer = self.command("Page.navigate", &json!({ "url": url }));
        assert_eq!(answer["errorText"], Value::Null, "{url}");
        self.wait_for("document.readyState === 'complete'");
    }

    /// Evaluates a JavaScript expression on the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let value = self.try_value(expression);
        value.unwrap_or_else(|error| panic!("{expression}: {error}"))
    }

    /// Evaluates an expression; panics if it throws, and fails if the page navigates meanwhile.
    fn try_value(&mut self, expression: &str) -> Result<Value, Value> {
        let parameters = json!({
            "expression": expression, "awaitPromise": true, "returnByValue": true,
        });
        let mut answer = self.try_command("Runtime.evaluate", &parameters)?;
        let thrown = &answer["exceptionDetails"];
        assert_eq!(thrown, &Value::Null, "{expression}: {thrown}");
        Ok(answer["result"]["value"].take())
    }

    /// Waits until an expression is true.
    pub fn wait_for(&mut self, expression: &str) {
        let start = Instant::now();
        // Evaluation fails while the browser navigates to another page.
        while self.try_value(&format!("Boolean({expression})")) != Ok(true.into()) {
            if start.elapsed() > PATIENCE {
                let page = self.value("document.body.innerText");
                panic!("timed out: {expression}\n{}", page.as_str().unwrap_or_default());
            }
            thread::sleep(POLL_INTERVAL);
        }
    }

    pub fn press(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            let event = json!({ "type": kind, "key": key, "code": key });
            self.command("Input.dispatchKeyEvent", &event);
        }
    }

    /// Clicks at the position of an element with a simulated mouse.
    pub fn click(&mut self, selector: &str) {
        let place = self.value(&format!(
            "(() => {{ const e = document.querySelector({selector:?}); \
             e.scrollIntoView({{ block: 'center' }}); const r = e.getBoundingClientRect(); \
             return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        ));
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({
                "type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1,
            });
            self.command("Input.dispatchMouseEvent", &event);
        }
    }

    pub fn set_screen(&mut self, screen: Screen) {
        let size = json!({
            "width": screen.width, "height": screen.height, "deviceScaleFactor": 1,
            "mobile": false,
        });
        self.command("Emulation.setDeviceMetricsOverride", &size);
        let scheme = if screen.is_dark { "dark" } else { "light" };
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        self.command("Emulation.setEmulatedMedia", &json!({ "features": features }));
    }

    /// Returns the errors logged to the console since the last call.
    pub fn console_errors(&mut self) -> Vec<String> {
        // Messages are ordered, so that a response comes after all earlier events.
        self.value("0");
        std::mem::take(&mut self.console_errors)
    }

    /// Returns every URL that pages have requested since the browser was started.
    pub fn requests(&mut self) -> &[String] {
        self.value("0");
        &self.requests
    }

    fn open_page(&mut self) {
        let target = self.command("Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = self.command("Target.attachToTarget", &attach);
        self.session = session["sessionId"].as_str().expect("a session").to_owned();
        for domain in ["Page", "Runtime", "Network", "Log"] {
            self.command(&format!("{domain}.enable"), &json!({}));
        }
    }

    /// Sends a command and waits for its response; records events that arrive meanwhile.
    fn command(&mut self, method: &str, parameters: &Value) -> Value {
        let answer = self.try_command(method, parameters);
        answer.unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_command(&mut self, method: &str, parameters: &Value) -> Result<Value, Value> {
        self.last_command += 1;
        let id = self.last_command;
        let mut command = json!({ "id": id, "method": method, "params": parameters });
        if !self.session.is_empty() {
            command["sessionId"] = self.session.clone().into();
        }
        let sent = self.commands.write_all(format!("{command}\0").as_bytes());
        sent.and_then(|()| self.commands.flush()).expect("a command is sent");
        loop {
            let mut message = match self.messages.recv_timeout(PATIENCE) {
                Ok(message) => message,
                Err(RecvTimeoutError::Timeout) => panic!("no answer to {method}"),
                Err(RecvTimeoutError::Disconnected) => panic!("the browser ended"),
            };
            if message["id"] == id {
                return match message["error"].take() {
                    Value::Null => Ok(message["result"].take()),
                    error => Err(error),
                };
            }
            self.record(&message);
        }
    }

    fn record(&mut self, message: &Value) {
        let params = &message["params"];
        match message["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => {
                self.console_errors.push(params["exceptionDetails"].to_string())
            }
            "Runtime.consoleAPICalled" if params["type"] == "error" => {
                self.console_errors.push(params["args"].to_string());
            }
            "Log.entryAdded" if params["entry"]["level"] == "error" => {
                self.console_errors.push(params["entry"].to_string());
            }
            "Network.requestWillBeSent" => {
                let url = params["request"]["url"].as_str().unwrap_or_default();
                self.requests.push(url.to_owned());
            }
            _ => {}
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
