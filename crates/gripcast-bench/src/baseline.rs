//! Baselines: other implementations, run through `python3`.

use std::io::Write as _;
use std::process::{Command, Stdio};

use gripcast::cli::Context;
use gripcast_base::error::{Error, Result};
use serde_json::Value;

/// Exit code of a script whose library cannot be imported.
const ABSENT: i32 = 3;

/// A library of PyPI and the script that benchmarks it.
pub(crate) struct Baseline {
    pub(crate) name: &'static str,
    /// Packages imported by the script.
    pub(crate) packages: &'static str,
    pub(crate) script: &'static str,
}

impl Baseline {
    /// Runs the script on `input`. If Python or a package is absent, returns none and prints what
    /// to install.
    pub(crate) fn measure(
        &self,
        context: &Context,
        runs: u64,
        input: &[u8],
    ) -> Result<Option<Value>> {
        let output = self.run(runs, input)?;
        if output.is_none() && !context.quiet {
            eprintln!(
                "gripcast-bench: {} is not installed\n  → pip install {}",
                self.name, self.packages
            );
        }
        Ok(output)
    }

    fn run(&self, runs: u64, input: &[u8]) -> Result<Option<Value>> {
        let spawned = Command::new("python3")
            .args(["-c", self.script, "-", "--runs", &runs.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        let mut python = match spawned {
            Ok(python) => python,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(Error::io("cannot start python3", error)),
        };
        if let Some(mut stdin) = python.stdin.take() {
            // A script without its library ends without reading its input.
            let _ = stdin.write_all(input);
        }
        let output = python
            .wait_with_output()
            .map_err(|e| Error::io("cannot read from python3", e))?;
        match output.status.code() {
            Some(0) => serde_json::from_slice(&output.stdout)
                .map(Some)
                .map_err(|e| self.failed("invalid JSON output").because(e)),
            Some(ABSENT) => Ok(None),
            _ => Err(self.failed("python3 failed, see its message above")),
        }
    }

    /// Returns the error of a failed baseline.
    pub(crate) fn failed(&self, what: &str) -> Error {
        Error::internal(format!("{} baseline: {what}", self.name))
    }
}
