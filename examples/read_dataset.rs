//! Read a dataset: iterate over its grasps, decode the images, measure what the gels felt.
//!
//! ```text
//! gripcast collect --rig virtual --script tests/data/three-grasps.txt --dataset my-dataset
//! cargo run --release --example read_dataset -- my-dataset
//! ```
//!
//! Prints a line per grasp: the size of the colour image and, of both gels, the mean absolute
//! tactile difference in grey levels and the fraction of pixels that changed.
//!
//! ```text
//! grasp                      object    outcome     colour    left           right
//! 2026-11-20T10-15-01Z-1f2e  mug       stable      640x480   6.12 (21 %)    5.87 (19 %)
//! ```

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::{Dataset, GraspRecord, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role, TactileDifference, crop_and_resize};
use image::RgbImage;

fn main() -> Result<()> {
    let usage = || Error::new(ErrorKind::Usage, "name the folder of a dataset");
    let folder = std::env::args().nth(1).ok_or_else(usage)?;
    println!("{}", table(&folder)?);
    Ok(())
}

pub(crate) fn table(folder: &str) -> Result<String> {
    let dataset = Dataset::open(folder)?;
    let mut decoder = Decoder::new()?;
    let mut lines = vec![format!(
        "{:<26} {:<9} {:<11} {:<9} {:<14} right",
        "grasp", "object", "outcome", "colour", "left"
    )];
    for record in dataset.grasps()? {
        let record = record?;
        let colour = match record.grasp.cameras.get(&Role::Rgb) {
            Some(_) => {
                let image = image_of(&dataset, &record, Stage::Grasp, Role::Rgb, &mut decoder)?;
                format!("{}x{}", image.width(), image.height())
            }
            None => "-".to_owned(),
        };
        let mut gels = Vec::new();
        for role in [Role::Left, Role::Right] {
            let initial = image_of(&dataset, &record, Stage::Initial, role, &mut decoder)?;
            let grasp = image_of(&dataset, &record, Stage::Grasp, role, &mut decoder)?;
            // Signed, grasp − initial: what the contact changed.
            let difference = TactileDifference::between(&initial, &grasp)?;
            let percent = 100.0 * difference.changed_fraction(10);
            gels.push(format!("{:.2} ({percent:.0} %)", difference.mean_abs()));
        }
        let (id, object, outcome) = (
            record.id.as_str(),
            &record.object,
            format!("{:?}", record.outcome),
        );
        lines.push(format!(
            "{id:<26} {object:<9} {outcome:<11} {colour:<9} {:<14} {}",
            gels[0], gels[1]
        ));
    }
    Ok(lines.join("\n"))
}

/// One stored image, tactile ones cropped to the gel as the rig file says.
fn image_of(
    dataset: &Dataset,
    record: &GraspRecord,
    stage: Stage,
    role: Role,
    decoder: &mut Decoder,
) -> Result<RgbImage> {
    let missing = || Error::new(ErrorKind::NotFound, format!("{} has no {role}", record.id));
    let camera = record.stage(stage).cameras.get(&role).ok_or_else(missing)?;
    let image = decoder.stored_image(&dataset.stored_image(record, camera)?)?;
    match &camera.crop_profile {
        Some(name) => Ok(crop_and_resize(
            &image,
            &CropProfile::by_name(name)?,
            320,
            240,
        )?),
        None => Ok(image),
    }
}
