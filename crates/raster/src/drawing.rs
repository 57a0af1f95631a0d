//! What every step from an instance to its samples works on.

use crate::instance::Instance;
use crate::model::Model;
use crate::positions::Positions;
use crate::visible::{Layers, Visible};
use crate::window::{Around, Window};

/// What drawing an instance needs beside it.
pub(crate) struct Drawing<'a> {
    pub(crate) model: &'a Model,
    pub(crate) instances: &'a [Instance],
    pub(crate) window: Window,
    /// What lies beyond it is cut off.
    pub(crate) plane: Option<[f32; 4]>,
    pub(crate) positions: &'a mut Positions,
    pub(crate) visible: &'a mut Visible,
    /// Where anything became visible.
    pub(crate) touched: Around,
    /// Where everything goes that is not behind what is visible; without it,
    /// what is nearest becomes visible.
    pub(crate) layers: Option<Layers<'a>>,
}
