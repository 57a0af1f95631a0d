//! From what is visible to colours: every triangle that is seen in a pixel is
//! coloured once, at the pixel's centre, for all samples that it has there.

use crate::clip::VARYING;
use crate::instance::Instance;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES};
use crate::light::{EyeLight, Shading};
use crate::model::Model;
use crate::sample::{self, Place};
use crate::surface::{self, COLOUR, COORDINATES, OPACITY, OVER_W, Surface, Vertices, Wanted};
use crate::texture::{Texels, TextureKind};
use crate::visible::{CLIPPED, NOTHING, Record, SAMPLES, Visible};
use crate::window::Window;

/// A triangle in a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Fragment {
    pub(crate) x: u16,
    pub(crate) y: u16,
    /// Its place among the surfaces.
    pub(crate) surface: u32,
    /// Bits of the samples that it has; where they go is the caller's.
    pub(crate) samples: u32,
}

/// Lists that are used again from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Lists {
    pub(crate) surfaces: Vec<Surface>,
    /// Of each record its surface, or [`NOTHING`].
    of_record: Vec<u32>,
    /// Of each surface its instance.
    instances: Vec<u32>,
    /// What is worked out of one cluster.
    wanted: Vec<Wanted>,
    vertices: Box<Vertices>,
    /// By texture; the last without any.
    pub(crate) fragments: Vec<Vec<Fragment>>,
}

impl Lists {
    pub(crate) fn clear(&mut self, records: usize, textures: usize) {
        self.instances.clear();
        self.of_record.clear();
        self.of_record.resize(records, NOTHING);
        self.fragments.resize_with(textures + 1, Vec::new);
        self.fragments.iter_mut().for_each(Vec::clear);
    }

    /// The surface of a record, to be worked out later; and its instance.
    #[inline(always)]
    pub(crate) fn surface_of(&mut self, id: u32, records: &[Record]) -> (u32, u32) {
        let known = self.of_record[id as usize];
        if known != NOTHING {
            return (known, self.instances[known as usize]);
        }
        let (surface, instance) = (self.instances.len() as u32, records[id as usize].instance);
        self.of_record[id as usize] = surface;
        self.instances.push(instance);
        (surface, instance)
    }

    /// Which list the fragments of an instance are in.
    #[inline(always)]
    pub(crate) fn list_of(&self, instance: &Instance) -> usize {
        instance.texture.unwrap_or(self.fragments.len() - 1)
    }
}

/// Lists the fragments of a window whose records are `first` or later ones.
pub(crate) fn list_fragments(
    visible: &Visible,
    instances: &[Instance],
    window: Window,
    first: u32,
    lists: &mut Lists,
) {
    for y in window.y[0]..window.y[1] + 1 {
        let row = y as usize * visible.stride;
        let mut last = (NOTHING, 0, 0);
        for x in window.x[0]..window.x[1] + 1 {
            let at = (row + x as usize) * SAMPLES;
            let ids: [u32; SAMPLES] = visible.ids[at..at + SAMPLES].try_into().expect("four");
            let [id, ..] = ids;
            if id == last.0 && id != NOTHING && ids == [id; SAMPLES] {
                lists.fragments[last.2].push(Fragment {
                    x: x as u16,
                    y: y as u16,
                    surface: last.1,
                    samples: 0xf,
                });
                continue;
            }
            let mut left = 0xfu32;
            while left != 0 {
                let sample = left.trailing_zeros() as usize;
                let id = ids[sample];
                let same =
                    (0..SAMPLES).fold(0, |bits, other| bits | u32::from(ids[other] == id) << other);
                left &= !same;
                if id == NOTHING || id < first {
                    continue;
                }
                if id != last.0 {
                    let (surface, instance) = lists.surface_of(id, &visible.records);
                    last = (id, surface, lists.list_of(&instances[instance as usize]));
                }
                lists.fragments[last.2].push(Fragment {
                    x: x as u16,
                    y: y as u16,
                    surface: last.1,
                    samples: same,
                });
            }
        }
    }
}

/// Works out the surfaces that were listed.
#[inline(always)]
pub(crate) fn work_out_surfaces(
    model: &Model,
    visible: &Visible,
    instances: &[Instance],
    lights: &[EyeLight],
    lists: &mut Lists,
) {
    // What is left of another frame is overwritten before it is read.
    if lists.surfaces.len() < lists.instances.len() {
        lists
            .surfaces
            .resize(lists.instances.len(), Surface::default());
    }
    let size = [visible.width as f32, visible.height as f32];
    let Lists {
        surfaces,
        of_record,
        wanted,
        vertices,
        ..
    } = lists;
    let mut shading = ShadingOf { lights, last: None };
    let mut records = visible.records.iter().zip(&*of_record).peekable();
    while let Some((record, surface)) = records.next() {
        if *surface == NOTHING {
            continue;
        }
        let instance = &instances[record.instance as usize];
        let mesh = instance.mesh.of(model);
        let shading = shading.of(record.instance, instance);
        if record.positions == CLIPPED {
            surfaces[*surface as usize] =
                surface::work_out_clipped(instance, mesh, shading, visible, record);
            continue;
        }
        wanted.clear();
        wanted.push(Wanted {
            triangle: record.triangle,
            surface: *surface,
        });
        let is_of_same =
            |next: &Record| (next.instance, next.positions) == (record.instance, record.positions);
        while let Some((next, surface)) = records.next_if(|(next, _)| is_of_same(next)) {
            if *surface != NOTHING {
                wanted.push(Wanted {
                    triangle: next.triangle,
                    surface: *surface,
                });
            }
        }
        let cluster = (record.positions, wanted.as_slice());
        surface::work_out(instance, mesh, shading, size, cluster, vertices, surfaces);
    }
}

/// The shading of the instance that was asked for last.
struct ShadingOf<'a> {
    lights: &'a [EyeLight],
    last: Option<(u32, Option<Shading<'a>>)>,
}

impl<'a> ShadingOf<'a> {
    /// None if lights do not make its colour.
    fn of(&mut self, index: u32, instance: &Instance) -> Option<&Shading<'a>> {
        if self.last.as_ref().is_none_or(|(last, _)| *last != index) {
            let shading = instance.is_lit.then(|| Shading::new(instance, self.lights));
            self.last = Some((index, shading));
        }
        self.last.as_ref().and_then(|(_, shading)| shading.as_ref())
    }
}

/// Colours the fragments of every list; each goes to `paint` with its colour,
/// red in the lowest byte.
#[inline(always)]
pub(crate) fn colour(
    model: &Model,
    largest: &[&[u8]],
    lists: &Lists,
    mut paint: impl FnMut(&Fragment, u32),
) {
    for (texture, fragments) in lists.fragments.iter().enumerate() {
        let largest = largest.get(texture).copied();
        let texture = model.textures.get(texture).zip(largest);
        let texture = texture.map(|(texture, largest)| Texels::new(texture, largest));
        for part in fragments.chunks(LANES) {
            let mut eight = [part[0]; LANES];
            eight[..part.len()].copy_from_slice(part);
            let colours = colour_eight(texture, &lists.surfaces, &eight);
            for (fragment, colour) in part.iter().zip(colours) {
                paint(fragment, colour);
            }
        }
    }
}

/// One of a surface's numbers for each of eight fragments.
#[derive(Clone, Copy)]
struct Planes {
    at_corner: F,
    per_x: F,
    per_y: F,
}

impl Planes {
    /// Of everything that varies, for each of eight surfaces.
    #[inline(always)]
    fn gather(of: &[&Surface; LANES]) -> [Self; VARYING] {
        let first = of[0];
        if of.iter().all(|surface| std::ptr::eq(*surface, first)) {
            return std::array::from_fn(|at| Self {
                at_corner: F::splat(first.at_corner[at]),
                per_x: F::splat(first.per_x[at]),
                per_y: F::splat(first.per_y[at]),
            });
        }
        let columns =
            |part: fn(&Surface) -> [f32; VARYING]| F::transpose(of.map(|it| F::new(part(it))));
        let at_corner = columns(|it| it.at_corner);
        let (per_x, per_y) = (columns(|it| it.per_x), columns(|it| it.per_y));
        std::array::from_fn(|at| Self {
            at_corner: at_corner[at],
            per_x: per_x[at],
            per_y: per_y[at],
        })
    }

    #[inline(always)]
    fn at(&self, x: F, y: F) -> F {
        let along = self.per_x.fused(x, self.at_corner);
        self.per_y.fused(y, along)
    }
}

#[inline(always)]
fn colour_eight(
    texture: Option<Texels<'_>>,
    surfaces: &[Surface],
    fragments: &[Fragment; LANES],
) -> [u32; LANES] {
    let splat = |value: f32| F::splat(value);
    let of: [&Surface; LANES] = fragments
        .each_ref()
        .map(|it| &surfaces[it.surface as usize]);
    let all = Planes::gather(&of);
    let planes = |at: usize| all[at];
    let (one, half) = (splat(1.0), splat(0.5));
    let place = |of: fn(&Fragment) -> u16| {
        let values = fragments.each_ref().map(|it| i32::from(of(it)));
        I::new(values)
    };
    let (x, y) = (place(|it| it.x), place(|it| it.y));
    let centre = |at: I| -> F { at.float() + half };
    let (px, py) = (centre(x), centre(y));
    let over_w = planes(OVER_W);
    let w = one / over_w.at(px, py);
    let [r, g, b] = [0, 1, 2].map(|channel| planes(COLOUR + channel).at(px, py) * w);
    let a = planes(OPACITY).at(px, py) * w;
    let mut colour = [r, g, b, a];
    if let Some(texture) = texture {
        let along = [0, 1, 2].map(|axis| planes(COORDINATES + axis));
        // Texture coordinates are divided by a fourth one, which is 1 but for
        // rounding.
        let at = |px: F, py: F| {
            let share = over_w.at(px, py);
            let w = one / share;
            let over_fourth = one / (share * w);
            Place {
                at: along.map(|plane| plane.at(px, py) * w * over_fourth),
            }
        };
        let own = at(px, py);
        let texel = match texture.texture.kind {
            TextureKind::Flat { srgb } => {
                let even = I::splat(!1);
                let (qx, qy) = (centre(x & even), centre(y & even));
                let square = [at(qx, qy), at(qx + one, qy), at(qx, qy + one)];
                sample::flat(texture, srgb, own, square)
            }
            TextureKind::Cube => {
                let other = I::splat(1);
                let neighbours = [at(centre(x ^ other), py), at(px, centre(y ^ other))];
                sample::cube(texture, own, neighbours)
            }
        };
        for (part, texel) in colour.iter_mut().zip(texel) {
            *part *= texel;
        }
    }
    let [r, g, b, a] = colour.map(|part| {
        let part = part.max(splat(0.0)).min(one) * splat(255.0);
        let part: I = part.nearest();
        part
    });
    let packed = r | (g << 8i32) | (b << 16i32) | (a << 24i32);
    packed.to_array().map(i32::cast_unsigned)
}
