#![no_main]

#[path = "../cases/grasp_json.rs"]
mod grasp_json;

libfuzzer_sys::fuzz_target!(|input: &[u8]| grasp_json::check(input));
