//! Which model predicts on a rig.

use crate::note;
use gripcast_base::error::Result;
use gripcast_capture::calibration::RigFile;
use gripcast_nn::predict::{BASELINE, Model, ModelContract, SHIPPED};

/// The model of a name; where none is named, the classifier that is built in if it suits the rig,
/// else the heuristic with a line on stderr that says why. `none` is none.
///
/// # Errors
/// As [`Model::named`].
pub(crate) fn chosen_model(name: &str, rig: &RigFile, is_quiet: bool) -> Result<Option<Model>> {
    match name {
        "" => {
            let (name, why) = usual_model(rig)?;
            if let (Some(why), false) = (why, is_quiet) {
                note!(
                    "{why}: predictions come from `{BASELINE}`, a heuristic, instead of `{SHIPPED}`"
                );
            }
            Model::by_name(name).map(Some)
        }
        "none" => Ok(None),
        name => Model::by_name(name).map(Some),
    }
}

/// Name of the model that predicts where none is named, and why it is not the classifier.
///
/// # Errors
/// As [`Model::named`]; a defect of gripcast.
pub(crate) fn usual_model(rig: &RigFile) -> Result<(&'static str, Option<String>)> {
    let shipped = Model::by_name(SHIPPED)?;
    Ok(match misfit(shipped.contract(), rig) {
        None => (SHIPPED, None),
        why => (BASELINE, why),
    })
}

/// Why a model cannot judge what the cameras of a rig see; none if it can.
pub(crate) fn misfit(model: &ModelContract, rig: &RigFile) -> Option<String> {
    for input in model.modality.inputs() {
        let role = input.role();
        let Some(camera) = rig.cameras.get(&role) else {
            return Some(format!("the rig has no camera `{role}`"));
        };
        let crop = camera.crop_profile.as_deref().unwrap_or_default();
        if role.is_tactile() && model.check_crop_profile(crop).is_err() {
            return Some(format!("the camera `{role}` is cropped with `{crop}`"));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::Role;

    #[test]
    fn the_classifier_is_used_where_the_rig_has_what_it_was_trained_on() {
        let usual = |rig: &RigFile| chosen_model("", rig, true).unwrap().unwrap();
        let mut rig = RigFile::virtual_rig();
        assert_eq!(usual(&rig).contract().name, SHIPPED);
        rig.cameras.remove(&Role::Rgb);
        assert_eq!(usual(&rig).contract().name, BASELINE);
        let contract = Model::by_name(SHIPPED).unwrap().contract().clone();
        let why = misfit(&contract, &rig).unwrap();
        assert!(why.contains("no camera `rgb`"), "{why}");

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
