//! Simulation state of a model.

use std::ptr::NonNull;

use mujoco_rs::mujoco_c as c;

use super::model::Model;
use crate::error::SimError;

/// Simulation state, owned. Every call takes the model that it was made for.
pub struct Data {
    raw: NonNull<c::mjData>,
}

/// Two geoms in contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Geom ids.
    pub geoms: [i32; 2],
    /// Distance between the surfaces, m; negative where they overlap.
    pub distance: f64,
}

macro_rules! slices {
    ($($(#[$doc:meta])* $name:ident = $rows:ident * $columns:literal;)*) => {$(
        $(#[$doc])*
        pub fn $name<'a>(&'a self, model: &Model) -> &'a [f64] {
            // SAFETY: the field points at this many doubles while the data lives.
            unsafe {
                std::slice::from_raw_parts(
                    self.raw.as_ref().$name,
                    model.raw().$rows as usize * $columns,
                )
            }
        }
    )*};
}

macro_rules! slices_mut {
    ($($(#[$doc:meta])* $method:ident: $name:ident = $rows:ident;)*) => {$(
        $(#[$doc])*
        pub fn $method<'a>(&'a mut self, model: &Model) -> &'a mut [f64] {
            // SAFETY: as for the shared slices; `&mut self` makes it exclusive.
            unsafe {
                std::slice::from_raw_parts_mut(
                    self.raw.as_mut().$name,
                    model.raw().$rows as usize,
                )
            }
        }
    )*};
}

macro_rules! stages {
    ($($(#[$doc:meta])* $method:ident = $function:ident;)*) => {$(
        $(#[$doc])*
        pub fn $method(&mut self, model: &Model) {
            // SAFETY: a live model and the data that was made for it.
            unsafe { c::$function(model.as_ptr(), self.raw.as_ptr()) }
        }
    )*};
}

impl Data {
    /// State at the model's reference configuration.
    pub fn new(model: &Model) -> Result<Self, SimError> {
        // SAFETY: a live model; null on failure, checked.
        let raw = unsafe { c::mj_makeData(model.as_ptr()) };
        let raw = NonNull::new(raw).ok_or(SimError::OutOfMemory("simulation state"))?;
        Ok(Self { raw })
    }

    /// Becomes a copy of another state of the same model.
    pub fn copy_from(&mut self, model: &Model, other: &Self) {
        // SAFETY: both were made for this model, which is alive.
        unsafe { c::mj_copyData(self.raw.as_ptr(), model.as_ptr(), other.raw.as_ptr()) };
    }

    pub(crate) fn as_mut_ptr(&mut self) -> *mut c::mjData {
        self.raw.as_ptr()
    }

    fn raw(&self) -> &c::mjData {
        // SAFETY: owned and alive until drop.
        unsafe { self.raw.as_ref() }
    }

    /// Simulated time, s.
    pub fn time_secs(&self) -> f64 {
        self.raw().time
    }

    /// Sets the simulated time, s.
    pub fn set_time_secs(&mut self, secs: f64) {
        // SAFETY: owned and alive; `&mut self` makes it exclusive.
        unsafe { self.raw.as_mut() }.time = secs;
    }

    /// The contacts found by the last collision pass.
    pub fn contacts(&self) -> impl Iterator<Item = Contact> {
        let data = self.raw();
        // SAFETY: `contact` holds `ncon` contacts until the next step; an
        // empty list may have a null pointer.
        let contacts = unsafe {
            match data.ncon {
                0 => &[][..],
                count => std::slice::from_raw_parts(data.contact, count as usize),
            }
        };
        contacts.iter().map(|contact| Contact {
            geoms: contact.geom,
            distance: contact.dist,
        })
    }

    /// How often the simulation has been found unstable: bad positions,
    /// velocities or accelerations.
    pub fn instabilities(&self) -> i32 {
        let warnings = &self.raw().warning;
        [
            c::mjtWarning::mjWARN_BADQPOS,
            c::mjtWarning::mjWARN_BADQVEL,
            c::mjtWarning::mjWARN_BADQACC,
        ]
        .map(|kind| warnings[kind as usize].number)
        .iter()
        .sum()
    }

    /// Dense joint-space inertia, nv × nv, row by row.
    pub fn full_inertia(&self, model: &Model, inertia: &mut [f64]) {
        assert_eq!(inertia.len(), model.nv() * model.nv(), "nv × nv values");
        // SAFETY: the target has nv × nv values, as asserted; `qM` is this
        // data's sparse inertia.
        unsafe { c::mj_fullM(model.as_ptr(), inertia.as_mut_ptr(), self.raw().qM) }
    }

    /// Jacobian of a site's position and rotation, each 3 × nv, row by row.
    pub fn site_jacobian(&self, model: &Model, site: usize, pos: &mut [f64], rot: &mut [f64]) {
        assert_eq!(pos.len(), 3 * model.nv(), "3 × nv values");
        assert_eq!(rot.len(), 3 * model.nv(), "3 × nv values");
        assert!(site < model.raw().nsite as usize, "a site of this model");
        // SAFETY: both targets have 3 × nv values and the site exists, as
        // asserted.
        unsafe {
            c::mj_jacSite(
                model.as_ptr(),
                self.raw.as_ptr(),
                pos.as_mut_ptr(),
                rot.as_mut_ptr(),
                site as i32,
            );
        }
    }

    stages! {
        /// Back to the model's reference configuration.
        reset = mj_resetData;
        /// Everything but the integration.
        forward = mj_forward;
        /// One step.
        step = mj_step;
        /// First half of a step: all that depends on positions and velocities.
        step1 = mj_step1;
        /// Second half of a step: forces, accelerations, integration.
        step2 = mj_step2;
        /// Poses of bodies, geoms and sites.
        kinematics = mj_kinematics;
        /// Quantities about centres of mass, which Jacobians need.
        com_pos = mj_comPos;
        /// Poses of cameras and lights.
        camlight = mj_camlight;
    }

    slices! {
        /// Joint positions.
        qpos = nq * 1;
        /// Joint velocities.
        qvel = nv * 1;
        /// Accelerations.
        qacc = nv * 1;
        /// Controls.
        ctrl = nu * 1;
        /// Bias forces: gravity, Coriolis, centrifugal.
        qfrc_bias = nv * 1;
        /// Body positions, world frame, m.
        xpos = nbody * 3;
        /// Body orientations, world frame, w x y z.
        xquat = nbody * 4;
        /// Centres of mass of bodies, world frame, m.
        xipos = nbody * 3;
        /// Geom positions, world frame, m.
        geom_xpos = ngeom * 3;
        /// Geom orientations, world frame, 3 × 3 row by row.
        geom_xmat = ngeom * 9;
        /// Site positions, world frame, m.
        site_xpos = nsite * 3;
        /// Site orientations, world frame, 3 × 3 row by row.
        site_xmat = nsite * 9;
    }

    slices_mut! {
        /// As the shared slice, to be changed.
        qpos_mut: qpos = nq;
        /// As the shared slice, to be changed.
        qvel_mut: qvel = nv;
        /// As the shared slice, to be changed.
        ctrl_mut: ctrl = nu;
    }
}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: owned, freed once.
        unsafe { c::mj_deleteData(self.raw.as_ptr()) }
    }
}
