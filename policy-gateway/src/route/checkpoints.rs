//! Pools of a route: one for all suites, or one per suite.

use std::{collections::BTreeMap, sync::Arc};

use policy_backends::{BackendSpec, UnusableBackend};

use super::{pool::Pool, replica::Replica};
use crate::config::{CheckpointSpecs, RouteSpec};

pub(super) enum Checkpoints {
    One(Arc<Pool>),
    PerSuite(BTreeMap<String, Arc<Pool>>),
}

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
        let pool = |suite: &str, replicas: &[BackendSpec]| {
            let replicas = replicas.iter().map(replica);
            let replicas = replicas.collect::<Result<_, UnusableBackend>>()?;
            Ok::<_, UnusableBackend>(Arc::new(Pool::new(suite, replicas, spec.batching)))
        };
        Ok(match &spec.checkpoints {
            CheckpointSpecs::One(replicas) => Self::One(pool("", replicas)?),
            CheckpointSpecs::PerSuite(suites) => {
                let pools = suites
                    .iter()
                    .map(|(suite, replicas)| Ok((suite.clone(), pool(suite, replicas)?)));
                Self::PerSuite(pools.collect::<Result<_, UnusableBackend>>()?)
            }
        })
    }

    pub(super) fn pool(&self, suite: &str) -> Option<&Arc<Pool>> {
        match self {
            Self::One(pool) => Some(pool),
            Self::PerSuite(pools) => pools.get(suite),
        }
    }

    /// Lists the suites that have their own pool, separated by commas.
    pub(super) fn suites(&self) -> String {
        match self {
            Self::One(_) => String::new(),
            Self::PerSuite(pools) => pools.keys().cloned().collect::<Vec<_>>().join(", "),
        }
    }

    /// Returns the only replica; `None` if there are several replicas, or a pool per suite.
    pub(super) fn only(&self) -> Option<(Arc<Pool>, Arc<Replica>)> {
        match self {
            Self::One(pool) => match pool.replicas() {
                [replica] => Some((Arc::clone(pool), Arc::clone(replica))),
                _ => None,
            },
            Self::PerSuite(_) => None,
        }
    }

    /// Returns every replica of every pool.
    pub(super) fn replicas(&self) -> Vec<Arc<Replica>> {
        match self {
            Self::One(pool) => pool.replicas().to_vec(),
            Self::PerSuite(pools) => {
                pools.values().flat_map(|pool| pool.replicas().iter().cloned()).collect()
            }
        }
    }
}
