#![no_main]

#[path = "../cases/hostile_names.rs"]
mod hostile_names;

libfuzzer_sys::fuzz_target!(|input: &[u8]| hostile_names::check(input));
