//! Statement about the look that a policy was trained on. In situations that were recorded in both
//! looks, its answers are compared with the recorded actions, for example those of the scripted
//! expert, which do not depend on frames.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use benchmark::Look;
use policy_backends::recording::{self, Pair, Reader, RecordingError};

use crate::doctor::recorded::situation;
use crate::doctor::server::{Action, ExaminationError, Server};
use crate::doctor::server_pair::SEED;
use crate::doctor::situation::Situation;
use crate::doctor::verdict::{Verdict, pass, skip};

/// Queries taken from each session, at even intervals.
const QUERIES: usize = 6;
/// Smallest number of sessions of which a sign test can say anything at [`LEVEL`]: 2 / 2^6 = 0.03.
const MIN_SESSIONS: usize = 6;
const LEVEL: f64 = 0.05;

/// A folder of recordings, and the look in which they were made: `LOOK=DIR`.
#[derive(Clone, Debug)]
pub struct RecordedLook {
    look: Look,
    folder: PathBuf,
}

impl FromStr for RecordedLook {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (look, folder) = text.split_once('=').ok_or("write LOOK=DIR")?;
        let look = look.parse().map_err(|error| format!("{error}"))?;
        Ok(Self { look, folder: folder.into() })
    }
}

#[derive(Debug)]
pub struct Session {
    queries: Vec<Query>,
}

#[derive(Debug)]
struct Query {
    /// The situation in each look, in the order of [`Look::ALL`].
    situations: [Situation; 2],
    /// First action of the recorded answer.
    recorded: Action,
}

/// Reads the sessions that two folders have in common.
pub fn sessions(folders: &[RecordedLook]) -> Result<Vec<Session>, ExaminationError> {
    let of = |look| folders.iter().find(|recorded| recorded.look == look);
    let [Some(older), Some(newer)] = Look::ALL.map(of) else {
        return Err(ExaminationError::OneLook);
    };
    let mut others = Vec::new();
    for path in recording::files(&newer.folder)? {
        others.push((Reader::open(&path)?.reset, path));
    }
    let mut sessions = Vec::new();
    for path in recording::files(&older.folder)? {
        let reset = Reader::open(&path)?.reset;
        let other = others.iter().find(|(other, _)| {
            (&other.suite, &other.instruction, other.seed)
                == (&reset.suite, &reset.instruction, reset.seed)
        });
        if let Some((_, other)) = other {
            sessions.push(session(&path, other)?);
        }
    }
    sessions.retain(|session| !session.queries.is_empty());
    Ok(sessions)
}

/// Takes queries with the same state of the robot from two recordings of an episode.
fn session(older: &Path, newer: &Path) -> Result<Session, RecordingError> {
    let mut readers = [Reader::open(older)?, Reader::open(newer)?];
    let mut queries = Vec::new();
    while let [Some(older), Some(newer)] = [readers[0].pair()?, readers[1].pair()?] {
        let recorded = first_action(&older);
        let [older, newer] = [(&readers[0], older), (&readers[1], newer)]
            .map(|(reader, pair)| situation(reader, pair));
        // From a different state on, the two episodes have nothing in common.
        if older.readings != newer.readings {
            break;
        }
        queries.extend(recorded.map(|recorded| Query { situations: [older, newer], recorded }));
    }
    let count = queries.len();
    let taken = QUERIES.min(count);
    let mut index = 0;
    queries.retain(|_| {
        index += 1;
        (0..taken).any(|number| number * count / taken == index - 1)
    });
    Ok(Session { queries })
}

fn first_action(pair: &Pair) -> Option<Action> {
    let first: [f32; 7] = pair.answer.actions.get(..7)?.try_into().ok()?;
    Some(first.map(f64::from))
}

/// Queries the server in every situation of the sessions, and says which look's answers are nearer
/// to the recorded actions.
pub async fn examine(server: &Server, sessions: &[Session]) -> Result<Verdict, ExaminationError> {
    let mut errors = Vec::new();
    for session in sessions {
        let mut sums = [0.0; 2];
        for query in &session.queries {
            for (situation, sum) in query.situations.iter().zip(&mut sums) {
                let observation = situation.observation(&server.described);
                let observation = observation.map_err(|missing| server.lacks(missing))?;
                let (suite, instruction) = (&situation.suite, &situation.instruction);
                let mut episode = server.episode(suite, instruction, SEED).await?;
                let actions = episode.actions(observation).await?;
                episode.end().await;
                *sum += distance(&actions[0], &query.recorded);
            }
        }
        errors.push(sums.map(|sum| sum / session.queries.len() as f64));
    }
    Ok(verdict(&errors))
}

fn distance(action: &Action, other: &Action) -> f64 {
    action.iter().zip(other).map(|(a, b)| (a - b).abs()).sum::<f64>() / action.len() as f64
}

/// Judges the mean errors by session, in the order of [`Look::ALL`].
fn verdict(errors: &[[f64; 2]]) -> Verdict {
    let count = errors.len();
    if count < MIN_SESSIONS {
        return skip(format!(
            "{count} sessions are recorded in both looks: at least {MIN_SESSIONS} are needed"
        ));
    }
    let means = [0, 1].map(|look| errors.iter().map(|e| e[look]).sum::<f64>() / count as f64);
    let wins = [0, 1].map(|look| errors.iter().filter(|e| e[look] < e[1 - look]).count());
    let nearer = usize::from(wins[1] > wins[0]);
    let figures = format!(
        "in {} of {count} sessions its answers are nearer to the recorded actions in the look {}, \
         mean error {:.3} against {:.3}",
        wins[nearer],
        Look::ALL[nearer],
        means[nearer],
        means[1 - nearer],
    );
    let p = sign_test(wins);
    match p < LEVEL && means[nearer] < means[1 - nearer] {
        true => pass(format!(
            "it was probably trained on {}: {figures} (p = {p:.1e})",
            Look::ALL[nearer]
        )),
        false => skip(format!("its answers do not tell: {figures} (p = {p:.2})")),
    }
}

fn sign_test([a, b]: [usize; 2]) -> f64 {
    let count = a + b;
    let mut term = 0.5_f64.powi(i32::try_from(count).unwrap_or(i32::MAX));
    let mut tail = 0.0;
    for successes in 0..=a.min(b) {
        tail += term;
        term *= (count - successes) as f64 / (successes + 1) as f64;
    }
    (2.0 * tail).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_test_is_binomial() {
        assert_eq!(sign_test([6, 0]), 2.0 / 64.0);
        assert_eq!(sign_test([1, 7]), 2.0 * 9.0 / 256.0);
        assert_eq!(sign_test([4, 4]), 1.0);
    }

    #[test]
    fn a_look_is_named_only_if_its_answers_are_nearer_beyond_chance() {
        let nearer_in = |older: usize, newer: usize| {
            let errors = std::iter::repeat_n([0.1, 0.3], older);
            verdict(&errors.chain(std::iter::repeat_n([0.3, 0.1], newer)).collect::<Vec<_>>())
        };
        let named = |verdict: &Verdict, look: Look| {
            let start = format!("it was probably trained on {look}: in 8 of 8 sessions");
            matches!(verdict, Verdict::Pass { note } if note.starts_with(&start))
        };
        assert!(named(&nearer_in(8, 0), Look::Mujoco332));
        assert!(named(&nearer_in(0, 8), Look::Mujoco333));
        let undecided = |verdict: Verdict| matches!(verdict, Verdict::Skip { .. });
        assert!(undecided(nearer_in(5, 3)));
        assert!(undecided(nearer_in(5, 0)));
    }
}
