//! Whether a surface has an inside, which mass needs.

use super::{PrepareOptions, Repair, TriangleMesh};
use crate::solid::Solid;
use gripcast_base::error::{Error, Result};

/// Largest uncertainty of a volume, as a fraction of it.
const MAX_UNCERTAINTY: f64 = 0.1;
/// Fractions of the volume or the surface that are worth a warning.
const NOTABLE: f64 = 1e-4;

/// Finds the inside of a surface and warns of what its mass depends on.
///
/// # Errors
/// `Input` for a surface without an inside if `options` need one; with [`Repair::Strict`] also for
/// bodies that share a volume.
pub(super) fn check(
    mesh: &TriangleMesh,
    options: &PrepareOptions,
    warnings: &mut Vec<String>,
) -> Result<Option<Solid>> {
    let found = Solid::of(mesh).map_err(|_| no_volume());
    let solid = match found {
        Ok(solid) if solid.uncertainty <= MAX_UNCERTAINTY => solid,
        _ if !options.needs_inside => return Ok(None),
        Ok(solid) => return Err(too_open(&solid)),
        Err(error) => return Err(error),
    };
    if solid.overlap > NOTABLE {
        let what = format!(
            "pieces overlap: {} of the volume counts once instead of more often",
            percent(solid.overlap)
        );
        if options.repair == Repair::Strict {
            return Err(Error::input(what).remedy(
                "merge the bodies in a mesh editor (boolean union), orient cavities inwards, or \
                 pass --repair auto",
            ));
        }
        warnings.push(what);
    }
    if solid.hole_area > NOTABLE {
        warnings.push(format!(
            "closed holes of {} of the surface for the mass",
            percent(solid.hole_area)
        ));
    }
    if solid.uncertainty > NOTABLE {
        warnings.push(format!(
            "the volume, and with it the centre of mass, is uncertain by {}",
            percent(solid.uncertainty)
        ));
    }
    Ok(Some(solid))
}

fn no_volume() -> Error {
    Error::input("the mesh must enclose a volume, found a flat or open surface").remedy(WALL)
}

fn too_open(solid: &Solid) -> Error {
    Error::input(format!(
        "the mesh must have an inside, found an open surface: its holes are {} of its area, and {} \
         of its volume could be inside or outside",
        percent(solid.hole_area),
        percent(solid.uncertainty)
    ))
    .remedy(WALL)
}

const WALL: &str = "if it is a shell, like a cup or a box without a lid, pass its wall as \
                    --wall-thickness-mm; else close its holes in a mesh editor";

/// Formats a fraction with two significant digits.
fn percent(fraction: f64) -> String {
    let percent = 100.0 * fraction;
    let digits = match percent {
        p if p >= 10.0 => 0,
        p if p >= 1.0 => 1,
        p if p >= 0.1 => 2,
        _ => 3,
    };
    format!("{percent:.digits$} %")
}
