//! Features of the frames. LeRobot needs each in every frame, with a constant shape.

use serde_json::{Map, Value, json};

use super::super::fields::{UniformField, tactile_name};
use super::super::selection::Survey;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::shard::ColumnType;
use gripcast_dataset::{MARKERS, Stage};
use gripcast_imaging::Role;

/// Roles of the colour cameras.
const COLOUR: [Role; 4] = [Role::Left, Role::Right, Role::Rgb, Role::External];
/// Name of the depth feature.
pub(super) const DEPTH: &str = "observation.depth";
/// Name of the pose feature.
pub(super) const POSE: &str = "observation.pose";
/// Name of the prediction feature.
pub(super) const P_STABLE: &str = "prediction.p_stable";
/// Name of the force feature.
const FORCE: &str = "observation.force";
/// Name of the feature with the gripper's opening.
pub(super) const ACTION: &str = "action";
/// Name of the feature with the phase of a frame.
const PHASE: &str = "phase";
/// Features of every frame, after the others: name, type, and LeRobot's name of the type.
pub(super) const ALWAYS: [(&str, ColumnType, &str); 8] = [
    ("next.reward", ColumnType::Float32, "float32"),
    ("next.done", ColumnType::Bool, "bool"),
    ("next.success", ColumnType::Bool, "bool"),
    ("timestamp", ColumnType::Float32, "float32"),
    ("frame_index", ColumnType::Int64, "int64"),
    ("episode_index", ColumnType::Int64, "int64"),
    ("index", ColumnType::Int64, "int64"),
    ("task_index", ColumnType::Int64, "int64"),
];

/// Features that depend on the dataset.
#[derive(Clone, Debug)]
pub(super) struct Features {
    /// Colour cameras with width and height, pixels.
    pub(super) colour: Vec<(Role, (u32, u32))>,
    /// Width and height of the depth camera, pixels.
    pub(super) depth: Option<(u32, u32)>,
    /// Field arrays; in all frames, NaN where a grasp has none.
    pub(super) fields: Vec<UniformField>,
    pub(super) has_pose: bool,
    pub(super) has_prediction: bool,
    pub(super) has_force: bool,
    /// Features of sequences; `None` for pairs of frames.
    pub(super) sequence: Option<SequenceFeatures>,
}

/// Features that only sequences have: the driver time of each camera's frame, and the phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct SequenceFeatures {
    /// Whether the gripper's opening is known for any grasp.
    pub(super) has_action: bool,
}

/// Name of a colour camera's feature.
pub(super) fn colour_name(role: Role) -> String {
    format!("observation.images.{role}")
}

/// Name of the feature with the driver times of a camera. LeRobot takes what begins with
/// `observation` for an input of policies.
fn time_name(role: Role) -> String {
    format!("driver_time_ns.{role}")
}

/// Name of a field's feature.
fn field_name(field: &UniformField) -> String {
    format!("observation.tactile.{}", tactile_name(&field.key))
}

impl Features {
    /// Selects the cameras that all grasps have in one size; returns a note for each other one.
    /// Sequences need a camera's size at the grasp only.
    ///
    /// # Errors
    /// `Input`: no such camera.
    pub(super) fn choose(survey: &Survey, is_sequence: bool) -> Result<(Self, Vec<String>)> {
        let mut notes = Vec::new();
        let stages = match is_sequence {
            true => &[Stage::Grasp][..],
            false => &Stage::ALL,
        };
        let mut size = |role: Role, stages: &[Stage]| {
            let name = if role == Role::Depth {
                DEPTH.to_owned()
            } else {
                colour_name(role)
            };
            let counts: Vec<_> = stages
                .iter()
                .map(|stage| survey.cameras.get(&(*stage, role)))
                .collect();
            let min = counts.iter().map(|s| s.map_or(0, |s| s.grasps)).min()?;
            if counts.iter().all(Option::is_none) {
                return None;
            }
            if min < survey.grasps {
                let all = survey.grasps;
                notes.push(format!("{name} left out: {min} of {all} grasps have it"));
                return None;
            }
            let mut sizes = counts.iter().flatten().flat_map(|s| &s.sizes);
            let first = *sizes.next()?;
            if sizes.any(|other| *other != first) {
                notes.push(format!("{name} left out: its images have different sizes"));
                return None;
            }
            Some(first)
        };
        let colour: Vec<_> = COLOUR
            .into_iter()
            .filter_map(|role| Some((role, size(role, stages)?)))
            .collect();
        let depth = size(Role::Depth, &[Stage::Grasp]);
        if colour.is_empty() {
            let what = "no camera has images of one size in all grasps";
            let remedy =
                "select grasps of one rig with `--split` and `--subset`, or use another format";
            return Err(Error::input(what).remedy(remedy));
        }
        let (mut fields, other) = survey.fields.of_one_shape();
        notes.extend(other);
        if is_sequence {
            fields.retain(|field| {
                let (role, name) = &field.key;
                let is_logged = *name == MARKERS && colour.iter().any(|(of, _)| of == role);
                if !is_logged {
                    notes.push(format!(
                        "field {name} of {role} left out: no sequence has it"
                    ));
                }
                is_logged
            });
            if !survey.has_opening {
                notes.push(format!(
                    "{ACTION} left out: no grasp has the gripper's opening"
                ));
            }
        }
        let features = Self {
            fields,
            colour,
            depth,
            has_pose: survey.has_pose,
            has_prediction: survey.has_prediction,
            has_force: survey.has_force,
            sequence: is_sequence.then_some(SequenceFeatures {
                has_action: survey.has_opening,
            }),
        };
        Ok((features, notes))
    }

    /// Cameras: colour, then depth.
    pub(super) fn roles(&self) -> Vec<Role> {
        let colour = self.colour.iter().map(|(role, _)| *role);
        colour.chain(self.depth.map(|_| Role::Depth)).collect()
    }

    /// Width and height of a camera, pixels.
    pub(super) fn size(&self, role: Role) -> Option<(u32, u32)> {
        if role == Role::Depth {
            return self.depth;
        }
        let found = self.colour.iter().find(|(of, _)| *of == role);
        found.map(|(_, size)| *size)
    }

    /// Features of sequences: name, type, and LeRobot's type and names.
    fn sequence_features(&self) -> Vec<(String, ColumnType, &'static str, Value)> {
        let Some(sequence) = &self.sequence else {
            return Vec::new();
        };
        let mut features = Vec::new();
        if sequence.has_action {
            let names = json!(["gripper_opening_m"]);
            features.push((ACTION.to_owned(), ColumnType::Float32, "float32", names));
        }
        let times = self.roles().into_iter().map(time_name);
        let integers = times.chain([PHASE.to_owned()]);
        features.extend(integers.map(|name| (name, ColumnType::Int64, "int64", Value::Null)));
        features
    }

    /// Columns of the data files, in the order of the cells of a frame.
    pub(super) fn columns(&self) -> Vec<(String, ColumnType)> {
        let colour = self.colour.iter().map(|(role, _)| colour_name(*role));
        let depth = self.depth.map(|_| DEPTH.to_owned());
        let mut columns: Vec<_> = colour
            .chain(depth)
            .map(|name| (name, ColumnType::Image))
            .collect();
        for field in &self.fields {
            let kind = ColumnType::Float32Array(field.shape.len());
            columns.push((field_name(field), kind));
        }
        let sequence = self.sequence_features().into_iter();
        columns.extend(sequence.map(|(name, kind, _, _)| (name, kind)));
        if self.has_pose {
            columns.push((POSE.to_owned(), ColumnType::Float32List(7)));
        }
        if self.has_prediction {
            columns.push((P_STABLE.to_owned(), ColumnType::Float32));
        }
        if self.has_force {
            columns.push((FORCE.to_owned(), ColumnType::Float32List(8)));
        }
        columns.extend(ALWAYS.map(|(name, kind, _)| (name.to_owned(), kind)));
        columns
    }

    /// Features for `info.json`.
    pub(super) fn to_json(&self) -> Value {
        let mut features = Map::new();
        let image = |(width, height): (u32, u32), channels: u32| {
            json!({
                "dtype": "image",
                "shape": [height, width, channels],
                "names": ["height", "width", "channels"],
            })
        };
        for (role, size) in &self.colour {
            features.insert(colour_name(*role), image(*size, 3));
        }
        if let Some(size) = self.depth {
            features.insert(DEPTH.to_owned(), image(size, 1));
        }
        for field in &self.fields {
            let names = json!({"components": field.counts.columns, "units": field.counts.units});
            let array = json!({"dtype": "float32", "shape": field.shape, "names": names});
            features.insert(field_name(field), array);
        }
        for (name, _, dtype, names) in self.sequence_features() {
            let scalar = json!({"dtype": dtype, "shape": [1], "names": names});
            features.insert(name, scalar);
        }
        if self.has_pose {
            let names = ["x_m", "y_m", "z_m", "q_w", "q_x", "q_y", "q_z"];
            let pose = json!({"dtype": "float32", "shape": [7], "names": names});
            features.insert(POSE.to_owned(), pose);
        }
        let scalar = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null});
        if self.has_prediction {
            features.insert(P_STABLE.to_owned(), scalar("float32"));
        }
        if self.has_force {
            let names = ["left", "right"].map(|gel| {
                ["n", "std_n", "shear_x_n", "shear_y_n"].map(|what| format!("{gel}_{what}"))
            });
            let force = json!({"dtype": "float32", "shape": [8], "names": names.as_flattened()});
            features.insert(FORCE.to_owned(), force);
        }
        for (name, _, dtype) in ALWAYS {
            features.insert(name.to_owned(), scalar(dtype));
        }
        Value::Object(features)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::selection::CameraCounts;
    use super::*;
    use gripcast_base::error::ErrorKind;

    /// Stage, role, number of grasps, sizes.
    type CameraCase<'a> = (Stage, Role, usize, &'a [(u32, u32)]);

    fn survey(cameras: &[CameraCase<'_>]) -> Survey {
        let cameras = cameras.iter().map(|(stage, role, grasps, sizes)| {
            let counts = CameraCounts {
                grasps: *grasps,
                jpegs: 0,
                sizes: sizes.iter().copied().collect(),
            };
            ((*stage, *role), counts)
        });
        Survey {
            grasps: 3,
            cameras: cameras.collect(),
            ..Survey::default()
        }
    }

    #[test]
    fn incomplete_features_are_left_out_with_a_note() {
        const VGA: &[(u32, u32)] = &[(640, 480)];
        let survey = survey(&[
            (Stage::Initial, Role::Left, 3, VGA),
            (Stage::Grasp, Role::Left, 3, VGA),
            (Stage::Initial, Role::Right, 3, VGA),
            (Stage::Grasp, Role::Right, 3, &[(640, 480), (3280, 2464)]),
            (Stage::Grasp, Role::Rgb, 3, VGA),
            (Stage::Grasp, Role::Depth, 2, VGA),
        ]);
        let (features, notes) = Features::choose(&survey, false).unwrap();
        assert_eq!(features.colour, [(Role::Left, (640, 480))]);
        assert_eq!(features.depth, None);
        assert_eq!(
            notes,
            [
                "observation.images.right left out: its images have different sizes",
                "observation.images.rgb left out: 0 of 3 grasps have it",
                "observation.depth left out: 2 of 3 grasps have it",
            ]
        );
        let names: Vec<String> = features
            .columns()
            .into_iter()
            .map(|(name, _)| name)
            .collect();
        let json = features.to_json();
        let declared: Vec<&String> = json.as_object().unwrap().keys().collect();
        assert_eq!(declared.len(), names.len());
        assert!(names.iter().all(|name| declared.contains(&name)));
    }

    #[test]
    fn dataset_without_common_camera_is_refused() {
        let survey = survey(&[(Stage::Grasp, Role::Left, 3, &[(640, 480)])]);
        let error = Features::choose(&survey, false).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.remedy_text().is_some());
    }
}
