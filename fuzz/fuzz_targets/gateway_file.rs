//! The gateway's configuration file. The checks are in `untrusted_input`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (untrusted_input::named("gateway_file").run)(input);
});
