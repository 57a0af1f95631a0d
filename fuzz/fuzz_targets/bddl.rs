//! BDDL files: whatever the text, an answer; a problem that was read reads the
//! same when it is written again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use scene::Problem;

fuzz_target!(|text: &str| {
    if let Ok(problem) = Problem::parse(text) {
        let written = problem.to_string();
        assert_eq!(Problem::parse(&written), Ok(problem), "{written}");
    }
});
