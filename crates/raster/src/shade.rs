//! Shading: every triangle visible in a pixel is coloured once, at the pixel's centre, for all its
//! samples in the pixel.

use crate::clip::VARYING;
use crate::instance::Instance;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES};
use crate::light::{Lighting, Shading};
use crate::model::Model;
use crate::sample::{self, Place};
use crate::shadow::Receiver;
use crate::surface::{
    self, COLOUR, COORDINATES, Interpolated, OPACITY, OVER_W, PLACE, Surface, SurfaceRequest,
    Vertices,
};
use crate::texture::{Texels, TextureKind};
use crate::visible::{CLIPPED, NOTHING, Record, SAMPLES, Visible};
use crate::window::Window;

/// A triangle in a pixel. Kept small, since there are more fragments than pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Fragment {
    /// Column, row, and bits of the covered samples.
    place: u32,
    surface: u32,
}

/// Longest side of a frame, pixels.
pub(crate) const MAX_SIDE: usize = 4096;
const SIDE_BITS: u32 = MAX_SIDE.ilog2();
const SIDE_MASK: u32 = (1 << SIDE_BITS) - 1;
const _: () = assert!(MAX_SIDE.is_power_of_two(), "column and row numbers fit in their bits");
const _: () =
    assert!(2 * SIDE_BITS + SAMPLES as u32 <= u32::BITS, "column, row and samples fit in 32 bits");

impl Fragment {
    #[inline(always)]
    pub(crate) fn new(x: u32, y: u32, samples: u32, surface: u32) -> Self {
        Self { place: x | y << SIDE_BITS | samples << (2 * SIDE_BITS), surface }
    }

    #[inline(always)]
    pub(crate) fn x(&self) -> usize {
        (self.place & SIDE_MASK) as usize
    }

    #[inline(always)]
    pub(crate) fn y(&self) -> usize {
        (self.place >> SIDE_BITS & SIDE_MASK) as usize
    }

    #[inline(always)]
    pub(crate) fn surface(&self) -> usize {
        self.surface as usize
    }

    #[inline(always)]
    pub(crate) fn samples(&self) -> usize {
        (self.place >> (2 * SIDE_BITS)) as usize & ((1 << SAMPLES) - 1)
    }
}

#[derive(Debug, Default)]
pub(crate) struct Lists {
    /// Per record from `first` on: its surface, if listed.
    surfaces: Vec<Surface>,
    /// Per record from `first` on: its place in a shadow map, if listed.
    places: Vec<Surface>,
    first: usize,
    /// Per record from `first` on: number of the list that holds its fragments, or [`NOTHING`].
    list_of: Vec<u32>,
    requests: Vec<SurfaceRequest>,
    vertices: Box<Vertices>,
    /// Fragments by texture; the last list holds the fragments without a texture.
    pub(crate) fragments: Vec<Vec<Fragment>>,
}

impl Lists {
    /// Empties the lists, for fragments of records from `first` on.
    pub(crate) fn clear(&mut self, first: usize, records: usize, textures: usize) {
        self.first = first;
        self.list_of.clear();
        self.list_of.resize(records - first, NOTHING);
        self.fragments.resize_with(textures + 1, Vec::new);
        self.fragments.iter_mut().for_each(Vec::clear);
    }

    /// Returns the surface's index, and the list for the record's fragments.
    #[inline(always)]
    pub(crate) fn request_surface(
        &mut self,
        id: u32,
        records: &[Record],
        instances: &[Instance],
    ) -> (u32, usize) {
        let surface = id as usize - self.first;
        let list = &mut self.list_of[surface];
        if *list == NOTHING {
            let texture = instances[records[id as usize].instance as usize].texture;
            *list = texture.unwrap_or(self.fragments.len() - 1) as u32;
        }
        (surface as u32, *list as usize)
    }
}

/// Lists the fragments of a window; `lists` must have been cleared for its records.
pub(crate) fn list_fragments(
    visible: &Visible,
    instances: &[Instance],
    window: Window,
    lists: &mut Lists,
) {
    let mut listing = Listing {
        lists,
        records: &visible.records,
        instances,
        id: NO_RECORD,
        surface: 0,
        number: 0,
        list: Vec::new(),
    };
    listing.open(0);
    for (row, y) in window.rows(visible.stride).zip(window.y[0]..) {
        let ids = &visible.ids[row.start * SAMPLES..row.end * SAMPLES];
        let (pixels, _) = ids.as_chunks::<SAMPLES>();
        for (ids, x) in pixels.iter().zip(window.x[0]..) {
            listing.pixel(ids, x as u32, y as u32);
        }
    }
    listing.close();
}

/// Differs from [`NOTHING`], so that pixels without a triangle do not match it.
const NO_RECORD: u32 = NOTHING - 1;

/// Appends fragments to the lists. Optimised for runs of fragments of the same triangle and list.
struct Listing<'a> {
    lists: &'a mut Lists,
    records: &'a [Record],
    instances: &'a [Instance],
    /// The last record and its surface.
    id: u32,
    surface: u32,
    /// Number of the last fragment's list, and the list itself, which is moved out of `lists`.
    number: usize,
    list: Vec<Fragment>,
}

impl Listing<'_> {
    #[inline(always)]
    fn pixel(&mut self, ids: &[u32; SAMPLES], x: u32, y: u32) {
        if *ids == [self.id; SAMPLES] {
            self.list.push(Fragment::new(x, y, 0xf, self.surface));
            return;
        }
        let [a, b, c, d] = *ids;
        let bit = |same: bool, sample: u32| u32::from(same) << sample;
        let with_first = 1 | bit(b == a, 1) | bit(c == a, 2) | bit(d == a, 3);
        self.push(a, x, y, with_first);
        if with_first == 0xf {
            return;
        }
        if b != a {
            self.push(b, x, y, 2 | bit(c == b, 2) | bit(d == b, 3));
        }
        if c != a && c != b {
            self.push(c, x, y, 4 | bit(d == c, 3));
        }
        if d != a && d != b && d != c {
            self.push(d, x, y, 8);
        }
    }

    #[inline(always)]
    fn push(&mut self, id: u32, x: u32, y: u32, samples: u32) {
        if id != self.id && !self.select_record(id) {
            return;
        }
        self.list.push(Fragment::new(x, y, samples, self.surface));
    }

    /// Makes a record the current record; returns false if the record is not listed.
    #[inline(always)]
    fn select_record(&mut self, id: u32) -> bool {
        if id == NOTHING || (id as usize) < self.lists.first {
            return false;
        }
        let (surface, number) = self.lists.request_surface(id, self.records, self.instances);
        (self.id, self.surface) = (id, surface);
        if number != self.number {
            self.close();
            self.open(number);
        }
        true
    }

    fn open(&mut self, number: usize) {
        self.number = number;
        self.list = std::mem::take(&mut self.lists.fragments[number]);
    }

    fn close(&mut self) {
        self.lists.fragments[self.number] = std::mem::take(&mut self.list);
    }
}

#[derive(Clone, Copy)]
pub(crate) enum Content<'a> {
    Colours(Lighting<'a>),
    /// Places in a light's shadow map.
    Places(&'a Receiver),
}

#[inline(always)]
pub(crate) fn compute_surfaces(
    model: &Model,
    visible: &Visible,
    instances: &[Instance],
    content: Content<'_>,
    lists: &mut Lists,
) {
    let size = [visible.width as f32, visible.height as f32];
    let Lists { surfaces, places, first, list_of, requests, vertices, .. } = lists;
    let into = match content {
        Content::Colours(_) => surfaces,
        Content::Places(_) => places,
    };
    // Stale entries of an earlier frame are overwritten before they are read.
    if into.len() < list_of.len() {
        into.resize(list_of.len(), Surface::default());
    }
    let mut shading = ShadingCache { content, last: None };
    let records = visible.records[*first..].iter().zip(&*list_of).zip(0u32..);
    let mut needed = records
        .filter(|((_, list), _)| **list != NOTHING)
        .map(|((record, _), surface)| (record, surface))
        .peekable();
    while let Some((record, surface)) = needed.next() {
        let instance = &instances[record.instance as usize];
        let mesh = instance.mesh.resolve(model);
        let interpolated = shading.get(record.instance, instance);
        if record.vertices == CLIPPED {
            into[surface as usize] =
                surface::compute_clipped(instance, mesh, interpolated, visible, record);
            continue;
        }
        requests.clear();
        requests.push(SurfaceRequest { triangle: record.triangle, surface });
        let is_in_same_cluster =
            |next: &Record| (next.instance, next.vertices) == (record.instance, record.vertices);
        while let Some((next, surface)) = needed.next_if(|(next, _)| is_in_same_cluster(next)) {
            requests.push(SurfaceRequest { triangle: next.triangle, surface });
        }
        let cluster = (record.vertices, requests.as_slice());
        surface::compute_cluster(instance, mesh, interpolated, size, cluster, vertices, into);
    }
}

struct ShadingCache<'a> {
    content: Content<'a>,
    last: Option<(u32, Option<Shading<'a>>)>,
}

impl<'a> ShadingCache<'a> {
    fn get(&mut self, index: u32, instance: &Instance) -> Interpolated<'_> {
        let light = match self.content {
            Content::Colours(light) => light,
            Content::Places(receiver) => return Interpolated::Place(receiver),
        };
        if self.last.as_ref().is_none_or(|(last, _)| *last != index) {
            let shading = instance.is_lit.then(|| Shading::new(instance, light));
            self.last = Some((index, shading));
        }
        Interpolated::Colour(self.last.as_ref().and_then(|(_, shading)| shading.as_ref()))
    }
}

/// Passes each fragment to `paint` with its colour, red in the lowest byte.
#[inline(always)]
pub(crate) fn colour(
    model: &Model,
    largest_levels: &[&[u8]],
    lists: &Lists,
    mut paint: impl FnMut(&Fragment, u32),
) {
    for (texture, fragments) in lists.fragments.iter().enumerate() {
        let level = largest_levels.get(texture).copied();
        let texture = model.textures.get(texture).zip(level);
        let texture = texture.map(|(texture, level)| Texels::new(texture, level));
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

/// Visits in the order of [`colour`]; a place is column and row as shares of the side, and depth.
#[inline(always)]
pub(crate) fn visit_places(lists: &Lists, mut visit: impl FnMut(&Fragment, [f32; 3])) {
    for part in lists.fragments.iter().flat_map(|list| list.chunks(LANES)) {
        let mut eight = [part[0]; LANES];
        eight[..part.len()].copy_from_slice(part);
        let surfaces: [&Surface; LANES] =
            eight.each_ref().map(|fragment| &lists.places[fragment.surface()]);
        let planes = Planes::gather(&surfaces);
        let (x, y) = pixels(&eight);
        let (px, py) = (centre(x), centre(y));
        let one = F::splat(1.0);
        let w = one / planes[OVER_W].at(px, py);
        let along = [0, 1, 2, 3].map(|axis| planes[PLACE + axis].at(px, py) * w);
        let over_fourth = one / along[3];
        let places = [0, 1, 2].map(|axis| (along[axis] * over_fourth).to_array());
        for (lane, fragment) in part.iter().enumerate() {
            visit(fragment, places.map(|axis| axis[lane]));
        }
    }
}

#[inline(always)]
fn pixels(fragments: &[Fragment; LANES]) -> (I, I) {
    let places = I::new(fragments.each_ref().map(|fragment| fragment.place.cast_signed()));
    let side = I::splat(SIDE_MASK.cast_signed());
    (places & side, (places >> SIDE_BITS.cast_signed()) & side)
}

#[inline(always)]
fn centre(at: I) -> F {
    at.float() + F::splat(0.5)
}

/// One interpolated value for each of eight fragments.
#[derive(Clone, Copy)]
struct Planes {
    at_corner: F,
    per_x: F,
    per_y: F,
}

impl Planes {
    #[inline(always)]
    fn gather(surfaces: &[&Surface; LANES]) -> [Self; VARYING] {
        let first = surfaces[0];
        if surfaces.iter().all(|surface| std::ptr::eq(*surface, first)) {
            return std::array::from_fn(|at| Self {
                at_corner: F::splat(first.at_corner[at]),
                per_x: F::splat(first.per_x[at]),
                per_y: F::splat(first.per_y[at]),
            });
        }
        let columns = |part: fn(&Surface) -> [f32; VARYING]| {
            F::transpose(surfaces.map(|surface| F::new(part(surface))))
        };
        let at_corner = columns(|surface| surface.at_corner);
        let (per_x, per_y) = (columns(|surface| surface.per_x), columns(|surface| surface.per_y));
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
    let eight: [&Surface; LANES] =
        fragments.each_ref().map(|fragment| &surfaces[fragment.surface as usize]);
    let all = Planes::gather(&eight);
    let planes = |at: usize| all[at];
    let one = splat(1.0);
    let (x, y) = pixels(fragments);
    let (px, py) = (centre(x), centre(y));
    let over_w = planes(OVER_W);
    let w = one / over_w.at(px, py);
    let [r, g, b] = [0, 1, 2].map(|channel| planes(COLOUR + channel).at(px, py) * w);
    let a = planes(OPACITY).at(px, py) * w;
    let mut colour = [r, g, b, a];
    if let Some(texture) = texture {
        let along = [0, 1, 2].map(|axis| planes(COORDINATES + axis));
        // Texture coordinates are divided by a fourth coordinate, which is 1 except for rounding.
        let at = |px: F, py: F| {
            let share = over_w.at(px, py);
            let w = one / share;
            let over_fourth = one / (share * w);
            Place { at: along.map(|plane| plane.at(px, py) * w * over_fourth) }
        };
        let place = at(px, py);
        let texel = match texture.texture.kind {
            TextureKind::Flat { srgb } => {
                // Three pixels of the 2 × 2 quad that contains the pixel.
                let even = I::splat(!1);
                let (qx, qy) = (centre(x & even), centre(y & even));
                let square = [at(qx, qy), at(qx + one, qy), at(qx, qy + one)];
                sample::flat(texture, srgb, place, square)
            }
            TextureKind::Cube => {
                let last_bit = I::splat(1);
                let neighbours = [at(centre(x ^ last_bit), py), at(px, centre(y ^ last_bit))];
                sample::cube(texture, place, neighbours)
            }
        };
        for (part, texel) in colour.iter_mut().zip(texel) {
            *part *= texel;
        }
    }
    let [r, g, b, a] = colour.map(|part| {
        let part = part.max(splat(0.0)).min(one) * splat(255.0);
        let part: I = part.round_to_int();
        part
    });
    let packed = r | (g << 8i32) | (b << 16i32) | (a << 24i32);
    packed.to_array().map(i32::cast_unsigned)
}
