//! Arbitrary messages to the gateway: every method of `rollout.policy.v1`, with the built-in
//! policies, and arbitrary answers of policy servers. Checks that every call is answered, and that
//! every answer of a policy server yields either executable actions or a refusal.

use std::sync::LazyLock;

use policy_backends::description;
use policy_backends::spec::KINDS;
use policy_gateway::config::Config;
use policy_gateway::service::Gateway;
use prost::Message;
use proto::checks::{LARGEST_NUMBER, MAX_HORIZON};
use proto::policy as wire;
use proto::policy::policy_server::PolicyServer;
use tonic::service::Routes;

use crate::untrusted_input::call::{block_on, call, is_internal_fault, methods};
use crate::untrusted_input::script;

/// Part of the gateway's message if the policy could not answer a query.
const POLICY_FAILED: &str = "the policy failed: ";
/// All methods; an input selects one by its index.
static METHODS: LazyLock<Vec<String>> =
    LazyLock::new(|| methods(include_str!("../../../proto/rollout/policy/v1/policy.proto")));

/// Makes the calls of an input in order; returns true if none was refused.
pub(crate) fn check_calls(input: &[u8]) -> bool {
    block_on(async {
        let routes = ["noop=builtin:noop", "expert=builtin:expert"];
        let routes = routes.map(|route| route.parse().expect("a route"));
        let config = Config::new(routes.into()).expect("two routes");
        let gateway = Gateway::new(&config).expect("no addresses");
        let mut services = Routes::new(PolicyServer::new(gateway));
        let mut are_all_accepted = true;
        for called in script::read(input) {
            let method = &METHODS[usize::from(called.method) % METHODS.len()];
            let path = format!("/rollout.policy.v1.{method}");
            if let Err(refusal) = call(&mut services, &path, &called.messages).await {
                let is_internal_fault =
                    is_internal_fault(&refusal) && !refusal.message().contains(POLICY_FAILED);
                assert!(!is_internal_fault, "{method} {called:?}: {refusal}");
                are_all_accepted = false;
            }
        }
        are_all_accepted
    })
}

/// Parses an input as every kind of policy server answer; returns true if one kind accepts it.
pub(crate) fn check_answers(input: &[u8]) -> bool {
    let mut is_accepted = false;
    if let Ok(described) = wire::DescribeResponse::decode(input)
        && proto::checks::description(&described).is_ok()
    {
        is_accepted = true;
        assert!((1..=MAX_HORIZON).contains(&described.horizon));
        assert!(description::batch_size(&described) >= 1);
        assert_eq!(description::difference(&described, &described), None);
    }
    if let Ok(response) = wire::InferResponse::decode(input)
        && let Ok(actions) = proto::checks::actions(&response, MAX_HORIZON)
    {
        is_accepted = true;
        assert_eq!(response.actions, actions.as_flattened());
        let is_bounded = |number: &f32| number.abs() <= LARGEST_NUMBER;
        assert!(response.actions.iter().all(is_bounded));
    }
    for answers in KINDS.iter().filter_map(|kind| kind.answers.as_ref()) {
        if let Some(response) = (answers.read)(input) {
            is_accepted = true;
            assert!(response.actions.len().is_multiple_of(response.action_width.max(1) as usize));
        }
    }
    is_accepted
}

/// Returns seed inputs for [`check_calls`]: for each policy, a session with one query and a batch
/// of two queries.
pub(crate) fn seeds() -> Vec<Vec<u8>> {
    ["noop", "expert"].map(session).to_vec()
}

pub(crate) fn answer_seeds() -> Vec<Vec<u8>> {
    let described = wire::DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "p".into(),
        horizon: 8,
        execute: 4,
        max_batch: 2,
        cameras: vec![wire::CameraRequest { name: "agentview".into(), width: 128, height: 128 }],
        ..wire::DescribeResponse::default()
    };
    let response = wire::InferResponse { actions: vec![0.5; 14], action_width: 7 };
    let examples = KINDS.iter().filter_map(|kind| Some(kind.answers.as_ref()?.example.to_vec()));
    [described.encode_to_vec(), response.encode_to_vec()].into_iter().chain(examples).collect()
}

fn session(policy: &str) -> Vec<u8> {
    let describe = wire::DescribeRequest {
        protocol_version: proto::PROTOCOL_VERSION,
        policy: policy.into(),
        suite: "libero_object".into(),
    };
    let reset = wire::ResetRequest {
        policy: policy.into(),
        session: "s".into(),
        suite: "libero_object".into(),
        instruction: "pick up the milk and place it in the basket".into(),
        seed: 1,
    };
    let infer = wire::InferRequest {
        policy: policy.into(),
        session: "s".into(),
        query_index: 0,
        observation: Some(wire::Observation {
            privileged: Some(scene()),
            ..wire::Observation::default()
        }),
        under_way: None,
    };
    let batch = wire::InferBatchRequest { queries: vec![infer.clone(), infer.clone()] };
    let end = wire::EndRequest { policy: policy.into(), session: "s".into() };
    [
        script::write(0, &describe.encode_to_vec()),
        script::write(1, &reset.encode_to_vec()),
        script::write(2, &infer.encode_to_vec()),
        script::write(3, &batch.encode_to_vec()),
        script::write(4, &end.encode_to_vec()),
    ]
    .concat()
}

/// Returns a scene with a bowl beside its target plate and the gripper above the origin.
fn scene() -> wire::PrivilegedState {
    let entity = |name: &str, centre: [f64; 3]| wire::Entity {
        name: name.into(),
        kind: wire::entity::Kind::Object.into(),
        category: "akita_black_bowl".into(),
        pos: centre.into(),
        quat: vec![1.0, 0.0, 0.0, 0.0],
        half_extents: vec![0.05, 0.05, 0.02],
        centre: centre.into(),
    };
    wire::PrivilegedState {
        entities: vec![entity("bowl_1", [-0.1, -0.1, 0.02]), entity("plate_1", [0.1, 0.2, 0.02])],
        joints: vec![],
        goal: vec![wire::GoalPredicate {
            predicate: "on".into(),
            arguments: vec!["bowl_1".into(), "plate_1".into()],
        }],
        grip_pos: vec![0.0, 0.0, 0.3],
        grip_quat: vec![0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt(), 0.0],
        gripper_opening: 0.08,
    }
}
