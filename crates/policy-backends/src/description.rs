//! Batch size that a description permits, and the difference between two descriptions. Pure
//! functions. The crate `policy-protocol` checks descriptions and answers.

use benchmark::attempt::CONNECTED_SINCE;
use proto::policy::DescribeResponse;

/// Largest number of queries in one `InferBatch`.
pub const MAX_BATCH_QUERIES: usize = 64;

/// Returns the batch size for a policy, limited by its description and by the largest message.
pub fn batch_size(described: &DescribeResponse) -> usize {
    let cameras = described.cameras.iter();
    let pixels = cameras.map(|camera| u64::from(camera.width) * u64::from(camera.height));
    // Frames may fill half of a message; the other half is more than enough for the readings.
    let query_bytes = 3 * pixels.sum::<u64>().max(1);
    let fitting = proto::MAX_MESSAGE_BYTES as u64 / 2 / query_bytes;
    let declared = u64::from(described.max_batch).min(MAX_BATCH_QUERIES as u64);
    declared.min(fitting).max(1) as usize
}

/// Describes the first difference of a description from the expected description; `None` if there
/// is none. Ignores the protocol version, batching and the time of connection, which may differ
/// between replicas.
pub fn difference(expected: &DescribeResponse, given: &DescribeResponse) -> Option<String> {
    let fields = |described: &DescribeResponse| {
        [
            ("name", described.name.clone()),
            ("checkpoint digest", described.checkpoint_digest.clone()),
            ("checkpoint", described.checkpoint.clone()),
            ("parameter count", described.parameters.to_string()),
            ("horizon", described.horizon.to_string()),
            ("execute", described.execute.to_string()),
            ("cameras", format!("{:?}", described.cameras)),
            ("robot readings", format!("{:?}", described.state)),
            ("stateful", described.stateful.to_string()),
            ("stochastic", described.stochastic.to_string()),
            ("seeding", (!described.unseeded).to_string()),
            ("language", described.language.to_string()),
            ("privileged", described.privileged.to_string()),
            ("real-time chunking", described.real_time_chunking.to_string()),
        ]
    };
    let setting = |described: &DescribeResponse, name: &str| {
        let named = described.settings.iter().find(|setting| setting.name == name);
        named.map_or_else(|| "not given".to_owned(), |setting| setting.value.clone())
    };
    let names = expected.settings.iter().chain(&given.settings);
    let names = names.map(|setting| setting.name.as_str()).filter(|name| *name != CONNECTED_SINCE);
    fields(expected)
        .into_iter()
        .zip(fields(given))
        .map(|((field, expected), (_, given))| (field, expected, given))
        .chain(names.map(|name| (name, setting(expected, name), setting(given, name))))
        .find(|(_, expected, given)| expected != given)
        .map(|(field, expected, given)| format!("its {field} is {given:?}, not {expected:?}"))
}
