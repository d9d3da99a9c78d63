//! The plan file and its hash.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{PlanHeader, PlannedObject, PlannedSimulation};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Printable, Root, SimulationId, sha256_hex};

/// Name of the plan file.
pub const PLAN_FILE: &str = "plan.jsonl";
/// Name of the hash file, as `sha256sum --check` reads it.
pub const HASH_FILE: &str = "plan.sha256";
/// Name of the format in the header.
pub const PLAN_FORMAT: &str = "gripcast-synth-plan";
/// Version of the format.
pub const PLAN_VERSION: u32 = 1;

/// One line of the file.
#[derive(Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Line {
    Plan(PlanHeader),
    Object(PlannedObject),
    Simulation(PlannedSimulation),
}

/// A plan. It never changes: results and datasets refer to it by its hash.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Header.
    pub header: PlanHeader,
    /// Objects by name.
    pub objects: BTreeMap<SimulationId, PlannedObject>,
    /// Simulations by object, grasp and force.
    pub simulations: Vec<PlannedSimulation>,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
}

impl Plan {
    /// Creates a plan and computes its hash.
    ///
    /// # Errors
    /// `Input` for a simulation of an unknown object or a duplicate id; `Internal` if a number has
    /// no JSON representation.
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
    /// `NotFound` for a folder without a plan; `Input` for an invalid or altered plan, or one of
    /// another version.
    pub fn read(folder: &Path) -> Result<Self> {
        let root = Root::new(folder);
        let place = root.top().join(PLAN_FILE);
        let bytes = place.read(FileKind::List).map_err(|e| {
            Error::io("cannot read the plan", e)
                .at(place.display())
                .remedy("create one: gripcast synth plan --preset small --out DIR")
        })?;
        let sha256 = verified_hash(&root, &bytes).map_err(|e| e.at(place.display()))?;
        let plan = Self::from_bytes(&bytes).map_err(|e| e.at(place.display()))?;
        // The hash of the file, not of how this build would format its numbers.
        Ok(Self { sha256, ..plan })
    }

    /// Writes the plan and its hash into an existing folder.
    ///
    /// # Errors
    /// `Input` if the folder contains another plan; I/O errors.
    pub(super) fn write(&self, root: &Root) -> Result<()> {
        self.check_output(root)?;
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
    /// `Input` if there is one; I/O errors.
    pub(super) fn check_output(&self, root: &Root) -> Result<()> {
        let place = root.top().join(PLAN_FILE);
        if !place.is_taken() {
            return Ok(());
        }
        let existing = place
            .read(FileKind::List)
            .map_err(|e| Error::io("cannot read the plan", e).at(place.display()))?;
        if existing == self.text()?.as_bytes() {
            return Ok(());
        }
        Err(Error::input("the folder contains another plan")
            .at(place.display())
            .remedy("name a new folder: results belong to one plan"))
    }

    /// The object of a simulation.
    ///
    /// # Errors
    /// `Internal` for a simulation of another plan.
    pub fn object(&self, simulation: &PlannedSimulation) -> Result<&PlannedObject> {
        self.objects
            .get(&simulation.object)
            .ok_or_else(|| Error::internal(format!("{} is not part of this plan", simulation.id)))
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

    /// Parses the bytes of a plan file, without checking its hash.
    ///
    /// # Errors
    /// `Input` with the number of an invalid line, and for what [`Plan::new`] refuses.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let invalid = |number: usize, what: String| {
            Error::input(format!("line {number}: {what}"))
                .remedy("create the plan again with the same flags: it will be identical")
        };
        let mut header = None;
        let mut objects = Vec::new();
        let mut simulations = Vec::new();
        for (number, line) in bytes.split(|b| *b == b'\n').enumerate() {
            let number = number + 1;
            if line.is_empty() {
                continue;
            }
            let line = serde_json::from_slice(line).map_err(|e| invalid(number, e.to_string()))?;
            match line {
                Line::Plan(found) if header.is_none() => header = Some(check_version(found)?),
                Line::Plan(_) => return Err(invalid(number, "duplicate header".to_owned())),
                Line::Object(object) => objects.push(object),
                Line::Simulation(simulation) => simulations.push(simulation),
            }
        }
        let header = header.ok_or_else(|| invalid(1, "the header is missing".to_owned()))?;
        Self::new(header, objects, simulations)
    }

    fn check(&self) -> Result<()> {
        let mut ids: Vec<&str> = self.simulations.iter().map(|s| s.id.as_str()).collect();
        ids.sort_unstable();
        if let Some(pair) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
            let what = format!("two simulations are named {}", pair[0]);
            return Err(Error::input(what));
        }
        let unknown = |s: &&PlannedSimulation| !self.objects.contains_key(&s.object);
        if let Some(unknown) = self.simulations.iter().find(unknown) {
            let what = format!("{} has the unknown object {}", unknown.id, unknown.object);
            return Err(Error::input(what));
        }
        Ok(())
    }
}

/// Refuses a header of another format or version.
fn check_version(header: PlanHeader) -> Result<PlanHeader> {
    if header.format == PLAN_FORMAT && header.version == PLAN_VERSION {
        return Ok(header);
    }
    let (format, version) = (Printable(&header.format), header.version);
    let what =
        format!("expected {PLAN_FORMAT} version {PLAN_VERSION}, found {format} version {version}");
    Err(Error::input(what).remedy(
        "create the plan again with the same flags in a new folder, or use the version of gripcast \
         that created it",
    ))
}

/// Replaces a file atomically.
pub(crate) fn replace(place: &BeneathPath, bytes: &[u8]) -> Result<()> {
    place
        .replace(bytes)
        .map_err(|e| Error::io("cannot write the file", e).at(place.display()))
}

/// Checks the plan file against its hash and returns the hash.
fn verified_hash(root: &Root, plan: &[u8]) -> Result<String> {
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
        "the plan was altered: expected SHA-256 {}, found {found}",
        Printable(expected)
    ))
    .remedy("restore it, or create a new plan in another folder; results belong to one plan"))
}
