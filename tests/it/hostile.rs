//! Datasets that try to read or change files outside of them. The corpus is in
//! `tests/data/hostile`, one directory per case; each case runs in a sandbox next to its targets.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::{Value, json};

use crate::daemon::Place;
use crate::dataset::write_dataset;
use crate::program::gripcast;

/// Must not appear in any output.
const SECRET: &str = "TOP-SECRET-7d1f";
/// Target of the cases with absolute paths.
const PLANTED: &str = "/tmp/gripcast-hostile-planted";

/// Modifies the record of the first grasp.
fn change(root: &Path, change: impl FnOnce(&mut Value)) {
    let path = first_grasp(root).join("grasp.json");
    let mut record: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut record);
    fs::write(path, serde_json::to_vec_pretty(&record).unwrap()).unwrap();
}

fn first_grasp(root: &Path) -> PathBuf {
    let mut grasps: Vec<_> = fs::read_dir(root.join("grasps"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    grasps.sort();
    grasps.remove(0)
}

/// Renames a stored file in the record and keeps its digest.
fn rename_file(record: &mut Value, from: &str, to: &str) {
    let digest = record["files"]
        .as_object_mut()
        .unwrap()
        .remove(from)
        .unwrap();
    record["files"][to] = digest;
    for stage in ["initial", "grasp"] {
        for (_, camera) in record[stage]["cameras"].as_object_mut().unwrap() {
            if camera["file"] == from {
                camera["file"] = json!(to);
            }
        }
    }
}

fn relink(path: &Path, target: &str) {
    let _ = fs::remove_file(path);
    symlink(target, path).unwrap();
}

type Attack = (&'static str, fn(&Path));

/// Each attack turns a valid dataset into a case. Sandbox layout: `outside/` and `data/CASE/`.
const ATTACKS: &[Attack] = &[
    ("id-with-dots", |root| {
        change(root, |r| r["id"] = json!("../../../outside/autostart"));
    }),
    ("id-absolute", |root| {
        change(root, |r| r["id"] = json!(PLANTED))
    }),
    ("id-with-separator", |root| {
        change(root, |r| r["id"] = json!("a/b"))
    }),
    ("file-key-with-dots", |root| {
        change(root, |r| {
            rename_file(r, "grasp.left.jpg", "../../../../outside/secret.txt");
        });
    }),
    ("file-key-absolute", |root| {
        change(root, |r| rename_file(r, "grasp.left.jpg", "/etc/passwd"));
    }),
    ("image-is-a-link", |root| {
        let image = first_grasp(root).join("grasp.left.jpg");
        relink(&image, "../../../../outside/secret.txt");
    }),
    ("record-is-a-link", |root| {
        let record = first_grasp(root).join("grasp.json");
        relink(&record, "../../../../outside/secret.json");
    }),
    ("grasp-folder-is-a-link", |root| {
        let folder = root.join("grasps/2026-01-01T00-00-00Z-0000");
        relink(&folder, "../../../outside/folder");
    }),
    ("grasps-is-a-link", |root| {
        fs::rename(root.join("grasps"), root.join("elsewhere")).unwrap();
        relink(&root.join("grasps"), "../../outside");
    }),
    ("lock-is-a-link", |root| {
        relink(&root.join(".lock"), "../../outside/secret.txt");
    }),
    ("partials-are-links", |root| {
        for name in [".metadata.jsonl.partial", ".dataset.toml.partial"] {
            relink(&root.join(name), "../../outside/secret.txt");
        }
        let partial = first_grasp(root).join(".grasp.json.partial");
        relink(&partial, "../../../../outside/secret.txt");
        fs::remove_file(root.join("metadata.jsonl")).unwrap();
    }),
    ("trash-is-a-link", |root| {
        fs::remove_dir(root.join("trash")).unwrap();
        relink(&root.join("trash"), "../../outside");
        fs::write(
            root.join("grasps/stray.desktop"),
            "[Desktop Entry]\nExec=x\n",
        )
        .unwrap();
    }),
    ("calibration-is-a-link", |root| {
        fs::remove_dir(root.join("calibration")).unwrap();
        relink(&root.join("calibration"), "../../outside");
    }),
    ("calibration-key-with-dots", |root| {
        change(root, |r| {
            r["calibration"] = json!({"left": "../../../outside/secret"});
        });
    }),
    ("split-names-a-path", |root| {
        fs::create_dir_all(root.join("splits")).unwrap();
        fs::write(
            root.join("splits/objects.json"),
            json!({"schema": 1, "by": "object", "seed": 0, "fractions": {"train": 1.0},
                "splits": {"../../outside/x": {"groups": [], "outcomes": {},
                    "grasps": ["../../../outside/folder"]}}})
            .to_string(),
        )
        .unwrap();
        relink(
            &root.join("splits/link.json"),
            "../../../outside/secret.json",
        );
    }),
    ("index-is-a-link", |root| {
        relink(&root.join("metadata.jsonl"), "../../outside/secret.txt");
    }),
    ("names-with-escapes", |root| {
        change(root, |r| {
            r["object"] = json!("mug\u{1b}]0;owned\u{7}\u{202e}");
            r["operator"] = json!("Ada\u{9b}31m\nroot");
        });
    }),
    ("object-is-a-path", |root| {
        change(root, |r| r["object"] = json!("../../outside/folder"));
    }),
];

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/hostile")
}

/// Copies a directory tree; symbolic links stay links.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (path, to) = {
            let entry = entry.unwrap();
            (entry.path(), to.join(entry.file_name()))
        };
        if path.is_symlink() {
            symlink(fs::read_link(&path).unwrap(), to).unwrap();
        } else if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}

/// Contents of all files and targets of all links below a directory.
fn tree(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let contents = if path.is_symlink() {
                let target = fs::read_link(&path).unwrap();
                target.into_os_string().into_encoded_bytes()
            } else if path.is_dir() {
                folders.push(path.clone());
                Vec::new()
            } else {
                fs::read(&path).unwrap()
            };
            found.insert(path, contents);
        }
    }
    found
}

/// A case of the corpus next to the files it targets.
struct Sandbox {
    dir: tempfile::TempDir,
    before: BTreeMap<PathBuf, Vec<u8>>,
}

impl Sandbox {
    fn new(case: &Path) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let outside = dir.path().join("outside");
        fs::create_dir_all(outside.join("folder")).unwrap();
        for name in [
            "secret.txt",
            "secret.toml",
            "secret.json",
            "folder/grasp.json",
        ] {
            fs::write(outside.join(name), format!("{SECRET} of {name}\n")).unwrap();
        }
        let sandbox = Self {
            before: tree(&outside),
            dir,
        };
        copy(case, &sandbox.dataset());
        sandbox
    }

    /// At the depth that the links of the corpus expect.
    fn dataset(&self) -> PathBuf {
        self.dir.path().join("data/case")
    }

    fn outside(&self) -> PathBuf {
        self.dir.path().join("outside")
    }

    fn run(&self, args: &[&str]) -> Output {
        gripcast()
            .args(args)
            .current_dir(self.dir.path())
            .output()
            .unwrap()
    }

    /// Asserts that no outside file was changed or shown and that the program exited normally.
    fn assert_contained(&self, output: &Output, context: &str) {
        let shown = [&output.stdout[..], &output.stderr].concat();
        let shown = String::from_utf8_lossy(&shown);
        assert!(
            !shown.contains(SECRET),
            "{context} prints the secret: {shown}"
        );
        assert!(
            !shown.contains("root:x:"),
            "{context} prints an outside file: {shown}"
        );
        let is_safe = |c: char| c == '\n' || !c.is_control() && c != '\u{202e}';
        assert!(
            shown.chars().all(is_safe),
            "{context} prints a control character: {shown:?}"
        );
        assert!(
            matches!(output.status.code(), Some(0..=4 | 69 | 75)),
            "{context}: {:?}: {shown}",
            output.status
        );
        assert_eq!(
            tree(&self.outside()),
            self.before,
            "{context} changed an outside file"
        );
        assert!(
            !Path::new(PLANTED).exists(),
            "{context} wrote an outside file"
        );
    }
}

fn cases() -> Vec<PathBuf> {
    let mut cases: Vec<_> = fs::read_dir(corpus())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir())
        .collect();
    cases.sort();
    cases
}

fn name(case: &Path) -> String {
    case.file_name().unwrap().to_string_lossy().into_owned()
}

/// Regenerate the corpus with `GRIPCAST_BLESS=1 cargo test --test it hostile`.
#[test]
fn corpus_contains_every_attack() {
    if std::env::var_os("GRIPCAST_BLESS").is_some() {
        let dir = tempfile::tempdir().unwrap();
        write_dataset(dir.path(), &["mug", "bottle"]);
        for (name, attack) in ATTACKS {
            let case = corpus().join(name);
            let _ = fs::remove_dir_all(&case);
            copy(dir.path(), &case);
            attack(&case);
            for folder in ["trash", "logs", "calibration", "models"] {
                // Git does not store empty directories.
                if fs::read_dir(case.join(folder)).is_ok_and(|mut f| f.next().is_none())
                    && !case.join(folder).is_symlink()
                {
                    fs::remove_dir(case.join(folder)).unwrap();
                }
            }
        }
    }
    let mut expected: Vec<_> = ATTACKS.iter().map(|(name, _)| (*name).to_owned()).collect();
    expected.sort();
    let found: Vec<_> = cases().iter().map(|case| name(case)).collect();
    assert_eq!(found, expected);
}

#[test]
fn hostile_datasets_cannot_reach_outside_files() {
    for case in cases() {
        let name = name(&case);
        let sandbox = Sandbox::new(&case);
        let data = sandbox.dataset().display().to_string();
        let out = |name: &str| sandbox.dir.path().join(name).display().to_string();
        let mut verbs: Vec<Vec<String>> = Vec::new();
        let mut verb = |args: &[&str]| verbs.push(args.iter().map(|a| (*a).to_owned()).collect());
        verb(&["dataset", "info", &data]);
        verb(&["dataset", "info", &data, "--json"]);
        for format in ["parquet", "webdataset", "lerobot", "zarr", "training"] {
            verb(&[
                "dataset",
                "export",
                &data,
                "--to",
                format,
                "--out",
                &out(format),
            ]);
        }
        verb(&[
            "eval",
            "--data",
            &out("training"),
            "--model",
            "baseline-contact",
        ]);
        verb(&["annotate", &data, "--dry-run"]);
        verb(&[
            "replay",
            &data,
            "--objects",
            &out("data"),
            "--out",
            &out("replay"),
        ]);
        verb(&["predict", &data]);
        verb(&["dataset", "split", &data]);
        verb(&["dataset", "verify", &data]);
        verb(&["dataset", "verify", &data, "--json"]);
        verb(&["dataset", "recover", &data, "--dry-run"]);
        verb(&["dataset", "recover", &data]);
        verb(&["dataset", "reindex", &data]);
        verb(&["dataset", "verify", &data]);
        verb(&["dataset", "info", &data]);
        for args in &verbs {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let output = sandbox.run(&args);
            sandbox.assert_contained(&output, &format!("{name}: {}", args.join(" ")));
        }
    }
}

#[test]
fn daemon_serves_no_file_outside_a_hostile_dataset() {
    for case in [
        "file-key-with-dots",
        "image-is-a-link",
        "grasp-folder-is-a-link",
    ] {
        let sandbox = Sandbox::new(&corpus().join(case));
        let place = Place::at(sandbox.dataset());
        let daemon = place.daemon();
        for grasp in fs::read_dir(sandbox.dataset().join("grasps")).unwrap() {
            let id = grasp.unwrap().file_name().into_string().unwrap();
            for path in [
                format!("/api/grasps/{id}"),
                format!("/api/grasps/{id}/files/grasp.left.jpg"),
                format!("/api/grasps/{id}/files/..%2F..%2F..%2F..%2Foutside%2Fsecret.txt"),
                format!("/api/grasps/{id}/files/%2Fetc%2Fpasswd"),
            ] {
                let (_, body) = daemon.ask("GET", &path, None);
                let body = String::from_utf8_lossy(&body);
                assert!(
                    !body.contains(SECRET) && !body.contains("root:x:"),
                    "{path}: {body}"
                );
            }
        }
        drop(daemon);
        assert_eq!(tree(&sandbox.outside()), sandbox.before, "{case}");
    }
}

/// Files that Git cannot store: a named pipe, a link to a device, a huge file, a hard link.
#[test]
fn devices_pipes_and_huge_files_are_refused_without_blocking() {
    let dir = tempfile::tempdir().unwrap();
    write_dataset(dir.path(), &["mug", "bottle"]);
    let image = first_grasp(dir.path()).join("grasp.left.jpg");
    let stored = fs::read(&image).unwrap();
    let replacements: [Attack; 4] = [
        ("named pipe", |path| {
            use rustix::fs::{CWD, FileType, Mode, mknodat};
            mknodat(CWD, path, FileType::Fifo, Mode::from_raw_mode(0o600), 0).unwrap();
        }),
        ("link to a device", |path| {
            symlink("/dev/zero", path).unwrap()
        }),
        ("huge file", |path| {
            fs::File::create(path).unwrap().set_len(1 << 42).unwrap();
        }),
        ("directory", |path| fs::create_dir(path).unwrap()),
    ];
    for (what, replace) in replacements {
        let _ = fs::remove_file(&image);
        replace(&image);
        let output = gripcast()
            .args(["dataset", "verify", "--json"])
            .arg(dir.path())
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(4), "{what}");
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let problems = report["problems"].to_string();
        assert!(problems.contains("grasp.left.jpg"), "{what}: {problems}");
        let _ = fs::remove_file(&image);
        let _ = fs::remove_dir(&image);
    }
    fs::write(&image, stored).unwrap();
    let target = dir.path().join("precious");
    fs::write(&target, "precious").unwrap();
    fs::remove_file(dir.path().join(".lock")).unwrap();
    fs::hard_link(&target, dir.path().join(".lock")).unwrap();
    let output = gripcast()
        .args(["dataset", "reindex"])
        .arg(dir.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(fs::read(&target).unwrap(), b"precious");
}

#[test]
fn grasps_on_another_disk_need_permission() {
    let dir = tempfile::tempdir().unwrap();
    let (root, disk) = (dir.path().join("d"), dir.path().join("disk"));
    write_dataset(&root, &["mug", "bottle"]);
    fs::create_dir(&disk).unwrap();
    fs::rename(root.join("grasps"), disk.join("grasps")).unwrap();
    symlink(disk.join("grasps"), root.join("grasps")).unwrap();
    // The dataset directory itself may always be a link.
    symlink(&root, dir.path().join("link")).unwrap();
    let verify = |allowed: Option<&Path>| {
        let mut command = gripcast();
        command
            .args(["dataset", "verify"])
            .arg(dir.path().join("link"));
        if let Some(folder) = allowed {
            command.env("GRIPCAST__FILES__LINKED_FOLDERS", folder);
        }
        command.output().unwrap()
    };
    let refused = verify(None);
    assert_eq!(refused.status.code(), Some(1));
    let text = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(text.contains("GRIPCAST__FILES__LINKED_FOLDERS"), "{text}");
    let allowed = verify(Some(&disk));
    let text = String::from_utf8_lossy(&allowed.stderr).into_owned();
    assert_eq!(allowed.status.code(), Some(0), "{text}");
}

/// File names are untrusted: they appear on stdout in problems and on stderr as locations.
#[test]
fn file_names_cannot_send_terminal_escapes() {
    const TITLE: &str = "\u{1b}]0;owned\u{7}\u{202e}";
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join(format!("data{TITLE}"));
    write_dataset(&root, &["mug"]);
    fs::write(root.join("grasps").join(TITLE), "stray").unwrap();
    for arguments in [
        vec!["dataset", "verify"],
        vec!["dataset", "verify", "--json"],
    ] {
        let output = gripcast().args(arguments).arg(&root).output().unwrap();
        let (stdout, stderr) = (
            String::from_utf8(output.stdout).unwrap(),
            String::from_utf8(output.stderr).unwrap(),
        );
        for text in [&stdout, &stderr] {
            assert!(text.contains("owned"), "{text:?}");
            assert!(!text.contains(['\u{1b}', '\u{7}', '\u{202e}']), "{text:?}");
        }
    }
}
