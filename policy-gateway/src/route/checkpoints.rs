//! Pools of a route: one for all suites, or one per suite.

use std::collections::BTreeMap;
use std::sync::Arc;

use policy_backends::{BackendSpec, UnusableBackend};

use super::pool::Pool;
use super::replica::Replica;
use crate::config::RouteSpec;

/// Pools by suite; that of the empty name serves all suites.
pub(super) struct Checkpoints(BTreeMap<String, Arc<Pool>>);

impl Checkpoints {
    /// Creates the pools of `spec`. Reuses the `existing` replicas whose settings are unchanged.
    pub(super) fn new(
        spec: &RouteSpec,
        existing: &[Arc<Replica>],
    ) -> Result<Self, UnusableBackend> {
        let access = spec.access.read()?;
        let replica = |backend: &BackendSpec| {
            let unchanged = existing.iter().find(|replica| replica.has_settings(backend, spec));
            match unchanged {
                Some(replica) => Ok(Arc::clone(replica)),
                None => Replica::new(backend, &access, spec).map(Arc::new),
            }
        };
        let pools = spec.checkpoints.iter().map(|(suite, replicas)| {
            let replicas = replicas.iter().map(replica).collect::<Result<_, UnusableBackend>>()?;
            Ok((suite.clone(), Arc::new(Pool::new(suite, replicas, spec.batching))))
        });
        Ok(Self(pools.collect::<Result<_, UnusableBackend>>()?))
    }

    pub(super) fn pool(&self, suite: &str) -> Option<&Arc<Pool>> {
        self.0.get("").or_else(|| self.0.get(suite))
    }

    /// Lists the suites that have their own pool, separated by commas.
    pub(super) fn suites(&self) -> String {
        self.0.keys().cloned().collect::<Vec<_>>().join(", ")
    }

    /// Returns the only replica; `None` if there are several replicas, or a pool per suite.
    pub(super) fn only(&self) -> Option<(Arc<Pool>, Arc<Replica>)> {
        let pool = self.0.get("")?;
        match pool.replicas() {
            [replica] => Some((Arc::clone(pool), Arc::clone(replica))),
            _ => None,
        }
    }

    pub(super) fn replicas(&self) -> Vec<Arc<Replica>> {
        self.0.values().flat_map(|pool| pool.replicas().iter().cloned()).collect()
    }
}
