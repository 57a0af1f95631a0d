//! The software renderer, which draws MuJoCo's abstract scene of a model's state (`mjvScene`).

use std::collections::BTreeMap;
use std::sync::Arc;

use mujoco_rs::mujoco_c as c;
use raster::{Camera, Geom, Light, LightKind, Scene, Shadows, Shape, TextureUse};

use super::View;
use super::prepare::{Material, Prepared, graphics};
use crate::error::SimError;
use crate::mujoco::{Model, Segment, VisualScene};

const PLANE: i32 = c::mjtGeom::mjGEOM_PLANE as i32;

pub(crate) struct SoftwareCanvas {
    visual_scene: VisualScene,
    prepared: Arc<Prepared>,
    scene: Scene,
    canvases: BTreeMap<usize, raster::Canvas>,
}

impl SoftwareCanvas {
    pub(crate) fn new(model: &Model, prepared: Arc<Prepared>) -> Self {
        Self {
            visual_scene: VisualScene::new(model),
            prepared,
            scene: Scene {
                geoms: Vec::new(),
                lights: Vec::new(),
                camera: Camera {
                    pos: [0.0; 3],
                    forward: [0.0; 3],
                    up: [0.0; 3],
                    center: 0.0,
                    half_width: 0.0,
                    bottom: 0.0,
                    top: 0.0,
                    near: 0.0,
                    far: 0.0,
                    orthographic: false,
                },
                sky: None,
                reflections: true,
                shadows: None,
            },
            canvases: BTreeMap::new(),
        }
    }

    pub(crate) fn draw(&mut self, view: View<'_>) -> Result<Vec<u8>, SimError> {
        self.draw_on_canvas(view, raster::Canvas::draw)
    }

    pub(crate) fn depth(&mut self, view: View<'_>) -> Result<Vec<f32>, SimError> {
        self.draw_on_canvas(view, raster::Canvas::depths)
    }

    pub(crate) fn segmentation(
        &mut self,
        view: View<'_>,
    ) -> Result<Vec<Option<Segment>>, SimError> {
        let size = view.size.map(|side| side as usize);
        self.update(view)?;
        let numbers = raster::segments(&self.prepared.model, &self.scene, size)
            .map_err(|error| graphics(error.to_string()))?;
        let segments = self.visual_scene.segments();
        Ok(numbers.into_iter().map(|number| segments.get(&number?).copied()).collect())
    }

    fn draw_on_canvas<T>(
        &mut self,
        view: View<'_>,
        draw: impl FnOnce(
            &mut raster::Canvas,
            &raster::Model,
            &[&[u8]],
            &Scene,
            [usize; 2],
        ) -> Result<T, raster::DrawError>,
    ) -> Result<T, SimError> {
        let camera = view.camera;
        let size = view.size.map(|side| side as usize);
        self.update(view)?;
        let canvas = self.canvases.entry(camera).or_default();
        let levels = self.prepared.largest_levels.iter();
        let levels: Vec<&[u8]> = levels.map(|level| &**level).collect();
        draw(canvas, &self.prepared.model, &levels, &self.scene, size)
            .map_err(|error| graphics(error.to_string()))
    }

    fn update(&mut self, view: View<'_>) -> Result<(), SimError> {
        self.visual_scene.update(view.model, view.data, view.camera);
        let visual = self.visual_scene.scene();
        let eye = self.visual_scene.eye();
        let flag = |flag: c::mjtRndFlag| visual.flags[flag as usize] != 0;
        self.scene.camera = Camera {
            pos: eye.pos,
            forward: eye.forward,
            up: eye.up,
            center: eye.frustum_center,
            half_width: eye.frustum_width,
            bottom: eye.frustum_bottom,
            top: eye.frustum_top,
            near: eye.frustum_near,
            far: eye.frustum_far,
            orthographic: eye.orthographic != 0,
        };
        self.scene.reflections = flag(c::mjtRndFlag::mjRND_REFLECTION);
        self.scene.sky = self.prepared.sky.filter(|_| flag(c::mjtRndFlag::mjRND_SKYBOX));
        self.scene.shadows = read_shadows(view.model).filter(|_| flag(c::mjtRndFlag::mjRND_SHADOW));
        self.scene.lights.clear();
        for light in &visual.lights[..visual.nlight as usize] {
            self.scene.lights.push(read_light(light)?);
        }
        let is_endless =
            |geom: &c::mjvGeom| geom.type_ == PLANE && geom.size[0] == 0.0 && geom.size[1] == 0.0;
        let has_haze = self.scene.sky.is_some() && flag(c::mjtRndFlag::mjRND_HAZE);
        if has_haze && self.visual_scene.geoms().iter().any(is_endless) {
            return Err(graphics(
                "the scene has haze between an endless plane and the sky".to_owned(),
            ));
        }
        self.scene.geoms.clear();
        for geom in self.visual_scene.geoms() {
            self.scene.geoms.push(read_geom(geom, &self.prepared.materials)?);
        }
        Ok(())
    }
}

/// Returns the quality of the model's shadows; `None` if they are switched off.
fn read_shadows(model: &Model) -> Option<Shadows> {
    let raw = model.raw();
    let map = &raw.vis.map;
    let size = usize::try_from(raw.vis.quality.shadowsize).ok()?;
    (size > 0).then_some(Shadows {
        size,
        half_width: (raw.stat.extent * f64::from(map.shadowclip)) as f32,
        cone_share: map.shadowscale,
    })
}

fn read_light(light: &c::mjvLight) -> Result<Light, SimError> {
    let kind = match light.type_ {
        kind if kind == c::mjtLightType::mjLIGHT_DIRECTIONAL as i32 => LightKind::Directional,
        kind if kind == c::mjtLightType::mjLIGHT_SPOT as i32 => LightKind::Spot {
            cutoff: light.cutoff,
            exponent: light.exponent,
            attenuation: light.attenuation,
        },
        kind => {
            return Err(graphics(format!(
                "a light has the unsupported type {kind} (mjtLightType)"
            )));
        }
    };
    Ok(Light {
        kind,
        pos: light.pos,
        dir: light.dir,
        ambient: light.ambient,
        diffuse: light.diffuse,
        specular: light.specular,
        casts_shadow: light.castshadow != 0,
    })
}

fn read_geom(geom: &c::mjvGeom, materials: &[Option<Material>]) -> Result<Geom, SimError> {
    const SPHERE: i32 = c::mjtGeom::mjGEOM_SPHERE as i32;
    const CAPSULE: i32 = c::mjtGeom::mjGEOM_CAPSULE as i32;
    const ELLIPSOID: i32 = c::mjtGeom::mjGEOM_ELLIPSOID as i32;
    const CYLINDER: i32 = c::mjtGeom::mjGEOM_CYLINDER as i32;
    const BOX: i32 = c::mjtGeom::mjGEOM_BOX as i32;
    const MESH: i32 = c::mjtGeom::mjGEOM_MESH as i32;
    // Even values of `dataid` are meshes, odd values are their convex hulls.
    let shape = match (geom.type_, usize::try_from(geom.dataid).ok()) {
        (PLANE, Some(index)) => Shape::Plane(index),
        (PLANE, None) => Shape::Rectangle,
        (SPHERE | ELLIPSOID, _) => Shape::Ellipsoid,
        (CAPSULE, _) => Shape::Capsule,
        (CYLINDER, _) => Shape::Cylinder,
        (BOX, _) => Shape::Box,
        (MESH, Some(index)) if index % 2 == 0 => Shape::Mesh(index / 2),
        (MESH, Some(_)) => {
            return Err(graphics("a geom is drawn as its mesh's convex hull".to_owned()));
        }
        (kind, _) => {
            return Err(graphics(format!("a geom has the unsupported type {kind} (mjtGeom)")));
        }
    };
    let material = usize::try_from(geom.matid).ok();
    let material = material.and_then(|index| materials.get(index).copied().flatten());
    Ok(Geom {
        shape,
        size: geom.size,
        pos: geom.pos,
        mat: geom.mat,
        rgba: geom.rgba,
        emission: geom.emission,
        specular: geom.specular,
        shininess: geom.shininess,
        reflectance: geom.reflectance,
        texture: material.map(|material| TextureUse {
            texture: material.texture,
            repeat: material.repeat,
            uniform: material.uniform,
            by_corner: geom.texcoord != 0,
        }),
        reach: geom.modelrbound,
        segment: u32::try_from(geom.segid).ok(),
    })
}
