//! Commands to the emulated rig, one a line:
//!
//! ```text
//! attach DEVICE [PORT]        plug in; DEVICE is left, right, d435 or pedal
//! detach DEVICE               pull out
//! fault CAMERA none           CAMERA is left, right, depth, infrared or rgb
//! fault CAMERA KIND [COUNT]   hit the next COUNT images, or all from now on; KIND is freeze,
//!                             silent, truncate, corrupt, error-bit, lose-packet, drop, tail,
//!                             lead, no-end, zero, still-clock or jumping-clock
//! stall-commit CAMERA COUNT   refuse the next COUNT starts of its stream
//! twin-serials                give both tactile sensors one serial number; before they are
//!                             plugged in
//! touch free|pressed          what both gels feel
//! pedal press [bounce]
//! quit
//! ```

use std::str::FromStr;

use crate::feed::{Fault, Touch};
use crate::profile;

/// A command; devices are indices into [`profile::NAMES`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    Attach {
        device: usize,
        port: u8,
    },
    Detach {
        device: usize,
    },
    Fault {
        camera: String,
        fault: Option<Fault>,
        images: Option<u32>,
    },
    StallCommit {
        camera: String,
        times: u32,
    },
    TwinSerials,
    Touch(Touch),
    Pedal {
        bounces: bool,
    },
    Quit,
}

fn device(name: &str) -> Result<usize, String> {
    profile::NAMES
        .iter()
        .position(|known| *known == name)
        .ok_or_else(|| format!("unknown device `{name}`"))
}

fn number<T: FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| format!("`{text}` is no number"))
}

impl FromStr for Command {
    type Err = String;

    fn from_str(line: &str) -> Result<Self, String> {
        let words: Vec<&str> = line.split_whitespace().collect();
        match *words.as_slice() {
            ["attach", name] => {
                let device = device(name)?;
                Ok(Self::Attach {
                    device,
                    port: device as u8,
                })
            }
            ["attach", name, port] => Ok(Self::Attach {
                device: device(name)?,
                port: number(port)?,
            }),
            ["detach", name] => Ok(Self::Detach {
                device: device(name)?,
            }),
            ["fault", camera, "none"] => Ok(Self::Fault {
                camera: camera.to_owned(),
                fault: None,
                images: None,
            }),
            ["fault", camera, kind] => Ok(Self::Fault {
                camera: camera.to_owned(),
                fault: Some(kind.parse()?),
                images: None,
            }),
            ["fault", camera, kind, images] => Ok(Self::Fault {
                camera: camera.to_owned(),
                fault: Some(kind.parse()?),
                images: Some(number(images)?),
            }),
            ["stall-commit", camera, times] => Ok(Self::StallCommit {
                camera: camera.to_owned(),
                times: number(times)?,
            }),
            ["twin-serials"] => Ok(Self::TwinSerials),
            ["touch", "free"] => Ok(Self::Touch(Touch::Free)),
            ["touch", "pressed"] => Ok(Self::Touch(Touch::Pressed)),
            ["pedal", "press"] => Ok(Self::Pedal { bounces: false }),
            ["pedal", "press", "bounce"] => Ok(Self::Pedal { bounces: true }),
            ["quit"] => Ok(Self::Quit),
            _ => Err(format!("`{line}` is no command")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read() {
        assert_eq!(
            "attach left 1".parse(),
            Ok(Command::Attach { device: 0, port: 1 })
        );
        assert_eq!(
            "fault rgb truncate 3".parse(),
            Ok(Command::Fault {
                camera: "rgb".into(),
                fault: Some(Fault::Truncate),
                images: Some(3)
            })
        );
        assert_eq!(
            "pedal press bounce".parse(),
            Ok(Command::Pedal { bounces: true })
        );
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        for line in [
            "",
            "attach",
            "attach arm",
            "fault left burn",
            "fault left drop x",
            "touch",
        ] {
            assert!(line.parse::<Command>().is_err(), "{line:?}");
        }
    }
}
