//! Python package `gripcast`: the native module `gripcast._native`.
//!
//! Simulator, renderers, predictor, marker tracker, marker boards and datasets are linked: no cameras,
//! no web, no terminal. Arrays are copied on the way in, so that work runs without the
//! interpreter's lock; every panic becomes an `InternalError`.

mod append;
mod arrays;
mod batch;
mod board;
mod case;
mod dataset;
mod failure;
mod fields;
mod grasp_record;
mod mesh;
mod placement;
mod pose;
mod predictor;
mod press;
mod render;
mod result;
mod sensor;
mod simulation;
mod track;
mod visual;
mod work;

/// The native half of the package `gripcast`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::arrays::decode_image;
    #[pymodule_export]
    use crate::batch::{simulate, simulate_batch};
    #[pymodule_export]
    use crate::board::{Board, BoardPose, Intrinsics, Marker, detect_markers, solve_pose};
    #[pymodule_export]
    use crate::case::GraspCase;
    #[pymodule_export]
    use crate::dataset::{Dataset, Problem, VerifyReport};
    #[cfg(debug_assertions)]
    #[pymodule_export]
    use crate::failure::panic_for_test;
    #[pymodule_export]
    use crate::fields::FaceFields;
    #[pymodule_export]
    use crate::grasp_record::Grasp;
    #[pymodule_export]
    use crate::mesh::{Mesh, Object};
    #[pymodule_export]
    use crate::placement::{GraspPose, Placement};
    #[pymodule_export]
    use crate::pose::Pose;
    #[pymodule_export]
    use crate::predictor::{LiftVerdict, Prediction, Predictor};
    #[pymodule_export]
    use crate::press::{PressResult, press};
    #[pymodule_export]
    use crate::render::{TactileImage, render_tactile};
    #[pymodule_export]
    use crate::result::{GraspResult, Snapshot};
    #[pymodule_export]
    use crate::sensor::{SensorFit, SensorProfile};
    #[pymodule_export]
    use crate::simulation::{Simulation, SimulationState};
    #[pymodule_export]
    use crate::track::{MarkerTrack, track_markers};
    #[pymodule_export]
    use crate::visual::{VisualImage, render_visual};

    /// Version of gripcast.
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
