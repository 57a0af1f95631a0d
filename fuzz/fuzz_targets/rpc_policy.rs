//! Any calls of the gateway. What must hold is in `hostile`.

#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| {
    (hostile::named("rpc_policy").run)(input);
});
