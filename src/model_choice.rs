//! Choice of the prediction model for a rig.

use crate::note;
use gripcast_base::error::Result;
use gripcast_capture::calibration::RigFile;
use gripcast_imaging::Role;
use gripcast_nn::predict::contract::InputName;
use gripcast_nn::predict::{BASELINE, Model, ModelContract, SHIPPED};

/// Loads the named model. Without a name, loads the built-in classifier if it suits the rig, else
/// the heuristic with a note on stderr. `none` gives no model.
///
/// # Errors
/// As [`Model::by_name`].
pub(crate) fn chosen_model(name: &str, rig: &RigFile, is_quiet: bool) -> Result<Option<Model>> {
    let model = named_model(name, rig, is_quiet)?;
    let reads_depth = |model: &Model| model.contract().modality.has_depth();
    let has_depth = rig.cameras.contains_key(&Role::Depth);
    let is_unknown = has_depth && rig.depth_view().is_none();
    if is_unknown && !is_quiet && model.as_ref().is_some_and(reads_depth) {
        note!(
            "the depth camera of this rig is not a RealSense D435, so the view of its images is \
             unknown: the model predicts without them"
        );
    }
    Ok(model)
}

fn named_model(name: &str, rig: &RigFile, is_quiet: bool) -> Result<Option<Model>> {
    match name {
        "" => {
            let (name, reason) = default_model(rig)?;
            if let (Some(reason), false) = (reason, is_quiet) {
                note!("{reason}: using the heuristic `{BASELINE}` instead of `{SHIPPED}`");
            }
            Model::by_name(name).map(Some)
        }
        "none" => Ok(None),
        name => Model::by_name(name).map(Some),
    }
}

/// Returns the default model of a rig, and the reason if it is not the classifier.
///
/// # Errors
/// As [`Model::by_name`]; a defect of gripcast.
pub(crate) fn default_model(rig: &RigFile) -> Result<(&'static str, Option<String>)> {
    let shipped = Model::by_name(SHIPPED)?;
    Ok(match misfit(shipped.contract(), rig) {
        None => (SHIPPED, None),
        reason => (BASELINE, reason),
    })
}

/// Returns why a model does not suit the cameras of a rig; none if it does. A model that also
/// predicts from touch alone needs no other camera.
pub(crate) fn misfit(model: &ModelContract, rig: &RigFile) -> Option<String> {
    let has = |name: InputName| match name {
        InputName::Depth => rig.depth_view().is_some(),
        _ => rig.cameras.contains_key(&name.role()),
    };
    let usable = model.output_from(has).map(|output| output.modality);
    let usable = usable.filter(|usable| usable.has_touch() || !model.modality.has_touch());
    for input in usable.unwrap_or(model.modality).inputs() {
        let role = input.role();
        let Some(camera) = rig.cameras.get(&role) else {
            return Some(format!("the rig has no camera `{role}`"));
        };
        let crop = camera.crop_profile.as_deref().unwrap_or_default();
        if role.is_tactile() && model.check_crop_profile(crop).is_err() {
            return Some(format!("the camera `{role}` has the crop profile `{crop}`"));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classifier_is_default_if_it_suits_rig() {
        let usual = |rig: &RigFile| chosen_model("", rig, true).unwrap().unwrap();
        let mut rig = RigFile::virtual_rig();
        assert_eq!(usual(&rig).contract().name, SHIPPED);
        // Without cameras it predicts from touch alone, without a gel not at all.
        for role in [Role::Rgb, Role::Depth] {
            rig.cameras.remove(&role);
            assert_eq!(usual(&rig).contract().name, SHIPPED);
        }
        rig.cameras.remove(&Role::Left);
        assert_eq!(usual(&rig).contract().name, BASELINE);
        let contract = Model::by_name(SHIPPED).unwrap().contract().clone();
        let why = misfit(&contract, &rig).unwrap();
        assert!(why.contains("no camera `left`"), "{why}");

        let mut rig = RigFile::virtual_rig();
        let left = rig.cameras.get_mut(&Role::Left).unwrap();
        left.crop_profile = Some("full-v1".to_owned());
        let why = misfit(&contract, &rig).unwrap();
        assert!(why.contains("`left`") && why.contains("full-v1"), "{why}");

        assert!(chosen_model("none", &rig, true).unwrap().is_none());
        let named = chosen_model(BASELINE, &RigFile::virtual_rig(), true).unwrap();
        assert_eq!(named.unwrap().contract().name, BASELINE);
    }
}
