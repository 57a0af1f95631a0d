/// A `place` is an index from 0 in row-major order.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WeightsError {
    #[error(
        "the weights file, {bytes} bytes, is not a complete safetensors file: export it or copy \
         it again"
    )]
    Unreadable { bytes: usize },
    #[error(
        "the weights file's metadata gives {} as its format; this program reads {}: give \
         weights that were exported for it",
        .found.as_ref().map_or("nothing".to_owned(), |found| format!("{found:?}")),
        .expected.map(|format| format!("{format:?}")).join(" or ")
    )]
    Format { found: Option<String>, expected: [&'static str; 2] },
    #[error("the weights file's metadata has no name: export it with \"name\" in the metadata")]
    Name,
    #[error(
        "the weights file has no tensor {tensor}, which must be {expected:?} of {kind}: export \
         the whole network"
    )]
    Missing { tensor: String, expected: Vec<usize>, kind: &'static str },
    #[error(
        "tensor {tensor} of the weights file has the shape {found:?}; expected is {expected:?}: \
         give weights of this network"
    )]
    Shape { tensor: String, found: Vec<usize>, expected: Vec<usize> },
    #[error(
        "tensor {tensor} of the weights file is of type {found}; expected is {expected}: export it \
         as {expected}"
    )]
    Type { tensor: String, found: String, expected: &'static str },
    #[error(
        "tensor {tensor} of the weights file holds {value} at place {place}, where a finite \
         number is expected: training has diverged, export an earlier state"
    )]
    NotFinite { tensor: String, place: usize, value: String },
    #[error(
        "tensor {tensor} of the weights file holds {value} at place {place}, where a number above \
         0 is expected: export a small positive standard deviation for a reading that never changes"
    )]
    NotPositive { tensor: String, place: usize, value: String },
    #[error(
        "the weights file has a tensor {tensor}, which this network lacks: give weights of \
         this network"
    )]
    Unknown { tensor: String },
}

/// A `query` is an index from 0 in the batch, a `place` one within the reading.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QueryError {
    #[error(
        "query {query}: the picture of {camera} has {found} bytes; expected are {expected}, 256 × \
         256 pixels of 3 bytes: request frames of that size"
    )]
    Picture { query: usize, camera: &'static str, found: usize, expected: usize },
    #[error(
        "query {query}: number {place} of {reading} is {value}, which is not finite: check the \
         values that the simulator or the client sent"
    )]
    State { query: usize, reading: &'static str, place: usize, value: String },
    #[error(
        "query {query}: the network's answer is not finite: give readings in metres, as in \
         training, or weights that do not overflow"
    )]
    Answer { query: usize },
}
