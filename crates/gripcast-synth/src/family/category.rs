//! The families: names, materials and fills.

use super::draw::Draw;
use super::script::{self, Formula};
use gripcast_base::error::{Result, unknown_name};
use gripcast_geometry::TriangleMesh;

/// Name and file of each family. The order is that of the objects of a plan.
const FAMILIES: [(&str, &str); 18] = [
    ("box", include_str!("shapes/box.shape")),
    ("block", include_str!("shapes/block.shape")),
    ("bottle", include_str!("shapes/bottle.shape")),
    ("can", include_str!("shapes/can.shape")),
    ("bowl", include_str!("shapes/bowl.shape")),
    ("mug", include_str!("shapes/mug.shape")),
    ("tube", include_str!("shapes/tube.shape")),
    ("ring", include_str!("shapes/ring.shape")),
    ("tool", include_str!("shapes/tool.shape")),
    ("cutlery", include_str!("shapes/cutlery.shape")),
    ("pen", include_str!("shapes/pen.shape")),
    ("fastener", include_str!("shapes/fastener.shape")),
    ("bracket", include_str!("shapes/bracket.shape")),
    ("knob", include_str!("shapes/knob.shape")),
    ("toy", include_str!("shapes/toy.shape")),
    ("sheet", include_str!("shapes/sheet.shape")),
    ("fruit", include_str!("shapes/fruit.shape")),
    ("figure", include_str!("shapes/figure.shape")),
];

/// A family of shapes, for instance `mug`; the files in `shapes` describe them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Category(usize);

impl Category {
    /// Number of categories.
    pub const COUNT: usize = FAMILIES.len();

    /// Returns all categories.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..Self::COUNT).map(Self)
    }

    /// Returns the category of an object's number; numbers cycle through the categories.
    pub fn cycled(number: usize) -> Self {
        Self(number % Self::COUNT)
    }

    /// Name in lower case.
    pub fn name(self) -> &'static str {
        FAMILIES[self.0].0
    }

    /// Finds a category by name.
    ///
    /// # Errors
    /// `Usage` for an unknown name; the remedy suggests the nearest and lists all.
    ///
    /// ```
    /// use gripcast_synth::family::Category;
    /// assert_eq!(Category::parse("ring")?.name(), "ring");
    /// # Ok::<(), gripcast_base::error::Error>(())
    /// ```
    pub fn parse(name: &str) -> Result<Self> {
        let found = Self::all().find(|category| category.name() == name);
        found.ok_or_else(|| unknown_name("category", name, &FAMILIES.map(|(name, _)| name)))
    }

    /// Names of typical materials, the most common first.
    pub fn materials(self) -> Vec<&'static str> {
        let materials = script::header(self.text(), "materials");
        let names = materials.iter().filter_map(|material| match material {
            Formula::Form(name) => Some(*name),
            _ => None,
        });
        names.collect()
    }

    /// Minimum and maximum fraction of the enclosed volume that is material. Closed vessels and
    /// cartons are modelled by their outer surface, so their fill is that of walls and contents.
    pub fn fill(self) -> (f64, f64) {
        match script::header(self.text(), "fill")[..] {
            [Formula::Number(low), Formula::Number(high)] => (low, high),
            _ => (1.0, 1.0),
        }
    }

    /// Its file: materials, fill and usually the shape.
    fn text(self) -> &'static str {
        FAMILIES[self.0].1
    }

    /// Draws a shape of the family.
    pub(super) fn draw(self, draw: &mut Draw) -> Result<TriangleMesh> {
        match self.name() {
            "bowl" => super::bowl::draw(draw),
            "mug" => super::mug::draw(draw),
            "toy" => super::toy::draw(draw),
            _ => super::scripted::draw(self.text(), draw),
        }
    }
}
