//! The two LeRobot frames of a grasp.

use std::borrow::Cow;

use image::RgbImage;

use super::super::source::{Grasp, Image};
use super::FRAMES;
use super::features::Features;
use super::tiff;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::Array;
use gripcast_dataset::Stage;
use gripcast_dataset::shard::TableCell;
use gripcast_imaging::{Decoder, DepthImage, Role, decode_png_grey16, encode_png_rgb};

/// Converts grasps to frames.
pub(super) struct Frames {
    features: Features,
    decoder: Decoder,
    /// Placeholder for the depth of the initial frame.
    no_depth: Option<Depth>,
}

/// An encoded colour image and its pixels.
struct Colour {
    bytes: Vec<u8>,
    pixels: RgbImage,
}

/// An encoded depth image and its counts.
#[derive(Clone)]
struct Depth {
    bytes: Vec<u8>,
    counts: DepthImage,
}

/// Decoded images of both frames.
pub(super) struct Images {
    frames: [FrameImages; FRAMES],
    pose: Option<Vec<f64>>,
    p_stable: Option<f64>,
    force: Option<Vec<f64>>,
}

struct FrameImages {
    colour: Vec<Colour>,
    /// Field arrays in the order of the features.
    fields: Vec<Array>,
    depth: Option<Depth>,
}

/// One frame: images and fields, then numbers in the order of the columns.
pub(super) struct FrameRow {
    images: FrameImages,
    numbers: Vec<Vec<f64>>,
    cells: Vec<TableCell<'static>>,
}

impl Images {
    pub(super) fn bytes(&self) -> usize {
        let colour = self.frames.iter().flat_map(|frame| &frame.colour);
        let depth = self.frames.iter().flat_map(|frame| &frame.depth);
        let fields = self.frames.iter().flat_map(|frame| &frame.fields);
        let images = colour
            .map(|c| c.bytes.len())
            .chain(depth.map(|d| d.bytes.len()));
        images
            .chain(fields.map(|array| 4 * array.values().len()))
            .sum()
    }
}

impl FrameRow {
    /// Pixels of the colour cameras.
    pub(super) fn colour(&self) -> impl Iterator<Item = &RgbImage> {
        self.images.colour.iter().map(|colour| &colour.pixels)
    }

    /// Numbers of the columns that are no images.
    pub(super) fn numbers(&self) -> impl Iterator<Item = Cow<'_, [f64]>> {
        let fields = self.images.fields.iter().map(|array| {
            let values = array.values().iter().map(|value| f64::from(*value));
            Cow::Owned(values.collect())
        });
        let others = self.numbers.iter();
        fields.chain(others.map(|numbers| Cow::Borrowed(numbers.as_slice())))
    }

    /// Counts of the depth camera.
    pub(super) fn depth(&self) -> Option<&DepthImage> {
        self.images.depth.as_ref().map(|depth| &depth.counts)
    }

    pub(super) fn into_cells(self) -> Vec<TableCell<'static>> {
        let image = |bytes| TableCell::Image(Cow::Owned(bytes));
        let colour = self.images.colour.into_iter().map(|c| image(c.bytes));
        let depth = self.images.depth.map(|d| image(d.bytes));
        let fields = self.images.fields.into_iter().map(TableCell::Array);
        colour
            .chain(depth)
            .chain(fields)
            .chain(self.cells)
            .collect()
    }
}

impl Frames {
    pub(super) fn new(features: Features) -> Result<Self> {
        let no_depth = features.depth.map(|(width, height)| {
            let counts = DepthImage::new(width, height);
            tiff::encode(&counts).map(|bytes| Depth { bytes, counts })
        });
        Ok(Self {
            decoder: Decoder::new()?,
            no_depth: no_depth.transpose()?,
            features,
        })
    }

    pub(super) fn features(&self) -> &Features {
        &self.features
    }

    /// Decodes the images of both frames.
    ///
    /// # Errors
    /// An image is missing or does not decode.
    pub(super) fn images(&mut self, grasp: &Grasp) -> Result<Images> {
        let [initial, closed] = Stage::ALL;
        let mut first = self.frame(grasp, initial)?;
        first.depth.clone_from(&self.no_depth);
        let mut second = self.frame(grasp, closed)?;
        if self.features.depth.is_some() {
            let image = image_of(grasp, Stage::Grasp, Role::Depth)?;
            let counts = decode_png_grey16(&image.bytes)?;
            second.depth = Some(Depth {
                bytes: tiff::encode(&counts)?,
                counts,
            });
        }
        let record = &grasp.record;
        let pose = self.features.has_pose.then(|| match &record.pose {
            Some(pose) => [&pose.t_m[..], &pose.q_wxyz[..]].concat(),
            None => vec![f64::NAN; 7],
        });
        let p_stable = self.features.has_prediction.then(|| {
            let prediction = record.prediction.as_ref();
            prediction.map_or(f64::NAN, |prediction| prediction.p_stable)
        });
        let force = self.features.has_force.then(|| {
            let gels = [Role::Left, Role::Right].map(|role| record.grasp.force.get(&role));
            let numbers = gels.map(|force| {
                let [x, y] = force.and_then(|f| f.shear_n).unwrap_or([f64::NAN; 2]);
                let normal = force.map_or(f64::NAN, |f| f.normal_n);
                [normal, force.map_or(f64::NAN, |f| f.normal_std_n), x, y]
            });
            numbers.as_flattened().to_vec()
        });
        Ok(Images {
            frames: [first, second],
            pose,
            p_stable,
            force,
        })
    }

    fn frame(&mut self, grasp: &Grasp, stage: Stage) -> Result<FrameImages> {
        let mut colour = Vec::new();
        for (role, _) in &self.features.colour {
            let image = image_of(grasp, stage, *role)?;
            let pixels = self.decoder.stored_image(&image.bytes)?;
            // LeRobot requires three channels.
            let bytes = if image.is_grey {
                encode_png_rgb(&pixels)?
            } else {
                image.bytes.clone()
            };
            colour.push(Colour { bytes, pixels });
        }
        let fields = self.features.fields.iter();
        let fields = fields.map(|field| field.of(&grasp.fields, stage));
        Ok(FrameImages {
            fields: fields.collect::<Result<_>>()?,
            colour,
            depth: None,
        })
    }
}

fn image_of(grasp: &Grasp, stage: Stage, role: Role) -> Result<&Image> {
    grasp.images.get(&(stage, role)).ok_or_else(|| {
        let what = format!("the grasp has no {} frame of {role}", stage.name());
        Error::input(what)
    })
}

/// Builds both frames. `episode` and `task` are the indices of the grasp and of its task.
pub(super) fn rows(
    is_stable: bool,
    episode: usize,
    task: usize,
    images: Images,
) -> [FrameRow; FRAMES] {
    let Images {
        frames: [first, second],
        pose,
        p_stable,
        force,
    } = images;
    let row = |frame: usize, images: FrameImages| {
        let is_last = frame + 1 == FRAMES;
        let succeeds = is_last && is_stable;
        let flags = [is_last, succeeds].map(i64::from);
        let indices = [frame, episode, episode * FRAMES + frame, task].map(|i| i as i64);
        let reward = f64::from(u8::from(succeeds));
        let timestamp = frame as f64;
        let mut cells = Vec::new();
        let mut numbers = Vec::new();
        if let Some(pose) = &pose {
            cells.push(TableCell::Numbers(pose.clone()));
            numbers.push(pose.clone());
        }
        if let Some(p_stable) = p_stable {
            cells.push(TableCell::Number(p_stable));
            numbers.push(vec![p_stable]);
        }
        if let Some(force) = &force {
            // That of the grasp: the gels of the first frame are untouched.
            let of_frame = match is_last {
                true => force.clone(),
                false => vec![f64::NAN; force.len()],
            };
            cells.push(TableCell::Numbers(of_frame.clone()));
            numbers.push(of_frame);
        }
        cells.push(TableCell::Number(reward));
        cells.extend(flags.map(TableCell::Integer));
        cells.push(TableCell::Number(timestamp));
        cells.extend(indices.map(TableCell::Integer));
        let scalars = [reward]
            .into_iter()
            .chain(flags.map(|flag| flag as f64))
            .chain([timestamp])
            .chain(indices.map(|index| index as f64));
        numbers.extend(scalars.map(|number| vec![number]));
        FrameRow {
            images,
            numbers,
            cells,
        }
    };
    [row(0, first), row(1, second)]
}
