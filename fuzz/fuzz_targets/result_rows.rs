//! Result rows of an export or of the reference. The properties are in `untrusted_input`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (untrusted_input::named("result_rows").run)(input);
});
