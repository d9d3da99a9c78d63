//! Tells the marker detector which of OpenCV's interfaces the system has: versions up to 4.6 have
//! it in the contrib module `aruco`, later ones in `objdetect`.

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
            "cargo::warning=opencv2/core/version.hpp was not found, so OpenCV 4.7 or later is \
             assumed; set OPENCV_INCLUDE_PATHS"
        ),
    }
}

/// Major and minor version by OpenCV's header.
fn opencv_version() -> Option<(u32, u32)> {
    include_folders()
        .into_iter()
        .flat_map(|folder| [folder.join("opencv4"), folder])
        .find_map(|folder| {
            let header = std::fs::read_to_string(folder.join("opencv2/core/version.hpp")).ok()?;
            let number = |name: &str| {
                header.lines().find_map(|line| {
                    let mut words = line.split_whitespace();
                    let is_it = words.next() == Some("#define") && words.next() == Some(name);
                    is_it.then(|| words.next()?.parse().ok()).flatten()
                })
            };
            Some((number("CV_VERSION_MAJOR")?, number("CV_VERSION_MINOR")?))
        })
}

fn include_folders() -> Vec<PathBuf> {
    if let Some(given) = env::var_os("OPENCV_INCLUDE_PATHS") {
        let given = given.to_string_lossy().into_owned();
        return given
            .split(',')
            .map(|folder| PathBuf::from(folder.trim_start_matches('+')))
            .filter(|folder| !folder.as_os_str().is_empty())
            .collect();
    }
    let asked = Command::new("pkg-config")
        .args(["--variable=includedir", "opencv4"])
        .output();
    let folder = asked
        .ok()
        .filter(|output| output.status.success())
        .map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
    let usual = ["/usr/include", "/usr/local/include"].map(PathBuf::from);
    folder.map(PathBuf::from).into_iter().chain(usual).collect()
}
