//! Vectors of eight numbers. Every operation follows IEEE 754 or two's complement exactly, so that
//! results do not depend on the instruction set. Fused multiply-adds are always fused, in software
//! if necessary.

use std::ops::{BitAnd, BitOr, Not};

use bytemuck::cast;
pub(crate) use wide::{f32x4, f32x8 as F, i16x16, i32x4, i32x8 as I};

pub(crate) const LANES: usize = 8;

/// Truth value per lane: all bits set or none.
#[derive(Clone, Copy)]
pub(crate) struct Mask(I);

impl Mask {
    #[inline(always)]
    pub(crate) fn select(self, yes: F, no: F) -> F {
        let mask: F = cast(self.0);
        mask.bitselect(yes, no)
    }

    #[inline(always)]
    pub(crate) fn select_ints(self, yes: I, no: I) -> I {
        self.0.bitselect(yes, no)
    }

    /// Packs the lanes into bits: bit `n` is lane `n`.
    #[inline(always)]
    pub(crate) fn bits(self) -> u32 {
        self.0.to_bitmask()
    }

    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        self.0.any()
    }

    #[inline(always)]
    pub(crate) fn all(self) -> bool {
        self.0.all()
    }

    /// Returns -1 in true lanes and 0 in false lanes.
    #[inline(always)]
    pub(crate) fn ints(self) -> I {
        self.0
    }

    #[inline(always)]
    pub(crate) fn from_bits(bits: u32) -> Self {
        Self(I::new(std::array::from_fn(|lane| -i32::from(bits & (1 << lane) != 0))))
    }
}

impl BitAnd for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOr for Mask {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Not for Mask {
    type Output = Self;

    #[inline(always)]
    fn not(self) -> Self {
        Self(!self.0)
    }
}

pub(crate) trait Floats: Sized {
    fn load(from: &[f32]) -> Self;
    fn store(self, to: &mut [f32]);
    /// Returns `self * by + plus`, rounded once.
    fn fused(self, by: Self, plus: Self) -> Self;
    fn lt(self, other: Self) -> Mask;
    fn le(self, other: Self) -> Mask;
    fn gt(self, other: Self) -> Mask;
    fn ge(self, other: Self) -> Mask;
    fn equals(self, other: Self) -> Mask;
    /// Rounds to the nearest integer, ties to even.
    fn round_to_int(self) -> I;
    fn truncate_to_int(self) -> I;
    fn to_signed_bits(self) -> I;
    fn from_signed_bits(bits: I) -> Self;
}

impl Floats for F {
    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        Self::new(from.try_into().expect("eight numbers"))
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to.copy_from_slice(self.as_array());
    }

    #[inline(always)]
    fn fused(self, by: Self, plus: Self) -> Self {
        if cfg!(any(
            all(target_arch = "x86_64", target_feature = "avx", target_feature = "fma"),
            target_arch = "aarch64"
        )) {
            return self.mul_add(by, plus);
        }
        let (a, b, c) = (self.as_array(), by.as_array(), plus.as_array());
        Self::new(std::array::from_fn(|lane| a[lane].mul_add(b[lane], c[lane])))
    }

    #[inline(always)]
    fn lt(self, other: Self) -> Mask {
        Mask(cast(self.simd_lt(other)))
    }

    #[inline(always)]
    fn le(self, other: Self) -> Mask {
        Mask(cast(self.simd_le(other)))
    }

    #[inline(always)]
    fn gt(self, other: Self) -> Mask {
        Mask(cast(self.simd_gt(other)))
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Mask {
        Mask(cast(self.simd_ge(other)))
    }

    #[inline(always)]
    fn equals(self, other: Self) -> Mask {
        Mask(cast(self.simd_eq(other)))
    }

    #[inline(always)]
    fn round_to_int(self) -> I {
        self.round_int()
    }

    #[inline(always)]
    fn truncate_to_int(self) -> I {
        self.trunc_int()
    }

    #[inline(always)]
    fn to_signed_bits(self) -> I {
        cast(self)
    }

    #[inline(always)]
    fn from_signed_bits(bits: I) -> Self {
        cast(bits)
    }
}

pub(crate) trait Ints: Sized {
    fn store(self, to: &mut [i32]);
    fn load_unsigned(from: &[u32]) -> Self;
    fn store_unsigned(self, to: &mut [u32]);
    fn lt(self, other: Self) -> Mask;
    fn le(self, other: Self) -> Mask;
    fn gt(self, other: Self) -> Mask;
    fn ge(self, other: Self) -> Mask;
    fn equals(self, other: Self) -> Mask;
    fn float(self) -> F;
}

impl Ints for I {
    #[inline(always)]
    fn store(self, to: &mut [i32]) {
        to.copy_from_slice(self.as_array());
    }

    #[inline(always)]
    fn load_unsigned(from: &[u32]) -> Self {
        let eight: [u32; LANES] = from.try_into().expect("eight numbers");
        cast(eight)
    }

    #[inline(always)]
    fn store_unsigned(self, to: &mut [u32]) {
        let eight: [u32; LANES] = cast(self);
        to.copy_from_slice(&eight);
    }

    #[inline(always)]
    fn lt(self, other: Self) -> Mask {
        Mask(self.simd_lt(other))
    }

    #[inline(always)]
    fn le(self, other: Self) -> Mask {
        !self.gt(other)
    }

    #[inline(always)]
    fn gt(self, other: Self) -> Mask {
        Mask(self.simd_gt(other))
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Mask {
        !self.lt(other)
    }

    #[inline(always)]
    fn equals(self, other: Self) -> Mask {
        Mask(self.simd_eq(other))
    }

    #[inline(always)]
    fn float(self) -> F {
        self.round_float()
    }
}
