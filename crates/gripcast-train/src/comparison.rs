//! Compares a fine-tuned model with its start model on the validation split.

use serde::Serialize;

use super::evaluate::{SEED, grouped};
use super::finish::calibrate;
use super::metrics::{Bootstrap, Interval, Scored, Summary};
use super::resampled::ResampledMetrics;
use super::samples::Samples;
use super::start::StartModel;
use super::validate::Logit;
use gripcast_nn::predict::contract::Modality;

/// Objects and lifts below which no improvement counts as shown: a bootstrap over fewer objects
/// gives intervals that are too narrow.
const MIN_OBJECTS: usize = 5;
const MIN_LIFTS: usize = 20;

/// Whether a fine-tuned model is better than its start model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// One metric is better with its whole interval, neither is worse, and there are enough objects.
    Better,
    /// The metrics rise or disagree, but chance explains it or there are too few objects.
    NotShown,
    /// Neither metric is better.
    NotBetter,
}

/// Comparison of a fine-tuned model with its start model on the validation split.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the start model.
    pub start: String,
    /// SHA-256 of its file.
    pub start_sha256: String,
    /// Its metrics, as it is.
    pub start_validation: Summary,
    /// Number of objects of the split.
    pub objects: usize,
    /// Number of lifts of the split.
    pub lifts: usize,
    /// Difference in AUROC, fine-tuned minus start, with its 95 % interval over objects; none with
    /// one object.
    pub auroc: Option<Interval>,
    /// Difference in balanced accuracy; both thresholds are fitted on this split.
    pub balanced_accuracy: Option<Interval>,
    /// OOD score that the fine-tuned model gives the mean of the start model's training images; up
    /// to 1 both kinds of images are in distribution. None without OOD detectors.
    pub ood_score_of_start: Option<f64>,
    /// Whether the fine-tuned model is better.
    pub verdict: Verdict,
    /// What follows, one sentence.
    pub advice: String,
}

impl Comparison {
    /// Compares the logits of both networks from some inputs on the samples of a split.
    pub(super) fn new(
        start: &StartModel,
        inputs: Modality,
        start_logits: &[Logit],
        tuned_logits: &[Logit],
        samples: &Samples,
    ) -> Self {
        let facts = samples.facts();
        let (objects, object_of) = grouped(facts, |facts| facts.object.clone());
        let (lifts, _) = grouped(facts, |facts| facts.lift.clone());
        let metrics = |logits: &[Logit]| {
            let (temperature, threshold) = calibrate(logits);
            let scored: Vec<Scored> = logits.iter().map(|x| x.scored(temperature)).collect();
            ResampledMetrics::new(&scored, threshold)
        };
        // Calibrated alike, or the threshold alone would favour the model that was fitted here.
        let (before, after) = (metrics(start_logits), metrics(tuned_logits));
        let all = vec![1; facts.len()];
        let gain = |metric: fn(&ResampledMetrics, &[u32]) -> Option<f64>| {
            let estimate = Some(metric(&after, &all)? - metric(&before, &all)?);
            let interval = Bootstrap::new(SEED).paired_interval(
                &object_of,
                |times| metric(&after, times),
                |times| metric(&before, times),
            );
            Some(Gain {
                estimate: estimate?,
                interval,
            })
        };
        let auroc = gain(ResampledMetrics::auroc);
        let balanced_accuracy = gain(ResampledMetrics::balanced_accuracy);
        let gains: Vec<Gain> = auroc.into_iter().chain(balanced_accuracy).collect();
        let counts = [objects.len(), lifts.len()];
        let verdict = verdict(&gains, counts);
        let as_it_is: Vec<Scored> = start_logits.iter().map(|x| x.scored(1.0)).collect();
        let contract = start.contract();
        let output = contract.outputs().find(|output| output.modality == inputs);
        let threshold = output.map_or(contract.threshold, |output| output.threshold);
        Self {
            start: contract.name.clone(),
            start_sha256: start.sha256().to_owned(),
            start_validation: Summary::new(&as_it_is, threshold),
            objects: counts[0],
            lifts: counts[1],
            auroc: auroc.and_then(|gain| gain.interval),
            balanced_accuracy: balanced_accuracy.and_then(|gain| gain.interval),
            ood_score_of_start: None,
            verdict,
            advice: advice(verdict, &contract.name, counts),
        }
    }
}

/// Difference of a metric, fine-tuned minus start.
#[derive(Clone, Copy, Debug)]
struct Gain {
    estimate: f64,
    interval: Option<Interval>,
}

fn is_enough([objects, lifts]: [usize; 2]) -> bool {
    objects >= MIN_OBJECTS && lifts >= MIN_LIFTS
}

fn verdict(gains: &[Gain], counts: [usize; 2]) -> Verdict {
    let is_shown = |gain: &Gain| gain.interval.is_some_and(|interval| interval.low > 0.0);
    if !gains.iter().any(|gain| gain.estimate > 0.0) {
        Verdict::NotBetter
    } else if is_enough(counts)
        && gains.iter().all(|gain| gain.estimate >= 0.0)
        && gains.iter().any(is_shown)
    {
        Verdict::Better
    } else {
        Verdict::NotShown
    }
}

fn advice(verdict: Verdict, start: &str, counts: [usize; 2]) -> String {
    let [objects, lifts] = counts;
    match verdict {
        Verdict::Better => format!(
            "better than `{start}` on the validation split, on which its epoch was chosen: confirm \
             it with `gripcast eval` on the split `test`"
        ),
        Verdict::NotBetter => {
            format!("not better than `{start}` on the validation split: keep `{start}`")
        }
        Verdict::NotShown if is_enough(counts) => format!(
            "an improvement over `{start}` is not shown: chance explains the difference, or one \
             metric is lower; keep `{start}` until `gripcast eval` on more grasps shows one"
        ),
        Verdict::NotShown => format!(
            "an improvement over `{start}` is not shown: the validation split has {lifts} lifts of \
             {objects} objects, at least {MIN_LIFTS} of {MIN_OBJECTS} are needed; label more \
             grasps of more objects"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gain(estimate: f64, bounds: Option<[f64; 2]>) -> Gain {
        let interval = bounds.map(|[low, high]| Interval {
            estimate,
            low,
            high,
            resamples: 2000,
        });
        Gain { estimate, interval }
    }

    #[test]
    fn better_needs_whole_interval_and_enough_objects() {
        let up = gain(0.2, Some([0.05, 0.3]));
        let maybe = gain(0.1, Some([-0.1, 0.3]));
        let same = gain(0.0, Some([-0.1, 0.1]));
        let down = gain(-0.1, Some([-0.2, 0.0]));
        let alone = gain(0.3, None);
        for (gains, counts, expected) in [
            (vec![up, same], [5, 20], Verdict::Better),
            (vec![up, same], [4, 20], Verdict::NotShown),
            (vec![up, same], [5, 19], Verdict::NotShown),
            (vec![up, down], [9, 90], Verdict::NotShown),
            (vec![maybe, same], [9, 90], Verdict::NotShown),
            (vec![alone], [1, 90], Verdict::NotShown),
            (vec![same, down], [9, 90], Verdict::NotBetter),
            (vec![], [9, 90], Verdict::NotBetter),
        ] {
            assert_eq!(verdict(&gains, counts), expected, "{gains:?} {counts:?}");
        }
    }

    #[test]
    fn advice_names_start_model_and_what_is_missing() {
        let text = advice(Verdict::NotBetter, "gripcast-vt", [9, 90]);
        assert!(text.ends_with("keep `gripcast-vt`"), "{text}");
        let text = advice(Verdict::NotShown, "gripcast-vt", [2, 6]);
        assert!(text.contains("6 lifts of 2 objects"), "{text}");
    }
}
