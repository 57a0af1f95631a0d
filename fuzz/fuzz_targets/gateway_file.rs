//! The gateway's configuration file. What must hold is said in `hostile`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (hostile::named("gateway_file").run)(input);
});
