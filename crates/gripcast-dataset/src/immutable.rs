//! Content-addressed files that grasps refer to: calibrations and model cards, each named after
//! its sha256.

use super::disk::replace;
use super::writer::DatasetWriter;
use gripcast_base::error::Result;
use gripcast_base::files::{BeneathPath, ContentKey, FileKind};

impl DatasetWriter {
    /// Stores a calibration; returns the key by which grasps refer to it.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub fn put_calibration(&mut self, toml: &str) -> Result<ContentKey> {
        self.put_immutable(&self.layout.calibration(), toml, ".toml")
    }

    /// Stores a model card; returns its key. The card holds the sha256 of the ONNX file, by which
    /// predictions name their model.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub fn put_model(&mut self, json: &str) -> Result<ContentKey> {
        self.put_immutable(&self.layout.models(), json, ".json")
    }

    fn put_immutable(
        &self,
        dir: &BeneathPath,
        text: &str,
        suffix: &'static str,
    ) -> Result<ContentKey> {
        let key = ContentKey::from_contents(text.as_bytes());
        let name = key.with_suffix(suffix);
        let stored = dir.join(&name).read(FileKind::Record);
        if !stored.is_ok_and(|stored| stored == text.as_bytes()) {
            replace(self.disk.as_ref(), dir, &name, text.as_bytes())
                .map_err(|e| self.failed(&format!("cannot store {name}"), e))?;
        }
        Ok(key)
    }
}
