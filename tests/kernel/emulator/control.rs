//! Camera controls: the values behind UVC camera terminals and processing units, and the
//! hardware monitor of the D435.

/// Entities of every camera function.
pub(crate) const CAMERA_TERMINAL: u8 = 1;
pub(crate) const PROCESSING_UNIT: u8 = 2;
pub(crate) const EXTENSION_UNIT: u8 = 3;

/// UVC class requests (`bRequest`).
pub(crate) mod request {
    pub(crate) const SET_CUR: u8 = 0x01;
    pub(crate) const GET_CUR: u8 = 0x81;
    pub(crate) const GET_MIN: u8 = 0x82;
    pub(crate) const GET_MAX: u8 = 0x83;
    pub(crate) const GET_RES: u8 = 0x84;
    pub(crate) const GET_LEN: u8 = 0x85;
    pub(crate) const GET_INFO: u8 = 0x86;
    pub(crate) const GET_DEF: u8 = 0x87;
}

/// What GET_INFO says of a control that can be read and written.
const READ_WRITE: u8 = 0x03;

mod camera {
    pub(super) const AE_MODE: u8 = 0x02;
    pub(super) const AE_PRIORITY: u8 = 0x03;
    pub(super) const EXPOSURE_TIME: u8 = 0x04;
}

mod processing {
    pub(super) const BACKLIGHT: u8 = 0x01;
    pub(super) const BRIGHTNESS: u8 = 0x02;
    pub(super) const CONTRAST: u8 = 0x03;
    pub(super) const GAIN: u8 = 0x04;
    pub(super) const POWER_LINE: u8 = 0x05;
    pub(super) const HUE: u8 = 0x06;
    pub(super) const SATURATION: u8 = 0x07;
    pub(super) const SHARPNESS: u8 = 0x08;
    pub(super) const GAMMA: u8 = 0x09;
    pub(super) const WHITE_BALANCE: u8 = 0x0a;
    pub(super) const WHITE_BALANCE_AUTO: u8 = 0x0b;
}

const AE_MANUAL: i32 = 1;
const AE_APERTURE_PRIORITY: i32 = 8;

/// One control of a camera terminal or processing unit.
#[derive(Clone, Debug)]
pub(crate) struct Control {
    pub(crate) entity: u8,
    pub(crate) selector: u8,
    /// Bit in `bmControls` of the entity's descriptor.
    pub(crate) bit: u8,
    /// Size on the wire, 1, 2 or 4.
    bytes: u8,
    min: i32,
    max: i32,
    /// Step; for the exposure mode the set of supported modes.
    resolution: i32,
    default: i32,
    current: i32,
}

impl Control {
    fn new(
        (entity, selector, bit): (u8, u8, u8),
        bytes: u8,
        (min, max): (i32, i32),
        default: i32,
    ) -> Self {
        Self {
            entity,
            selector,
            bit,
            bytes,
            min,
            max,
            resolution: 1,
            default,
            current: default,
        }
    }

    fn encode(&self, value: i32) -> Vec<u8> {
        value.to_le_bytes()[..usize::from(self.bytes)].to_vec()
    }

    fn decode(&self, data: &[u8]) -> Option<i32> {
        match *data {
            [a] if self.bytes == 1 => Some(i32::from(a)),
            [a, b] if self.bytes == 2 && self.min < 0 => Some(i16::from_le_bytes([a, b]).into()),
            [a, b] if self.bytes == 2 => Some(u16::from_le_bytes([a, b]).into()),
            [a, b, c, d] if self.bytes == 4 => Some(i32::from_le_bytes([a, b, c, d])),
            _ => None,
        }
    }

    fn accepts(&self, value: i32) -> bool {
        if (self.entity, self.selector) == (CAMERA_TERMINAL, camera::AE_MODE) {
            value.count_ones() == 1 && value & self.resolution != 0
        } else {
            (self.min..=self.max).contains(&value)
        }
    }
}

fn exposure_mode() -> Control {
    let mut mode = Control::new(
        (CAMERA_TERMINAL, camera::AE_MODE, 1),
        1,
        (AE_MANUAL, AE_APERTURE_PRIORITY),
        AE_APERTURE_PRIORITY,
    );
    mode.resolution = AE_MANUAL | AE_APERTURE_PRIORITY;
    mode
}

fn exposure_time(max: i32, default: i32) -> Control {
    Control::new(
        (CAMERA_TERMINAL, camera::EXPOSURE_TIME, 3),
        4,
        (1, max),
        default,
    )
}

fn image(selector: u8, bit: u8, range: (i32, i32), default: i32) -> Control {
    Control::new((PROCESSING_UNIT, selector, bit), 2, range, default)
}

fn switch(selector: u8, bit: u8, max: i32, default: i32) -> Control {
    Control::new((PROCESSING_UNIT, selector, bit), 1, (0, max), default)
}

/// Controls of a GelSight Mini. Names are those of the vendor's parameter script; ranges are
/// those of common cameras with the same bridge.
pub(crate) fn gelsight_mini() -> Vec<Control> {
    vec![
        exposure_mode(),
        Control::new((CAMERA_TERMINAL, camera::AE_PRIORITY, 2), 1, (0, 1), 0),
        exposure_time(5000, 157),
        image(processing::BRIGHTNESS, 0, (-64, 64), 0),
        image(processing::CONTRAST, 1, (0, 64), 32),
        image(processing::HUE, 2, (-40, 40), 0),
        image(processing::SATURATION, 3, (0, 128), 64),
        image(processing::SHARPNESS, 4, (0, 6), 3),
        image(processing::GAMMA, 5, (72, 500), 100),
        image(processing::WHITE_BALANCE, 6, (2800, 6500), 4600),
        image(processing::BACKLIGHT, 8, (0, 2), 1),
        image(processing::GAIN, 9, (0, 100), 0),
        switch(processing::POWER_LINE, 10, 2, 1),
        switch(processing::WHITE_BALANCE_AUTO, 12, 1, 1),
    ]
}

/// Controls of the stereo module of a D435.
pub(crate) fn realsense_depth() -> Vec<Control> {
    vec![
        exposure_mode(),
        exposure_time(1660, 85),
        image(processing::GAIN, 9, (16, 248), 16),
    ]
}

/// Controls of the colour camera of a D435.
pub(crate) fn realsense_colour() -> Vec<Control> {
    vec![
        exposure_mode(),
        Control::new((CAMERA_TERMINAL, camera::AE_PRIORITY, 2), 1, (0, 1), 0),
        exposure_time(10_000, 166),
        image(processing::BRIGHTNESS, 0, (-64, 64), 0),
        image(processing::CONTRAST, 1, (0, 100), 50),
        image(processing::HUE, 2, (-180, 180), 0),
        image(processing::SATURATION, 3, (0, 100), 64),
        image(processing::SHARPNESS, 4, (0, 100), 50),
        image(processing::GAMMA, 5, (100, 500), 300),
        image(processing::WHITE_BALANCE, 6, (2800, 6500), 4600),
        image(processing::BACKLIGHT, 8, (0, 1), 0),
        image(processing::GAIN, 9, (0, 128), 64),
        switch(processing::POWER_LINE, 10, 2, 2),
        switch(processing::WHITE_BALANCE_AUTO, 12, 1, 1),
    ]
}

/// The controls of one camera function.
#[derive(Clone, Debug)]
pub(crate) struct ControlPanel(Vec<Control>);

impl ControlPanel {
    pub(crate) fn new(controls: Vec<Control>) -> Self {
        Self(controls)
    }

    fn value(&self, entity: u8, selector: u8) -> Option<i32> {
        let found = self
            .0
            .iter()
            .find(|c| (c.entity, c.selector) == (entity, selector))?;
        Some(found.current)
    }

    /// As real cameras do, a value is refused while its automatic is on.
    fn is_automatic(&self, entity: u8, selector: u8) -> bool {
        match (entity, selector) {
            (CAMERA_TERMINAL, camera::EXPOSURE_TIME) => {
                self.value(CAMERA_TERMINAL, camera::AE_MODE) != Some(AE_MANUAL)
            }
            (PROCESSING_UNIT, processing::WHITE_BALANCE) => {
                self.value(PROCESSING_UNIT, processing::WHITE_BALANCE_AUTO) == Some(1)
            }
            _ => false,
        }
    }

    /// Answers a GET request; `None` = stall.
    pub(crate) fn get(&self, entity: u8, selector: u8, what: u8) -> Option<Vec<u8>> {
        let control = self
            .0
            .iter()
            .find(|c| (c.entity, c.selector) == (entity, selector))?;
        match what {
            request::GET_CUR => Some(control.encode(control.current)),
            request::GET_MIN => Some(control.encode(control.min)),
            request::GET_MAX => Some(control.encode(control.max)),
            request::GET_RES => Some(control.encode(control.resolution)),
            request::GET_DEF => Some(control.encode(control.default)),
            request::GET_LEN => Some(vec![control.bytes, 0]),
            request::GET_INFO => Some(vec![READ_WRITE]),
            _ => None,
        }
    }

    /// Sets a value; `false` = stall.
    pub(crate) fn set(&mut self, entity: u8, selector: u8, data: &[u8]) -> bool {
        if self.is_automatic(entity, selector) {
            return false;
        }
        let found = self
            .0
            .iter_mut()
            .find(|c| (c.entity, c.selector) == (entity, selector));
        let Some(control) = found else { return false };
        match control.decode(data) {
            Some(value) if control.accepts(value) => {
                control.current = value;
                true
            }
            _ => false,
        }
    }
}

/// The hardware monitor of a D435: a mailbox of 1024 bytes, written with a command and read
/// with its result.
#[derive(Clone, Debug)]
pub(crate) struct HardwareMonitor {
    reply: Vec<u8>,
}

impl HardwareMonitor {
    /// Only selector of the extension unit.
    pub(crate) const SELECTOR: u8 = 1;
    /// `C9606CCB-594C-4D25-AF47-CCC496435995` in wire order.
    #[rustfmt::skip]
    pub(crate) const GUID: [u8; 16] = [
        0xcb, 0x6c, 0x60, 0xc9, 0x4c, 0x59, 0x25, 0x4d,
        0xaf, 0x47, 0xcc, 0xc4, 0x96, 0x43, 0x59, 0x95,
    ];

    const MAILBOX: usize = 1024;
    const MAGIC: u16 = 0xcdab;
    /// Reads a table of the factory calibration.
    const GET_CALIBRATION: u32 = 0x15;
    const RGB_TABLE: u32 = 32;
    /// Offset of the reply's length in the mailbox.
    const LENGTH_AT: usize = 1020;
    /// Reply to a command that is not known: anything but an echo of the opcode is an error.
    const UNKNOWN_COMMAND: i32 = -1;

    pub(crate) fn new() -> Self {
        Self {
            reply: vec![0; Self::MAILBOX],
        }
    }

    /// Answers a GET request; `None` = stall.
    pub(crate) fn get(&self, what: u8) -> Option<Vec<u8>> {
        match what {
            request::GET_CUR => Some(self.reply.clone()),
            request::GET_LEN => Some((Self::MAILBOX as u16).to_le_bytes().to_vec()),
            request::GET_INFO => Some(vec![READ_WRITE]),
            request::GET_MIN | request::GET_DEF => Some(vec![0; Self::MAILBOX]),
            request::GET_MAX => Some(vec![0xff; Self::MAILBOX]),
            request::GET_RES => {
                let mut one = vec![0; Self::MAILBOX];
                one[0] = 1;
                Some(one)
            }
            _ => None,
        }
    }

    /// Runs a command: u16 length 20, u16 magic, u32 opcode, u32 parameters 1..4, all
    /// little-endian. `false` = stall.
    pub(crate) fn set(&mut self, command: &[u8]) -> bool {
        if command.len() != Self::MAILBOX {
            return false;
        }
        let half = |at: usize| u16::from_le_bytes([command[at], command[at + 1]]);
        let word = |at: usize| u32::from(half(at)) | u32::from(half(at + 2)) << 16;
        if half(0) != 20 || half(2) != Self::MAGIC {
            return false;
        }
        self.reply = vec![0; Self::MAILBOX];
        let (status, payload) = match (word(4), word(8)) {
            (Self::GET_CALIBRATION, Self::RGB_TABLE) => {
                (Self::GET_CALIBRATION.cast_signed(), rgb_calibration())
            }
            _ => (Self::UNKNOWN_COMMAND, Vec::new()),
        };
        self.reply[..4].copy_from_slice(&status.to_le_bytes());
        self.reply[4..4 + payload.len()].copy_from_slice(&payload);
        let length = payload.len() as u32;
        self.reply[Self::LENGTH_AT..].copy_from_slice(&length.to_le_bytes());
        true
    }
}

/// Intrinsics behind [`rgb_calibration`], at 1280×720: fx, fy, cx, cy in px.
#[cfg(test)]
const RGB_INTRINSICS_720P: [f64; 4] = [912.0, 911.25, 643.2, 361.44];

/// Factory table 32 of the colour camera: 16 bytes of header, then the table.
fn rgb_calibration() -> Vec<u8> {
    const VERSION: u16 = 0x0100;
    const TABLE_TYPE: u16 = 32;
    let mut table = Vec::new();
    let mut floats = |values: &[f32]| {
        for value in values {
            table.extend_from_slice(&value.to_le_bytes());
        }
    };
    // Normalised column-major matrix: fx = m[0]·W/2, fy = m[4]·H/2, cx = (1 + m[2])·W/2,
    // cy = (1 + m[5])·H/2.
    floats(&[1.425, 0.0, 0.005, 0.0, 2.531_25, 0.004, 0.0, 0.0, 1.0]);
    floats(&[0.12, -0.24, 0.0004, -0.0003, 0.08]);
    floats(&[0.002, -0.004, 0.001]);
    floats(&[14.8, 0.1, 0.3]);
    floats(&[0.0; 12]);
    for side in [1920_u16, 1080] {
        table.extend_from_slice(&side.to_le_bytes());
    }
    const RECTIFICATION_AND_RESERVED: usize = 36 + 36 + 24;
    table.resize(table.len() + RECTIFICATION_AND_RESERVED, 0);

    let mut bytes = Vec::new();
    bytes.extend_from_slice(&VERSION.to_be_bytes());
    bytes.extend_from_slice(&TABLE_TYPE.to_le_bytes());
    bytes.extend_from_slice(&(table.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&0_u32.to_le_bytes());
    bytes.extend_from_slice(&crc32(&table).to_le_bytes());
    bytes.extend_from_slice(&table);
    bytes
}

/// CRC-32 of IEEE 802.3, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_time_needs_manual_mode() {
        let mut panel = ControlPanel::new(gelsight_mini());
        let time = 180_i32.to_le_bytes();
        assert!(!panel.set(CAMERA_TERMINAL, camera::EXPOSURE_TIME, &time));
        assert!(panel.set(CAMERA_TERMINAL, camera::AE_MODE, &[1]));
        assert!(panel.set(CAMERA_TERMINAL, camera::EXPOSURE_TIME, &time));
        let read = panel.get(CAMERA_TERMINAL, camera::EXPOSURE_TIME, request::GET_CUR);
        assert_eq!(read.unwrap(), time);
    }

    #[test]
    fn values_out_of_range_or_of_wrong_size_stall() {
        let mut panel = ControlPanel::new(gelsight_mini());
        assert!(!panel.set(PROCESSING_UNIT, processing::GAIN, &101_u16.to_le_bytes()));
        assert!(!panel.set(PROCESSING_UNIT, processing::GAIN, &[1]));
        assert!(!panel.set(CAMERA_TERMINAL, camera::AE_MODE, &[2]));
        assert!(panel.set(
            PROCESSING_UNIT,
            processing::BRIGHTNESS,
            &(-3_i16).to_le_bytes()
        ));
        assert_eq!(
            panel.value(PROCESSING_UNIT, processing::BRIGHTNESS),
            Some(-3)
        );
        assert_eq!(panel.get(PROCESSING_UNIT, 0x40, request::GET_CUR), None);
    }

    #[test]
    fn crc_matches_the_check_value_of_the_standard() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn hardware_monitor_hands_out_the_colour_table() {
        let mut monitor = HardwareMonitor::new();
        let mut command = vec![0; 1024];
        command[..2].copy_from_slice(&20_u16.to_le_bytes());
        command[2..4].copy_from_slice(&0xcdab_u16.to_le_bytes());
        command[4] = 0x15;
        command[8] = 32;
        assert!(monitor.set(&command));
        let reply = monitor.get(request::GET_CUR).unwrap();
        assert_eq!(reply[..4], [0x15, 0, 0, 0]);
        let table = &reply[4 + 16..];
        let element = |i: usize| {
            f64::from(f32::from_le_bytes(
                table[i * 4..i * 4 + 4].try_into().unwrap(),
            ))
        };
        let found = [
            element(0) * 640.0,
            element(4) * 360.0,
            (1.0 + element(2)) * 640.0,
            (1.0 + element(5)) * 360.0,
        ];
        for (found, stated) in found.into_iter().zip(RGB_INTRINSICS_720P) {
            assert!((found - stated).abs() < 1e-3, "{found} {stated}");
        }
        command[8] = 99;
        assert!(monitor.set(&command));
        let reply = monitor.get(request::GET_CUR).unwrap();
        assert_eq!(reply[..4], [0xff; 4]);
        assert!(!monitor.set(&command[..20]));
    }
}
