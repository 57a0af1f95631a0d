use std::ptr::NonNull;

use mujoco_rs::mujoco_c as c;

use super::model::Model;
use super::values;
use crate::error::SimError;

/// Simulation state of a model.
/// Does not own its model: an environment has two states of one model, which perturbations change.
///
/// # Panics
/// Every method panics if it is given a model of another compilation.
pub struct Data {
    raw: NonNull<c::mjData>,
    /// Serial number of the model's compilation, whose sizes the arrays have.
    model: u64,
}

// SAFETY: plain memory that no thread owns, written through `&mut self`.
unsafe impl Send for Data {}
// SAFETY: `&self` only reads.
unsafe impl Sync for Data {}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    pub geoms: [i32; 2],
    /// Distance between the surfaces, m; negative where they overlap.
    pub distance: f64,
}

macro_rules! slices {
    ($($name:ident = $rows:ident * $columns:literal;)*) => {$(
        pub fn $name<'a>(&'a self, model: &Model) -> &'a [f64] {
            self.assert_made_for(model);
            // SAFETY: the data is of this model, so the field points at this many
            // doubles while the data lives.
            unsafe { values(self.raw().$name.cast_const(), model.raw().$rows * $columns) }
        }
    )*};
}

macro_rules! slices_mut {
    ($($method:ident: $name:ident = $rows:ident;)*) => {$(
        pub fn $method<'a>(&'a mut self, model: &Model) -> &'a mut [f64] {
            self.assert_made_for(model);
            // SAFETY: as for the shared slices; `&mut self` makes the access exclusive.
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
            self.assert_made_for(model);
            // SAFETY: a live model and the data that was made for it, as asserted.
            unsafe { c::$function(model.as_ptr(), self.raw.as_ptr()) }
        }
    )*};
}

impl Data {
    pub fn new(model: &Model) -> Result<Self, SimError> {
        // SAFETY: a live model; null on failure, checked.
        let raw = unsafe { c::mj_makeData(model.as_ptr()) };
        Ok(Self {
            raw: NonNull::new(raw).ok_or(SimError::OutOfMemory("simulation state"))?,
            model: model.serial(),
        })
    }

    /// # Panics
    /// If this state was made for a model of another compilation.
    pub(super) fn assert_made_for(&self, model: &Model) {
        assert!(self.model == model.serial(), "this is a state of another model");
    }

    pub fn copy_from(&mut self, model: &Model, other: &Self) {
        self.assert_made_for(model);
        other.assert_made_for(model);
        // SAFETY: both states were made for this model, as asserted, and the model is alive.
        unsafe { c::mj_copyData(self.raw.as_ptr(), model.as_ptr(), other.raw.as_ptr()) };
    }

    pub(super) fn as_mut_ptr(&mut self) -> *mut c::mjData {
        self.raw.as_ptr()
    }

    fn raw(&self) -> &c::mjData {
        // SAFETY: owned and alive until drop.
        unsafe { self.raw.as_ref() }
    }

    pub fn time_secs(&self) -> f64 {
        self.raw().time
    }

    pub fn set_time_secs(&mut self, secs: f64) {
        // SAFETY: owned and alive; `&mut self` makes the access exclusive.
        unsafe { self.raw.as_mut() }.time = secs;
    }

    /// Returns the contacts found by the last collision pass.
    pub fn contacts(&self) -> impl Iterator<Item = Contact> {
        let data = self.raw();
        // SAFETY: `contact` holds `ncon` contacts until the next step.
        let contacts = unsafe { values(data.contact.cast_const(), data.ncon) };
        contacts.iter().map(|contact| Contact { geoms: contact.geom, distance: contact.dist })
    }

    /// Bad positions, velocities or accelerations since this state was created or last reset.
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

    /// Computes the dense joint-space inertia, nv × nv, row by row.
    pub fn full_inertia(&self, model: &Model, inertia: &mut [f64]) {
        self.assert_made_for(model);
        assert_eq!(inertia.len(), model.nv() * model.nv(), "nv × nv values");
        // SAFETY: the target has nv × nv values, as asserted; `qM` is this
        // data's sparse inertia.
        unsafe { c::mj_fullM(model.as_ptr(), inertia.as_mut_ptr(), self.raw().qM) }
    }

    /// Computes the Jacobian of a site's position and rotation, each 3 × nv, row by row.
    pub fn site_jacobian(&self, model: &Model, site: usize, pos: &mut [f64], rot: &mut [f64]) {
        self.assert_made_for(model);
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
        /// Resets to the model's reference configuration.
        reset = mj_resetData;
        /// Computes everything except the integration.
        forward = mj_forward;
        step = mj_step;
        /// First half of a step: everything that depends on positions and velocities.
        step1 = mj_step1;
        /// Second half of a step: forces, accelerations, integration.
        step2 = mj_step2;
        /// Computes the poses of bodies, geoms and sites.
        kinematics = mj_kinematics;
        /// Computes quantities about centres of mass, which Jacobians need.
        com_pos = mj_comPos;
        /// Computes the poses of cameras and lights.
        camlight = mj_camlight;
    }

    // MuJoCo's arrays of these names: poses in the world frame, positions in m, quaternions w x y z,
    // matrices row by row.
    slices! {
        qpos = nq * 1;
        qvel = nv * 1;
        qacc = nv * 1;
        ctrl = nu * 1;
        qfrc_bias = nv * 1;
        xpos = nbody * 3;
        xquat = nbody * 4;
        xipos = nbody * 3;
        xmat = nbody * 9;
        cam_xpos = ncam * 3;
        cam_xmat = ncam * 9;
        sensordata = nsensordata * 1;
        geom_xpos = ngeom * 3;
        geom_xmat = ngeom * 9;
        site_xpos = nsite * 3;
        site_xmat = nsite * 9;
    }

    slices_mut! {
        qpos_mut: qpos = nq;
        qvel_mut: qvel = nv;
        ctrl_mut: ctrl = nu;
    }
}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: owned, freed once.
        unsafe { c::mj_deleteData(self.raw.as_ptr()) }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    /// Returns a model with this many bodies, each with a hinge, a motor and a site.
    fn chain(bodies: usize) -> Model {
        let body = |at: usize| {
            format!(r#"<body><joint name="j{at}"/><geom size="0.1"/><site name="s{at}"/>"#)
        };
        let bodies_open: String = (0..bodies).map(body).collect();
        let motors: String = (0..bodies).map(|at| format!(r#"<motor joint="j{at}"/>"#)).collect();
        Model::compile(&format!(
            "<mujoco><worldbody>{bodies_open}{}</worldbody><actuator>{motors}</actuator></mujoco>",
            "</body>".repeat(bodies)
        ))
        .expect("a model")
    }

    #[test]
    fn methods_panic_if_given_a_state_of_another_model() {
        // With the larger model's sizes, accesses would exceed the state's arrays.
        let (own, other) = (chain(2), chain(40));
        let foreign = Data::new(&other).expect("a state");
        type Call = fn(&mut Data, &Model, &Data);
        let calls: [(&str, Call); 14] = [
            ("qpos", |data, model, _| drop(data.qpos(model).to_vec())),
            ("ctrl", |data, model, _| drop(data.ctrl(model).to_vec())),
            ("site_xmat", |data, model, _| {
                drop(data.site_xmat(model).to_vec());
            }),
            ("qpos_mut", |data, model, _| data.qpos_mut(model).fill(0.0)),
            ("ctrl_mut", |data, model, _| data.ctrl_mut(model).fill(0.0)),
            ("reset", |data, model, _| data.reset(model)),
            ("forward", |data, model, _| data.forward(model)),
            ("step", |data, model, _| data.step(model)),
            ("step1", |data, model, _| data.step1(model)),
            ("step2", |data, model, _| data.step2(model)),
            ("kinematics", |data, model, _| data.kinematics(model)),
            ("full_inertia", |data, model, _| {
                data.full_inertia(model, &mut vec![0.0; model.nv() * model.nv()]);
            }),
            ("site_jacobian", |data, model, _| {
                let (mut pos, mut rot) = (vec![0.0; 3 * model.nv()], vec![0.0; 3 * model.nv()]);
                data.site_jacobian(model, 0, &mut pos, &mut rot);
            }),
            ("copy_from", |data, model, other| {
                data.copy_from(model, other);
            }),
        ];
        for (name, call) in calls {
            let mut data = Data::new(&own).expect("a state");
            let same = Data::new(&own).expect("a state");
            call(&mut data, &own, &same);
            let refused = catch_unwind(AssertUnwindSafe(|| call(&mut data, &other, &foreign)));
            let message = refused.expect_err(name);
            let message = message.downcast_ref::<&str>().copied().unwrap_or_default();
            assert_eq!(message, "this is a state of another model", "{name}");
        }
        let mut data = Data::new(&own).expect("a state");
        let copied = catch_unwind(AssertUnwindSafe(|| data.copy_from(&own, &foreign)));
        assert!(copied.is_err(), "a copy of another model's state");
    }

    #[test]
    fn a_state_belongs_to_its_model_after_the_model_has_moved() {
        let (mut own, mut other) = (chain(2), chain(40));
        let data = Data::new(&own).expect("a state");
        std::mem::swap(&mut own, &mut other);
        assert_eq!(data.qpos(&other).len(), 2);
        assert!(catch_unwind(AssertUnwindSafe(|| data.qpos(&own).len())).is_err());
        // A second compilation of the same source counts as another model.
        let twin = chain(2);
        assert!(catch_unwind(AssertUnwindSafe(|| data.qpos(&twin).len())).is_err());
        drop((own, other));
    }
}
