//! The frames of a tactile recording: a video, a folder of images, or a grasp of a dataset.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};
use std::vec::IntoIter;

use image::RgbImage;

use super::image_folder::{file_name, images};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, GraspId, read_regular};
use gripcast_dataset::{Dataset, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role, crop_and_resize};
use gripcast_interop::video::Video;

/// Size of a cropped image, px.
const CROPPED: [u32; 2] = [320, 240];

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
            Frames::Video(video) => {
                let number = video.frames();
                (number.to_string(), video.next()?)
            }
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
