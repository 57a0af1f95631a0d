//! What cannot be read or answered, and why.

/// Why a file is not the weights of a student.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WeightsError {
    /// Not the container that weights come in.
    #[error(
        "the weights file, {bytes} bytes, is no safetensors file or is not whole: export it or \
         copy it again"
    )]
    Unreadable {
        /// Bytes that were given.
        bytes: usize,
    },
    /// Another kind of network, or one of another version.
    #[error(
        "the weights file's metadata gives {} as its format; this program reads {expected:?}: give \
         weights that were exported for it",
        .found.as_ref().map_or("nothing".to_owned(), |found| format!("{found:?}"))
    )]
    Format {
        /// What the metadata has as `format`, if anything.
        found: Option<String>,
        /// What is read.
        expected: &'static str,
    },
    /// Weights that do not say what they are called.
    #[error("the weights file's metadata has no name: export it with \"name\" in the metadata")]
    Name,
    /// A tensor is not there.
    #[error(
        "the weights file has no tensor {tensor}, which must be {expected:?} of {kind}: export \
         the whole network"
    )]
    Missing {
        /// Its name.
        tensor: String,
        /// Its shape.
        expected: Vec<usize>,
        /// Its numbers' type.
        kind: &'static str,
    },
    /// A tensor has other dimensions.
    #[error(
        "tensor {tensor} of the weights file has the shape {found:?}; expected is {expected:?}: \
         give weights of this network"
    )]
    Shape {
        /// Its name.
        tensor: String,
        /// Its shape.
        found: Vec<usize>,
        /// The network's.
        expected: Vec<usize>,
    },
    /// A tensor's numbers are of another type.
    #[error(
        "tensor {tensor} of the weights file is of type {found}; expected is {expected}: export it \
         as {expected}"
    )]
    Type {
        /// Its name.
        tensor: String,
        /// Its type.
        found: String,
        /// The network's.
        expected: &'static str,
    },
    /// A number that cannot be computed with.
    #[error(
        "tensor {tensor} of the weights file holds {value} at place {place}, where a finite \
         number is expected: training has diverged, export an earlier state"
    )]
    NotFinite {
        /// Its name.
        tensor: String,
        /// Counted from 0, row after row.
        place: usize,
        /// What stands there: `NaN`, `inf` or `-inf`.
        value: String,
    },
    /// A divisor that is none.
    #[error(
        "tensor {tensor} of the weights file holds {value} at place {place}, where a number above \
         0 is expected: export a spread of at least a rounding error for numbers that never vary"
    )]
    NotPositive {
        /// Its name.
        tensor: String,
        /// Counted from 0.
        place: usize,
        /// What stands there.
        value: String,
    },
    /// A tensor that no layer takes.
    #[error(
        "the weights file has a tensor {tensor}, which this network does not: give weights of \
         this network"
    )]
    Unknown {
        /// Its name.
        tensor: String,
    },
}

/// Why a query cannot be answered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QueryError {
    /// A picture of another size.
    #[error(
        "query {query}: the picture of {camera} has {found} bytes; expected are {expected}, 256 × \
         256 pixels of 3 bytes: ask the camera for that size"
    )]
    Picture {
        /// Which of the queries, counted from 0.
        query: usize,
        /// `agentview` or `wrist`.
        camera: &'static str,
        /// Its bytes.
        found: usize,
        /// What they should be.
        expected: usize,
    },
    /// A reading that is no number to compute with.
    #[error(
        "query {query}: number {place} of {reading} is {value}, which is not finite: look for what \
         the simulator or the client sent"
    )]
    State {
        /// Which of the queries, counted from 0.
        query: usize,
        /// `eef_pos`, `eef_rotation` or `gripper_pos`.
        reading: &'static str,
        /// Counted from 0.
        place: usize,
        /// What it is.
        value: String,
    },
    /// An answer that has left the range of numbers.
    #[error(
        "query {query}: the network's answer is not finite: give readings in metres as the \
         network was trained on, or weights that do not overflow"
    )]
    Answer {
        /// Which of the queries, counted from 0.
        query: usize,
    },
}
