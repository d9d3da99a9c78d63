//! Records the raw frames of a camera in the format of `replay`.
//!
//! ```text
//! DIR/<role>/stream.json    stream configuration
//!            frames.jsonl   one line per frame: file, sequence, driver_time_ns
//!            000000.jpg …   payloads (jpg, yuyv, z16, grey)
//! ```
//! A payload is written before its line: an interruption leaves at most an incomplete last line or
//! an unreferenced payload, which replay ignores.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::source::{CameraIdentity, StreamInfo};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::FileName;
use gripcast_imaging::{Frame, PixelFormat, Role};

pub(super) const STREAM_FILE: &str = "stream.json";
pub(super) const FRAMES_FILE: &str = "frames.jsonl";

/// `stream.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StreamRecord {
    pub(super) schema: u32,
    pub(super) product: String,
    pub(super) serial: String,
    pub(super) interface: u8,
    pub(super) port: String,
    pub(super) format: PixelFormat,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) nominal_fps: f64,
    pub(super) depth_unit_m: Option<f64>,
}

impl StreamRecord {
    pub(super) const SCHEMA: u32 = 1;

    fn new(info: &StreamInfo) -> Self {
        Self {
            schema: Self::SCHEMA,
            product: info.identity.product.clone(),
            serial: info.identity.serial.clone(),
            interface: info.identity.interface,
            port: info.identity.port.clone(),
            format: info.format,
            width: info.width,
            height: info.height,
            nominal_fps: info.nominal_fps,
            depth_unit_m: info.depth_unit_m,
        }
    }

    /// Configuration of a replay of `dir`, with the directory as port.
    pub(super) fn info(&self, dir: &Path) -> StreamInfo {
        StreamInfo {
            identity: CameraIdentity {
                product: self.product.clone(),
                serial: self.serial.clone(),
                interface: self.interface,
                port: dir.display().to_string(),
                node: None,
            },
            format: self.format,
            width: self.width,
            height: self.height,
            nominal_fps: self.nominal_fps,
            depth_unit_m: self.depth_unit_m,
        }
    }
}

/// A line of `frames.jsonl`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FrameRecord {
    pub(super) file: FileName,
    pub(super) sequence: u32,
    pub(super) driver_time_ns: u64,
}

fn extension(format: PixelFormat) -> &'static str {
    match format {
        PixelFormat::Mjpg => "jpg",
        PixelFormat::Yuyv => "yuyv",
        PixelFormat::Z16 => "z16",
        PixelFormat::Grey => "grey",
        PixelFormat::Rgb => "rgb",
    }
}

/// Writes the frames of one role.
#[derive(Debug)]
pub struct Recorder {
    dir: PathBuf,
    lines: File,
    format: PixelFormat,
    count: u64,
}

impl Recorder {
    /// Starts a recording in `dir/<role>`.
    ///
    /// # Errors
    /// `Input` for an existing recording; I/O errors.
    pub fn create(dir: &Path, role: Role, info: &StreamInfo) -> Result<Self> {
        let dir = dir.join(role.name());
        let create = || -> Result<File> {
            fs::create_dir_all(&dir)
                .map_err(|error| Error::io("cannot create the directory", error))?;
            let stream = dir.join(STREAM_FILE);
            if stream.exists() {
                return Err(Error::input("the directory already has a recording")
                    .remedy("choose another directory or remove this one"));
            }
            let mut text = serde_json::to_string_pretty(&StreamRecord::new(info))
                .map_err(|error| Error::internal(STREAM_FILE).because(error))?;
            text.push('\n');
            write_synced(&stream, text.as_bytes())?;
            File::create_new(dir.join(FRAMES_FILE))
                .map_err(|error| Error::io(format!("cannot create {FRAMES_FILE}"), error))
        };
        let lines = create().map_err(|error| error.at(dir.display()))?;
        Ok(Self {
            dir,
            lines,
            format: info.format,
            count: 0,
        })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// I/O errors; previous frames stay readable.
    pub fn write(&mut self, frame: &Frame) -> Result<()> {
        let number = format!("{:06}", self.count);
        let file = FileName::from_words(&[&number, extension(self.format)]);
        let record = FrameRecord {
            file,
            sequence: frame.sequence,
            driver_time_ns: frame.driver_time_ns,
        };
        let append = || -> Result<()> {
            let path = self.dir.join(record.file.as_str());
            fs::write(&path, &*frame.data)
                .map_err(|error| Error::io(format!("cannot write {}", record.file), error))?;
            let mut line = serde_json::to_string(&record)
                .map_err(|error| Error::internal(FRAMES_FILE).because(error))?;
            line.push('\n');
            (&self.lines)
                .write_all(line.as_bytes())
                .map_err(|error| Error::io(format!("cannot append to {FRAMES_FILE}"), error))
        };
        append().map_err(|error| error.at(self.dir.display()))?;
        self.count += 1;
        Ok(())
    }

    /// Number of written frames.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Ends the recording and syncs its index.
    ///
    /// # Errors
    /// I/O errors.
    pub fn finish(self) -> Result<u64> {
        self.lines
            .sync_all()
            .map_err(|error| Error::io(format!("cannot sync {FRAMES_FILE}"), error))
            .map_err(|error| error.at(self.dir.display()))?;
        Ok(self.count)
    }
}

fn write_synced(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = || -> std::io::Result<()> {
        let mut file = File::create_new(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(|error| Error::io(format!("cannot write {}", path.display()), error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn info() -> StreamInfo {
        StreamInfo {
            identity: CameraIdentity::default(),
            format: PixelFormat::Grey,
            width: 2,
            height: 1,
            nominal_fps: 25.0,
            depth_unit_m: None,
        }
    }

    #[test]
    fn an_existing_recording_is_not_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        Recorder::create(dir.path(), Role::Left, &info()).unwrap();
        let error = Recorder::create(dir.path(), Role::Left, &info()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(
            error
                .to_string()
                .contains("/left: the directory already has a recording")
        );
        Recorder::create(dir.path(), Role::Right, &info()).unwrap();
    }

    #[test]
    fn payloads_are_unchanged() {
        let dir = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(dir.path(), Role::Left, &info()).unwrap();
        let frame = Frame {
            format: PixelFormat::Grey,
            width: 2,
            height: 1,
            data: vec![7, 9].into(),
            sequence: 41,
            driver_time_ns: 5,
            received_ns: 6,
        };
        recorder.write(&frame).unwrap();
        assert_eq!(recorder.finish().unwrap(), 1);
        let left = dir.path().join("left");
        assert_eq!(fs::read(left.join("000000.grey")).unwrap(), [7, 9]);
        assert_eq!(
            fs::read_to_string(left.join(FRAMES_FILE)).unwrap(),
            "{\"file\":\"000000.grey\",\"sequence\":41,\"driver_time_ns\":5}\n"
        );
    }
}
