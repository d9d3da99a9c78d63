#![no_main]

#[path = "../cases/mesh.rs"]
mod mesh;

libfuzzer_sys::fuzz_target!(|input: &[u8]| mesh::check(input));
