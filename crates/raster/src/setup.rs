//! Triangle setup: edge functions, depths, and the range of pixels that a triangle may cover.

use crate::clip::ClippedCorner;
use crate::instance::Instance;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask};
use crate::positions::{MAX_COORDINATE, SUBPIXELS};
use crate::raster::Drawing;
use crate::window::Window;

/// Extent, in subpixel units, from which blocks are needed, so that no product exceeds 32 bits.
const LARGE: i32 = 32 * SUBPIXELS;

/// Mesa swaps the first two corners of a triangle whose front is wound counter-clockwise.
#[inline(always)]
pub(crate) fn winding_order(counter_clockwise: bool) -> [usize; 3] {
    if counter_clockwise { [1, 0, 2] } else { [0, 1, 2] }
}

#[inline(always)]
pub(crate) fn extent([a, b, c]: &[I; 3]) -> [I; 2] {
    [a.min(*b).min(*c), a.max(*b).max(*c)]
}

#[inline(always)]
pub(crate) fn is_large(x: [I; 2], y: [I; 2]) -> Mask {
    let [is_wide, is_high] = [x, y].map(|[least, most]| (most - least).ge(I::splat(LARGE)));
    is_wide | is_high
}

/// True for edges that own the samples exactly on them: left and lower ones, the top-left rule in a
/// frame buffer object, whose first row is the lowest. `dx` is the difference of an edge's ends
/// along y, and `dy` along x: each is the direction in which it changes the edge's value.
#[inline(always)]
pub(crate) fn owns_samples(dx: I, dy: I) -> Mask {
    let zero = I::splat(0);
    dx.lt(zero) | dx.equals(zero) & dy.gt(zero)
}

#[derive(Default)]
pub(crate) struct Setup {
    /// Per edge: value at the corner of the first pair of pixels; non-negative inside.
    pub(crate) edge: [[i32; LANES]; 3],
    /// Change per lattice point, of which a pixel has eight along x and along y.
    pub(crate) along_x: [[i32; LANES]; 3],
    pub(crate) along_y: [[i32; LANES]; 3],
    /// Depth at the picture's corner, and its change per pixel.
    pub(crate) depth: [f32; LANES],
    pub(crate) depth_x: [f32; LANES],
    pub(crate) depth_y: [f32; LANES],
    /// Inclusive ranges of pixels.
    pub(crate) x: [[i32; LANES]; 2],
    pub(crate) y: [[i32; LANES]; 2],
    /// Bits of the triangles whose edge functions may exceed 32 bits.
    pub(crate) large: u32,
    pub(crate) corners: [[[i32; LANES]; 2]; 3],
}

impl Setup {
    /// Sets up eight triangles, whose corners are in these rows of the positions.
    #[inline(always)]
    pub(crate) fn eight(&mut self, drawing: &Drawing<'_>, rows: &[[u8; LANES]; 3]) {
        let corners = drawing.positions.corners(rows);
        let (x, y) = corners.snapped();
        let (extent_x, extent_y) = (extent(&x), extent(&y));
        let splat = |value: i32| I::splat(value);
        // The outermost samples of a pixel lie 32 of its 256 units inside its sides.
        let pixels = |[least, most]: [I; 2], window: [i32; 2]| {
            let from = ((least + splat(31)) >> 8i32).max(splat(window[0]));
            [from, ((most - splat(32)) >> 8i32).min(splat(window[1]))]
        };
        let (pixels_x, pixels_y) =
            (pixels(extent_x, drawing.window.x), pixels(extent_y, drawing.window.y));
        let (origin_x, origin_y) = ((pixels_x[0] & splat(!1)) << 8i32, pixels_y[0] << 8i32);
        for edge in 0..3 {
            let next = (edge + 1) % 3;
            let (dx, dy) = (y[edge] - y[next], x[edge] - x[next]);
            let value = dx * (x[edge] - origin_x) - dy * (y[edge] - origin_y);
            // Divided by the 32 units between lattice points; rounding down preserves the sign.
            let value = (value - owns_samples(dx, dy).ints() - splat(1)) >> 5i32;
            value.store(&mut self.edge[edge]);
            (-dx).store(&mut self.along_x[edge]);
            dy.store(&mut self.along_y[edge]);
            x[edge].store(&mut self.corners[edge][0]);
            y[edge].store(&mut self.corners[edge][1]);
        }
        self.large = is_large(extent_x, extent_y).bits();
        for end in 0..2 {
            pixels_x[end].store(&mut self.x[end]);
            pixels_y[end].store(&mut self.y[end]);
        }
        let [x, y, z] = corners.exact();
        let [at_corner, per_x, per_y] = Slopes::new(&x, &y).plane(&z);
        at_corner.store(&mut self.depth);
        per_x.store(&mut self.depth_x);
        per_y.store(&mut self.depth_y);
    }

    /// Sets up lane 0; false if the piece faces away, is degenerate, or is outside the window.
    pub(crate) fn clipped(
        &mut self,
        instance: &Instance,
        piece: &[ClippedCorner<()>; 3],
        window: Window,
    ) -> bool {
        let corners = winding_order(instance.counter_clockwise).map(|corner| piece[corner]);
        let snap = |value: f32| {
            let at = (value * SUBPIXELS as f32).round_ties_even() as i32;
            at.clamp(-MAX_COORDINATE, MAX_COORDINATE)
        };
        let [x, y] = [0, 1].map(|axis| corners.map(|corner| snap(corner.window[axis])));
        let product = |a: i32, b: i32| i64::from(a) * i64::from(b);
        let area = product(x[0] - x[1], y[2] - y[0]) - product(x[2] - x[0], y[0] - y[1]);
        if area <= 0 {
            return false;
        }
        let least = |values: [i32; 3]| (values[0].min(values[1]).min(values[2]) + 31) >> 8i32;
        let most = |values: [i32; 3]| (values[0].max(values[1]).max(values[2]) - 32) >> 8i32;
        let pixels_x = [least(x).max(window.x[0]), most(x).min(window.x[1])];
        let pixels_y = [least(y).max(window.y[0]), most(y).min(window.y[1])];
        if pixels_x[0] > pixels_x[1] || pixels_y[0] > pixels_y[1] {
            return false;
        }
        for end in 0..2 {
            self.x[end][0] = pixels_x[end];
            self.y[end][0] = pixels_y[end];
        }
        let extent = |values: [i32; 3]| {
            let [a, b, c] = values;
            a.max(b).max(c) - a.min(b).min(c)
        };
        self.large = u32::from(extent(x).max(extent(y)) >= LARGE);
        let origin = [pixels_x[0] & !1, pixels_y[0]].map(|pixel| pixel * SUBPIXELS);
        for edge in 0..3 {
            let next = (edge + 1) % 3;
            let (dx, dy) = (y[edge] - y[next], x[edge] - x[next]);
            if self.large == 0 {
                let value = dx * (x[edge] - origin[0]) - dy * (y[edge] - origin[1]);
                let owned = i32::from(dx < 0 || dx == 0 && dy > 0);
                self.edge[edge][0] = (value + owned - 1) >> 5i32;
            }
            self.along_x[edge][0] = -dx;
            self.along_y[edge][0] = dy;
            self.corners[edge][0][0] = x[edge];
            self.corners[edge][1][0] = y[edge];
        }
        let [x, y, z] = [0, 1, 2].map(|axis| corners.map(|corner| F::splat(corner.window[axis])));
        let slopes = Slopes::new(&x, &y).plane(&z);
        [self.depth[0], self.depth_x[0], self.depth_y[0]] = slopes.map(|slope| slope.as_array()[0]);
        true
    }
}

/// Coefficients that interpolate from three corners, with llvmpipe's order of operations.
pub(crate) struct Slopes {
    x: F,
    y: F,
    dx01: F,
    dy01: F,
    dx20: F,
    dy20: F,
}

impl Slopes {
    #[inline(always)]
    pub(crate) fn new(x: &[F; 3], y: &[F; 3]) -> Self {
        let (dx01, dy01) = (x[0] - x[1], y[0] - y[1]);
        let (dx20, dy20) = (x[2] - x[0], y[2] - y[0]);
        let over_area = F::splat(1.0) / (dx01 * dy20 - dy01 * dx20);
        Self {
            x: x[0],
            y: y[0],
            dx01: dx01 * over_area,
            dy01: dy01 * over_area,
            dx20: dx20 * over_area,
            dy20: dy20 * over_area,
        }
    }

    #[inline(always)]
    pub(crate) fn each(&self) -> [Self; LANES] {
        let Self { x, y, dx01, dy01, dx20, dy20 } = self;
        std::array::from_fn(|lane| {
            let broadcast = |all: &F| F::splat(all.as_array()[lane]);
            Self {
                x: broadcast(x),
                y: broadcast(y),
                dx01: broadcast(dx01),
                dy01: broadcast(dy01),
                dx20: broadcast(dx20),
                dy20: broadcast(dy20),
            }
        })
    }

    /// Returns the value at the picture's corner, and its changes per pixel.
    #[inline(always)]
    pub(crate) fn plane(&self, values: &[F; 3]) -> [F; 3] {
        let (d01, d20) = (values[0] - values[1], values[2] - values[0]);
        let per_x = d01 * self.dy20 - d20 * self.dy01;
        let per_y = d20 * self.dx01 - d01 * self.dx20;
        let at_corner = values[0] - (per_x * self.x + per_y * self.y);
        [at_corner, per_x, per_y]
    }
}
