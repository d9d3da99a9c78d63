//! Other implementations that are measured beside gripcast, through `python3`.

use std::io::Write as _;
use std::process::{Command, Stdio};

use gripcast::cli::Context;
use gripcast_base::error::{Error, Result};
use serde_json::Value;

/// Exit code of a peer's script when its library cannot be imported.
const ABSENT: i32 = 3;

/// A library of PyPI and the script that measures it.
pub(crate) struct Peer {
    pub(crate) name: &'static str,
    /// Packages that the script imports.
    pub(crate) packages: &'static str,
    pub(crate) script: &'static str,
}

impl Peer {
    /// Runs the script on `input`. Where Python or a package is absent: `None`, and stderr says
    /// what to install.
    pub(crate) fn measure(
        &self,
        context: &Context,
        runs: u64,
        input: &[u8],
    ) -> Result<Option<Value>> {
        let answer = self.answer(runs, input)?;
        if answer.is_none() && !context.quiet {
            eprintln!(
                "gripcast-bench: {} is absent, so it was not measured\n  → pip install {}",
                self.name, self.packages
            );
        }
        Ok(answer)
    }

    fn answer(&self, runs: u64, input: &[u8]) -> Result<Option<Value>> {
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
            // A peer that is absent ends without reading; its exit code says so.
            let _ = stdin.write_all(input);
        }
        let output = python
            .wait_with_output()
            .map_err(|e| Error::io("cannot read from python3", e))?;
        match output.status.code() {
            Some(0) => serde_json::from_slice(&output.stdout)
                .map(Some)
                .map_err(|e| self.failed("its answer is not JSON").because(e)),
            Some(ABSENT) => Ok(None),
            _ => Err(self.failed("python3 failed, see its message above")),
        }
    }

    /// The error of a peer that does not answer as it should.
    pub(crate) fn failed(&self, what: &str) -> Error {
        Error::internal(format!("{} bench: {what}", self.name))
    }
}
