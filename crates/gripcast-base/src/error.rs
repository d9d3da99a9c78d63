//! The error type of gripcast: what failed, where, and how to fix it.
//!
//! Every message states operation, object, expected and found values;
//! the caller adds path, camera role or port with [`Error::at`].

use std::fmt;

mod refused;

pub use refused::Refused;

/// Result with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Class of an error; determines the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// Invalid or contradictory arguments.
    Usage,
    /// Invalid configuration or rig file.
    Config,
    /// Invalid input: file, model, mesh, image or record.
    Input,
    /// A path or item does not exist.
    NotFound,
    /// The operating system refuses access.
    Permission,
    /// The operating system reports an IO failure.
    Io,
    /// No space (or no inodes, or quota) is left on the disk that is written to.
    DiskFull,
    /// Another process holds the resource.
    Busy,
    /// A device is missing, unplugged or unusable.
    Device,
    /// The work finished, but some data was lost or skipped.
    Partial,
    /// A requested check failed.
    Check,
    /// Stopped at a safe point; the same command resumes.
    Stopped,
    /// Interrupted by the user.
    Interrupted,
    /// A defect of gripcast itself.
    Internal,
}

impl ErrorKind {
    /// Process exit code (design: 0 ok, 1 failed, 2 usage, 3 partial, 4 check, 69 no device,
    /// 75 run again, 130 interrupted).
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Usage | Self::Config => 2,
            Self::Partial => 3,
            Self::Check => 4,
            Self::Device => 69,
            Self::Stopped => 75,
            Self::Interrupted => 130,
            Self::Input
            | Self::NotFound
            | Self::Permission
            | Self::Io
            | Self::DiskFull
            | Self::Busy
            | Self::Internal => 1,
        }
    }
}

/// An error with location and remedy.
pub struct Error(Box<Inner>);

struct Inner {
    kind: ErrorKind,
    what: String,
    location: Option<String>,
    remedy: Option<String>,
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

impl Error {
    /// An error of `kind`; `what` states operation and object, expected and found values.
    pub fn new(kind: ErrorKind, what: impl Into<String>) -> Self {
        Self(Box::new(Inner {
            kind,
            what: what.into(),
            location: None,
            remedy: None,
            source: None,
        }))
    }

    /// Invalid input: file, model, mesh, image or record.
    pub fn input(what: impl Into<String>) -> Self {
        Self::new(ErrorKind::Input, what)
    }

    /// Invalid or contradictory arguments.
    pub fn usage(what: impl Into<String>) -> Self {
        Self::new(ErrorKind::Usage, what)
    }

    /// Invalid configuration or rig file.
    pub fn config(what: impl Into<String>) -> Self {
        Self::new(ErrorKind::Config, what)
    }

    /// A path or item does not exist.
    pub fn not_found(what: impl Into<String>) -> Self {
        Self::new(ErrorKind::NotFound, what)
    }

    /// A defect of gripcast itself.
    pub fn internal(what: impl Into<String>) -> Self {
        Self::new(ErrorKind::Internal, what)
    }

    /// Wraps an IO error; the kind follows from the operating system's code.
    pub fn io(what: impl Into<String>, source: std::io::Error) -> Self {
        use std::io::ErrorKind as Io;
        let refused = source.get_ref().and_then(|e| e.downcast_ref::<Refused>());
        if let Some(remedy) = refused.map(Refused::remedy) {
            return Self::new(ErrorKind::Input, what)
                .because(source)
                .remedy(remedy);
        }
        let kind = match source.kind() {
            Io::NotFound => ErrorKind::NotFound,
            Io::PermissionDenied | Io::ReadOnlyFilesystem => ErrorKind::Permission,
            Io::StorageFull | Io::QuotaExceeded => ErrorKind::DiskFull,
            Io::ResourceBusy => ErrorKind::Busy,
            _ => ErrorKind::Io,
        };
        Self::new(kind, what).because(source)
    }

    /// Adds the location: a path, camera role or port. The outermost location comes first.
    #[must_use]
    pub fn at(mut self, location: impl fmt::Display) -> Self {
        self.0.location = Some(match self.0.location.take() {
            Some(inner) => format!("{location}: {inner}"),
            None => location.to_string(),
        });
        self
    }

    /// Adds a remedy. The first one, closest to the cause, is kept.
    #[must_use]
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.0.remedy.get_or_insert_with(|| remedy.into());
        self
    }

    /// Replaces a remedy that does not apply where the error goes to.
    #[must_use]
    pub fn replace_remedy(mut self, remedy: impl Into<String>) -> Self {
        self.0.remedy = Some(remedy.into());
        self
    }

    /// Adds the underlying cause.
    #[must_use]
    pub fn because(mut self, source: impl std::error::Error + Send + Sync + 'static) -> Self {
        self.0.source = Some(Box::new(source));
        self
    }

    /// Class of the error.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// What failed, without location and remedy.
    #[must_use]
    pub fn what(&self) -> &str {
        &self.0.what
    }

    /// Where it failed, if known.
    #[must_use]
    pub fn location(&self) -> Option<&str> {
        self.0.location.as_deref()
    }

    /// How to fix it, if known.
    #[must_use]
    pub fn remedy_text(&self) -> Option<&str> {
        self.0.remedy.as_deref()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let inner = &self.0;
        if let Some(location) = &inner.location {
            write!(f, "{location}: ")?;
        }
        f.write_str(&inner.what)?;
        if let Some(source) = &inner.source {
            write!(f, ": {source}")?;
        }
        if let Some(remedy) = &inner.remedy {
            write!(f, "\n  → {remedy}")?;
        }
        Ok(())
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {self}", self.0.kind)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.0.source.as_deref().map(|s| s as _)
    }
}

/// Returns the known name closest to a misspelt one, if close enough.
#[must_use]
pub fn nearest_name<'a>(wanted: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .map(|name| (edit_distance(wanted, name), name))
        .min()
        .filter(|(distance, _)| *distance <= (wanted.chars().count() / 2).max(1))
        .map(|(_, name)| name)
}

/// `Usage` error for an unknown name; the remedy lists the closest name and all valid ones.
#[must_use]
pub fn unknown_name(kind: &str, wanted: &str, known: &[&str]) -> Error {
    let nearest = nearest_name(wanted, known.iter().copied());
    let hint = nearest.map_or(String::new(), |name| format!("did you mean {name}? "));
    Error::usage(format!("unknown {kind} {wanted:?}"))
        .remedy(format!("{hint}valid names: {}", known.join(", ")))
}

/// Levenshtein distance.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, cb) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_has_location_what_cause_and_remedy() {
        let cause = std::io::Error::from(std::io::ErrorKind::StorageFull);
        let error = Error::io("cannot write the grasp", cause)
            .at("grasp.json")
            .at("/data/kitchen")
            .remedy("free some space")
            .remedy("a later remedy does not replace the first");
        assert_eq!(error.kind(), ErrorKind::DiskFull);
        assert_eq!(
            error.to_string(),
            "/data/kitchen: grasp.json: cannot write the grasp: no storage space\n  → free some space"
        );
    }

    #[test]
    fn nearest_name_is_close() {
        let known = ["left", "right", "rgb"];
        assert_eq!(nearest_name("lft", known), Some("left"));
        assert_eq!(nearest_name("rihgt", known), Some("right"));
        assert_eq!(nearest_name("external", known), None);
        assert_eq!(edit_distance("kitten", "sitting"), 3);
    }

    #[test]
    fn exit_codes_are_as_documented() {
        for (kind, code) in [
            (ErrorKind::Usage, 2),
            (ErrorKind::Config, 2),
            (ErrorKind::Partial, 3),
            (ErrorKind::Check, 4),
            (ErrorKind::Device, 69),
            (ErrorKind::Stopped, 75),
            (ErrorKind::Interrupted, 130),
            (ErrorKind::Io, 1),
        ] {
            assert_eq!(kind.exit_code(), code, "{kind:?}");
        }
    }
}
