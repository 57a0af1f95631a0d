//! An MJCF file prepared for merging into a scene: default classes are expanded, file names are
//! made independent of the file's location, and names are prefixed. Follows robosuite 1.4.0's
//! `MujocoXML`.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use crate::element::Element;
use crate::error::SceneError;
use crate::sources::{AssetRoot, FileRef};

const NAMED_ATTRIBUTES: &[&str] = &[
    "class",
    "childclass",
    "name",
    "objname",
    "material",
    "texture",
    "joint",
    "joint1",
    "joint2",
    "jointinparent",
    "geom",
    "geom1",
    "geom2",
    "mesh",
    "fixed",
    "actuator",
    "tendon",
    "tendon1",
    "tendon2",
    "slidesite",
    "cranksite",
    "body",
    "body1",
    "body2",
    "hfield",
    "target",
    "prefix",
    "site",
];

const LIST_SECTIONS: &[&str] = &["actuator", "sensor", "tendon", "equality", "contact"];

#[derive(Debug, Clone)]
pub(crate) struct Part {
    pub(crate) root: Element,
}

impl Part {
    pub(crate) fn load(root: &AssetRoot, file: &str, what: &str) -> Result<Self, SceneError> {
        let path = root.path(file);
        root.verify(file, what)?;
        let text = std::fs::read_to_string(&path).map_err(|source| SceneError::Read {
            what: what.to_owned(),
            path: path.clone(),
            remedy: root.remedy(),
            source,
        })?;
        Self::parse(&text, root, file).map_err(|problem| SceneError::Malformed {
            what: what.to_owned(),
            path,
            problem,
        })
    }

    /// MuJoCo's own message would not name the model that uses a missing file.
    pub(crate) fn check_files(&self, root: &AssetRoot, what: &str) -> Result<(), SceneError> {
        let mut names = HashSet::new();
        let assets = self.root.child("asset").into_iter();
        for asset in assets.flat_map(|section| &section.children) {
            // Only the first of several assets with one name is merged into a scene.
            if !names.insert((&asset.tag, asset.name())) {
                continue;
            }
            let Some(inside) = asset.get("file").and_then(|file| root.inside(file)) else {
                continue;
            };
            let what = format!("{} of the {what}", asset.tag);
            let path = root.path(inside);
            std::fs::metadata(&path).map_err(|source| SceneError::Read {
                what,
                path,
                remedy: root.remedy(),
                source,
            })?;
        }
        Ok(())
    }

    pub(crate) fn parse(text: &str, root: &AssetRoot, file: &str) -> Result<Self, String> {
        let mut tree = Element::parse(text)?;
        if tree.tag != "mujoco" {
            return Err(format!("expected `<mujoco>`, found `<{}>`", tree.tag));
        }
        expand_defaults(&mut tree)?;
        let folder = Path::new(file).parent().unwrap_or(Path::new(""));
        for asset in &mut tree.child_mut("asset").children {
            if let Some(name) = asset.get("file") {
                let reference = FileRef::resolve(root.kind, folder, name)?;
                asset.set("file", reference.to_string());
            }
        }
        Ok(Self { root: tree })
    }

    pub(crate) fn worldbody(&self) -> Result<&Element, String> {
        self.root.child("worldbody").ok_or_else(|| "no `<worldbody>`".to_owned())
    }

    pub(crate) fn worldbody_mut(&mut self) -> &mut Element {
        self.root.child_mut("worldbody")
    }

    /// Bodies become children of `bodies_to`, or of the world body.
    pub(crate) fn merge(&mut self, other: &Part, bodies_to: Option<&str>) -> Result<(), String> {
        let bodies = other.worldbody()?.children.clone();
        let target = match bodies_to {
            None => self.worldbody_mut(),
            Some(name) => self
                .worldbody_mut()
                .find_mut("body", name)
                .ok_or_else(|| format!("no body `{name}` to attach bodies to"))?,
        };
        target.children.extend(bodies);
        self.merge_assets(other);
        for section in LIST_SECTIONS {
            if let Some(list) = other.root.child(section) {
                let list = list.children.clone();
                self.root.child_mut(section).children.extend(list);
            }
        }
        Ok(())
    }

    /// The first asset of a name stays. As in robosuite, unnamed assets of one kind share a name.
    pub(crate) fn merge_assets(&mut self, other: &Part) {
        let assets = self.root.child_mut("asset");
        let incoming = other.root.child("asset").map_or(&[][..], |section| &section.children);
        for asset in incoming {
            let exists = assets
                .children
                .iter()
                .any(|existing| existing.tag == asset.tag && existing.name() == asset.name());
            if !exists {
                assets.children.push(asset.clone());
            }
        }
    }
}

pub(crate) fn add_prefix(element: &mut Element, prefix: &str) {
    element.for_each_mut(&mut |element| {
        for attribute in NAMED_ATTRIBUTES {
            if let Some(value) = element.get(attribute)
                && !value.starts_with(prefix)
            {
                let value = format!("{prefix}{value}");
                element.set(attribute, value);
            }
        }
    });
}

/// Returns true if an element is a collision geom: by convention, a geom of group 0 or no group.
pub(crate) fn is_collision_geom(element: &Element) -> bool {
    element.tag == "geom" && matches!(element.get("group"), None | Some("0"))
}

/// Removes the material, too; leaves out the geom named `except`.
pub(crate) fn recolor_collision_geoms(root: &mut Element, rgba: &str, except: Option<&str>) {
    root.for_each_mut(&mut |element| {
        if is_collision_geom(element) && (except.is_none() || element.name() != except) {
            element.set("rgba", rgba);
            element.remove("material");
        }
    });
}

/// Attributes of default classes replace those that an element does not set.
fn expand_defaults(root: &mut Element) -> Result<(), String> {
    let mut classes: HashMap<String, Vec<Element>> = HashMap::new();
    root.children.retain(|child| {
        if child.tag != "default" {
            return true;
        }
        for class in &child.children {
            let name = class.get("class").unwrap_or_default().to_owned();
            classes.insert(name, class.children.clone());
        }
        false
    });
    let mut unknown = None;
    root.for_each_mut(&mut |element| {
        let Some(class) = element.remove("class") else {
            return;
        };
        let Some(defaults) = classes.get(&class) else {
            unknown = Some(class);
            return;
        };
        if let Some(default) = defaults.iter().rfind(|default| default.tag == element.tag) {
            for (name, value) in default.attributes() {
                element.set_default(name, value);
            }
        }
    });
    match unknown {
        Some(class) => Err(format!("class `{class}` has no `<default>`")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_classes_set_missing_attributes_only() {
        let mut root = Element::parse(
            r#"<mujoco><default><default class="c"><geom rgba="1 0 0 1" group="1"/></default>
            </default><worldbody><geom class="c" group="0"/><site class="c"/></worldbody></mujoco>"#,
        )
        .unwrap();
        expand_defaults(&mut root).unwrap();
        let geom = &root.child("worldbody").unwrap().children[0];
        assert_eq!(geom.get("rgba"), Some("1 0 0 1"));
        assert_eq!(geom.get("group"), Some("0"));
        assert_eq!(geom.get("class"), None);
        assert!(root.child("default").is_none());
    }

    #[test]
    fn an_unknown_class_is_refused() {
        let mut root = Element::parse(r#"<mujoco><geom class="c"/></mujoco>"#).unwrap();
        assert_eq!(expand_defaults(&mut root).unwrap_err(), "class `c` has no `<default>`");
    }

    #[test]
    fn a_prefix_is_added_only_once() {
        let mut root =
            Element::parse(r#"<body name="a"><geom mesh="m" pos="0 0 0"/></body>"#).unwrap();
        add_prefix(&mut root, "x_");
        let once = root.clone();
        add_prefix(&mut root, "x_");
        assert_eq!(root, once);
        assert_eq!(root.children[0].get("mesh"), Some("x_m"));
        assert_eq!(root.children[0].get("pos"), Some("0 0 0"));
    }
}
