//! Built-in families of tabletop objects: any number of distinct closed meshes per category,
//! generated from seeds without downloads.
//!
//! Bodies are turned on a lathe, cut from plates, or blended from signed distance primitives; none
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

/// Maximum draws until a shape passes its checks.
const ATTEMPTS: u32 = 12;

/// Generates the shape of a category for a seed: 2 to 15 cm long, with at most 8000 triangles, most
/// edges 2 to 4 mm long. Identical on all machines.
///
/// The mesh (m) is closed, connected, free of self-intersections and counter-clockwise seen from
/// outside; its bounding box is centred at the origin, with z up in the natural pose. A draw that
/// does not pass the checks is replaced by the next one of the same seed.
///
/// # Errors
/// `Internal`, with the reason of the last draw, if none of a dozen passes.
///
/// ```
/// use gripcast_synth::family::{Category, family_shape};
/// let mug = family_shape(Category::parse("mug")?, 7)?;
/// assert!(mug.edges().is_closed());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn family_shape(category: Category, seed: u64) -> Result<TriangleMesh> {
    let mut rejected = 0;
    loop {
        let name = format!("family/{}/{rejected}", category.name());
        let mut draw = Draw(SeedStream::named(seed, &name));
        match category.draw(&mut draw).and_then(shape::finish) {
            Ok(mesh) => return Ok(mesh),
            Err(e) if rejected + 1 == ATTEMPTS => {
                return Err(e.at(format!("shape {seed} of the family {}", category.name())));
            }
            Err(_) => rejected += 1,
        }
    }
}

#[cfg(test)]
#[path = "family_test.rs"]
mod tests;
