//! `--fields` of `gripcast sim grasp` and `sim press` as a user runs them.

use std::fs;
use std::path::Path;

use gripcast_sim::grasp::{StageName, TraceFile};

use crate::peers::{agrees, peer};
use crate::program::{gripcast, stderr, succeed};

fn sim(arguments: &str, trace: &Path) -> std::process::Command {
    let mut command = gripcast();
    command.arg("sim").args(arguments.split_whitespace());
    command.arg("--trace").arg(trace);
    command
}

const GRASP: &str = "grasp --object builtin:sphere --gel coarse --adjust-s 0.1 --lift 0.004 \
                     --stop-force-n 10 --threads 1";

#[test]
fn grasp_writes_its_fields_and_numpy_reads_them() {
    let dir = tempfile::tempdir().unwrap();
    let [plain, every, stages] =
        ["plain.bin", "every.bin", "stages.bin"].map(|n| dir.path().join(n));
    succeed(&mut sim(GRASP, &plain));
    succeed(sim(GRASP, &every).args(["--fields", "every:5"]));
    succeed(sim(GRASP, &stages).args(["--fields", "stages"]));
    let read = |path| TraceFile::read(&fs::read(path).unwrap()).unwrap().trace;
    let (plain, trace) = (read(&plain), read(&every));
    assert!(plain.fields.is_none());
    assert_eq!(
        (&plain.steps, &plain.snapshots),
        (&trace.steps, &trace.snapshots)
    );
    let series = trace.fields.unwrap();
    assert_eq!(series.steps.len(), plain.steps.len().div_ceil(5));
    assert_eq!((series.mesh.x_m.len(), series.mesh.y_m.len()), (13, 11));
    let ends = read(&stages).fields.unwrap();
    let ends: Vec<_> = ends.steps.iter().map(|step| step.stage).collect();
    assert_eq!(ends, StageName::ALL.map(Some));
    if let Some(mut reader) = peer("read_trace.py") {
        let said = agrees(reader.arg(&every));
        let expected = format!("{} 2 11 13 closure adjustment lift", series.steps.len());
        assert_eq!(said.trim(), expected);
    }
}

#[test]
fn press_writes_the_fields_of_its_targets() {
    let dir = tempfile::tempdir().unwrap();
    let trace = dir.path().join("press.bin");
    succeed(&mut sim(
        "press --indenter sphere --radius-m 0.01 --gel coarse --friction 0.4 --face-m 1e-3 \
         --depth-m 3e-4 --shift-m 5e-5",
        &trace,
    ));
    let file = TraceFile::read(&fs::read(&trace).unwrap()).unwrap();
    let series = file.trace.fields.unwrap();
    let points = file.header["press"]["points"].as_array().unwrap();
    assert_eq!((series.steps.len(), points.len()), (2, 2));
    for (step, point) in series.steps.iter().zip(points) {
        let [shear, _, normal] = step.gels[0].resultant.force_n;
        let expected = |name: &str| point[name].as_f64().unwrap();
        assert!((normal + expected("normal_n")).abs() < 1e-9);
        assert!((shear - expected("shear_n")).abs() < 1e-9);
    }
    if let Some(mut reader) = peer("read_trace.py") {
        assert_eq!(agrees(reader.arg(&trace)).trim(), "2 1 11 13 press");
    }
}

#[test]
fn fields_need_a_binary_trace() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |file: &str, fields: &str, expected: &str| {
        let mut command = sim(GRASP, &dir.path().join(file));
        let output = command.args(["--fields", fields]).output().unwrap();
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(expected), "{text}");
    };
    refused("grasp.json", "all", ".bin");
    refused("grasp.bin", "every:0", "every:N");
    refused("grasp.bin", "sometimes", "every:N");
}

#[test]
fn documentation_shows_the_reader_that_is_tested() {
    let read =
        |path: &str| fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap();
    let script = read("tests/peers/read_trace.py");
    let start = script.find("def read_fields").unwrap();
    let end = script.find("\n\n\ndef main").unwrap();
    assert!(read("docs/reference/trace-format.md").contains(&script[start..end]));
}
