//! Whether the model loads, fits the rig and computes on this processor what it should.

use super::{Finding, Verdict};
use crate::model_choice::{misfit, usual_model};
use gripcast_base::error::Result;
use gripcast_capture::calibration::RigFile;
use gripcast_nn::predict::{BASELINE, Model, SelfCheck, model_bytes, self_check};

/// Time between two frames of a gel, ms.
const FRAME_MS: f64 = 40.0;
/// Largest difference of the two engines that rounding explains.
const ROUNDING: f64 = 1e-5;

/// The model of a name; empty for the one that `collect` would take.
pub(super) fn findings(name: &str, rig: Option<&RigFile>) -> Vec<Finding> {
    if name == "none" {
        let found = "predictions are switched off";
        return vec![Finding::new("model", "none", Verdict::Skipped, found)];
    }
    match looked_at(name, rig) {
        Ok(findings) => findings,
        Err(error) => vec![Finding::failed("model", name, &error)],
    }
}

fn looked_at(name: &str, rig: Option<&RigFile>) -> Result<Vec<Finding>> {
    let (name, why) = match (name, rig) {
        ("", Some(rig)) => usual_model(rig)?,
        ("", None) => (gripcast_nn::predict::SHIPPED, None),
        (name, _) => (name, None),
    };
    let bytes = model_bytes(name)?;
    let model = Model::from_bytes(&bytes)?;
    let mut findings = Vec::new();
    if let Some(why) = why {
        let found = format!("{why}: `{BASELINE}`, a heuristic, predicts");
        findings.push(
            Finding::new("model", name, Verdict::Warn, found)
                .remedy("bind the camera in the rig file to use the classifier"),
        );
    }
    if let Some(why) = rig.and_then(|rig| misfit(model.contract(), rig)) {
        findings.push(
            Finding::new("model", name, Verdict::Fail, why)
                .remedy("bind such a camera in the rig file, or choose another --model"),
        );
    }
    findings.push(answers(name, &self_check(&bytes)?));
    Ok(findings)
}

fn answers(name: &str, check: &SelfCheck) -> Finding {
    let SelfCheck {
        p_stable,
        reference,
        engine_ms,
        load_ms,
    } = *check;
    let found = format!("loaded in {load_ms:.0} ms, predicts in {engine_ms:.1} ms");
    let finding = Finding::new("model", name, Verdict::Ok, found)
        .figure("load_ms", load_ms)
        .figure("engine_ms", engine_ms)
        .figure("p_stable", p_stable);
    let difference = reference.map_or(0.0, |reference| (reference - p_stable).abs());
    if difference > ROUNDING {
        let found = format!(
            "answers {p_stable:.6} here, but {:.6} by reference arithmetic",
            reference.unwrap_or_default()
        );
        return Finding {
            verdict: Verdict::Fail,
            found,
            ..finding
        }
        .remedy("the processor or the program is damaged: install it again, test the memory");
    }
    if engine_ms > FRAME_MS {
        return Finding {
            verdict: Verdict::Warn,
            ..finding
        }
        .remedy("slower than a gel's frames come: the gauge lags; use a smaller model");
    }
    finding
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::Role;

    #[test]
    fn built_in_models_are_sound_here() {
        let rig = RigFile::virtual_rig();
        for name in ["", BASELINE] {
            let found = findings(name, Some(&rig));
            assert!(
                found.iter().all(|f| f.verdict <= Verdict::Warn),
                "{found:?}"
            );
            assert!(found[0].figures["load_ms"] > 0.0);
        }
    }

    #[test]
    fn wrong_arithmetic_misfits_and_files_that_are_none_are_told() {
        let check = SelfCheck {
            p_stable: 0.5,
            reference: Some(0.5001),
            engine_ms: 1.0,
            load_ms: 1.0,
        };
        assert_eq!(answers("m", &check).verdict, Verdict::Fail);
        let slow = SelfCheck {
            reference: None,
            engine_ms: 50.0,
            ..check
        };
        assert_eq!(answers("m", &slow).verdict, Verdict::Warn);

        let mut rig = RigFile::virtual_rig();
        rig.cameras.remove(&Role::Rgb);
        let usual = findings("", Some(&rig));
        assert_eq!(
            (usual[0].verdict, &*usual[0].name),
            (Verdict::Warn, BASELINE)
        );
        let named = findings(gripcast_nn::predict::SHIPPED, Some(&rig));
        assert_eq!(named[0].verdict, Verdict::Fail, "{named:?}");
        assert_eq!(findings("no-such-file", None)[0].verdict, Verdict::Fail);
    }
}
