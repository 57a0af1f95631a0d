//! Import of result rows, from an export or from the reference implementation. The checks are in
//! `untrusted_input`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (untrusted_input::named("result_rows").run)(input);
});
