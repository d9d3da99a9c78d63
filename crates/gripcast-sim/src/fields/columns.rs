//! Binary columns of a [`FieldSeries`]: one record per recorded time step, all of the same size.
//!
//! All numbers little-endian, no padding. With G gels and NY × NX nodes a record has the columns of
//! [`columns`]; the last axis of a shape varies fastest. The description that goes with the
//! records, `fields` in the header of a trace, lists them with their types, shapes and units.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{FaceField, FaceMesh, FieldSeries, FieldStep};
use crate::grasp::StageName;
use crate::solver::NodeContact;
use gripcast_base::error::{Error, Result};

/// Code of a step that belongs to no stage.
const NO_STAGE: u32 = 3;

/// Parts of a field that make a column.
type Get<T> = fn(&FaceField) -> T;
type GetRef<T> = fn(&FaceField) -> &T;
type GetMut<T> = fn(&mut FaceField) -> &mut T;

/// One column of a record.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Column {
    name: &'static str,
    /// Type in numpy's notation.
    dtype: &'static str,
    shape: Vec<usize>,
    unit: &'static str,
}

impl Column {
    fn bytes(&self) -> usize {
        let size = match self.dtype {
            "<f8" => 8,
            "u1" => 1,
            _ => 4,
        };
        size * self.shape.iter().product::<usize>()
    }
}

/// Columns of a record, in order.
fn columns(gels: usize, rows: usize, columns: usize) -> Vec<Column> {
    let column = |name, dtype, shape: &[usize], unit| Column {
        name,
        dtype,
        shape: shape.to_vec(),
        unit,
    };
    let (vectors, scalars) = ([gels, rows, columns, 3], [gels, rows, columns]);
    vec![
        column("step", "<u4", &[], ""),
        column("stage", "<u4", &[], ""),
        column("t_s", "<f8", &[], "s"),
        column("resultant_force_n", "<f8", &[gels, 3], "N"),
        column("resultant_torque_n_m", "<f8", &[gels, 3], "N m"),
        column("side_force_n", "<f8", &[gels, 3], "N"),
        column("side_torque_n_m", "<f8", &[gels, 3], "N m"),
        column("displacement_m", "<f4", &vectors, "m"),
        column("traction_pa", "<f4", &vectors, "Pa"),
        column("contact", "u1", &scalars, ""),
    ]
}

/// Description of the records, in the header of their file.
#[derive(Clone, Debug, Deserialize)]
struct Description {
    steps: usize,
    record_bytes: usize,
    gels: usize,
    x_m: Vec<f64>,
    y_m: Vec<f64>,
    thickness_m: f64,
    area_m2: Vec<Vec<f64>>,
    eps_v_m_s: f64,
}

impl FieldSeries {
    fn columns(&self) -> Vec<Column> {
        columns(self.gels, self.mesh.y_m.len(), self.mesh.x_m.len())
    }

    /// Description for the header of a file that ends with the records.
    pub(crate) fn description(&self) -> Value {
        let columns = self.columns();
        let areas = self.mesh.area_m2.chunks(self.mesh.x_m.len().max(1));
        serde_json::json!({
            "steps": self.steps.len(),
            "record_bytes": columns.iter().map(Column::bytes).sum::<usize>(),
            "gels": self.gels,
            "frame": "gel",
            "x_m": self.mesh.x_m,
            "y_m": self.mesh.y_m,
            "thickness_m": self.mesh.thickness_m,
            "area_m2": areas.collect::<Vec<_>>(),
            "eps_v_m_s": self.eps_v_m_s,
            "stage": ["closure", "adjustment", "lift", "press"],
            "contact": NodeContact::ALL,
            "columns": columns,
        })
    }

    /// Appends the records.
    pub(crate) fn write(&self, out: &mut Vec<u8>) {
        for step in &self.steps {
            let stage = step.stage.map_or(NO_STAGE, |stage| stage as u32);
            out.extend(step.step.to_le_bytes());
            out.extend(stage.to_le_bytes());
            out.extend(step.t_s.to_le_bytes());
            let doubles: [Get<[f64; 3]>; 4] = [
                |gel| gel.resultant.force_n,
                |gel| gel.resultant.torque_n_m,
                |gel| gel.sides.force_n,
                |gel| gel.sides.torque_n_m,
            ];
            for column in doubles {
                let values = step.gels.iter().flat_map(column);
                out.extend(values.flat_map(f64::to_le_bytes));
            }
            let floats: [GetRef<[[f32; 3]]>; 2] =
                [|gel| &gel.displacement_m, |gel| &gel.traction_pa];
            for column in floats {
                let values = step.gels.iter().flat_map(column).flatten();
                out.extend(values.flat_map(|value| value.to_le_bytes()));
            }
            let contacts = step.gels.iter().flat_map(|gel| &gel.contact);
            out.extend(contacts.map(|contact| *contact as u8));
        }
    }

    /// Reads the records that follow a description.
    ///
    /// # Errors
    /// `Input` for an invalid description, or bytes that do not match it.
    pub(crate) fn read(description: &Value, bytes: &[u8]) -> Result<Self> {
        let found = Description::deserialize(description)
            .map_err(|e| damaged("`fields` of the header is invalid".into()).because(e))?;
        if !(1..=2).contains(&found.gels) {
            return Err(damaged(format!(
                "expected 1 or 2 gels, found {}",
                found.gels
            )));
        }
        let (rows, across) = (found.y_m.len(), found.x_m.len());
        let expected: usize = columns(found.gels, rows, across)
            .iter()
            .map(Column::bytes)
            .sum();
        let total = expected.checked_mul(found.steps);
        if found.record_bytes != expected || total != Some(bytes.len()) {
            return Err(damaged(format!(
                "expected {} records of {expected} bytes, found {} bytes in records of {}",
                found.steps,
                bytes.len(),
                found.record_bytes
            )));
        }
        let areas_fit =
            found.area_m2.len() == rows && found.area_m2.iter().all(|r| r.len() == across);
        if !areas_fit {
            return Err(damaged("`area_m2` does not match the nodes".into()));
        }
        let nodes = rows * across;
        let records = bytes.chunks_exact(expected.max(1));
        let steps = records.map(|record| read_step(record, found.gels, nodes));
        Ok(Self {
            steps: steps.collect::<Result<_>>()?,
            mesh: FaceMesh {
                area_m2: found.area_m2.concat(),
                x_m: found.x_m,
                y_m: found.y_m,
                thickness_m: found.thickness_m,
            },
            gels: found.gels,
            eps_v_m_s: found.eps_v_m_s,
        })
    }
}

fn read_step(mut record: &[u8], gels: usize, nodes: usize) -> Result<FieldStep> {
    let step = u32::from_le_bytes(array(&mut record)?);
    let stage = u32::from_le_bytes(array(&mut record)?);
    let t_s = f64::from_le_bytes(array(&mut record)?);
    let mut fields = vec![FaceField::default(); gels];
    let doubles: [GetMut<[f64; 3]>; 4] = [
        |gel| &mut gel.resultant.force_n,
        |gel| &mut gel.resultant.torque_n_m,
        |gel| &mut gel.sides.force_n,
        |gel| &mut gel.sides.torque_n_m,
    ];
    for column in doubles {
        for value in fields.iter_mut().flat_map(column) {
            *value = f64::from_le_bytes(array(&mut record)?);
        }
    }
    let floats: [GetMut<Vec<[f32; 3]>>; 2] =
        [|gel| &mut gel.displacement_m, |gel| &mut gel.traction_pa];
    for column in floats {
        for gel in &mut fields {
            let values = column(gel);
            values.resize(nodes, [0.0; 3]);
            for value in values.iter_mut().flatten() {
                *value = f32::from_le_bytes(array(&mut record)?);
            }
        }
    }
    for gel in &mut fields {
        for _ in 0..nodes {
            let [code] = array(&mut record)?;
            let contact = NodeContact::ALL.get(usize::from(code)).copied();
            let unknown = || damaged(format!("unknown contact state {code}"));
            gel.contact.push(contact.ok_or_else(unknown)?);
        }
    }
    let known = StageName::ALL.get(stage as usize).copied();
    if known.is_none() && stage != NO_STAGE {
        return Err(damaged(format!("unknown stage {stage} of a field")));
    }
    Ok(FieldStep {
        step,
        stage: known,
        t_s,
        gels: fields,
    })
}

/// Takes the next bytes of a record.
fn array<const N: usize>(record: &mut &[u8]) -> Result<[u8; N]> {
    let (first, rest) = record
        .split_first_chunk()
        .ok_or_else(|| damaged("a record of the fields is truncated".into()))?;
    *record = rest;
    Ok(*first)
}

fn damaged(what: String) -> Error {
    Error::input(format!("the trace is damaged: {what}"))
        .remedy("check that the file was copied completely, or simulate again with --fields")
}

#[cfg(test)]
#[path = "columns_test.rs"]
mod tests;
