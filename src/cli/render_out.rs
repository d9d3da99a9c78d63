//! Where rendered images go, and what is said about them.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::working::Progress;
use gripcast_base::error::{Error, ErrorKind, Result};

/// One image, or a folder of several.
pub(super) struct OutPlan {
    pub(super) out: PathBuf,
    pub(super) is_single: bool,
}

impl OutPlan {
    /// Checks the name and makes folders; `single` says how to ask for one image.
    pub(super) fn prepare(&self, single: &str) -> Result<()> {
        let out = &self.out;
        let is_png = out
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("png"));
        if is_png != self.is_single {
            let what = if self.is_single {
                "`--out` must end in .png for one image"
            } else {
                "`--out` must be a folder for several images"
            };
            return Err(Error::usage(what)
                .at(out.display())
                .remedy(format!("one image is {single} of one trace")));
        }
        let parent = out.parent().filter(|f| !f.as_os_str().is_empty());
        let folder = if self.is_single { parent } else { Some(&**out) };
        folder.map_or(Ok(()), |folder| {
            fs::create_dir_all(folder)
                .map_err(|e| Error::io("cannot create the folder", e).at(folder.display()))
        })
    }

    /// Where an image goes that is called `name` among several.
    pub(super) fn place(&self, name: &str) -> PathBuf {
        if self.is_single {
            self.out.clone()
        } else {
            self.out.join(name)
        }
    }
}

/// What was written and what was not.
#[derive(Debug, Serialize)]
pub(super) struct Report<T> {
    pub(super) images: Vec<T>,
    failed: Vec<Failed>,
}

#[derive(Debug, Serialize)]
struct Failed {
    trace: PathBuf,
    error: String,
}

impl<T> Report<T> {
    /// All went well.
    pub(super) fn of(images: Vec<T>) -> Self {
        Self {
            images,
            failed: Vec::new(),
        }
    }

    /// Renders every trace. Of several, one that cannot be rendered is told of and left out.
    ///
    /// # Errors
    /// That of the only trace; `Input` where none of several can be rendered.
    pub(super) fn of_traces(
        traces: &[PathBuf],
        progress: &Progress,
        mut render: impl FnMut(&Path) -> Result<Vec<T>>,
    ) -> Result<Self> {
        let mut report = Self::of(Vec::new());
        for (done, trace) in traces.iter().enumerate() {
            progress.at(done as u64, traces.len() as u64);
            match render(trace) {
                Ok(written) => report.images.extend(written),
                Err(error) if traces.len() == 1 => return Err(error),
                Err(error) => {
                    progress.line(format!("gripcast: {error}"));
                    report.failed.push(Failed {
                        trace: trace.clone(),
                        error: error.to_string(),
                    });
                }
            }
        }
        if report.images.is_empty() {
            return Err(Error::input("no trace could be rendered"));
        }
        Ok(report)
    }

    /// The end of the command: an error of kind `Partial` where a trace was left out.
    pub(super) fn finish(&self) -> Result<()> {
        match self.failed.len() {
            0 => Ok(()),
            count => Err(Error::new(
                ErrorKind::Partial,
                format!("{count} traces could not be rendered"),
            )
            .remedy("their errors are above")),
        }
    }
}
