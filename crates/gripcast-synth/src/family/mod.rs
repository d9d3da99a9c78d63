//! Built-in families of objects that people pick up from a table: hundreds of distinct closed
//! meshes for each category from a seed, so that a synthetic dataset can be made offline.
//!
//! Bodies are turned, cut out of plates, or blended from parts given by their signed
//! distance; none needs boolean operations on meshes.

mod block;
mod bottle;
mod bowl;
mod bracket;
mod can;
mod carton;
mod category;
mod cutlery;
mod draw;
mod fastener;
mod figure;
mod fruit;
mod knob;
mod lathe;
mod mug;
mod outline;
mod pen;
mod plate;
mod ring;
mod shape;
mod sheet;
mod solid;
mod tool;
mod toy;
mod tube;

pub use category::Category;
pub use draw::Parameter;

use serde::{Deserialize, Serialize};

use self::draw::Draw;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::TriangleMesh;

/// Draws of a shape that are tried until one passes its checks.
const ATTEMPTS: u32 = 12;

/// What a shape was made from, for the record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShapeRecord {
    /// Family.
    pub category: Category,
    /// Seed of the shape.
    pub seed: u64,
    /// Kind within the family, such as "spoon".
    pub form: String,
    /// Draws before this one that failed their checks.
    pub rejected: u32,
    /// Drawn numbers in the order of drawing.
    pub parameters: Vec<Parameter>,
}

/// A shape of a family.
#[derive(Clone, Debug, PartialEq)]
pub struct FamilyShape {
    /// Where it comes from.
    pub record: ShapeRecord,
    /// Closed, connected, free of self-intersections, counter-clockwise seen from outside; the
    /// bounding box is centred in the origin, z up in the natural pose, m.
    pub mesh: TriangleMesh,
}

/// The shape of a category for a seed: 2 to 15 cm long, with at most 8000 triangles, most of whose
/// sides are 2 to 4 mm. Equal on all machines.
///
/// A draw that does not pass the checks is replaced by the next one of the same seed.
///
/// # Errors
/// `Internal`, with the reason of the last draw, if none of a dozen passes.
///
/// ```
/// use gripcast_synth::family::{Category, family_shape};
/// let mug = family_shape(Category::Mug, 7)?;
/// assert!(mug.mesh.edges().is_closed());
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn family_shape(category: Category, seed: u64) -> Result<FamilyShape> {
    let mut rejected = 0;
    loop {
        let name = format!("family/{}/{rejected}", category.name());
        let mut draw = Draw::new(SeedStream::named(seed, &name));
        match category.draw(&mut draw).and_then(shape::finished) {
            Ok(mesh) => {
                let (form, parameters) = draw.into_record();
                let record = ShapeRecord {
                    category,
                    seed,
                    form: form.to_string(),
                    rejected,
                    parameters,
                };
                return Ok(FamilyShape { record, mesh });
            }
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
