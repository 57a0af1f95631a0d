//! Mutable access to the arrays of which each model of a compilation has a copy.

use super::model::Model;
use super::own::each_own_array;

pub enum OwnArray<'a> {
    Double(&'a mut [f64]),
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

macro_rules! change {
    ($($method:ident: $name:ident: $kind:ty = $rows:ident * $columns:literal;)*) => {
        impl Model {
            pub const OWN_ARRAYS: &[&str] = &[$(stringify!($name),)*];

            $(
                pub fn $method(&mut self) -> &mut [$kind] {
                    let model = self.raw_mut();
                    // SAFETY: the pointer points at this model's own copy, of this length; `&mut
                    // self` makes the access exclusive.
                    unsafe {
                        std::slice::from_raw_parts_mut(
                            model.$name,
                            model.$rows as usize * $columns,
                        )
                    }
                }
            )*

            /// Returns an array of [`OWN_ARRAYS`](Self::OWN_ARRAYS).
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

each_own_array!(change);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::{Data, ObjectKind};

    const SCENE: &str = r#"<mujoco><worldbody>
        <light name="lamp" pos="0 0 3"/><camera name="front" pos="1 0 0"/>
        <body name="block"><freejoint/><geom size="0.1"/><site name="mark"/></body>
    </worldbody></mujoco>"#;

    #[test]
    fn changes_of_one_model_do_not_affect_another_model() {
        let mut first = Model::compile(SCENE).expect("a model");
        let before = first.cam_pos().to_vec();
        let mut second = first.share();
        for name in Model::OWN_ARRAYS {
            match second.own_array_mut(name).expect("an own array") {
                OwnArray::Double(values) => values.fill(7.0),
                OwnArray::Single(values) => values.fill(7.0),
            }
        }
        second.set_headlight_ambient([0.5; 3]);
        assert_eq!(first.cam_pos(), before);
        assert!(second.cam_pos().iter().all(|value| *value == 7.0));
        assert_ne!(first.headlight_ambient(), second.headlight_ambient());
        assert!(first.own_array_mut("geom_pos").is_none());
        // Names still resolve after the first model is dropped, and a state made for it fits.
        let state = Data::new(&first).expect("a state");
        drop(first);
        assert_eq!(state.qpos(&second).len(), 7);
        assert_eq!(second.id(ObjectKind::Site, "mark").expect("a site"), 0);
        let third = second.share();
        assert_eq!(third.light_pos(), second.light_pos());
        second.copy_own(&Model::share(&third));
        assert_eq!(second.cam_pos(), third.cam_pos());
    }

    #[test]
    #[should_panic(expected = "another compilation")]
    fn copying_own_arrays_from_another_compilation_panics() {
        let [mut first, second] = [SCENE; 2].map(|scene| Model::compile(scene).expect("a model"));
        first.copy_own(&second);
    }
}
