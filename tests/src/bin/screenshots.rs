//! Takes the documentation's screenshots of the live page with a real coordinator
//! and a real browser: one campaign repeats published outcomes through a simulated
//! slot, a small one is simulated and recorded on video.

#![forbid(unsafe_code)]

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use tests::browser::{Browser, Screen};
use tests::programs::{Campaigns, Process};

/// Name of the campaign that repeats published outcomes.
const REPEATED: &str = "openvla-oft-repeated";
/// Number of its results when its screenshots are taken.
const REPEATED_RESULTS: usize = 4_500;
/// Name of the campaign that is simulated and recorded on video.
const FILMED: &str = "first-look";
/// Largest allowed screenshot, bytes.
const MAX_PICTURE_BYTES: usize = 300 << 10;

/// Takes the pictures of the live page.
#[derive(Parser)]
struct Arguments {
    /// Result rows whose outcomes are repeated.
    #[arg(long)]
    outcomes: PathBuf,
    /// Folder of the pictures.
    #[arg(long)]
    output: PathBuf,
}

/// A screenshot to take.
struct Picture {
    name: &'static str,
    path: String,
    /// Selector of the element that is scrolled to the top; empty for the top of the page.
    from: &'static str,
    screen: Screen,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let folder = tempfile::tempdir().context("make a temporary folder")?;
    let campaigns = Campaigns::with_student(&folder.path().join("data"), "builtin:student");
    let endpoint = campaigns.gateway.url.clone();
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", FILMED, "--policy", "student", "--endpoint", &endpoint,
        "--tasks", "libero_object/4", "--axes", "all", "--levels", "L2", "--configs", "1",
        "--nominal", "eval", "--record", "all",
    ]);
    let worker = Process::worker(&campaigns.coordinator.url, 2, "libero");
    campaigns.wait_for_commits(FILMED, None);
    drop(worker);
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", REPEATED, "--policy", "noop", "--endpoint", &endpoint,
        "--tasks", "all", "--axes", "all", "--levels", "L1,L2,L3", "--configs", "0-9",
        "--nominal", "none",
    ]);
    let outcomes = arguments.outcomes.to_string_lossy();
    let environment =
        [("SIMULATED_SLOT_OUTCOMES", outcomes.as_ref()), ("SIMULATED_SLOT_STEP_MILLIS", "0")];
    let _worker = campaigns.simulated_worker(2, &environment);
    campaigns.wait_for_commits(REPEATED, Some(REPEATED_RESULTS));
    std::fs::create_dir_all(&arguments.output)
        .with_context(|| format!("make {}", arguments.output.display()))?;
    let mut browser = Browser::start(&folder.path().join("profile"));
    for picture in pictures() {
        take(&mut browser, &campaigns, &picture, &arguments.output)?;
    }
    Ok(())
}

fn pictures() -> Vec<Picture> {
    let desk = |height| Screen { width: 1440, height, is_dark: false };
    let phone = Screen { width: 390, height: 844, is_dark: false };
    let campaign = format!("/campaigns/{REPEATED}");
    let configuration = format!("/campaigns/{FILMED}/configurations/object/t4/combination/L2/c01");
    let picture =
        |name, path: &str, from, screen| Picture { name, path: path.to_owned(), from, screen };
    vec![
        picture("campaigns", "/", "", desk(620)),
        picture("campaign", &campaign, "", desk(1_300)),
        picture("matrix", &campaign, "figure:last-of-type", desk(640)),
        picture("configuration", &configuration, "", desk(1_150)),
        picture("campaign-dark", &campaign, "", Screen { is_dark: true, ..desk(1_000) }),
        picture("phone", &campaign, "", phone),
    ]
}

fn take(
    browser: &mut Browser,
    campaigns: &Campaigns,
    picture: &Picture,
    folder: &Path,
) -> Result<()> {
    browser.set_screen(picture.screen);
    browser.go(&format!("{}{}", campaigns.coordinator.url, picture.path));
    browser.wait_for("[...document.querySelectorAll('video')].every(v => v.readyState >= 3)");
    // The middle of a video shows more than its beginning.
    browser.value("document.querySelectorAll('video').forEach(v => { v.currentTime = 3; })");
    browser.wait_for("[...document.querySelectorAll('video')].every(v => !v.seeking)");
    if !picture.from.is_empty() {
        browser.value(&format!("document.querySelector({:?}).scrollIntoView()", picture.from));
    }
    let is_too_wide = browser.value("document.documentElement.scrollWidth > window.innerWidth");
    ensure!(is_too_wide == false, "show {}: the page is wider than its screen", picture.name);
    let png = browser.screenshot();
    ensure!(
        png.len() <= MAX_PICTURE_BYTES,
        "keep the picture {}: it takes {} bytes",
        picture.name,
        png.len()
    );
    let path = folder.join(format!("{}.png", picture.name));
    std::fs::write(&path, png).with_context(|| format!("write {}", path.display()))?;
    println!("{}", path.display());
    Ok(())
}
