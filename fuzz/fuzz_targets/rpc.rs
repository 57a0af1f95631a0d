//! Any calls of the coordinator. What must hold is in `hostile`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (hostile::named("rpc").run)(input);
});
