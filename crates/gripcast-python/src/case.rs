//! A grasp before it is simulated.

use std::str::FromStr as _;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::failure::{Outcome, argument};
use super::mesh::Object;
use super::placement::{Start, check};
use super::pose::Pose;
use super::sensor::profile;
use super::work::interruptible;
use gripcast_base::error::{Error, ErrorKind, Result, unknown_name};
use gripcast_base::number::NumberRange;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::fields::FieldSampling;
use gripcast_sim::grasp::{
    self, ForceRule, GraspSettings, GraspStart, Preset, Scene, TACCEL_DRIVE_WEIGHT, simulate_until,
};
use gripcast_sim::rigid::RigidEngine;
use gripcast_sim::solver::Drive;
use gripcast_sim::{Engine as _, EngineKind, GraspSetup};
use gripcast_tactile::SimulatedGel;

/// Arguments that every engine has.
const COMMON: [&str; 2] = ["engine", "stop_force_n"];
/// Arguments of the finite-element simulator.
const FEM: [&str; 13] = [
    "adjust_s",
    "drive",
    "dt_s",
    "eps_v_m_s",
    "fields",
    "gain_m_per_n",
    "gel",
    "lift_m",
    "max_iterations",
    "preset",
    "profile",
    "tolerance_m_s",
    "rule",
];

/// Settings of a grasp.
#[derive(Clone)]
pub(crate) struct Settings {
    pub(crate) engine: EngineKind,
    pub(crate) fem: GraspSettings,
    pub(crate) fields: Option<FieldSampling>,
}

impl Settings {
    pub(crate) fn new(given: Option<&Bound<'_, PyDict>>) -> Outcome<Self> {
        let mut settings = Self {
            engine: EngineKind::Fem,
            fem: GraspSettings::default(),
            fields: None,
        };
        let Some(given) = given else {
            return Ok(settings);
        };
        let known = [&COMMON[..], &FEM[..]].concat();
        for key in given.keys() {
            let key: String = key.extract()?;
            if !known.contains(&key.as_str()) {
                return Err(unknown_name("argument", &key, &known).into());
            }
        }
        if let Some(name) = text(given, "engine")? {
            let engines = EngineKind::ALL;
            settings.engine = engines
                .into_iter()
                .find(|engine| engine.name() == name)
                .ok_or_else(|| unknown_name("engine", &name, &engines.map(EngineKind::name)))?;
        }
        if settings.engine == EngineKind::Rigid {
            let other = FEM
                .iter()
                .find(|key| given.contains(**key).is_ok_and(|c| c));
            if let Some(other) = other {
                let what = format!("`{other}` is of the engine fem, found the engine rigid");
                return Err(Error::usage(what).remedy("omit one of them").into());
            }
        }
        settings.read_gel(given)?;
        settings.read_protocol(given)?;
        Ok(settings)
    }

    fn read_gel(&mut self, given: &Bound<'_, PyDict>) -> Outcome<()> {
        let named = text(given, "preset")?;
        if let Some(name) = &named {
            let presets = Preset::ALL;
            let found = presets.into_iter().find(|preset| preset.name() == name);
            let preset =
                found.ok_or_else(|| unknown_name("preset", name, &presets.map(Preset::name)))?;
            self.fem = GraspSettings::new(preset);
        }
        if let Some(value) = given.get_item("profile")?.filter(|v| !v.is_none()) {
            if named.is_some() {
                return Err(Error::usage("`preset` contradicts `profile`")
                    .remedy("omit one of them")
                    .into());
            }
            let profile = profile(&value)?;
            (self.fem.pad, self.fem.material) = (profile.pad(), profile.gel_material());
        }
        if let Some(name) = text(given, "gel")? {
            self.fem.resolution = GelResolution::from_name(&name)?;
        }
        match text(given, "drive")?.as_deref() {
            None | Some("area") => {}
            Some("taccel") => self.fem.drive = Drive::PerMass(TACCEL_DRIVE_WEIGHT),
            Some(other) => return Err(unknown_name("drive", other, &["area", "taccel"]).into()),
        }
        let fields = text(given, "fields")?;
        self.fields = fields.as_deref().map(FieldSampling::from_str).transpose()?;
        Ok(())
    }

    fn read_protocol(&mut self, given: &Bound<'_, PyDict>) -> Outcome<()> {
        let gain_m_per_n = positive(given, "gain_m_per_n")?;
        let rules = ["bang-bang", "proportional"];
        let protocol = &mut self.fem.protocol;
        match (text(given, "rule")?.as_deref(), gain_m_per_n) {
            (None | Some("bang-bang"), None) => {}
            (Some("proportional"), gain) => {
                protocol.rule = ForceRule::Proportional {
                    gain_m_per_n: gain.unwrap_or(ForceRule::GAIN_M_PER_N),
                };
            }
            (None | Some("bang-bang"), Some(_)) => {
                let what = "`gain_m_per_n` is of the rule proportional";
                return Err(Error::usage(what)
                    .remedy("add rule=\"proportional\"")
                    .into());
            }
            (Some(other), _) => return Err(unknown_name("rule", other, &rules).into()),
        }
        let numbers = [
            ("stop_force_n", &mut protocol.stop_force_n),
            ("adjust_s", &mut protocol.adjust_s),
            ("lift_m", &mut protocol.lift_m),
            ("dt_s", &mut self.fem.solver.dt_s),
            ("eps_v_m_s", &mut self.fem.solver.eps_v_m_s),
            ("tolerance_m_s", &mut self.fem.solver.newton_tolerance_m_s),
        ];
        for (name, target) in numbers {
            if let Some(value) = positive(given, name)? {
                *target = value;
            }
        }
        if let Some(value) = given.get_item("max_iterations")?.filter(|v| !v.is_none()) {
            let count: u32 = argument(&value, "max_iterations")?;
            if count == 0 {
                return Err(Error::usage("`max_iterations` must be above 0, found 0").into());
            }
            self.fem.solver.max_iterations = count;
        }
        Ok(())
    }
}

fn text(given: &Bound<'_, PyDict>, name: &str) -> PyResult<Option<String>> {
    let value = given.get_item(name)?.filter(|value| !value.is_none());
    value.map(|value| argument(&value, name)).transpose()
}

fn positive(given: &Bound<'_, PyDict>, name: &str) -> Outcome<Option<f64>> {
    let value = given.get_item(name)?.filter(|value| !value.is_none());
    let value: Option<f64> = value.map(|value| argument(&value, name)).transpose()?;
    check(name, value, NumberRange::POSITIVE)?;
    Ok(value)
}

/// A grasp that is ready to be simulated: object, placed gripper and settings.
///
/// The gripper is placed here, so an object that does not fit is refused here. Settings are those of
/// `simulate`.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct GraspCase(pub(crate) Arc<Case>);

pub(crate) struct Case {
    pub(crate) object: Object,
    pub(crate) settings: Settings,
    pub(crate) start: GraspStart,
}

impl GraspCase {
    pub(crate) fn build(
        py: Python<'_>,
        object: &Object,
        placement: Option<&Bound<'_, PyAny>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> Outcome<Self> {
        let settings = Settings::new(settings)?;
        let start = Start::new(placement)?;
        let object = object.clone();
        let case = interruptible(py, move |_| {
            let pad = match settings.engine {
                EngineKind::Fem => settings.fem.pad,
                EngineKind::Rigid => RigidEngine::default().pad(),
            };
            let start = start.place(object.mesh.surface(), pad)?;
            Ok(Case {
                object,
                settings,
                start,
            })
        })?;
        Ok(Self(Arc::new(case)))
    }
}

impl Case {
    /// Simulates the grasp.
    pub(crate) fn run(&self, is_cancelled: &AtomicBool) -> Result<grasp::GraspResult> {
        if is_cancelled.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(Error::new(
                ErrorKind::Interrupted,
                "the grasp was interrupted",
            ));
        }
        let (object, fem) = (&self.object, &self.settings.fem);
        match self.settings.engine {
            EngineKind::Fem => {
                let fields = self.settings.fields;
                simulate_until(
                    &self.scene()?,
                    &fem.protocol,
                    &fem.solver,
                    fields,
                    is_cancelled,
                )
            }
            EngineKind::Rigid => {
                let gripper = &self.start.gripper;
                let setup = GraspSetup {
                    mesh: Arc::new(object.mesh.surface().clone()),
                    mass_kg: object.mass_kg,
                    t_world_object: self.start.t_world_object,
                    t_world_gripper: gripper.t_world_gripper,
                    opening_m: gripper.opening_m,
                };
                let force_n = fem.protocol.stop_force_n;
                RigidEngine::default().simulate(&setup, object.friction, force_n)
            }
        }
    }

    /// Initial state for the finite-element simulator.
    pub(crate) fn scene(&self) -> Result<Scene> {
        let (object, gripper) = (&self.object, &self.start.gripper);
        Ok(Scene {
            mesh: object.mesh.surface().clone(),
            mass_kg: object.mass_kg,
            friction: object.friction,
            t_world_object: self.start.t_world_object,
            t_world_gripper: gripper.t_world_gripper,
            opening_m: gripper.opening_m,
            gel: self.settings.fem.gel()?,
        })
    }

    /// The gels, for renderers.
    pub(crate) fn gel(&self) -> Result<SimulatedGel> {
        let settings = &self.settings;
        if settings.engine != EngineKind::Fem {
            return Err(
                Error::input("a grasp of the engine rigid has no gels to render")
                    .remedy("simulate it with engine=\"fem\""),
            );
        }
        Ok(SimulatedGel {
            grid: settings.fem.gel()?.grid,
            d_hat_m: settings.fem.solver.d_hat_m,
        })
    }
}

#[pymethods]
impl GraspCase {
    #[new]
    #[pyo3(signature = (object, placement = None, **settings))]
    fn new(
        py: Python<'_>,
        object: &Object,
        placement: Option<&Bound<'_, PyAny>>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> Outcome<Self> {
        Self::build(py, object, placement, settings)
    }

    /// Object to grasp.
    #[getter]
    fn object(&self) -> Object {
        self.0.object.clone()
    }

    /// fem or rigid.
    #[getter]
    fn engine(&self) -> &'static str {
        self.0.settings.engine.name()
    }

    /// Stopping force per finger (rigid: motor force per finger), N.
    #[getter]
    fn stop_force_n(&self) -> f64 {
        self.0.settings.fem.protocol.stop_force_n
    }

    /// Pose of the object on the ground.
    #[getter]
    fn t_world_object(&self) -> Pose {
        Pose(self.0.start.t_world_object)
    }

    /// Pose of the gripper; the fingers close along its x axis.
    #[getter]
    fn t_world_gripper(&self) -> Pose {
        Pose(self.0.start.gripper.t_world_gripper)
    }

    /// Distance between the gel faces at the start, m.
    #[getter]
    fn opening_m(&self) -> f64 {
        self.0.start.gripper.opening_m
    }

    /// Reasons to look at mesh and placement, one sentence each.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        let mesh = &self.0.object.mesh.prepared.warnings;
        [&mesh[..], &self.0.start.warnings[..]].concat()
    }

    fn __repr__(&self) -> String {
        format!(
            "<GraspCase of {}: engine {}, opening {:.1} mm, stopping force {} N>",
            self.0.object.mesh.__repr__(),
            self.engine(),
            1e3 * self.opening_m(),
            self.stop_force_n()
        )
    }
}
