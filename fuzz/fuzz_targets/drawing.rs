//! Models, scenes and cameras for the renderer. What must hold is said in `hostile`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (hostile::named("drawing").run)(input);
});
