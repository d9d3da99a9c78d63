//! `gripcast synth`: datasets of one run and of resumed shards, image selection, invalid input.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use crate::json_schema::assert_schema;
use crate::program::{end_of, gripcast, json, stderr, succeed, wait_until};

/// Flags of a small plan for the rigid engine.
const SMALL_PLAN: [&str; 12] = [
    "--preset",
    "tiny",
    "--engine",
    "rigid",
    "--objects",
    "4",
    "--grasps",
    "2",
    "--spp",
    "1",
    "--seed",
    "8",
];

fn synth(verb: &str, plan: &Path) -> Command {
    let mut command = gripcast();
    command.args(["synth", verb, "--plan"]).arg(plan);
    command
}

fn plan(folder: &Path, flags: &[&str]) -> Output {
    let mut command = gripcast();
    let output = command
        .args(["synth", "plan", "--json"])
        .args(flags)
        .arg("--out")
        .arg(folder)
        .output()
        .unwrap();
    // 3: an object without grasps is skipped.
    let code = output.status.code();
    assert!(matches!(code, Some(0 | 3)), "{}", stderr(&output));
    output
}

fn merge(plan: &Path, out: &Path) -> Command {
    let mut command = synth("merge", plan);
    command
        .args(["--balance", "none", "--split", "train=1", "--json", "--out"])
        .arg(out);
    command
}

/// Lists all files below a folder.
fn paths(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path);
            }
        }
    }
    found
}

/// Contents of all files below a folder, by relative path.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let file = |path: PathBuf| {
        let name = path.strip_prefix(folder).unwrap().to_owned();
        (name, fs::read(&path).unwrap())
    };
    paths(folder).into_iter().map(file).collect()
}

/// Counts results; a run may be in progress.
fn count_results(plan: &Path) -> usize {
    if !plan.join("results").exists() {
        return 0;
    }
    let all = paths(&plan.join("results"));
    all.iter()
        .filter(|path| path.extension().is_some_and(|end| end == "json"))
        .count()
}

fn start(plan: &Path) -> Child {
    synth("run", plan)
        .args(["--jobs", "1"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// Waits for a new result, sends a signal and returns the exit code.
fn interrupt(plan: &Path, signal: Signal) -> Option<i32> {
    let before = count_results(plan);
    let mut child = start(plan);
    wait_until(&mut child, || count_results(plan) > before);
    // Ignored: the run may have ended meanwhile.
    let _ = kill_process(Pid::from_child(&child), signal);
    end_of(&mut child).code()
}

#[test]
fn resumed_shards_give_the_dataset_of_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, shards] = ["whole", "shards"].map(|name| dir.path().join(name));
    let planned = json(&plan(&whole, &SMALL_PLAN));
    assert_eq!(
        json(&plan(&shards, &SMALL_PLAN))["sha256"],
        planned["sha256"]
    );
    assert_schema("synth plan", &[&planned]);
    let simulations = planned["simulations"].as_u64().unwrap() as usize;
    assert!(simulations >= 12, "{planned}");
    succeed(synth("run", &whole).args(["--jobs", "2"]));

    assert_eq!(interrupt(&shards, Signal::KILL), None);
    let code = interrupt(&shards, Signal::TERM);
    assert!(matches!(code, Some(75 | 0)), "{code:?}");
    let open = merge(&shards, &dir.path().join("early")).output().unwrap();
    assert!(count_results(&shards) < simulations, "the run had ended");
    assert_eq!(open.status.code(), Some(1));
    assert!(stderr(&open).contains("--partial"), "{}", stderr(&open));

    for index in ["2", "0", "1"] {
        let mut run = synth("run", &shards);
        run.args(["--shard", "/3", "--jobs", "1", "--json"]);
        let summary = json(&succeed(run.env("SLURM_ARRAY_TASK_ID", index)));
        assert_eq!(summary["shard"], format!("{index}/3"));
    }
    let again = json(&succeed(synth("run", &shards).arg("--json")));
    assert_schema("synth run", &[&again]);
    assert_eq!(again["simulated_now"], 0, "no simulation is repeated");
    let status = json(&succeed(synth("status", &shards).arg("--json")));
    assert_schema("synth status", &[&status]);
    assert_eq!(status["done"], simulations);

    let [a, b] = [&whole, &shards].map(|plan| {
        let out = plan.join("dataset");
        let merged = json(&succeed(&mut merge(plan, &out)));
        assert_schema("synth merge", &[&merged]);
        files(&out)
    });
    assert!(
        a.keys()
            .any(|path| path.ends_with("train-00000-of-00001.parquet"))
    );
    assert!(a == b, "the datasets differ");
}

#[test]
fn fem_rows_contain_the_simulated_properties() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("p");
    let mut flags = SMALL_PLAN;
    flags[3] = "fem";
    flags[5] = "1";
    plan(&folder, &flags);
    succeed(&mut synth("run", &folder));
    let out = dir.path().join("d");
    let report = json(&succeed(&mut merge(&folder, &out)));
    let split = &report["parts"]["train"];
    assert!(split["rows"].as_u64().unwrap() > 0, "{report}");
    let shard = out.join("data/train-00000-of-00001.parquet");
    let rows = gripcast_dataset::shard::ShardReader::open(&shard).unwrap();
    for row in rows.rows() {
        let facts = row.unwrap().facts;
        assert_eq!(facts.engine, gripcast_dataset::shard::ShardEngine::Fem);
        assert!(facts.force_left_n.unwrap() > 0.0 && facts.mass_kg.unwrap() <= 0.2);
        assert!([10.0, 40.0].contains(&facts.stop_force_n.unwrap()));
    }
}

#[test]
fn friction_from_material_is_that_of_the_appearance_in_the_images() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("p");
    let flags = ["--friction-from", "material", "--renderings", "2"];
    plan(&folder, &[&SMALL_PLAN[..], &flags].concat());
    succeed(&mut synth("run", &folder));
    let out = dir.path().join("d");
    succeed(&mut merge(&folder, &out));
    let mut planned = BTreeMap::new();
    let text = fs::read_to_string(folder.join("plan.jsonl")).unwrap();
    let lines: Vec<Value> = text
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert_eq!(lines[0]["friction_from"], "material");
    let object = |name: &Value| lines.iter().find(|line| line["name"] == *name).unwrap();
    for simulation in lines.iter().filter(|line| line["id"].is_string()) {
        let look = simulation["look"].as_u64().unwrap() as usize;
        let words = &object(&simulation["object"])["looks"][look]["words"];
        let id = simulation["id"].as_str().unwrap().to_owned();
        planned.insert(id, (words.clone(), simulation["friction"].as_f64()));
    }
    let shard = out.join("data/train-00000-of-00001.parquet");
    let rows = gripcast_dataset::shard::ShardReader::open(&shard).unwrap();
    let mut count = 0;
    for row in rows.rows() {
        let facts = row.unwrap().facts;
        let (words, friction) = &planned[&facts.simulation];
        assert_eq!(
            (&Value::from(facts.appearance), facts.friction),
            (words, *friction)
        );
        count += 1;
    }
    assert!(count > 4 && count % 2 == 0, "{count}");
    let contradiction = synth_plan_refused(&dir.path().join("q"));
    assert!(
        contradiction.contains("--min-friction-fraction"),
        "{contradiction}"
    );
}

/// What is said about contamination of a surface that a camera can see.
fn synth_plan_refused(out: &Path) -> String {
    let mut command = gripcast();
    command.args(["synth", "plan", "--friction-from", "material"]);
    command
        .args(["--min-friction-fraction", "0.5", "--out"])
        .arg(out);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    stderr(&output)
}

#[test]
fn mixed_or_altered_plans_and_results_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let [one, other] = ["one", "other"].map(|name| dir.path().join(name));
    let mut flags = SMALL_PLAN;
    flags[5] = "1";
    plan(&one, &flags);
    flags[11] = "4";
    plan(&other, &flags);
    succeed(&mut synth("run", &one));
    let fails = |command: &mut Command, message: &str| {
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
    };
    // Another plan into the same folder.
    let mut again = gripcast();
    again
        .args(["synth", "plan"])
        .args(flags)
        .arg("--out")
        .arg(&one);
    fails(&mut again, "plan");
    // Altered images are refused; truncated ones are simulated again.
    let dataset = dir.path().join("d");
    let result = files(&one.join("results"));
    let (name, bytes) = result
        .iter()
        .find(|(path, _)| path.extension().is_some_and(|end| end == "parquet"))
        .unwrap();
    let image = one.join("results").join(name);
    let mut changed = bytes.clone();
    changed[bytes.len() / 2] ^= 1;
    fs::write(&image, &changed).unwrap();
    fails(&mut merge(&one, &dataset), "do not belong to the result");
    fs::write(&image, &bytes[..bytes.len() / 2]).unwrap();
    fails(&mut merge(&one, &dataset), "no result yet");
    succeed(&mut synth("run", &one));
    assert_eq!(&fs::read(&image).unwrap(), bytes);
    succeed(&mut merge(&one, &dataset));
    // Results and a dataset of another plan.
    fs::rename(one.join("results"), other.join("results")).unwrap();
    fails(&mut synth("run", &other), "another plan");
    fs::remove_dir_all(other.join("results")).unwrap();
    succeed(&mut synth("run", &other));
    fails(&mut merge(&other, &dataset), "another dataset");
    // An altered plan.
    let path = other.join("plan.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(
        &path,
        text.replace("\"stop_force_n\":10.0", "\"stop_force_n\":11.0"),
    )
    .unwrap();
    for verb in ["run", "status"] {
        fails(&mut synth(verb, &other), "altered");
    }
    fails(&mut synth("run", &dir.path().join("nothing")), "plan");
}

#[test]
fn invalid_objects_of_a_table_are_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let table = dir.path().join("objects.toml");
    let image = image::RgbImage::from_pixel(8, 4, image::Rgb([200, 30, 30]));
    image.save(dir.path().join("red.png")).unwrap();
    let rows = "schema = 1\n\
        [[object]]\nname = \"own-mug\"\nmesh = \"builtin:mug\"\ncategory = \"mug\"\n\
        material = \"ceramic\"\nmass_kg = 0.12\nfriction = 0.8\ntextures = [\"red.png\"]\n\
        [[object]]\nname = \"house\"\nmesh = \"builtin:box\"\nscale = 1.0\ncategory = \"box\"\n\
        material = \"cardbord\"\n\
        [[object]]\nname = \"huge\"\nmesh = \"builtin:box\"\nscale = 10.0\n\
        category = \"box\"\nmaterial = \"wood\"\n";
    fs::write(&table, rows).unwrap();
    let folder = dir.path().join("p");
    let run = |out: &Path, table: &Path| {
        let mut command = gripcast();
        command
            .args(["synth", "plan", "--preset", "tiny", "--engine", "rigid"])
            .args(["--grasps", "1", "--spp", "1", "--table"])
            .arg(table)
            .arg("--out")
            .arg(out);
        command.output().unwrap()
    };
    let output = run(&folder, &table);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stderr(&output).contains("house: ") && stderr(&output).contains("cardboard"));
    assert!(stderr(&output).contains("huge: ") && stderr(&output).contains("unit and scale"));
    let text = fs::read_to_string(folder.join("plan.jsonl")).unwrap();
    let object = text.lines().nth(1).unwrap();
    let object: Value = serde_json::from_str(object).unwrap();
    assert_eq!(
        (&object["mass_kg"], &object["friction"]),
        (&0.12.into(), &0.8.into())
    );
    succeed(&mut synth("run", &folder));
    // The plan has its own copy of the image.
    fs::remove_file(dir.path().join("red.png")).unwrap();
    let stored = paths(&folder.join("textures")).remove(0);
    let kept = fs::read(&stored).unwrap();
    let other = image::RgbImage::from_pixel(8, 4, image::Rgb([30, 200, 30]));
    other.save(&stored).unwrap();
    fs::remove_dir_all(folder.join("results")).unwrap();
    let changed = synth("run", &folder).output().unwrap();
    assert_eq!(changed.status.code(), Some(3), "{}", stderr(&changed));
    assert!(
        stderr(&changed).contains("texture changed"),
        "{}",
        stderr(&changed)
    );
    // A failure remains a result until `--retry-failed`.
    fs::write(&stored, kept).unwrap();
    let same = synth("run", &folder).output().unwrap();
    assert_eq!(same.status.code(), Some(3), "{}", stderr(&same));
    succeed(synth("run", &folder).arg("--retry-failed"));
    let nothing = run(&dir.path().join("q"), &dir.path().join("none.toml"));
    assert_eq!(nothing.status.code(), Some(1));
    assert!(stderr(&nothing).contains("none.toml"));
}

#[test]
fn partial_run_renders_labelled_simulations_only() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("part");
    plan(&folder, &SMALL_PLAN);
    succeed(synth("run", &folder).args(["--shard", "0/2", "--images", "none"]));
    let status = || json(&succeed(synth("status", &folder).arg("--json")));
    let before = status();
    let total = before["simulations"].as_u64().unwrap();
    let done = before["done"].as_u64().unwrap();
    let labelled = before["without_images"].as_u64().unwrap();
    assert!(labelled > 0 && done < total, "{done} of {total}");

    let alone = synth("run", &folder).arg("--partial").output().unwrap();
    assert_eq!(alone.status.code(), Some(2));
    assert!(stderr(&alone).contains("--images chosen"));
    let mut run = synth("run", &folder);
    run.args(["--images", "chosen", "--partial", "--json"]);
    run.args(["--balance", "none", "--split", "train=1"]);
    let summary = json(&succeed(&mut run));
    assert_eq!(summary["simulated_now"], labelled);
    assert_eq!(summary["simulations"], done);
    let after = status();
    assert_eq!(after["done"], done, "no open simulation is run");
    assert_eq!(after["without_images"], 0);

    let out = dir.path().join("dataset");
    let merged = merge(&folder, &out).arg("--partial").output().unwrap();
    assert_eq!(merged.status.code(), Some(3), "{}", stderr(&merged));
    let report = json(&merged);
    let split = &report["parts"]["train"];
    let simulations = split["stable"].as_u64().unwrap() + split["slip"].as_u64().unwrap();
    assert_eq!(simulations, labelled);
    let sum_over_categories = |column: usize| {
        let incomplete = report["incomplete"].as_object().unwrap().values();
        incomplete
            .map(|counts| counts[column].as_u64().unwrap())
            .sum::<u64>()
    };
    let open = sum_over_categories(1) - sum_over_categories(0);
    assert_eq!(open, total - done, "{report}");
}

#[test]
fn lifts_of_a_plan_end_early_unless_full_ones_are_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let protocol = |name: &str, flags: &[&str]| {
        let folder = dir.path().join(name);
        plan(
            &folder,
            &[&["--preset", "tiny", "--objects", "1"], flags].concat(),
        );
        let text = fs::read_to_string(folder.join("plan.jsonl")).unwrap();
        let header: Value = serde_json::from_str(text.lines().next().unwrap()).unwrap();
        header["parameters"]["protocol"].clone()
    };
    assert_eq!(protocol("default", &[])["early_end"], true);
    let full = protocol("full", &["--full-lift"]);
    assert_eq!(full.get("early_end"), None, "as plans of earlier versions");
    assert_eq!(full["lift_m"], 0.05);
}

#[test]
fn images_rendered_after_curation_are_identical() {
    let dir = tempfile::tempdir().unwrap();
    let [whole, late] = ["whole", "late"].map(|name| dir.path().join(name));
    let merge = |folder: &Path| {
        let mut command = synth("merge", folder);
        command.args(["--split", "train=1", "--json", "--out"]);
        command.arg(folder.join("dataset"));
        command
    };
    for folder in [&whole, &late] {
        plan(folder, &SMALL_PLAN);
    }
    succeed(&mut synth("run", &whole));
    succeed(synth("run", &late).args(["--images", "none"]));
    let status = json(&succeed(synth("status", &late).arg("--json")));
    let labelled = status["stable"].as_u64().unwrap() + status["slip"].as_u64().unwrap();
    assert_eq!(status["without_images"], labelled);
    assert_eq!(status["rows"], 0);
    let early = merge(&late).output().unwrap();
    assert_eq!(early.status.code(), Some(1));
    assert!(
        stderr(&early).contains("no images yet") && stderr(&early).contains("--images chosen"),
        "{}",
        stderr(&early)
    );

    // Simulations with a missing, truncated or altered record are run again.
    let records = |folder: &Path| -> Vec<PathBuf> {
        let all = files(&folder.join("results"));
        let is_record = |path: &PathBuf| path.extension().is_some_and(|end| end == "grasp");
        all.into_keys().filter(is_record).collect()
    };
    let kept = records(&late);
    assert_eq!(kept.len() as u64, labelled);
    for (number, record) in kept.iter().enumerate() {
        let path = late.join("results").join(record);
        let mut bytes = fs::read(&path).unwrap();
        match number % 4 {
            0 => fs::remove_file(path).unwrap(),
            1 => fs::write(path, &bytes[..60]).unwrap(),
            2 => {
                *bytes.last_mut().unwrap() ^= 1;
                fs::write(path, bytes).unwrap();
            }
            _ => {}
        }
    }

    let mut run = synth("run", &late);
    run.args(["--images", "chosen", "--split", "train=1", "--json"]);
    let rendered = json(&succeed(&mut run))["simulated_now"].as_u64().unwrap();
    assert!(
        rendered > 0 && rendered < labelled,
        "{rendered} of {labelled}"
    );
    assert_eq!(json(&succeed(&mut run))["simulated_now"], 0);
    for folder in [&whole, &late] {
        succeed(&mut merge(folder));
    }
    assert!(files(&whole.join("dataset")) == files(&late.join("dataset")));
    let mut report = synth("report", &late);
    report.arg("--dataset").arg(late.join("dataset"));
    report.arg("--json").arg("--out").arg(late.join("report"));
    assert_schema("synth report", &[&json(&succeed(&mut report))]);

    succeed(&mut synth("run", &late));
    let status = json(&succeed(synth("status", &late).arg("--json")));
    assert_eq!(status["without_images"], 0);
    assert!(
        files(&whole.join("results"))
            .keys()
            .eq(files(&late.join("results")).keys()),
        "records are kept"
    );
}
