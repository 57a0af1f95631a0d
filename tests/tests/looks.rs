//! Layout of the live page on screens of common sizes: nothing is cut off, no letter is too small
//! to read, and figures fill the available width.
//!
//! `ROLLOUT_LOOKS=FOLDER` saves screenshots of every page to that folder, for every screen, light
//! and dark.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use libero_ctrl::{Axis, AxisSet, Condition, Level, RolloutId, Suite, TaskRef};
use tests::browser::{self, Browser, Screen};
use tests::programs::{Campaigns, Process};

/// Widths of a phone, a tablet, a laptop and a desktop screen, CSS pixels.
const WIDTHS: [u32; 4] = [390, 768, 1280, 1920];
/// Width from which a page's cards must stand side by side, CSS pixels.
const WIDE: u32 = 1280;
/// Smallest allowed letters, CSS pixels.
const MIN_LETTERS_PX: f64 = 11.0;
/// Smallest allowed share of the page's width that a figure with its caption takes on a wide
/// screen.
const MIN_FILLED: f64 = 0.85;
/// Tallest screenshot, CSS pixels.
const MAX_HEIGHT: u64 = 8_000;

/// JavaScript for the displayed size of the smallest visible letters, and their text.
const SMALLEST: &str = "(() => { let least = [99, ''];
    for (const e of document.querySelectorAll('main *')) {
        const own = [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim());
        if (!own || e.closest('.unseen') || !e.getClientRects().length) continue;
        const svg = e.closest('svg');
        const scale = svg ? svg.clientWidth / svg.viewBox.baseVal.width : 1;
        const size = parseFloat(getComputedStyle(e).fontSize) * scale;
        if (size < least[0]) least = [size, e.textContent.trim()];
    }
    return least; })()";
/// JavaScript for the share of the page's width that the narrowest figure takes.
const NARROWEST: &str = "(() => { const page = document.querySelector('main');
    const width = page.getBoundingClientRect().width;
    const share = f => { const boxes = [...f.querySelectorAll('svg, figcaption, p')]
            .map(e => e.getBoundingClientRect()).filter(b => b.width);
        return (Math.max(...boxes.map(b => b.right)) - Math.min(...boxes.map(b => b.left))) / width; };
    return Math.min(1, ...[...document.querySelectorAll('main figure')].map(share)); })()";
/// JavaScript for the titles of a configuration's first two cards, and true if they share a row.
const SIDE_BY_SIDE: &str = "(() => { const [nominal, all] = document.querySelectorAll('.rollout');
    const title = e => e.querySelector('h2').innerText;
    return [title(nominal), title(all),
        nominal.getBoundingClientRect().top === all.getBoundingClientRect().top]; })()";

/// JavaScript that is true if the lattice shows its nominal rollout without sideways scrolling.
const NOMINAL_IN_VIEW: &str = "(() => { const box = document.querySelector('.centred');
    const words = [...box.querySelectorAll('text')].find(e => e.textContent === 'nominal');
    const [at, view] = [words, box].map(e => e.getBoundingClientRect());
    return at.left >= view.left && at.right <= view.right; })()";

fn create(campaigns: &Campaigns, name: &str, levels: &str) {
    let endpoint = &campaigns.gateway.url;
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", name, "--policy", "noop", "--endpoint", endpoint,
        "--tasks", "libero_object,libero_spatial", "--axes", "all", "--levels", levels,
        "--configs", "0-1", "--nominal", "eval",
    ]);
}

/// Longest time that a derived campaign may take.
const PATIENCE: Duration = Duration::from_secs(60);

/// Returns true if a configuration fails under these axes by a made-up rule, which depends on task
/// and configuration.
fn is_planted_to_fail(task: usize, config: u16, axes: AxisSet) -> bool {
    let has = |text: &str| text.parse::<AxisSet>().unwrap().is_subset(axes);
    match (task + usize::from(config)) % 7 {
        0 | 1 => has("camera+robot"),
        2 => has("camera+lighting+sensor"),
        3 => has("robot+language") || has("camera+sensor"),
        4 => has("robot") && !has("camera"),
        5 => has("lighting+actuation") && !has("lighting+actuation+sensor") || axes == AxisSet::ALL,
        _ => has("sensor") && task.is_multiple_of(2),
    }
}

/// Returns result rows for every subset of the axes, with the outcomes of [`is_planted_to_fail`].
fn planted_outcomes() -> String {
    let mut rows = String::new();
    let suite = TaskRef::all().filter(|task| task.suite() == Suite::Object);
    for (index, task) in suite.enumerate() {
        let nominal = (0..50).map(|state| (RolloutId::clean(task, state), true));
        let conditions = AxisSet::ALL.subsets().into_iter().skip(1);
        let perturbed = conditions.flat_map(|axes| {
            (0..2).map(move |config| {
                let condition = Condition::of(axes);
                let id = RolloutId::perturbed(task, condition, Level::L2, config).unwrap();
                (id, !is_planted_to_fail(index, config, axes))
            })
        });
        for (id, success) in nominal.chain(perturbed) {
            rows.push_str(&format!("{{\"rollout_id\":\"{id}\",\"success\":{success}}}\n"));
        }
    }
    rows
}

/// Runs and explains a campaign of one suite, and runs a second campaign of all subsets of axes.
fn explain(campaigns: &Campaigns, outcomes: &Path) {
    let endpoint = &campaigns.gateway.url;
    for (name, further) in [
        ("planted", ["--configs", "0-1"].as_slice()),
        ("lattices", &["--configs", "0", "--subsets", "all"]),
    ] {
        #[rustfmt::skip]
        let arguments = [
            "campaign", "create", "--name", name, "--policy", "noop", "--endpoint", endpoint,
            "--tasks", "libero_object", "--axes", "all", "--levels", "L2",
        ];
        campaigns.succeed(&[&arguments[..], further].concat());
    }
    std::fs::write(outcomes, planted_outcomes()).unwrap();
    let _worker = planted_worker(campaigns, outcomes);
    campaigns.wait_for_commits("lattices", None);
    finish(campaigns, "explain", "planted");
}

/// Spacing and largest of the radii that `coordinator thresholds` may run by default.
const RADII: [f64; 2] = [0.5, 16.0];

/// Returns the smallest radius at which a rollout fails: larger for later tasks, and largest for
/// the robot axis alone. Task 7, which also fails nominally, has the smallest.
fn failure_radius(task: usize, config: u16, condition: Condition) -> f64 {
    let scale = match condition {
        Condition::Combination => 0.6,
        Condition::Single(Axis::Camera) => 1.1,
        Condition::Single(Axis::Robot) => 3.0,
        _ => 0.9,
    };
    let task = if task == 7 { 0.0 } else { 1.0 + task as f64 };
    scale * (task + 0.7 * f64::from(config))
}

/// Returns result rows for all radii. Task 2 under the camera axis alone fails at smaller radii
/// and succeeds again at radius 8.
fn outcomes_by_radius() -> String {
    let mut rows = String::new();
    let suite = TaskRef::all().filter(|task| task.suite() == Suite::Object);
    let [step, most] = RADII;
    let conditions = [Axis::Camera, Axis::Robot, Axis::Language].map(Condition::Single);
    for (index, task) in suite.enumerate() {
        let nominal = (0..50).map(|state| (RolloutId::clean(task, state), index != 7));
        let mut all: Vec<(RolloutId, bool)> = nominal.collect();
        for condition in conditions.into_iter().chain([Condition::Combination]) {
            for config in 0..2 {
                let from = failure_radius(index, config, condition);
                let recovers = condition == conditions[0] && index == 2;
                for radius in
                    (1..).map(|k| step * f64::from(k)).take_while(|radius| *radius <= most)
                {
                    let level = Level::of_radius(radius).unwrap();
                    let id = RolloutId::perturbed(task, condition, level, config).unwrap();
                    all.push((id, radius < from || recovers && radius == 8.0));
                }
            }
        }
        for (id, success) in all {
            rows.push_str(&format!("{{\"rollout_id\":\"{id}\",\"success\":{success}}}\n"));
        }
    }
    rows
}

/// Runs a campaign of one suite and measures its thresholds.
fn measure(campaigns: &Campaigns, outcomes: &Path) {
    let endpoint = &campaigns.gateway.url;
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", "radii", "--policy", "noop", "--endpoint", endpoint,
        "--tasks", "libero_object", "--axes", "camera,robot,language", "--levels", "L1,L2,L3",
        "--configs", "0-1",
    ]);
    std::fs::write(outcomes, outcomes_by_radius()).unwrap();
    let _worker = planted_worker(campaigns, outcomes);
    finish(campaigns, "thresholds", "radii");
}

/// Starts a worker whose rollouts have the outcomes of the rows in a file.
fn planted_worker(campaigns: &Campaigns, outcomes: &Path) -> Process {
    let environment = [
        ("SIMULATED_SLOT_OUTCOMES", outcomes.to_str().unwrap()),
        ("SIMULATED_SLOT_STEP_MILLIS", "0"),
    ];
    campaigns.simulated_worker(2, &environment)
}

/// Repeats `explain` or `thresholds` until its findings are complete.
fn finish(campaigns: &Campaigns, command: &str, campaign: &str) {
    let start = Instant::now();
    loop {
        let found = campaigns.succeed(&[command, campaign, "--create", "--json"]);
        if found.contains("\"complete\": true") {
            return;
        }
        assert!(start.elapsed() < PATIENCE, "{found}");
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// Takes a screenshot of the whole page.
fn save_screenshot(browser: &mut Browser, screen: Screen, path: &Path) {
    let height = browser.value("document.documentElement.scrollHeight");
    let height = height.as_u64().expect("a height").clamp(1, MAX_HEIGHT);
    let height = u32::try_from(height).expect("a clamped height");
    browser.set_screen(Screen { height, ..screen });
    std::fs::write(path, browser.screenshot()).expect("written");
}

#[test]
fn on_every_screen_nothing_is_cut_off_or_too_small_and_figures_use_the_width() {
    let test = "on_every_screen_nothing_is_cut_off_or_too_small_and_figures_use_the_width";
    if !browser::is_installed(test) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let pictures = std::env::var_os("ROLLOUT_LOOKS").map(PathBuf::from);
    if let Some(folder) = &pictures {
        std::fs::create_dir_all(folder).unwrap();
    }
    // Colours do not change the layout, so they matter only to screenshots.
    let themes = if pictures.is_some() { &[false, true][..] } else { &[false] };
    let campaigns = Campaigns::start(&folder.path().join("data"));
    create(&campaigns, "one-level", "L2");
    create(&campaigns, "three-levels", "L1,L2,L3");
    let fast = [("SIMULATED_SLOT_STEP_MILLIS", "0")];
    let worker = campaigns.simulated_worker(2, &fast);
    campaigns.wait_for_commits("one-level", None);
    campaigns.wait_for_commits("three-levels", None);
    drop(worker);
    explain(&campaigns, &folder.path().join("subsets.jsonl"));
    measure(&campaigns, &folder.path().join("radii.jsonl"));
    create(&campaigns, "no-result", "L1,L2,L3");
    let pages = [
        ("campaigns", "/"),
        ("no-result", "/campaigns/no-result"),
        ("one-level", "/campaigns/one-level"),
        ("three-levels", "/campaigns/three-levels"),
        ("configuration", "/campaigns/one-level/configurations/object/t0/combination/L2/c00"),
        ("explanation", "/campaigns/planted-explained"),
        (
            "explained-configuration",
            "/campaigns/planted/configurations/object/t2/combination/L2/c00",
        ),
        (
            "explaining-configuration",
            "/campaigns/planted-explained/configurations/object/t5/lighting+actuation/L2/c00",
        ),
        ("interactions", "/campaigns/lattices"),
        ("thresholds", "/campaigns/radii-thresholds"),
        ("rollouts", "/campaigns/one-level/rollouts"),
        ("workers", "/workers"),
    ];
    let mut browser = Browser::start(&folder.path().join("profile"));
    let mut problems = Vec::new();
    for (name, path) in pages {
        let screens = WIDTHS.into_iter();
        for (width, is_dark) in
            screens.flat_map(|width| themes.iter().map(move |theme| (width, *theme)))
        {
            let screen = Screen { width, height: 1_000, is_dark };
            browser.set_screen(screen);
            // A loaded page adapts to a new width by its style sheets alone, except for lattices,
            // which a script scrolls to their middle only once after loading.
            if width == WIDTHS[0] || name == "explained-configuration" {
                browser.go(&format!("{}{path}", campaigns.coordinator.url));
            }
            browser.wait_for(&format!("innerWidth === {width}"));
            let place = format!("{name} at {width} px");
            let scroll_width = browser.value("document.documentElement.scrollWidth");
            if scroll_width.as_u64() > Some(u64::from(width)) {
                problems.push(format!("{place} is {scroll_width} px wide"));
            }
            let smallest = browser.value(SMALLEST);
            if smallest[0].as_f64() < Some(MIN_LETTERS_PX) {
                problems.push(format!("{place}: letters of {smallest} px"));
            }
            let filled = browser.value(NARROWEST);
            if width >= WIDE && filled.as_f64() < Some(MIN_FILLED) {
                problems.push(format!("{place}: a figure takes {filled} of the width"));
            }
            if name == "explained-configuration" {
                let nominal = browser.value(NOMINAL_IN_VIEW);
                assert_eq!(nominal, serde_json::json!(true), "{place}");
            }
            if name == "configuration" && width >= WIDE {
                let cards = browser.value(SIDE_BY_SIDE);
                assert_eq!(cards, serde_json::json!(["nominal", "simultaneous", true]));
            }
            if let Some(folder) = &pictures {
                let theme = if is_dark { "dark" } else { "light" };
                let picture = folder.join(format!("{name}-{width}-{theme}.png"));
                save_screenshot(&mut browser, screen, &picture);
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    let console_errors = browser.console_errors();
    assert!(console_errors.is_empty(), "{console_errors:#?}");
}
