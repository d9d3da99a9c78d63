//! A long collection during which things go wrong at random, the same for the same seed.

use std::fmt::Write as _;

use crate::scenario::PLUG_ALL;

/// From one pressing of the gels to the next, s.
const CYCLE_S: f64 = 20.0;
const PRESSED_S: f64 = 8.0;
/// The last pause of the faults before the closing grasp, s.
const QUIET_S: f64 = 10.0;
/// The first initial frame is taken before: without one nothing is known to touch.
const FIRST_FAULT_S: f64 = 8.0;
/// Room for a grasp, MiB.
const GRASP_MIB: u64 = 16;
/// Room that must stay free for a trigger to be taken (1000 MB), and some more, MiB.
const BASE_MIB: u64 = 1536;

/// A soak of a length.
pub(crate) struct Soak {
    steps: Vec<(f64, String)>,
    script: String,
}

/// The first numbers of SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn of<'a>(&mut self, choices: &[&'a str]) -> &'a str {
        choices[(self.next() % choices.len() as u64) as usize]
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Grasps that are tried in that time.
fn cycles(seconds: f64) -> u64 {
    (seconds / CYCLE_S).ceil().max(1.0) as u64
}

/// Disk that the grasps of that time need, MiB.
pub(crate) fn disk_mib(seconds: f64) -> u64 {
    BASE_MIB + GRASP_MIB * cycles(seconds)
}

impl Soak {
    /// Faults come every few seconds, a grasp is tried every [`CYCLE_S`]; one that a fault spoils
    /// is refused, and the next is tried. The last one must be saved.
    pub(crate) fn new(seconds: f64, seed: u64) -> Self {
        let mut random = Random(seed);
        let mut steps = Vec::new();
        let mut at = FIRST_FAULT_S;
        while at < seconds - QUIET_S {
            let lasts = random.between(0.5, 4.0);
            let (begin, end) = fault(&mut random);
            steps.push((at, begin));
            steps.extend(end.map(|end| (at + lasts, end)));
            // One after the other: what ends a fault of a camera would end the next one too.
            at += lasts + random.between(1.0, 12.0);
        }
        // The gels go on being pressed for a script that lags behind; it ends the run.
        for cycle in 0..2 * cycles(seconds) + 4 {
            let pressed = CYCLE_S * cycle as f64 + 5.0;
            steps.push((pressed, "touch pressed".to_owned()));
            steps.push((pressed + PRESSED_S, "touch free".to_owned()));
        }
        steps.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Between frames.
        for (at, _) in &mut steps {
            *at = (*at * 25.0).round() / 25.0 + 0.013;
        }
        Self {
            steps,
            script: script(seconds, &mut random),
        }
    }

    pub(crate) fn setup(&self) -> &'static [&'static str] {
        PLUG_ALL
    }

    pub(crate) fn steps(&self) -> Vec<(f64, &str)> {
        let steps = self.steps.iter();
        steps.map(|(at, line)| (*at, line.as_str())).collect()
    }

    pub(crate) fn script(&self) -> &str {
        &self.script
    }
}

/// What begins a fault, and what ends it where it does not end by itself.
fn fault(random: &mut Random) -> (String, Option<String>) {
    let images = 1 + random.next() % 12;
    match random.next() % 4 {
        0 => {
            let device = random.of(&["left", "right", "d435", "pedal"]);
            (format!("detach {device}"), Some(format!("attach {device}")))
        }
        1 => {
            let camera = random.of(&["left", "right", "rgb", "depth"]);
            let kind = random.of(&["freeze", "silent"]);
            let end = format!("fault {camera} none");
            (format!("fault {camera} {kind}"), Some(end))
        }
        2 => {
            let camera = random.of(&["left", "right"]);
            let kind = random.of(&["truncate", "corrupt"]);
            (format!("fault {camera} {kind} {images}"), None)
        }
        _ => {
            let camera = random.of(&["left", "right", "rgb", "depth"]);
            let kind = random.of(&["error-bit", "lose-packet", "drop"]);
            (format!("fault {camera} {kind} {images}"), None)
        }
    }
}

fn script(seconds: f64, random: &mut Random) -> String {
    let mut script = "wait live\nobject mug\n+0.5 initial\nexpect saved\n".to_owned();
    for cycle in 0..cycles(seconds) {
        let outcome = random.of(&["stable", "slip"]);
        if cycle > 0 {
            script.push_str("wait no-contact 600\n+1 initial\n");
        }
        // Writing into a string cannot fail.
        let _ = write!(script, "wait contact 600\n+1 grasp\n+1 {outcome}\n");
    }
    script.push_str(
        "wait no-contact 600\nsleep 60\nwait live\nwait no-contact 60\nstable\n+1 initial\n\
         expect saved\nwait contact 60\n+1 grasp\nexpect saved\nstable\nexpect saved\nquit\n",
    );
    script
}

#[cfg(test)]
mod tests {
    use gripcast_capture::trigger::Script;

    use super::*;
    use crate::guest::Action;

    #[test]
    fn seed_gives_reproducible_readable_soak() {
        let soak = Soak::new(300.0, 4);
        let again = Soak::new(300.0, 4);
        assert_eq!((&soak.steps, &soak.script), (&again.steps, &again.script));
        assert_ne!(soak.steps, Soak::new(300.0, 5).steps);
        for (_, line) in &soak.steps {
            assert!(line.parse::<Action>().is_ok(), "{line}");
        }
        assert!(soak.steps.is_sorted_by_key(|(at_s, _)| *at_s));
        let any = |_: &str| Ok(());
        assert!(Script::parse(&soak.script, "script", &any).is_ok());
    }

    #[test]
    fn every_fault_has_an_end_before_the_next() {
        let soak = Soak::new(3600.0, 1);
        let mut open: Option<&str> = None;
        for (_, line) in &soak.steps {
            let words: Vec<&str> = line.split_whitespace().collect();
            match *words.as_slice() {
                ["detach", device] | ["fault", device, "freeze" | "silent"] => {
                    assert_eq!(open.replace(device), None, "{line}");
                }
                ["attach", device] | ["fault", device, "none"] => {
                    assert_eq!(open.take(), Some(device), "{line}");
                }
                _ => {}
            }
        }
        assert_eq!(open, None);
    }
}
