//! Plans the samplers for a problem's `:init`, in LIBERO's order: joints as listed, then objects
//! and fixtures on the workspace, then objects on sites, in sites, and on other objects.

use benchmark::Predicate;

use super::{Base, JointSampler, PoseSampler, PoseTarget, Samplers};
use crate::arena::Arena;
use crate::bddl::{Problem, Rectangle, Region};
use crate::catalog::Articulation;
use crate::compose::{InstanceKind, RegionSite};
use crate::error::SceneError;
use crate::object::ObjectPart;
use crate::rotation::Rotation;

/// Height of an object's underside above the workspace or another object, m.
const OBJECT_Z_OFFSET: f64 = 0.01;

struct Plan<'a> {
    problem: &'a Problem,
    arena: &'a Arena,
    parts: &'a [ObjectPart],
    regions: &'a [RegionSite],
    samplers: Samplers,
}

/// Place that a statement assigns to its object.
enum Place<'a> {
    Workspace(&'a Region),
    OnSite(&'a Region),
    InSite(&'a Region),
    OnObject(&'a str),
}

impl Samplers {
    pub(crate) fn new(
        problem: &Problem,
        arena: &Arena,
        parts: &[ObjectPart],
        regions: &[RegionSite],
    ) -> Result<Self, SceneError> {
        let mut plan = Plan {
            problem,
            arena,
            parts,
            regions,
            samplers: Self { joints: Vec::new(), poses: Vec::new(), sites: Vec::new() },
        };
        for predicate in &problem.init {
            plan.add_joints(predicate)?;
        }
        let placed: Vec<(&Predicate, Place<'_>)> = problem
            .init
            .iter()
            .filter_map(|predicate| Some((predicate, plan.place(predicate)?)))
            .collect();
        let stages: [fn(&Place<'_>) -> bool; 4] = [
            |place| matches!(place, Place::Workspace(_)),
            |place| matches!(place, Place::OnSite(_)),
            |place| matches!(place, Place::InSite(_)),
            |place| matches!(place, Place::OnObject(_)),
        ];
        for stage in stages {
            for (predicate, place) in placed.iter().filter(|(_, place)| stage(place)) {
                plan.add_pose(predicate, place)?;
            }
        }
        Ok(plan.samplers)
    }
}

impl<'a> Plan<'a> {
    fn part(&self, name: &str) -> Option<&'a ObjectPart> {
        self.parts.iter().find(|part| part.instance.name == name)
    }

    fn has_kind(&self, name: &str, kind: InstanceKind) -> bool {
        self.part(name).is_some_and(|part| part.instance.kind == kind)
    }

    /// Place by a statement; `None` if it places nothing or names an unknown region, as in LIBERO.
    fn place(&self, predicate: &'a Predicate) -> Option<Place<'a>> {
        let [_, place] = predicate.arguments.as_slice() else {
            return None;
        };
        let region = self.problem.region(place);
        match predicate.name.as_str() {
            "on" if self.has_kind(place, InstanceKind::Object) => Some(Place::OnObject(place)),
            "on" => region.map(|region| match self.part(&region.target) {
                Some(_) => Place::OnSite(region),
                None => Place::Workspace(region),
            }),
            "in" => region.map(Place::InSite),
            _ => None,
        }
    }

    fn add_joints(&mut self, predicate: &Predicate) -> Result<(), SceneError> {
        let statement = predicate.name.as_str();
        let ("open" | "close" | "turnon" | "turnoff", Some(name)) =
            (statement, predicate.arguments.first())
        else {
            return Ok(());
        };
        let site = self.regions.iter().find(|region| region.name == *name);
        let (part, joints) = match (self.part(name), site) {
            (Some(part), _) => (Some(part), &part.instance.joints),
            (None, Some(site)) => {
                let parent = site.parent.as_deref().unwrap_or_default();
                (self.part(parent), &site.joints)
            }
            (None, None) => return Ok(()),
        };
        let articulation =
            part.map_or(Articulation::None, |part| part.instance.category.articulation);
        let range = match (statement, articulation) {
            ("open", Articulation::OpenClose { open_range, .. }) => open_range,
            ("close", Articulation::OpenClose { close_range, .. }) => close_range,
            ("turnon", Articulation::OnOff { on_range, .. }) => on_range,
            ("turnoff", Articulation::OnOff { off_range, .. }) => off_range,
            _ => {
                return Err(inconsistent(
                    predicate,
                    &format!("`{name}` does not support `{statement}`"),
                ));
            }
        };
        if self.has_kind(name, InstanceKind::Object) {
            let problem = format!("`{name}` moves freely; declare it under `:fixtures`");
            return Err(inconsistent(predicate, &problem));
        }
        self.samplers.joints.push(JointSampler { joints: joints.clone(), range });
        Ok(())
    }

    fn add_pose(&mut self, predicate: &Predicate, place: &Place<'_>) -> Result<(), SceneError> {
        let name = &predicate.arguments[0];
        let part = self.part(name).ok_or_else(|| {
            inconsistent(
                predicate,
                &format!("`{name}` is not declared under `:objects` or `:fixtures`"),
            )
        })?;
        if self.index(name).is_some() {
            let problem = format!("`{name}` is already placed");
            return Err(inconsistent(predicate, &problem));
        }
        let instance = &part.instance;
        let is_fixture = instance.kind == InstanceKind::Fixture;
        if is_fixture && !matches!(place, Place::Workspace(_)) {
            let problem =
                format!("`{name}` is a fixture, and fixtures can only stand on the workspace");
            return Err(inconsistent(predicate, &problem));
        }
        let arena = self.arena;
        let radius = part.footprint.radius;
        let (base, ranges, z_offset) = match place {
            Place::Workspace(region) => {
                let must_fit_whole = !is_fixture && arena.whole_object_in_region;
                let inset = if must_fit_whole { radius } else { 0.0 };
                (
                    Base::Point(arena.workspace_offset),
                    region.ranges.iter().map(|r| bounds(r, inset)).collect(),
                    if is_fixture { arena.fixture_z_offset } else { OBJECT_Z_OFFSET },
                )
            }
            Place::OnSite(region) => {
                let (base, [x, y, _]) = self.site(predicate, region, true)?;
                // Half of the site's length along each axis, as in LIBERO.
                let middle = Rectangle { x: [-x / 2.0, x / 2.0], y: [-y / 2.0, y / 2.0] };
                (base, vec![bounds(&middle, radius)], 0.0)
            }
            Place::InSite(region) => {
                let (base, _) = self.site(predicate, region, false)?;
                (base, vec![[[0.0; 2]; 2]], 0.0)
            }
            Place::OnObject(carrier) => (
                Base::Top(self.placed_index(predicate, carrier)?),
                vec![[[0.0; 2]; 2]],
                OBJECT_Z_OFFSET,
            ),
        };
        let rotation = match place {
            Place::Workspace(region) if is_fixture => Rotation::Yaw(region.yaw),
            _ => instance.category.rotation,
        };
        let target = match instance.joints.last() {
            Some(joint) if !is_fixture => PoseTarget::FreeJoint(joint.clone()),
            _ => PoseTarget::Body(instance.root_body.clone()),
        };
        self.samplers.poses.push(PoseSampler {
            instance: name.clone(),
            place: predicate.arguments[1].clone(),
            base,
            ranges,
            z_offset,
            footprint: part.footprint,
            avoids_others: !is_fixture && !matches!(place, Place::OnObject(_)),
            rotation,
            target,
        });
        Ok(())
    }

    fn site(
        &mut self,
        predicate: &Predicate,
        region: &Region,
        is_relative_to_top: bool,
    ) -> Result<(Base, [f64; 3]), SceneError> {
        let carrier = self.placed_index(predicate, &region.target)?;
        let region_site = self.regions.iter().find(|site| site.name == region.name);
        let region_site = region_site.ok_or_else(|| {
            let problem = format!(
                "the model of `{}` has no site `{}`; is the asset pack complete?",
                region.target, region.name
            );
            inconsistent(predicate, &problem)
        })?;
        let sites = &mut self.samplers.sites;
        let listed = sites.iter().position(|site| *site == region.name);
        let site = listed.unwrap_or_else(|| {
            sites.push(region.name.clone());
            sites.len() - 1
        });
        Ok((Base::Site { carrier, is_relative_to_top, site }, region_site.half_size))
    }

    fn index(&self, name: &str) -> Option<usize> {
        let poses = &self.samplers.poses;
        poses.iter().position(|sampler| sampler.instance == name)
    }

    fn placed_index(&self, predicate: &Predicate, name: &str) -> Result<usize, SceneError> {
        self.index(name).ok_or_else(|| {
            inconsistent(
                predicate,
                &format!("`{name}` is not placed; add a statement that places `{name}`"),
            )
        })
    }
}

fn bounds(rectangle: &Rectangle, inset: f64) -> [[f64; 2]; 2] {
    [rectangle.x, rectangle.y].map(|[low, high]| [low + inset, high - inset])
}

fn inconsistent(predicate: &Predicate, problem: &str) -> SceneError {
    SceneError::Inconsistent(format!("`:init` states {predicate}, but {problem}"))
}
