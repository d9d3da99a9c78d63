//! Kalibr's `camchain.yaml`.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::lens::{ForeignCamera, unsupported};
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
    let listed: Vec<&str> = names.iter().map(|name| &**name).collect();
    let name = match (chosen, &listed[..]) {
        (_, [only]) => *only,
        (Some(name), _) => name,
        (None, _) => {
            return Err(
                Error::input(format!("the camchain has {} cameras", listed.len())).remedy(format!(
                    "choose one of {}: `gripcast calibrate convert FILE --camera-name {} --to toml \
                     --out FILE.toml`",
                    listed.join(", "),
                    listed.first().unwrap_or(&"cam0")
                )),
            );
        }
    };
    let camera = cameras
        .remove(name)
        .ok_or_else(|| unknown_name("camera", name, &listed))?;
    let foreign = camera.foreign(name);
    foreign.map_err(|e| e.at(name))
}

impl Camera {
    fn foreign(&self, name: &str) -> Result<ForeignCamera> {
        if self.camera_model != "pinhole" {
            return Err(unsupported(format!("camera model {:?}", self.camera_model)));
        }
        let is_straight = self.distortion_model == "none";
        if self.distortion_model != "radtan" && !is_straight {
            let model = &self.distortion_model;
            return Err(unsupported(format!("distortion model {model:?}")));
        }
        let [fx, fy, cx, cy] = self.intrinsics[..] else {
            let found = self.intrinsics.len();
            return Err(Error::input(format!(
                "expected 4 numbers in intrinsics, found {found}"
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
