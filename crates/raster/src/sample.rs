//! Texture sampling at eight places, with llvmpipe's arithmetic: 8 bits for flat textures in linear
//! colours, single precision for sRGB textures and cubes.

use bytemuck::cast;

use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask, i16x16};
use crate::texture::{Level, SRGB_LINEAR_FACTOR, SRGB_LINEAR_TO, SRGB_POLYNOMIAL, Texels};

/// Red, green, blue and opacity, 0 to 1.
pub(crate) type Colour = [F; 4];
const CHANNELS: usize = 4;
const OVER_255: f32 = 1.0 / 255.0;

#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub(crate) at: [F; 3],
}

/// `corner`, `right` and `above` are places of three pixels of each place's 2 × 2 quad, which uses
/// the level of detail of its first pixel.
#[inline(always)]
pub(crate) fn flat(
    texels: Texels<'_>,
    is_srgb: bool,
    place: Place,
    [corner, right, above]: [Place; 3],
) -> Colour {
    let changes = [right, above].map(|to| [0, 1].map(|axis| to.at[axis] - corner.at[axis]));
    let levels = Levels::choose(texels, footprint(texels, changes));
    let [s, t, _] = place.at;
    match is_srgb {
        false => flat_in_bytes(texels, &levels, s, t),
        true => flat_in_floats(texels, &levels, s, t),
    }
}

/// `beside` and `over` are the directions of the neighbours along x and y in each 2 × 2 quad, on
/// either side: every pixel has its own level of detail.
#[inline(always)]
pub(crate) fn cube(texels: Texels<'_>, place: Place, [beside, over]: [Place; 2]) -> Colour {
    let changes = [beside, over].map(|to| [0, 1, 2].map(|axis| to.at[axis] - place.at[axis]));
    let (face, changes) = Face::new(&place, &changes);
    let levels = Levels::choose(texels, footprint(texels, changes));
    let first = sample_cube_level(texels, &levels.first, &face);
    if levels.is_single {
        return first;
    }
    mix_colours(first, sample_cube_level(texels, &levels.second, &face), levels.share)
}

/// Returns the larger of the squared lengths of two differences, in texels of the largest level.
#[inline(always)]
fn footprint(texels: Texels<'_>, changes: [[F; 2]; 2]) -> F {
    let base = texels.texture.levels[0];
    let size = [base.width as f32, base.height as f32].map(F::splat);
    let [a, b] = changes.map(|change| {
        let (s, t) = (change[0] * size[0], change[1] * size[1]);
        s * s + t * t
    });
    a.max(b)
}

struct Levels {
    first: [u8; LANES],
    second: [u8; LANES],
    /// Weight of the second level, 0 to 1.
    share: F,
    is_single: bool,
}

impl Levels {
    /// Chooses levels from the squared size of a pixel in texels of the largest level.
    #[inline(always)]
    fn choose(texels: Texels<'_>, square: F) -> Self {
        let int = |value: i32| I::splat(value);
        // Half the binary logarithm, approximated by the exponent plus the mantissa − 1.
        let bits = square.to_signed_bits();
        let exponent = ((bits >> 23i32) & int(255)) - int(128);
        let mantissa = F::from_signed_bits((bits & int(0x007f_ffff)) | int(0x3f80_0000));
        let exponent: F = exponent.float();
        let detail = (exponent + mantissa) * F::splat(0.5);
        let floor = detail.floor();
        let level: I = floor.truncate_to_int();
        let last = int(texels.texture.levels.len() as i32 - 1);
        let between = level.ge(int(0)) & level.lt(last);
        let first = level.max(int(0)).min(last);
        let share = between.select(detail - floor, F::splat(0.0));
        let second = between.select_ints(first + int(1), first);
        let narrow = |values: I| -> [u8; LANES] {
            let values: [i32; LANES] = values.into();
            values.map(|value| value as u8)
        };
        Self {
            first: narrow(first),
            second: narrow(second),
            is_single: !share.gt(F::splat(0.0)).any(),
            share,
        }
    }
}

struct Sizes {
    width: I,
    height: I,
    start: I,
    image: I,
}

impl Sizes {
    #[inline(always)]
    fn new(texels: Texels<'_>, levels: &[u8; LANES]) -> Self {
        let first = levels[0];
        if levels.iter().all(|level| *level == first) {
            let level = &texels.texture.levels[usize::from(first)];
            let splat = |value: usize| I::splat(value as i32);
            return Self {
                width: splat(level.width),
                height: splat(level.height),
                start: splat(level.start),
                image: splat(level.image),
            };
        }
        let each = |part: fn(&Level) -> usize| {
            let mut values = [0; LANES];
            for (value, level) in values.iter_mut().zip(levels) {
                *value = part(&texels.texture.levels[usize::from(*level)]) as i32;
            }
            I::new(values)
        };
        Self {
            width: each(|level| level.width),
            height: each(|level| level.height),
            start: each(|level| level.start),
            image: each(|level| level.image),
        }
    }
}

/// Fetches eight texels. Sampling never produces indices out of range.
#[inline(always)]
fn fetch(texels: Texels<'_>, at: I) -> I {
    I::new(texels.eight(&at.into()).map(u32::cast_signed))
}

/// Two texels in each of eight rows; with `is_beside` the second ones follow the first.
#[inline(always)]
fn fetch_two(texels: Texels<'_>, row: I, [x0, x1]: [I; 2], is_beside: bool) -> [I; 2] {
    let pairs = if is_beside { texels.eight_pairs(&(row + x0).into()) } else { None };
    match pairs {
        Some(pairs) => pairs.map(|texels| I::new(texels.map(u32::cast_signed))),
        None => [fetch(texels, row + x0), fetch(texels, row + x1)],
    }
}

/// Texels around places of a flat texture, and the second texel's weight along each axis.
struct Neighbours<W> {
    texels: [I; 4],
    shares: [W; 2],
}

#[inline(always)]
fn fetch_neighbours<W>(
    texels: Texels<'_>,
    sizes: &Sizes,
    (x, share_x): (I, W),
    (y, share_y): (I, W),
) -> Neighbours<W> {
    let one = I::splat(1);
    let next = |at: I, size: I| {
        let is_last = at.equals(size - one);
        is_last.select_ints(I::splat(0), at + one)
    };
    let (x1, y1) = (next(x, sizes.width), next(y, sizes.height));
    let row0 = sizes.start + y * sizes.width;
    let row1 = sizes.start + y1 * sizes.width;
    let is_beside = x1.equals(x + one).all();
    let [a, b] = fetch_two(texels, row0, [x, x1], is_beside);
    let [c, d] = fetch_two(texels, row1, [x, x1], is_beside);
    Neighbours { texels: [a, b, c, d], shares: [share_x, share_y] }
}

#[inline(always)]
fn flat_in_bytes(texels: Texels<'_>, levels: &Levels, s: F, t: F) -> Colour {
    let sample_level = |level: &[u8; LANES]| {
        let sizes = Sizes::new(texels, level);
        let base = &texels.texture.levels[0];
        let x = texel_in_256ths(s, sizes.width, base.width.is_power_of_two());
        let y = texel_in_256ths(t, sizes.height, base.height.is_power_of_two());
        let Neighbours { texels: [a, b, c, d], shares: [u, v] } =
            fetch_neighbours(texels, &sizes, x, y);
        let (u, v) = (Share::new(u), Share::new(v));
        let top = Bytes::new(a).blended(&Bytes::new(b), u);
        top.blended(&Bytes::new(c).blended(&Bytes::new(d), u), v)
    };
    let mut colour = sample_level(&levels.first);
    if !levels.is_single {
        let share: I = (levels.share * F::splat(256.0)).truncate_to_int();
        colour = colour.blended(&sample_level(&levels.second), Share::new(share));
    }
    let Bytes([even, odd]) = colour;
    let (even, odd): (I, I) = (cast(even), cast(odd));
    [even & I::splat(255), odd & I::splat(255), even >> 16i32, odd >> 16i32].map(|part| {
        let part: F = part.float();
        part * F::splat(OVER_255)
    })
}

/// Eight texels with 16 bits per channel: red and blue, green and opacity.
struct Bytes([i16x16; 2]);

/// A weight in 256ths for each channel of eight texels, in the form that [`Bytes::blended`] needs.
#[derive(Clone, Copy)]
struct Share(i16x16);

impl Share {
    #[inline(always)]
    fn new(share: I) -> Self {
        // Weights in 256ths are shifted to 32,768ths; the product is rounded to integers.
        Self(cast((share << 7i32) | (share << 23i32)))
    }
}

impl Bytes {
    #[inline(always)]
    fn new(texels: I) -> Self {
        let even = I::splat(0x00ff_00ff);
        Self([cast(texels & even), cast((texels >> 8i32) & even)])
    }

    /// Interpolates between values of 0 to 255.
    #[inline(always)]
    fn blended(&self, to: &Self, Share(share): Share) -> Self {
        let blend = |from: i16x16, to: i16x16| {
            let change = (to - from).mul_scale_round(share);
            (from + change) & i16x16::splat(255)
        };
        Self([blend(self.0[0], to.0[0]), blend(self.0[1], to.0[1])])
    }
}

/// The texel before a place of a repeating texture, and the distance from it in 256ths.
#[inline(always)]
fn texel_in_256ths(at: F, size: I, is_power_of_two: bool) -> (I, I) {
    let int = |value: i32| I::splat(value);
    if is_power_of_two {
        let scale: F = (size << 8i32).float();
        let place: I = (at * scale).round_to_int();
        let place = place - int(128);
        return ((place >> 8i32) & (size - int(1)), place & int(255));
    }
    let size_as_float: F = size.float();
    let fraction = at - at.floor();
    let place = fraction * size_as_float * F::splat(256.0);
    let place: I = place.round_to_int();
    let place = place - int(128);
    let texel = place >> 8i32;
    let texel = texel.lt(int(0)).select_ints(size - int(1), texel);
    (texel.min(size - int(1)).max(int(0)), place & int(255))
}

#[inline(always)]
fn flat_in_floats(texels: Texels<'_>, levels: &Levels, s: F, t: F) -> Colour {
    let sample_level = |level: &[u8; LANES]| {
        let sizes = Sizes::new(texels, level);
        let base = &texels.texture.levels[0];
        let x = texel_and_share(s, sizes.width, base.width.is_power_of_two());
        let y = texel_and_share(t, sizes.height, base.height.is_power_of_two());
        let Neighbours { texels, shares } = fetch_neighbours(texels, &sizes, x, y);
        mix_four(texels, shares, true)
    };
    let first = sample_level(&levels.first);
    if levels.is_single {
        return first;
    }
    mix_colours(first, sample_level(&levels.second), levels.share)
}

#[inline(always)]
fn mix_colours(first: Colour, second: Colour, share: F) -> Colour {
    [0, 1, 2, 3].map(|channel| mix(first[channel], second[channel], share))
}

#[inline(always)]
fn mix(from: F, to: F, share: F) -> F {
    share.fused(to - from, from)
}

#[inline(always)]
fn mix_four(texels: [I; 4], [u, v]: [F; 2], is_srgb: bool) -> Colour {
    [0, 1, 2, 3].map(|channel: u32| {
        let [a, b, c, d] = texels.map(|texel| {
            let part = (texel >> (8 * channel as i32)) & I::splat(255);
            let part: F = part.float();
            if is_srgb && channel < 3 { linear(part) } else { part * F::splat(OVER_255) }
        });
        mix(mix(a, b, u), mix(c, d, u), v)
    })
}

/// Converts sRGB of 0 to 255 to linear values of 0 to 1.
#[inline(always)]
fn linear(value: F) -> F {
    let splat = |value: f32| F::splat(value);
    let [c0, c1, c2, c3] = SRGB_POLYNOMIAL.map(splat);
    let square = value * value;
    let even = square.fused(c2, c0);
    let odd = square.fused(c3, c1);
    let curved = odd.fused(value, even);
    let straight = value * splat(SRGB_LINEAR_FACTOR);
    value.le(splat(SRGB_LINEAR_TO)).select(straight, curved)
}

/// Like [`texel_in_256ths`], with the distance as a fraction.
#[inline(always)]
fn texel_and_share(at: F, size: I, is_power_of_two: bool) -> (I, F) {
    let int = |value: i32| I::splat(value);
    let size_as_float: F = size.float();
    let half = F::splat(0.5);
    let at = if is_power_of_two { at } else { at - at.floor() };
    let place = at * size_as_float - half;
    let floor = place.floor();
    let texel: I = floor.truncate_to_int();
    let texel = if is_power_of_two {
        texel & (size - int(1))
    } else {
        let texel = texel.lt(int(0)).select_ints(size - int(1), texel);
        texel.min(size - int(1)).max(int(0))
    };
    (texel, place - floor)
}

struct Face {
    number: I,
    s: F,
    t: F,
}

impl Face {
    /// Faces, and the derivatives of the places on them for two changes of direction.
    #[inline(always)]
    fn new(place: &Place, changes: &[[F; 3]; 2]) -> (Self, [[F; 2]; 2]) {
        let [x, y, z] = place.at;
        let half = F::splat(0.5);
        let widest_is_x = x.abs().gt(y.abs());
        let is_z = z.abs().ge(x.abs().max(y.abs()));
        let choose = |x: F, y: F, z: F| is_z.select(z, widest_is_x.select(x, y));
        let major = choose(x, y, z);
        let sign = |value: F| {
            let signs: I = major.to_signed_bits() & I::splat(i32::MIN);
            F::from_signed_bits(value.to_signed_bits() ^ signs)
        };
        let on_face = |[x, y, z]: [F; 3]| [choose(sign(-z), x, sign(x)), choose(-y, sign(z), -y)];
        let over_major = F::splat(1.0) / major;
        let half_over_major = half * over_major;
        let [s, t] = on_face(place.at);
        let changes = changes.map(|change| {
            let along = choose(change[0], change[1], change[2]) * over_major;
            let [ds, dt] = on_face(change);
            [(ds - along * s) * half_over_major, (dt - along * t) * half_over_major]
        });
        let int = |value: i32| I::splat(value);
        let axis = is_z.select_ints(int(4), widest_is_x.select_ints(int(0), int(2)));
        let is_negative = (major.to_signed_bits() >> 31i32) & int(1);
        let face = Self {
            number: axis | is_negative,
            s: s * half_over_major.abs() + half,
            t: t * half_over_major.abs() + half,
        };
        (face, changes)
    }
}

#[inline(always)]
fn sample_cube_level(cube: Texels<'_>, level: &[u8; LANES], face: &Face) -> Colour {
    let sizes = Sizes::new(cube, level);
    let int = |value: i32| I::splat(value);
    let side: F = sizes.width.float();
    let place = |at: F| {
        let place = at.max(F::splat(0.0)) * side - F::splat(0.5);
        let floor = place.floor();
        let texel: I = floor.truncate_to_int();
        // Directions too short for a valid face are clamped.
        let texel = texel.max(int(-1)).min(sizes.width);
        (texel, place - floor)
    };
    let ((x, u), (y, v)) = (place(face.s), place(face.t));
    let last = sizes.width - int(1);
    let inside = |at: I| at.ge(int(0)) & at.lt(last);
    let is_inside: Mask = inside(x) & inside(y);
    // Places that extend over an edge are clamped here and resampled below.
    let clamped = |at: I| at.max(int(0)).min(last);
    let (x0, x1) = (clamped(x), clamped(x + int(1)));
    let (y0, y1) = (clamped(y), clamped(y + int(1)));
    let start = sizes.start + face.number * sizes.image;
    let (row0, row1) = (start + y0 * sizes.width, start + y1 * sizes.width);
    let is_beside = x1.equals(x0 + int(1)).all();
    let [a, b] = fetch_two(cube, row0, [x0, x1], is_beside);
    let [c, d] = fetch_two(cube, row1, [x0, x1], is_beside);
    let mut colour = mix_four([a, b, c, d], [u, v], false);
    if !is_inside.all() {
        let bits = is_inside.bits();
        for lane in (0..LANES).filter(|lane| bits & (1 << lane) == 0) {
            let at = EdgePlace {
                level: &cube.texture.levels[usize::from(level[lane])],
                face: face.number.as_array()[lane],
                x: x.as_array()[lane],
                y: y.as_array()[lane],
                shares: [u.as_array()[lane], v.as_array()[lane]],
            };
            for (channel, value) in blend_over_edge(cube, &at).into_iter().enumerate() {
                colour[channel].as_mut_array()[lane] = value;
            }
        }
    }
    colour
}

struct EdgePlace<'a> {
    level: &'a Level,
    face: i32,
    /// Column and row of the first of the four texels around the place; may be out of range.
    x: i32,
    y: i32,
    shares: [f32; 2],
}

/// Blends the four texels around a place, of which those beyond an edge are on a neighbouring face.
/// At a corner of the cube, blends the three texels that meet there.
#[inline(never)]
fn blend_over_edge(cube: Texels<'_>, at: &EdgePlace<'_>) -> [f32; CHANNELS] {
    let side = at.level.width as i32;
    let is_beyond_edge = |index: i32| index < 0 || index >= side;
    let places = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (at.x + dx, at.y + dy));
    let texels = places.map(|(x, y)| match (is_beyond_edge(x), is_beyond_edge(y)) {
        (true, true) => None,
        (false, false) => Some(texel(cube, at.level, at.face, x, y)),
        _ => {
            let (face, x, y) = neighbour(side, at.face, x, y);
            Some(texel(cube, at.level, face, x, y))
        }
    });
    let [u, v] = at.shares;
    if let [Some(a), Some(b), Some(c), Some(d)] = texels {
        let mix = |a: f32, b: f32, share: f32| share.mul_add(b - a, a);
        return std::array::from_fn(|channel| {
            let top = mix(a[channel], b[channel], u);
            mix(top, mix(c[channel], d[channel], u), v)
        });
    }
    let (left, upper) = (1.0 - u, 1.0 - v);
    let mut weights = [left * upper, u * upper, left * v, u * v];
    let missing = texels.iter().position(Option::is_none).unwrap_or(0);
    let spread = weights[missing] * (1.0 / 3.0);
    weights = std::array::from_fn(|at| if at == missing { 0.0 } else { weights[at] + spread });
    std::array::from_fn(|channel| {
        let parts: [f32; 4] = std::array::from_fn(|at| {
            weights[at] * texels[at].map_or(0.0, |texel: [f32; CHANNELS]| texel[channel])
        });
        parts[3] + (parts[2] + (parts[1] + parts[0]))
    })
}

fn texel(cube: Texels<'_>, level: &Level, face: i32, x: i32, y: i32) -> [f32; CHANNELS] {
    let inside = |index: i32| (index.max(0) as usize).min(level.width - 1);
    let at = level.start + face as usize * level.image + inside(y) * level.width + inside(x);
    cube.at(at).to_le_bytes().map(|part| f32::from(part) * OVER_255)
}

/// Face, column and row of the texel beyond an edge of `face`, where `x` or `y` is out of range.
fn neighbour(side: i32, face: i32, x: i32, y: i32) -> (i32, i32, i32) {
    // Coordinates across each face from -`side` to `side`, in half texels, clamped to the edge.
    let on_face = |index: i32| (2 * index + 1 - side).clamp(-side, side);
    let (s, t, edge) = (on_face(x), on_face(y), side);
    let [dx, dy, dz] = match face {
        0 => [edge, -t, -s],
        1 => [-edge, -t, s],
        2 => [s, edge, t],
        3 => [s, -edge, -t],
        4 => [s, -t, edge],
        _ => [-s, -t, -edge],
    };
    // It is on the other axis whose coordinate is at the edge.
    let is_own_axis = |axis: i32| face / 2 == axis;
    let (face, s, t) = if dx.abs() == side && !is_own_axis(0) {
        (i32::from(dx < 0), if dx < 0 { dz } else { -dz }, -dy)
    } else if dy.abs() == side && !is_own_axis(1) {
        (2 + i32::from(dy < 0), dx, if dy < 0 { -dz } else { dz })
    } else {
        (4 + i32::from(dz < 0), if dz < 0 { -dx } else { dx }, -dy)
    };
    let index = |place: i32| ((place + side) / 2).clamp(0, side - 1);
    (face, index(s), index(t))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossing_an_edge_twice_returns_to_the_same_texel() {
        let side = 4;
        for face in 0..6 {
            for along in 0..side {
                for (x, y) in [(-1, along), (side, along), (along, -1), (along, side)] {
                    let (next, next_x, next_y) = neighbour(side, face, x, y);
                    assert_ne!(next / 2, face / 2, "a neighbour is on another axis");
                    let inside = (x.clamp(0, side - 1), y.clamp(0, side - 1));
                    let returns = [(-1, 0), (1, 0), (0, -1), (0, 1)]
                        .map(|(dx, dy)| (next_x + dx, next_y + dy))
                        .into_iter()
                        .filter(|(x, y)| !(0..side).contains(x) || !(0..side).contains(y))
                        .map(|(x, y)| neighbour(side, next, x, y))
                        .any(|place| place == (face, inside.0, inside.1));
                    assert!(returns, "face {face}, {x} {y} to {next}, {next_x} {next_y}");
                }
            }
        }
    }
}
