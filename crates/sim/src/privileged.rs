//! The simulator's own state, for scripted experts and debugging.

use benchmark::{Entity, EntityKind, Privileged};
use scene::{Instance, InstanceKind, RegionSite};

use crate::controller::{ARM_JOINTS, GRIP_SITE};
use crate::environment::Environment;
use crate::error::SimError;
use crate::mujoco::{Data, Model, ObjectKind};
use crate::ready_scene::FREE_JOINT;

impl Environment {
    pub fn privileged(&self) -> Result<Privileged, SimError> {
        let (scene, model, data) = (self.scene(), self.model(), self.data());
        let instances =
            scene.instances.iter().map(|instance| instance_entity(model, data, instance));
        let regions = scene.regions.iter().map(|region| region_entity(model, data, region));
        let grip = model.id(ObjectKind::Site, GRIP_SITE)?;
        let qpos = data.qpos(model);
        Ok(Privileged {
            entities: instances.chain(regions).collect::<Result<_, _>>()?,
            joints: joints(self)?,
            goal: scene.goal.clone(),
            grip_pos: triple(data.site_xpos(model), grip),
            grip_quat_wxyz: site_quat(model, data, grip),
            gripper_opening: qpos[ARM_JOINTS] - qpos[ARM_JOINTS + 1],
        })
    }
}

fn joints(environment: &Environment) -> Result<Vec<(String, f64)>, SimError> {
    let (model, data) = (environment.model(), environment.data());
    let mut joints = Vec::new();
    for name in environment.scene().instances.iter().flat_map(|instance| &instance.joints) {
        let id = model.id(ObjectKind::Joint, name)?;
        if model.jnt_type()[id] != FREE_JOINT {
            let position = data.qpos(model)[model.jnt_qposadr()[id] as usize];
            joints.push((name.clone(), position));
        }
    }
    Ok(joints)
}

fn instance_entity(model: &Model, data: &Data, instance: &Instance) -> Result<Entity, SimError> {
    let body = model.id(ObjectKind::Body, &instance.root_body)?;
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for name in &instance.contact_geoms {
        let geom = model.id(ObjectKind::Geom, name)?;
        let (centre, half) = world_box(model, data, geom);
        for axis in 0..3 {
            low[axis] = low[axis].min(centre[axis] - half[axis]);
            high[axis] = high[axis].max(centre[axis] + half[axis]);
        }
    }
    let pos = triple(data.xpos(model), body);
    if instance.contact_geoms.is_empty() {
        (low, high) = (pos, pos);
    }
    Ok(Entity {
        name: instance.name.clone(),
        kind: match instance.kind {
            InstanceKind::Object => EntityKind::Object,
            InstanceKind::Fixture => EntityKind::Fixture,
        },
        category: instance.category.name.to_owned(),
        pos,
        quat_wxyz: std::array::from_fn(|i| data.xquat(model)[body * 4 + i]),
        half_extents: std::array::from_fn(|axis| (high[axis] - low[axis]) / 2.0),
        centre: std::array::from_fn(|axis| (high[axis] + low[axis]) / 2.0),
    })
}

/// Returns the world-aligned bounding box of a geom: centre and half extents, m.
fn world_box(model: &Model, data: &Data, geom: usize) -> ([f64; 3], [f64; 3]) {
    let local = &model.geom_aabb()[geom * 6..][..6];
    let rotation = &data.geom_xmat(model)[geom * 9..][..9];
    let pos = triple(data.geom_xpos(model), geom);
    let row = |axis: usize| &rotation[axis * 3..][..3];
    let along = |axis: usize, values: &[f64]| -> f64 {
        row(axis).iter().zip(values).map(|(r, v)| r * v).sum()
    };
    let spread = |axis: usize| -> f64 {
        row(axis).iter().zip(&local[3..]).map(|(r, half)| r.abs() * half).sum()
    };
    (std::array::from_fn(|axis| pos[axis] + along(axis, &local[..3])), std::array::from_fn(spread))
}

fn region_entity(model: &Model, data: &Data, region: &RegionSite) -> Result<Entity, SimError> {
    let site = model.id(ObjectKind::Site, &region.name)?;
    let pos = triple(data.site_xpos(model), site);
    Ok(Entity {
        name: region.name.clone(),
        kind: EntityKind::Site,
        category: region.parent.clone().unwrap_or_default(),
        pos,
        quat_wxyz: site_quat(model, data, site),
        half_extents: region.half_size,
        centre: pos,
    })
}

fn site_quat(model: &Model, data: &Data, site: usize) -> [f64; 4] {
    let matrix = nalgebra::Matrix3::from_row_slice(&data.site_xmat(model)[site * 9..][..9]);
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(matrix);
    let quat = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
    [quat.w, quat.i, quat.j, quat.k]
}

fn triple(values: &[f64], index: usize) -> [f64; 3] {
    std::array::from_fn(|axis| values[index * 3 + axis])
}
