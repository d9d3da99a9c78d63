//! `camchain.yaml` of Kalibr.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::lens::{ForeignCamera, unknown_lens};
use crate::yaml;
use gripcast_base::error::{Error, Result, unknown_name};

#[derive(Deserialize)]
struct Camera {
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: String,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: Option<[u32; 2]>,
}

pub(super) fn read(text: &str, chosen: Option<&str>) -> Result<ForeignCamera> {
    let mut cameras: BTreeMap<String, Camera> = yaml::read(text, "the camchain")?;
    let names: Vec<String> = cameras.keys().cloned().collect();
    let known: Vec<&str> = names.iter().map(|name| &**name).collect();
    let name = match (chosen, &known[..]) {
        (_, [only]) => *only,
        (Some(name), _) => name,
        (None, _) => {
            return Err(
                Error::input(format!("the camchain has {} cameras", known.len())).remedy(format!(
                    "choose one: `gripcast calibrate convert FILE --camera-name {} --to toml --out \
                 FILE.toml`; there are {}",
                    known.first().unwrap_or(&"cam0"),
                    known.join(", ")
                )),
            );
        }
    };
    let camera = cameras
        .remove(name)
        .ok_or_else(|| unknown_name("camera", name, &known))?;
    let foreign = camera.foreign(name);
    foreign.map_err(|e| e.at(name))
}

impl Camera {
    fn foreign(&self, name: &str) -> Result<ForeignCamera> {
        if self.camera_model != "pinhole" {
            return Err(unknown_lens(&format!(
                "the camera model {:?}",
                self.camera_model
            )));
        }
        let is_straight = self.distortion_model == "none";
        if self.distortion_model != "radtan" && !is_straight {
            return Err(unknown_lens(&format!(
                "the model {:?}",
                self.distortion_model
            )));
        }
        let [fx, fy, cx, cy] = self.intrinsics[..] else {
            return Err(Error::input(format!(
                "intrinsics of a pinhole camera are 4 numbers, found {}",
                self.intrinsics.len()
            )));
        };
        Ok(ForeignCamera {
            width: self.resolution.map(|[width, _]| width),
            height: self.resolution.map(|[_, height]| height),
            matrix: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            coefficients: if is_straight {
                Vec::new()
            } else {
                self.distortion_coeffs.clone()
            },
            camera_name: Some(name.to_owned()),
            ..ForeignCamera::default()
        })
    }
}
