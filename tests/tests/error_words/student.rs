//! Errors of the student: unusable weights and queries; and of the expert: unsupported scenes.

use expert::ExpertError;
use policy_backends::builtin::student::WeightsFileError;
use student::{QueryError, WeightsError};

use crate::{Messages, io_error, path, text, variants};

pub(crate) fn add(messages: &mut Messages) {
    variants!(messages, WeightsFileError,
        WeightsFileError::Unreadable { .. } => WeightsFileError::Unreadable {
            path: path(), source: io_error(),
        },
        WeightsFileError::InvalidWeights { .. } => WeightsFileError::InvalidWeights {
            path: path(), source: WeightsError::Name,
        },
    );
    variants!(messages, WeightsError,
        WeightsError::Unreadable { .. } => WeightsError::Unreadable { bytes: 12 },
        WeightsError::Format { .. } => WeightsError::Format {
            found: None, expected: ["rollout-student/1", "rollout-student/2"],
        },
        WeightsError::Name => WeightsError::Name,
        WeightsError::Missing { .. } => WeightsError::Missing {
            tensor: text(), expected: vec![384], kind: "F16",
        },
        WeightsError::Shape { .. } => WeightsError::Shape {
            tensor: text(), found: vec![1], expected: vec![384],
        },
        WeightsError::Type { .. } => WeightsError::Type {
            tensor: text(), found: "F64".to_owned(), expected: "F16",
        },
        WeightsError::NotFinite { .. } => WeightsError::NotFinite {
            tensor: text(), place: 3, value: "NaN".to_owned(),
        },
        WeightsError::NotPositive { .. } => WeightsError::NotPositive {
            tensor: text(), place: 3, value: "0".to_owned(),
        },
        WeightsError::Unknown { .. } => WeightsError::Unknown { tensor: text() },
    );
    variants!(messages, ExpertError,
        ExpertError::Entities { .. } => ExpertError::Entities {
            given: 1_001, most: 1_000,
        },
        ExpertError::NoEntity { .. } => ExpertError::NoEntity { name: text() },
        ExpertError::NoJointNamed { .. } => ExpertError::NoJointNamed { name: text() },
        ExpertError::NoJoint { .. } => ExpertError::NoJoint { fixture: text() },
        ExpertError::NoDrawer { .. } => ExpertError::NoDrawer { region: text() },
        ExpertError::NotGraspable { .. } => ExpertError::NotGraspable { object: text() },
        ExpertError::NoSkill { .. } => ExpertError::NoSkill { goal: text() },
        ExpertError::OutOfRange { .. } => ExpertError::OutOfRange {
            field: "pos", owner: text(), value: 1e256,
        },
    );
    variants!(messages, QueryError,
        QueryError::Picture { .. } => QueryError::Picture {
            query: 0, camera: "agentview", found: 3, expected: 196_608,
        },
        QueryError::State { .. } => QueryError::State {
            query: 0, reading: "eef_pos", place: 1, value: "inf".to_owned(),
        },
        QueryError::Answer { .. } => QueryError::Answer { query: 0 },
    );
}
