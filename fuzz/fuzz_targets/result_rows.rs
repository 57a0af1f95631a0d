//! Result rows, of the reference implementation or exported. What must hold is said in `hostile`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (hostile::named("result_rows").run)(input);
});
