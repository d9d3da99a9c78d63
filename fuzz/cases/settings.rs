//! Texts that people write or bring along. Input: which one (byte 0, modulo 5), text.

use std::path::Path;

use gripcast::config;
use gripcast_capture::calibration::RigFile;
use gripcast_capture::trigger::Script;
use gripcast_pose::{BoardFile, CameraFile, CameraReadOptions};
use gripcast_session::Command;

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    let Some((kind, text)) = input.split_first() else {
        return;
    };
    let Ok(text) = std::str::from_utf8(text) else {
        return;
    };
    match kind % 5 {
        0 => {
            let file = config::ConfigFile::Found("gripcast.toml".into());
            let _ = config::merge(Some((&file, text)), [], &[]);
        }
        1 => {
            let _ = RigFile::parse(text);
        }
        2 => {
            // No dictionary is beside it.
            let _ = BoardFile::parse(text, Path::new("/proc/nonexistent"));
        }
        3 => {
            let _ = CameraFile::parse(text, CameraReadOptions::default());
        }
        _ => {
            let check = |line: &str| match line.parse::<Command>() {
                Ok(_) => Ok(()),
                Err(error) => Err(error.to_string()),
            };
            let _ = Script::parse(text, "script", &check);
        }
    }
}
