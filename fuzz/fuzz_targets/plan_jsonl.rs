#![no_main]

#[path = "../cases/plan_jsonl.rs"]
mod plan_jsonl;

libfuzzer_sys::fuzz_target!(|input: &[u8]| plan_jsonl::check(input));
