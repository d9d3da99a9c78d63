//! SIMD vectors, selected at run time.
//!
//! The order of additions does not depend on the vector width, so results are equal with 8 and 16
//! lanes. Without fused multiply-add they differ in the last bits.
//!
//! Not based on `pulp`: enabling its AVX-512 affects the whole program and would change the order
//! of sums in the simulator's solvers.

#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m256, __m512, _mm256_add_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_set1_ps,
    _mm256_storeu_ps, _mm512_add_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_max_ps,
    _mm512_set1_ps, _mm512_storeu_ps,
};

/// Arithmetic on vectors of floats. A value proves that the CPU has the instructions.
pub(super) trait Lanes: Copy {
    /// Vector type.
    type Vector: Copy;
    /// Floats per vector.
    const COUNT: usize;
    /// Rows of sums, two vectors each, that fit into registers beside the operands.
    const ROWS: usize;

    fn splat(self, x: f32) -> Self::Vector;
    /// Loads the first floats of a slice.
    fn load(self, from: &[f32]) -> Self::Vector;
    /// Stores into the first floats of a slice.
    fn store(self, x: Self::Vector, to: &mut [f32]);
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a·b + c`.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
}

/// A computation on vectors. Implementations are `#[inline(always)]`, so that they are compiled for
/// each instruction set.
pub(super) trait WithLanes {
    /// Result type.
    type Output;

    /// Runs the computation.
    fn with_lanes<S: Lanes>(self, lanes: S) -> Self::Output;
}

/// Instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Isa {
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    Portable,
}

/// Vector width in bits used for networks on this CPU; 0 for portable code.
pub fn vector_bits() -> u32 {
    Isa::best().bits()
}

impl Isa {
    /// Best instruction set of this CPU.
    #[inline]
    pub(super) fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            // The macro caches its result.
            if std::arch::is_x86_feature_detected!("avx512f") {
                return Self::Avx512(Avx512(()));
            }
            if std::arch::is_x86_feature_detected!("avx2")
                && std::arch::is_x86_feature_detected!("fma")
            {
                return Self::Avx2(Avx2(()));
            }
        }
        Self::Portable
    }

    /// Vector width in bits; 0 for portable code.
    fn bits(self) -> u32 {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(_) => 512,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(_) => 256,
            Self::Portable => 0,
        }
    }

    /// All instruction sets of this CPU, the best one first.
    #[cfg(test)]
    pub(super) fn available() -> Vec<Self> {
        let mut found = vec![Self::best()];
        #[cfg(target_arch = "x86_64")]
        if matches!(Self::best(), Self::Avx512(_)) && std::arch::is_x86_feature_detected!("fma") {
            found.push(Self::Avx2(Avx2(())));
        }
        if Self::best() != Self::Portable {
            found.push(Self::Portable);
        }
        found
    }

    /// Floats per vector.
    pub(super) fn lanes(self) -> usize {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(_) => Avx512::COUNT,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(_) => Avx2::COUNT,
            Self::Portable => Portable::COUNT,
        }
    }

    /// Runs the computation.
    #[inline]
    pub(super) fn run<W: WithLanes>(self, work: W) -> W::Output {
        match self {
            // SAFETY: a value of this type exists only if the CPU has the instructions.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(lanes) => unsafe { with_avx512(work, lanes) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(lanes) => unsafe { with_avx2(work, lanes) },
            Self::Portable => work.with_lanes(Portable),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn with_avx512<W: WithLanes>(work: W, lanes: Avx512) -> W::Output {
    work.with_lanes(lanes)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn with_avx2<W: WithLanes>(work: W, lanes: Avx2) -> W::Output {
    work.with_lanes(lanes)
}

macro_rules! x86 {
    ($doc:literal, $name:ident, $vector:ident, $count:literal, $rows:literal,
     $splat:ident, $load:ident, $store:ident, $add:ident, $max:ident, $mul_add:ident) => {
        #[doc = $doc]
        #[cfg(target_arch = "x86_64")]
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) struct $name(());

        #[cfg(target_arch = "x86_64")]
        impl Lanes for $name {
            type Vector = $vector;
            const COUNT: usize = $count;
            const ROWS: usize = $rows;

            #[inline(always)]
            fn splat(self, x: f32) -> $vector {
                // SAFETY: `self` proves that the CPU has the instruction.
                unsafe { $splat(x) }
            }

            #[inline(always)]
            fn load(self, from: &[f32]) -> $vector {
                let from = &from[..$count];
                // SAFETY: `self` proves that the CPU has the instruction;
                // the slice is as long as the vector.
                unsafe { $load(from.as_ptr()) }
            }

            #[inline(always)]
            fn store(self, x: $vector, to: &mut [f32]) {
                let to = &mut to[..$count];
                // SAFETY: `self` proves that the CPU has the instruction;
                // the slice is as long as the vector.
                unsafe { $store(to.as_mut_ptr(), x) }
            }

            #[inline(always)]
            fn add(self, a: $vector, b: $vector) -> $vector {
                // SAFETY: `self` proves that the CPU has the instruction.
                unsafe { $add(a, b) }
            }

            #[inline(always)]
            fn max(self, a: $vector, b: $vector) -> $vector {
                // SAFETY: `self` proves that the CPU has the instruction.
                unsafe { $max(a, b) }
            }

            #[inline(always)]
            fn mul_add(self, a: $vector, b: $vector, c: $vector) -> $vector {
                // SAFETY: `self` proves that the CPU has the instruction.
                unsafe { $mul_add(a, b, c) }
            }
        }
    };
}

x86!(
    "16 lanes in 32 registers.",
    Avx512,
    __m512,
    16,
    10,
    _mm512_set1_ps,
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_add_ps,
    _mm512_max_ps,
    _mm512_fmadd_ps
);
x86!(
    "8 lanes in 16 registers.",
    Avx2,
    __m256,
    8,
    5,
    _mm256_set1_ps,
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_add_ps,
    _mm256_max_ps,
    _mm256_fmadd_ps
);

/// 8 lanes in portable code.
#[derive(Clone, Copy, Debug)]
pub(super) struct Portable;

impl Lanes for Portable {
    type Vector = [f32; 8];
    const COUNT: usize = 8;
    const ROWS: usize = 5;

    #[inline(always)]
    fn splat(self, x: f32) -> [f32; 8] {
        [x; 8]
    }

    #[inline(always)]
    fn load(self, from: &[f32]) -> [f32; 8] {
        std::array::from_fn(|l| from[l])
    }

    #[inline(always)]
    fn store(self, x: [f32; 8], to: &mut [f32]) {
        to[..8].copy_from_slice(&x);
    }

    #[inline(always)]
    fn add(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|l| a[l] + b[l])
    }

    #[inline(always)]
    fn max(self, a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|l| a[l].max(b[l]))
    }

    #[inline(always)]
    fn mul_add(self, a: [f32; 8], b: [f32; 8], c: [f32; 8]) -> [f32; 8] {
        if cfg!(target_arch = "aarch64") {
            std::array::from_fn(|l| a[l].mul_add(b[l], c[l]))
        } else {
            // Without the instruction, `mul_add` is a hundred times slower.
            std::array::from_fn(|l| a[l] * b[l] + c[l])
        }
    }
}
