//! The arrays of a model that rollouts change: poses of fixtures, cameras, lights, and
//! what glows. Each model has its own.

use mujoco_rs::mujoco_c::mjModel;

use super::model::{Model, values};

/// One of them, to be changed.
pub enum OwnArray<'a> {
    /// Doubles.
    Double(&'a mut [f64]),
    /// Singles.
    Single(&'a mut [f32]),
}

impl<'a> From<&'a mut [f64]> for OwnArray<'a> {
    fn from(values: &'a mut [f64]) -> Self {
        Self::Double(values)
    }
}

impl<'a> From<&'a mut [f32]> for OwnArray<'a> {
    fn from(values: &'a mut [f32]) -> Self {
        Self::Single(values)
    }
}

macro_rules! own_arrays {
    ($($method:ident: $name:ident: $kind:ty = $rows:ident * $columns:literal;)*) => {
        /// Keeps the arrays alive.
        #[expect(dead_code, reason = "they are reached through the model")]
        pub(super) struct OwnArrays {
            $($name: Box<[$kind]>,)*
        }

        impl OwnArrays {
            /// Copies a model's arrays and has it point at the copies.
            pub(super) fn of(model: &mut mjModel) -> Self {
                $(
                    // SAFETY: the field points at this many values.
                    let $name = unsafe {
                        values(model.$name.cast_const(), model.$rows * $columns)
                    };
                    let mut $name: Box<[$kind]> = $name.into();
                    model.$name = $name.as_mut_ptr();
                )*
                Self { $($name,)* }
            }

            /// Their names.
            pub(super) const NAMES: &[&str] = &[$(stringify!($name),)*];
        }

        impl Model {
            $(
                /// As the shared slice, to be changed.
                pub fn $method(&mut self) -> &mut [$kind] {
                    let model = self.raw_mut();
                    // SAFETY: it leads to this model's own copy, of this length;
                    // `&mut self` makes it exclusive.
                    unsafe {
                        std::slice::from_raw_parts_mut(
                            model.$name,
                            model.$rows as usize * $columns,
                        )
                    }
                }
            )*

            /// An array that may be changed, by MuJoCo's name; none of another name.
            pub fn own_array_mut(&mut self, name: &str) -> Option<OwnArray<'_>> {
                match name {
                    $(stringify!($name) => Some(self.$method().into()),)*
                    _ => None,
                }
            }

            pub(super) fn copy_arrays(&mut self, other: &Self) {
                $(self.$method().copy_from_slice(other.$name());)*
            }
        }
    };
}

own_arrays! {
    body_pos_mut: body_pos: f64 = nbody * 3;
    body_quat_mut: body_quat: f64 = nbody * 4;
    cam_pos_mut: cam_pos: f64 = ncam * 3;
    cam_quat_mut: cam_quat: f64 = ncam * 4;
    light_pos_mut: light_pos: f64 = nlight * 3;
    light_dir_mut: light_dir: f64 = nlight * 3;
    light_diffuse_mut: light_diffuse: f32 = nlight * 3;
    light_specular_mut: light_specular: f32 = nlight * 3;
    site_rgba_mut: site_rgba: f32 = nsite * 4;
}

impl Model {
    /// Names of the arrays that may be changed.
    pub const OWN_ARRAYS: &[&str] = OwnArrays::NAMES;
}
