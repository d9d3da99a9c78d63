//! Compact record of a simulated grasp: the states before the lift and in its first 20 mm, at the
//! frame rate of a sensor.
//!
//! A record keeps what images and learning need: poses, forces, and the displacement of the gels'
//! faces to 2 µm. With 13 × 11 nodes on a face it takes 7 KB as bytes; a trace takes 0.3 MB.
//!
//! Bytes: DEFLATE of little-endian numbers. Header: u16 states, u16 nodes along x and y, pose of the
//! gripper before the lift (3 f64 translation, 4 f64 quaternion xyzw). Each state: u8 stage, then as
//! f32 time, rise of the gripper and opening, the object's pose, for each gel force (normal, two
//! shear, torque) and smallest gap (NaN without contact), and the centre of each gel's back; then the
//! displacements of both faces in 2 µm as zigzag LEB128, each less that of the state before, in the
//! first state less that of the neighbouring node.

use std::io::{Read as _, Write as _};

use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use glam::{DQuat, DVec3};

use super::scene::Finger;
use super::trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
use crate::fem::GelGrid;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::Pose;

/// Quantum of displacements, m.
const QUANTUM_M: f64 = 2e-6;
/// Maximum size of an inflated record, bytes.
const MAX_BYTES: u64 = 16 << 20;

/// Record of a grasp that reached its lift.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspRecord {
    /// Pose of the gripper before the lift.
    pub t_world_gripper: Pose,
    /// Nodes of a gel's face along x and y; zero without gels.
    pub face_nodes: [usize; 2],
    /// The state before the lift, then those of the lift.
    pub states: Vec<RecordedState>,
}

/// State of a grasp at the time of a sensor's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedState {
    /// Stage of the protocol.
    pub stage: StageName,
    /// Time since the start, s.
    pub t_s: f64,
    /// Rise of the gripper, m.
    pub lifted_m: f64,
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// Force on the left and right gel.
    pub force: [GelForce; 2],
    /// Smallest distance between each gel and the object, m; `None` beyond `d_hat`.
    pub min_gap_m: [Option<f64>; 2],
    /// Left and right gel.
    pub gels: [RecordedFace; 2],
}

/// Face of a gel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedFace {
    /// Mean of the back's nodes in the world, m.
    pub back_m: DVec3,
    /// Displacement of each node of the face relative to the back, in the gel frame, m.
    pub displacement_m: Vec<[f64; 3]>,
}

impl GraspRecord {
    /// Records a trace; `grid` is the mesh of its gels, if it has any. `None` if the grasp ended
    /// before the lift.
    ///
    /// # Errors
    /// `Input` for a trace with another gel mesh.
    pub fn new(trace: &Trace, grid: Option<&GelGrid>) -> Result<Option<Self>> {
        let is_before = |snapshot: &&Snapshot| snapshot.stage == StageName::Adjustment;
        let Some(before) = trace.snapshots.iter().find(is_before) else {
            return Ok(None);
        };
        let states = [before].into_iter().chain(&trace.lift_snapshots);
        let state = |snapshot: &Snapshot| -> Result<RecordedState> {
            let step = trace.steps.iter().rev().find(|s| s.t_s == snapshot.t_s);
            let step = step.ok_or_else(|| damaged("a snapshot belongs to no step"))?;
            RecordedState::new(snapshot, step, grid)
        };
        Ok(Some(Self {
            t_world_gripper: before.t_world_gripper,
            face_nodes: grid.map_or([0; 2], |grid| [grid.nodes()[0], grid.nodes()[1]]),
            states: states.map(state).collect::<Result<_>>()?,
        }))
    }

    /// Returns the state with index `state` as a snapshot for renderers: the nodes of face and back
    /// are those of the simulation, the others lie evenly between.
    ///
    /// # Errors
    /// `Input` for an unknown state, or another gel mesh than the record's.
    pub fn snapshot(&self, state: usize, grid: Option<&GelGrid>) -> Result<Snapshot> {
        let found = self.states.get(state).ok_or_else(|| {
            let count = self.states.len();
            Error::input(format!(
                "expected a state below {count} of the record, found {state}"
            ))
        })?;
        let own = grid.map_or([0; 2], |grid| [grid.nodes()[0], grid.nodes()[1]]);
        if own != self.face_nodes {
            return Err(other_mesh(&own, &self.face_nodes));
        }
        let gels = Finger::BOTH.map(|finger| {
            let face = &found.gels[finger as usize];
            let rotation = self.t_world_gripper.rotation_matrix() * finger.rotation();
            grid.map_or_else(Vec::new, |grid| {
                face.nodes(grid, |v| (face.back_m + rotation * v).to_array())
            })
        });
        let rise = Pose::from_translation(DVec3::Z * found.lifted_m);
        Ok(Snapshot {
            stage: found.stage,
            t_s: found.t_s,
            t_world_object: found.t_world_object,
            t_world_gripper: rise * self.t_world_gripper,
            opening_m: found.opening_m,
            gels,
        })
    }

    /// Writes the record.
    ///
    /// # Errors
    /// `Internal` for more than 65,535 states or nodes.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        let counts = [self.states.len(), self.face_nodes[0], self.face_nodes[1]];
        for count in counts {
            let count = u16::try_from(count)
                .map_err(|e| Error::internal("too many values for a record").because(e))?;
            out.extend(count.to_le_bytes());
        }
        push_pose(&mut out, &self.t_world_gripper);
        let mut before: Option<Vec<i64>> = None;
        for state in &self.states {
            state.write(&mut out);
            let values = state.quanta();
            match &before {
                Some(before) => {
                    let changes = values.iter().zip(before).map(|(now, then)| now - then);
                    changes.for_each(|change| push_integer(&mut out, change));
                }
                None => (0..values.len()).for_each(|index| {
                    let prediction = self.neighbour(index).map_or(0, |at| values[at]);
                    push_integer(&mut out, values[index] - prediction);
                }),
            }
            before = Some(values);
        }
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
        encoder
            .write_all(&out)
            .and_then(|()| encoder.finish())
            .map_err(|e| Error::internal("cannot compress a record").because(e))
    }

    /// Reads a record.
    ///
    /// # Errors
    /// `Input` for damaged bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let mut inflated = Vec::new();
        DeflateDecoder::new(bytes)
            .take(MAX_BYTES)
            .read_to_end(&mut inflated)
            .map_err(|e| damaged("it does not inflate").because(e))?;
        let mut input = inflated.as_slice();
        let [states, x, y] = take_all(|| Ok(u16::from_le_bytes(take(&mut input)?).into()))?;
        let translation_m = DVec3::from_array(take_doubles(&mut input)?);
        let t_world_gripper = pose(translation_m, take_doubles(&mut input)?)?;
        let mut record = Self {
            t_world_gripper,
            face_nodes: [x, y],
            states: Vec::new(),
        };
        let mut before: Option<Vec<i64>> = None;
        for _ in 0..states {
            let mut state = RecordedState::read(&mut input)?;
            let mut values: Vec<i64> = Vec::new();
            for index in 0..6 * x * y {
                let prediction = match &before {
                    Some(before) => before[index],
                    None => record.neighbour(index).map_or(0, |at| values[at]),
                };
                let change = take_integer(&mut input)?;
                let value = prediction.checked_add(change);
                values.push(value.ok_or_else(|| damaged("a displacement is out of range"))?);
            }
            state.set_quanta(&values, x * y);
            record.states.push(state);
            before = Some(values);
        }
        if !input.is_empty() {
            return Err(damaged("it has bytes after its last state"));
        }
        Ok(record)
    }

    /// Index of the value at the neighbouring node that predicts a value of the first state.
    fn neighbour(&self, index: usize) -> Option<usize> {
        let [x, y] = self.face_nodes;
        let node = (index / 3) % (x * y);
        match node {
            0 => None,
            _ if node.is_multiple_of(x) => Some(index - 3 * x),
            _ => Some(index - 3),
        }
    }
}

impl RecordedState {
    fn new(snapshot: &Snapshot, step: &TraceStep, grid: Option<&GelGrid>) -> Result<Self> {
        let gripper = snapshot.t_world_gripper.rotation_matrix();
        let mut gels = [RecordedFace::default(), RecordedFace::default()];
        if let Some(grid) = grid {
            for finger in Finger::BOTH {
                let nodes = &snapshot.gels[finger as usize];
                let to_gel = (gripper * finger.rotation()).transpose();
                gels[finger as usize] = RecordedFace::new(nodes, grid, |v| to_gel * v)?;
            }
        }
        Ok(Self {
            stage: snapshot.stage,
            t_s: snapshot.t_s,
            lifted_m: step.lifted_m,
            opening_m: snapshot.opening_m,
            t_world_object: snapshot.t_world_object,
            force: step.force,
            min_gap_m: step.min_gap_m,
            gels,
        })
    }

    /// Displacements of both faces in quanta.
    fn quanta(&self) -> Vec<i64> {
        let values = self.gels.iter().flat_map(|gel| &gel.displacement_m);
        let quanta = values.flatten().map(|m| (m / QUANTUM_M).round() as i64);
        quanta.collect()
    }

    fn set_quanta(&mut self, values: &[i64], nodes: usize) {
        let (vectors, _) = values.as_chunks::<3>();
        for (gel, vectors) in self.gels.iter_mut().zip(vectors.chunks(nodes.max(1))) {
            let vectors = vectors.iter().map(|v| v.map(|q| q as f64 * QUANTUM_M));
            gel.displacement_m = vectors.collect();
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        out.push(self.stage as u8);
        push_singles(out, [self.t_s, self.lifted_m, self.opening_m]);
        push_singles(out, self.t_world_object.translation_m.to_array());
        push_singles(out, self.t_world_object.rotation.to_array());
        for (force, gap) in self.force.iter().zip(self.min_gap_m) {
            let [y, z] = force.shear_n;
            push_singles(out, [force.normal_n, y, z, force.torque_n_m]);
            push_singles(out, [gap.unwrap_or(f64::NAN)]);
        }
        for gel in &self.gels {
            push_singles(out, gel.back_m.to_array());
        }
    }

    fn read(input: &mut &[u8]) -> Result<Self> {
        let [code] = take(input)?;
        let stage = StageName::ALL.get(usize::from(code)).copied();
        let stage = stage.ok_or_else(|| damaged("a stage is unknown"))?;
        let [t_s, lifted_m, opening_m] = take_singles(input)?;
        let translation_m = DVec3::from_array(take_singles(input)?);
        let t_world_object = pose(translation_m, take_singles(input)?)?;
        let mut force = [GelForce::default(); 2];
        let mut min_gap_m = [None; 2];
        for (force, gap) in force.iter_mut().zip(&mut min_gap_m) {
            let [normal_n, y, z, torque_n_m, found] = take_singles(input)?;
            *force = GelForce {
                normal_n,
                shear_n: [y, z],
                torque_n_m,
            };
            *gap = (!found.is_nan()).then_some(found);
        }
        let [left, right] = take_all(|| Ok(DVec3::from_array(take_singles(input)?)))?;
        let face = |back_m| RecordedFace {
            back_m,
            ..RecordedFace::default()
        };
        Ok(Self {
            stage,
            t_s,
            lifted_m,
            opening_m,
            t_world_object,
            force,
            min_gap_m,
            gels: [face(left), face(right)],
        })
    }
}

impl RecordedFace {
    /// Reads a face from the nodes of a gel in the world; `to_gel` rotates into the gel frame.
    fn new(nodes: &[[f64; 3]], grid: &GelGrid, to_gel: impl Fn(DVec3) -> DVec3) -> Result<Self> {
        let expected = grid.positions().len();
        if nodes.len() != expected {
            return Err(other_mesh(&[expected], &[nodes.len()]));
        }
        let at = |node: usize| DVec3::from_array(nodes[node]);
        let count = grid.driven().len().max(1) as f64;
        let back: DVec3 = grid.driven().iter().map(|node| at(*node as usize)).sum();
        let back_m = back / count;
        let rest = back_at_rest(grid);
        let displacement = |node: usize| {
            let moved = to_gel(at(node) - back_m) - (grid.positions()[node] - rest);
            moved.to_array()
        };
        Ok(Self {
            back_m,
            displacement_m: front(grid).map(displacement).collect(),
        })
    }

    /// Positions of all nodes of the gel; `to_world` maps a position relative to the back.
    fn nodes(&self, grid: &GelGrid, to_world: impl Fn(DVec3) -> [f64; 3]) -> Vec<[f64; 3]> {
        let rest = back_at_rest(grid);
        let thickness = grid.thickness_m();
        let layer = self.displacement_m.len().max(1);
        let position = |(node, at): (usize, &DVec3)| {
            let face = self.displacement_m.get(node % layer);
            let displacement = face.map_or(DVec3::ZERO, |d| DVec3::from_array(*d));
            let height = (at.z - rest.z) / thickness;
            to_world(*at - rest + height * displacement)
        };
        grid.positions().iter().enumerate().map(position).collect()
    }
}

/// Mean of the back's nodes at rest, m.
fn back_at_rest(grid: &GelGrid) -> DVec3 {
    let positions = grid
        .driven()
        .iter()
        .map(|node| grid.positions()[*node as usize]);
    positions.sum::<DVec3>() / grid.driven().len().max(1) as f64
}

/// The nodes of the face: the last layer.
fn front(grid: &GelGrid) -> std::ops::Range<usize> {
    let [x, y, layers] = grid.nodes();
    x * y * (layers - 1)..x * y * layers
}

fn push_pose(out: &mut Vec<u8>, pose: &Pose) {
    let translation = pose.translation_m.to_array();
    let values = translation.into_iter().chain(pose.rotation.to_array());
    out.extend(values.flat_map(f64::to_le_bytes));
}

fn push_singles<const N: usize>(out: &mut Vec<u8>, values: [f64; N]) {
    let singles = values.into_iter().map(|value| value as f32);
    out.extend(singles.flat_map(f32::to_le_bytes));
}

/// Appends zigzag LEB128.
fn push_integer(out: &mut Vec<u8>, value: i64) {
    let mut rest = ((value << 1) ^ (value >> 63)) as u64;
    while rest >= 0x80 {
        out.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    out.push(rest as u8);
}

fn take<const N: usize>(input: &mut &[u8]) -> Result<[u8; N]> {
    let (first, rest) = input
        .split_first_chunk()
        .ok_or_else(|| damaged("it is truncated"))?;
    *input = rest;
    Ok(*first)
}

fn take_all<T: Default + Copy, const N: usize>(
    mut next: impl FnMut() -> Result<T>,
) -> Result<[T; N]> {
    let mut values = [T::default(); N];
    for value in &mut values {
        *value = next()?;
    }
    Ok(values)
}

fn take_doubles<const N: usize>(input: &mut &[u8]) -> Result<[f64; N]> {
    take_all(|| Ok(f64::from_le_bytes(take(input)?)))
}

fn take_singles<const N: usize>(input: &mut &[u8]) -> Result<[f64; N]> {
    take_all(|| Ok(f64::from(f32::from_le_bytes(take(input)?))))
}

fn pose(translation_m: DVec3, rotation_xyzw: [f64; 4]) -> Result<Pose> {
    let rotation = DQuat::from_array(rotation_xyzw);
    if !(translation_m.is_finite() && rotation.is_normalized()) {
        return Err(damaged("a pose is invalid"));
    }
    Ok(Pose::new(rotation, translation_m))
}

fn take_integer(input: &mut &[u8]) -> Result<i64> {
    let mut value = 0_u64;
    for shift in (0..63).step_by(7) {
        let [byte] = take(input)?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Ok((value >> 1) as i64 ^ -((value & 1) as i64));
        }
    }
    Err(damaged("a displacement is out of range"))
}

fn other_mesh(expected: &[usize], found: &[usize]) -> Error {
    Error::input(format!(
        "expected {expected:?} nodes of the gel mesh, found {found:?}"
    ))
    .remedy("use the gel mesh with which the grasp was simulated")
}

fn damaged(what: &str) -> Error {
    Error::input(format!("the record of a grasp is damaged: {what}"))
        .remedy("remove the file and simulate the grasp again")
}

#[cfg(test)]
#[path = "record_test.rs"]
mod tests;
