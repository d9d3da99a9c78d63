//! Render settings.

use std::sync::atomic::{AtomicBool, Ordering};

use gripcast_base::error::{Error, Result};

/// Pixel reconstruction filter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelFilter {
    /// Box of one pixel.
    Box,
    /// Gaussian with σ = 0.5 px, truncated at 2 px.
    #[default]
    Gaussian,
}

/// Settings of a rendering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Samples per pixel; powers of two are best distributed.
    pub samples_per_pixel: u32,
    /// Maximum number of reflections and refractions of a path.
    pub max_bounces: u32,
    /// Bounce at which Russian roulette starts.
    pub rr_depth: u32,
    /// Maximum contribution of one path to a channel; brighter paths are clamped, which biases the
    /// image. `None` keeps it unbiased.
    pub clamp: Option<f32>,
    /// Reconstruction filter.
    pub filter: PixelFilter,
    /// Random seed.
    pub seed: u64,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            samples_per_pixel: 64,
            max_bounces: 6,
            rr_depth: 3,
            clamp: None,
            filter: PixelFilter::default(),
            seed: 0,
        }
    }
}

impl RenderSettings {
    pub(super) fn validate(&self) -> Result<()> {
        let bad = |what: String| Err(Error::usage(what));
        if !(1..=1 << 20).contains(&self.samples_per_pixel) {
            let found = self.samples_per_pixel;
            return bad(format!(
                "samples per pixel must be from 1 to {}, found {found}",
                1 << 20
            ));
        }
        if self.clamp.is_some_and(|c| c.is_nan() || c <= 0.0) {
            let found = self.clamp;
            return bad(format!("the clamp must be positive, found {found:?}"));
        }
        Ok(())
    }
}

/// Progress callback and cancellation of a rendering.
#[derive(Clone, Copy, Default)]
pub struct RenderControl<'a> {
    /// Called from any thread with the numbers of finished tiles and of all tiles.
    pub on_progress: Option<&'a (dyn Fn(usize, usize) + Sync)>,
    /// Once true, rendering stops soon with an error of kind `Interrupted`.
    pub cancel: Option<&'a AtomicBool>,
}

impl RenderControl<'_> {
    pub(super) fn is_cancelled(&self) -> bool {
        self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }
}
