//! The families, what they are made of and how full they are.

use serde::{Deserialize, Serialize};

use super::draw::Draw;
use gripcast_base::error::{Result, unknown_name};
use gripcast_geometry::TriangleMesh;

/// A family of shapes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Category {
    /// Cartons, books, bars of soap, tapered boxes.
    Box,
    /// Toy blocks: wedges, arches, prisms, crosses, twisted columns.
    Block,
    /// Closed bottles: round, square, waisted, flat, with a dropper.
    Bottle,
    /// Cans, jars, tins and open cups.
    Can,
    /// Bowls, dishes and saucers.
    Bowl,
    /// Mugs, tea cups and tankards with a handle.
    Mug,
    /// Pipes, caps, elbows, tees, squeeze tubes, rolls.
    Tube,
    /// Rings, bands, chain links, gaskets.
    Ring,
    /// Screwdrivers, hammers, wrenches, scrapers, clamps, hexagon keys.
    Tool,
    /// Spoons, forks, knives, spatulas.
    Cutlery,
    /// Pencils, markers, brushes, candles.
    Pen,
    /// Bolts, nuts, gears, spacers.
    Fastener,
    /// Bent and flat brackets with holes, flanges.
    Bracket,
    /// Knobs, star handles, door knobs.
    Knob,
    /// Random bodies of graded complexity.
    Toy,
    /// Cards, trays, coasters, bent and wavy sheets.
    Sheet,
    /// Fruit and vegetables.
    Fruit,
    /// Animals and people.
    Figure,
}

impl Category {
    /// All categories.
    pub const ALL: [Self; 18] = [
        Self::Box,
        Self::Block,
        Self::Bottle,
        Self::Can,
        Self::Bowl,
        Self::Mug,
        Self::Tube,
        Self::Ring,
        Self::Tool,
        Self::Cutlery,
        Self::Pen,
        Self::Fastener,
        Self::Bracket,
        Self::Knob,
        Self::Toy,
        Self::Sheet,
        Self::Fruit,
        Self::Figure,
    ];

    /// Its name, in lower case.
    pub fn name(self) -> &'static str {
        self.about().0
    }

    /// The category of a name.
    ///
    /// # Errors
    /// `Usage` for another name; the remedy has the nearest and lists all.
    ///
    /// ```
    /// use gripcast_synth::family::Category;
    /// assert_eq!(Category::parse("ring")?, Category::Ring);
    /// # Ok::<(), gripcast_base::error::Error>(())
    /// ```
    pub fn parse(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|c| c.name() == name);
        found.ok_or_else(|| unknown_name("category", name, &Self::ALL.map(Self::name)))
    }

    /// Names of materials that such objects are made of, the commonest first.
    pub fn materials(self) -> &'static [&'static str] {
        self.about().1
    }

    /// Part of the enclosed volume that is material: from, to. Closed vessels and cartons are
    /// modelled by their outer surface, so their walls and contents are a part of it.
    pub fn fill(self) -> (f64, f64) {
        self.about().2
    }

    /// Name, materials, fill.
    fn about(self) -> (&'static str, &'static [&'static str], (f64, f64)) {
        match self {
            Self::Box => (
                "box",
                &["cardboard", "paper", "wood", "wax", "foam"],
                (0.1, 0.6),
            ),
            Self::Block => ("block", &["wood", "abs", "foam", "stone"], (0.3, 1.0)),
            Self::Bottle => (
                "bottle",
                &["polyethylene", "pet", "glass", "aluminium"],
                (0.1, 0.5),
            ),
            Self::Can => (
                "can",
                &["steel", "aluminium", "glass", "polypropylene", "paper"],
                (0.1, 0.5),
            ),
            Self::Bowl => (
                "bowl",
                &["ceramic", "wood", "polypropylene", "glass", "steel"],
                (1.0, 1.0),
            ),
            Self::Mug => ("mug", &["ceramic", "glass", "abs", "steel"], (1.0, 1.0)),
            Self::Tube => (
                "tube",
                &["pvc", "cardboard", "copper", "steel", "rubber"],
                (0.5, 1.0),
            ),
            Self::Ring => (
                "ring",
                &["rubber", "steel", "wood", "abs", "brass"],
                (0.8, 1.0),
            ),
            Self::Tool => ("tool", &["steel", "abs", "wood", "rubber"], (0.4, 1.0)),
            Self::Cutlery => (
                "cutlery",
                &["steel", "wood", "polypropylene", "bamboo"],
                (0.8, 1.0),
            ),
            Self::Pen => ("pen", &["wood", "abs", "wax", "aluminium"], (0.4, 1.0)),
            Self::Fastener => (
                "fastener",
                &["steel", "brass", "nylon", "aluminium"],
                (0.9, 1.0),
            ),
            Self::Bracket => (
                "bracket",
                &["steel", "aluminium", "abs", "brass"],
                (0.6, 1.0),
            ),
            Self::Knob => (
                "knob",
                &["abs", "brass", "wood", "rubber", "aluminium"],
                (0.4, 1.0),
            ),
            Self::Toy => ("toy", &["abs", "pla", "rubber", "wood"], (0.1, 0.6)),
            Self::Sheet => (
                "sheet",
                &["cardboard", "wood", "acrylic", "aluminium", "cork"],
                (0.7, 1.0),
            ),
            Self::Fruit => ("fruit", &["fruit flesh", "wax", "foam", "wood"], (0.8, 1.0)),
            Self::Figure => (
                "figure",
                &["abs", "rubber", "fabric", "wood", "ceramic"],
                (0.1, 0.6),
            ),
        }
    }

    /// Draws a shape of the family.
    pub(super) fn draw(self, draw: &mut Draw) -> Result<TriangleMesh> {
        match self {
            Self::Box => super::carton::draw(draw),
            Self::Block => super::block::draw(draw),
            Self::Bottle => super::bottle::draw(draw),
            Self::Can => super::can::draw(draw),
            Self::Bowl => super::bowl::draw(draw),
            Self::Mug => super::mug::draw(draw),
            Self::Tube => super::tube::draw(draw),
            Self::Ring => super::ring::draw(draw),
            Self::Tool => super::tool::draw(draw),
            Self::Cutlery => super::cutlery::draw(draw),
            Self::Pen => super::pen::draw(draw),
            Self::Fastener => super::fastener::draw(draw),
            Self::Bracket => super::bracket::draw(draw),
            Self::Knob => super::knob::draw(draw),
            Self::Toy => super::toy::draw(draw),
            Self::Sheet => super::sheet::draw(draw),
            Self::Fruit => super::fruit::draw(draw),
            Self::Figure => super::figure::draw(draw),
        }
    }
}
