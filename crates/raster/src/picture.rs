//! A picture being drawn: the visible surfaces of some instances, and the colours of their samples.

use crate::instance::{Instance, View};
use crate::light::Lighting;
use crate::model::Model;
use crate::positions::Positions;
use crate::raster;
use crate::raster::Drawing;
use crate::shade::{self, Content, Lists};
use crate::visible::{SAMPLES, Visible};
use crate::window::{BoundingWindow, Window};

#[derive(Default)]
pub(crate) struct Picture {
    pub(crate) instances: Vec<Instance>,
    pub(crate) visible: Visible,
    /// Colours of all samples, red in the lowest byte.
    pub(crate) samples: Vec<[u32; SAMPLES]>,
}

#[derive(Clone, Copy)]
pub(crate) struct Pass<'a> {
    pub(crate) model: &'a Model,
    /// For each texture: the bytes of its largest mipmap level.
    pub(crate) largest_levels: &'a [&'a [u8]],
    pub(crate) view: &'a View,
    pub(crate) light: Lighting<'a>,
    pub(crate) window: Window,
}

#[derive(Default)]
pub(crate) struct Workspace {
    pub(crate) positions: Box<Positions>,
    pub(crate) lists: Lists,
    order: Vec<usize>,
}

/// Per set of samples: for each sample, a mask with all bits set if the sample is in the set.
const SAMPLE_MASKS: [[u32; SAMPLES]; 1 << SAMPLES] = {
    let mut masks = [[0; SAMPLES]; 1 << SAMPLES];
    let mut at = 0;
    while at < SAMPLES << SAMPLES {
        let (set, sample) = (at / SAMPLES, at % SAMPLES);
        if set & (1 << sample) != 0 {
            masks[set][sample] = u32::MAX;
        }
        at += 1;
    }
    masks
};

impl Picture {
    /// Removes all instances, sets the picture's size in pixels, and clears a window of it.
    pub(crate) fn clear(&mut self, size: [usize; 2], window: Window) {
        self.instances.clear();
        self.visible.clear(size, window);
        let stride = self.visible.stride;
        self.samples.resize(stride * size[1], [0; SAMPLES]);
        for row in window.rows(stride) {
            self.samples[row].fill([0; SAMPLES]);
        }
    }

    /// Near instances come first, since they occlude much of the distant ones.
    pub(crate) fn rasterise(&mut self, pass: Pass<'_>, first: usize, work: &mut Workspace) {
        work.order.clear();
        work.order.extend(first..self.instances.len());
        let distance = |at: &usize| self.instances[*at].distance;
        work.order.sort_unstable_by(|a, b| distance(a).total_cmp(&distance(b)));
        for index in &work.order {
            let mut drawing = Drawing {
                model: pass.model,
                instances: &self.instances,
                window: pass.window,
                plane: pass.view.clip,
                positions: &mut work.positions,
                visible: &mut self.visible,
                touched: BoundingWindow::EMPTY,
                layers: None,
            };
            raster::draw(*index, &mut drawing);
            let touched = drawing.touched.window();
            self.instances[*index].window = touched;
            self.visible.touched = Window::union(self.visible.touched, touched);
        }
    }

    pub(crate) fn paint(&mut self, pass: Pass<'_>, first: usize, work: &mut Workspace) {
        let Some(window) = self.visible.touched else {
            return;
        };
        let (visible, lists) = (&self.visible, &mut work.lists);
        lists.clear(first, visible.records.len(), pass.model.textures.len());
        shade::list_fragments(visible, &self.instances, window, lists);
        let content = Content::Colours(pass.light);
        shade::compute_surfaces(pass.model, visible, &self.instances, content, lists);
        let (stride, samples) = (visible.stride, &mut self.samples);
        shade::colour(pass.model, pass.largest_levels, lists, |fragment, colour| {
            let pixel = &mut samples[fragment.y() * stride + fragment.x()];
            let masks = SAMPLE_MASKS[fragment.samples()];
            for (value, mask) in pixel.iter_mut().zip(masks) {
                *value = *value & !mask | colour & mask;
            }
        });
    }
}
