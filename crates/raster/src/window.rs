use std::ops::Range;

/// Rectangle of pixels in a picture; the ends are inclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) x: [i32; 2],
    pub(crate) y: [i32; 2],
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct BoundingWindow {
    low: [i32; 2],
    high: [i32; 2],
}

impl BoundingWindow {
    pub(crate) const EMPTY: Self = Self { low: [i32::MAX; 2], high: [i32::MIN; 2] };

    /// Adds an inclusive range of pixels.
    #[inline(always)]
    pub(crate) fn add(&mut self, x: [i32; 2], y: [i32; 2]) {
        let Self { low, high } = self;
        *low = [low[0].min(x[0]), low[1].min(y[0])];
        *high = [high[0].max(x[1]), high[1].max(y[1])];
    }

    pub(crate) fn window(&self) -> Option<Window> {
        let Self { low, high } = *self;
        (low[0] <= high[0]).then_some(Window { x: [low[0], high[0]], y: [low[1], high[1]] })
    }
}

impl Window {
    pub(crate) fn whole(width: usize, height: usize) -> Self {
        Self { x: [0, width as i32 - 1], y: [0, height as i32 - 1] }
    }

    pub(crate) fn pixel(x: i32, y: i32) -> Self {
        Self { x: [x, x], y: [y, y] }
    }

    pub(crate) fn enclosing(self, other: Self) -> Self {
        let range = |a: [i32; 2], b: [i32; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self { x: range(self.x, other.x), y: range(self.y, other.y) }
    }

    pub(crate) fn union(first: Option<Self>, second: Option<Self>) -> Option<Self> {
        match (first, second) {
            (Some(first), Some(second)) => Some(first.enclosing(second)),
            (first, second) => first.or(second),
        }
    }

    pub(crate) fn rows(self, stride: usize) -> impl Iterator<Item = Range<usize>> {
        let [left, right] = self.x.map(|x| x as usize);
        (self.y[0]..=self.y[1]).map(move |y| {
            let row = y as usize * stride;
            row + left..row + right + 1
        })
    }
}
