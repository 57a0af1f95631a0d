//! Situations from recorded sessions, with a policy's actual inputs.

use std::path::Path;

use policy_backends::recording::{self, Pair, Reader, RecordingError};

use crate::doctor::situation::Situation;

/// Takes up to `count` situations from the recordings of a folder, from as many sessions as
/// possible, and evenly spaced within each session.
pub(crate) fn situations(folder: &Path, count: usize) -> Result<Vec<Situation>, RecordingError> {
    let files = recording::files(folder)?;
    let mut situations = vec![];
    for index in 0..count.min(files.len()) {
        let file = &files[index * files.len() / count.min(files.len())];
        // If `count` is no multiple of the number of sessions, the first sessions contribute one
        // situation more than the last.
        let sessions = count.min(files.len());
        let share = count / sessions + usize::from(index < count % sessions);
        situations.extend(of_session(file, share)?);
    }
    match situations.is_empty() {
        false => Ok(situations),
        true => Err(RecordingError::NoRecordings { folder: folder.to_owned() }),
    }
}

fn of_session(file: &Path, count: usize) -> Result<Vec<Situation>, RecordingError> {
    let mut queries = 0;
    let mut counting = Reader::open(file)?;
    while counting.pair()?.is_some() {
        queries += 1;
    }
    let count = count.min(queries);
    let selected: Vec<usize> = (0..count).map(|index| index * queries / count).collect();
    let mut reader = Reader::open(file)?;
    let mut situations = vec![];
    let mut query = 0;
    while let Some(pair) = reader.pair()? {
        if selected.contains(&query) {
            situations.push(situation(&reader, pair));
        }
        query += 1;
    }
    Ok(situations)
}

pub(crate) fn situation(reader: &Reader, pair: Pair) -> Situation {
    let observation = pair.query.observation.unwrap_or_default();
    let readings = observation.state.iter();
    Situation {
        suite: reader.reset.suite.clone(),
        instruction: reader.reset.instruction.clone(),
        readings: readings.map(|reading| (reading.field(), reading.values.clone())).collect(),
        frames: observation.images,
        privileged: observation.privileged,
    }
}

#[cfg(test)]
mod tests {
    use proto::policy::{
        DescribeResponse, InferRequest, InferResponse, Observation, ResetRequest, StateField,
        StateReading,
    };

    use super::*;
    use policy_backends::recording::Writer;

    fn record(folder: &Path, session: &str, queries: u32) {
        let reset = ResetRequest {
            session: session.to_owned(),
            instruction: session.to_owned(),
            ..ResetRequest::default()
        };
        let mut writer =
            Writer::begin(folder, &DescribeResponse::default(), &reset).expect("written");
        for query_index in 0..queries {
            let reading = StateReading {
                field: StateField::EefPos.into(),
                values: vec![f64::from(query_index); 3],
            };
            let query = InferRequest {
                query_index,
                observation: Some(Observation { state: vec![reading], ..Observation::default() }),
                ..InferRequest::default()
            };
            let answer = InferResponse::default();
            writer.add(&Pair { query, answer }).expect("written");
        }
        writer.finish().expect("finished");
    }

    #[test]
    fn situations_come_from_all_sessions_at_even_intervals() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(situations(folder.path(), 4).is_err());
        record(folder.path(), "short", 1);
        record(folder.path(), "long", 10);
        let taken = situations(folder.path(), 4).expect("recordings");
        let readings = |session: &str| -> Vec<f64> {
            let taken = taken.iter().filter(|situation| situation.instruction == session);
            taken.map(|situation| situation.readings[0].1[0]).collect()
        };
        assert_eq!(readings("short"), [0.0]);
        assert_eq!(readings("long"), [0.0, 5.0]);
    }
}
