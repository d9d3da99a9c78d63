//! How well a score tells ahead that a grasp is being lost.

use std::collections::BTreeMap;

use gripcast_base::random::SeedStream;
use gripcast_base::statistics::quantile;
use serde::Serialize;

/// Resampled sets of objects.
const RESAMPLES: usize = 1000;
/// Frames before a loss at which the score is compared.
const AHEAD: [usize; 3] = [1, 2, 4];
/// Fractions of the clips without loss that may be alarmed.
const ALARMED: [f64; 2] = [0.05, 0.1];
/// Frames before the loss by which an alarm must come.
const IN_TIME: usize = 2;

/// The score of a clip in each frame from the contact of both fingers on.
#[derive(Clone, Debug)]
pub(crate) struct ScoredClip {
    pub(crate) object: String,
    /// Frames from the contact to the loss; `None` for a clip without loss.
    pub(crate) loss: Option<usize>,
    /// Score by frame after the contact; of a clip with a loss, those before it.
    pub(crate) scores: Vec<f32>,
}

/// A figure with a 95 % interval over objects; the interval is missing where the figure is undefined
/// in most resampled sets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Figure {
    pub(crate) value: f64,
    pub(crate) interval: Option<[f64; 2]>,
}

/// The figures of an alarm in one phase of the grasps.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct AlarmFigures {
    pub(crate) losses: usize,
    pub(crate) without_loss: usize,
    /// By frames before the loss: the probability that the score of a clip with a loss exceeds that
    /// of a clip without, the same number of frames after the contact.
    pub(crate) concordance: BTreeMap<String, Option<Figure>>,
    /// By the fraction of clips without loss that may be alarmed: fraction of the losses alarmed at
    /// least two frames ahead.
    pub(crate) told_ahead: BTreeMap<String, Option<Figure>>,
}

/// A figure of clips with a loss and clips without.
type AlarmFigure<'a> = dyn Fn(&[&ScoredClip], &[&ScoredClip]) -> Option<f64> + 'a;

/// Scores an alarm on the losses within `frames` after the contact. No frame beyond its end counts,
/// so that the length of a clip says nothing.
pub(crate) fn alarm_figures(clips: &[ScoredClip], frames: std::ops::Range<usize>) -> AlarmFigures {
    let is_loss = |clip: &&ScoredClip| clip.loss.is_some_and(|loss| frames.contains(&loss));
    let losses: Vec<&ScoredClip> = clips.iter().filter(is_loss).collect();
    let held: Vec<&ScoredClip> = clips.iter().filter(|clip| clip.loss.is_none()).collect();
    let figure = |of: &AlarmFigure<'_>| with_interval(&losses, &held, of);
    let concordance = AHEAD.map(|ahead| {
        let value = figure(&|losses, held| concordance(losses, held, ahead));
        (format!("{ahead}"), value)
    });
    let told_ahead = ALARMED.map(|alarmed| {
        let value = figure(&|losses, held| told_ahead(losses, held, alarmed, frames.end));
        (format!("{alarmed}"), value)
    });
    AlarmFigures {
        losses: losses.len(),
        without_loss: held.len(),
        concordance: concordance.into(),
        told_ahead: told_ahead.into(),
    }
}

fn concordance(losses: &[&ScoredClip], held: &[&ScoredClip], ahead: usize) -> Option<f64> {
    let (mut sum, mut pairs) = (0.0, 0_usize);
    for lost in losses {
        let at = lost.loss?.checked_sub(ahead);
        let Some((at, score)) = at.and_then(|at| Some((at, *lost.scores.get(at)?))) else {
            continue;
        };
        for other in held.iter().filter_map(|clip| clip.scores.get(at)) {
            sum += match score.total_cmp(other) {
                std::cmp::Ordering::Greater => 1.0,
                std::cmp::Ordering::Equal => 0.5,
                std::cmp::Ordering::Less => 0.0,
            };
            pairs += 1;
        }
    }
    (pairs > 0).then(|| sum / pairs as f64)
}

fn told_ahead(
    losses: &[&ScoredClip],
    held: &[&ScoredClip],
    alarmed: f64,
    end: usize,
) -> Option<f64> {
    if losses.is_empty() || held.is_empty() {
        return None;
    }
    let max = |scores: &[f32]| scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut highest: Vec<f32> = held
        .iter()
        .map(|clip| max(&clip.scores[..clip.scores.len().min(end)]))
        .collect();
    highest.sort_by(|a, b| b.total_cmp(a));
    // The smallest limit that at most this fraction of the clips exceeds.
    let allowed = (alarmed * held.len() as f64).floor() as usize;
    let limit = highest[allowed.min(highest.len() - 1)];
    let is_told = |lost: &&&ScoredClip| {
        let before = lost.loss.unwrap_or_default().saturating_sub(IN_TIME) + 1;
        max(&lost.scores[..lost.scores.len().min(before)]) > limit
    };
    Some(losses.iter().filter(is_told).count() as f64 / losses.len() as f64)
}

/// The figure, with its interval over resampled objects.
fn with_interval(
    losses: &[&ScoredClip],
    held: &[&ScoredClip],
    of: &AlarmFigure<'_>,
) -> Option<Figure> {
    let value = of(losses, held)?;
    let mut objects: Vec<&str> = losses
        .iter()
        .chain(held)
        .map(|clip| clip.object.as_str())
        .collect();
    objects.sort_unstable();
    objects.dedup();
    let mut random = SeedStream::named(0, "objects of recorded clips");
    let mut values: Vec<f64> = (0..RESAMPLES)
        .filter_map(|_| {
            let drawn: Vec<&str> = objects
                .iter()
                .map(|_| objects[random.index(objects.len())])
                .collect();
            let resampled = |clips: &[&'_ ScoredClip]| -> Vec<usize> {
                let of_object = |object: &&str| {
                    let of_object = clips.iter().enumerate();
                    let object = (*object).to_owned();
                    of_object
                        .filter(move |(_, clip)| clip.object == object)
                        .map(|(at, _)| at)
                        .collect::<Vec<_>>()
                };
                drawn.iter().flat_map(of_object).collect()
            };
            let pick = |clips: &[&'_ ScoredClip]| resampled(clips);
            let losses: Vec<&ScoredClip> = pick(losses).into_iter().map(|at| losses[at]).collect();
            let held: Vec<&ScoredClip> = pick(held).into_iter().map(|at| held[at]).collect();
            of(&losses, &held)
        })
        .collect();
    values.sort_by(f64::total_cmp);
    let interval = (values.len() > RESAMPLES / 2)
        .then(|| Some([quantile(&values, 0.025)?, quantile(&values, 0.975)?]))
        .flatten();
    Some(Figure { value, interval })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clip(object: &str, loss: Option<usize>, scores: &[f32]) -> ScoredClip {
        ScoredClip {
            object: object.to_owned(),
            loss,
            scores: scores.to_vec(),
        }
    }

    #[test]
    fn concordance_compares_the_same_frames_after_the_contact() {
        let clips = [
            clip("a", Some(4), &[0.0, 0.0, 0.3, 0.6]),
            clip("b", None, &[0.9, 0.1, 0.4, 0.1, 0.0]),
            clip("c", None, &[0.0, 0.2, 0.2, 0.6, 0.9]),
        ];
        let figures = alarm_figures(&clips, 0..10);
        let value = |ahead: &str| figures.concordance[ahead].unwrap().value;
        // 0.6 against 0.1 and 0.6; 0.3 against 0.4 and 0.2; 0.0 against 0.9 and 0.0.
        assert_eq!([value("1"), value("2"), value("4")], [0.75, 0.5, 0.25]);
        assert_eq!((figures.losses, figures.without_loss), (1, 2));
    }

    #[test]
    fn losses_count_as_told_only_ahead_of_time() {
        let mut clips: Vec<ScoredClip> = (0..10)
            .map(|at| clip("held", None, &[0.1 * at as f32, 0.0, 0.0, 0.0]))
            .collect();
        // At most one of ten may be alarmed: the limit is 0.8.
        clips.push(clip("early", Some(3), &[0.0, 0.85, 0.0]));
        clips.push(clip("late", Some(3), &[0.0, 0.0, 0.95]));
        let figures = alarm_figures(&clips, 0..10);
        assert_eq!(figures.told_ahead["0.1"].unwrap().value, 0.5);
        // None may be: 0.9 is exceeded by no clip without a loss.
        assert_eq!(figures.told_ahead["0.05"].unwrap().value, 0.0);
        // A loss of another phase is none here.
        assert_eq!(alarm_figures(&clips, 10..20).losses, 0);
        assert!(alarm_figures(&clips, 10..20).concordance["1"].is_none());
    }
}
