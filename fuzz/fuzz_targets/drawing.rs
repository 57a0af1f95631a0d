//! Models, scenes and cameras for the renderer. The checks are in `untrusted_input`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (untrusted_input::named("drawing").run)(input);
});
