//! Output files of the renderers and their report.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::flags::suffix;
use super::working::Progress;
use super::{create_folder, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};

/// Output of a renderer: one image, or a folder of several.
pub(super) struct OutPlan {
    pub(super) out: PathBuf,
    pub(super) is_single: bool,
}

impl OutPlan {
    /// Checks the name and creates folders; `single` says how to request one image.
    pub(super) fn prepare(&self, single: &str) -> Result<()> {
        let out = &self.out;
        if (suffix(out) == "png") != self.is_single {
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
        folder.map_or(Ok(()), create_folder)
    }

    /// Returns the file of an image; `name` is its name among several.
    pub(super) fn file(&self, name: &str) -> PathBuf {
        if self.is_single {
            self.out.clone()
        } else {
            self.out.join(name)
        }
    }
}

/// Written images and failed traces.
#[derive(Debug, Serialize)]
pub(super) struct Report<T> {
    images: Vec<T>,
    failed: Vec<Failed>,
}

#[derive(Debug, Serialize)]
struct Failed {
    trace: PathBuf,
    error: String,
}

impl<T: Serialize> Report<T> {
    /// Returns a report without failures.
    pub(super) fn new(images: Vec<T>) -> Self {
        Self {
            images,
            failed: Vec::new(),
        }
    }

    /// Renders every trace. One of several that cannot be rendered is reported and omitted.
    ///
    /// # Errors
    /// The error of the only trace; `Input` if none of several can be rendered.
    pub(super) fn of_traces(
        traces: &[PathBuf],
        progress: &Progress,
        mut render: impl FnMut(&Path) -> Result<Vec<T>>,
    ) -> Result<Self> {
        let mut report = Self::new(Vec::new());
        for (done, trace) in traces.iter().enumerate() {
            progress.count(done, traces.len());
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

    /// Prints the report: as JSON, or as a line per image.
    ///
    /// # Errors
    /// `Partial` if a trace failed.
    pub(super) fn conclude(&self, json: bool, line: impl Fn(&T) -> String) -> Result<()> {
        print_report(json, self, |_| {
            let lines: Vec<String> = self.images.iter().map(line).collect();
            lines.join("\n")
        })?;
        match self.failed.len() {
            0 => Ok(()),
            count => Err(Error::new(
                ErrorKind::Partial,
                format!("{count} traces could not be rendered"),
            )
            .remedy("see the errors above")),
        }
    }
}
