//! Every fuzz target: runs the checks of `untrusted_input` that have this program's name.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (tests::untrusted_input::named(env!("CARGO_BIN_NAME")).run)(input);
});
