//! Videos, decoded by the system's ffmpeg.

use std::fs::File;
use std::io::{BufRead as _, BufReader, ErrorKind as IoKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

use image::RgbImage;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, open_regular};

/// Maximum width and height of a frame, px.
const MAX_SIDE: u32 = 8192;
/// Maximum length of what ffmpeg says that is repeated, bytes.
const MAX_MESSAGE: u64 = 2000;

/// A video; iterates over all stored frames, whatever their times.
pub struct Video {
    path: PathBuf,
    child: Child,
    output: BufReader<ChildStdout>,
    messages: File,
    frames: usize,
    has_failed: bool,
}

impl Video {
    /// Starts ffmpeg.
    ///
    /// # Errors
    /// `NotFound` without the file or without ffmpeg; `Io`.
    pub fn open(path: &Path) -> Result<Self> {
        let file = open_regular(path, FileKind::Bulk)
            .map_err(|e| Error::io("cannot open the recording", e).at(path.display()))?;
        Self::of_file(file, path)
    }

    /// As [`open`](Self::open), of an open file; `path` is for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn of_file(file: File, path: &Path) -> Result<Self> {
        let messages =
            tempfile::tempfile().map_err(|e| Error::io("cannot create a temporary file", e))?;
        let stderr = messages
            .try_clone()
            .map_err(|e| Error::io("cannot use a temporary file", e))?;
        // The name of the file is never an argument, so ffmpeg cannot take it for an option or an
        // address. PPM, because each of its images has its own size. New times in steps of a frame
        // keep every frame of a video whose rate varies.
        let mut child = Command::new("ffmpeg")
            .args(["-nostdin", "-v", "level+warning"])
            .args(["-i", "file:/proc/self/fd/0"])
            .args([
                "-map",
                "0:v:0",
                "-noautoscale",
                "-vf",
                "setpts=N/(25*TB)",
                "-r",
                "25",
            ])
            .args(["-f", "image2pipe", "-c:v", "ppm", "-"])
            .stdin(file)
            .stdout(Stdio::piped())
            .stderr(stderr)
            .spawn()
            .map_err(|e| ffmpeg_error(e).at(path.display()))?;
        let output = child.stdout.take();
        let output = output.ok_or_else(|| Error::internal("ffmpeg has no output"))?;
        Ok(Self {
            path: path.to_owned(),
            child,
            output: BufReader::new(output),
            messages,
            frames: 0,
            has_failed: false,
        })
    }

    /// Frames that were read.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Ends the reading before the end of the video: ffmpeg is stopped, and damage of the rest is
    /// not looked for.
    ///
    /// # Errors
    /// `Input` where not one frame could be decoded.
    pub fn stop(mut self) -> Result<()> {
        if self.frames == 0 {
            return self.close();
        }
        // ffmpeg may have ended by itself.
        let _ = self.child.kill();
        let cannot = |e| Error::io("cannot wait for ffmpeg", e);
        self.child.wait().map_err(cannot).map(drop)
    }

    /// Waits for ffmpeg; its errors are errors, and its warnings of damaged data.
    ///
    /// # Errors
    /// `Input` where ffmpeg tells damage, or decoded no frame.
    pub fn close(mut self) -> Result<()> {
        drop(self.output);
        let cannot = |e| Error::io("cannot wait for ffmpeg", e);
        let status = self.child.wait().map_err(cannot)?;
        let mut text = String::new();
        self.messages.seek(SeekFrom::Start(0)).map_err(cannot)?;
        let mut bytes = Vec::new();
        self.messages
            .take(MAX_MESSAGE)
            .read_to_end(&mut bytes)
            .map_err(cannot)?;
        text.push_str(String::from_utf8_lossy(&bytes).trim());
        let damage = text.lines().find(|line| tells_damage(line));
        if status.success() && damage.is_none() && self.frames > 0 {
            return Ok(());
        }
        let found = match self.frames {
            0 => "the video has no frame that ffmpeg can decode".to_owned(),
            frames => format!("the video is damaged; ffmpeg decoded {frames} frames"),
        };
        let message = damage.or(text.lines().next()).unwrap_or("no message");
        Err(Error::input(format!("{found}: {message}"))
            .at(self.path.display())
            .remedy(
                "record or copy it again; for a codec that this ffmpeg lacks, install a full build \
                 or convert it elsewhere (`ffmpeg -i VIDEO -c:v ffv1 NEW.mkv`)",
            ))
    }
}

impl Iterator for Video {
    type Item = Result<RgbImage>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let image = read_ppm(&mut self.output)
            .map_err(|e| Error::io("cannot read the video from ffmpeg", e).at(self.path.display()))
            .transpose()?;
        self.has_failed = image.is_err();
        self.frames += usize::from(image.is_ok());
        Some(image)
    }
}

/// Whether a message of ffmpeg is of damage. A file that ends early is only worth a warning to it.
fn tells_damage(line: &str) -> bool {
    let words = ["corrupt", "truncated", "partial file", "conceal"];
    !line.contains("[warning]") || words.iter().any(|word| line.contains(word))
}

/// Explains that ffmpeg cannot be started.
pub fn ffmpeg_error(error: std::io::Error) -> Error {
    if error.kind() != IoKind::NotFound {
        return Error::io("cannot start ffmpeg", error);
    }
    Error::not_found("videos need the program ffmpeg, which is not installed").remedy(
        "install it (`sudo apt install ffmpeg`), or extract the frames on a machine that has it \
         (`ffmpeg -i VIDEO FOLDER/%06d.png`) and give the folder",
    )
}

/// Reads one image of a stream of PPM images; `None` at its end.
fn read_ppm(input: &mut BufReader<ChildStdout>) -> std::io::Result<Option<RgbImage>> {
    let invalid = |what: String| std::io::Error::new(IoKind::InvalidData, what);
    if input.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let mut header = [0_u32; 3];
    let mut line = String::new();
    let mut numbers = Vec::new();
    while numbers.len() < 1 + header.len() {
        line.clear();
        if input.take(64).read_line(&mut line)? == 0 {
            return Err(invalid("the last image is cut off".to_owned()));
        }
        numbers.extend(line.split_whitespace().map(str::to_owned));
    }
    if numbers[0] != "P6" {
        return Err(invalid(format!(
            "expected a PPM image, found `{}`",
            numbers[0]
        )));
    }
    for (value, text) in header.iter_mut().zip(&numbers[1..]) {
        *value = text
            .parse()
            .map_err(|_| invalid(format!("expected a number, found `{text}`")))?;
    }
    let [width, height, maximum] = header;
    let is_valid = |side: u32| (1..=MAX_SIDE).contains(&side);
    if !is_valid(width) || !is_valid(height) || maximum != 255 {
        return Err(invalid(format!(
            "expected 8-bit images, found {width}×{height}×{maximum}"
        )));
    }
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    input.read_exact(&mut pixels)?;
    Ok(RgbImage::from_raw(width, height, pixels))
}
