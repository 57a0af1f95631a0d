//! The examination of policy servers on real sockets.

mod compare;
mod conformance;
mod mistakes;
mod planted;
#[allow(dead_code, reason = "the gateway's tests stop these servers and call them directly")]
mod scripted;
