//! The verb `dataset export`, killed exports, and exports read by other libraries.

use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::Command;

use super::dataset::{gripcast, json, stderr, stdout, tree, write_dataset, write_mixed_dataset};
use crate::json_schema::assert_schema;
use crate::peers::{agrees, peer};

const FORMATS: [&str; 5] = ["parquet", "webdataset", "lerobot", "zarr", "training"];

/// Whether the format leaves out unlabelled grasps.
fn requires_labels(format: &str) -> bool {
    ["lerobot", "training"].contains(&format)
}

/// Arguments of an export.
fn arguments<'a>(format: &'a str, out: &'a Path) -> [&'a str; 5] {
    ["export", "--to", format, "--out", out.to_str().unwrap()]
}

#[test]
fn exports_never_overwrite() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    write_dataset(&root, &["mug", "bottle", "sponge"]);
    let mut reports = Vec::new();
    for format in FORMATS {
        let out = dir.path().join(format);
        let arguments = arguments(format, &out);
        let output = gripcast(&[&arguments[..], &["--json"]].concat(), &root);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let report = json(&output);
        let grasps = if requires_labels(format) { 2 } else { 3 };
        assert_eq!(report["format"], format);
        assert_eq!(report["grasps"], grasps);
        let before = tree(&out);
        assert_eq!(report["files"], before.len());
        let again = gripcast(&arguments, &root);
        assert_eq!(again.status.code(), Some(1), "{format}");
        assert!(
            stderr(&again).contains("the target exists"),
            "{}",
            stderr(&again)
        );
        assert_eq!(tree(&out), before);
        reports.push(report);
    }
    assert_schema("dataset export", &reports.iter().collect::<Vec<_>>());
    let text = gripcast(&arguments("zarr", &dir.path().join("z.zip")), &root);
    assert!(stdout(&text).contains("3 grasps: 1 stable, 1 slip, 1 unlabelled"));
    for wrong in [
        &["export", "--to", "hdf5", "--out", "x"][..],
        &["export", "--to", "parquet", "--out", "x", "--size", "8x8"],
        &["export", "--to", "zarr", "--out", "x", "--size", "8"],
        &["export", "--to", "parquet", "--out", "x", "--split", "no"],
    ] {
        let output = gripcast(wrong, &root);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{wrong:?} {}",
            stderr(&output)
        );
    }
}

#[test]
fn damaged_grasp_is_reported_and_sets_the_exit_code() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    let ids = write_dataset(&root, &["mug", "bottle"]);
    fs::write(
        root.join(format!("grasps/{}/grasp.left.jpg", ids[0])),
        b"torn",
    )
    .unwrap();
    let out = dir.path().join("out");
    let output = gripcast(&arguments("parquet", &out), &root);
    assert_eq!(output.status.code(), Some(3));
    assert!(
        stdout(&output).contains(ids[0].as_str()),
        "{}",
        stdout(&output)
    );
    assert!(
        stderr(&output).contains("1 grasp left out"),
        "{}",
        stderr(&output)
    );
    assert!(out.join("data/train-00000-of-00001.parquet").exists());
}

/// The kernel kills the export by SIGXFSZ when a file grows over one block.
#[test]
fn killed_export_leaves_only_a_hidden_partial() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    write_dataset(&root, &["mug", "bottle"]);
    for format in FORMATS {
        let out = dir.path().join(format);
        let killed = Command::new("sh")
            .args(["-c", "ulimit -c 0; ulimit -f 1; exec \"$0\" \"$@\""])
            .args([
                env!("CARGO_BIN_EXE_gripcast"),
                "dataset",
                "export",
                "--quiet",
            ])
            .arg(&root)
            .args(&arguments(format, &out)[1..])
            .status()
            .unwrap();
        assert_eq!(killed.signal(), Some(libc::SIGXFSZ), "{format}");
        assert!(!out.exists(), "{format}");
        let hidden = dir.path().join(format!(".{format}.gripcast-partial"));
        assert!(hidden.is_dir(), "{format}");
        let reference = dir.path().join(format!("{format}-reference"));
        for path in [&out, &reference] {
            let output = gripcast(&arguments(format, path), &root);
            assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        }
        assert!(!hidden.exists(), "{format}");
        let relative = |root: &Path| -> Vec<_> {
            let files = tree(root).into_iter();
            files
                .map(|(path, bytes)| (path.strip_prefix(root).unwrap().to_owned(), bytes))
                .collect()
        };
        assert_eq!(relative(&out), relative(&reference), "{format}");
    }
}

#[test]
fn python_opens_every_export() {
    let Some(mut check) = peer("load_exports.py") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    write_dataset(&root, &["mug", "bottle", "sponge"]);
    check.arg(&root);
    for format in FORMATS {
        let out = dir.path().join(format);
        let output = gripcast(&arguments(format, &out), &root);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        check.arg(format!("--{format}")).arg(out);
    }
    let cache = dir.path().join("cache");
    println!("{}", agrees(check.env("HF_HOME", cache)));
}

#[test]
fn python_opens_exports_of_a_mixed_dataset() {
    let Some(mut check) = peer("load_exports.py") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("d");
    write_mixed_dataset(&root);
    check.arg(&root);
    for format in ["parquet", "webdataset", "lerobot", "zarr"] {
        let out = dir.path().join(format);
        let output = gripcast(&arguments(format, &out), &root);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        check.arg(format!("--{format}")).arg(out);
    }
    let cache = dir.path().join("cache");
    println!("{}", agrees(check.env("HF_HOME", cache)));
}
