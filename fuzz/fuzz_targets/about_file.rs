//! What is said beside result rows. What must hold is said in `hostile`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (hostile::named("about_file").run)(input);
});
