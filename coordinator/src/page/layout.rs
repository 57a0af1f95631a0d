//! Shared layout of all pages: head, navigation and connection status.

use maud::{DOCTYPE, Markup, html};

use super::answer::FILES_VERSION;

/// Content of a page without the shared layout.
pub(super) struct Sheet {
    pub(super) title: String,
    /// Navigation entry that is highlighted.
    pub(super) tab: Tab,
    pub(super) main: Markup,
}

impl Sheet {
    pub(super) fn new(tab: Tab, title: impl Into<String>, main: Markup) -> Sheet {
        Sheet { title: title.into(), tab, main }
    }
}

/// An entry of the navigation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tab {
    Campaigns,
    Workers,
    Policies,
    Quarantine,
}

/// Reload interval of browsers without JavaScript, seconds.
const RELOAD_SECS: u32 = 10;

const NAVIGATION: [(Tab, &str, &str); 4] = [
    (Tab::Campaigns, "/", "Campaigns"),
    (Tab::Workers, "/workers", "Workers"),
    (Tab::Policies, "/policies", "Policies"),
    (Tab::Quarantine, "/quarantine", "Quarantine"),
];

/// Renders a live page, which updates itself.
pub(super) fn live_page(sheet: &Sheet, may_log_out: bool) -> Markup {
    let top = html! {
        nav aria-label="Pages" {
            @for (tab, address, name) in NAVIGATION {
                @let current = (tab == sheet.tab).then_some("page");
                a href=(address) aria-current=[current] { (name) }
            }
        }
        p #connection role="status" {}
        @if may_log_out {
            form method="post" action="/logout" { button { "Log out" } }
        }
    };
    document(&sheet.title, true, top, &sheet.main)
}

/// Renders a static page, such as an error.
pub(super) fn static_page(title: &str, main: &Markup) -> Markup {
    let top = html! { nav aria-label="Pages" { a href="/" { "Campaigns" } } };
    document(title, false, top, main)
}

/// Renders a name such as `camera+robot` with a line-break opportunity after each `+`.
pub(super) fn breakable(name: &str) -> Markup {
    let mut axes = name.split('+');
    html! {
        (axes.next().unwrap_or_default())
        @for axis in axes { "+" wbr; (axis) }
    }
}

/// Renders a horizontally scrollable table. A column heading that begins with `.` marks a column of
/// text.
pub(super) fn table(name: &str, columns: &[impl AsRef<str>], rows: &Markup) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(name) {
            table {
                thead {
                    tr {
                        @for column in columns {
                            @let column = column.as_ref();
                            th scope="col" class=[column.starts_with('.').then_some("words")] {
                                (column.trim_start_matches('.'))
                            }
                        }
                    }
                }
                tbody { (rows) }
            }
        }
    }
}

/// Renders the breadcrumbs of a page below a campaign.
pub(super) fn crumbs(campaign: &str) -> Markup {
    html! {
        p.crumbs {
            a href="/" { "Campaigns" } " › "
            a href={ "/campaigns/" (campaign) } { (campaign) }
        }
    }
}

/// Renders the complete HTML document around the content `main`.
fn document(title: &str, is_live: bool, top: Markup, main: &Markup) -> Markup {
    let version = FILES_VERSION.as_str();
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) " · rollout" }
                link rel="icon" href={ "/icon.svg?v=" (version) };
                link rel="stylesheet" href={ "/style.css?v=" (version) };
                @if is_live {
                    script src={ "/page.js?v=" (version) } defer {}
                    noscript { meta http-equiv="refresh" content=(RELOAD_SECS); }
                }
            }
            body {
                a.skip href="#main" { "To the content" }
                header.top { (top) }
                main #main tabindex="-1" { (main) }
            }
        }
    }
}
