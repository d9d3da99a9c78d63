//! `gripcast calibrate`: calibrates cameras, gripper tags and the force of tactile sensors.
//!
//! ```text
//! gripcast calibrate intrinsics --board charuco.toml --rig bench --out external.toml
//! gripcast calibrate intrinsics --board charuco.toml --images photos --out external.toml
//! gripcast calibrate show camera_info.yaml
//! gripcast calibrate convert camera_info.yaml --to toml --out external.toml
//! gripcast calibrate convert external.toml --to ros --camera-name external --out external.yaml
//! gripcast calibrate convert camera.yml --size 1280x720 --to toml --out external.toml
//! gripcast calibrate gripper --tags calib/boards/gripper-umi.toml --intrinsics external.toml \
//!     --images photos --closed closed-1.png --out gripper.toml
//! gripcast calibrate force --rig bench --role left --weights-g 200,500,1000 --out left.force.toml
//! ```
//!
//! `intrinsics` uses views of a planar board, live or from files (docs/how-to/calibration.md).
//! `show` and `convert` read intrinsics of gripcast (TOML), ROS (camera_info YAML), OpenCV
//! (FileStorage YAML) and Kalibr (camchain.yaml); the format is detected from the content.
//! `gripper` measures the poses of the gripper tags (docs/how-to/gripper-tags.md). `force` finds how
//! stiff a sensor's gel is, from known weights.
//!
//! Exit codes: 0 done · 1 invalid file or unusable images · 2 usage · 3 done, but an image was
//! unreadable or a tag was loose.

use clap::Subcommand;

use super::{Context, calibrate_convert, calibrate_force, calibrate_gripper, calibrate_intrinsics};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    /// Calibrate camera intrinsics with a planar board
    Intrinsics(calibrate_intrinsics::Args),
    /// Calibrate the poses of the gripper tags
    Gripper(calibrate_gripper::Args),
    /// Calibrate the force of a tactile sensor with known weights
    Force(calibrate_force::Args),
    /// Convert an intrinsics file to another format
    Convert(calibrate_convert::ConvertArgs),
    /// Check and describe an intrinsics file
    Show(calibrate_convert::ShowArgs),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.kind {
        Kind::Intrinsics(args) => calibrate_intrinsics::run(context, &args),
        Kind::Gripper(args) => calibrate_gripper::run(context, args),
        Kind::Force(args) => calibrate_force::run(context, &args),
        Kind::Convert(args) => calibrate_convert::convert(context, &args),
        Kind::Show(args) => calibrate_convert::show(&args),
    }
}
