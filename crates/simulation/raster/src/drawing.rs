//! Context shared by every step from an instance to its samples.

use crate::instance::Instance;
use crate::model::Model;
use crate::positions::Positions;
use crate::visible::{Layers, Visible};
use crate::window::{BoundingWindow, Window};

/// Context needed to draw an instance.
pub(crate) struct Drawing<'a> {
    pub(crate) model: &'a Model,
    pub(crate) instances: &'a [Instance],
    pub(crate) window: Window,
    /// Clip-space plane beyond which geometry is clipped.
    pub(crate) plane: Option<[f32; 4]>,
    pub(crate) positions: &'a mut Positions,
    pub(crate) visible: &'a mut Visible,
    /// Bounds of the samples that became visible.
    pub(crate) touched: BoundingWindow,
    /// Receives every layer that is not behind a visible surface. If `None`, the nearest layer
    /// becomes the visible surface.
    pub(crate) layers: Option<Layers<'a>>,
}
