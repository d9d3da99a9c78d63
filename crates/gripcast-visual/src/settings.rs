//! How an image is made.

use std::sync::atomic::{AtomicBool, Ordering};

use gripcast_base::error::{Error, Result};

/// How much of the light around a pixel's centre counts for it (reconstruction filter).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PixelFilter {
    /// The pixel's square alone.
    Box,
    /// Falls linearly to 0 at a distance of 1 px.
    Tent,
    /// Gaussian with σ = 0.5 px, cut at 2 px.
    #[default]
    Gaussian,
}

/// How an image is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Paths for each pixel; powers of two are spread best.
    pub samples_per_pixel: u32,
    /// Most reflections and refractions of a path.
    pub max_bounces: u32,
    /// From this bounce on, paths that carry little end at random (Russian roulette).
    pub rr_depth: u32,
    /// Largest value that one path may add to a channel; what lies above is lost. `None` keeps the
    /// image unbiased.
    pub clamp: Option<f32>,
    /// Reconstruction filter.
    pub filter: PixelFilter,
    /// Decides on every random choice.
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
                "the number of samples_per_pixel must be from 1 to {}, found {found}",
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

/// Ways to follow and to stop a rendering.
#[derive(Clone, Copy, Default)]
pub struct RenderControl<'a> {
    /// Called from any thread with the number of finished tiles and of all tiles.
    pub on_progress: Option<&'a (dyn Fn(usize, usize) + Sync)>,
    /// Once true, rendering ends soon with an error of kind `Interrupted`.
    pub cancel: Option<&'a AtomicBool>,
}

impl RenderControl<'_> {
    /// Whether the rendering is to end.
    pub(super) fn cancelled(&self) -> bool {
        self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }
}
