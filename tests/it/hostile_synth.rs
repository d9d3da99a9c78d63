//! Plans, results and tables that try to access files outside of their folder.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use sha2::{Digest as _, Sha256};

use crate::program::{gripcast, stderr, succeed};

/// A box of 40 × 30 × 60 mm.
const MESH: &str = "v 0 0 0\nv 40 0 0\nv 40 30 0\nv 0 30 0\nv 0 0 60\nv 40 0 60\n\
    v 40 30 60\nv 0 30 60\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

/// A folder with a secret file next to the plan and the table.
struct Jail(tempfile::TempDir);

impl Jail {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("secret"), "secret").unwrap();
        Self(dir)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Creates a plan of one textured object.
    fn plan(&self) -> PathBuf {
        fs::create_dir_all(self.at("table")).unwrap();
        let image = image::RgbImage::from_pixel(8, 4, image::Rgb([200, 30, 30]));
        image.save(self.at("table/label.png")).unwrap();
        fs::write(self.at("table/part.obj"), MESH).unwrap();
        let row = "mesh = \"part.obj\"\nunit = \"mm\"\ntextures = [\"label.png\"]";
        succeed(&mut self.plan_command(row));
        self.at("plan")
    }

    fn plan_command(&self, row: &str) -> Command {
        fs::create_dir_all(self.at("table")).unwrap();
        let table = format!(
            "schema = 1\n[[object]]\nname = \"part\"\ncategory = \"block\"\n\
             material = \"pine\"\nmass_kg = 0.05\n{row}\n"
        );
        fs::write(self.at("table/objects.toml"), table).unwrap();
        let mut command = gripcast();
        command
            .args(["synth", "plan", "--preset", "tiny", "--engine", "rigid"])
            .args(["--grasps", "4", "--spp", "1", "--stop-force-n", "10"])
            .arg("--table")
            .arg(self.at("table/objects.toml"))
            .arg("--out")
            .arg(self.at("plan"));
        command
    }

    /// Checks that nothing outside of the plan and the table was created or changed.
    fn assert_intact(&self) {
        assert_eq!(fs::read(self.at("secret")).unwrap(), b"secret");
        for entry in fs::read_dir(self.0.path()).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            let known = ["secret", "table", "plan", "dataset", "report", "moved"];
            assert!(known.contains(&name.as_str()), "unexpected {name}");
        }
    }
}

fn synth(verb: &str, plan: &Path) -> Command {
    let mut command = gripcast();
    command.args(["synth", verb, "--plan"]).arg(plan);
    command
}

/// Changes a plan and updates its hash.
fn forge(plan: &Path, from: &str, to: &str) {
    let path = plan.join("plan.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{from}");
    let text = text.replace(from, to);
    let digest = Sha256::digest(&text);
    let hash: String = digest.iter().map(|b| format!("{b:02x}")).collect();
    fs::write(path, text).unwrap();
    fs::write(plan.join("plan.sha256"), format!("{hash}  plan.jsonl\n")).unwrap();
}

/// `<2 hex>/<id>` of the first simulation.
fn first_result(plan: &Path) -> PathBuf {
    let id = "part-000-10n";
    let digest = Sha256::digest(id);
    plan.join("results")
        .join(format!("{:02x}", digest[0]))
        .join(id)
}

#[track_caller]
fn assert_refused(output: &Output, message: &str) {
    let text = stderr(output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains(message), "{text}");
}

#[test]
fn paths_as_names_in_a_plan_are_refused() {
    let jail = Jail::new();
    let plan = jail.plan();
    let text = fs::read(plan.join("plan.jsonl")).unwrap();
    let absolute = jail.at("planted").display().to_string();
    for id in ["../../planted", "a/b", &absolute] {
        forge(&plan, "\"part-000-10n\"", &format!("{id:?}"));
        for verb in ["run", "status"] {
            let output = synth(verb, &plan).output().unwrap();
            assert_refused(&output, "invalid simulation id");
        }
        for verb in ["merge", "report"] {
            let mut command = synth(verb, &plan);
            let output = command.arg("--out").arg(jail.at("dataset")).output();
            assert_refused(&output.unwrap(), "invalid simulation id");
        }
        fs::write(plan.join("plan.jsonl"), &text).unwrap();
    }
    forge(&plan, "part.ply", "../../secret");
    assert_refused(&synth("run", &plan).output().unwrap(), "invalid file name");
    assert!(!plan.join("results").exists());
    jail.assert_intact();
}

#[test]
fn symlinks_out_of_a_plan_are_not_followed() {
    let jail = Jail::new();
    let plan = jail.plan();
    let secret = jail.at("secret");
    // Result.
    let facts = first_result(&plan).with_extension("json");
    fs::create_dir_all(facts.parent().unwrap()).unwrap();
    symlink(&secret, &facts).unwrap();
    assert_refused(&synth("run", &plan).output().unwrap(), "leads out of");
    fs::remove_file(&facts).unwrap();
    // Images, state and cached convex pieces.
    for ending in ["parquet", "state"] {
        symlink(&secret, facts.with_extension(ending)).unwrap();
    }
    succeed(&mut synth("run", &plan));
    jail.assert_intact();
    let pieces: Vec<_> = fs::read_dir(plan.join("convex-pieces"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert!(!pieces.is_empty());
    for path in &pieces {
        fs::remove_file(path).unwrap();
        symlink(&secret, path).unwrap();
    }
    // Mesh and texture.
    for folder in ["meshes", "textures"] {
        fs::remove_dir_all(plan.join("results")).unwrap();
        let entry = fs::read_dir(plan.join(folder)).unwrap().next().unwrap();
        let path = entry.unwrap().path();
        let kept = fs::read(&path).unwrap();
        fs::remove_file(&path).unwrap();
        symlink(&secret, &path).unwrap();
        let output = synth("run", &plan).output().unwrap();
        assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
        assert!(
            stderr(&output).contains("leads out of"),
            "{}",
            stderr(&output)
        );
        fs::remove_file(&path).unwrap();
        fs::write(&path, kept).unwrap();
    }
    // Folder of results.
    fs::remove_dir_all(plan.join("results")).unwrap();
    symlink(jail.0.path(), plan.join("results")).unwrap();
    assert_refused(&synth("run", &plan).output().unwrap(), "leads out of");
    jail.assert_intact();
}

#[test]
fn moved_plan_can_be_run() {
    let jail = Jail::new();
    let plan = jail.plan();
    fs::remove_dir_all(jail.at("table")).unwrap();
    fs::rename(plan, jail.at("moved")).unwrap();
    succeed(&mut synth("run", &jail.at("moved")));
}

#[test]
fn tables_refer_to_their_folder_and_linked_folders_only() {
    let jail = Jail::new();
    fs::create_dir(jail.at("meshes")).unwrap();
    fs::write(jail.at("meshes/part.obj"), MESH).unwrap();
    let absolute = jail.at("meshes/part.obj");
    let row = |mesh: &str| format!("mesh = {mesh:?}\nunit = \"mm\"");
    for mesh in [absolute.to_str().unwrap(), "../meshes/part.obj"] {
        assert_refused(
            &jail.plan_command(&row(mesh)).output().unwrap(),
            "LINKED_FOLDERS",
        );
    }
    let mut plan = jail.plan_command(&row(absolute.to_str().unwrap()));
    succeed(plan.env("GRIPCAST__FILES__LINKED_FOLDERS", jail.at("meshes")));
    let outside = jail.at("meshes/../secret");
    let mut plan = jail.plan_command(&row(outside.to_str().unwrap()));
    plan.env("GRIPCAST__FILES__LINKED_FOLDERS", jail.at("meshes"));
    assert_refused(&plan.output().unwrap(), "not below the folder");
}
