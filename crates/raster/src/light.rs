//! OpenGL's vertex lighting, as in Mesa's vertex programs: local viewer, one-sided, highlights
//! added before texturing. Eight corners at a time.

use crate::instance::{Instance, View};
use crate::lanes::{F, Floats as _, I, Ints as _};
use crate::matrix::{Vec3, dot};
use crate::scene::{Light, LightKind, MAX_LIGHTS, Scene};

const AMBIENT_WITHOUT_LIGHTS: f32 = 0.3;
const MAX_SHININESS: f32 = 128.0;

#[derive(Debug, Clone, Copy)]
pub(crate) struct EyeLight {
    /// Position of the light; for a directional light, the direction towards the light.
    place: Vec3,
    cone: Option<Cone>,
    is_directional: bool,
    /// Constant, linear and quadratic; `None` without attenuation.
    attenuation: Option<Vec3>,
    ambient: Vec3,
    diffuse: Vec3,
    specular: Vec3,
}

#[derive(Debug, Clone, Copy)]
struct Cone {
    axis: Vec3,
    cosine: f32,
    exponent: f32,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Lighting<'a> {
    pub(crate) lights: &'a [EyeLight],
    /// Ambient light without a source.
    pub(crate) everywhere: f32,
    pub(crate) has_emission: bool,
}

impl<'a> Lighting<'a> {
    pub(crate) fn all(lights: &'a [EyeLight]) -> Self {
        Self {
            lights,
            everywhere: if lights.is_empty() { AMBIENT_WITHOUT_LIGHTS } else { 0.0 },
            has_emission: true,
        }
    }

    pub(crate) fn added_by(light: &'a EyeLight) -> Self {
        Self { lights: std::slice::from_ref(light), everywhere: 0.0, has_emission: false }
    }
}

/// Normalises a vector with Mesa's operations; leaves the zero vector unchanged.
fn unit(v: Vec3) -> Vec3 {
    let square = dot(v, v);
    if square == 0.0 {
        return v;
    }
    let scale = 1.0 / square.sqrt();
    v.map(|part| part * scale)
}

impl EyeLight {
    /// Returns the lights of the scene, up to OpenGL's limit.
    pub(crate) fn all(scene: &Scene, view: &View) -> Vec<Self> {
        let lights = scene.lights.iter().take(MAX_LIGHTS);
        lights.map(|light| Self::new(light, view)).collect()
    }

    fn new(light: &Light, view: &View) -> Self {
        let (place, cone, attenuation) = match light.kind {
            LightKind::Directional => {
                let towards = light.dir.map(|part| -part);
                (unit(view.world_to_eye.direction(towards)), None, None)
            }
            LightKind::Spot { cutoff, exponent, attenuation } => {
                let axis = unit(unit(view.world_to_eye.direction(light.dir)));
                let radians = f64::from(cutoff) * std::f64::consts::PI / 180.0;
                let cone = Cone { axis, cosine: libm::cosf(radians as f32).max(0.0), exponent };
                (
                    view.world_to_eye.point(light.pos),
                    (cutoff != 180.0).then_some(cone),
                    (attenuation != [1.0, 0.0, 0.0]).then_some(attenuation),
                )
            }
        };
        Self {
            place,
            cone,
            is_directional: light.kind == LightKind::Directional,
            attenuation,
            ambient: light.ambient,
            diffuse: light.diffuse,
            specular: light.specular,
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Shading<'a> {
    lights: &'a [EyeLight],
    /// Colour without any light.
    base: Vec3,
    /// For each light: its ambient, diffuse and specular colours times the material's colours.
    products: [[Vec3; 3]; MAX_LIGHTS],
    /// For each light: true if the light adds only its ambient part to corners that face away from
    /// it. Requires finite values, since infinity times zero is not zero.
    adds_only_ambient: [bool; MAX_LIGHTS],
    shininess: f32,
}

impl<'a> Shading<'a> {
    pub(crate) fn new(instance: &Instance, lighting: Lighting<'a>) -> Self {
        let Lighting { lights, everywhere, .. } = lighting;
        let [r, g, b, _] = instance.rgba;
        let colour = [r, g, b];
        let emission = if lighting.has_emission { instance.emission } else { 0.0 };
        let times = |light: Vec3, material: Vec3| -> Vec3 {
            std::array::from_fn(|channel| light[channel] * material[channel])
        };
        let products: [[Vec3; 3]; MAX_LIGHTS] = std::array::from_fn(|at| {
            lights.get(at).map_or([[0.0; 3]; 3], |light| {
                [
                    times(light.ambient, colour),
                    times(light.diffuse, colour),
                    times(light.specular, [instance.specular; 3]),
                ]
            })
        });
        let adds_only_ambient = |light: &EyeLight, products: &[Vec3; 3]| {
            let is_finite = products.as_flattened().iter().all(|part| part.is_finite());
            let is_dimmed_finitely = light.attenuation.is_none()
                && light.cone.is_none_or(|cone| cone.exponent >= 0.0 && cone.exponent.is_finite());
            is_finite && is_dimmed_finitely && (light.cone.is_none() || products[0] == [0.0; 3])
        };
        Self {
            lights,
            base: colour.map(|part| everywhere * part + emission * part),
            adds_only_ambient: std::array::from_fn(|at| {
                lights.get(at).is_some_and(|light| adds_only_ambient(light, &products[at]))
            }),
            products,
            shininess: instance.shininess,
        }
    }
}

type Vec3x8 = [F; 3];

/// Returns the dot product in Mesa's order of summation, last component first.
#[inline(always)]
fn dot8(a: Vec3x8, b: Vec3x8) -> F {
    a[2] * b[2] + a[1] * b[1] + a[0] * b[0]
}

#[inline(always)]
fn normalize8(v: Vec3x8) -> Vec3x8 {
    let scale = F::splat(1.0) / dot8(v, v).sqrt();
    v.map(|part| part * scale)
}

#[inline(always)]
fn subtract8(a: Vec3x8, b: Vec3x8) -> Vec3x8 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `pos` and `normal` are in the eye frame; `normal` may have any length.
#[inline(always)]
pub(crate) fn shade(shading: &Shading<'_>, pos: Vec3x8, normal: Vec3x8) -> Vec3x8 {
    let splat = |value: f32| F::splat(value);
    let (zero, one) = (splat(0.0), splat(1.0));
    let vec = |v: Vec3| v.map(splat);
    let normal = normalize8(normal);
    let has_highlights = shading.shininess != 0.0;
    let towards_pos = if has_highlights { normalize8(pos) } else { pos };
    let mut colour = vec(shading.base);
    let materials = shading.products.iter().zip(&shading.adds_only_ambient);
    for (light, (products, adds_only_ambient)) in shading.lights.iter().zip(materials) {
        let [ambient, diffuse, specular] = products.map(vec);
        let (to_light, over_distance) = if light.is_directional {
            (vec(light.place), one)
        } else {
            let offset = subtract8(vec(light.place), pos);
            let over_distance = one / dot8(offset, offset).sqrt();
            (offset.map(|part| part * over_distance), over_distance)
        };
        let facing = dot8(normal, to_light);
        if *adds_only_ambient && facing.le(zero).all() {
            for channel in 0..3 {
                colour[channel] = ambient[channel] + colour[channel];
            }
            continue;
        }
        let attenuation = match light.is_directional {
            true => None,
            false => attenuated(light, to_light, over_distance),
        };
        let (is_lit, lit) = (facing.gt(zero), facing.max(zero));
        // Without shininess, Mesa's program takes base and exponent of the power from the register
        // that holds the dot product `facing`.
        let (base, exponent) = if has_highlights && products[2] != [0.0; 3] {
            let half = normalize8(subtract8(to_light, towards_pos));
            (dot8(normal, half), splat(shading.shininess.min(MAX_SHININESS)))
        } else {
            (facing, facing)
        };
        let highlight = if products[2] == [0.0; 3] {
            zero
        } else if has_highlights || attenuation.is_some() {
            is_lit.select(power(base.max(zero), exponent), zero)
        } else {
            is_lit.select(one, zero)
        };
        for channel in 0..3 {
            let (glow, lit, highlight) = match attenuation {
                Some(share) => (share * ambient[channel], lit * share, highlight * share),
                None => (ambient[channel], lit, highlight),
            };
            colour[channel] = glow + colour[channel];
            colour[channel] = lit * diffuse[channel] + colour[channel];
            colour[channel] = highlight * specular[channel] + colour[channel];
        }
    }
    colour.map(|part| part.max(zero).min(one))
}

/// Returns the attenuation of a light; `None` if the light is not attenuated.
#[inline(always)]
fn attenuated(light: &EyeLight, to_light: Vec3x8, over_distance: F) -> Option<F> {
    let splat = |value: f32| F::splat(value);
    let one = splat(1.0);
    let in_cone = light.cone.map(|cone| {
        let along = dot8(to_light.map(|part| -part), cone.axis.map(splat));
        let inside = splat(cone.cosine).lt(along);
        let share = power(along.abs(), splat(cone.exponent));
        inside.select(one, splat(0.0)) * share
    });
    let with_distance = light.attenuation.map(|[constant, linear, square]| {
        let distance = one / over_distance;
        let unity = over_distance * distance;
        let squared = distance * distance;
        let sum = splat(square) * squared + splat(linear) * distance + splat(constant) * unity;
        one / sum
    });
    match (in_cone, with_distance) {
        (Some(cone), Some(distance)) => Some(distance * cone),
        (cone, distance) => cone.or(distance),
    }
}

/// Mesa's binary logarithm: a polynomial in the square of (m − 1) / (m + 1), constant first.
const LOG2: [f32; 5] = [2.885_39, 0.961_791_6, 0.577_440_3, 0.403_343_86, 0.406_718_05];
/// Coefficients of Mesa's polynomial for the power of two of a fraction.
const EXP2: [f32; 6] =
    [1.0, 0.693_153_1, 0.240_153_61, 0.055_826_318, 0.008_989_34, 0.001_877_576_7];

/// Power of a non-negative base; zero for a base of zero, whatever the exponent.
#[inline(always)]
fn power(base: F, exponent: F) -> F {
    let splat = |value: f32| F::splat(value);
    let int = |value: i32| I::splat(value);
    let (zero, one) = (splat(0.0), splat(1.0));
    let bits = base.to_signed_bits();
    let base_exponent = ((bits & int(0x7f80_0000)) >> 23i32) - int(127);
    let mantissa = F::from_signed_bits((bits & int(0x007f_ffff)) | int(0x3f80_0000));
    let y = (mantissa - one) / (mantissa + one);
    let z = y * y;
    let zz = z * z;
    let even = splat(LOG2[4]).fused(zz, splat(LOG2[2]));
    let even = zz.fused(even, splat(LOG2[0]));
    let odd = zz.fused(splat(LOG2[3]), splat(LOG2[1]));
    let polynomial = odd.fused(z, even);
    let base_exponent: F = base_exponent.float();
    let logarithm = y.fused(polynomial, base_exponent);
    let x = (logarithm * exponent).min(splat(128.0)).max(splat(-126.999_99));
    let floor = x.floor();
    let fraction = x - floor;
    let floor: I = floor.truncate_to_int();
    let scale = F::from_signed_bits((floor + int(127)) << 23i32);
    let square = fraction * fraction;
    let even = square.fused(splat(EXP2[4]), splat(EXP2[2]));
    let even = square.fused(even, splat(EXP2[0]));
    let odd = square.fused(splat(EXP2[5]), splat(EXP2[3]));
    let odd = square.fused(odd, splat(EXP2[1]));
    let result = scale * odd.fused(fraction, even);
    base.equals(zero).select(zero, result)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn approximate_powers_are_near_the_exact_powers() {
        let bases = [0.0, 1e-3, 0.1, 0.5, 0.9, 0.99, 1.0, 1.5];
        for exponent in [0.5f32, 1.0, 10.0, 64.0] {
            let found = power(F::new(bases), F::splat(exponent)).to_array();
            for (base, found) in bases.iter().zip(found) {
                let expected = base.powf(exponent);
                assert!(
                    (found - expected).abs() < 2e-4 * expected.max(1.0),
                    "{base}^{exponent}: {found}"
                );
            }
        }
    }
}
