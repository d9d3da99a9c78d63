"""gripcast: grasps with touch.

Simulates grasps with finite-element gels (`simulate`, `Simulation`), renders what a GelSight Mini and a
camera see (`render_tactile`, `render_visual`), predicts stability (`Predictor`), follows gel markers
(`track_markers`), finds poses of marker boards (`solve_pose`), reads and writes datasets (`Dataset`) and
commands a running daemon (`Client`). `gripcast.gym` has environments for Gymnasium. Lengths are metres,
forces newtons; names carry the unit. A pose `t_a_b` maps coordinates of frame b into frame a. Images
are height × width × 3, uint8, RGB.
"""

import sysconfig

if sysconfig.get_config_var("Py_GIL_DISABLED"):
    raise ImportError(
        "gripcast does not run on free-threaded CPython: its native module is built for the stable ABI, "
        "which needs the interpreter's lock; use the ordinary build of the same version, for instance "
        "python3.14 instead of python3.14t"
    )

from gripcast._client import Client, DaemonState, Event, Events, LiveFrame, LiveMarkers
from gripcast._errors import (
    AccessError,
    BusyError,
    ConfigError,
    Error,
    InputError,
    InternalError,
    IoError,
    NotFoundError,
    RefusedError,
    UnreachableError,
    UsageError,
)
from gripcast._native import (
    Board,
    BoardPose,
    Dataset,
    FaceFields,
    Grasp,
    GraspCase,
    GraspPose,
    GraspResult,
    Intrinsics,
    LiftVerdict,
    Marker,
    MarkerTrack,
    Mesh,
    Object,
    Placement,
    Pose,
    Prediction,
    Predictor,
    PressResult,
    Problem,
    SensorFit,
    SensorProfile,
    Simulation,
    SimulationState,
    Snapshot,
    TactileImage,
    VerifyReport,
    VisualImage,
    __version__,
    detect_markers,
    press,
    render_tactile,
    render_visual,
    simulate,
    simulate_batch,
    solve_pose,
    track_markers,
)

__all__ = [
    "AccessError",
    "Board",
    "BoardPose",
    "BusyError",
    "Client",
    "ConfigError",
    "DaemonState",
    "Dataset",
    "Error",
    "Event",
    "Events",
    "FaceFields",
    "Grasp",
    "GraspCase",
    "GraspPose",
    "GraspResult",
    "InputError",
    "InternalError",
    "Intrinsics",
    "IoError",
    "LiftVerdict",
    "LiveFrame",
    "LiveMarkers",
    "Marker",
    "MarkerTrack",
    "Mesh",
    "NotFoundError",
    "Object",
    "Placement",
    "Pose",
    "Prediction",
    "Predictor",
    "PressResult",
    "Problem",
    "RefusedError",
    "SensorFit",
    "SensorProfile",
    "Simulation",
    "SimulationState",
    "Snapshot",
    "TactileImage",
    "UnreachableError",
    "UsageError",
    "VerifyReport",
    "VisualImage",
    "__version__",
    "detect_markers",
    "press",
    "render_tactile",
    "render_visual",
    "simulate",
    "simulate_batch",
    "solve_pose",
    "track_markers",
]
