//! Eight-lane f32 SIMD: AVX2 if available, plain arrays otherwise. Both give the same bits, since
//! no multiply-add is fused.

/// Number of boxes or triangles tested together.
pub(in super::super) const WIDTH: usize = 8;

/// Operations on eight floats; the provided methods are the portable implementation.
pub(in super::super) trait Lanes: Copy + Send + Sync {
    /// Eight floats.
    type F: Copy;

    fn load(self, values: &[f32; WIDTH]) -> Self::F;
    fn store(self, values: Self::F) -> [f32; WIDTH];
    #[inline(always)]
    fn splat(self, value: f32) -> Self::F {
        self.load(&[value; WIDTH])
    }

    #[inline(always)]
    fn add(self, a: Self::F, b: Self::F) -> Self::F {
        self.load(&zip(self.store(a), self.store(b), |a, b| a + b))
    }

    #[inline(always)]
    fn sub(self, a: Self::F, b: Self::F) -> Self::F {
        self.load(&zip(self.store(a), self.store(b), |a, b| a - b))
    }

    #[inline(always)]
    fn mul(self, a: Self::F, b: Self::F) -> Self::F {
        self.load(&zip(self.store(a), self.store(b), |a, b| a * b))
    }

    #[inline(always)]
    fn div(self, a: Self::F, b: Self::F) -> Self::F {
        self.load(&zip(self.store(a), self.store(b), |a, b| a / b))
    }

    /// Lane-wise minimum; `b` if one is NaN.
    #[inline(always)]
    fn min(self, a: Self::F, b: Self::F) -> Self::F {
        self.load(&zip(self.store(a), self.store(b), |a, b| {
            if a < b { a } else { b }
        }))
    }

    /// Lane-wise maximum; `b` if one is NaN.
    #[inline(always)]
    fn max(self, a: Self::F, b: Self::F) -> Self::F {
        self.load(&zip(self.store(a), self.store(b), |a, b| {
            if a > b { a } else { b }
        }))
    }

    /// Bit i: a ≤ b in lane i.
    #[inline(always)]
    fn le(self, a: Self::F, b: Self::F) -> u32 {
        bits(self.store(a), self.store(b), |a, b| a <= b)
    }

    /// Bit i: a < b in lane i.
    #[inline(always)]
    fn lt(self, a: Self::F, b: Self::F) -> u32 {
        bits(self.store(a), self.store(b), |a, b| a < b)
    }

    /// Bit i: a = b in lane i.
    #[inline(always)]
    fn eq(self, a: Self::F, b: Self::F) -> u32 {
        bits(self.store(a), self.store(b), |a, b| a == b)
    }
}

/// Portable implementation.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Portable;

#[inline(always)]
fn zip(a: [f32; WIDTH], b: [f32; WIDTH], op: impl Fn(f32, f32) -> f32) -> [f32; WIDTH] {
    std::array::from_fn(|l| op(a[l], b[l]))
}

#[inline(always)]
fn bits(a: [f32; WIDTH], b: [f32; WIDTH], op: impl Fn(f32, f32) -> bool) -> u32 {
    (0..WIDTH).fold(0, |mask, l| mask | (u32::from(op(a[l], b[l])) << l))
}

impl Lanes for Portable {
    type F = [f32; WIDTH];

    #[inline(always)]
    fn load(self, values: &[f32; WIDTH]) -> Self::F {
        *values
    }

    #[inline(always)]
    fn store(self, values: Self::F) -> [f32; WIDTH] {
        values
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use pulp::bytemuck::cast;
    use pulp::x86::V3;
    use pulp::{Simd, f32x8};

    use super::{Lanes, WIDTH, WithLanes};

    /// Adapter from [`WithLanes`] to `pulp`.
    pub(super) struct Wide<W> {
        pub(super) work: W,
        pub(super) simd: V3,
    }

    impl<W: WithLanes> pulp::WithSimd for Wide<W> {
        type Output = W::Output;

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> W::Output {
            self.work.with_lanes(self.simd)
        }
    }

    #[inline(always)]
    fn mask(simd: V3, lanes: pulp::m32x8) -> u32 {
        simd.avx._mm256_movemask_ps(cast(lanes)) as u32
    }

    impl Lanes for V3 {
        type F = f32x8;

        #[inline(always)]
        fn load(self, values: &[f32; WIDTH]) -> f32x8 {
            cast(*values)
        }

        #[inline(always)]
        fn store(self, values: f32x8) -> [f32; WIDTH] {
            cast(values)
        }

        #[inline(always)]
        fn splat(self, value: f32) -> f32x8 {
            self.splat_f32x8(value)
        }

        #[inline(always)]
        fn add(self, a: f32x8, b: f32x8) -> f32x8 {
            self.add_f32s(a, b)
        }

        #[inline(always)]
        fn sub(self, a: f32x8, b: f32x8) -> f32x8 {
            self.sub_f32s(a, b)
        }

        #[inline(always)]
        fn mul(self, a: f32x8, b: f32x8) -> f32x8 {
            self.mul_f32s(a, b)
        }

        #[inline(always)]
        fn div(self, a: f32x8, b: f32x8) -> f32x8 {
            self.div_f32s(a, b)
        }

        #[inline(always)]
        fn min(self, a: f32x8, b: f32x8) -> f32x8 {
            cast(self.avx._mm256_min_ps(cast(a), cast(b)))
        }

        #[inline(always)]
        fn max(self, a: f32x8, b: f32x8) -> f32x8 {
            cast(self.avx._mm256_max_ps(cast(a), cast(b)))
        }

        #[inline(always)]
        fn le(self, a: f32x8, b: f32x8) -> u32 {
            mask(self, self.cmp_le_f32x8(a, b))
        }

        #[inline(always)]
        fn lt(self, a: f32x8, b: f32x8) -> u32 {
            mask(self, self.cmp_lt_f32x8(a, b))
        }

        #[inline(always)]
        fn eq(self, a: f32x8, b: f32x8) -> u32 {
            mask(self, self.cmp_eq_f32x8(a, b))
        }
    }
}

/// Work compiled for the widest available lanes.
pub(in super::super) trait WithLanes {
    type Output;

    /// Must be `#[inline(always)]`, like everything it calls that should be vectorised.
    fn with_lanes<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Runs the work with the widest available lanes.
#[inline]
pub(in super::super) fn dispatch<W: WithLanes>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    if let pulp::Arch::V3(simd) = pulp::Arch::new() {
        return pulp::Simd::vectorize(simd, avx2::Wide { work, simd });
    }
    work.with_lanes(Portable)
}
