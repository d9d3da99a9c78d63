//! Depth images as points in the gripper frame.

use gripcast_geometry::WristCamera;
use gripcast_imaging::{Depth, DepthView};

use super::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};

const WIDTH: usize = IMAGE_WIDTH as usize;
const HEIGHT: usize = IMAGE_HEIGHT as usize;
/// Principal point, px.
const CENTRE: [f64; 2] = [0.5 * (WIDTH as f64 - 1.0), 0.5 * (HEIGHT as f64 - 1.0)];
/// Unit of x and y, m.
const UNIT_M: f64 = 0.1;
/// Depth with an inverse depth of 1, m.
const NEAR_M: f64 = 0.2;
/// Maximum |x| and |y|, units: the background is of no interest.
const MAX: f64 = 2.0;
/// Points of a depth image: x and y in the gripper frame and the inverse depth of each pixel of a
/// 320×240 image of the [`WristCamera`] at its nominal mount, row-major; zeros without depth.
#[derive(Clone, Debug)]
pub struct PointMap(Vec<[f32; 3]>);

impl PointMap {
    /// Converts a depth image of a view. That of a D435's left imager is projected to the colour
    /// camera by the nominal lenses and distance (D400 series data sheet).
    pub fn new(depth: &Depth, view: DepthView) -> Self {
        let focal = WristCamera::focal_px(WIDTH, HEIGHT);
        let depths_m = depth.in_colour_image(view, WIDTH, HEIGHT);
        let pose = WristCamera::t_gripper_camera();
        let rotation = pose.rotation_matrix();
        let points = depths_m.iter().enumerate().map(|(pixel, z)| {
            if *z <= 0.0 {
                return [0.0; 3];
            }
            let [u, v] = [pixel % WIDTH, pixel / WIDTH].map(|at| at as f64);
            let [u, v] = [(u - CENTRE[0]) / focal, (v - CENTRE[1]) / focal];
            let at = |axis: usize| {
                let direction = rotation.row(axis);
                let along = direction.x * u + direction.y * v + direction.z;
                let position = pose.translation_m[axis] + z * along;
                (position / UNIT_M).clamp(-MAX, MAX) as f32
            };
            [at(0), at(1), (NEAR_M / z) as f32]
        });
        Self(points.collect())
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
    use gripcast_imaging::DepthImage;
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
            let unit_m = 1e-4;
            let map = PointMap::new(&Depth { image, unit_m }, DepthView::Colour);
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
            let unit_m = 1e-3;
            for view in DepthView::ALL {
                let image = image.clone();
                let map = PointMap::new(&Depth { image, unit_m }, view);
                assert!(map.points().iter().all(|point| *point == [0.0; 3]));
            }
        }
        let empty = Depth {
            image: DepthImage::new(0, 0),
            unit_m: 1e-3,
        };
        let map = PointMap::new(&empty, DepthView::LeftImager);
        assert_eq!(map.points().len(), WIDTH * HEIGHT);
    }

    /// Focal lengths of D435s as their factory tables give them, px, are within 2 % of these.
    #[test]
    fn depth_modes_have_the_focal_lengths_of_a_d435() {
        for (width, height, found) in [
            (1280, 720, 643.0),
            (848, 480, 426.0),
            (640, 480, 386.0),
            (640, 360, 321.5),
            (480, 270, 241.0),
            (424, 240, 213.0),
        ] {
            let focal = WristCamera::depth_focal_px(width, height);
            assert!((focal / found - 1.0).abs() < 0.02, "{width}: {focal}");
        }
    }

    #[test]
    fn left_imager_is_projected_to_colour_camera() {
        let camera = WristCamera::t_gripper_camera();
        let (near, far) = (0.15, 0.30);
        for (width, height) in [(848, 480), (640, 480), (480, 270), (424, 240)] {
            let focal = WristCamera::depth_focal_px(width, height);
            let middle = [width, height].map(|side| 0.5 * (side as f64 - 1.0));
            // A wall, and a plate of 30 mm before it that starts on the colour camera's axis.
            let plate = |u: f64, v: f64| {
                let x = u * near + WristCamera::LEFT_IMAGER_M;
                (0.0..0.03).contains(&x) && (v * near).abs() < 0.01
            };
            let image = DepthImage::from_fn(width as u32, height as u32, |x, y| {
                let [u, v] = [
                    (f64::from(x) - middle[0]) / focal,
                    (f64::from(y) - middle[1]) / focal,
                ];
                Luma([if plate(u, v) { 1500 } else { 3000 }])
            });
            let unit_m = 1e-4;
            let map = PointMap::new(&Depth { image, unit_m }, DepthView::LeftImager);
            let to = WristCamera::focal_px(WIDTH, HEIGHT);
            let point = |x_m: f64, y_m: f64, z_m: f64| {
                let column = (CENTRE[0] + to * x_m / z_m).round() as usize;
                let row = (CENTRE[1] + to * y_m / z_m).round() as usize;
                map.points()[row * WIDTH + column]
            };
            for (x_m, y_m, z_m) in [
                (0.002, 0.0, near),
                (0.028, 0.008, near),
                (-0.02, 0.0, far),
                (0.064, 0.0, far),
                (0.0, 0.06, far),
            ] {
                let [x, y, inverse] = point(x_m, y_m, z_m).map(f64::from);
                assert!(
                    (inverse - NEAR_M / z_m).abs() < 1e-3,
                    "{width}: {x_m} {inverse}"
                );
                let expected = camera.transform_point(glam::DVec3::new(x_m, y_m, z_m));
                assert!((x * UNIT_M - expected.x).abs() < 1e-3, "{width}: {x_m} {x}");
                assert!((y * UNIT_M - expected.y).abs() < 1e-3, "{width}: {y_m} {y}");
            }
            // Beside its left edge the plate hides the wall from the left imager; elsewhere there
            // are no gaps.
            let row = &map.points()[HEIGHT / 2 * WIDTH..][..WIDTH];
            let unknown = row.iter().filter(|point| **point == [0.0; 3]).count();
            let shadow = to * WristCamera::LEFT_IMAGER_M * (1.0 / near - 1.0 / far);
            assert!(
                unknown as f64 <= shadow + 3.0,
                "{width}: {unknown} {shadow}"
            );
        }
    }
}
