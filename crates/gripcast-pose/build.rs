//! Selects the ArUco interface of the installed OpenCV: contrib module `aruco` up to version 4.6,
//! `objdetect` from 4.7.

use std::env;
use std::path::PathBuf;
use std::process::Command;

fn main() {
    println!("cargo::rustc-check-cfg=cfg(aruco_contrib)");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=OPENCV_INCLUDE_PATHS");
    if env::var_os("CARGO_FEATURE_OPENCV").is_none() {
        return;
    }
    match opencv_version() {
        Some(version) if version < (4, 7) => println!("cargo::rustc-cfg=aruco_contrib"),
        Some(_) => {}
        None => println!(
            "cargo::warning=opencv2/core/version.hpp not found, assuming OpenCV 4.7 or later; set \
             OPENCV_INCLUDE_PATHS"
        ),
    }
}

/// Reads major and minor version from OpenCV's header.
fn opencv_version() -> Option<(u32, u32)> {
    include_folders()
        .into_iter()
        .flat_map(|folder| [folder.join("opencv4"), folder])
        .find_map(|folder| {
            let header = std::fs::read_to_string(folder.join("opencv2/core/version.hpp")).ok()?;
            let number = |name: &str| {
                header.lines().find_map(|line| {
                    let value = line.strip_prefix("#define ")?.strip_prefix(name)?;
                    value.trim().parse().ok()
                })
            };
            Some((number("CV_VERSION_MAJOR")?, number("CV_VERSION_MINOR")?))
        })
}

fn include_folders() -> Vec<PathBuf> {
    if let Ok(paths) = env::var("OPENCV_INCLUDE_PATHS") {
        return paths
            .split(',')
            .map(|folder| PathBuf::from(folder.trim_start_matches('+')))
            .filter(|folder| !folder.as_os_str().is_empty())
            .collect();
    }
    let output = Command::new("pkg-config")
        .args(["--variable=includedir", "opencv4"])
        .output();
    let folder = output
        .ok()
        .filter(|output| output.status.success())
        .map(|output| PathBuf::from(String::from_utf8_lossy(&output.stdout).trim()));
    let defaults = ["/usr/include", "/usr/local/include"].map(PathBuf::from);
    folder.into_iter().chain(defaults).collect()
}
