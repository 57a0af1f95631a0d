//! Evaluation of goals with LIBERO's predicates (hf-libero 0.1.4, `object_states` and `objects`),
//! resolved to ids once per scene.
//!
//! As in LIBERO, predicates use the body positions and contacts that the last simulation step
//! computed before it integrated, and the joint positions that the integration resulted in.

use benchmark::Predicate;
use scene::catalog::{Articulation, Threshold};
use scene::{Instance, RegionSite, Scene};

use crate::error::SimError;
use crate::mujoco::{Data, Model, ObjectKind};

/// A goal resolved to ids: all its checks must hold.
pub struct Goal {
    checks: Vec<Check>,
    /// For each geom, the instance that has it as a collision geom.
    owner_of_geom: Vec<Option<usize>>,
}

enum Check {
    /// An object on another object or a fixture.
    OnObject { upper: ObjectRef, lower: ObjectRef },
    /// The object must touch `parent`, the region's instance; `None` for a zone on the workspace.
    OnSite { object: ObjectRef, site: Site, parent: Option<usize> },
    /// An object in a region.
    InSite { object: ObjectRef, site: Site },
    /// Joints beyond a threshold: one of them or all of them.
    Joints { addresses: Vec<usize>, condition: JointCondition, quantifier: Quantifier },
}

#[derive(Clone, Copy)]
struct ObjectRef {
    instance: usize,
    body: usize,
}

struct Site {
    id: usize,
    half_size: [f64; 3],
}

#[derive(Clone, Copy)]
enum JointCondition {
    Side(Threshold),
    AtLeast(f64),
}

#[derive(Clone, Copy)]
enum Quantifier {
    Any,
    All,
}

/// Horizontal distance below which an object counts as `on` another object, m.
const STACKED_DISTANCE: f64 = 0.03;
/// Distances below and above the top of a region within which an object is `on` the region, m.
const ON_SITE_BELOW: f64 = 0.005;
const ON_SITE_ABOVE: f64 = 0.10;
/// Distance below a region within which an object is still `in` the region, m.
const IN_SITE_BELOW: f64 = 0.01;

impl Goal {
    pub fn resolve(
        predicates: &[Predicate],
        scene: &Scene,
        model: &Model,
    ) -> Result<Self, SimError> {
        let mut owner_of_geom = vec![None; model.count(ObjectKind::Geom)];
        for (index, instance) in scene.instances.iter().enumerate() {
            for geom in &instance.contact_geoms {
                owner_of_geom[model.id(ObjectKind::Geom, geom)?] = Some(index);
            }
        }
        let resolver = Resolver { scene, model };
        let checks = predicates.iter().map(|predicate| resolver.check(predicate));
        Ok(Self { checks: checks.collect::<Result<_, _>>()?, owner_of_geom })
    }

    pub fn holds(&self, model: &Model, data: &Data) -> bool {
        self.checks.iter().all(|check| self.check_holds(check, model, data))
    }

    /// Returns the truth value of each predicate, in the BDDL file's order.
    pub fn truths(&self, model: &Model, data: &Data) -> Vec<bool> {
        self.checks.iter().map(|check| self.check_holds(check, model, data)).collect()
    }

    fn check_holds(&self, check: &Check, model: &Model, data: &Data) -> bool {
        let position = |object: &ObjectRef| vector(data.xpos(model), object.body);
        match check {
            Check::OnObject { upper, lower } => {
                let (above, below) = (position(upper), position(lower));
                let distance = (below[0] - above[0]).hypot(below[1] - above[1]);
                below[2] <= above[2]
                    && distance < STACKED_DISTANCE
                    && self.are_touching(data, upper.instance, lower.instance)
            }
            Check::OnSite { object, site, parent } => {
                site.supports(model, data, position(object))
                    && parent.is_none_or(|parent| self.are_touching(data, parent, object.instance))
            }
            Check::InSite { object, site } => site.contains(model, data, position(object)),
            Check::Joints { addresses, condition, quantifier } => {
                let holds = |address: &usize| condition.holds(data.qpos(model)[*address]);
                match quantifier {
                    Quantifier::Any => addresses.iter().any(holds),
                    Quantifier::All => addresses.iter().all(holds),
                }
            }
        }
    }

    fn are_touching(&self, data: &Data, a: usize, b: usize) -> bool {
        let owner = |geom: i32| usize::try_from(geom).ok().and_then(|g| self.owner_of_geom[g]);
        data.contacts().any(|contact| {
            let owners = contact.geoms.map(owner);
            owners == [Some(a), Some(b)] || owners == [Some(b), Some(a)]
        })
    }
}

impl Site {
    /// Rotates the offset by the site's matrix rather than its transpose, like LIBERO.
    fn supports(&self, model: &Model, data: &Data, position: [f64; 3]) -> bool {
        let offset = self.offset(model, data, position);
        let rotation = &data.site_xmat(model)[self.id * 9..self.id * 9 + 9];
        let along = |row: usize| -> f64 {
            (0..3).map(|column| rotation[row * 3 + column] * offset[column]).sum()
        };
        let [half_x, half_y, half_z] = self.half_size;
        let height = along(2);
        half_z - ON_SITE_BELOW < height
            && height < half_z + ON_SITE_ABOVE
            && along(0).abs() < half_x
            && along(1).abs() < half_y
    }

    fn contains(&self, model: &Model, data: &Data, position: [f64; 3]) -> bool {
        let rotation = &data.site_xmat(model)[self.id * 9..self.id * 9 + 9];
        let centre = vector(data.site_xpos(model), self.id);
        (0..3).all(|axis| {
            let extent: f64 =
                (0..3).map(|column| rotation[axis * 3 + column] * self.half_size[column]).sum();
            let slack = if axis == 2 { IN_SITE_BELOW } else { 0.0 };
            let (low, high) = (centre[axis] - extent.abs() - slack, centre[axis] + extent.abs());
            position[axis] > low && position[axis] < high
        })
    }

    fn offset(&self, model: &Model, data: &Data, position: [f64; 3]) -> [f64; 3] {
        let centre = vector(data.site_xpos(model), self.id);
        std::array::from_fn(|axis| position[axis] - centre[axis])
    }
}

impl JointCondition {
    fn holds(self, q: f64) -> bool {
        match self {
            Self::Side(threshold) => threshold.holds(q),
            Self::AtLeast(limit) => q >= limit,
        }
    }
}

fn vector(values: &[f64], index: usize) -> [f64; 3] {
    std::array::from_fn(|axis| values[index * 3 + axis])
}

enum Referent<'a> {
    Instance(usize, &'a Instance),
    Region(&'a RegionSite),
}

struct Resolver<'a> {
    scene: &'a Scene,
    model: &'a Model,
}

impl<'a> Resolver<'a> {
    fn check(&self, predicate: &Predicate) -> Result<Check, SimError> {
        let problem = |problem: &str| SimError::Predicate {
            predicate: predicate.to_string(),
            problem: problem.to_owned(),
        };
        let referent = |name: &str| {
            self.referent(name).ok_or_else(|| problem(&format!("`{name}` is not in the scene")))
        };
        let object = |name: &str| match referent(name)? {
            Referent::Instance(index, instance) => self.object_ref(index, instance),
            Referent::Region(_) => Err(problem(&format!("`{name}` is a region, not an object"))),
        };
        match (predicate.name.as_str(), predicate.arguments.as_slice()) {
            ("on", [upper, lower]) => match referent(lower)? {
                Referent::Instance(index, instance) => Ok(Check::OnObject {
                    upper: object(upper)?,
                    lower: self.object_ref(index, instance)?,
                }),
                Referent::Region(region) => Ok(Check::OnSite {
                    object: object(upper)?,
                    site: self.site(region)?,
                    parent: region.parent.as_deref().and_then(|name| self.instance_index(name)),
                }),
            },
            ("in", [inner, outer]) => match referent(outer)? {
                Referent::Region(region) => {
                    Ok(Check::InSite { object: object(inner)?, site: self.site(region)? })
                }
                Referent::Instance(..) => Err(problem(&format!(
                    "`{outer}` is an object or a fixture, and `in` needs a region"
                ))),
            },
            ("open" | "close" | "turnon" | "turnoff", [name]) => {
                let (instance, joints) = match referent(name)? {
                    Referent::Instance(_, instance) => (instance, &instance.joints),
                    Referent::Region(region) => {
                        let parent = region.parent.as_deref().and_then(|p| self.scene.instance(p));
                        let parent = parent.ok_or_else(|| {
                            problem(&format!("`{name}` belongs to no object or fixture"))
                        })?;
                        (parent, &region.joints)
                    }
                };
                let (condition, quantifier) =
                    articulation_check(&predicate.name, instance.category.articulation)
                        .ok_or_else(|| {
                            problem(&format!(
                                "category `{}` does not support `{}`",
                                instance.category.name, predicate.name
                            ))
                        })?;
                Ok(Check::Joints { addresses: self.addresses(joints)?, condition, quantifier })
            }
            _ => Err(problem("no predicate has this name and number of arguments")),
        }
    }

    fn instance_index(&self, name: &str) -> Option<usize> {
        self.scene.instances.iter().position(|instance| instance.name == name)
    }

    fn referent(&self, name: &str) -> Option<Referent<'a>> {
        let scene = self.scene;
        self.instance_index(name)
            .map(|index| Referent::Instance(index, &scene.instances[index]))
            .or_else(|| scene.region(name).map(Referent::Region))
    }

    fn object_ref(&self, instance: usize, names: &Instance) -> Result<ObjectRef, SimError> {
        Ok(ObjectRef { instance, body: self.model.id(ObjectKind::Body, &names.root_body)? })
    }

    fn site(&self, region: &RegionSite) -> Result<Site, SimError> {
        let id = self.model.id(ObjectKind::Site, &region.name)?;
        Ok(Site { id, half_size: region.half_size })
    }

    fn addresses(&self, joints: &[String]) -> Result<Vec<usize>, SimError> {
        let address = |name: &String| {
            let joint = self.model.id(ObjectKind::Joint, name)?;
            Ok(self.model.jnt_qposadr()[joint] as usize)
        };
        joints.iter().map(address).collect()
    }
}

fn articulation_check(
    predicate: &str,
    articulation: Articulation,
) -> Option<(JointCondition, Quantifier)> {
    match (predicate, articulation) {
        ("open", Articulation::OpenClose { open, .. }) => {
            Some((JointCondition::Side(open), Quantifier::Any))
        }
        ("close", Articulation::OpenClose { close, .. }) => {
            Some((JointCondition::Side(close), Quantifier::All))
        }
        ("turnon", Articulation::OnOff { on, .. }) => {
            Some((JointCondition::AtLeast(on), Quantifier::Any))
        }
        ("turnoff", Articulation::OnOff { off, .. }) => {
            Some((JointCondition::Side(Threshold::Below(off)), Quantifier::All))
        }
        _ => None,
    }
}
