//! The same bits on every machine, in every batch.

mod support;

use builtin_policies::student::{Network, Output, Products};
use sha2::{Digest, Sha256};
use support::{OwnedQuery, Weights};

fn network() -> Network {
    Network::from_safetensors(&Weights::random(1).bytes()).expect("weights")
}

fn owned_queries() -> Vec<OwnedQuery> {
    (0..5).map(OwnedQuery::random).collect()
}

fn digest(outputs: &[Output]) -> String {
    let mut hash = Sha256::new();
    for output in outputs {
        for number in output.arm.as_flattened().iter().chain(&output.gripper_logits) {
            hash.update(number.to_bits().to_le_bytes());
        }
    }
    hex::encode(hash.finalize())
}

/// Digest of five answers. It changes only with the network's definition, not with the processor,
/// with the instructions that the code is compiled for, or with versions of libraries.
const GOLDEN: &str = "b0814112ff3d36c7a1a3bbd1e909e5c638806e17facb6116dfaceec49371f682";

#[test]
fn golden_answers_have_the_same_bits_on_every_machine() {
    let owned_queries = owned_queries();
    let queries: Vec<_> = owned_queries.iter().map(OwnedQuery::query).collect();
    let outputs = network().outputs(&queries).expect("answers");
    assert_eq!(digest(&outputs), GOLDEN);
    let has_distinct_values = |numbers: Vec<f32>| numbers.windows(2).any(|pair| pair[0] != pair[1]);
    assert!(has_distinct_values(outputs.iter().map(|output| output.arm[3][2]).collect()));
}

/// Represents machines without fused multiply-adds.
#[test]
fn plain_products_give_the_same_bits() {
    let owned = OwnedQuery::random(1);
    let network = network();
    let expected = network.outputs(&[owned.query()]).expect("an answer");
    let plain = network.with_plain_products();
    assert_eq!(plain.products(), Products::Plain);
    let found = plain.outputs(&[owned.query()]).expect("an answer");
    assert_eq!(digest(&found), digest(&expected));
}

#[test]
fn answers_in_a_batch_equal_single_answers_bit_for_bit() {
    let (network, owned_queries) = (network(), owned_queries());
    let queries: Vec<_> = owned_queries.iter().map(OwnedQuery::query).collect();
    let batched = network.outputs(&queries).expect("answers");
    let mut separate = Vec::new();
    for query in &queries {
        separate.extend(network.outputs(&[*query]).expect("an answer"));
    }
    assert_eq!(digest(&batched), digest(&separate));
    // More queries than the kernels' tiles have rows (16), in another order.
    let many: Vec<_> = (0..37).map(|index| queries[index * 3 % 5]).collect();
    for (index, output) in network.outputs(&many).expect("answers").iter().enumerate() {
        let alone = &batched[index * 3 % 5];
        assert_eq!(digest(&[*output]), digest(&[*alone]), "query {index}");
    }
}

#[test]
fn threads_share_a_network() {
    let (network, owned_queries) = (network(), owned_queries());
    let expected = digest(&network.outputs(&[owned_queries[0].query()]).expect("an answer"));
    std::thread::scope(|scope| {
        let query = || digest(&network.outputs(&[owned_queries[0].query()]).expect("an answer"));
        let threads = [scope.spawn(query), scope.spawn(query)];
        for thread in threads {
            assert_eq!(thread.join().expect("a digest"), expected);
        }
    });
}
