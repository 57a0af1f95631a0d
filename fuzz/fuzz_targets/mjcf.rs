//! Object models of an asset pack: whatever the text, an answer; a scene made
//! of one reads the same when it is written.

#![no_main]

use libfuzzer_sys::fuzz_target;
use scene::fuzzing::object_model;

fuzz_target!(|text: &str| {
    for movable in [false, true] {
        let _ = object_model(text, movable);
    }
});
