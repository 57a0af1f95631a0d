//! `policy-gateway doctor URL`: checks a server for common mistakes. This module orders the
//! checks: `diagnosed_server` queries the server, `verdicts` judges the answers, `memory`
//! watches the server's process.

use std::time::Duration;

use crate::doctor::{
    looks::{self, Session},
    server::{ExaminationError, Server},
    situation::Situation,
    verdict::{self, Finding, Verdict, fail, points, skip},
};
use diagnosed_server::{Answered, DiagnosedServer};
use memory::Process;
use verdicts::Change;

mod diagnosed_server;
mod memory;
mod verdicts;

points! {
    Actions "answers are finite actions of seven numbers",
    Range "actions lie within -1..1",
    Motion "the arm moves",
    Observations "other observations get other actions",
    Frames "other frames get other actions",
    Instructions "other instructions get other actions",
    Gripper "the gripper opens",
    /// Precedes the latency check, whose percentiles include the many queries of this check.
    Memory "an ended episode leaves no state behind",
    Latency "answers arrive in time",
    Look "answers tell the look of its training",
}

#[derive(Clone, Copy, Debug)]
pub struct Measures {
    /// Longest time for one answer, as configured in a gateway.
    pub answer_within: Duration,
    pub episodes: u32,
}

/// Checks a server point by point, in situations and in sessions that were recorded in both looks,
/// and reports each finding as soon as it is made. Returns true if no point failed.
pub async fn examine(
    server: &Server,
    situations: &[Situation],
    looks: &[Session],
    measures: Measures,
    report: &mut dyn FnMut(&Finding<Point>),
) -> Result<bool, ExaminationError> {
    let mut diagnosed = DiagnosedServer::new(server, situations)?;
    let answered = diagnosed.answer_all().await?;
    let mut is_sound = true;
    for &point in Point::ALL {
        let verdict = verdict_on(point, &mut diagnosed, &answered, (looks, measures)).await;
        let verdict = verdict.unwrap_or_else(|error| fail(format!("failed to {error}")));
        is_sound &= !verdict.has_failed();
        report(&Finding { point, verdict });
    }
    Ok(is_sound)
}

async fn verdict_on(
    point: Point,
    diagnosed: &mut DiagnosedServer<'_>,
    answered: &Answered,
    (looks, measures): (&[Session], Measures),
) -> Result<Verdict, ExaminationError> {
    let actions = &answered.actions;
    let described = &diagnosed.server().described;
    let noise = answered.noise;
    Ok(match point {
        Point::Actions => verdicts::actions(&answered.faults, answered.count),
        Point::Memory => memory(diagnosed, measures.episodes).await?,
        Point::Latency => verdicts::latency(&diagnosed.latencies, measures.answer_within),
        _ if !answered.faults.is_empty() => skip("not all of its answers are actions"),
        Point::Range => verdict::range(actions.as_flattened()),
        Point::Motion => verdicts::motion(actions),
        Point::Gripper => verdicts::gripper(actions),
        _ if verdicts::is_constant(actions) => skip("all of its actions are the same"),
        Point::Observations => {
            let largest = answered.between_situations;
            verdicts::observations(
                Change { largest, noise },
                diagnosed.situation_count(),
                described,
            )
        }
        Point::Look if looks.is_empty() => skip("no session is recorded in both looks (--look)"),
        Point::Look => looks::examine(diagnosed.server(), looks).await?,
        Point::Frames if described.cameras.is_empty() => skip("it requests no frames"),
        Point::Frames => {
            let mut changes = vec![];
            for camera in &described.cameras {
                let largest = diagnosed.with_other_frames(&camera.name).await?;
                changes.push((camera.name.clone(), Change { largest, noise }));
            }
            verdicts::frames(&changes)
        }
        Point::Instructions => match verdicts::reads_language(described) {
            Err(reason) => skip(reason),
            Ok(()) => {
                let (largest, count) = diagnosed.with_other_instructions().await?;
                verdicts::instructions(Change { largest, noise }, count)
            }
        },
    })
}

/// Plays episodes, and checks that the server's memory does not grow with them or, if the memory
/// cannot be read, its latency.
async fn memory(
    diagnosed: &mut DiagnosedServer<'_>,
    episodes: u32,
) -> Result<Verdict, ExaminationError> {
    let process = Process::listening_at(&diagnosed.server().url);
    let mut resident = vec![];
    let mut durations = vec![];
    for _ in 0..episodes {
        durations.push(diagnosed.episode().await?);
        resident.extend(process.as_ref().and_then(Process::resident_bytes));
    }
    Ok(match process {
        Some(process) if resident.len() == durations.len() => {
            verdicts::memory(&process.to_string(), &resident)
        }
        _ => verdicts::slowing(&durations),
    })
}
