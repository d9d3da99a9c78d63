#![no_main]

#[path = "../cases/onnx.rs"]
mod onnx;

libfuzzer_sys::fuzz_target!(|input: &[u8]| onnx::check(input));
