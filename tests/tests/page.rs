//! The live page with a real browser, a real coordinator and real campaigns. Its text is tested in
//! the coordinator's own tests.

use tempfile::TempDir;
use tests::browser::{self, Browser, Screen};
use tests::programs::{Campaigns, Process};

const DESK: Screen = Screen { width: 1440, height: 1000, is_dark: false };
/// JavaScript for the displayed size of the smallest visible letters, pixels.
const SMALLEST: &str = "(() => { let least = 99;
    for (const e of document.querySelectorAll('main *')) {
        const own = [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim());
        if (!own || e.closest('.unseen') || !e.getClientRects().length) continue;
        const svg = e.closest('svg');
        const scale = svg ? svg.clientWidth / svg.viewBox.baseVal.width : 1;
        least = Math.min(least, parseFloat(getComputedStyle(e).fontSize) * scale);
    }
    return least; })()";
/// JavaScript for the number of finished rollouts on the start page or a campaign's page.
const DONE: &str = "Number(document.querySelector('.pace')?.innerText.match(/(\\d+) of/)?.[1])";

struct Bench {
    folder: TempDir,
    campaigns: Campaigns,
    browser: Browser,
}

impl Bench {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let campaigns = Campaigns::start(&folder.path().join("data"));
        let mut browser = Browser::start(&folder.path().join("profile"));
        browser.set_screen(DESK);
        Self { folder, campaigns, browser }
    }

    fn url(&self, path: &str) -> String {
        format!("{}{path}", self.campaigns.coordinator.url)
    }

    /// Asserts that on a phone, a tablet and a desk nothing is cut off or too small to read, and
    /// that the page requested nothing from other origins and logged no errors.
    fn check(&mut self) {
        for width in [390, 768, DESK.width] {
            self.browser.set_screen(Screen { width, ..DESK });
            self.browser.wait_for(&format!("innerWidth === {width}"));
            let needed = self.browser.value("document.documentElement.scrollWidth");
            assert!(needed.as_u64() <= Some(width.into()), "{needed} px wide on {width}");
            let letters = self.browser.value(SMALLEST);
            assert!(letters.as_f64() >= Some(11.0), "letters of {letters} px on {width}");
        }
        let console_errors = self.browser.console_errors();
        assert!(console_errors.is_empty(), "{console_errors:#?}");
        let origin = self.url("/");
        for url in self.browser.requests() {
            let is_own =
                url.starts_with(&origin) || url.starts_with("data:") || url == "about:blank";
            assert!(is_own, "the page requested {url}");
        }
    }
}

#[test]
fn the_page_updates_without_reload_and_reconnects_after_a_restart() {
    if !browser::is_installed("the_page_updates_without_reload_and_reconnects_after_a_restart") {
        return;
    }
    let mut bench = Bench::start();
    let tasks = "libero_object,libero_spatial/0-1";
    bench.campaigns.create("live", "noop", tasks, "0-9");
    bench.browser.go(&bench.url("/"));
    // A reload of the page would delete this variable.
    bench.browser.value("window.since = 'the beginning'");
    assert_eq!(bench.browser.value(DONE), 0);
    let _worker = bench.campaigns.simulated_worker(2, &[]);
    bench.browser.wait_for(&format!("{DONE} > 10"));
    bench.browser.wait_for("document.getElementById('connection').innerText === 'Live'");
    assert_eq!(bench.browser.value("window.since"), "the beginning");

    bench.browser.click("section.campaign h2 a");
    // The matrix has a row for each of the twelve tasks, with ten configurations.
    bench.browser.wait_for("document.querySelectorAll('svg.panel[role=group] a').length === 120");
    bench.browser.click("details:has(svg.panel[role=group]) > summary");
    let square = "document.querySelectorAll('svg.panel[role=group] a')";
    bench.browser.value(&format!("window.since = 'the click', {square}[0].focus()"));
    bench.browser.press("ArrowRight");
    bench.browser.press("ArrowDown");
    let is_focused = format!("document.activeElement === {square}[11]");
    assert_eq!(bench.browser.value(&is_focused), true, "arrow keys move the focus in the matrix");
    let focus_top = "document.activeElement.getBoundingClientRect().top";
    bench.browser.value(&format!("window.scrollBy(0, {focus_top} - 200)"));
    let before = bench.browser.value(focus_top).as_f64().unwrap();
    let done = bench.browser.value(DONE).as_i64().unwrap();
    bench.browser.wait_for(&format!("{DONE} > {done} + 10"));
    assert_eq!(bench.browser.value("window.since"), "the click");
    assert_eq!(bench.browser.value(&is_focused), true, "focus stays");
    let after = bench.browser.value(focus_top).as_f64().unwrap();
    // The browser rounds to whole pixels at each of the updates between.
    assert!(
        (before - after).abs() <= 10.0,
        "the focused square keeps its position: {before} and {after} px from the top"
    );
    let inserted = format!(
        "(() => {{ const main = document.getElementById('main');
        const grown = main.cloneNode(true);
        const section = document.createElement('section');
        section.innerHTML = '<h2>New</h2><p>Something to say</p>'.repeat(9);
        grown.insertBefore(section, grown.querySelector('section'));
        const top = () => {square}[11].getBoundingClientRect().top;
        const before = top();
        show(grown);
        return main.isEqualNode(grown) && {is_focused} && Math.abs(top() - before) <= 1; }})()"
    );
    assert_eq!(
        bench.browser.value(&inserted),
        true,
        "focus and position stay when a section is inserted above"
    );
    bench.browser.value("document.activeElement.blur()");
    assert_eq!(
        bench.browser.value(&inserted.replace(&is_focused, "scrollY > 0")),
        true,
        "the position stays without a focused element"
    );
    bench.check();

    let done = bench.browser.value(DONE).as_i64().unwrap();
    bench.campaigns.kill_coordinator();
    bench
        .browser
        .wait_for("document.getElementById('connection').innerText.includes('Disconnected')");
    bench.browser.console_errors();
    let data = bench.folder.path().join("data");
    bench.campaigns.restart_coordinator(&data);
    bench.browser.wait_for(&format!("{DONE} > {done} + 10"));
    bench.browser.wait_for("document.getElementById('connection').innerText === 'Live'");
    assert_eq!(bench.browser.value("window.since"), "the click");

    bench.browser.click("svg.panel[role=group] a");
    // The rollouts of a configuration: nominal, simultaneous and five single axes.
    bench.browser.wait_for("document.querySelectorAll('article.rollout').length === 7");
    let paper = "getComputedStyle(document.body).backgroundColor";
    assert_eq!(bench.browser.value(paper), "rgb(255, 255, 255)");
    bench.browser.set_screen(Screen { is_dark: true, ..DESK });
    assert_eq!(bench.browser.value(paper), "rgb(20, 24, 28)");
}

#[test]
fn the_videos_of_a_configuration_play_together() {
    if !browser::is_installed("the_videos_of_a_configuration_play_together") {
        return;
    }
    let mut bench = Bench::start();
    let endpoint = bench.campaigns.gateway.url.clone();
    #[rustfmt::skip]
    bench.campaigns.succeed(&[
        "campaign", "create", "--name", "filmed", "--policy", "expert", "--endpoint", &endpoint,
        "--tasks", "libero_object/0", "--axes", "camera,actuation", "--levels", "L1",
        "--configs", "0", "--nominal", "eval", "--record", "all",
    ]);
    let worker = Process::worker(&bench.campaigns.coordinator.url, 2, "primitives");
    bench.campaigns.wait_for_commits("filmed", None);
    let configuration = "/campaigns/filmed/configurations/object/t0/simultaneous/L1/c00";
    bench.browser.go(&bench.url(configuration));
    // A video may arrive a moment after its result.
    bench.browser.wait_for("document.querySelectorAll('video').length === 4");
    drop(worker);
    let every = |condition: &str| {
        format!("[...document.querySelectorAll('video')].every(v => {condition})")
    };
    bench.browser.wait_for(&every("v.readyState >= 3 && v.videoWidth > 0 && !v.controls"));
    bench.browser.click("#play");
    bench.browser.wait_for(&every("v.currentTime > 0.2"));
    bench.browser.click("#play");
    bench.browser.wait_for(&every("v.paused"));
    bench.browser.value(
        "document.getElementById('scrub').value = 500, \
         document.getElementById('scrub').dispatchEvent(new Event('input'))",
    );
    bench.browser.wait_for(&every("!v.seeking && v.currentTime > 1"));
    let difference = "(t => Math.max(...t) - Math.min(...t))(\
        [...document.querySelectorAll('video')].map(v => Math.min(v.currentTime, v.duration)))";
    let shortest = "Math.min(...[...document.querySelectorAll('video')].map(v => v.duration))";
    let difference = bench.browser.value(difference).as_f64().unwrap();
    let shortest = bench.browser.value(shortest).as_f64().unwrap();
    // The slider is in the middle of the longest video, which lasts 14 s at most. A video of less
    // than 8 s may have ended there.
    assert!(difference < 0.1 || shortest < 8.0, "the videos are {difference} s apart");
    bench.check();
}
