//! The families, what they are made of and how full they are.

use serde::{Deserialize, Serialize};

use super::draw::Draw;
use super::script::{self, Formula};
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

/// Names in the order of the categories.
const NAMES: [&str; 18] = [
    "box", "block", "bottle", "can", "bowl", "mug", "tube", "ring", "tool", "cutlery", "pen",
    "fastener", "bracket", "knob", "toy", "sheet", "fruit", "figure",
];

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
        NAMES[self as usize]
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
        found.ok_or_else(|| unknown_name("category", name, &NAMES))
    }

    /// Names of materials that such objects are made of, the commonest first.
    pub fn materials(self) -> Vec<&'static str> {
        let materials = script::header(self.text(), "materials");
        let names = materials.iter().filter_map(|material| match material {
            Formula::Form(name) => Some(*name),
            _ => None,
        });
        names.collect()
    }

    /// Part of the enclosed volume that is material: from, to. Closed vessels and cartons are
    /// modelled by their outer surface, so their walls and contents are a part of it.
    pub fn fill(self) -> (f64, f64) {
        match script::header(self.text(), "fill")[..] {
            [Formula::Number(low), Formula::Number(high)] => (low, high),
            _ => (1.0, 1.0),
        }
    }

    /// Its file: materials, fill and for most the shape.
    fn text(self) -> &'static str {
        match self {
            Self::Box => include_str!("shapes/box.shape"),
            Self::Block => include_str!("shapes/block.shape"),
            Self::Bottle => include_str!("shapes/bottle.shape"),
            Self::Can => include_str!("shapes/can.shape"),
            Self::Bowl => include_str!("shapes/bowl.shape"),
            Self::Mug => include_str!("shapes/mug.shape"),
            Self::Tube => include_str!("shapes/tube.shape"),
            Self::Ring => include_str!("shapes/ring.shape"),
            Self::Tool => include_str!("shapes/tool.shape"),
            Self::Cutlery => include_str!("shapes/cutlery.shape"),
            Self::Pen => include_str!("shapes/pen.shape"),
            Self::Fastener => include_str!("shapes/fastener.shape"),
            Self::Bracket => include_str!("shapes/bracket.shape"),
            Self::Knob => include_str!("shapes/knob.shape"),
            Self::Toy => include_str!("shapes/toy.shape"),
            Self::Sheet => include_str!("shapes/sheet.shape"),
            Self::Fruit => include_str!("shapes/fruit.shape"),
            Self::Figure => include_str!("shapes/figure.shape"),
        }
    }

    /// Draws a shape of the family.
    pub(super) fn draw(self, draw: &mut Draw) -> Result<TriangleMesh> {
        match self {
            Self::Bowl => super::bowl::draw(draw),
            Self::Mug => super::mug::draw(draw),
            Self::Toy => super::toy::draw(draw),
            _ => super::scripted::draw(self.text(), draw),
        }
    }
}
