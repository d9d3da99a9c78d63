//! Adam (Kingma and Ba, 2015) with decoupled weight decay (Loshchilov and Hutter, 2019).

use super::architecture::Param;

const BETA: [f32; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-8;

/// Adam optimiser with its state.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Running mean of the gradient.
    pub first: Vec<f32>,
    /// Running mean of the squared gradient.
    pub second: Vec<f32>,
    /// Number of steps taken.
    pub steps: u64,
}

impl Adam {
    /// A fresh state for `parameters` parameters.
    pub fn new(parameters: usize) -> Self {
        Self {
            first: vec![0.0; parameters],
            second: vec![0.0; parameters],
            steps: 0,
        }
    }

    /// Updates the parameters of the tensors `params`; weight decay (`rate·decay`) applies to
    /// weights only, not to biases and scales.
    pub fn step<'a>(
        &mut self,
        params: impl IntoIterator<Item = &'a Param>,
        parameters: &mut [f32],
        gradient: &[f32],
        rate: f32,
        decay: f32,
    ) {
        self.steps += 1;
        let steps = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let [first_fraction, second_fraction] = BETA.map(|beta| 1.0 - beta.powi(steps));
        for param in params {
            let shrink = if param.is_weight() { rate * decay } else { 0.0 };
            let range = param.range();
            let means = self.first[range.clone()]
                .iter_mut()
                .zip(&mut self.second[range.clone()]);
            let moved = parameters[range.clone()].iter_mut().zip(&gradient[range]);
            for ((first, second), (parameter, gradient)) in means.zip(moved) {
                *first += (1.0 - BETA[0]) * (gradient - *first);
                *second += (1.0 - BETA[1]) * (gradient * gradient - *second);
                let slope =
                    *first / first_fraction / ((*second / second_fraction).sqrt() + EPSILON);
                *parameter -= rate * slope + shrink * *parameter;
            }
        }
    }
}

/// Learning rate factor at a step: linear warm-up over `warm_up` steps, linear decay to zero at
/// step `total`.
pub fn linear_schedule(step: u64, warm_up: u64, total: u64) -> f32 {
    let rising = (step + 1) as f32 / warm_up.max(1) as f32;
    let falling = 1.0 - step as f32 / total.max(1) as f32;
    rising.min(falling).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::predict::contract::Modality;
    use crate::{Architecture, Layout};

    #[test]
    fn adam_converges_and_decays_weights_only() {
        let layout = Layout::new(&Architecture::gripcast(), Modality::T);
        let mut parameters = vec![1.0; layout.len()];
        let mut adam = Adam::new(layout.len());
        for _ in 0..400 {
            let gradient: Vec<f32> = parameters.iter().map(|p| 2.0 * (p - 0.25)).collect();
            adam.step(layout.params(), &mut parameters, &gradient, 0.01, 0.0);
        }
        assert!(parameters.iter().all(|p| (p - 0.25).abs() < 1e-3));
        let gradient = vec![0.0; layout.len()];
        let mut adam = Adam::new(layout.len());
        adam.step(layout.params(), &mut parameters, &gradient, 0.1, 0.5);
        for param in layout.params() {
            let expected = if param.is_weight() { 0.95 } else { 1.0 };
            let found = parameters[param.first] / 0.25;
            assert!((found - expected).abs() < 5e-3, "{}: {found}", param.name);
        }
    }

    #[test]
    fn schedule_warms_up_then_decays_to_zero() {
        assert_eq!(linear_schedule(0, 10, 100), 0.1);
        assert_eq!(linear_schedule(50, 10, 100), 0.5);
        assert_eq!(linear_schedule(100, 10, 100), 0.0);
        assert_eq!(linear_schedule(500, 10, 100), 0.0);
    }
}
