//! Example scripts for clusters: Slurm on a local one-node cluster, Kubernetes by checks of the
//! manifest.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use gripcast_base::error::ErrorKind;
use serde_json::{Value, json};

use crate::program::{end_of, wait_until};
use gripcast_testing::{Needs, skip};

/// Exit code of the script if Slurm cannot run.
const NO_SLURM: i32 = 77;

fn in_repository(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn slurm_gives_the_dataset_of_a_single_process() {
    if std::env::var_os("GRIPCAST_SKIP_SLURM").is_some() {
        return skip(Needs::Slurm, "GRIPCAST_SKIP_SLURM is set");
    }
    let output = Command::new(in_repository("tests/cluster/slurm.sh"))
        .arg(env!("CARGO_BIN_EXE_gripcast"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let log = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    if output.status.code() == Some(NO_SLURM) {
        return skip(Needs::Slurm, errors.trim());
    }
    assert!(
        output.status.success(),
        "{}\n{log}\n{errors}",
        output.status
    );
    eprintln!("{log}");
}

fn manifest() -> Value {
    let text = fs::read_to_string(in_repository("examples/cluster/kubernetes-job.yaml")).unwrap();
    serde_saphyr::from_str(&text).unwrap()
}

fn container(manifest: &Value) -> &Value {
    &manifest["spec"]["template"]["spec"]["containers"][0]
}

/// Script that the pod runs.
fn pod_script(manifest: &Value) -> &str {
    let container = container(manifest);
    assert_eq!(container["command"], json!(["/bin/sh", "-c"]));
    container["args"][0].as_str().unwrap()
}

#[test]
fn kubernetes_job_has_one_pod_per_shard() {
    let manifest = manifest();
    let spec = &manifest["spec"];
    assert_eq!(manifest["kind"], "Job");
    assert_eq!(spec["completionMode"], "Indexed");
    // Required by `backoffLimitPerIndex` and `podFailurePolicy`.
    assert_eq!(spec["template"]["spec"]["restartPolicy"], "Never");
    let shards = spec["completions"].as_u64().unwrap();
    let script = pod_script(&manifest);
    assert!(script.contains(&format!("--shard /{shards} ")), "{script}");
    assert!(spec["maxFailedIndexes"].as_u64().unwrap() <= shards);
    assert!(spec["parallelism"].as_u64().unwrap() <= shards);
    let claims = &spec["template"]["spec"]["volumes"];
    assert_eq!(
        container(&manifest)["volumeMounts"][0]["name"],
        claims[0]["name"]
    );
}

#[test]
fn kubernetes_job_retries_temporary_failures() {
    let manifest = manifest();
    let rules = manifest["spec"]["podFailurePolicy"]["rules"]
        .as_array()
        .unwrap();
    let action = |kind: ErrorKind| {
        let code = kind.exit_code();
        let rule = rules.iter().find(|rule| {
            rule["onExitCodes"]["values"]
                .as_array()
                .is_some_and(|all| all.contains(&json!(code)))
        });
        rule.map_or("Count", |rule| rule["action"].as_str().unwrap())
    };
    for kind in [
        ErrorKind::Usage,
        ErrorKind::Config,
        ErrorKind::Input,
        ErrorKind::NotFound,
    ] {
        assert_eq!(action(kind), "FailIndex", "{kind:?}");
    }
    assert_eq!(action(ErrorKind::Stopped), "Ignore");
    for rule in rules {
        if rule.get("onExitCodes").is_some() {
            assert_eq!(
                rule["onExitCodes"]["containerName"],
                container(&manifest)["name"]
            );
            assert_eq!(rule["onExitCodes"]["operator"], "In");
        }
    }
}

/// Starts the script of the pod with a shell script in place of gripcast.
fn pod(folder: &Path, program: &str) -> Child {
    let path = folder.join("gripcast");
    fs::write(&path, format!("#!/bin/sh\n{program}\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    let manifest = manifest();
    let search = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap());
    let mut shell = Command::new("/bin/sh");
    shell
        .args(["-c", pod_script(&manifest)])
        .env("PATH", search);
    shell.current_dir(folder).process_group(0).spawn().unwrap()
}

#[test]
fn pod_exits_with_the_code_of_its_shard() {
    let folder = tempfile::tempdir().unwrap();
    for (code, expected) in [(0, 0), (1, 1), (2, 2), (75, 75), (137, 137)] {
        let status = pod(folder.path(), &format!("exit {code}")).wait().unwrap();
        assert_eq!(status.code(), Some(expected), "{code}");
    }
    // Failed simulations are results.
    let partial = ErrorKind::Partial.exit_code();
    let status = pod(folder.path(), &format!("exit {partial}"))
        .wait()
        .unwrap();
    assert_eq!(status.code(), Some(0));
}

#[test]
fn evicted_pod_stops_its_shard() {
    let folder = tempfile::tempdir().unwrap();
    let stopped = ErrorKind::Stopped.exit_code();
    // Ends on its own if it is not stopped.
    let program =
        format!("trap 'exit {stopped}' TERM\n: > runs\nfor i in $(seq 600); do sleep 0.1; done");
    let mut pod = pod(folder.path(), &program);
    wait_until(&mut pod, || folder.path().join("runs").exists());
    // Only the shell: Kubernetes signals the first process.
    let shell = rustix::process::Pid::from_child(&pod);
    rustix::process::kill_process(shell, rustix::process::Signal::TERM).unwrap();
    assert_eq!(end_of(&mut pod).code(), Some(i32::from(stopped)));
}
