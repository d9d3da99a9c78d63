//! Random records, plans and meshes with hostile names, in a jail. The input chooses names from a
//! list, or is one, and where they stand. Nothing outside of the jail may change or be opened.

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use gripcast_base::files::Root;
use gripcast_dataset::Dataset;
use gripcast_geometry::{LengthUnit, load_mesh, load_textured_mesh};
use gripcast_synth::plan::Plan;
use gripcast_synth::{ResultStore, planned_mesh};
use rustix::fs::inotify::{self, CreateFlags, WatchFlags};

/// What names try. `OUTSIDE` becomes the absolute path of the folder outside.
const NAMES: [&str; 24] = [
    "..",
    ".",
    "",
    "../../outside/secret",
    "../../../outside/secret",
    "../../../../outside/secret.jpg",
    "OUTSIDE/secret",
    "OUTSIDE/new",
    "/proc/self/mem",
    "/dev/zero",
    "a/../../../../outside/secret",
    "..\\..\\outside\\secret",
    "link",
    "link/secret",
    "link/new",
    "file",
    ".lock",
    "grasp.json",
    "initial.left.jpg",
    "2026-11-20T10-15-03Z-7f3a",
    "mug",
    "a\u{0}b",
    "\u{202e}gpj.exe",
    "\u{1b}]0;x\u{7}",
];

/// Takes choices from the input; zeros where it has ended.
struct Choices<'a>(&'a [u8]);

impl Choices<'_> {
    fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((&first, rest)) => {
                self.0 = rest;
                first
            }
            None => 0,
        }
    }

    fn name(&mut self, outside: &Path) -> String {
        let choice = usize::from(self.byte());
        if choice < 200 {
            let name = NAMES[choice % NAMES.len()];
            return name.replace("OUTSIDE", &outside.display().to_string());
        }
        let length = usize::from(self.byte() % 32).min(self.0.len());
        let (text, rest) = self.0.split_at(length);
        self.0 = rest;
        String::from_utf8_lossy(text).into_owned()
    }
}

/// `outside/` and `jail/` in a folder of their own; whoever opens something outside is seen.
struct Place {
    dir: tempfile::TempDir,
    watch: std::os::fd::OwnedFd,
}

impl Place {
    fn new() -> Self {
        let dir = tempfile::tempdir().expect("a folder for the case");
        let outside = dir.path().join("outside");
        fs::create_dir_all(outside.join("folder")).expect("outside");
        for name in [
            "secret",
            "secret.jpg",
            "secret.obj",
            "secret.mtl",
            "folder/grasp.json",
        ] {
            fs::write(outside.join(name), "secret").expect("a secret");
        }
        fs::create_dir(dir.path().join("jail")).expect("a jail");
        let watch = inotify::init(CreateFlags::NONBLOCK | CreateFlags::CLOEXEC).expect("inotify");
        // Not the end of an opening: a process that another test starts holds the files written
        // above for a moment, and closes them after the watch began.
        let closes = WatchFlags::CLOSE_WRITE | WatchFlags::CLOSE_NOWRITE;
        let flags = WatchFlags::ALL_EVENTS - closes;
        for folder in [outside.clone(), outside.join("folder")] {
            inotify::add_watch(&watch, folder, flags).expect("a watch");
        }
        Self { dir, watch }
    }

    fn outside(&self) -> PathBuf {
        self.dir.path().join("outside")
    }

    fn jail(&self) -> PathBuf {
        self.dir.path().join("jail")
    }

    /// Panics for anything that happened outside.
    fn check(&self, what: &str) {
        let mut buffer = [std::mem::MaybeUninit::uninit(); 4096];
        let mut events = inotify::Reader::new(&self.watch, &mut buffer);
        if let Ok(event) = events.next() {
            panic!(
                "{what}: {:?} of {:?} outside",
                event.events(),
                event.file_name()
            );
        }
    }
}

/// Text as a JSON string.
fn quoted(text: &str) -> String {
    serde_json::to_string(text).expect("a text is JSON")
}

/// Puts a link or a small file where a name that is one component may lie.
fn litter(folder: &Path, choices: &mut Choices<'_>, outside: &Path) {
    for _ in 0..choices.byte() % 4 {
        let name = choices.name(outside);
        let is_plain =
            !name.is_empty() && !name.contains(['/', '\0']) && name != "." && name != "..";
        if !is_plain {
            continue;
        }
        let place = folder.join(name);
        let _ = match choices.byte() % 4 {
            0 => symlink("../../../../outside/secret", place),
            1 => symlink(outside, place),
            2 => symlink("..", place),
            _ => fs::write(place, "file"),
        };
    }
}

/// Panics where something outside of the jail is opened or changed.
pub(crate) fn check(input: &[u8]) {
    let mut choices = Choices(input);
    let place = Place::new();
    match choices.byte() % 3 {
        0 => record(&place, &mut choices),
        1 => plan(&place, &mut choices),
        _ => mesh(&place, &mut choices),
    }
}

fn record(place: &Place, choices: &mut Choices<'_>) {
    let outside = place.outside();
    let root = place.jail();
    let folder = root.join("grasps/2026-11-20T10-15-03Z-7f3a");
    fs::create_dir_all(&folder).expect("a grasp");
    fs::write(
        root.join("dataset.toml"),
        "schema = 1\nname = \"n\"\nrig = \"r\"\nlicence = \"l\"\nlabel_definition = \"d\"\n\
         software = \"s\"\n",
    )
    .expect("a description");
    for name in ["trash", "calibration", "splits", "logs", "models"] {
        if choices.byte().is_multiple_of(4) {
            let _ = symlink(&outside, root.join(name));
        } else {
            fs::create_dir_all(root.join(name)).expect("a folder");
        }
    }
    for folder in [&root, &root.join("grasps"), &folder] {
        litter(folder, choices, &outside);
    }
    let mut name = || quoted(&choices.name(&outside));
    let digest = "{\"bytes\":4,\"sha256\":\
                  \"3b9c358f36f0a31b6ad3e14f309c7cf198ac9246e8316f9ce543d5b19ac02b80\"}";
    let mut json = format!("{{\"schema\":1,\"id\":{},", name());
    for key in ["object", "scene", "operator", "rig", "software", "note"] {
        let _ = write!(json, "\"{key}\":{},", name());
    }
    for stage in ["initial", "grasp"] {
        let _ = write!(
            json,
            "\"{stage}\":{{\"captured_at\":\"2026-11-20T10:15:03Z\",\"trigger_time_ns\":0,\
             \"trigger\":\"script\",\"skew_ms\":0.0,\"cameras\":{{\"left\":{{\"file\":{},\
             \"product\":\"\",\"serial\":\"\",\"interface\":0,\"port\":\"\",\"format\":\"MJPG\",\
             \"width\":16,\"height\":8,\"driver_time_ns\":0,\"sequence\":0,\"age_ms\":0.0,\
             \"controls\":{{}},\"crop_profile\":null,\"depth_unit_m\":null}}}}}},",
            name()
        );
    }
    let _ = write!(
        json,
        "\"outcome\":\"stable\",\"labelled_at\":null,\"pose\":null,\"prediction\":null,\
         \"overridden_guards\":[],\"calibration\":{{\"left\":{}}},\"files\":{{{}:{digest}}}}}",
        name(),
        name()
    );
    let _ = fs::remove_file(folder.join("grasp.json"));
    fs::write(folder.join("grasp.json"), json).expect("a record");
    if let Ok(data) = Dataset::open(&root) {
        for record in data.grasps().into_iter().flatten().flatten() {
            for file in record.files.keys() {
                let _ = data
                    .file(&record, file)
                    .map(|f| f.read(gripcast_base::files::FileKind::Image));
            }
            for key in record.calibration_keys() {
                let _ = data.calibration(key);
            }
        }
        for name in data.split_names().into_iter().flatten() {
            let _ = data.split(&name);
        }
    }
    let _ = gripcast_dataset::verify(&root, &|_, _| {});
    let _ = gripcast_dataset::recover(&root, false);
    let _ = gripcast_dataset::reindex(&root);
    let _ = gripcast_dataset::verify(&root, &|_, _| {});
    place.check("a dataset");
}

/// A plan of one object; its names and its mesh are replaced.
const PLAN: &str = include_str!("../corpus/plan_jsonl/plan");
const PLANNED_MESH: &str = r#""mesh":{"from":"family","category":"block","seed":1188066420357611}"#;

fn plan(place: &Place, choices: &mut Choices<'_>) {
    let outside = place.outside();
    let root = place.jail();
    for name in ["meshes", "textures", "results"] {
        if choices.byte().is_multiple_of(4) {
            let _ = symlink(&outside, root.join(name));
        } else {
            fs::create_dir_all(root.join(name)).expect("a folder");
            litter(&root.join(name), choices, &outside);
        }
    }
    litter(&root, choices, &outside);
    let mut text = PLAN.to_owned();
    if choices.byte().is_multiple_of(2) {
        let file = quoted(&choices.name(&outside));
        text = text.replace(
            PLANNED_MESH,
            &format!("\"mesh\":{{\"from\":\"file\",\"file\":{file}}}"),
        );
    }
    if choices.byte().is_multiple_of(2) {
        let name = quoted(&choices.name(&outside));
        text = text.replace("block-0000", name.trim_matches('"'));
    }
    let _ = fs::remove_file(root.join("plan.jsonl"));
    fs::write(root.join("plan.jsonl"), &text).expect("a plan");
    let hash = format!("{}  plan.jsonl\n", gripcast_base::files::sha256_hex(&text));
    let _ = fs::remove_file(root.join("plan.sha256"));
    fs::write(root.join("plan.sha256"), hash).expect("its hash");
    if let Ok(plan) = Plan::read(&root) {
        let store = ResultStore::new(&root);
        for object in plan.objects.values() {
            let _ = planned_mesh(object, &Root::new(&root));
        }
        for simulation in &plan.simulations {
            let _ = store.has_file(&simulation.id);
            let _ = store.load(&plan, &simulation.id);
        }
    }
    place.check("a plan");
}

fn mesh(place: &Place, choices: &mut Choices<'_>) {
    let outside = place.outside();
    let root = place.jail();
    litter(&root, choices, &outside);
    let is_obj = choices.byte().is_multiple_of(2);
    let name = choices.name(&outside);
    let path = root.join(if is_obj { "mesh.obj" } else { "mesh.gltf" });
    let text = if is_obj {
        format!(
            "mtllib {name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl a\n\
                 f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
        )
    } else {
        format!(
            "{{\"asset\":{{\"version\":\"2.0\"}},\"buffers\":[{{\"byteLength\":6,\"uri\":{}}}],\
             \"meshes\":[],\"scenes\":[]}}",
            quoted(&name)
        )
    };
    // What the litter put there may be a link out.
    if fs::symlink_metadata(&path).is_err() {
        fs::write(&path, text).expect("a mesh");
        let _ = load_mesh(&path, LengthUnit::Metre);
        let _ = load_textured_mesh(&path, LengthUnit::Metre);
    }
    place.check("a mesh");
}
