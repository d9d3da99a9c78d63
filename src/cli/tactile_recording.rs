//! The frames of a tactile recording: a video, a folder of images, or a grasp of a dataset.

use std::cmp::Ordering;
use std::fs::File;
use std::io::{BufRead as _, BufReader, ErrorKind as IoKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::vec::IntoIter;

use image::RgbImage;

use super::image_folder::{file_name, images};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, GraspId, read_regular};
use gripcast_dataset::{Dataset, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role, crop_and_resize};

/// Maximum width and height of a frame, px.
const MAX_SIDE: u32 = 8192;
/// Size of a cropped image, px.
const CROPPED: [u32; 2] = [320, 240];
/// Maximum length of what ffmpeg says that is repeated, bytes.
const MAX_MESSAGE: u64 = 2000;

/// One frame: its name, and its image or why there is none.
pub(super) type NamedFrame = (String, Result<RgbImage>);

/// Reads the frames of a recording one after the other.
pub(super) struct Recording {
    frames: Frames,
    crop: Option<CropProfile>,
}

enum Frames {
    Folder(Decoder, IntoIter<PathBuf>),
    Grasp(IntoIter<NamedFrame>),
    Video(Video),
}

impl Recording {
    /// Opens a recording; `role` chooses the sensor of a grasp.
    ///
    /// # Errors
    /// `NotFound`, `Input`: nothing there that could be tracked, or no ffmpeg for a video.
    pub(super) fn open(path: &Path, role: Role, crop: Option<CropProfile>) -> Result<Self> {
        let frames = if !path.is_dir() {
            Frames::Video(Video::open(path)?)
        } else if path.join("grasp.json").is_file() {
            Frames::Grasp(frames_of_grasp(path, role)?.into_iter())
        } else {
            let mut files = images(path)?;
            files.sort_by(|a, b| natural_order(&file_name(a), &file_name(b)));
            Frames::Folder(Decoder::new()?, files.into_iter())
        };
        Ok(Self { frames, crop })
    }

    /// Number of frames that are left, where it is known.
    pub(super) fn left(&self) -> Option<usize> {
        match &self.frames {
            Frames::Folder(_, files) => Some(files.len()),
            Frames::Grasp(frames) => Some(frames.len()),
            Frames::Video(_) => None,
        }
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// `Input` where the decoder of a video reports damage.
    pub(super) fn close(self) -> Result<()> {
        match self.frames {
            Frames::Video(video) => video.close(),
            Frames::Folder(..) | Frames::Grasp(_) => Ok(()),
        }
    }
}

impl Iterator for Recording {
    type Item = NamedFrame;

    fn next(&mut self) -> Option<NamedFrame> {
        let (name, image) = match &mut self.frames {
            Frames::Folder(decoder, files) => {
                let path = files.next()?;
                (file_name(&path), read_image(decoder, &path))
            }
            Frames::Grasp(frames) => return frames.next(),
            Frames::Video(video) => video.next()?,
        };
        let image = image.and_then(|image| cropped(image, self.crop.as_ref()));
        Some((name, image))
    }
}

/// Reads the image file of an untouched gel.
///
/// # Errors
/// `Io`; `Input` for an invalid image.
pub(super) fn initial_image(path: &Path, crop: Option<&CropProfile>) -> Result<RgbImage> {
    cropped(read_image(&mut Decoder::new()?, path)?, crop)
}

fn read_image(decoder: &mut Decoder, path: &Path) -> Result<RgbImage> {
    let bytes = read_regular(path, FileKind::Image)
        .map_err(|e| Error::io("cannot read the image", e).at(path.display()))?;
    decoder
        .stored_image(&bytes)
        .map_err(|e| e.at(path.display()))
}

fn cropped(image: RgbImage, crop: Option<&CropProfile>) -> Result<RgbImage> {
    let Some(crop) = crop else { return Ok(image) };
    Ok(crop_and_resize(&image, crop, CROPPED[0], CROPPED[1])?)
}

/// Both stages of a grasp, cropped as they were recorded.
fn frames_of_grasp(folder: &Path, role: Role) -> Result<Vec<NamedFrame>> {
    let not_in_dataset = || {
        Error::input("the folder has a grasp.json, but is not in a dataset")
            .at(folder.display())
            .remedy("give the folder grasps/ID inside its dataset")
    };
    let folder = folder
        .canonicalize()
        .map_err(|e| Error::io("cannot open the grasp", e).at(folder.display()))?;
    let root = folder
        .parent()
        .and_then(Path::parent)
        .ok_or_else(not_in_dataset)?;
    let dataset = Dataset::open(root)?;
    let id = GraspId::parse(&file_name(&folder)).map_err(|_| not_in_dataset())?;
    let record = dataset.grasp(&id)?;
    let mut decoder = Decoder::new()?;
    let mut frames = Vec::new();
    for stage in Stage::ALL {
        let image = dataset.tactile_image(&mut decoder, &record, stage, role);
        // A damaged image can be left out; without any there is nothing to track.
        let image = match image {
            Err(error) if error.kind() != ErrorKind::Input => return Err(error),
            image => image,
        };
        frames.push((stage.name().to_owned(), image));
    }
    Ok(frames)
}

/// Orders names as people do: numbers in them by their value.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a, b);
    loop {
        let (Some(first), Some(second)) = (next_run(&mut a_rest), next_run(&mut b_rest)) else {
            return a_rest.len().cmp(&b_rest.len()).then(a.cmp(b));
        };
        let is_number = |run: &str| run.starts_with(|c: char| c.is_ascii_digit());
        let order = if is_number(first) && is_number(second) {
            let [first, second] = [first, second].map(|run| run.trim_start_matches('0'));
            first.len().cmp(&second.len()).then(first.cmp(second))
        } else {
            first.cmp(second)
        };
        if order.is_ne() {
            return order;
        }
    }
}

/// Takes a run of digits, or of other characters, from the beginning of a name.
fn next_run<'a>(rest: &mut &'a str) -> Option<&'a str> {
    let is_digit = rest.starts_with(|c: char| c.is_ascii_digit());
    let end = rest
        .find(|c: char| c.is_ascii_digit() != is_digit)
        .unwrap_or(rest.len());
    let (run, after) = rest.split_at(end);
    *rest = after;
    (!run.is_empty()).then_some(run)
}

/// A video, decoded by the system's ffmpeg.
struct Video {
    path: PathBuf,
    child: Child,
    output: BufReader<ChildStdout>,
    messages: File,
    frames: usize,
    has_failed: bool,
}

impl Video {
    fn open(path: &Path) -> Result<Self> {
        File::open(path)
            .map_err(|e| Error::io("cannot open the recording", e).at(path.display()))?;
        let messages =
            tempfile::tempfile().map_err(|e| Error::io("cannot create a temporary file", e))?;
        let stderr = messages
            .try_clone()
            .map_err(|e| Error::io("cannot use a temporary file", e))?;
        // PPM, because each of its images has its own size. New times in steps of a frame keep
        // every frame of a video whose rate varies.
        let mut child = Command::new("ffmpeg")
            .args(["-nostdin", "-v", "level+warning", "-i"])
            .arg(path)
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
            .stdin(Stdio::null())
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

    fn next(&mut self) -> Option<NamedFrame> {
        if self.has_failed {
            return None;
        }
        let image = read_ppm(&mut self.output)
            .map_err(|e| Error::io("cannot read the video from ffmpeg", e).at(self.path.display()))
            .transpose()?;
        self.has_failed = image.is_err();
        self.frames += 1;
        Some((self.frames.saturating_sub(1).to_string(), image))
    }

    /// Waits for ffmpeg; its errors are errors, and its warnings of damaged data.
    fn close(mut self) -> Result<()> {
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
            .remedy("record or copy it again, or extract its frames to a folder and give that"))
    }
}

/// Whether a message of ffmpeg is of damage. A file that ends early is only worth a warning to it.
fn tells_damage(line: &str) -> bool {
    let words = ["corrupt", "truncated", "partial file", "conceal"];
    !line.contains("[warning]") || words.iter().any(|word| line.contains(word))
}

/// Explains that ffmpeg cannot be started.
pub(super) fn ffmpeg_error(error: std::io::Error) -> Error {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_are_ordered_by_value() {
        let mut names = [
            "f10.png", "f9.png", "f009.png", "a2b3", "a2b20", "a10", "f1.png",
        ];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(
            names,
            [
                "a2b3", "a2b20", "a10", "f1.png", "f009.png", "f9.png", "f10.png"
            ]
        );
    }
}
