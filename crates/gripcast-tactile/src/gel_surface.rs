//! Baseline renderer: image of the deformed gel mesh, as in Taccel's built-in renderer (Li et al.
//! 2025).
//!
//! Rays hit the flat triangles of the gel face, so each triangle has one normal and shows as a flat
//! patch, and the face sinks around the contact. Shading is that of the sensor profile; Taccel uses
//! a neural network of another sensor.

use glam::DVec3;
use image::RgbImage;

use super::depth::{depth_below, gel_surface_depth};
use super::press_depth::{PressDepth, SensorGeometry};
use super::profile::SensorProfile;
use super::rasteriser::Rasteriser;
use super::scene::TactileScene;
use super::scene_renderer::{ObjectDepthRenderer, SceneRenderer, noise};
use super::smooth::Smoothing;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_shear::MarkerField;
use gripcast_sim::fem::{GelGrid, Side};

/// Renders the deformed gel face without smoothing.
#[derive(Clone, Debug)]
pub struct GelSurfaceRenderer(ObjectDepthRenderer);

impl GelSurfaceRenderer {
    /// Renderer with the shading of a sensor profile.
    ///
    /// # Errors
    /// `Config` if the profile is invalid.
    pub fn new(profile: &SensorProfile) -> Result<Self> {
        let unsmoothed = SensorProfile {
            smoothing: Smoothing::default(),
            ..profile.clone()
        };
        ObjectDepthRenderer::new(&unsmoothed).map(Self)
    }
}

impl SceneRenderer for GelSurfaceRenderer {
    fn grid(&self) -> SensorGeometry {
        self.0.grid()
    }

    fn render(&mut self, scene: &TactileScene<'_>, seed: Option<u64>) -> Result<RgbImage> {
        let grid = self.grid();
        let press = gel_surface_depth(scene, &grid, &mut self.0.rasteriser).ok_or_else(|| {
            Error::input("the gel-surface renderer needs the deformed gel, which the scene lacks")
                .remedy("render the end of a stage of a simulated grasp")
        })?;
        let noise = noise(&self.0.drift, seed);
        self.0.shading.render_with_skin(&press, &scene.skin, &noise)
    }

    fn marker_field(&mut self, scene: &TactileScene<'_>) -> Result<Option<MarkerField>> {
        self.0.marker_field(scene)
    }
}

/// Resamples a press at the nodes of a gel face with flat triangles between them: the best that the
/// gel mesh can represent.
pub fn faceted(press: &PressDepth, gel: &GelGrid, rasteriser: &mut Rasteriser) -> PressDepth {
    let grid = &press.geometry;
    let thickness = gel.thickness_m();
    let [_, _, layers] = gel.nodes();
    let first = gel.node(0, 0, layers - 1);
    let sunken = |node: &DVec3| DVec3::new(node.x, node.y, thickness - depth_at(press, node));
    let face = TriangleMesh {
        vertices: gel.positions()[first..].iter().map(sunken).collect(),
        triangles: gel
            .triangles(Side::Front)
            .iter()
            .map(|t| t.map(|v| v - first as u32))
            .collect(),
    };
    let range = [f64::NEG_INFINITY, thickness];
    let nearest = rasteriser.nearest(&face, &Pose::IDENTITY, grid, range);
    depth_below(nearest, thickness, grid)
}

/// Returns the depth at the pixel nearest to a point of the face; 0 outside the image.
fn depth_at(press: &PressDepth, point: &DVec3) -> f64 {
    let grid = &press.geometry;
    let pixel = |c: f64, count: usize| {
        let pixel = (c / grid.pixel_m + 0.5 * (count as f64 - 1.0)).round();
        (pixel >= 0.0 && pixel < count as f64).then_some(pixel as usize)
    };
    match (pixel(point.x, grid.width), pixel(point.y, grid.height)) {
        (Some(column), Some(row)) => f64::from(press.depth_m[row * grid.width + column]),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lookup::{LookupRenderer, TaximTable};
    use crate::scene::Skin;
    use gripcast_geometry::builtin;
    use gripcast_sim::fem::{GelPad, GelResolution};

    /// The middle of the face sunk by `depth_m`, the object far away.
    fn scene(object: &TriangleMesh, depth_m: f64) -> TactileScene<'_> {
        let corner = |x: f64, y: f64, z: f64| DVec3::new(0.0125 * x, 0.01 * y, z);
        let face = TriangleMesh {
            vertices: vec![
                corner(-1.0, -1.0, 4e-3),
                corner(1.0, -1.0, 4e-3),
                corner(1.0, 1.0, 4e-3),
                corner(-1.0, 1.0, 4e-3),
                corner(0.0, 0.0, 4e-3 - depth_m),
            ],
            triangles: vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
        };
        TactileScene {
            object,
            t_sensor_object: Pose::from_translation(DVec3::Z),
            face_m: 4e-3,
            gap_m: 0.0,
            gel_face: Some(face),
            skin: Skin::default(),
        }
    }

    #[test]
    fn every_renderer_shows_undeformed_gel_as_background() {
        let object = builtin("builtin:sphere").unwrap();
        let profile = SensorProfile::gelsight_mini().unwrap();
        let untouched = profile.background.image.clone().unwrap();
        let table = TaximTable::constant(9, [640, 480], [5.0, 0.0, 0.0]);
        let lookup = LookupRenderer::new(profile.geometry, untouched.clone(), table);
        let renderers: [Box<dyn SceneRenderer>; 3] = [
            Box::new(ObjectDepthRenderer::new(&profile).unwrap()),
            Box::new(GelSurfaceRenderer::new(&profile).unwrap()),
            Box::new(lookup.unwrap()),
        ];
        for mut renderer in renderers {
            assert_eq!(renderer.grid(), profile.geometry);
            let image = renderer.render(&scene(&object, 0.0), None).unwrap();
            assert_eq!(image, untouched);
        }
    }

    #[test]
    fn each_triangle_has_one_colour() {
        let object = builtin("builtin:sphere").unwrap();
        let mut profile = SensorProfile::gelsight_mini().unwrap();
        // A flat background and colours that do not depend on the place.
        profile.background.image = None;
        let mut renderer = GelSurfaceRenderer::new(&profile).unwrap();
        let change = |renderer: &mut GelSurfaceRenderer, depth: f64| {
            let grid = renderer.grid();
            let press =
                gel_surface_depth(&scene(&object, depth), &grid, &mut renderer.0.rasteriser)
                    .unwrap();
            renderer.0.shading.change(&press).unwrap().clone()
        };
        let sunk = change(&mut renderer, 2e-3);
        let grid = renderer.grid();
        let at = |column: usize, row: usize| sunk[0][row * grid.width + column];
        let (column, row) = (grid.width / 2, grid.height / 2);
        // The same slope on both sides of a face's middle line, another on the next face.
        assert!((at(column, 20) - at(column, 30)).abs() < 1.0);
        assert!((at(column, 20) - at(30, row)).abs() > 1.0);
    }

    #[test]
    fn facets_match_the_press_at_gel_nodes() {
        let geometry = SensorGeometry {
            width: 200,
            height: 160,
            pixel_m: 1e-4,
            gel_thickness_m: 4e-3,
        };
        let mut press = PressDepth::untouched(geometry);
        for (pixel, depth) in press.depth_m.iter_mut().enumerate() {
            let [x, y] = geometry.pixel_to_gel_m((pixel % 200) as f64, (pixel / 200) as f64);
            *depth = (1e-3 - 20.0 * (x * x + y * y)).max(0.0) as f32;
        }
        let gel = GelPad::default().grid(GelResolution::Fine).unwrap();
        let facets = faceted(&press, &gel, &mut Rasteriser::new());
        // A node lies 0.5 mm beside the middle of x, and in the middle of y.
        let at = |press: &PressDepth, column: usize| press.depth_m[80 * 200 + column];
        assert!((at(&facets, 105) - at(&press, 105)).abs() < 1e-5);
        let between = (at(&facets, 110) - at(&press, 110)).abs();
        assert!(between > 2e-6 && between < 2e-5, "{between}");
        let nothing = faceted(
            &PressDepth::untouched(geometry),
            &gel,
            &mut Rasteriser::new(),
        );
        assert_eq!(nothing.deepest_m(), 0.0);
    }

    #[test]
    fn scene_without_gel_is_refused() {
        let object = builtin("builtin:sphere").unwrap();
        let profile = SensorProfile::gelsight_mini().unwrap();
        let lacking = TactileScene {
            gel_face: None,
            ..scene(&object, 0.0)
        };
        let error = GelSurfaceRenderer::new(&profile)
            .unwrap()
            .render(&lacking, Some(1))
            .unwrap_err();
        assert!(error.to_string().contains("deformed gel"), "{error}");
    }

    #[test]
    fn noise_depends_on_seed() {
        let object = builtin("builtin:sphere").unwrap();
        let profile = SensorProfile::gelsight_mini().unwrap();
        let mut renderer = ObjectDepthRenderer::new(&profile).unwrap();
        let first = renderer.render(&scene(&object, 0.0), Some(7)).unwrap();
        let again = renderer.render(&scene(&object, 0.0), Some(7)).unwrap();
        let other = renderer.render(&scene(&object, 0.0), Some(8)).unwrap();
        assert!(first == again && first != other);
    }
}
