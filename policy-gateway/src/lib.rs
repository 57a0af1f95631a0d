//! Between workers and policy servers: routes a worker's queries to the policy
//! it names and checks every answer before an action reaches a robot. To a
//! worker a gateway looks like a policy. Not responsible for simulating,
//! perturbing or clipping anything.

#![forbid(unsafe_code)]

pub mod builtin;
