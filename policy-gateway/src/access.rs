//! Access table of the gateway: the permission that each call requires. All resources are calls,
//! since the gateway has no web pages.

use transport::{Allowed, Resource, Role};

/// Maps request paths to permissions: workers, which query policies, and operators, who check them,
/// may make all calls. Health checks need no token, because they often come from outside this
/// system.
pub(crate) fn resource(path: &str) -> Resource {
    Resource::Call(match path.starts_with("/grpc.health.v1.Health/") {
        true => Allowed::Everybody,
        false => Allowed::OneOf(&[Role::Worker, Role::Operator]),
    })
}

#[cfg(test)]
mod tests;
