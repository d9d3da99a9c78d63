#![no_main]

#[path = "../cases/calibration_table.rs"]
mod calibration_table;

libfuzzer_sys::fuzz_target!(|input: &[u8]| calibration_table::check(input));
