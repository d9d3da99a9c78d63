//! Built-in families of objects that people pick up from a table: hundreds of distinct closed
//! meshes for each category from a seed, so that a synthetic dataset can be made offline.
//!
//! Bodies are turned, cut out of plates, or blended from parts given by their signed distance; none
//! needs boolean operations on meshes. Most families are files in `shapes`.

mod bowl;
mod category;
mod draw;
mod lathe;
mod mug;
mod outline;
mod plate;
mod rounded_box;
mod script;
mod scripted;
mod shape;
mod solid;
mod toy;

pub use category::Category;

use self::draw::Draw;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::TriangleMesh;

/// Draws of a shape that are tried until one passes its checks.
const ATTEMPTS: u32 = 12;

/// The shape of a category for a seed: 2 to 15 cm long, with at most 8000 triangles, most of whose
/// sides are 2 to 4 mm. Equal on all machines.
///
/// The mesh is closed, connected, free of self-intersections, counter-clockwise seen from outside;
/// its bounding box is centred in the origin, z up in the natural pose, m. A draw that does not pass
/// the checks is replaced by the next one of the same seed.
///
/// # Errors
/// `Internal`, with the reason of the last draw, if none of a dozen passes.
///
/// ```
/// use gripcast_synth::family::{Category, family_shape};
/// let mug = family_shape(Category::Mug, 7)?;
/// assert!(mug.edges().is_closed());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn family_shape(category: Category, seed: u64) -> Result<TriangleMesh> {
    let mut rejected = 0;
    loop {
        let name = format!("family/{}/{rejected}", category.name());
        let mut draw = Draw(SeedStream::named(seed, &name));
        match category.draw(&mut draw).and_then(shape::finished) {
            Ok(mesh) => return Ok(mesh),
            Err(e) if rejected + 1 == ATTEMPTS => {
                return Err(e.at(format!("shape {seed} of the family {}", category.name())));
            }
            Err(_) => rejected += 1,
        }
    }
}
