//! Renders tactile images.

use image::RgbImage;
use pyo3::prelude::*;

use super::arrays::{array, image_array};
use super::failure::Outcome;
use super::mesh::Mesh;
use super::pose::pose;
use super::result::GraspResult;
use super::sensor::{SensorProfile, sensor};
use super::simulation::Simulation;
use super::work::detached;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_geometry::Pose;
use gripcast_sim::grasp::Finger;
use gripcast_tactile::{Moment, MountingAngle, SensorMount, TactileScene};

/// Depth of a press unless another is given, m.
const PRESS_M: f64 = 5e-4;

/// What a sensor sees of a scene.
struct Rendered {
    image: RgbImage,
    depth_m: Vec<f32>,
    deepest_m: f64,
    markers: Option<(Vec<f32>, [usize; 3])>,
}

/// Renders what a tactile sensor sees.
///
/// `source` is a `GraspResult`, whose `side` (left or right) is seen at a `moment` (initial, closure,
/// grasp or lift), a `Simulation` as it is now, or a `Mesh` that is pressed `press_m` deep into one gel (m, 5e-4 by default) at
/// `t_sensor_object`: the sensor's x runs along the columns, y along the rows, z towards the object,
/// from the centre of the gel; z of the pose is ignored.
///
/// `profile` is a `SensorProfile`, a name or a file; a `SensorProfile` that is kept renders faster.
/// `mounting_deg` turns the sensor on its finger. With `markers` the positions of the gel markers are
/// returned, too. `seed` selects the noise; None is without noise.
#[pyfunction]
#[pyo3(signature = (source, t_sensor_object = None, *, press_m = None, side = "left", moment = None, profile = None, mounting_deg = 0, markers = false, seed = Some(0)))]
#[pyo3(
    text_signature = "(source, t_sensor_object=None, *, press_m=None, side='left', moment=None, profile=None, mounting_deg=0, markers=False, seed=0)"
)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn render_tactile(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    t_sensor_object: Option<&Bound<'_, PyAny>>,
    press_m: Option<f64>,
    side: &str,
    moment: Option<&str>,
    profile: Option<&Bound<'_, PyAny>>,
    mounting_deg: u16,
    markers: bool,
    seed: Option<u64>,
) -> Outcome<TactileImage> {
    let mount = SensorMount {
        finger: finger(side)?,
        mounting: MountingAngle::from_degrees(mounting_deg)?,
    };
    let sensor = match profile {
        Some(profile) => sensor(profile)?,
        None => detached(py, || SensorProfile::named("gelsight-mini"))?,
    };
    if markers {
        sensor.profile().marker_pattern()?;
    }
    let rendered = if let Ok(result) = source.cast::<GraspResult>() {
        if t_sensor_object.is_some() || press_m.is_some() {
            let what = "`t_sensor_object` and `press_m` are of a mesh, found a GraspResult";
            return Err(Error::usage(what).remedy("omit them").into());
        }
        let moment = named_moment(moment.unwrap_or(Moment::Grasp.name()))?;
        let grasp = result.get().simulated();
        detached(py, || {
            let gel = grasp.case().gel()?;
            sensor.profile().check_pad(&gel.grid)?;
            let mesh = grasp.case().object.mesh.surface();
            let start = grasp.start();
            let scene = TactileScene::at_moment(mesh, &gel, &start, grasp.trace(), moment, mount)?;
            render(&sensor, &scene, mount.finger, markers, seed)
        })?
    } else if moment.is_some() {
        let found = source.get_type().name()?;
        let what = format!("`moment` is of a GraspResult, found a {found}");
        return Err(Error::usage(what).remedy("omit it").into());
    } else if let Ok(simulation) = source.cast::<Simulation>() {
        if t_sensor_object.is_some() || press_m.is_some() {
            let what = "`t_sensor_object` and `press_m` are of a mesh, found a Simulation";
            return Err(Error::usage(what).remedy("omit them").into());
        }
        let simulation = simulation.get();
        detached(py, || {
            let case = simulation.simulated();
            let gel = case.gel()?;
            sensor.profile().check_pad(&gel.grid)?;
            let (mesh, snapshot) = (case.object.mesh.surface(), simulation.snapshot());
            let scene = TactileScene::from_snapshot(mesh, &gel, &snapshot, mount)?;
            render(&sensor, &scene, mount.finger, markers, seed)
        })?
    } else if let Ok(mesh) = source.cast::<Mesh>() {
        let at = t_sensor_object.map(|value| pose(value, "t_sensor_object"));
        let at = at.transpose()?.unwrap_or(Pose::IDENTITY);
        let mesh = mesh.get();
        detached(py, || {
            let grid = sensor.profile().geometry;
            let press_m = press_m.unwrap_or(PRESS_M);
            let scene = TactileScene::pressed(mesh.surface(), &at, press_m, &grid)?;
            render(&sensor, &scene, mount.finger, markers, seed)
        })?
    } else {
        let found = source.get_type().name()?;
        let what = format!("`source` must be a GraspResult, a Simulation or a Mesh, found {found}");
        return Err(Error::usage(what).into());
    };
    let (width, height) = (
        rendered.image.width() as usize,
        rendered.image.height() as usize,
    );
    let touched = rendered
        .depth_m
        .iter()
        .filter(|depth| **depth > 0.0)
        .count();
    let markers = rendered.markers;
    Ok(TactileImage {
        contact_fraction: touched as f64 / rendered.depth_m.len().max(1) as f64,
        deepest_m: rendered.deepest_m,
        depth_m: array(py, rendered.depth_m, &[height, width])?,
        image: image_array(py, rendered.image)?,
        markers: markers
            .map(|(values, shape)| array(py, values, &shape))
            .transpose()?,
    })
}

fn render(
    sensor: &SensorProfile,
    scene: &TactileScene<'_>,
    finger: Finger,
    markers: bool,
    seed: Option<u64>,
) -> Result<Rendered> {
    sensor.with_renderer(finger, |renderer| {
        let press = renderer.press(scene);
        let markers = match markers {
            true => renderer.marker_field_of(&press, &scene.skin)?,
            false => None,
        };
        Ok(Rendered {
            image: renderer.render_press(&press, &scene.skin, seed)?,
            deepest_m: press.deepest_m(),
            depth_m: press.depth_m,
            markers: markers.map(|field| field.to_array()),
        })
    })
}

/// A finger by its name.
fn finger(side: &str) -> Result<Finger> {
    let found = Finger::BOTH
        .into_iter()
        .find(|finger| finger.name() == side);
    found.ok_or_else(|| unknown_name("side", side, &Finger::BOTH.map(Finger::name)))
}

pub(crate) fn named_moment(name: &str) -> Result<Moment> {
    let found = Moment::ALL.into_iter().find(|moment| moment.name() == name);
    found.ok_or_else(|| unknown_name("moment", name, &Moment::ALL.map(Moment::name)))
}

/// A rendered tactile image.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct TactileImage {
    /// height × width × 3, uint8, RGB.
    image: Py<PyAny>,
    /// height × width, float32, m: contact depth, 0 without contact.
    depth_m: Py<PyAny>,
    /// Largest contact depth, m.
    deepest_m: f64,
    /// Fraction of the pixels in contact.
    contact_fraction: f64,
    /// rows × columns × 5, float32: rest x, rest y, displacement x, displacement y (px), confidence;
    /// NaN where the image has no gel marker. None unless `markers` was set.
    markers: Option<Py<PyAny>>,
}

#[pymethods]
impl TactileImage {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let shape = self.image.getattr(py, "shape")?;
        Ok(format!(
            "<TactileImage {shape}: {:.2} mm deep, {:.0} % in contact>",
            1e3 * self.deepest_m,
            100.0 * self.contact_fraction
        ))
    }
}
