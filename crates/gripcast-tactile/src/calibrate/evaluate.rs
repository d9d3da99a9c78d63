//! Scores a profile on presses, fitted or not, and scores existing profiles.

use image::RgbImage;

use super::no_contact::check_no_contact;
use super::press_file::PressList;
use super::press_read::ReadOptions;
use super::press_set::{LabelledPress, PressSet};
use super::report::{CalibrationReport, PressRow, Role, listed, notes};
use super::score::{ChangePlanes, Score, background_residual, score};
use super::sheet::{Row, sheet};
use crate::{SensorProfile, ShadingModel, TactileRenderer};
use gripcast_base::error::Result;

/// Presses shown in the image.
const MAX_ROWS: usize = 6;
/// Residual of the profile's background that makes another sensor likely, grey levels.
const MAX_BACKGROUND_RESIDUAL: f64 = 16.0;

/// Scores an existing profile on the presses of a folder without fitting anything. They are resized
/// to the profile's grid and its pixel size is used; the background is that of the folder. Returns
/// the report and the image of scored presses. `test` names the presses as
/// [`super::Split::Named`]; empty means all.
///
/// # Errors
/// Those of [`PressSet::read`]; `Usage` if a name is unknown; `Input` if the images have another
/// aspect ratio than the profile's.
pub fn score_profile(
    profile: &SensorProfile,
    options: &ReadOptions,
    test: &[String],
) -> Result<(CalibrationReport, RgbImage)> {
    let options = ReadOptions {
        grid: Some(profile.geometry),
        ..options.clone()
    };
    let list = PressList::read(&options.folder)?;
    let named = list
        .positions(test)
        .map_err(|e| e.at(options.folder.display()))?;
    let all: Vec<usize> = (0..list.presses.len()).collect();
    let positions = if test.is_empty() { &all } else { &named };
    let set = PressSet::read_at(&options, &list, positions)?;
    check_no_contact(&set).map_err(|e| e.at(options.folder.display()))?;
    let roles: Vec<(usize, Role)> = (0..set.presses.len())
        .map(|index| (index, recorded_role(profile, &set.presses[index])))
        .collect();
    let (mut report, image) = evaluate(&set, &roles, profile)?;
    let unused = all.iter().filter(|position| !positions.contains(position));
    report.unused = unused.map(|i| list.presses[*i].file.clone()).collect();
    report.notes.extend(foreign(profile, &set, &report));
    Ok((report, image))
}

fn recorded_role(profile: &SensorProfile, press: &LabelledPress) -> Role {
    if profile.fitted_to.is_empty() {
        Role::Unknown
    } else if profile.fitted_to.iter().any(|p| p.sha256 == press.sha256) {
        Role::Fitted
    } else {
        Role::HeldOut
    }
}

/// Notes on a profile that is scored on presses it was fitted to, or of another sensor.
fn foreign(profile: &SensorProfile, set: &PressSet, report: &CalibrationReport) -> Vec<String> {
    let mut notes = Vec::new();
    let of = |role: Role| report.presses.iter().filter(move |row| row.role == role);
    let fitted: Vec<&str> = of(Role::Fitted).map(|row| &*row.score.file).collect();
    if report.scored_on == Role::Fitted {
        notes.push("the profile was fitted to all of these presses: the scores flatter it".into());
    } else if !fitted.is_empty() {
        notes.push(format!(
            "the profile was fitted to {}: left out of the means",
            listed(&fitted)
        ));
    }
    if of(Role::Unknown).next().is_some() {
        notes.push(
            "the profile does not record its presses: it may have been fitted to some of these"
                .into(),
        );
    }
    if let Some(image) = &profile.background.image {
        let residual = background_residual(set, image);
        if residual > MAX_BACKGROUND_RESIDUAL {
            notes.push(format!(
                "the no-contact image differs from the profile's by {residual:.0} grey levels \
                 after gain and offset: another sensor or other light?"
            ));
        }
    }
    notes
}

/// Scores a profile on presses of a set, given as indices with roles.
pub(super) fn evaluate(
    set: &PressSet,
    roles: &[(usize, Role)],
    profile: &SensorProfile,
) -> Result<(CalibrationReport, RgbImage)> {
    let of = |is: &dyn Fn(Role) -> bool| -> Vec<usize> {
        let chosen = roles.iter().filter(|(_, role)| is(*role));
        chosen.map(|(index, _)| *index).collect()
    };
    let fitted = of(&|role| role == Role::Fitted);
    let others = of(&|role| role != Role::Fitted);
    let mut renderer = TactileRenderer::new(profile)?;
    let mut scored = |indices: &[usize]| -> Result<(Score, Vec<ChangePlanes>)> {
        let mut shown = Vec::new();
        let score = score(set, indices, &mut |contact| {
            let press = contact.press(profile.smoothing.sink_length_m);
            let change = renderer.change(&press)?;
            if shown.len() < MAX_ROWS {
                shown.push(change.clone());
            }
            Ok(change.clone())
        })?;
        Ok((score, shown))
    };
    let on_fitted = scored(&fitted)?;
    let on_others = scored(&others)?;
    let train = (!fitted.is_empty()).then(|| on_fitted.0.clone());
    let role = |index: usize| roles.iter().find(|role| role.0 == index);
    let role = |index: usize| role(index).map_or(Role::Unknown, |(_, role)| *role);
    let each = fitted.iter().zip(&on_fitted.0.presses);
    let each = each.chain(others.iter().zip(&on_others.0.presses));
    let mut presses: Vec<PressRow> = each
        .map(|(index, score)| {
            let press = &set.presses[*index];
            PressRow {
                number: press.number,
                role: role(*index),
                center_px: press.centre_px,
                radius_px: press.radius_px,
                is_detected: press.is_detected,
                indentation_m: set.contact(press).indentation_m(),
                score: score.clone(),
            }
        })
        .collect();
    presses.sort_by_key(|row| row.number);
    let (indices, (score, changes)) = if others.is_empty() {
        (&fitted, on_fitted)
    } else {
        (&others, on_others)
    };
    let scored_on = indices.first().map_or(Role::Unknown, |index| role(*index));
    let rows: Vec<Row<'_>> = changes
        .into_iter()
        .zip(indices.iter().zip(&score.presses))
        .map(|(change, (index, score))| Row {
            index: *index,
            change,
            score,
        })
        .collect();
    let image = sheet(set, &rows);
    let report = CalibrationReport {
        notes: notes(set, profile, &score, &presses),
        score,
        scored_on,
        train,
        fitted: fitted.len(),
        held_out: others.len(),
        contacts_found: presses.iter().filter(|row| row.is_detected).count(),
        presses,
        skipped: set.skipped.clone(),
        unused: Vec::new(),
        model: match profile.shading {
            ShadingModel::Polynomial(_) => "polynomial",
            ShadingModel::Leds(_) => "leds",
        },
        ball_diameter_m: 2.0 * set.ball_m,
        pixel_m: set.geometry.pixel_m,
        scale: set.scale,
        fit: None,
    };
    Ok((report, image))
}
