//! Arrays of a model that rollouts change: poses of fixtures, cameras, lights, and opacities of
//! burner sites. Each model has its own copies.

use std::ptr::NonNull;

use mujoco_rs::mujoco_c::mjModel;

use super::values;

/// Entries: method for mutable access, MuJoCo's name, element type, length.
macro_rules! each_own_array {
    ($use:ident) => {
        $use! {
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
    };
}
pub(super) use each_own_array;

/// An allocation that MuJoCo's structure points into, freed when dropped.
///
/// Uses a raw pointer rather than a `Box`: moving a `Box` asserts exclusive access to its contents,
/// which invalidates every pointer taken before the move.
struct Allocation<T>(NonNull<[T]>);

impl<T: Copy> Allocation<T> {
    fn copy_of(values: &[T]) -> Self {
        Self(NonNull::from(Box::leak(values.into())))
    }

    fn as_mut_ptr(&self) -> *mut T {
        self.0.as_ptr().cast()
    }
}

impl<T> Drop for Allocation<T> {
    fn drop(&mut self) {
        // SAFETY: leaked from a box by `copy_of`, and freed nowhere else.
        drop(unsafe { Box::from_raw(self.0.as_ptr()) });
    }
}

macro_rules! define_own_arrays {
    ($($method:ident: $name:ident: $kind:ty = $rows:ident * $columns:literal;)*) => {
        #[expect(dead_code, reason = "they are reached through the model")]
        pub(super) struct OwnArrays {
            $($name: Allocation<$kind>,)*
        }

        impl OwnArrays {
            pub(super) fn copy_of(model: &mut mjModel) -> Self {
                $(
                    // SAFETY: the field points at this many values.
                    let $name = Allocation::copy_of(unsafe {
                        values(model.$name.cast_const(), model.$rows * $columns)
                    });
                    model.$name = $name.as_mut_ptr();
                )*
                Self { $($name,)* }
            }
        }
    };
}

each_own_array!(define_own_arrays);

#[cfg(test)]
#[allow(unsafe_code, reason = "accesses as MuJoCo makes them")]
mod tests {
    use super::*;

    /// Every number is unique; functions access the arrays through the model's pointers.
    macro_rules! define_test_arrays {
        ($($method:ident: $name:ident: $kind:ty = $rows:ident * $columns:literal;)*) => {
            #[derive(Debug, Default, PartialEq)]
            struct Arrays {
                $($name: Vec<$kind>,)*
            }

            impl Arrays {
                fn with_rows(rows: usize) -> Self {
                    let mut start = 0.0;
                    Self {
                        $($name: {
                            start += 100.0;
                            let length = rows * $columns;
                            (0..length).map(|index| start as $kind + index as $kind).collect()
                        },)*
                    }
                }

                fn model(&mut self, rows: i32) -> mjModel {
                    // SAFETY: consists of numbers and pointers.
                    let mut model: mjModel = unsafe { std::mem::zeroed() };
                    $(
                        model.$rows = rows;
                        model.$name = self.$name.as_mut_ptr();
                    )*
                    model
                }
            }

            fn add_one(model: &mjModel) {
                $(for index in 0..(model.$rows * $columns) as usize {
                    // SAFETY: the field points at this many values.
                    unsafe { *model.$name.add(index) += 1.0 };
                })*
            }

            fn read(model: &mjModel) -> Arrays {
                Arrays {
                    // SAFETY: the fields point at this many values.
                    $($name: unsafe {
                        values(model.$name.cast_const(), model.$rows * $columns).to_vec()
                    },)*
                }
            }
        };
    }

    each_own_array!(define_test_arrays);

    /// Under Miri, this test also detects pointers that a move has invalidated.
    #[test]
    fn own_arrays_are_copies_whose_pointers_stay_valid_when_the_owner_moves() {
        let mut shared = Arrays::with_rows(2);
        let mut model = shared.model(2);
        let arrays = OwnArrays::copy_of(&mut model);
        let boxed = Box::new(arrays);
        add_one(&model);
        let moved = std::iter::once(*boxed).collect::<Vec<_>>();
        add_one(&model);
        let [last] = <[OwnArrays; 1]>::try_from(moved).ok().expect("one");
        let mut expected = Arrays::with_rows(2);
        let expected_model = expected.model(2);
        add_one(&expected_model);
        add_one(&expected_model);
        assert_eq!(read(&model), read(&expected_model));
        assert_eq!(shared, Arrays::with_rows(2), "the shared arrays were written to");
        drop(last);
    }

    #[test]
    fn a_model_without_cameras_and_lights_has_empty_arrays() {
        let mut none = Arrays::default();
        let mut model = none.model(0);
        let arrays = OwnArrays::copy_of(&mut model);
        assert_eq!(read(&model), Arrays::default());
        drop(arrays);
    }
}
