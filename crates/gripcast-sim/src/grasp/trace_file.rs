//! Trace files: JSON for people and scripts, a compact binary form for renderers.
//!
//! # Binary form, versions 1 and 2
//! All numbers little-endian, floats IEEE 754 `f64`, no padding but the zeros listed.
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | magic `89 47 43 54 0d 0a 1a 0a` (`\x89GCT\r\n\x1a\n`: reveals damage by text-mode copies) |
//! | u32 | version: 1, or 2 with fields |
//! | u32 | length H of the header |
//! | u64 | number of steps |
//! | u32 | number of snapshots |
//! | u32 | bytes of one step, 184 |
//! | H | header: one JSON object in UTF-8, the result of the grasp with its parameters |
//! | … | the steps, then the snapshots, in version 2 the records of the fields; then the file ends |
//!
//! A step is: u8 stage (0 closure, 1 adjustment, 2 lift) · u8 flags (1 has a solver report, 2
//! converged, 4 has a left gap, 8 has a right gap) · u16 zero · u32 iterations, factorisations,
//! halvings, broad-phase rebuilds, zero · f64 time, opening, lift · left gel: normal force, shear
//! along y and z, torque · right gel: the same · left and right gap (0 if absent) · object pose:
//! translation x y z, quaternion w x y z.
//!
//! The records are those of [`crate::fields`]; `fields` in the header describes them. A trace
//! without fields is written in version 1.
//!
//! A snapshot is: u8 stage · 3 zero bytes · u32 nodes of the left gel, of the right gel, zero · f64
//! time, opening · object pose · gripper pose · node positions x y z of the left gel, of the right.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
use crate::fields::FieldSeries;
use crate::solver::StepReport;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

const MAGIC: [u8; 8] = *b"\x89GCT\r\n\x1a\n";
const VERSION: u32 = 1;
/// Version of a binary trace with fields.
const VERSION_WITH_FIELDS: u32 = 2;
const FORMAT: &str = "gripcast-trace";
const STEP_BYTES: usize = 24 + 20 * 8;

const SOLVED: u8 = 1;
const CONVERGED: u8 = 2;
const LEFT_GAP: u8 = 4;
const RIGHT_GAP: u8 = 8;

/// A trace with the result of its grasp.
#[derive(Clone, Debug)]
pub struct TraceFile {
    /// Result and parameters of the grasp: a JSON object.
    pub header: Value,
    /// All steps and snapshots.
    pub trace: Trace,
}

impl TraceFile {
    /// Encodes as one JSON object: `{"format", "version", "result", "steps", "snapshots"}`.
    ///
    /// # Errors
    /// `Usage` for a trace with fields: as text they are six times as large, and numpy cannot map
    /// them. `Internal` for a number that JSON cannot represent.
    pub fn to_json(&self) -> Result<Vec<u8>> {
        if self.trace.fields.is_some() {
            return Err(Error::usage("fields are written in binary traces only")
                .remedy("write the trace to a file that ends in .bin"));
        }
        #[derive(Serialize)]
        struct Document<'a> {
            format: &'static str,
            version: u32,
            result: &'a Value,
            #[serde(flatten)]
            trace: &'a Trace,
        }
        let document = Document {
            format: FORMAT,
            version: VERSION,
            result: &self.header,
            trace: &self.trace,
        };
        serde_json::to_vec(&document)
            .map_err(|e| Error::internal("cannot write the trace").because(e))
    }

    /// Encodes in the binary form.
    ///
    /// # Errors
    /// `Internal` if the header cannot be encoded or there are more than 2³² items.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let (version, header) = match &self.trace.fields {
            None => (VERSION, serde_json::to_vec(&self.header)),
            Some(fields) => {
                let mut header = self.header.clone();
                header["fields"] = fields.description();
                (VERSION_WITH_FIELDS, serde_json::to_vec(&header))
            }
        };
        let header = header.map_err(|e| Error::internal("cannot write the trace").because(e))?;
        let mut out = Writer(Vec::new());
        out.0.extend(MAGIC);
        out.u32(version);
        out.count(header.len())?;
        out.0.extend((self.trace.steps.len() as u64).to_le_bytes());
        out.count(self.trace.snapshots.len())?;
        out.count(STEP_BYTES)?;
        out.0.extend(header);
        for step in &self.trace.steps {
            out.step(step);
        }
        for snapshot in &self.trace.snapshots {
            out.snapshot(snapshot)?;
        }
        if let Some(fields) = &self.trace.fields {
            fields.write(&mut out.0);
        }
        Ok(out.0)
    }

    /// Reads a trace in either form.
    ///
    /// # Errors
    /// `Input` if the bytes are not a trace, of another version, or truncated.
    pub fn read(bytes: &[u8]) -> Result<Self> {
        if bytes.trim_ascii_start().starts_with(b"{") {
            Self::from_json(bytes)
        } else {
            Self::from_bytes(bytes)
        }
    }

    /// Reads the JSON form.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_json(bytes: &[u8]) -> Result<Self> {
        #[derive(Deserialize)]
        struct Head {
            format: String,
            version: u32,
        }
        #[derive(Deserialize)]
        struct Document {
            result: Value,
            #[serde(flatten)]
            trace: Trace,
        }
        let head: Head = serde_json::from_slice(bytes)
            .map_err(|e| not_a_trace("not a grasp trace").because(e))?;
        if head.format != FORMAT {
            return Err(not_a_trace(&format!(
                "expected the format `{FORMAT}`, found `{}`",
                head.format
            )));
        }
        check_version(head.version, &[VERSION])?;
        let document: Document = serde_json::from_slice(bytes)
            .map_err(|e| damaged("invalid content".into()).because(e))?;
        Ok(Self {
            header: document.result,
            trace: document.trace,
        })
    }

    /// Reads the binary form.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let mut reader = Reader { bytes, position: 0 };
        if !bytes.starts_with(&MAGIC[..bytes.len().min(MAGIC.len())]) {
            return Err(not_a_trace("not a grasp trace"));
        }
        reader.take(MAGIC.len())?;
        let version = reader.u32()?;
        check_version(version, &[VERSION, VERSION_WITH_FIELDS])?;
        let header_bytes = reader.u32()? as usize;
        let step_count = reader.u64()?;
        let snapshot_count = reader.u32()?;
        let step_bytes = reader.u32()?;
        if step_bytes as usize != STEP_BYTES {
            return Err(damaged(format!(
                "expected {STEP_BYTES} bytes per step, found {step_bytes}"
            )));
        }
        let mut header: Value = serde_json::from_slice(reader.take(header_bytes)?)
            .map_err(|e| damaged("the header is not valid JSON".into()).because(e))?;
        let mut trace = Trace::default();
        for _ in 0..step_count {
            trace.steps.push(reader.step()?);
        }
        for _ in 0..snapshot_count {
            trace.snapshots.push(reader.snapshot()?);
        }
        let rest = &bytes[reader.position..];
        if version == VERSION_WITH_FIELDS {
            let description = header
                .as_object_mut()
                .and_then(|header| header.remove("fields"))
                .unwrap_or_default();
            trace.fields = Some(FieldSeries::read(&description, rest)?);
        } else if !rest.is_empty() {
            return Err(damaged(format!("{} bytes after the end", rest.len())));
        }
        Ok(Self { header, trace })
    }
}

fn not_a_trace(what: &str) -> Error {
    Error::input(what).remedy("write a trace with `gripcast sim grasp … --trace FILE.bin`")
}

fn check_version(version: u32, known: &[u32]) -> Result<()> {
    if known.contains(&version) {
        return Ok(());
    }
    let known: Vec<String> = known.iter().map(u32::to_string).collect();
    let known = known.join(" or ");
    Err(
        Error::input(format!("expected trace version {known}, found {version}"))
            .remedy("read it with the gripcast that wrote it, or simulate the grasp again"),
    )
}

fn damaged(what: String) -> Error {
    Error::input(format!("the trace is damaged: {what}"))
        .remedy("check that the file was copied completely, or simulate the grasp again")
}

struct Writer(Vec<u8>);

impl Writer {
    fn u32(&mut self, value: u32) {
        self.0.extend(value.to_le_bytes());
    }

    fn count(&mut self, value: usize) -> Result<()> {
        let value =
            u32::try_from(value).map_err(|_| Error::internal("the trace has too many items"))?;
        self.u32(value);
        Ok(())
    }

    fn floats(&mut self, values: impl IntoIterator<Item = f64>) {
        for value in values {
            self.0.extend(value.to_le_bytes());
        }
    }

    fn pose(&mut self, pose: &Pose) {
        let q = pose.rotation;
        self.floats(pose.translation_m.to_array());
        self.floats([q.w, q.x, q.y, q.z]);
    }

    fn step(&mut self, step: &TraceStep) {
        let solver = step.solver.unwrap_or_default();
        let [left, right] = step.min_gap_m;
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        let flags = flag(step.solver.is_some(), SOLVED)
            | flag(solver.converged, CONVERGED)
            | flag(left.is_some(), LEFT_GAP)
            | flag(right.is_some(), RIGHT_GAP);
        self.0.extend([step.stage as u8, flags, 0, 0]);
        self.u32(solver.iterations);
        self.u32(solver.factorisations);
        self.u32(solver.halvings);
        self.u32(solver.broad_phase_rebuilds);
        self.u32(0);
        self.floats([step.t_s, step.opening_m, step.lifted_m]);
        for force in &step.force {
            let [y, z] = force.shear_n;
            self.floats([force.normal_n, y, z, force.torque_n_m]);
        }
        self.floats([left.unwrap_or(0.0), right.unwrap_or(0.0)]);
        self.pose(&step.t_world_object);
    }

    fn snapshot(&mut self, snapshot: &Snapshot) -> Result<()> {
        self.0.extend([snapshot.stage as u8, 0, 0, 0]);
        for gel in &snapshot.gels {
            self.count(gel.len())?;
        }
        self.u32(0);
        self.floats([snapshot.t_s, snapshot.opening_m]);
        self.pose(&snapshot.t_world_object);
        self.pose(&snapshot.t_world_gripper);
        self.floats(snapshot.gels.iter().flatten().flatten().copied());
        Ok(())
    }
}

fn stage_from_code(code: u8) -> Result<StageName> {
    let stage = StageName::ALL.get(usize::from(code)).copied();
    stage.ok_or_else(|| damaged(format!("unknown stage {code}")))
}

struct Reader<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let rest = &self.bytes[self.position..];
        if rest.len() < count {
            return Err(damaged(format!(
                "truncated after {} bytes, {} more expected",
                self.bytes.len(),
                count - rest.len()
            )));
        }
        self.position += count;
        Ok(&rest[..count])
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.array()?);
        }
        Ok(values)
    }

    fn pose(&mut self) -> Result<Pose> {
        let translation_m = DVec3::from_array(self.floats()?);
        let [w, x, y, z] = self.floats()?;
        Ok(Pose::new(DQuat::from_xyzw(x, y, z, w), translation_m))
    }

    fn force(&mut self) -> Result<GelForce> {
        let [normal_n, y, z, torque_n_m] = self.floats()?;
        Ok(GelForce {
            normal_n,
            shear_n: [y, z],
            torque_n_m,
        })
    }

    fn step(&mut self) -> Result<TraceStep> {
        let [stage, flags, _, _] = self.array()?;
        let solver = StepReport {
            converged: flags & CONVERGED != 0,
            iterations: self.u32()?,
            factorisations: self.u32()?,
            halvings: self.u32()?,
            broad_phase_rebuilds: self.u32()?,
        };
        self.u32()?;
        let [t_s, opening_m, lifted_m] = self.floats()?;
        let force = [self.force()?, self.force()?];
        let [left, right] = self.floats()?;
        let optional = |bit: u8, gap: f64| (flags & bit != 0).then_some(gap);
        Ok(TraceStep {
            stage: stage_from_code(stage)?,
            t_s,
            force,
            t_world_object: self.pose()?,
            opening_m,
            lifted_m,
            min_gap_m: [optional(LEFT_GAP, left), optional(RIGHT_GAP, right)],
            solver: (flags & SOLVED != 0).then_some(solver),
        })
    }

    fn nodes(&mut self, count: u32) -> Result<Vec<[f64; 3]>> {
        (0..count).map(|_| self.floats()).collect()
    }

    fn snapshot(&mut self) -> Result<Snapshot> {
        let [stage, _, _, _] = self.array()?;
        let (left, right) = (self.u32()?, self.u32()?);
        self.u32()?;
        let [t_s, opening_m] = self.floats()?;
        Ok(Snapshot {
            stage: stage_from_code(stage)?,
            t_s,
            t_world_object: self.pose()?,
            t_world_gripper: self.pose()?,
            opening_m,
            gels: [self.nodes(left)?, self.nodes(right)?],
        })
    }
}

#[cfg(test)]
#[path = "trace_file_test.rs"]
mod tests;
