//! Objects and fixtures: extracts the model from its file and renames it after the instance, as
//! robosuite 1.4.0's `MujocoXMLObject` does.

use crate::catalog::Category;
use crate::compose::{Instance, InstanceKind, RegionSite};
use crate::element::{Element, parse_numbers};
use crate::error::SceneError;
use crate::pack::AssetPack;
use crate::part::{Part, add_prefix, is_collision_geom};

#[derive(Debug, Clone)]
pub(crate) struct ObjectPart {
    pub(crate) instance: Instance,
    /// The whole model. Its assets are merged into the scene, and its bodies hold the region sites.
    pub(crate) part: Part,
    pub(crate) body: Element,
    pub(crate) footprint: Footprint,
}

/// Horizontal radius, and heights of top and bottom above the origin, m: three marker sites.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Footprint {
    pub(crate) radius: f64,
    pub(crate) top: f64,
    pub(crate) bottom: f64,
}

const FREE_JOINT_DAMPING: &str = "0.0005";

pub(crate) fn load_object(
    pack: &AssetPack,
    name: &str,
    category: &'static Category,
    kind: InstanceKind,
) -> Result<ObjectPart, SceneError> {
    let root = pack.root();
    let what = format!("model of category `{}`", category.name);
    let part = Part::load(&root, category.file, &what)?;
    part.check_files(&root, &what)?;
    build(part, name, category, kind).map_err(|problem| SceneError::Malformed {
        what,
        path: root.path(category.file),
        problem,
    })
}

pub(crate) fn build(
    mut part: Part,
    name: &str,
    category: &'static Category,
    kind: InstanceKind,
) -> Result<ObjectPart, String> {
    let prefix = format!("{name}_");
    let is_object = |body: &&Element| body.tag == "body" && body.name() == Some("object");
    let world = part.worldbody()?;
    let mut body = world
        .children
        .iter()
        .filter(|outer| outer.tag == "body")
        .flat_map(|outer| &outer.children)
        .find(is_object)
        // LIBERO-Plus' models have no outer body.
        .or_else(|| world.children.iter().find(is_object))
        .ok_or("no body `object`, neither inside the outermost body nor in its place")?
        .clone();
    body.set("name", "main");
    filter_and_name_geoms(&mut body);
    if kind == InstanceKind::Object {
        body.children.push(
            Element::new("joint")
                .with("name", "joint0")
                .with("type", "free")
                .with("damping", FREE_JOINT_DAMPING),
        );
    }
    body.children.push(
        Element::new("site")
            .with("pos", "0 0 0")
            .with("size", "0.002 0.002 0.002")
            .with("rgba", "1 0 0 0")
            .with("type", "sphere")
            .with("group", "0")
            .with("name", "default_site"),
    );
    add_prefix(&mut body, &prefix);
    add_prefix(&mut part.root, &prefix);

    let names = |is_selected: &dyn Fn(&Element) -> bool| -> Vec<String> {
        let elements = body.descendants().into_iter().filter(|element| is_selected(element));
        elements.filter_map(|element| element.name().map(str::to_owned)).collect()
    };
    let burner = format!("{prefix}burner");
    let instance = Instance {
        name: name.to_owned(),
        kind,
        category,
        root_body: format!("{prefix}main"),
        joints: names(&|element| element.tag == "joint"),
        contact_geoms: names(&is_collision_geom),
        burner_site: body.find("site", &burner).map(|_| burner),
    };
    let footprint = footprint(&part, &prefix)?;
    Ok(ObjectPart { instance, part, body, footprint })
}

/// Keeps collision group 0 and visual group 1; names unnamed geoms `g<i>`, counting all geoms.
fn filter_and_name_geoms(body: &mut Element) {
    fn visit(element: &mut Element, count: &mut usize) {
        element.children.retain_mut(|child| {
            if child.tag == "geom" {
                let is_kept = matches!(child.get("group"), None | Some("0" | "1"));
                let name = format!("g{count}");
                *count += 1;
                child.set_default("name", &name);
                return is_kept;
            }
            visit(child, count);
            true
        });
    }
    visit(body, &mut 0);
}

fn footprint(part: &Part, prefix: &str) -> Result<Footprint, String> {
    let marker = |name: &str| -> Result<[f64; 3], String> {
        let name = format!("{prefix}{name}");
        part.worldbody()?
            .children
            .iter()
            .flat_map(|outer| &outer.children)
            .find(|site| site.tag == "site" && site.name() == Some(&name))
            .and_then(|site| parse_numbers(site.get("pos").unwrap_or("0 0 0")))
            .and_then(|pos| pos.try_into().ok())
            .ok_or_else(|| format!("no marker site `{}`", &name[prefix.len()..]))
    };
    Ok(Footprint {
        radius: marker("horizontal_radius_site")?[0],
        top: marker("top_site")?[2],
        bottom: marker("bottom_site")?[2],
    })
}

impl ObjectPart {
    /// Visits the bodies in document order like LIBERO, takes the last body that contains the
    /// site, and stops at the first body without any site.
    pub(crate) fn region_site(&self, region: &str) -> Option<RegionSite> {
        let outer =
            self.part.worldbody().ok()?.children.iter().find(|child| child.tag == "body")?;
        let bodies = outer.descendants().into_iter().skip(1).filter(|e| e.tag == "body");
        let mut found = None;
        for body in bodies {
            let inside = body.descendants();
            let mut sites = inside.iter().filter(|e| e.tag == "site").peekable();
            if sites.peek().is_none() {
                break;
            }
            let Some(site) = sites.find(|site| site.name() == Some(region)) else {
                continue;
            };
            let joints = body.children.iter().filter(|child| child.tag == "joint");
            found = Some(RegionSite {
                name: region.to_owned(),
                half_size: half_size(site),
                parent: Some(self.instance.name.clone()),
                joints: joints.filter_map(|joint| joint.name().map(str::to_owned)).collect(),
            });
        }
        found
    }
}

fn half_size(site: &Element) -> [f64; 3] {
    let size = site.get("size").and_then(parse_numbers).unwrap_or_default();
    std::array::from_fn(|axis| size.get(axis).copied().unwrap_or_default())
}
