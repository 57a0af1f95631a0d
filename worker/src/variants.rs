//! `worker variants`: counts rollouts of LIBERO-Plus, LIBERO-PRO, LIBERO-Para or a suite file,
//! reports missing files, and runs the rollouts; for variants, also the unperturbed rollouts of
//! their tasks. Results are lines of `results.jsonl`; an interrupted run resumes from them.

mod audit;
mod case;
mod choice;
mod error;
mod own;
mod protocols;
mod results;
mod rules;

use std::path::{Path, PathBuf};

use libero_ctrl::ManifestRow;
use libero_family::Case;
use scene::{AssetPack, Sources};
use sim::{Simulator, SimulatorConfig};

use crate::actor::Actor;
use crate::message::Assignment;
use crate::single;

pub use audit::{Audit, lack};
pub use case::{Prepared, files};
pub use choice::{Choice, RunOptions};
pub use error::VariantsError;
pub use protocols::{Starts, compare};
use results::Results;
pub use results::{Pin, Row, Tally};
pub use rules::Rules;

pub struct Run<'a> {
    pub rules: Rules,
    /// The unperturbed rollouts, if any, followed by the chosen rollouts.
    pub cases: Vec<Case>,
    /// Folder of the results.
    pub output: &'a Path,
    /// True if each rollout is filmed.
    pub video: bool,
    /// Builds the assignment of a rollout whose outputs go to the given folder.
    pub assign: &'a dyn Fn(ManifestRow, &Path) -> Assignment,
}

impl Run<'_> {
    /// Runs the cases without a result. Returns the tally over all results.
    pub fn run(
        &self,
        simulator: SimulatorConfig,
        actor: &mut dyn Actor,
        report: &mut dyn FnMut(&str),
    ) -> Result<Tally, VariantsError> {
        let (sources, pack) = (simulator.sources.clone(), simulator.pack.clone());
        let pin = self.rules.pin(&pack);
        let mut results = Results::open(self.output, pin)?;
        let mut simulator = Simulator::new(simulator);
        for case in &self.cases {
            if results.has(&case.name()) {
                continue;
            }
            let row = self.run_case(case, &sources, &pack, &mut simulator, actor)?;
            let outcome = if row.success { "success" } else { "failure" };
            report(&format!("{}: {outcome} after {} steps", row.variant, row.steps));
            results.add(row)?;
        }
        Ok(results.tally())
    }

    fn run_case(
        &self,
        case: &Case,
        sources: &Sources,
        pack: &AssetPack,
        simulator: &mut Simulator,
        actor: &mut dyn Actor,
    ) -> Result<Row, VariantsError> {
        let row = self.rules.row(case)?;
        pack.provide_with_bar(&[files(&row, sources)?])?;
        let Prepared { files, start, row } = Prepared::new(&row, sources)?;
        let output: PathBuf = self.output.join(case.name());
        let assignment = (self.assign)(row, &output);
        let request = single::Request {
            assignment: &assignment,
            files: Some(files),
            variant: Some(start),
            renders_ends: self.video,
            output: &output,
        };
        let finished = single::run(simulator, actor, &request)?;
        let pin = self.rules.pin(pack);
        Ok(Row::new(case, pin, &assignment.row, &finished))
    }
}
