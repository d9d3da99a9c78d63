//! Motion of the grasped object in depth images of the wrist camera.

use std::ops::Range;

use glam::{DMat3, DVec3};
use gripcast_base::random::SeedStream;
use gripcast_geometry::WristCamera;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::depth::{Depth, DepthView};

/// Size of the view that is compared, px.
const SIZE: [usize; 2] = [320, 240];
/// Places of the object, m in the gripper frame: |x| and range of y. Between the fingers the first is
/// narrow, as they do not move with the object.
const PLACES_M: [(f64, [f64; 2]); 3] = [
    (5e-3, [-10e-3, 10e-3]),
    (20e-3, [-70e-3, -20e-3]),
    (20e-3, [20e-3, 70e-3]),
];
/// Minimum pixels of a place.
const MIN_PIXELS: [usize; 3] = [25, 40, 40];
/// Range of the object along the approach direction, m from the centre of the gels.
const ALONG_M: [f64; 2] = [-80e-3, 20e-3];
/// Minimum height above the table, m.
const MIN_HEIGHT_M: f64 = 4e-3;
/// Region in which the table is searched for, m: |x|, |y| and range along the approach direction.
const TABLE_HALF_M: [f64; 2] = [0.12, 0.15];
const TABLE_ALONG_M: [f64; 2] = [4e-3, 90e-3];
/// Points and planes that the search tries, and the distance of a point of the plane, m.
const TABLE_POINTS: usize = 2000;
const TABLE_PLANES: usize = 150;
const TABLE_DISTANCE_M: f64 = 1.5e-3;
/// Minimum points, and cosine of the maximum angle between approach direction and the table's normal.
const MIN_TABLE_POINTS: usize = 300;
const MIN_TABLE_COSINE: f64 = 0.7;
/// Minimum cosine of the angle between approach direction and the normal of a surface that shows a
/// drop: a wall along it looks the same after one.
const MIN_FACING: f64 = 0.5;
/// Minimum pixels of a window that a normal is fitted to, and their maximum difference in depth, m.
const MIN_NORMAL_PIXELS: usize = 25;
const MAX_NORMAL_STEP_M: f64 = 4e-3;
/// Half side of the windows of normals and of averaged changes of depth, px, and the minimum fraction
/// of it with a change: depths are noisy and quantised to 1 mm.
const WINDOW_HALF_PX: i64 = 3;
const MIN_WINDOW_FRACTION: f64 = 0.3;
/// Maximum drop, mm; farther the object is gone.
const MAX_DROP_MM: f64 = 25.0;

/// Drop of the object since before the lift at three places: its displacement along the approach
/// direction relative to the gripper, mm, positive where it falls behind while the gripper rises.
/// `None` where too little of the object is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ObjectMotion {
    /// Between the fingers.
    pub between_mm: Option<f64>,
    /// Before the fingers, where the camera is (−y).
    pub front_mm: Option<f64>,
    /// Behind the fingers (+y).
    pub back_mm: Option<f64>,
}

impl ObjectMotion {
    /// Number of values of [`ObjectMotion::to_array`].
    pub const LEN: usize = 3;

    /// No motion where the object is seen.
    pub const NONE: Self = Self {
        between_mm: Some(0.0),
        front_mm: Some(0.0),
        back_mm: Some(0.0),
    };

    /// All drops in the order of the fields; NaN where unknown.
    #[must_use]
    pub fn to_array(self) -> [f64; Self::LEN] {
        [self.between_mm, self.front_mm, self.back_mm].map(|drop_mm| drop_mm.unwrap_or(f64::NAN))
    }

    /// The motion of an array of [`ObjectMotion::to_array`].
    #[must_use]
    pub fn from_array(drops_mm: [f64; Self::LEN]) -> Self {
        let [between_mm, front_mm, back_mm] =
            drops_mm.map(|drop_mm| (!drop_mm.is_nan()).then_some(drop_mm));
        Self {
            between_mm,
            front_mm,
            back_mm,
        }
    }

    /// Smallest, mean and largest known drop, mm; none if all are unknown.
    #[must_use]
    pub fn summary_mm(&self) -> Option<[f64; 3]> {
        let known = self
            .to_array()
            .into_iter()
            .filter(|drop_mm| !drop_mm.is_nan());
        let count = known.clone().count();
        (count > 0).then(|| {
            let low = known.clone().fold(f64::INFINITY, f64::min);
            let high = known.clone().fold(f64::NEG_INFINITY, f64::max);
            [low, known.sum::<f64>() / count as f64, high]
        })
    }
}

/// Follows the object between the fingers.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectTracker {
    /// Pixels of the object before the lift.
    pixels: Vec<ObjectPixel>,
}

/// A pixel of the object.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ObjectPixel {
    column: usize,
    row: usize,
    /// Place, or none beside all of them, where depths only serve averages.
    place: Option<usize>,
    depth_m: f64,
    /// Motion along the approach direction for a change of depth of 1, of a surface that it meets
    /// at a right angle.
    along: f64,
}

impl ObjectTracker {
    /// The object in a depth image of the closed gripper; none if too little of it is seen.
    #[must_use]
    pub fn new(depth: &Depth, view: DepthView) -> Option<Self> {
        let depths_m = depths(depth, view);
        let seen: Vec<(ObjectPixel, DVec3)> = points(&depths_m).collect();
        let table = table(seen.iter().map(|(_, point)| *point));
        let is_above = |point: &DVec3| {
            let height_m = table.map(|(normal, offset)| offset - normal.dot(*point));
            height_m.is_none_or(|height_m| height_m > MIN_HEIGHT_M)
        };
        let object = seen
            .into_iter()
            .filter(|(_, point)| (ALONG_M[0]..=ALONG_M[1]).contains(&point.z) && is_above(point));
        let pixels = object.map(|(pixel, point)| {
            let place = PLACES_M.iter().position(|(half_width_m, [low, high])| {
                point.x.abs() <= *half_width_m && (*low..=*high).contains(&point.y)
            });
            ObjectPixel {
                place: place.filter(|_| facing(&depths_m, &pixel) >= MIN_FACING),
                ..pixel
            }
        });
        let tracker = Self {
            pixels: pixels.collect(),
        };
        let is_seen = |place: usize| {
            let pixels = tracker.pixels.iter().filter(|p| p.place == Some(place));
            pixels.count() >= MIN_PIXELS[place]
        };
        (0..PLACES_M.len()).any(is_seen).then_some(tracker)
    }

    /// Rows of the 320×240 view in which depths are compared.
    #[must_use]
    pub fn rows(&self) -> Range<usize> {
        let rows = self.pixels.iter().map(|pixel| pixel.row);
        let first = rows.clone().min().unwrap_or_default();
        first..rows.max().map_or(first, |last| last + 1)
    }

    /// Motion of the object in a later depth image; none if too little of it is seen, as when it is
    /// gone.
    #[must_use]
    pub fn motion(&self, depth: &Depth, view: DepthView) -> Option<ObjectMotion> {
        let depths_m = depths(depth, view);
        let [width, height] = SIZE;
        let mut changes_mm = vec![f64::NAN; width * height];
        for pixel in &self.pixels {
            let index = pixel.row * width + pixel.column;
            let now_m = depths_m[index];
            let change_mm = 1e3 * (now_m - pixel.depth_m) * pixel.along;
            if now_m > 0.0 && change_mm.abs() <= MAX_DROP_MM {
                changes_mm[index] = change_mm;
            }
        }
        let mut found: [Vec<f64>; PLACES_M.len()] = Default::default();
        for pixel in &self.pixels {
            if let (Some(place), Some(change_mm)) = (pixel.place, window_mean(&changes_mm, pixel)) {
                found[place].push(change_mm);
            }
        }
        let mut place = 0;
        let drops_mm = found.map(|mut changes_mm| {
            let is_seen = changes_mm.len() >= MIN_PIXELS[place];
            place += 1;
            changes_mm.sort_by(f64::total_cmp);
            let median = changes_mm.get(changes_mm.len() / 2).copied();
            median.filter(|_| is_seen).unwrap_or(f64::NAN)
        });
        let is_seen = drops_mm.iter().any(|drop_mm| !drop_mm.is_nan());
        is_seen.then(|| ObjectMotion::from_array(drops_mm))
    }
}

fn depths(depth: &Depth, view: DepthView) -> Vec<f64> {
    let [width, height] = SIZE;
    depth.in_colour_image(view, width, height)
}

/// Mean of the known changes around a pixel; none if few are known.
fn window_mean(changes_mm: &[f64], pixel: &ObjectPixel) -> Option<f64> {
    let [width, height] = SIZE.map(|side| side as i64);
    let half = WINDOW_HALF_PX;
    let (column, row) = (pixel.column as i64, pixel.row as i64);
    let rows = (row - half).max(0)..=(row + half).min(height - 1);
    let columns = (column - half).max(0)..=(column + half).min(width - 1);
    let (mut sum, mut count) = (0.0, 0);
    for row in rows {
        for column in columns.clone() {
            let change_mm = changes_mm[(row * width + column) as usize];
            if !change_mm.is_nan() {
                sum += change_mm;
                count += 1;
            }
        }
    }
    let all = f64::from((2 * half as i32 + 1).pow(2));
    (f64::from(count) >= MIN_WINDOW_FRACTION * all).then(|| sum / f64::from(count))
}

/// Cosine of the angle between the approach direction and the normal of the plane through the
/// surroundings of a pixel; 0 where it is not known.
fn facing(depths_m: &[f64], pixel: &ObjectPixel) -> f64 {
    let [width, height] = SIZE.map(|side| side as i64);
    let offsets = -WINDOW_HALF_PX..=WINDOW_HALF_PX;
    let mut known = 0;
    // Normal equations of the depth over column, row and 1.
    let (mut matrix, mut vector) = (DMat3::ZERO, DVec3::ZERO);
    for dy in offsets.clone() {
        for dx in offsets.clone() {
            let (column, row) = (pixel.column as i64 + dx, pixel.row as i64 + dy);
            if !(0..width).contains(&column) || !(0..height).contains(&row) {
                continue;
            }
            let depth_m = depths_m[(row * width + column) as usize];
            if depth_m > 0.0 && (depth_m - pixel.depth_m).abs() <= MAX_NORMAL_STEP_M {
                let at = DVec3::new(dx as f64, dy as f64, 1.0);
                for axis in 0..3 {
                    *matrix.col_mut(axis) += at[axis] * at;
                }
                vector += depth_m * at;
                known += 1;
            }
        }
    }
    if known < MIN_NORMAL_PIXELS {
        return 0.0;
    }
    let plane = matrix.inverse() * vector;
    // z (u, v) has the normal (-gx, -gy, 1 + u gx + v gy) with g = f · dz / z.
    let focal = WristCamera::focal_px(SIZE[0], SIZE[1]);
    let [gx, gy] = [plane.x, plane.y].map(|slope| focal * slope / plane.z);
    let [u, v] = [(pixel.column, SIZE[0]), (pixel.row, SIZE[1])]
        .map(|(at, side)| (at as f64 - 0.5 * (side as f64 - 1.0)) / focal);
    let normal = DVec3::new(-gx, -gy, 1.0 + u * gx + v * gy).normalize_or_zero();
    let axes = WristCamera::t_gripper_camera().rotation_matrix();
    (axes * normal).z.abs()
}

/// Pixels with a depth, and their points in the gripper frame.
fn points(depths_m: &[f64]) -> impl Iterator<Item = (ObjectPixel, DVec3)> + use<'_> {
    let [width, height] = SIZE;
    let focal = WristCamera::focal_px(width, height);
    let centre = SIZE.map(|side| 0.5 * (side as f64 - 1.0));
    let pose = WristCamera::t_gripper_camera();
    let axes = pose.rotation_matrix();
    let seen = depths_m.iter().enumerate().filter(|(_, z)| **z > 0.0);
    seen.map(move |(index, z)| {
        let (column, row) = (index % width, index / width);
        let [u, v] = [column as f64 - centre[0], row as f64 - centre[1]].map(|at| at / focal);
        let direction = axes * DVec3::new(u, v, 1.0);
        let pixel = ObjectPixel {
            column,
            row,
            place: None,
            depth_m: *z,
            along: direction.z,
        };
        (pixel, pose.translation_m + *z * direction)
    })
}

/// Normal and offset of the plane of the table, gripper frame: that of the most points below the
/// gels (Fischler and Bolles, 1981). None if there is none.
fn table(points: impl Iterator<Item = DVec3>) -> Option<(DVec3, f64)> {
    let is_near = |point: &DVec3| {
        point.x.abs() < TABLE_HALF_M[0]
            && point.y.abs() < TABLE_HALF_M[1]
            && (TABLE_ALONG_M[0]..TABLE_ALONG_M[1]).contains(&point.z)
    };
    let points: Vec<DVec3> = points.filter(is_near).collect();
    if points.len() < MIN_TABLE_POINTS {
        return None;
    }
    let stride = points.len().div_ceil(TABLE_POINTS);
    let points: Vec<DVec3> = points.into_iter().step_by(stride).collect();
    let mut draw = SeedStream::named(0, "table");
    let planes = (0..TABLE_PLANES).filter_map(|_| {
        let [a, b, c] = [0; 3].map(|_| points[draw.index(points.len())]);
        let normal = (b - a).cross(c - a).try_normalize()?;
        let normal = normal * normal.z.signum();
        let offset = normal.dot(a);
        let is_level = normal.z >= MIN_TABLE_COSINE;
        is_level.then(|| {
            let on_it = |point: &&DVec3| (normal.dot(**point) - offset).abs() < TABLE_DISTANCE_M;
            (points.iter().filter(on_it).count(), normal, offset)
        })
    });
    let best = planes.max_by_key(|(count, _, _)| *count);
    best.map(|(_, normal, offset)| (normal, offset))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DepthImage;

    /// A bar across the fingers whose top is 5 mm above the centre of the gels, dropped and tilted
    /// about the closing axis, on a table that is `lifted_m` lower than 14 mm below the centre; codes
    /// of `unit_m`.
    fn bar(drop_mm: f64, tilt_rad: f64, lifted_m: f64, unit_m: f64) -> Depth {
        let [width, height] = SIZE;
        let focal = WristCamera::focal_px(width, height);
        let pose = WristCamera::t_gripper_camera();
        let (half, table) = (DVec3::new(0.015, 0.05, 0.0095), 0.014 + lifted_m);
        let rotation = DMat3::from_rotation_x(tilt_rad);
        let centre = DVec3::new(0.0, 0.0, half.z - 0.005 + 1e-3 * drop_mm);
        let codes = DepthImage::from_fn(width as u32, height as u32, |column, row| {
            let u = (f64::from(column) - 159.5) / focal;
            let v = (f64::from(row) - 119.5) / focal;
            let ray = pose.rotation_matrix() * DVec3::new(u, v, 1.0);
            let eye = pose.translation_m;
            let [o, d] = [eye - centre, ray].map(|v| rotation.transpose() * v);
            let ends = [-half, half].map(|corner| (corner - o) / d);
            let near = ends[0].min(ends[1]).max_element();
            let far = ends[0].max(ends[1]).min_element();
            let depth = match near <= far {
                true => near,
                false => (table - eye.z) / ray.z,
            };
            image::Luma([(depth / unit_m).round() as u16])
        });
        Depth {
            image: codes,
            unit_m,
        }
    }

    #[test]
    fn drop_and_tilt_of_a_bar_are_measured() {
        let view = DepthView::Colour;
        for unit_m in [1e-3, 1e-4] {
            let tracker = ObjectTracker::new(&bar(0.0, 0.0, 0.0, unit_m), view).unwrap();
            for (drop_mm, tilt_rad) in [(0.0, 0.0), (0.4, 0.0), (2.0, 0.0), (9.0, 0.0), (0.0, 0.05)]
            {
                // The gripper has risen, so that the table is farther.
                let now = bar(drop_mm, tilt_rad, 0.01, unit_m);
                let found = tracker.motion(&now, view).unwrap();
                let end_mm = 35.0 * tilt_rad;
                let expected = [drop_mm, drop_mm - end_mm, drop_mm + end_mm];
                for (found, expected) in found.to_array().into_iter().zip(expected) {
                    let error = (found - expected).abs();
                    assert!(error < 0.15 + 0.3 * end_mm, "{found} {expected}");
                }
            }
        }
    }

    #[test]
    fn object_that_is_gone_or_not_seen_has_no_motion() {
        let view = DepthView::Colour;
        let held = bar(0.0, 0.0, 0.0, 1e-3);
        let tracker = ObjectTracker::new(&held, view).unwrap();
        assert_eq!(tracker.motion(&bar(200.0, 0.0, 0.2, 1e-3), view), None);
        let nothing = Depth {
            image: DepthImage::new(320, 240),
            unit_m: 1e-3,
        };
        assert_eq!(tracker.motion(&nothing, view), None);
        // The table is not the object.
        for unseen in [nothing, bar(200.0, 0.0, 0.0, 1e-3)] {
            assert_eq!(ObjectTracker::new(&unseen, view), None);
        }
    }

    #[test]
    fn wall_along_the_approach_direction_shows_no_drop() {
        let view = DepthView::Colour;
        let [width, height] = SIZE;
        let focal = WristCamera::focal_px(width, height);
        let pose = WristCamera::t_gripper_camera();
        // The side of a tall object 25 mm before the gels; its top is too near to be seen.
        let codes = DepthImage::from_fn(width as u32, height as u32, |column, row| {
            let u = (f64::from(column) - 159.5) / focal;
            let v = (f64::from(row) - 119.5) / focal;
            let ray = pose.rotation_matrix() * DVec3::new(u, v, 1.0);
            let depth = (-0.025 - pose.translation_m.y) / ray.y;
            let point = pose.translation_m + depth * ray;
            let is_side = depth > 0.0 && point.x.abs() < 0.02 && (-0.05..0.014).contains(&point.z);
            image::Luma([if is_side {
                (depth * 1e3).round() as u16
            } else {
                0
            }])
        });
        assert!(codes.iter().filter(|code| **code > 0).count() > 1000);
        let side = Depth {
            image: codes,
            unit_m: 1e-3,
        };
        assert_eq!(ObjectTracker::new(&side, view), None);
    }

    #[test]
    fn values_are_read_back_and_summarised() {
        let motion = ObjectMotion {
            between_mm: Some(0.5),
            front_mm: None,
            back_mm: Some(2.5),
        };
        assert_eq!(ObjectMotion::from_array(motion.to_array()), motion);
        assert_eq!(motion.summary_mm(), Some([0.5, 1.5, 2.5]));
        assert_eq!(ObjectMotion::default().summary_mm(), None);
    }
}
