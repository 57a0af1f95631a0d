//! MuJoCo's abstract scene of a model's state (`mjvScene`): geoms, lights and cameras. Both
//! renderers draw it.

use std::collections::BTreeMap;
use std::mem::MaybeUninit;

use mujoco_rs::mujoco_c as c;

use super::{Data, Model};

/// Maximum number of geoms in a picture, as in robosuite; further geoms are not drawn.
const MAX_GEOMS: i32 = 1000;
/// Geom group of collision geometry, which is not drawn.
const COLLISION_GROUP: usize = 0;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// Kind of object (`mjtObj`); geoms are 5, sites 6.
    pub kind: i32,
    pub id: i32,
}

pub(crate) struct VisualScene {
    options: c::mjvOption,
    scene: Box<c::mjvScene>,
    /// Serial of the compilation, for whose skins and flexible bodies there is capacity.
    model: u64,
}

// SAFETY: plain memory that no thread owns, written through `&mut self`.
unsafe impl Send for VisualScene {}

impl VisualScene {
    pub(crate) fn new(model: &Model) -> Self {
        let mut options = MaybeUninit::uninit();
        let mut scene = Box::new(MaybeUninit::uninit());
        // SAFETY: each object is written whole by its default function before it is assumed
        // initialised; the boxed scene does not move, since MuJoCo may store its address.
        let (mut options, scene): (c::mjvOption, Box<c::mjvScene>) = unsafe {
            c::mjv_defaultOption(options.as_mut_ptr());
            c::mjv_defaultScene(scene.as_mut_ptr());
            let mut scene = scene.assume_init();
            c::mjv_makeScene(model.as_ptr(), &mut *scene, MAX_GEOMS);
            (options.assume_init(), scene)
        };
        options.geomgroup[COLLISION_GROUP] = 0;
        Self { options, scene, model: model.serial() }
    }

    pub(crate) fn scene(&self) -> &c::mjvScene {
        &self.scene
    }

    /// Pictures are drawn from the mean of the left and the right eye's camera.
    pub(crate) fn eye(&self) -> c::mjvGLCamera {
        let [left, right] = &self.scene.camera;
        // SAFETY: the call reads the two cameras, and nothing else.
        unsafe { c::mjv_averageCamera(left, right) }
    }

    pub(crate) fn geoms(&self) -> &[c::mjvGeom] {
        // SAFETY: MuJoCo keeps `ngeom` geoms there until the scene changes.
        unsafe { std::slice::from_raw_parts(self.scene.geoms, self.scene.ngeom as usize) }
    }

    /// Returns the model's object for each id that a pixel of a segmentation image can have.
    pub(crate) fn segments(&self) -> BTreeMap<u32, Segment> {
        let numbered = self.geoms().iter().filter_map(|geom| {
            let number = u32::try_from(geom.segid).ok()?;
            let (kind, id) = (geom.objtype, geom.objid);
            Some((number, Segment { kind, id }))
        });
        numbered.collect()
    }

    ///
    /// # Panics
    /// If the state or this scene was made for another model.
    pub(crate) fn update(
        &mut self,
        model: &Model,
        data: &mut Data,
        camera_id: usize,
    ) -> &mut c::mjvScene {
        assert!(self.model == model.serial(), "this scene was made for another model");
        data.assert_made_for(model);
        let mut camera = MaybeUninit::uninit();
        // SAFETY: the camera is written whole by its default function before it is
        // assumed initialised; data and scene were made for this model, as
        // asserted.
        unsafe {
            c::mjv_defaultCamera(camera.as_mut_ptr());
            let mut camera: c::mjvCamera = camera.assume_init();
            camera.type_ = c::mjtCamera::mjCAMERA_FIXED as i32;
            camera.fixedcamid = camera_id as i32;
            c::mjv_updateScene(
                model.as_ptr(),
                data.as_mut_ptr(),
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

impl Drop for VisualScene {
    fn drop(&mut self) {
        // SAFETY: made in `new`, freed once.
        unsafe { c::mjv_freeScene(&mut *self.scene) }
    }
}
