//! Traces as bytes: JSON for people and scripts, a compact binary form for renderers.
//!
//! # Binary form, version 1
//! All numbers little-endian, floats IEEE 754 `f64`, no padding besides what is named.
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | magic `89 47 43 54 0d 0a 1a 0a` (`\x89GCT\r\n\x1a\n`: damage by text-mode copies shows) |
//! | u32 | version, 1 |
//! | u32 | length H of the header |
//! | u64 | number of steps |
//! | u32 | number of snapshots |
//! | u32 | bytes of one step, 184 |
//! | H | header: one JSON object in UTF-8, the result of the grasp with its parameters |
//! | … | the steps, then the snapshots; then the file ends |
//!
//! A step is: u8 stage (0 closure, 1 adjustment, 2 lift) · u8 flags (1 solved by the solver, 2
//! converged, 4 the left gap is known, 8 the right gap is known) · u16 zero · u32 iterations,
//! factorisations, halvings, gathers, zero · f64 time, opening, lift · left gel: normal force, shear
//! along y and z, torque · right gel: the same · left and right gap (0 where not known) · object
//! pose: translation x y z, quaternion w x y z.
//!
//! A snapshot is: u8 stage · 3 zero bytes · u32 nodes of the left gel, of the right gel, zero · f64
//! time, opening · object pose · gripper pose · node positions x y z of the left gel, of the right.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
use crate::solver::StepReport;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

const MAGIC: [u8; 8] = *b"\x89GCT\r\n\x1a\n";
const VERSION: u32 = 1;
const FORMAT: &str = "gripcast-trace";
const STEP_BYTES: usize = 24 + 20 * 8;

const SOLVED: u8 = 1;
const CONVERGED: u8 = 2;
const LEFT_GAP: u8 = 4;
const RIGHT_GAP: u8 = 8;

/// A trace with the result it belongs to.
#[derive(Clone, Debug)]
pub struct TraceFile {
    /// The result of the grasp with its parameters: a JSON object.
    pub header: Value,
    /// All steps and snapshots.
    pub trace: Trace,
}

impl TraceFile {
    /// One JSON object: `{"format", "version", "result", "steps", "snapshots"}`.
    ///
    /// # Errors
    /// `Internal` where a number has no JSON form.
    pub fn to_json(&self) -> Result<Vec<u8>> {
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

    /// The binary form.
    ///
    /// # Errors
    /// `Internal` where the header cannot be written or there are more than 2³² items.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let header = serde_json::to_vec(&self.header)
            .map_err(|e| Error::internal("cannot write the trace").because(e))?;
        let mut out = Writer(Vec::new());
        out.0.extend(MAGIC);
        out.u32(VERSION);
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
        Ok(out.0)
    }

    /// Reads either form.
    ///
    /// # Errors
    /// `Input` where the bytes are something else, of another version, or cut off.
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
            .map_err(|e| not_a_trace("this JSON is no trace of a grasp").because(e))?;
        if head.format != FORMAT {
            let what = format!("expected the format `{FORMAT}`, found `{}`", head.format);
            return Err(not_a_trace(&what));
        }
        check_version(head.version)?;
        let document: Document = serde_json::from_slice(bytes)
            .map_err(|e| damaged("its content does not fit the format".into()).because(e))?;
        Ok(Self {
            header: document.result,
            trace: document.trace,
        })
    }

    /// Reads the binary form.
    ///
    /// # Errors
    /// `Input` where the bytes are something else, of another version, or cut off.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let mut from = Reader { bytes, at: 0 };
        if !bytes.starts_with(&MAGIC[..bytes.len().min(MAGIC.len())]) {
            return Err(not_a_trace("this is no trace of a grasp"));
        }
        from.take(MAGIC.len())?;
        check_version(from.u32()?)?;
        let header_bytes = from.u32()? as usize;
        let step_count = from.u64()?;
        let snapshot_count = from.u32()?;
        let step_bytes = from.u32()?;
        if step_bytes as usize != STEP_BYTES {
            return Err(damaged(format!(
                "expected {STEP_BYTES} bytes a step, found {step_bytes}"
            )));
        }
        let header = serde_json::from_slice(from.take(header_bytes)?)
            .map_err(|e| damaged("its header is no JSON".into()).because(e))?;
        let mut trace = Trace::default();
        for _ in 0..step_count {
            trace.steps.push(from.step()?);
        }
        for _ in 0..snapshot_count {
            trace.snapshots.push(from.snapshot()?);
        }
        let rest = bytes.len() - from.at;
        if rest > 0 {
            return Err(damaged(format!("{rest} bytes follow its end")));
        }
        Ok(Self { header, trace })
    }
}

fn not_a_trace(what: &str) -> Error {
    Error::input(what).remedy("write one with `gripcast sim grasp … --trace FILE.bin`")
}

fn check_version(version: u32) -> Result<()> {
    if version == VERSION {
        return Ok(());
    }
    Err(Error::input(format!(
        "expected a trace of version {VERSION}, found {version}"
    ))
    .remedy("use the gripcast that wrote it, or simulate the grasp again"))
}

fn damaged(what: String) -> Error {
    Error::input(format!("the trace is damaged: {what}"))
        .remedy("check that the file was copied whole, or simulate the grasp again")
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
        self.0.extend([stage_code(step.stage), flags, 0, 0]);
        self.u32(solver.iterations);
        self.u32(solver.factorisations);
        self.u32(solver.halvings);
        self.u32(solver.gathers);
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
        self.0.extend([stage_code(snapshot.stage), 0, 0, 0]);
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

fn stage_code(stage: StageName) -> u8 {
    match stage {
        StageName::Closure => 0,
        StageName::Adjustment => 1,
        StageName::Lift => 2,
    }
}

fn stage_of(code: u8) -> Result<StageName> {
    match code {
        0 => Ok(StageName::Closure),
        1 => Ok(StageName::Adjustment),
        2 => Ok(StageName::Lift),
        other => Err(damaged(format!("there is no stage {other}"))),
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let rest = &self.bytes[self.at..];
        if rest.len() < count {
            return Err(damaged(format!(
                "it ends after {} bytes, {} more were expected",
                self.bytes.len(),
                count - rest.len()
            )));
        }
        self.at += count;
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

    fn float(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.float()?;
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
        let mut counts = [0; 5];
        for count in &mut counts {
            *count = self.u32()?;
        }
        let [t_s, opening_m, lifted_m] = self.floats()?;
        let force = [self.force()?, self.force()?];
        let [left, right] = self.floats()?;
        let known = |bit: u8, gap: f64| (flags & bit != 0).then_some(gap);
        Ok(TraceStep {
            stage: stage_of(stage)?,
            t_s,
            force,
            t_world_object: self.pose()?,
            opening_m,
            lifted_m,
            min_gap_m: [known(LEFT_GAP, left), known(RIGHT_GAP, right)],
            solver: (flags & SOLVED != 0).then(|| report(flags & CONVERGED != 0, counts)),
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
            stage: stage_of(stage)?,
            t_s,
            t_world_object: self.pose()?,
            t_world_gripper: self.pose()?,
            opening_m,
            gels: [self.nodes(left)?, self.nodes(right)?],
        })
    }
}

fn report(converged: bool, counts: [u32; 5]) -> StepReport {
    let mut report = StepReport::default();
    let fill = |report: &mut StepReport| {
        report.converged = converged;
        report.iterations = counts[0];
        report.factorisations = counts[1];
        report.halvings = counts[2];
        report.gathers = counts[3];
    };
    fill(&mut report);
    report
}

#[cfg(test)]
#[path = "trace_file_test.rs"]
mod tests;
