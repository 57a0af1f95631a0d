//! Initial-state files: whatever the bytes, an answer, and only states that
//! can be asked for. The pickle inside is also reached past the zip, whose
//! checksums a fuzzer cannot guess.

#![no_main]

use std::io::Cursor;
use std::path::Path;

use libfuzzer_sys::fuzz_target;
use scene::InitialStates;
use scene::fuzzing::pickled_states;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(states) = InitialStates::from_reader(Cursor::new(bytes), Path::new("fuzzed")) {
        for id in 0..states.count() {
            let state = states.get(id).expect("counted");
            assert!(state.iter().all(|value| value.is_finite()));
        }
        assert_eq!(states.get(states.count()), None);
    }
    if let Ok([rows, columns]) = pickled_states(bytes) {
        assert!(rows * columns * 8 <= bytes.len());
    }
});
