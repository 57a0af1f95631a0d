//! `builtin:expert`: `builtin_policies::expert` behind the policy protocol. It requests the
//! simulator's own state, so all its results are marked privileged.

use benchmark::{Entity, EntityKind, Predicate, Privileged};
use proto::policy::entity::Kind;
use proto::policy::{self as wire, DescribeResponse, Language, Observation};

use super::{Action, BuiltinPolicy};

/// Returns the expert's description: no cameras, no robot readings, privileged
/// state, one action per query.
pub fn describe() -> DescribeResponse {
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "expert".to_owned(),
        checkpoint: format!("builtin:expert {}", env!("CARGO_PKG_VERSION")),
        horizon: 1,
        execute: 1,
        stateful: true,
        language: Language::Ignored.into(),
        privileged: true,
        ..DescribeResponse::default()
    }
}

impl BuiltinPolicy for builtin_policies::expert::Expert {
    fn infer(
        &mut self,
        _query_index: u32,
        observation: &Observation,
    ) -> Result<Vec<Action>, String> {
        let state = observation.privileged.as_ref();
        let state =
            state.ok_or("the observation lacks the privileged state that the expert requests")?;
        let action = self.act(&read(state)?);
        action.map(|action| vec![action]).map_err(|error| error.to_string())
    }
}

/// Converts the privileged state. The error names the field or the entity.
fn read(state: &wire::PrivilegedState) -> Result<Privileged, String> {
    let joint = |joint: &wire::JointReading| (joint.name.clone(), joint.position);
    let predicate = |goal: &wire::GoalPredicate| Predicate {
        name: goal.predicate.clone(),
        arguments: goal.arguments.clone(),
    };
    Ok(Privileged {
        entities: state.entities.iter().map(entity).collect::<Result<_, _>>()?,
        joints: state.joints.iter().map(joint).collect(),
        goal: state.goal.iter().map(predicate).collect(),
        grip_pos: numbers(&state.grip_pos, "gripper", "grip_pos")?,
        grip_quat_wxyz: numbers(&state.grip_quat, "gripper", "grip_quat")?,
        gripper_opening: state.gripper_opening,
    })
}

fn entity(entity: &wire::Entity) -> Result<Entity, String> {
    Ok(Entity {
        name: entity.name.clone(),
        kind: match entity.kind() {
            Kind::Object => EntityKind::Object,
            Kind::Fixture => EntityKind::Fixture,
            Kind::Site => EntityKind::Site,
            Kind::Unspecified => {
                return Err(format!("the kind of '{}' is not specified", entity.name));
            }
        },
        category: entity.category.clone(),
        pos: numbers(&entity.pos, &entity.name, "pos")?,
        quat_wxyz: numbers(&entity.quat, &entity.name, "quat")?,
        half_extents: numbers(&entity.half_extents, &entity.name, "half_extents")?,
        centre: numbers(&entity.centre, &entity.name, "centre")?,
    })
}

fn numbers<const N: usize>(values: &[f64], owner: &str, field: &str) -> Result<[f64; N], String> {
    values
        .try_into()
        .map_err(|_| format!("{field} of '{owner}' has {} numbers, not {N}", values.len()))
}

#[cfg(test)]
mod tests {
    use builtin_policies::expert::Expert;

    use super::*;

    #[test]
    fn an_observation_without_privileged_state_is_refused() {
        let refusal = Expert::default().infer(0, &Observation::default()).unwrap_err();
        assert!(refusal.contains("privileged"), "{refusal}");
    }

    #[test]
    fn an_entity_of_the_wrong_width_is_refused_by_name() {
        let bowl = wire::Entity {
            name: "bowl_1".to_owned(),
            kind: Kind::Object.into(),
            pos: vec![0.0; 2],
            ..wire::Entity::default()
        };
        let observation = Observation {
            privileged: Some(wire::PrivilegedState {
                entities: vec![bowl],
                ..wire::PrivilegedState::default()
            }),
            ..Observation::default()
        };
        let refusal = Expert::default().infer(0, &observation).unwrap_err();
        assert_eq!(refusal, "pos of 'bowl_1' has 2 numbers, not 3");
    }

    #[test]
    fn the_expert_declares_privileged_state_and_no_camera() {
        let described = describe();
        assert!(described.privileged && described.cameras.is_empty());
        assert_eq!((described.horizon, described.execute), (1, 1));
    }
}
