//! Rules of a run: a named protocol or a suite file.

use std::collections::BTreeMap;

use libero_ctrl::{ManifestRow, RolloutId, SuiteFile};
use libero_family::protocol::Protocol;
use libero_family::{Case, SelectionError};
use scene::AssetPack;

use super::results::Pin;

/// Rules of all rollouts of a run.
#[derive(Clone, Debug)]
pub enum Rules {
    /// A protocol of LIBERO-Plus, LIBERO-PRO or LIBERO-Para.
    Protocol(Protocol),
    SuiteFile {
        file: Box<SuiteFile>,
        /// Manifest rows of the file's rollouts, by rollout id.
        rows: BTreeMap<RolloutId, ManifestRow>,
    },
}

impl Rules {
    /// Returns the rules and the rollouts of a suite file.
    pub fn of_file(file: SuiteFile) -> Result<(Self, Vec<Case>), SelectionError> {
        let rows = file.rows();
        let cases: Result<_, _> = rows.iter().map(|row| Case::of_id(row.id)).collect();
        let rows = rows.into_iter().map(|row| (row.id, row)).collect();
        let file = Box::new(file);
        Ok((Self::SuiteFile { file, rows }, cases?))
    }

    /// Returns the name in results and tables.
    pub fn name(&self) -> String {
        match self {
            Self::Protocol(protocol) => protocol.name.to_owned(),
            Self::SuiteFile { file, .. } => file.protocol(),
        }
    }

    /// Returns the manifest row of a case under these rules.
    pub fn row(&self, case: &Case) -> Result<ManifestRow, SelectionError> {
        match self {
            Self::Protocol(protocol) => Ok(case.row(protocol)),
            Self::SuiteFile { rows, .. } => {
                let id = case.own_id();
                let row = id.and_then(|id| rows.get(&id)).cloned();
                row.ok_or(SelectionError::Nothing)
            }
        }
    }

    /// Returns the conditions that all results of a run share.
    pub fn pin(&self, pack: &AssetPack) -> Pin {
        match self {
            Self::Protocol(protocol) => Pin::new(protocol, pack),
            Self::SuiteFile { file, .. } => Pin {
                benchmark: file.name.clone(),
                protocol: file.protocol(),
                prompt_source: file.prompt.name().to_owned(),
                beginning: file.start.name().to_owned(),
                seed: file.seed,
                waits: file.waits,
                ..Pin::new(&Protocol::PRO_OFFICIAL, pack)
            },
        }
    }
}
