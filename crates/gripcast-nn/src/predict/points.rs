//! Depth images as points in the gripper frame.

use gripcast_geometry::WristCamera;
use gripcast_imaging::DepthImage;

use super::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};

const WIDTH: usize = IMAGE_WIDTH as usize;
const HEIGHT: usize = IMAGE_HEIGHT as usize;
/// Unit of x and y, m.
const UNIT_M: f64 = 0.1;
/// Depth with an inverse depth of 1, m.
const NEAR_M: f64 = 0.2;
/// Maximum |x| and |y|, units: the background is of no interest.
const MAX: f64 = 2.0;
/// Code of a depth beyond the range of the camera.
const OUT_OF_RANGE: u16 = u16::MAX;

/// A depth image.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth {
    /// Depth codes; 0 and 65,535 are unknown.
    pub image: DepthImage,
    /// Depth of one code, m.
    pub unit_m: f64,
}

/// Points of a depth image that is aligned to the colour image: x and y in the gripper frame and
/// the inverse depth of each pixel of a 320×240 image of the [`WristCamera`] at its nominal mount,
/// row-major; zeros without depth.
///
/// The image is resampled to its centre crop of 4:3 by the nearest pixel, as mixing depths across
/// an edge would make points that do not exist.
#[derive(Clone, Debug)]
pub struct PointMap(Vec<[f32; 3]>);

impl PointMap {
    /// Converts a depth image.
    pub fn new(depth: &Depth) -> Self {
        let (width, height) = depth.image.dimensions();
        if width == 0 || height == 0 {
            return Self(vec![[0.0; 3]; WIDTH * HEIGHT]);
        }
        let scale = (f64::from(width) / WIDTH as f64).min(f64::from(height) / HEIGHT as f64);
        let nearest = |side: u32, all: usize, at: usize| {
            let position = 0.5 * f64::from(side) + (at as f64 + 0.5 - 0.5 * all as f64) * scale;
            (position as u32).min(side - 1)
        };
        let columns: Vec<u32> = (0..WIDTH).map(|x| nearest(width, WIDTH, x)).collect();
        let pose = WristCamera::t_gripper_camera();
        let rotation = pose.rotation_matrix();
        let focal = WristCamera::focal_px(WIDTH, HEIGHT);
        let centre = [WIDTH, HEIGHT].map(|side| 0.5 * (side as f64 - 1.0));
        let mut points = Vec::with_capacity(WIDTH * HEIGHT);
        for y in 0..HEIGHT {
            let row = nearest(height, HEIGHT, y);
            let v = (y as f64 - centre[1]) / focal;
            for (x, column) in columns.iter().enumerate() {
                let code = depth.image.get_pixel(*column, row)[0];
                let z = f64::from(code) * depth.unit_m;
                if matches!(code, 0 | OUT_OF_RANGE) || z <= 0.0 {
                    points.push([0.0; 3]);
                    continue;
                }
                let u = (x as f64 - centre[0]) / focal;
                let at = |axis: usize| {
                    let direction = rotation.row(axis);
                    let along = direction.x * u + direction.y * v + direction.z;
                    let position = pose.translation_m[axis] + z * along;
                    (position / UNIT_M).clamp(-MAX, MAX) as f32
                };
                points.push([at(0), at(1), (NEAR_M / z) as f32]);
            }
        }
        Self(points)
    }

    /// The points, row-major.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.0
    }

    /// Writes the points as planes x, y, inverse depth.
    pub(super) fn write_planes(&self, planes: &mut [f32]) {
        for (axis, plane) in planes.chunks_exact_mut(WIDTH * HEIGHT).enumerate() {
            for (value, point) in plane.iter_mut().zip(&self.0) {
                *value = point[axis];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    #[test]
    fn pixel_is_the_point_that_the_camera_sees_there() {
        let point = glam::DVec3::new(0.02, 0.005, -0.01);
        let camera = WristCamera::t_gripper_camera().inverse();
        let depth_mm = camera.transform_point(point).z * 1e3;
        for (width, height) in [(320, 240), (1280, 720), (640, 480)] {
            let [x, y] = WristCamera::project(point, width, height).unwrap();
            let mut image = DepthImage::new(width as u32, height as u32);
            for dy in -3..=3 {
                for dx in -3..=3 {
                    let (x, y) = (x.round() as i32 + dx, y.round() as i32 + dy);
                    image.put_pixel(x as u32, y as u32, Luma([(depth_mm * 10.0) as u16]));
                }
            }
            let map = PointMap::new(&Depth {
                image,
                unit_m: 1e-4,
            });
            let [x, y] = WristCamera::project(point, WIDTH, HEIGHT).unwrap();
            let index = y.round() as usize * WIDTH + x.round() as usize;
            let [px, py, inverse] = map.points()[index];
            // A pixel is 0.6 mm.
            assert!((f64::from(px) - 0.2).abs() < 0.01, "{width} {px}");
            assert!((f64::from(py) - 0.05).abs() < 0.01, "{width} {py}");
            assert!((f64::from(inverse) - 200.0 / depth_mm).abs() < 1e-3);
            assert_eq!(map.points()[0], [0.0; 3]);
        }
    }

    #[test]
    fn unknown_depths_are_zeros() {
        for code in [0, u16::MAX] {
            let image = DepthImage::from_pixel(640, 480, Luma([code]));
            let map = PointMap::new(&Depth {
                image,
                unit_m: 1e-3,
            });
            assert!(map.points().iter().all(|point| *point == [0.0; 3]));
        }
        let map = PointMap::new(&Depth {
            image: DepthImage::new(0, 0),
            unit_m: 1e-3,
        });
        assert_eq!(map.points().len(), WIDTH * HEIGHT);
    }
}
