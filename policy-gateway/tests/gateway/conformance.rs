//! Behind a gateway, policies conform to the policy protocol.

use crate::scripted::{failures, proper, stochastic};
use crate::support::{Scripted, gateway, serve};

#[tokio::test]
async fn the_builtin_policies_conform() {
    let gateway = gateway(&["noop=builtin:noop", "expert=builtin:expert"]).await;
    assert_eq!(failures(&format!("{}/noop", gateway.address)).await, []);
    assert_eq!(failures(&format!("{}/expert", gateway.address)).await, []);
}

#[tokio::test]
async fn a_policy_that_ignores_the_version_conforms_behind_a_gateway() {
    let server = serve(Scripted::new(stochastic(), |query| proper(&query))).await;
    let gateway = gateway(&[&format!("x=grpc://{}", server.address)]).await;
    assert_eq!(failures(&gateway.address.to_string()).await, []);
}
