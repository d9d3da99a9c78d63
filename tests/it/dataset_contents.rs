//! What counts as a grasp, and how many grasps and problems are shown.

use std::fs;

use crate::dataset::{gripcast, json, stderr, stdout, tree, write_dataset};
use crate::json_schema::assert_schema;

#[test]
fn files_of_systems_and_copies_are_not_grasps() {
    let dir = tempfile::tempdir().unwrap();
    let ids = write_dataset(dir.path(), &["mug", "bottle"]);
    let grasp = dir.path().join(format!("grasps/{}", ids[0]));
    for name in [
        ".DS_Store",
        "._grasp.json",
        "Thumbs.db",
        "grasp.json~",
        ".nfs0123",
    ] {
        fs::write(grasp.join(name), "x").unwrap();
        fs::write(dir.path().join("grasps").join(name), "x").unwrap();
        fs::write(dir.path().join(name), "x").unwrap();
    }
    // A byte-order mark and line ends of Windows.
    let record = grasp.join("grasp.json");
    let text = fs::read_to_string(&record).unwrap().replace('\n', "\r\n");
    fs::write(&record, format!("\u{feff}{text}")).unwrap();
    let toml = dir.path().join("dataset.toml");
    fs::write(
        &toml,
        format!("\u{feff}{}", fs::read_to_string(&toml).unwrap()),
    )
    .unwrap();
    let output = gripcast(&["verify"], dir.path());
    assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
    let out = dir.path().with_extension("export");
    let exported = gripcast(
        &[
            "export",
            "--to",
            "webdataset",
            "--out",
            out.to_str().unwrap(),
        ],
        dir.path(),
    );
    assert_eq!(exported.status.code(), Some(0), "{}", stderr(&exported));
    fs::remove_dir_all(out).unwrap();

    for copy in [
        "X (conflicted copy 2026-11-25)",
        "X.sync-conflict-20261125-101010-ABCDEF",
        "X-copy",
    ] {
        let copy = dir.path().join("grasps").join(copy.replace('X', &ids[0]));
        fs::create_dir(&copy).unwrap();
        for (path, bytes) in tree(&grasp) {
            fs::write(copy.join(path.file_name().unwrap()), bytes).unwrap();
        }
        let output = gripcast(&["verify", "--json"], dir.path());
        let report = json(&output);
        assert_eq!(output.status.code(), Some(4));
        assert_eq!(report["grasps"], 2);
        assert_eq!(
            report["problems"].as_array().unwrap().len(),
            1,
            "{report:#}"
        );
        assert_eq!(report["problems"][0]["kind"], "duplicate-id");
        let listed = json(&gripcast(&["list", "--json"], dir.path()));
        assert_eq!(listed["grasps"].as_array().unwrap().len(), 2);
        fs::remove_dir_all(copy).unwrap();
    }

    let unknown = text.replacen('{', "{\"weight_g\": 120,", 1);
    fs::write(&record, unknown).unwrap();
    let problem = &json(&gripcast(&["verify", "--json"], dir.path()))["problems"][0];
    assert_eq!(problem["kind"], "unreadable-record");
    assert!(
        problem["detail"].as_str().unwrap().contains("weight_g"),
        "{problem}"
    );
    assert!(
        problem["remedy"]
            .as_str()
            .unwrap()
            .contains("remove the key"),
        "{problem}"
    );
}

#[test]
fn problems_are_summed_up_by_kind() {
    let dir = tempfile::tempdir().unwrap();
    let ids = write_dataset(dir.path(), &["a", "b", "c", "d", "e"]);
    for id in &ids {
        fs::remove_file(dir.path().join(format!("grasps/{id}/grasp.rgb.png"))).unwrap();
    }
    let text = stdout(&gripcast(&["verify"], dir.path()));
    assert!(
        text.starts_with("missing-file  5 problems in 5 grasps, the first of them:\n"),
        "{text}"
    );
    assert_eq!(text.matches("grasp.rgb.png").count(), 3, "{text}");
    assert!(text.contains("`--all` prints every problem"), "{text}");
    let all = stdout(&gripcast(&["verify", "--all"], dir.path()));
    assert_eq!(all.matches("grasp.rgb.png").count(), 5, "{all}");
    let json = json(&gripcast(&["verify", "--json"], dir.path()));
    assert_eq!(json["problems"].as_array().unwrap().len(), 5);
    let summary = &json["by_kind"][0];
    assert_eq!(
        (&summary["problems"], &summary["grasps"]),
        (&5.into(), &5.into())
    );
    assert_eq!(
        summary["examples"],
        serde_json::json!([ids[0], ids[1], ids[2]])
    );
}

#[test]
fn list_pages_and_filters() {
    let dir = tempfile::tempdir().unwrap();
    let ids = write_dataset(dir.path(), &["mug", "bottle", "mug"]);
    let list = |args: &[&str]| -> Vec<String> {
        let output = gripcast(&[&["list", "--json"], args].concat(), dir.path());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let listed = json(&output);
        let grasps = listed["grasps"].as_array().unwrap().iter();
        grasps
            .map(|grasp| grasp["id"].as_str().unwrap().to_owned())
            .collect()
    };
    let [first, second, third] = [0, 1, 2].map(|index: usize| ids[index].to_string());
    assert_eq!(list(&[]), [third.clone(), second.clone(), first.clone()]);
    assert_eq!(
        list(&["--before", &third, "--limit", "1"]),
        std::slice::from_ref(&second)
    );
    assert_eq!(list(&["--object", "mug"]), [third, first]);
    assert_eq!(list(&["--outcome", "slip"]), [second]);
    assert!(list(&["--until", "2026-11-20"]).is_empty());
    assert_eq!(list(&["--since", "2026-11-20T10:15:00Z"]).len(), 3);
    let pages = [&["list", "--json"][..], &["list", "--json", "--limit", "1"]]
        .map(|args| json(&gripcast(args, dir.path())));
    assert_schema("dataset list", &pages.each_ref());
    let text = stdout(&gripcast(&["list", "--limit", "1"], dir.path()));
    assert!(text.contains("older: `--before"), "{text}");
}
