//! Composition of one MJCF model from a BDDL problem and an asset pack: arena, robot, objects,
//! fixtures and region sites, in the element order of LIBERO's models and with their names.

use std::path::PathBuf;

use benchmark::{Look, Predicate};
use sha2::{Digest, Sha256};

use crate::arena::{Arena, arena, known_problems};
use crate::bddl::Problem;
use crate::catalog::{Category, category, category_count};
use crate::element::{Element, numbers};
use crate::error::SceneError;
use crate::goal;
use crate::object::{ObjectPart, load_object};
use crate::pack::AssetPack;
use crate::part::{Part, recolor_collision_geoms};
use crate::placement::{FixturePose, Samplers};
use crate::robot;
use crate::sources::{AssetRoot, Sources, locate_files};

/// Simulation step of robosuite's macros, s.
const TIMESTEP_SECS: f64 = 0.002;
/// Colour of the arena's collision geoms in robosuite.
const ARENA_COLLISION_RGBA: &str = "0.5 0.5 0 1";
/// Half height of a zone's site, m (`TargetZone`).
const ZONE_HALF_HEIGHT: f64 = 0.007;

#[derive(Debug, Clone)]
pub struct Scene {
    mjcf: String,
    /// Objects in BDDL order, then fixtures.
    pub instances: Vec<Instance>,
    pub regions: Vec<RegionSite>,
    pub goal: Vec<Predicate>,
    /// Fixture poses in campaigns; they replace the poses in the model.
    pub fixture_poses: Vec<FixturePose>,
    pub samplers: Samplers,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InstanceKind {
    Object,
    /// Fixture, whose base does not move, although its drawers and doors do.
    Fixture,
}

#[derive(Debug, Clone)]
pub struct Instance {
    pub name: String,
    pub kind: InstanceKind,
    pub category: &'static Category,
    pub root_body: String,
    /// Names of the joints, in document order; an object's free joint is the last.
    pub joints: Vec<String>,
    pub contact_geoms: Vec<String>,
    /// Site of a stove's burner, which is visible while the stove is on.
    pub burner_site: Option<String>,
}

#[derive(Debug, Clone)]
pub struct RegionSite {
    pub name: String,
    /// Half extents in the site's frame, m.
    pub half_size: [f64; 3],
    /// Instance that the site is attached to; `None` for a zone on the workspace.
    pub parent: Option<String>,
    /// Joints of the body that the site is attached to, such as a drawer's slide.
    pub joints: Vec<String>,
}

impl Scene {
    /// Returns the model as MJCF with this machine's file paths, ready to compile.
    pub fn mjcf(&self, pack: &AssetPack, sources: &Sources) -> String {
        locate_files(&self.mjcf, [&pack.root(), &sources.robosuite()])
    }

    /// Returns the model as MJCF with placeholder folder names, equal on every machine.
    pub fn portable_mjcf(&self) -> &str {
        &self.mjcf
    }

    /// Verifies the meshes and textures that the MJCF references against the digests of
    /// LIBERO's files, if the pack is named `libero`. To be called before compiling.
    pub fn verify_files(&self, pack: &AssetPack) -> Result<(), SceneError> {
        let root = pack.root();
        let mut files = self.files_below(&root);
        files.try_for_each(|file| root.verify(file, "file of the scene"))
    }

    pub fn robot_files(&self, sources: &Sources) -> Vec<PathBuf> {
        let root = sources.robosuite();
        self.files_below(&root).map(|file| root.path(file)).collect()
    }

    fn files_below<'a>(&'a self, root: &'a AssetRoot) -> impl Iterator<Item = &'a str> {
        let references = self.mjcf.split("file=\"").skip(1);
        let files = references.filter_map(|rest| Some(rest.split_once('"')?.0));
        files.filter_map(|file| root.inside(file))
    }

    /// Returns the SHA-256 of the composed MJCF and the fixtures' poses, hex. The digest is equal
    /// on every machine; the pack's own digest covers the files that the MJCF references.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(self.mjcf.as_bytes());
        for pose in &self.fixture_poses {
            hash.update(pose.root_body.as_bytes());
            for value in pose.pos.iter().chain(&pose.quat) {
                hash.update(value.to_le_bytes());
            }
        }
        hex::encode(hash.finalize())
    }

    pub fn instance(&self, name: &str) -> Option<&Instance> {
        self.instances.iter().find(|instance| instance.name == name)
    }

    pub fn region(&self, name: &str) -> Option<&RegionSite> {
        self.regions.iter().find(|region| region.name == name)
    }
}

/// Composes a problem with a pack, in the pack's look; `env_seed` determines the poses of fixtures
/// in campaigns.
pub fn compose(
    problem: &Problem,
    pack: &AssetPack,
    sources: &Sources,
    env_seed: u32,
) -> Result<Scene, SceneError> {
    let arena = arena(&problem.name).ok_or_else(|| SceneError::UnknownProblem {
        problem: problem.name.clone(),
        known: known_problems(),
    })?;
    goal::check_goal(problem)?;
    let robot = robot::load(&sources.robosuite(), arena.robot)?;
    let mut workspace = load_arena(&arena, pack)?;
    let parts = load_instances(problem, &arena, pack)?;
    let regions = find_regions(problem, &arena, &parts, &mut workspace)?;

    let inconsistent = SceneError::Inconsistent;
    let mut model = Part::load(&sources.robosuite(), "base.xml", "base model")?;
    model.root.child_mut("option").set("timestep", TIMESTEP_SECS.to_string());
    model.merge(&workspace, None).map_err(inconsistent)?;
    model.merge(&robot, None).map_err(inconsistent)?;
    for part in &parts {
        model.merge_assets(&part.part);
        model.worldbody_mut().children.push(part.body.clone());
    }
    match pack.look() {
        Look::Mujoco332 => {
            for asset in &mut model.root.child_mut("asset").children {
                if asset.tag == "texture" && asset.get("file").is_some() {
                    asset.set("colorspace", "linear");
                }
            }
        }
        // MuJoCo 3.3.7 takes the colour space from the file.
        Look::Mujoco333 => {}
    }
    let samplers = Samplers::new(problem, &arena, &parts, &regions)?;
    let scene = Scene {
        mjcf: model.root.write(),
        fixture_poses: samplers.campaign_fixtures(env_seed)?,
        samplers,
        instances: parts.into_iter().map(|part| part.instance).collect(),
        regions,
        goal: problem.goal.clone(),
    };
    check_goal(&scene)?;
    Ok(scene)
}

fn load_instances(
    problem: &Problem,
    arena: &Arena,
    pack: &AssetPack,
) -> Result<Vec<ObjectPart>, SceneError> {
    let objects = problem.objects.iter().map(|d| (d, InstanceKind::Object));
    let fixtures = problem
        .fixtures
        .iter()
        .filter(|declaration| declaration.category != arena.workspace_category)
        .map(|d| (d, InstanceKind::Fixture));
    let mut parts: Vec<ObjectPart> = Vec::new();
    for (declaration, kind) in objects.chain(fixtures) {
        let name = &declaration.name;
        if parts.iter().any(|part| part.instance.name == *name) {
            return Err(SceneError::Inconsistent(format!("two instances are called `{name}`")));
        }
        let category =
            category(&declaration.category).ok_or_else(|| SceneError::UnknownCategory {
                category: declaration.category.clone(),
                instance: name.clone(),
                known: category_count(),
            })?;
        parts.push(load_object(pack, name, category, kind)?);
    }
    Ok(parts)
}

fn load_arena(arena: &Arena, pack: &AssetPack) -> Result<Part, SceneError> {
    let root = pack.root();
    let mut part = Part::load(&root, &arena.file, "arena model")?;
    recolor_collision_geoms(part.worldbody_mut(), ARENA_COLLISION_RGBA, Some("floor"));
    let missing = |what: String| SceneError::Malformed {
        what: "arena model".to_owned(),
        path: root.path(&arena.file),
        problem: format!("no {what}"),
    };
    for (texture, file) in [("texplane", &arena.floor_texture), ("tex-wall", &arena.wall_texture)] {
        let texture = part
            .root
            .child_mut("asset")
            .children
            .iter_mut()
            .find(|asset| asset.tag == "texture" && asset.name() == Some(texture))
            .ok_or_else(|| missing(format!("texture `{texture}`")))?;
        let old = texture.get("file").unwrap_or_default();
        let folder = old.rsplit_once('/').map_or("", |(folder, _)| folder);
        let file = format!("{folder}/{file}");
        texture.set("file", file);
    }
    part.check_files(&root, "arena model")?;
    if let Some(table) = arena.table {
        size_table(&mut part, arena, table.full_size, table.friction).map_err(missing)?;
    }
    for camera in arena.cameras {
        let world = part.worldbody_mut();
        let element = match world.find_mut("camera", camera.name) {
            Some(element) => element,
            None => {
                world.children.push(Element::new("camera").with("name", camera.name));
                world.children.last_mut().expect("just pushed")
            }
        };
        element.set("pos", numbers(&camera.pos));
        element.set("quat", numbers(&camera.quat));
    }
    Ok(part)
}

/// Resizes the table's top and legs. The error names an element that the arena's model lacks.
fn size_table(
    part: &mut Part,
    arena: &Arena,
    full_size: [f64; 3],
    friction: [f64; 3],
) -> Result<(), String> {
    /// Distances from the table's edges along x and y, m; from the negative edge if negative.
    const LEG_INSET: [[f64; 2]; 4] = [[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]];
    const LEG_RADIUS: f64 = 0.025;
    let half = full_size.map(|extent| extent / 2.0);
    let offset = arena.workspace_offset;
    let world = part.worldbody_mut();
    let set_attributes = |world: &mut Element, tag: &str, name: &str, values: &[(&str, String)]| {
        let element = world.find_mut(tag, name).ok_or_else(|| format!("{tag} `{name}`"))?;
        for (attribute, value) in values {
            element.set(attribute, value.clone());
        }
        Ok::<(), String>(())
    };
    set_attributes(world, "geom", "floor", &[("pos", numbers(&[0.0; 3]))])?;
    let centre = numbers(&[offset[0], offset[1], -half[2] + offset[2]]);
    set_attributes(world, "body", "table", &[("pos", centre)])?;
    let size = ("size", numbers(&half));
    let friction = ("friction", numbers(&friction));
    set_attributes(world, "geom", "table_collision", &[size.clone(), friction])?;
    set_attributes(world, "geom", "table_visual", &[size])?;
    set_attributes(world, "site", "table_top", &[("pos", numbers(&[0.0, 0.0, half[2]]))])?;
    let half_length = (offset[2] - half[2]) / 2.0;
    for (index, inset) in LEG_INSET.iter().enumerate() {
        let mut pos = [0.0, 0.0, -half_length];
        for axis in 0..2 {
            // On a table that is too narrow for the inset, legs stand on the middle line.
            if half[axis] > (inset[axis] * 2.0).abs() {
                pos[axis] = inset[axis].signum() * half[axis] - inset[axis];
            }
        }
        let name = format!("table_leg{}_visual", index + 1);
        let size = numbers(&[LEG_RADIUS, half_length]);
        set_attributes(world, "geom", &name, &[("pos", numbers(&pos)), ("size", size)])?;
    }
    Ok(())
}

fn find_regions(
    problem: &Problem,
    arena: &Arena,
    parts: &[ObjectPart],
    workspace: &mut Part,
) -> Result<Vec<RegionSite>, SceneError> {
    let mut sites: Vec<RegionSite> = Vec::new();
    for region in &problem.regions {
        // Of regions with the same name, the last definition is used, at the position of the first.
        let region = problem.region(&region.name).expect("the problem has the region");
        if sites.iter().any(|site| site.name == region.name) {
            continue;
        }
        if !region.name.contains(arena.zone_marker) {
            sites
                .extend(parts.iter().filter_map(|part| part.region_site(&region.name)).next_back());
            continue;
        }
        let Some(rectangle) = region.ranges.first() else {
            return Err(SceneError::Inconsistent(format!(
                "region `{}` lies on the workspace and has no `(:ranges …)`",
                region.name
            )));
        };
        let centre = |[a, b]: [f64; 2]| (b + a) / 2.0;
        let half = |[a, b]: [f64; 2]| (b - a) / 2.0;
        let half_size = [half(rectangle.x), half(rectangle.y), ZONE_HALF_HEIGHT];
        if half_size.iter().any(|half| *half < 0.0) {
            return Err(SceneError::Inconsistent(format!(
                "the first rectangle of region `{}` has its corners in the wrong order",
                region.name
            )));
        }
        let offset = arena.zone_offset;
        let pos = [centre(rectangle.x) + offset[0], centre(rectangle.y) + offset[1], offset[2]];
        let body =
            workspace.worldbody_mut().find_mut("body", arena.zone_body).ok_or_else(|| {
                SceneError::Inconsistent(format!("the arena has no body `{}`", arena.zone_body))
            })?;
        body.children.push(
            Element::new("site")
                .with("name", &*region.name)
                .with("pos", numbers(&pos))
                .with("quat", "1 0 0 0")
                .with("rgba", numbers(&region.rgba))
                .with("size", numbers(&half_size))
                .with("type", "box"),
        );
        sites.push(RegionSite {
            name: region.name.clone(),
            half_size,
            parent: None,
            joints: Vec::new(),
        });
    }
    Ok(sites)
}

fn check_goal(scene: &Scene) -> Result<(), SceneError> {
    for predicate in &scene.goal {
        for argument in &predicate.arguments {
            if scene.instance(argument).is_none() && scene.region(argument).is_none() {
                return Err(SceneError::Inconsistent(format!(
                    "the goal {predicate} names `{argument}`, which is neither an instance \
                     nor a region with a site in the asset pack's models"
                )));
            }
        }
    }
    Ok(())
}
