//! Files of a scene: BDDL problems, object models and initial states.

use std::io::Cursor;
use std::path::Path;

use scene::fuzzing::{object_model, pickled_states};
use scene::{InitialStates, Problem};

/// Parses a BDDL problem, which must survive a round trip.
pub(crate) fn bddl(input: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(input) else {
        return false;
    };
    let Ok(problem) = Problem::parse(text) else {
        return false;
    };
    let written = problem.to_string();
    assert_eq!(Problem::parse(&written), Ok(problem), "{written}");
    true
}

/// Composes scenes from an object model, as a fixture and as a movable object. Each composed scene
/// must survive a round trip.
pub(crate) fn mjcf(input: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(input) else {
        return false;
    };
    // `object_model` checks its own output.
    let [fixture, object] = [false, true].map(|movable| object_model(text, movable).is_ok());
    fixture || object
}

/// Checks that accepted initial states are finite, and that an index after the last state returns
/// `None`. Also parses the input as the bare pickle of a zip archive, since a fuzzer cannot guess
/// the archive's checksums.
pub(crate) fn pruned_init(input: &[u8]) -> bool {
    let mut is_accepted = false;
    if let Ok(states) = InitialStates::from_reader(Cursor::new(input), Path::new("fuzzed")) {
        is_accepted = true;
        for id in 0..states.count() {
            let state = states.get(id).expect("counted");
            assert!(state.iter().all(|value| value.is_finite()));
        }
        assert_eq!(states.get(states.count()), None);
    }
    if let Ok([rows, columns]) = pickled_states(input) {
        is_accepted = true;
        assert!(rows * columns * 8 <= input.len());
    }
    is_accepted
}

pub(crate) fn bddl_seeds() -> Vec<Vec<u8>> {
    let problem = "(define (problem LIBERO_Floor_Manipulation) ; a comment
      (:domain robosuite)
      (:language Put it there)
      (:regions (bin_region (:target floor) (:ranges ((-0.01 0.25 0.01 0.27))))
                (contain_region (:target basket_1)))
      (:fixtures floor - floor)
      (:objects milk_1 milk_2 - milk basket_1 - basket)
      (:obj_of_interest milk_1 basket_1)
      (:init (On basket_1 floor_bin_region))
      (:goal (And (In milk_1 basket_1_contain_region))))";
    vec![problem.into()]
}

pub(crate) fn mjcf_seeds() -> Vec<Vec<u8>> {
    vec![
        include_bytes!("../../../assets/primitives/articulated_objects/flat_stove.xml").to_vec(),
        include_bytes!("../../../assets/primitives/stable_hope_objects/milk/milk.xml").to_vec(),
    ]
}

pub(crate) fn pruned_init_seeds() -> Vec<Vec<u8>> {
    // A NumPy pickle of an array with one row of two numbers.
    let mut pickle = b"\x80\x02cnumpy.core.multiarray\n_reconstruct\nq\x00cnumpy\nndarray\nq\x01\
        K\x00\x85q\x02c_codecs\nencode\nq\x03X\x01\x00\x00\x00bq\x04X\x06\x00\x00\x00latin1q\x05\
        \x86q\x06Rq\x07\x87q\x08Rq\t(K\x01K\x01K\x02\x86q\ncnumpy\ndtype\nq\x0bX\x02\x00\x00\x00f8\
        q\x0c\x89\x88\x87q\rRq\x0e(K\x03X\x01\x00\x00\x00<q\x0fNNNJ\xff\xff\xff\xffJ\xff\xff\xff\xff\
        K\x00tq\x10b\x89h\x03X\x10\x00\x00\x00"
        .to_vec();
    pickle.extend([0; 16]);
    pickle.extend(b"q\x11h\x05\x86q\x12Rq\x13tq\x14b.");
    vec![crate::untrusted_input::files::zipped("archive/data.pkl", &pickle), pickle]
}
