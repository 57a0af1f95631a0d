//! Files `about.json`, which describe result rows. The checks are in `untrusted_input`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (untrusted_input::named("about_file").run)(input);
});
