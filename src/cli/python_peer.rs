//! Peers that are measured beside gripcast through `python3`.

use std::io::Write as _;
use std::process::{Command, Stdio};

use serde_json::Value;

use gripcast_base::error::{Error, ErrorKind, Result};

/// Exit code of a peer's script when its library cannot be imported.
const ABSENT: i32 = 3;

/// Runs a peer's script on `input`; `None` when Python or the peer's library is absent.
pub(super) fn measure(name: &str, script: &str, runs: u64, input: &[u8]) -> Result<Option<Value>> {
    let failed = |what: &str| Error::new(ErrorKind::Internal, format!("{name} bench: {what}"));
    let runs = runs.to_string();
    let spawned = Command::new("python3")
        .args(["-c", script, "-", "--runs", &runs])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let mut python = match spawned {
        Ok(python) => python,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::io("cannot start python3", error)),
    };
    if let Some(mut stdin) = python.stdin.take() {
        // A peer that is absent ends without reading; its exit code says so.
        let _ = stdin.write_all(input);
    }
    let output = python
        .wait_with_output()
        .map_err(|e| Error::io("cannot read from python3", e))?;
    match output.status.code() {
        Some(0) => serde_json::from_slice(&output.stdout)
            .map(Some)
            .map_err(|cause| failed("its answer is no JSON").because(cause)),
        Some(ABSENT) => Ok(None),
        _ => Err(failed("python3 failed, see its message above")),
    }
}
