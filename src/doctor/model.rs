//! Checks that the model loads, fits the rig and computes correctly on this processor.

use super::{CheckStatus, Finding};
use crate::model_choice::{default_model, misfit};
use gripcast_base::error::Result;
use gripcast_capture::calibration::RigFile;
use gripcast_nn::predict::{BASELINE, Model, SelfCheck, model_bytes, self_check};

/// Frame interval of a tactile camera, ms.
const FRAME_MS: f64 = 40.0;
/// Maximum difference of the two engines by rounding.
const MAX_ROUNDING: f64 = 1e-5;

/// Checks a model by name; empty for the default of `collect`.
pub(super) fn findings(name: &str, rig: Option<&RigFile>) -> Vec<Finding> {
    if name == "none" {
        let found = "predictions are disabled";
        return vec![Finding::new("model", "none", CheckStatus::Skipped, found)];
    }
    match check_model(name, rig) {
        Ok(findings) => findings,
        Err(error) => vec![Finding::failed("model", name, &error)],
    }
}

fn check_model(name: &str, rig: Option<&RigFile>) -> Result<Vec<Finding>> {
    let (name, why) = match (name, rig) {
        ("", Some(rig)) => default_model(rig)?,
        ("", None) => (gripcast_nn::predict::SHIPPED, None),
        (name, _) => (name, None),
    };
    let bytes = model_bytes(name)?;
    let model = Model::from_bytes(&bytes)?;
    let mut findings = Vec::new();
    if let Some(why) = why {
        let found = format!("{why}: falling back to the heuristic `{BASELINE}`");
        findings.push(
            Finding::new("model", name, CheckStatus::Warn, found)
                .remedy("add the camera to the rig file to use the classifier"),
        );
    }
    if let Some(why) = rig.and_then(|rig| misfit(model.contract(), rig)) {
        findings.push(
            Finding::new("model", name, CheckStatus::Fail, why)
                .remedy("add such a camera to the rig file, or set another --model"),
        );
    }
    findings.push(compute_check(name, &self_check(&bytes)?));
    Ok(findings)
}

fn compute_check(name: &str, check: &SelfCheck) -> Finding {
    let SelfCheck {
        p_stable,
        reference,
        engine_ms,
        load_ms,
    } = *check;
    let found = format!("loads in {load_ms:.0} ms, predicts in {engine_ms:.1} ms");
    let finding = Finding::new("model", name, CheckStatus::Ok, found)
        .measurement("load_ms", load_ms)
        .measurement("engine_ms", engine_ms)
        .measurement("p_stable", p_stable);
    let difference = reference.map_or(0.0, |reference| (reference - p_stable).abs());
    if difference > MAX_ROUNDING {
        let message = format!(
            "expected a probability of {:.6}, found {p_stable:.6}",
            reference.unwrap_or_default()
        );
        return Finding {
            status: CheckStatus::Fail,
            message,
            ..finding
        }
        .remedy("the program or the hardware is faulty: reinstall gripcast, test the memory");
    }
    if engine_ms > FRAME_MS {
        return finding
            .warn("slower than the tactile frame rate, so the gauge lags; use a smaller model");
    }
    finding
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::Role;

    #[test]
    fn built_in_models_pass() {
        let rig = RigFile::virtual_rig();
        for name in ["", BASELINE] {
            let found = findings(name, Some(&rig));
            assert!(
                found.iter().all(|f| f.status <= CheckStatus::Warn),
                "{found:?}"
            );
            assert!(found[0].measurements["load_ms"] > 0.0);
        }
    }

    #[test]
    fn wrong_results_misfits_and_invalid_files_are_reported() {
        let check = SelfCheck {
            p_stable: 0.5,
            reference: Some(0.5001),
            engine_ms: 1.0,
            load_ms: 1.0,
        };
        assert_eq!(compute_check("m", &check).status, CheckStatus::Fail);
        let slow = SelfCheck {
            reference: None,
            engine_ms: 50.0,
            ..check
        };
        assert_eq!(compute_check("m", &slow).status, CheckStatus::Warn);

        let mut rig = RigFile::virtual_rig();
        rig.cameras.remove(&Role::Left);
        let default = findings("", Some(&rig));
        assert_eq!(
            (default[0].status, &*default[0].name),
            (CheckStatus::Warn, BASELINE)
        );
        let named = findings(gripcast_nn::predict::SHIPPED, Some(&rig));
        assert_eq!(named[0].status, CheckStatus::Fail, "{named:?}");
        assert_eq!(findings("no-such-file", None)[0].status, CheckStatus::Fail);
    }
}
