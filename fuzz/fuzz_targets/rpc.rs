//! Arbitrary calls of the coordinator's methods. The checks are in `untrusted_input`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (untrusted_input::named("rpc").run)(input);
});
