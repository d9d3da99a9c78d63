//! Texts that people write or bring along. Input: which one (byte 0, modulo 6), text.

use std::path::Path;

use gripcast::config;
use gripcast_capture::calibration::RigFile;
use gripcast_capture::trigger::Script;
use gripcast_pose::{
    BoardFile, CameraFile, CameraReadOptions, Dictionary, import_aruco_map, import_kalibr,
    import_ros,
};
use gripcast_session::Command;

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    let Some((kind, text)) = input.split_first() else {
        return;
    };
    let Ok(text) = std::str::from_utf8(text) else {
        return;
    };
    match kind % 6 {
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
            for (size, camera) in [(None, None), (Some([640, 480]), Some("cam0"))] {
                if let Ok(file) = CameraFile::parse(text, CameraReadOptions { size, camera }) {
                    file.intrinsics
                        .validate()
                        .expect("intrinsics are plausible");
                }
            }
        }
        5 => {
            let Ok(dictionary) = Dictionary::by_name("4X4_50") else {
                return;
            };
            let _ = import_ros(text, &dictionary);
            let _ = import_kalibr(text, "board", None);
            let _ = import_aruco_map(text, "board", None);
            let _ = Dictionary::from_opencv("own.yml", text);
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
