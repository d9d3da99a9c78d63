//! The plan as a file, and the hash that says that it is the one that was made.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{PlanHeader, PlannedObject, PlannedSimulation};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Printable, Root, SimulationId, sha256_hex};

/// Name of the plan in its folder.
pub const PLAN_FILE: &str = "plan.jsonl";
/// Name of its hash, as `sha256sum --check` reads it.
pub const HASH_FILE: &str = "plan.sha256";
/// Name of the format in the header.
pub const PLAN_FORMAT: &str = "gripcast-synth-plan";
/// Its version.
pub const PLAN_VERSION: u32 = 1;

/// A line of the file.
#[derive(Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Line {
    Plan(PlanHeader),
    Object(PlannedObject),
    Simulation(PlannedSimulation),
}

/// What is to be simulated. A plan never changes: what is made of it is known by its hash.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// What all simulations fraction.
    pub header: PlanHeader,
    /// Objects by name.
    pub objects: BTreeMap<SimulationId, PlannedObject>,
    /// Simulations by object, grasp and force.
    pub simulations: Vec<PlannedSimulation>,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
}

impl Plan {
    /// A plan of its parts.
    ///
    /// # Errors
    /// `Input` for a simulation of an unknown object, or two of a name; `Internal` where a number
    /// has no JSON form.
    pub fn new(
        header: PlanHeader,
        objects: Vec<PlannedObject>,
        simulations: Vec<PlannedSimulation>,
    ) -> Result<Self> {
        let objects = objects.into_iter().map(|o| (o.name.clone(), o)).collect();
        let mut plan = Self {
            header,
            objects,
            simulations,
            sha256: String::new(),
        };
        plan.check()?;
        plan.sha256 = sha256_hex(plan.text()?);
        Ok(plan)
    }

    /// Reads the plan of a folder.
    ///
    /// # Errors
    /// `NotFound` for a folder without plan; `Input` for one that was altered, or is of another
    /// version, or is no plan.
    pub fn read(folder: &Path) -> Result<Self> {
        let root = Root::new(folder);
        let place = root.top().join(PLAN_FILE);
        let bytes = place.read(FileKind::List).map_err(|e| {
            Error::io("cannot read the plan", e)
                .at(place.display())
                .remedy("make one: gripcast synth plan --preset small --out DIR")
        })?;
        let sha256 = checked_hash(&root, &bytes).map_err(|e| e.at(place.display()))?;
        let plan = Self::from_bytes(&bytes).map_err(|e| e.at(place.display()))?;
        // That of the file, whoever wrote its numbers.
        Ok(Self { sha256, ..plan })
    }

    /// Writes the plan and its hash into a folder that exists.
    ///
    /// # Errors
    /// `Input` where another plan is there; those of the operating system.
    pub(super) fn write(&self, root: &Root) -> Result<()> {
        self.check_free(root)?;
        let place = root.top().join(PLAN_FILE);
        if !place.is_taken() {
            replace(&place, self.text()?.as_bytes())?;
        }
        let hash = format!("{}  {PLAN_FILE}\n", self.sha256);
        replace(&root.top().join(HASH_FILE), hash.as_bytes())
    }

    /// Refuses a folder with another plan.
    ///
    /// # Errors
    /// `Input` where there is one; those of the operating system.
    pub(super) fn check_free(&self, root: &Root) -> Result<()> {
        let place = root.top().join(PLAN_FILE);
        if !place.is_taken() {
            return Ok(());
        }
        let there = place
            .read(FileKind::List)
            .map_err(|e| Error::io("cannot read the plan", e).at(place.display()))?;
        if there == self.text()?.as_bytes() {
            return Ok(());
        }
        Err(Error::input("another plan is in the folder already")
            .at(place.display())
            .remedy("give a new folder: results belong to the plan they were made of"))
    }

    /// The object of a simulation.
    ///
    /// # Errors
    /// `Internal` for a simulation that is not of this plan.
    pub fn object(&self, simulation: &PlannedSimulation) -> Result<&PlannedObject> {
        self.objects.get(&simulation.object).ok_or_else(|| {
            let what = format!("{} is not of this plan", simulation.id);
            Error::internal(what)
        })
    }

    fn text(&self) -> Result<String> {
        let mut text = String::new();
        let mut line = |line: &Line| -> Result<()> {
            let json = serde_json::to_string(line)
                .map_err(|e| Error::internal("cannot write JSON").because(e))?;
            text.push_str(&json);
            text.push('\n');
            Ok(())
        };
        line(&Line::Plan(self.header.clone()))?;
        for object in self.objects.values() {
            line(&Line::Object(object.clone()))?;
        }
        for simulation in &self.simulations {
            line(&Line::Simulation(simulation.clone()))?;
        }
        Ok(text)
    }

    /// Reads the bytes of a plan's file, without its hash.
    ///
    /// # Errors
    /// `Input` with the line that is none of a plan, and for what [`Plan::new`] refuses.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let wrong = |number: usize, what: String| {
            Error::input(format!("line {number}: {what}"))
                .remedy("make the plan again with the same flags: it comes out the same")
        };
        let mut header = None;
        let mut objects = Vec::new();
        let mut simulations = Vec::new();
        for (number, line) in bytes.split(|b| *b == b'\n').enumerate() {
            let number = number + 1;
            if line.is_empty() {
                continue;
            }
            let line = serde_json::from_slice(line).map_err(|e| wrong(number, e.to_string()))?;
            match line {
                Line::Plan(found) if header.is_none() => header = Some(checked(found)?),
                Line::Plan(_) => return Err(wrong(number, "a second header".to_owned())),
                Line::Object(object) => objects.push(object),
                Line::Simulation(simulation) => simulations.push(simulation),
            }
        }
        let header = header.ok_or_else(|| wrong(1, "the header is missing".to_owned()))?;
        Self::new(header, objects, simulations)
    }

    fn check(&self) -> Result<()> {
        let mut ids: Vec<&str> = self.simulations.iter().map(|s| s.id.as_str()).collect();
        ids.sort_unstable();
        if let Some(twice) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
            let what = format!("two simulations are named {}", twice[0]);
            return Err(Error::input(what));
        }
        let unknown = |s: &&PlannedSimulation| !self.objects.contains_key(&s.object);
        if let Some(unknown) = self.simulations.iter().find(unknown) {
            let what = format!("{} is of the unknown object {}", unknown.id, unknown.object);
            return Err(Error::input(what));
        }
        Ok(())
    }
}

/// A header of this version.
fn checked(header: PlanHeader) -> Result<PlanHeader> {
    if header.format == PLAN_FORMAT && header.version == PLAN_VERSION {
        return Ok(header);
    }
    let (format, version) = (Printable(&header.format), header.version);
    let what =
        format!("expected {PLAN_FORMAT} version {PLAN_VERSION}, found {format} version {version}");
    Err(Error::input(what).remedy(
        "make the plan again with the same flags, in a new folder; or read it with the release of \
         gripcast that made it",
    ))
}

/// Replaces a file of the plan.
pub(crate) fn replace(place: &BeneathPath, bytes: &[u8]) -> Result<()> {
    place
        .replace(bytes)
        .map_err(|e| Error::io("cannot write the file", e).at(place.display()))
}

/// Hash of a plan's file, which is as it was written.
fn checked_hash(root: &Root, plan: &[u8]) -> Result<String> {
    let place = root.top().join(HASH_FILE);
    let text = place
        .read_to_string(FileKind::Record)
        .map_err(|e| Error::io("cannot read the hash of the plan", e).at(place.display()))?;
    let expected = text.split_whitespace().next().unwrap_or_default();
    let found = sha256_hex(plan);
    if expected == found {
        return Ok(found);
    }
    Err(Error::input(format!(
        "the plan was altered: expected the hash {}, found {found}",
        Printable(expected)
    ))
    .remedy("restore it, or make a new plan in another folder; results belong to one plan"))
}
