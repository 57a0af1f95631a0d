//! A worker judges a policy server in the same way, directly and through a gateway.

use std::cell::{Cell, RefCell};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use policy_gateway::config::{Config, RouteSpec};
use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::{TestCaseError, TestRunner};
use proto::policy::{CameraRequest, DescribeResponse, InferResponse, Observation, Setting};
use tokio::runtime::Runtime;
use transport::Access;
use worker::actor::{Actor, PolicySession};
use worker::message::FailureKind;
use worker::policy::{PolicyClient, ROLLOUT_SETTINGS};

use crate::support::{Scripted, chunk, description, reloadable, serve};

/// Longest chunk of the policy whose answers are judged.
const HORIZON: u32 = 3;
const SESSION: PolicySession<'static> = PolicySession {
    policy: "p",
    session: "s",
    suite: "libero_object",
    deadline: Duration::from_secs(60),
};

fn worker(address: SocketAddr) -> PolicyClient {
    let endpoint = format!("grpc://{address}");
    PolicyClient::new(&endpoint, &Access::none(), ROLLOUT_SETTINGS).expect("an endpoint")
}

fn numbers() -> impl Strategy<Value = f32> {
    let edges = [1e3, -1e3, 1000.1, -1e9, f32::MAX, f32::NAN, f32::INFINITY];
    prop_oneof![20 => -1.0..1.0_f32, 1 => select(edges.to_vec())]
}

fn answers() -> impl Strategy<Value = InferResponse> {
    let whole_actions = (0..=HORIZON as usize + 1).prop_map(|actions| 7 * actions);
    let count = prop_oneof![3 => whole_actions, 1 => 0..30_usize];
    let numbers = count.prop_flat_map(|count| prop::collection::vec(numbers(), count));
    let width = prop_oneof![9 => Just(7_u32), 1 => 0..9_u32];
    (numbers, width).prop_map(|(numbers, width)| chunk(&numbers, width))
}

/// Draws one of the values, mostly the first.
fn mostly<T: Clone + std::fmt::Debug + 'static>(values: &[T]) -> impl Strategy<Value = T> + use<T> {
    prop_oneof![6 => Just(values[0].clone()), 1 => select(values.to_vec())]
}

fn descriptions() -> impl Strategy<Value = DescribeResponse> {
    let side = || mostly(&[256, 0, 1024, 1025, u32::MAX]);
    let camera = mostly(&["agentview", "robot0_eye_in_hand", "frontview"]);
    let camera = (camera, side(), side()).prop_map(|(name, width, height)| CameraRequest {
        name: name.to_owned(),
        width,
        height,
    });
    let setting = mostly(&["execute", ""])
        .prop_map(|name| Setting { name: name.to_owned(), value: "5".to_owned() });
    (
        mostly(&[proto::PROTOCOL_VERSION, proto::PROTOCOL_VERSION + 1]),
        mostly(&["p", ""]),
        mostly(&[8_u32, 0, 1, 1040, 1041]),
        mostly(&[1_u32, 0, 8, 9, 1041]),
        prop::collection::vec(camera, 0..3),
        prop::collection::vec(mostly(&[1, 0, 8, 9, -1]), 0..3),
        prop::collection::vec(setting, 0..3),
    )
        .prop_map(|(protocol_version, name, horizon, execute, cameras, state, settings)| {
            DescribeResponse {
                protocol_version,
                horizon,
                execute,
                cameras,
                state,
                settings,
                ..description(name, horizon)
            }
        })
}

/// Requires that both verdicts accept the same value if there is no `fault`, and otherwise that
/// both are refusals which name it.
fn compare_verdicts<T: PartialEq + std::fmt::Debug, E: std::fmt::Display>(
    direct: Result<T, E>,
    through: Result<T, E>,
    fault: Option<String>,
) -> Result<(), TestCaseError> {
    match (direct, through, fault) {
        (Ok(direct), Ok(through), None) => prop_assert_eq!(direct, through),
        (Err(direct), Err(through), Some(fault)) => {
            for refusal in [direct, through].map(|error| error.to_string()) {
                prop_assert!(refusal.contains(&fault), "{} in {}", fault, refusal);
            }
        }
        (direct, through, fault) => {
            let [direct, through] =
                [direct, through].map(|verdict| verdict.map_err(|error| error.to_string()));
            return Err(TestCaseError::fail(format!(
                "directly: {direct:?}; through a gateway: {through:?}; fault: {fault:?}"
            )));
        }
    }
    Ok(())
}

/// Regression: the gateway refused numbers beyond 1,000. Without a gateway, the worker clipped
/// them, so that failures of a broken neural network were counted as failed tasks.
#[test]
fn a_worker_judges_answers_alike_with_and_without_a_gateway() {
    let runtime = Runtime::new().expect("a runtime");
    let scripted = Arc::new(Mutex::new(InferResponse::default()));
    let answer = Arc::clone(&scripted);
    let policy = Scripted::new(description("p", HORIZON), move |_| {
        Ok(answer.lock().expect("no panic").clone())
    });
    let server = runtime.block_on(serve(policy));
    let route = format!("p=grpc://{}", server.address);
    let (gateway, _) = runtime.block_on(reloadable(vec![route.parse().expect("a route")]));

    let workers = RefCell::new([server.address, gateway.address].map(worker));
    for worker in workers.borrow_mut().iter_mut() {
        worker.describe(SESSION).expect("a description");
        let instruction = "pick up the milk and place it in the basket";
        let reset = worker.reset(SESSION, instruction, 7);
        reset.expect("an episode");
    }
    let query = Cell::new(0);
    let judged = TestRunner::default().run(&answers(), |response| {
        let fault = proto::checks::actions(&response, HORIZON).err();
        *scripted.lock().expect("no panic") = response;
        let index = query.replace(query.get() + 1);
        let [direct, through] = workers.borrow_mut().each_mut().map(|worker| {
            worker.infer(SESSION, index, Observation::default(), HORIZON as usize, None)
        });
        for error in [&direct, &through].into_iter().filter_map(|verdict| verdict.as_ref().err()) {
            let kind = FailureKind::from(error);
            prop_assert_eq!(kind, FailureKind::PolicyMisbehaved, "{}", error);
        }
        compare_verdicts(direct, through, fault.map(|fault| fault.to_string()))
    });
    judged.expect("the same verdict");
}

#[test]
fn a_worker_judges_descriptions_alike_with_and_without_a_gateway() {
    let runtime = Runtime::new().expect("a runtime");
    let scripted = Arc::new(Mutex::new(description("p", 1)));
    let described = Arc::clone(&scripted);
    let policy = Scripted::new(description("p", 1), |_| Ok(chunk(&[0.0; 7], 7)))
        .describing(move || described.lock().expect("no panic").clone());
    let server = runtime.block_on(serve(policy));
    let route: RouteSpec = format!("p=grpc://{}", server.address).parse().expect("a route");
    let (gateway, handle) = runtime.block_on(reloadable(vec![route.clone()]));
    let config = Config::new(vec![route]).expect("one route");

    let workers = RefCell::new([server.address, gateway.address].map(worker));
    let judged = TestRunner::default().run(&descriptions(), |description| {
        let fault = proto::checks::description(&description).err();
        *scripted.lock().expect("no panic") = description;
        // Drops the previous description, which the policy would otherwise have to match.
        handle.reload(&config).expect("the same route");
        let [direct, through] =
            workers.borrow_mut().each_mut().map(|worker| worker.describe(SESSION));
        for error in [&direct, &through].into_iter().filter_map(|verdict| verdict.as_ref().err()) {
            let kind = FailureKind::from(error);
            prop_assert_eq!(kind, FailureKind::PolicyUnavailable, "{}", error);
        }
        // Only a gateway reports a batch mode.
        let through = through.map(|mut description| {
            description.about.batch_mode.clear();
            description
        });
        compare_verdicts(direct, through, fault.map(|fault| fault.to_string()))
    });
    judged.expect("the same verdict");
}
