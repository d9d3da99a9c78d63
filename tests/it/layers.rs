//! Holds every `use crate::…` against the layer table of ARCHITECTURE.md.

use std::fs;
use std::path::{Path, PathBuf};

/// Areas that an area may use, besides itself.
fn allowed(area: &str) -> Option<&'static [&'static str]> {
    const LAYER_0: &[&str] = &[
        "error",
        "files",
        "geometry",
        "hdf5",
        "html",
        "imaging",
        "nn",
        "quiet_panic",
        "workers",
    ];
    const LAYER_1: &[&str] = &[
        "error",
        "files",
        "geometry",
        "hdf5",
        "html",
        "imaging",
        "nn",
        "quiet_panic",
        "workers",
    ];
    const LAYER_2: &[&str] = &[
        "error",
        "files",
        "geometry",
        "hdf5",
        "html",
        "imaging",
        "nn",
        "quiet_panic",
        "workers",
        "sim",
        "pose",
        "dataset",
        "shard",
    ];
    const LAYER_3: &[&str] = &[
        "error",
        "files",
        "geometry",
        "hdf5",
        "html",
        "imaging",
        "nn",
        "quiet_panic",
        "workers",
        "sim",
        "pose",
        "dataset",
        "shard",
        "render",
        "predict",
        "annotate",
    ];
    const LAYER_4: &[&str] = &[
        "error",
        "files",
        "geometry",
        "hdf5",
        "html",
        "imaging",
        "nn",
        "quiet_panic",
        "workers",
        "sim",
        "pose",
        "dataset",
        "shard",
        "render",
        "predict",
        "annotate",
        "synth",
    ];
    Some(match area {
        "error" => &[],
        "quiet_panic" => &[],
        "nn" => &[],
        "files" | "workers" => &["error"],
        "hdf5" => &["error", "files"],
        "geometry" | "imaging" | "html" => LAYER_0,
        "sim" | "pose" | "dataset" | "shard" => LAYER_1,
        "render" | "predict" | "annotate" | "import" | "export" => LAYER_2,
        "rig" | "session" => LAYER_3,
        "synth" => LAYER_3,
        "train" | "replay" => LAYER_4,
        "app" => &[
            "error",
            "files",
            "geometry",
            "hdf5",
            "html",
            "imaging",
            "nn",
            "quiet_panic",
            "workers",
            "sim",
            "pose",
            "dataset",
            "shard",
            "render",
            "predict",
            "annotate",
            "export",
            "import",
            "rig",
            "session",
            "synth",
            "train",
            "replay",
        ],
        _ => return None,
    })
}

pub(crate) fn rust_files(dir: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(dir)
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Areas named by `crate::…` paths of one file, with line numbers.
fn used_areas(source: &str) -> Vec<(usize, String)> {
    let mut used = Vec::new();
    for (number, line) in source.lines().enumerate() {
        if line.trim_start().starts_with("//") {
            continue;
        }
        for (at, _) in line.match_indices("crate::") {
            let before = line[..at].chars().next_back();
            if before.is_some_and(|c| c.is_alphanumeric() || c == '_') {
                continue;
            }
            let area: String = line[at + "crate::".len()..]
                .chars()
                .take_while(|c| c.is_alphanumeric() || *c == '_')
                .collect();
            used.push((number + 1, area));
        }
    }
    used
}

#[test]
fn imports_only_point_down() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&src, &mut files);
    assert!(files.len() > 10, "found only {} source files", files.len());
    let mut wrong = Vec::new();
    for path in &files {
        let inner = path.strip_prefix(&src).unwrap();
        let first = inner
            .components()
            .next()
            .unwrap()
            .as_os_str()
            .to_str()
            .unwrap();
        let area = first.trim_end_matches(".rs");
        if matches!(area, "lib" | "main") {
            continue;
        }
        let Some(allowed) = allowed(area) else {
            wrong.push(format!("{}: area `{area}` has no layer", inner.display()));
            continue;
        };
        for (line, used) in used_areas(&fs::read_to_string(path).unwrap()) {
            // `skip` is of tests alone.
            if used != area && used != "skip" && !allowed.contains(&used.as_str()) {
                wrong.push(format!(
                    "{}:{line}: `{area}` uses `{used}`",
                    inner.display()
                ));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "imports that point up:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn only_the_application_knows_tokio_clap_and_ratatui() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&src, &mut files);
    for path in files.iter().filter(|p| !p.starts_with(src.join("app"))) {
        let source = fs::read_to_string(path).unwrap();
        for name in ["tokio", "clap", "ratatui", "axum"] {
            let bad = source.lines().find(|line| {
                !line.trim_start().starts_with("//") && line.contains(&format!("{name}::"))
            });
            assert!(bad.is_none(), "{} uses {name}: {bad:?}", path.display());
        }
    }
}

#[test]
fn the_parser_sees_crate_paths() {
    let found =
        used_areas("use crate::imaging::Role;\n// crate::app\nlet x = crate::error::Error;");
    assert_eq!(found, [(1, "imaging".into()), (3, "error".into())]);
}
