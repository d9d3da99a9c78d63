//! The scenarios: what happens to the rig while `gripcast collect` follows a script.

/// What happens when: seconds after all four streams have begun, and a step of [`crate::guest`].
pub(crate) type Step = (f64, &'static str);

/// A scenario.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scenario {
    pub(crate) name: &'static str,
    pub(crate) about: &'static str,
    /// Commands before the program starts.
    pub(crate) setup: &'static [&'static str],
    pub(crate) steps: &'static [Step],
    /// Script of the program.
    pub(crate) script: &'static str,
    /// Size of the disk that holds the dataset, MiB.
    pub(crate) disk_mib: u32,
}

pub(crate) const PLUG_ALL: &[&str] =
    &["attach left", "attach right", "attach d435", "attach pedal"];
const ROOMY_MIB: u32 = 2048;

/// One grasp: the gels are pressed at 2 s.
const ONE_GRASP: &str = "\
wait live
object mug
+0.5 initial
wait saved
wait contact
+0.2 grasp
wait saved
stable
wait saved
quit
";

/// One grasp that starts late, after what happens in the first three seconds.
const LATE_GRASP: &str = "\
wait live
object mug
sleep 1.5
wait live
+0.5 initial
wait saved
wait contact
+0.2 grasp
wait saved
stable
wait saved
quit
";

/// One grasp whose triggers are both refused at first, and come again half a second later.
const SECOND_TRY: &str = "\
wait live
object mug
+0.5 initial
expect refused
+0.5 initial
expect saved
wait contact
+0.2 grasp
expect refused
+0.5 grasp
expect saved
stable
wait saved
quit
";

/// All scenarios.
pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario {
        name: "clean",
        about: "two grasps, nothing goes wrong",
        setup: PLUG_ALL,
        steps: &[
            (2.013, "touch pressed"),
            (3.513, "touch free"),
            (5.013, "touch pressed"),
        ],
        script: "\
wait live
object mug
+0.5 initial
wait saved
wait contact
+0.2 grasp
wait saved
stable
wait saved
wait no-contact
+0.5 initial
wait saved
wait contact
+0.2 grasp
wait saved
slip
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "frames-lost",
        about: "broken and lost packets on the bus, skipped images",
        setup: PLUG_ALL,
        steps: &[
            (0.713, "fault left error-bit 2"),
            (0.913, "fault right lose-packet 3"),
            (1.113, "fault rgb drop 4"),
            (2.013, "touch pressed"),
        ],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "truncated",
        about: "half JPEGs around both triggers",
        setup: PLUG_ALL,
        steps: &[
            (0.413, "fault left truncate 6"),
            (2.013, "touch pressed"),
            (2.113, "fault right truncate 6"),
        ],
        script: SECOND_TRY,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "corrupted",
        about: "JPEGs with altered bytes around both triggers",
        setup: PLUG_ALL,
        steps: &[
            (0.413, "fault right corrupt 6"),
            (2.013, "touch pressed"),
            (2.113, "fault left corrupt 6"),
        ],
        script: SECOND_TRY,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "frozen",
        about: "the left image stands still before the grasp and recovers",
        setup: PLUG_ALL,
        steps: &[
            (1.013, "fault left freeze"),
            (4.013, "fault left none"),
            (5.013, "touch pressed"),
        ],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "silent",
        about: "the left camera sends nothing for three seconds",
        setup: PLUG_ALL,
        steps: &[
            (1.013, "fault left silent"),
            (4.013, "fault left none"),
            (6.013, "touch pressed"),
        ],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "replug-idle",
        about: "the left sensor is pulled out and put back before anything is taken",
        setup: PLUG_ALL,
        steps: &[
            (0.613, "detach left"),
            (2.613, "attach left"),
            (6.013, "touch pressed"),
        ],
        script: LATE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "replug-between",
        about: "the right sensor is pulled out and put back between initial and grasp",
        setup: PLUG_ALL,
        steps: &[
            (1.513, "detach right"),
            (2.513, "attach right"),
            (6.013, "touch pressed"),
        ],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "unplug-during-save",
        about: "the right sensor is pulled out in the moment the pedal takes the grasp",
        setup: PLUG_ALL,
        steps: &[
            (2.013, "touch pressed"),
            (3.013, "pedal press"),
            (3.013, "detach right"),
            (4.013, "attach right"),
        ],
        script: "\
wait live
object mug
+0.5 initial
wait saved
wait contact
sleep 4
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "swapped-ports",
        about: "each sensor sits in the port of the other; roles follow the serials",
        setup: &[
            "attach left 1",
            "attach right 0",
            "attach d435",
            "attach pedal",
        ],
        steps: &[(2.013, "touch pressed")],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "twins-unplugged",
        about: "both sensors have one serial number; they are pulled out one after the other, and \
                the right one comes back first",
        setup: &[
            "twin-serials",
            "attach left",
            "attach right",
            "attach d435",
            "attach pedal",
        ],
        steps: &[
            (1.513, "detach left"),
            (3.513, "detach right"),
            (4.513, "attach right"),
            (7.513, "attach left"),
            (10.013, "touch pressed"),
        ],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "both-unplugged",
        about: "both sensors are pulled out within one frame, and put back together",
        setup: PLUG_ALL,
        steps: &[
            (1.513, "detach left"),
            (1.513, "detach right"),
            (4.513, "attach left"),
            (4.513, "attach right"),
            (8.013, "touch pressed"),
        ],
        script: "\
wait live
object mug
+0.5 initial
expect saved
sleep 1.7
grasp
expect refused
wait contact
+0.2 grasp
expect saved
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "commit-stalls",
        about: "the left sensor refuses to start its stream, when plugged in and after a replug",
        setup: &[
            "stall-commit left 3",
            "attach left",
            "attach right",
            "attach d435",
            "attach pedal",
        ],
        steps: &[
            (1.513, "detach left"),
            (1.613, "stall-commit left 2"),
            (2.513, "attach left"),
            (8.013, "touch pressed"),
        ],
        script: ONE_GRASP,
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "camera-clocks",
        about: "the kernel stamps images with the cameras' clocks: one stands still, one jumps",
        setup: PLUG_ALL,
        steps: &[
            (0.113, "camera-clocks"),
            (0.713, "fault left still-clock"),
            (0.713, "fault right jumping-clock"),
            (3.013, "touch pressed"),
        ],
        script: "\
wait live
object mug
+1.5 initial
wait saved
wait contact
+0.2 grasp
wait saved
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "harmless-bytes",
        about: "bytes before and after the JPEGs, and JPEGs without an end marker",
        setup: PLUG_ALL,
        steps: &[
            (0.313, "fault left tail"),
            (0.313, "fault right lead"),
            (2.013, "touch pressed"),
            (2.013, "fault right no-end"),
        ],
        script: "\
wait live
object mug
+1 initial
expect saved
wait contact
+1 grasp
expect saved
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "always-damaged",
        about: "every JPEG of the left sensor is cut off for three seconds",
        setup: PLUG_ALL,
        steps: &[
            (1.013, "fault left truncate"),
            (4.013, "fault left none"),
            (6.013, "touch pressed"),
        ],
        script: "\
wait live
object mug
+2.5 initial
expect refused
+2 initial
expect saved
wait contact
+0.2 grasp
expect saved
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "zero-depth",
        about: "the depth camera sees nothing for four seconds",
        setup: PLUG_ALL,
        steps: &[
            (1.013, "touch pressed"),
            (1.013, "fault depth zero"),
            (5.013, "fault depth none"),
        ],
        script: "\
wait live
object mug
+0.5 initial
expect saved
wait contact
+2.5 grasp
expect saved
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "disk-full",
        about: "the disk takes the first grasp and has no room for the second",
        setup: PLUG_ALL,
        steps: &[
            (2.013, "touch pressed"),
            (4.013, "touch free"),
            (4.513, "fill-disk 256"),
            (7.013, "touch pressed"),
        ],
        script: "\
wait live
object mug
+0.5 initial
expect refused
override
expect saved
wait contact
+0.2 grasp
expect refused
override
expect saved
stable
expect saved
wait no-contact
+2 initial
expect refused
override
expect refused
quit
",
        disk_mib: 64,
    },
    Scenario {
        name: "read-only",
        about: "the disk becomes read-only after the first grasp",
        setup: PLUG_ALL,
        steps: &[
            (2.013, "touch pressed"),
            (4.013, "touch free"),
            (5.013, "read-only"),
        ],
        script: "\
wait live
object mug
+0.5 initial
expect saved
wait contact
+0.2 grasp
expect saved
stable
expect saved
wait no-contact
+2.5 initial
expect refused
quit
",
        disk_mib: ROOMY_MIB,
    },
    Scenario {
        name: "pedal-bounce",
        about: "a worn pedal takes initial and grasp once each",
        setup: PLUG_ALL,
        steps: &[
            (1.013, "pedal press bounce"),
            (2.013, "touch pressed"),
            (3.013, "pedal press bounce"),
        ],
        script: "\
wait live
object mug
wait contact
sleep 3
stable
wait saved
quit
",
        disk_mib: ROOMY_MIB,
    },
];

/// The scenario of that name.
pub(crate) fn find(name: &str) -> Option<&'static Scenario> {
    SCENARIOS.iter().find(|scenario| scenario.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Command;
    use crate::guest::Action;

    #[test]
    fn every_step_can_be_read_and_times_ascend() {
        for scenario in SCENARIOS {
            for line in scenario.setup {
                assert!(line.parse::<Command>().is_ok(), "{}: {line}", scenario.name);
            }
            for (_, line) in scenario.steps {
                assert!(line.parse::<Action>().is_ok(), "{}: {line}", scenario.name);
            }
            assert!(scenario.steps.is_sorted_by_key(|(at_s, _)| *at_s));
        }
    }

    #[test]
    fn names_are_unique() {
        for scenario in SCENARIOS {
            assert_eq!(find(scenario.name).unwrap().about, scenario.about);
        }
    }
}
