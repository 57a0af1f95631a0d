//! MuJoCo's abstract scene of a model's state (`mjvScene`): geoms, lights and
//! cameras, from which both renderers draw.

use std::collections::BTreeMap;
use std::mem::MaybeUninit;

use mujoco_rs::mujoco_c as c;

use super::{Segment, View};
use crate::mujoco::Model;

/// Geoms in one picture at most, as in robosuite; further ones are not drawn.
const MAX_GEOMS: i32 = 1000;
/// Geom groups: collision geometry is not drawn, visual geometry is.
const COLLISION_GROUP: usize = 0;

/// An abstract scene, made for one model.
pub(super) struct Abstraction {
    options: c::mjvOption,
    scene: Box<c::mjvScene>,
}

impl Abstraction {
    /// An empty one.
    pub(super) fn new(model: &Model) -> Self {
        let mut options = MaybeUninit::uninit();
        let mut scene = Box::new(MaybeUninit::uninit());
        // SAFETY: each object is written whole by its default function before it
        // is assumed initialised; the box keeps its address, which MuJoCo may
        // remember.
        let (mut options, scene): (c::mjvOption, Box<c::mjvScene>) = unsafe {
            c::mjv_defaultOption(options.as_mut_ptr());
            c::mjv_defaultScene(scene.as_mut_ptr());
            let mut scene = scene.assume_init();
            c::mjv_makeScene(model.as_ptr(), &mut *scene, MAX_GEOMS);
            (options.assume_init(), scene)
        };
        options.geomgroup[COLLISION_GROUP] = 0;
        Self { options, scene }
    }

    pub(super) fn scene(&self) -> &c::mjvScene {
        &self.scene
    }

    pub(super) fn geoms(&self) -> &[c::mjvGeom] {
        // SAFETY: MuJoCo keeps so many geoms there until the scene changes.
        unsafe { std::slice::from_raw_parts(self.scene.geoms, self.scene.ngeom as usize) }
    }

    /// What geoms are of, by their numbers in segmentation images.
    pub(super) fn segments(&self) -> BTreeMap<u32, Segment> {
        let numbered = self.geoms().iter().filter_map(|geom| {
            let number = u32::try_from(geom.segid).ok()?;
            let (kind, id) = (geom.objtype, geom.objid);
            Some((number, Segment { kind, id }))
        });
        numbered.collect()
    }

    /// Makes it that of a state, as a camera of the model sees it.
    pub(super) fn update(&mut self, view: View<'_>) -> &mut c::mjvScene {
        let mut camera = MaybeUninit::uninit();
        // SAFETY: the camera is written whole by its default function before it is
        // assumed initialised; model and data belong together, and the scene was
        // made for this model.
        unsafe {
            c::mjv_defaultCamera(camera.as_mut_ptr());
            let mut camera: c::mjvCamera = camera.assume_init();
            camera.type_ = c::mjtCamera::mjCAMERA_FIXED as i32;
            camera.fixedcamid = view.camera as i32;
            c::mjv_updateScene(
                view.model.as_ptr(),
                view.data.as_mut_ptr(),
                &self.options,
                std::ptr::null(),
                &mut camera,
                c::mjtCatBit::mjCAT_ALL as i32,
                &mut *self.scene,
            );
        }
        &mut self.scene
    }
}

impl Drop for Abstraction {
    fn drop(&mut self) {
        // SAFETY: made in `new`, freed once.
        unsafe { c::mjv_freeScene(&mut *self.scene) }
    }
}
