//! Requirements of a campaign on its workers. The first result fixes requirements that are left
//! unspecified.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::look::Look;

/// Smallest number of digits of a digest that identifies an asset pack.
pub(crate) const MIN_DIGEST_DIGITS: usize = 8;
const PACKS: [&str; 2] = ["primitives", "libero"];

/// Asset pack, renderer and look required of a campaign's workers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wanted {
    /// The asset pack: `primitives`, `libero`, or the first digits of a pack's
    /// digest, at least eight.
    pub assets: Option<String>,
    pub renderer: Option<RendererKind>,
    pub look: Option<Look>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RendererKind {
    /// This project's renderer, bit-identical on every machine.
    Software,
    /// The machine's OpenGL.
    Gl,
}

impl Wanted {
    pub(crate) fn unknown_assets(&self) -> Option<&str> {
        let is_digit = |byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
        let is_known = |text: &str| {
            PACKS.contains(&text) || text.len() >= MIN_DIGEST_DIGITS && text.bytes().all(is_digit)
        };
        self.assets.as_deref().filter(|text| !is_known(text))
    }
}

impl RendererKind {
    /// Returns the name in a specification and on a worker's command line.
    pub fn name(self) -> &'static str {
        match self {
            RendererKind::Software => "software",
            RendererKind::Gl => "gl",
        }
    }
}

/// Writes "assets `libero` and renderer `software`"; empty if there are no requirements.
impl fmt::Display for Wanted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let assets = self.assets.iter().map(|name| format!("assets `{name}`"));
        let renderer = self.renderer.iter();
        let renderer = renderer.map(|kind| format!("renderer `{}`", kind.name()));
        let look = self.look.iter().map(|look| format!("look `{look}`"));
        let parts: Vec<String> = assets.chain(renderer).chain(look).collect();
        f.write_str(&parts.join(" and "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assets_are_a_packs_name_or_the_beginning_of_its_digest() {
        let check = |assets: &str, is_known: bool| {
            let wanted = Wanted { assets: Some(assets.to_owned()), ..Wanted::default() };
            assert_eq!(wanted.unknown_assets().is_none(), is_known, "{assets}");
        };
        check("primitives", true);
        check("libero", true);
        check("0123abcd", true);
        check("0123abc", false);
        check("0123ABCD", false);
        check("../libero-assets", false);
    }
}
