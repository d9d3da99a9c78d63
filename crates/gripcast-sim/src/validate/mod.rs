//! The simulator held against theory and against converged finite elements.
//!
//! Every number is expected from a formula or from the press reference of
//! `tests/data/press_reference.json`, found by a run of the simulator, and held against a
//! tolerance. [`Effort::Quick`] takes coarser meshes, fewer grasps and wider tolerances.

mod bodies;
mod contact_cases;
mod grasp_cases;
mod overlap;
mod pinch;
mod press_cases;
mod random_grasp;
mod report;

pub use grasp_cases::{MeshOutcomes, mesh_outcomes};
pub use report::{CaseResult, Report, Tolerance};

use report::Recorder;

use gripcast_base::error::{Error, Result, nearest_name};

/// How much is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// A minute or two.
    Quick,
    /// The meshes and numbers of grasps that the goals are stated for.
    #[default]
    Full,
}

/// Groups of cases, in the order they are run.
pub const CASE_NAMES: &[&str] = &[
    "free-fall",
    "momentum",
    "incline",
    "balance",
    "creep",
    "gap",
    "drive",
    "lift",
    "determinism",
    "penetration",
    "press-plate",
    "press-cylinder",
    "press-edge",
    "press-sphere-10mm",
    "press-sphere-3mm",
    "press-friction",
    "mesh",
];

/// Checks that all names are of [`CASE_NAMES`].
///
/// # Errors
/// `Usage` with the first that is not, and the nearest that is.
pub fn check_names(names: &[String]) -> Result<()> {
    let Some(name) = names.iter().find(|n| !CASE_NAMES.contains(&n.as_str())) else {
        return Ok(());
    };
    let hint = nearest_name(name, CASE_NAMES.iter().copied());
    let hint = hint.map_or(String::new(), |n| format!("did you mean {n}? "));
    let what = format!("there is no case named {name:?}");
    let remedy = format!("{hint}known are: {}", CASE_NAMES.join(", "));
    Err(Error::usage(what).remedy(remedy))
}

/// Runs the named groups of cases, or all if none is named.
///
/// # Errors
/// As [`check_names`]. A number that does not hold is no error but counted as failed.
pub fn run(names: &[String], effort: Effort) -> Result<Report> {
    check_names(names)?;
    let mut report = Report::default();
    for &group in CASE_NAMES {
        if names.is_empty() || names.iter().any(|name| name == group) {
            let mut recorder = Recorder::new(group);
            run_group(group, effort == Effort::Quick, &mut recorder)?;
            report.add(recorder.cases);
        }
    }
    Ok(report)
}

fn run_group(group: &str, is_quick: bool, recorder: &mut Recorder) -> Result<()> {
    match group {
        "free-fall" => bodies::free_fall(recorder),
        "momentum" => bodies::momentum(recorder),
        "incline" => bodies::incline(recorder),
        "balance" => contact_cases::balance(recorder),
        "creep" => contact_cases::creep(recorder),
        "gap" => contact_cases::gap(recorder),
        "drive" => contact_cases::drive(recorder),
        "lift" => contact_cases::lift(recorder, is_quick),
        "determinism" => grasp_cases::determinism(recorder, is_quick),
        "penetration" => grasp_cases::penetration(recorder, if is_quick { 7 } else { 200 }),
        "press-plate" => press_cases::plate().run(recorder, is_quick),
        "press-cylinder" => press_cases::cylinder().run(recorder, is_quick),
        "press-edge" => press_cases::edge().run(recorder, is_quick),
        "press-sphere-10mm" => press_cases::sphere_10().run(recorder, is_quick),
        "press-sphere-3mm" => press_cases::sphere_3().run(recorder, is_quick),
        "press-friction" => press_cases::friction(recorder, is_quick),
        "mesh" => grasp_cases::mesh_agreement(recorder, is_quick),
        other => Err(Error::internal(format!(
            "case {other} is listed but not written"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    /// Runs a group with little effort; every number must hold.
    fn passes(group: &str) {
        let report = run(&[group.to_owned()], Effort::Quick).unwrap();
        assert!(!report.cases.is_empty());
        let failed: Vec<_> = report.cases.iter().filter(|case| !case.passed).collect();
        assert!(failed.is_empty(), "{failed:#?}");
    }

    macro_rules! groups {
        ($($test:ident: $group:literal),* $(,)?) => {
            $(#[test] fn $test() { passes($group); })*

            #[test]
            fn every_group_is_tested() {
                let tested = [$($group),*, "mesh"];
                assert!(CASE_NAMES.iter().all(|name| tested.contains(name)));
            }
        };
    }

    // `mesh` runs for minutes: grasp_cases.rs tests it with one grasp.
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
    }

    #[test]
    fn a_misspelt_case_is_answered_with_the_nearest() {
        let error = run(&["press-spere-10mm".to_owned()], Effort::Quick).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(error.to_string().contains("press-sphere-10mm"));
    }
}
