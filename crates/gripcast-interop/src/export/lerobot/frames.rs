//! The LeRobot frames of a grasp.

use std::borrow::Cow;

use image::RgbImage;

use super::super::selection::opening_m;
use super::super::source::{Grasp, Image};
use super::PAIR;
use super::features::Features;
use super::sequences::{Moment, Sequence};
use super::ticks::Phase;
use super::tiff;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::npy::Array;
use gripcast_dataset::shard::TableCell;
use gripcast_dataset::{GraspRecord, Stage};
use gripcast_imaging::{
    Decoder, DepthImage, Frame, PixelFormat, Role, decode_png_grey16, encode_png_rgb, jpeg,
};
use gripcast_shear::FingerForce;

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
    frames: [FrameImages; PAIR],
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
    cells: Vec<TableCell<'static>>,
}

/// Place of a frame in its episode and in the dataset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Index in the episode.
    pub(super) frame: usize,
    /// Index of the grasp.
    pub(super) episode: usize,
    /// Index in the dataset.
    pub(super) index: usize,
    /// Index of the task.
    pub(super) task: usize,
    /// Time since the first frame of the episode, s.
    pub(super) timestamp_s: f64,
    pub(super) is_last: bool,
    /// Whether the grasp is stable.
    pub(super) is_stable: bool,
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
        let others = self.cells.iter().map(|cell| match cell {
            TableCell::Numbers(numbers) => Cow::Borrowed(numbers.as_slice()),
            TableCell::Number(number) => Cow::Owned(vec![*number]),
            TableCell::Integer(number) => Cow::Owned(vec![*number as f64]),
            _ => Cow::Owned(Vec::new()),
        });
        fields.chain(others)
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
        Ok(Images {
            frames: [first, second],
        })
    }

    /// Both frames of a grasp; `first` is the place of the first.
    pub(super) fn pair(
        &self,
        record: &GraspRecord,
        images: Images,
        first: Place,
    ) -> [FrameRow; PAIR] {
        let row = |frame: usize, images: FrameImages| {
            let is_grasp = frame + 1 == PAIR;
            let place = Place {
                frame,
                index: first.index + frame,
                timestamp_s: frame as f64,
                is_last: is_grasp,
                ..first
            };
            let mut cells = Vec::new();
            // Pose and prediction are of the grasp as a whole.
            self.push_grasp(&mut cells, record, true);
            // The gels of the first frame are untouched.
            let force = |role| record.grasp.force.get(&role).filter(|_| is_grasp);
            self.push_force(&mut cells, force);
            cells.extend(place.cells());
            FrameRow { images, cells }
        };
        let [initial, grasp] = images.frames;
        [row(0, initial), row(1, grasp)]
    }

    /// A frame of a sequence.
    ///
    /// # Errors
    /// An image does not decode, `Internal`: it cannot be encoded.
    pub(super) fn of_moment(
        &mut self,
        grasp: &Grasp,
        sequence: &Sequence,
        moment: &Moment<'_>,
        place: Place,
    ) -> Result<FrameRow> {
        let record = &grasp.record;
        let (mut colour, mut depth) = (Vec::new(), None);
        for (role, frame) in sequence.roles.iter().zip(&moment.frames) {
            match role {
                Role::Depth => {
                    let counts = self.decoder.depth(frame)?;
                    let bytes = tiff::encode(&counts)?;
                    depth = Some(Depth { bytes, counts });
                }
                _ => colour.push(self.colour(frame)?),
            }
        }
        let time_of = |role: Role| {
            let at = sequence.roles.iter().position(|of| *of == role)?;
            moment.tick.frames_ns.get(at).copied()
        };
        let shear = |role: Role| sequence.shear(role, time_of(role)?);
        let fields = self.features.fields.iter().map(|field| {
            let role = field.key.0;
            // The stored frames have what was stored with them.
            let stored = record.stages().into_iter().find(|(stage, frames)| {
                let key = (*stage, role, field.key.1.clone());
                let camera = frames.cameras.get(&role);
                camera.map(|camera| camera.driver_time_ns) == time_of(role)
                    && grasp.fields.contains_key(&key)
            });
            if let Some((stage, _)) = stored {
                return field.of(&grasp.fields, stage);
            }
            let markers = shear(role).and_then(|shear| shear.markers.as_ref());
            let markers = markers.filter(|markers| markers.shape == field.shape);
            let count = field.shape.iter().product();
            let values = match markers {
                Some(markers) => {
                    let values = markers.values.iter();
                    values.map(|value| value.unwrap_or(f32::NAN)).collect()
                }
                None => vec![f32::NAN; count],
            };
            Array::new(field.shape.clone(), values)
        });
        let images = FrameImages {
            fields: fields.collect::<Result<_>>()?,
            colour,
            depth,
        };
        let is_grasp = moment.tick.phase == Phase::Grasp;
        let mut cells = Vec::new();
        if self.features.sequence.is_some_and(|s| s.has_action) {
            let opening = opening_m(record).filter(|_| is_grasp);
            cells.push(TableCell::Number(opening.unwrap_or(f64::NAN)));
        }
        let times = moment.tick.frames_ns.iter();
        let times = times.map(|time| i64::try_from(*time).unwrap_or(i64::MAX));
        cells.extend(
            times
                .chain([moment.tick.phase.number()])
                .map(TableCell::Integer),
        );
        self.push_grasp(&mut cells, record, is_grasp);
        self.push_force(&mut cells, |role| match is_grasp {
            true => record.grasp.force.get(&role),
            false => shear(role)?.force.as_ref(),
        });
        cells.extend(place.cells());
        Ok(FrameRow { images, cells })
    }

    /// A frame of a colour camera, encoded as it is stored.
    fn colour(&mut self, frame: &Frame) -> Result<Colour> {
        if frame.format == PixelFormat::Mjpg {
            let (file, _) = jpeg::whole_file(&frame.data)?;
            let pixels = self.decoder.stored_image(&file)?;
            // LeRobot requires three channels.
            let bytes = match jpeg::inspect(&file)?.components {
                1 => encode_png_rgb(&pixels)?,
                _ => file.into_owned(),
            };
            return Ok(Colour { bytes, pixels });
        }
        let pixels = self.decoder.decode_full(frame)?;
        let bytes = encode_png_rgb(&pixels)?;
        Ok(Colour { bytes, pixels })
    }

    /// Adds pose and prediction; NaN where `has` is false or the grasp has none.
    fn push_grasp(&self, cells: &mut Vec<TableCell<'static>>, record: &GraspRecord, has: bool) {
        if self.features.has_pose {
            let pose = record.pose.as_ref().filter(|_| has);
            cells.push(TableCell::Numbers(match pose {
                Some(pose) => [&pose.t_m[..], &pose.q_wxyz[..]].concat(),
                None => vec![f64::NAN; 7],
            }));
        }
        if self.features.has_prediction {
            let prediction = record.prediction.as_ref().filter(|_| has);
            let p_stable = prediction.map_or(f64::NAN, |prediction| prediction.p_stable);
            cells.push(TableCell::Number(p_stable));
        }
    }

    /// Adds the forces of both gels; NaN where there is none.
    fn push_force<'f>(
        &self,
        cells: &mut Vec<TableCell<'static>>,
        force: impl Fn(Role) -> Option<&'f FingerForce>,
    ) {
        if self.features.has_force {
            let numbers = [Role::Left, Role::Right].map(|role| {
                let force = force(role);
                let [x, y] = force.and_then(|f| f.shear_n).unwrap_or([f64::NAN; 2]);
                let normal = force.map_or(f64::NAN, |f| f.normal_n);
                [normal, force.map_or(f64::NAN, |f| f.normal_std_n), x, y]
            });
            cells.push(TableCell::Numbers(numbers.as_flattened().to_vec()));
        }
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

impl Place {
    /// Cells of the features of every frame, in the order of [`ALWAYS`](super::features::ALWAYS).
    fn cells(self) -> impl Iterator<Item = TableCell<'static>> {
        let succeeds = self.is_last && self.is_stable;
        let reward = TableCell::Number(f64::from(u8::from(succeeds)));
        let flags = [self.is_last, succeeds].map(i64::from);
        let indices = [self.frame, self.episode, self.index, self.task].map(|i| i as i64);
        [reward]
            .into_iter()
            .chain(flags.map(TableCell::Integer))
            .chain([TableCell::Number(self.timestamp_s)])
            .chain(indices.map(TableCell::Integer))
    }
}
