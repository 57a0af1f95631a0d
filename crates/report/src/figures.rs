//! The figures, as SVG. Most are panels of the same fixed width, so that a page can set panels side
//! by side if there is room and below one another if there is not, without scaling text; a wide
//! figure takes a row of its own.
//!
//! Colour never carries meaning alone: transitions have marks, measures have
//! shapes. Colours are those of M. Okabe and K. Ito, Color Universal Design (2008).

mod lattice;
mod levels;
mod matrix;
mod paper;
mod survival;
mod svg;
mod sweep;
mod upset;

use std::collections::BTreeSet;

use benchmark::{Level, RolloutId};
use maud::{Markup, PreEscaped, html};
use paired::Transition;

use crate::document::Document;
use crate::threshold_report::ThresholdReport;

pub use self::lattice::{SubsetLink, lattice};
pub use self::levels::decomposition;
pub use matrix::matrix;
pub use paper::{by_level, changes};
pub use survival::survival;
pub use svg::WIDTH;
pub use sweep::sweep;
pub use upset::upset;

/// The style that the panels need; a page includes it once.
pub const STYLE: &str = include_str!("figures/style.css");

/// Maps the simultaneous rollout of a configuration, and a replicate, to the URL of the page that
/// shows the configuration's rollouts.
pub type Link<'a> = &'a dyn Fn(RolloutId, u32) -> String;

/// Padding around a panel that is written to a file of its own.
const PADDING: f64 = 14.0;

/// One panel, rendered inline in a page or as an SVG file.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Name of the SVG file, without extension.
    pub name: String,
    /// Description for readers who cannot see the figure.
    pub title: String,
    has_links: bool,
    is_wide: bool,
    height: f64,
    body: Markup,
}

impl Figure {
    fn new(name: &str, title: String, height: f64, body: Markup) -> Self {
        let allowed = |c: char| match c.is_ascii_alphanumeric() || c == '.' {
            true => c.to_ascii_lowercase(),
            false => '-',
        };
        Self {
            name: name.chars().map(allowed).collect(),
            title,
            has_links: false,
            is_wide: false,
            height,
            body,
        }
    }

    /// Makes the figure as wide as a page; on a narrow page it scrolls in a box.
    fn wide(self) -> Self {
        Self { is_wide: true, ..self }
    }

    /// Renders the figure for a page that includes [`STYLE`].
    pub fn inline(&self) -> Markup {
        self.svg(html! {}, 0.0)
    }

    /// Renders the figure for a file of its own.
    pub fn standalone(&self) -> String {
        // The file draws its own background, because a viewer may show a dark background behind
        // the text of the light scheme, or the reverse.
        let style = html! {
            style { (PreEscaped(literal_style())) }
            rect class="ground" x=(svg::number(-PADDING)) y=(svg::number(-PADDING))
                width="100%" height="100%" {}
        };
        format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{}\n", self.svg(style, PADDING).0)
    }

    fn svg(&self, style: Markup, padding: f64) -> Markup {
        let (width, class) = match self.is_wide {
            true => (svg::WIDE, "panel wide"),
            false => (WIDTH, "panel"),
        };
        // Not `-padding`, which is written as `-0` without padding.
        let origin = svg::number(0.0 - padding);
        let (width, height) = (width + 2.0 * padding, self.height + 2.0 * padding);
        let (width, height) = (svg::number(width), svg::number(height));
        // Screen readers do not reach links inside an element of role `img`.
        let role = if self.has_links { "group" } else { "img" };
        html! {
            svg xmlns="http://www.w3.org/2000/svg" class=(class) role=(role)
                viewBox={ (origin) " " (origin) " " (width) " " (height) }
                width=(width) height=(height) {
                title { (self.title) }
                (style)
                (self.body)
            }
        }
    }
}

/// Returns [`STYLE`] with the values of its variables, and always light: programs that convert SVG
/// files to PDF know no variables, and a file does not follow the colours of its reader's desktop.
fn literal_style() -> String {
    // The style's first rule holds the variables of the light scheme, without spaces between them;
    // every rule that begins with `@`, for dark schemes and for print, is a single line.
    let (_, light) = STYLE.split_once('{').unwrap_or_default();
    let light = light.split_once('}').map_or("", |(light, _)| light);
    let variables = light.split(';').filter(|declaration| declaration.starts_with("--"));
    let mut style: String = STYLE
        .lines()
        .filter(|line| !line.starts_with('@'))
        .map(|line| format!("{line}\n"))
        .collect();
    for variable in variables {
        style = style.replace(&format!("{variable};"), "");
        if let Some((name, value)) = variable.split_once(':') {
            style = style.replace(&format!("var({name})"), value);
        }
    }
    style
}

/// Returns the levels of a document, in ascending order of radius.
pub fn levels(document: &Document) -> Vec<Level> {
    let cells = document.analyses.iter().flat_map(|analysis| &analysis.report.cells);
    let levels: BTreeSet<Level> = cells.map(|cell| cell.level).collect();
    levels.into_iter().collect()
}

/// Draws the survival curves of a campaign that measures thresholds.
pub fn of_thresholds(report: &ThresholdReport) -> Vec<Figure> {
    report.curves.iter().filter_map(survival).collect()
}

/// Draws all figures of a document, in the page's order.
pub fn all(document: &Document) -> Vec<Figure> {
    let mut figures = Vec::new();
    let levels = levels(document);
    figures.extend(sweep(document));
    figures.extend(by_level(document));
    figures.extend(levels.iter().filter_map(|&level| changes(document, level)));
    figures.extend(levels.iter().filter_map(|&level| decomposition(document, level)));
    for analysis in &document.analyses {
        let matrices = levels.iter().map(|&level| matrix(analysis, level, None));
        figures.extend(matrices.flatten());
    }
    for analysis in &document.analyses {
        if let Some(findings) = &analysis.findings {
            let transitions = [Transition::Emergent, Transition::Compensated];
            figures
                .extend(transitions.iter().filter_map(|transition| upset(findings, *transition)));
        }
        figures.extend(analysis.thresholds.iter().flat_map(of_thresholds));
    }
    // Distinct labels can map to the same file name; files must not overwrite each other.
    let mut used_names = BTreeSet::new();
    for figure in &mut figures {
        while !used_names.insert(figure.name.clone()) {
            figure.name.push_str("-2");
        }
    }
    figures
}
