//! `gripcast calibrate`: cameras and the gripper's tags.
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
//! ```
//!
//! `intrinsics` takes views of a flat board, live or from files: docs/calibration.md. `show` and `convert` read intrinsics of gripcast (TOML), ROS (camera_info YAML), OpenCV
//! (FileStorage YAML) and Kalibr (camchain.yaml); the content decides which it is. `gripper` finds
//! out where the gripper's tags really are: docs/gripper-tags.md.
//!
//! Exit codes: 0 done · 1 a file, an image or the set of images is refused · 2 usage · 3 done,
//! but an image could not be read or a tag was loose.

use clap::Subcommand;

use super::{Context, calibrate_convert, calibrate_gripper, calibrate_intrinsics};
use gripcast_base::error::Result;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    /// Intrinsics of a camera from views of a flat board
    Intrinsics(calibrate_intrinsics::Args),
    /// Find out from images where the gripper's tags are
    Gripper(calibrate_gripper::Args),
    /// Read intrinsics of any known format and write them in another
    Convert(calibrate_convert::ConvertArgs),
    /// Check a file of intrinsics and say what is in it
    Show(calibrate_convert::ShowArgs),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.kind {
        Kind::Intrinsics(args) => calibrate_intrinsics::run(context, &args),
        Kind::Gripper(args) => calibrate_gripper::run(context, args),
        Kind::Convert(args) => calibrate_convert::convert(context, &args),
        Kind::Show(args) => calibrate_convert::show(&args),
    }
}
