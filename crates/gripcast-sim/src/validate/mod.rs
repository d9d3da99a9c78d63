//! Validation of the simulator against theory and converged finite elements.
//!
//! Values found by the simulator are compared, within a tolerance, with a formula or with the press
//! reference in `tests/data/press_reference.json`. [`Effort::Quick`] uses coarser meshes, fewer
//! grasps and wider tolerances.

mod bodies;
mod contact_cases;
mod grasp_cases;
mod overlap;
mod pinch;
mod press_cases;
mod random_grasp;
mod report;
mod shear_cases;

pub use report::{CaseResult, Report, Tolerance};

use report::Recorder;

use gripcast_base::error::{Result, unknown_name};

/// Amount of computation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// One or two minutes.
    Quick,
    /// The meshes and numbers of grasps of the documented results.
    #[default]
    Full,
}

/// Runs a case group; whether with quick effort.
type RunGroup = fn(&mut Recorder, bool) -> Result<()>;

/// Case groups, in the order of execution.
const GROUPS: [(&str, RunGroup); 18] = [
    ("free-fall", |recorder, _| bodies::free_fall(recorder)),
    ("momentum", |recorder, _| bodies::momentum(recorder)),
    ("incline", |recorder, _| bodies::incline(recorder)),
    ("balance", |recorder, _| contact_cases::balance(recorder)),
    ("creep", |recorder, _| contact_cases::creep(recorder)),
    ("gap", |recorder, _| contact_cases::gap(recorder)),
    ("drive", |recorder, _| contact_cases::drive(recorder)),
    ("lift", contact_cases::lift),
    ("determinism", grasp_cases::determinism),
    ("penetration", grasp_cases::penetration),
    ("press-plate", |r, quick| press_cases::plate().run(r, quick)),
    ("press-cylinder", |r, quick| {
        press_cases::cylinder().run(r, quick)
    }),
    ("press-edge", |r, quick| press_cases::edge().run(r, quick)),
    ("press-sphere-10mm", |r, quick| {
        press_cases::sphere_10().run(r, quick)
    }),
    ("press-sphere-3mm", |r, quick| {
        press_cases::sphere_3().run(r, quick)
    }),
    ("press-friction", press_cases::friction),
    ("press-stick", shear_cases::stick_region),
    ("mesh", grasp_cases::mesh_agreement),
];

/// Names of the case groups, in the order of execution.
pub fn case_names() -> [&'static str; GROUPS.len()] {
    GROUPS.map(|(name, _)| name)
}

/// Checks that all names are in [`case_names`].
///
/// # Errors
/// `Usage` with the first unknown name and the nearest known one.
pub fn check_names(names: &[String]) -> Result<()> {
    let known = case_names();
    let unknown = names.iter().find(|name| !known.contains(&name.as_str()));
    unknown.map_or(Ok(()), |name| Err(unknown_name("case", name, &known)))
}

/// Runs the given case groups, or all if `names` is empty.
///
/// # Errors
/// As [`check_names`]. A value out of tolerance is not an error; it counts as failed.
pub fn run(names: &[String], effort: Effort) -> Result<Report> {
    check_names(names)?;
    let mut report = Report::default();
    for (group, run_group) in GROUPS {
        if names.is_empty() || names.iter().any(|name| name == group) {
            let mut recorder = Recorder::new(group);
            run_group(&mut recorder, effort == Effort::Quick)?;
            report.add(recorder.cases);
        }
    }
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    /// Runs a group with quick effort; all comparisons must pass.
    fn passes(group: &str) {
        let report = run(&[group.to_owned()], Effort::Quick).unwrap();
        assert!(!report.cases.is_empty());
        println!(
            "{:#?}",
            report
                .cases
                .iter()
                .map(|c| (c.name.clone(), c.expected, c.found, c.passed))
                .collect::<Vec<_>>()
        );
        let failed: Vec<_> = report.cases.iter().filter(|case| !case.passed).collect();
        assert!(failed.is_empty(), "{failed:#?}");
    }

    macro_rules! groups {
        ($($test:ident: $group:literal),* $(,)?) => {
            $(#[test] fn $test() { passes($group); })*

            #[test]
            fn every_group_is_tested() {
                let tested = [$($group),*, "mesh"];
                assert!(case_names().iter().all(|name| tested.contains(name)));
            }
        };
    }

    // `mesh` takes minutes: grasp_cases.rs tests it with one grasp.
    groups! {
        free_fall: "free-fall",
        momentum: "momentum",
        incline: "incline",
        balance: "balance",
        creep: "creep",
        gap: "gap",
        drive: "drive",
        lift: "lift",
        determinism: "determinism",
        penetration: "penetration",
        press_plate: "press-plate",
        press_cylinder: "press-cylinder",
        press_edge: "press-edge",
        press_sphere_10mm: "press-sphere-10mm",
        press_sphere_3mm: "press-sphere-3mm",
        press_friction: "press-friction",
        press_stick: "press-stick",
    }

    #[test]
    fn misspelt_case_suggests_the_nearest() {
        let error = run(&["press-spere-10mm".to_owned()], Effort::Quick).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(error.to_string().contains("press-sphere-10mm"));
    }
}
