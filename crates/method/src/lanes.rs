//! Several numbers at once, one per lane, in plain arrays that the compiler puts into vector registers.
//!
//! Kernels are functions that are inlined into [`wide`]. It compiles them once for any processor and once for those
//! with 256-bit registers (AVX2), and chooses at run time. No operation is fused or reordered, so both give the same
//! bits.

use std::ops::{Add, AddAssign, Mul, Neg, Sub, SubAssign};
use std::sync::atomic::{AtomicBool, Ordering};

use pulp::{Arch, Scalar256b, Simd, WithSimd};

/// Numbers in a [`Lanes`].
pub const LANES: usize = 4;

/// One number for each of several instants or rows. Operations are written out, because in a kernel that is too large
/// for further inlining each closure or iterator would become a call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lanes(pub [f64; LANES]);

impl Lanes {
    /// Zero in all lanes.
    pub const ZERO: Self = Self([0.0; LANES]);

    /// Same number in all lanes.
    #[inline(always)]
    #[must_use]
    pub fn splat(value: f64) -> Self {
        Self([value; LANES])
    }

    /// Sum of the lanes.
    #[inline(always)]
    #[must_use]
    pub fn sum(self) -> f64 {
        let Self([a, b, c, d]) = self;
        (a + c) + (b + d)
    }
}

impl Add for Lanes {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let (Self([a, b, c, d]), Self([e, f, g, h])) = (self, other);
        Self([a + e, b + f, c + g, d + h])
    }
}

impl Sub for Lanes {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let (Self([a, b, c, d]), Self([e, f, g, h])) = (self, other);
        Self([a - e, b - f, c - g, d - h])
    }
}

impl Mul for Lanes {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let (Self([a, b, c, d]), Self([e, f, g, h])) = (self, other);
        Self([a * e, b * f, c * g, d * h])
    }
}

impl Mul<f64> for Lanes {
    type Output = Self;

    #[inline(always)]
    fn mul(self, by: f64) -> Self {
        self * Self::splat(by)
    }
}

impl Neg for Lanes {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let Self([a, b, c, d]) = self;
        Self([-a, -b, -c, -d])
    }
}

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Lanes {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

/// Spatial vector at each of several instants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LaneVector {
    /// Along x.
    pub x: Lanes,
    /// Along y.
    pub y: Lanes,
    /// Along z.
    pub z: Lanes,
}

impl LaneVector {
    /// Zero at each instant.
    pub const ZERO: Self = Self { x: Lanes::ZERO, y: Lanes::ZERO, z: Lanes::ZERO };

    /// Same vector at each instant.
    #[inline(always)]
    #[must_use]
    pub fn splat(x: f64, y: f64, z: f64) -> Self {
        Self { x: Lanes::splat(x), y: Lanes::splat(y), z: Lanes::splat(z) }
    }

    /// Scalar product.
    #[inline(always)]
    #[must_use]
    pub fn dot(&self, other: &Self) -> Lanes {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Vector product.
    #[inline(always)]
    #[must_use]
    pub fn cross(&self, other: &Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }
}

impl Add for LaneVector {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl Sub for LaneVector {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl Mul<Lanes> for LaneVector {
    type Output = Self;

    #[inline(always)]
    fn mul(self, by: Lanes) -> Self {
        Self { x: self.x * by, y: self.y * by, z: self.z * by }
    }
}

/// Numbers that sums and comparisons of long series process in parallel, so that none waits for the previous one.
const ABREAST: usize = 16;

/// Sum of products of two series of equal length.
#[must_use]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    struct Dot<'a>(&'a [f64], &'a [f64], &'a mut f64);

    impl Kernel for Dot<'_> {
        #[inline(always)]
        fn run(self) {
            let (a, b) = (self.0.as_chunks::<ABREAST>(), self.1.as_chunks::<ABREAST>());
            let mut sums = [0.0; ABREAST];
            for (a, b) in a.0.iter().zip(b.0) {
                for k in 0..ABREAST {
                    sums[k] += a[k] * b[k];
                }
            }
            for k in 0..a.1.len().min(b.1.len()) {
                *self.2 += a.1[k] * b.1[k];
            }
            for sum in sums {
                *self.2 += sum;
            }
        }
    }

    let mut sum = 0.0;
    wide(Dot(a, b, &mut sum));
    sum
}

/// Smallest and largest value of a series; `[inf, -inf]` for an empty one. NaN does not count.
#[must_use]
pub(crate) fn extent(series: &[f64]) -> [f64; 2] {
    let mut found = [f64::INFINITY, f64::NEG_INFINITY];
    wide(Extent { series, found: &mut found });
    found
}

struct Extent<'a> {
    series: &'a [f64],
    found: &'a mut [f64; 2],
}

impl Kernel for Extent<'_> {
    #[inline(always)]
    fn run(self) {
        let (whole, rest) = self.series.as_chunks::<ABREAST>();
        let (mut low, mut high) = ([f64::INFINITY; ABREAST], [f64::NEG_INFINITY; ABREAST]);
        for of in whole {
            for k in 0..ABREAST {
                low[k] = lower(low[k], of[k]);
                high[k] = higher(high[k], of[k]);
            }
        }
        let [least, most] = self.found;
        for k in 0..ABREAST {
            *least = lower(*least, low[k]);
            *most = higher(*most, high[k]);
        }
        for x in rest {
            *least = lower(*least, *x);
            *most = higher(*most, *x);
        }
    }
}

/// Smaller of two numbers by a comparison, since `f64::min` has no vector instruction. NaN does not count.
#[inline(always)]
fn lower(low: f64, x: f64) -> f64 {
    if x < low { x } else { low }
}

#[inline(always)]
fn higher(high: f64, x: f64) -> f64 {
    if x > high { x } else { high }
}

/// Largest absolute difference of two neighbours in a series; zero for fewer than two. NaN does not count.
#[must_use]
pub(crate) fn largest_step(series: &[f64]) -> f64 {
    struct LargestStep<'a>(&'a [f64], &'a mut f64);

    impl Kernel for LargestStep<'_> {
        #[inline(always)]
        fn run(self) {
            let Some((_, behind)) = self.0.split_first() else { return };
            let before = &self.0[..behind.len()];
            let (before, behind) = (before.as_chunks::<ABREAST>(), behind.as_chunks::<ABREAST>());
            let mut steps = [0.0; ABREAST];
            for (a, b) in before.0.iter().zip(behind.0) {
                for k in 0..ABREAST {
                    steps[k] = higher(steps[k], (b[k] - a[k]).abs());
                }
            }
            for step in steps {
                *self.1 = higher(*self.1, step);
            }
            for k in 0..before.1.len().min(behind.1.len()) {
                *self.1 = higher(*self.1, (behind.1[k] - before.1[k]).abs());
            }
        }
    }

    let mut largest = 0.0;
    wide(LargestStep(series, &mut largest));
    largest
}

/// Number of values of a series in each of two closed ranges; NaN is in none.
#[must_use]
pub(crate) fn counts_within(series: &[f64], ranges: [[f64; 2]; 2]) -> [usize; 2] {
    struct Counts<'a>(&'a [f64], [[f64; 2]; 2], &'a mut [usize; 2]);

    impl Kernel for Counts<'_> {
        #[inline(always)]
        fn run(self) {
            let [[a, b], [c, d]] = self.1;
            let (mut first, mut second) = (0_u64, 0_u64);
            for x in self.0 {
                first += u64::from((*x >= a) & (*x <= b));
                second += u64::from((*x >= c) & (*x <= d));
            }
            *self.2 = [first as usize, second as usize];
        }
    }

    let mut counts = [0; 2];
    wide(Counts(series, ranges, &mut counts));
    counts
}

/// True if kernels run as on a processor without wide registers.
static FOR_ANY_PROCESSOR: AtomicBool = AtomicBool::new(false);

/// Makes kernels of this process run as on a processor without wide registers, with the same results: for benchmarks
/// and tests. Other crates still choose for themselves.
pub fn run_as_on_any_processor(is_so: bool) {
    FOR_ANY_PROCESSOR.store(is_so, Ordering::Relaxed);
}

fn processor() -> Arch {
    if FOR_ANY_PROCESSOR.load(Ordering::Relaxed) { Arch::Scalar } else { Arch::new() }
}

/// Work that [`wide`] compiles for wide registers: `run` and all functions it calls must be `#[inline(always)]`.
pub trait Kernel {
    /// Does the work.
    fn run(self);
}

/// Runs a kernel with the widest registers that the processor has.
#[inline]
pub fn wide(kernel: impl Kernel) {
    struct Dispatched<K>(K);

    impl<K: Kernel> WithSimd for Dispatched<K> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) {
            self.0.run();
        }
    }

    processor().dispatch(Dispatched(kernel));
}

/// Work on vectors of [`LANES`] numbers, `S::f64s`. If a kernel ends in sums over lanes, the compiler would disassemble
/// and reassemble arrays in each step; it does not do so with vectors.
pub(crate) trait VectorKernel {
    /// Does the work. It and all functions it calls must be `#[inline(always)]`.
    fn run<S: Simd>(self, simd: S);
}

/// Runs a kernel with vector registers of [`LANES`] numbers if the processor has them, otherwise on arrays of the same
/// length. The results have the same bits.
#[inline]
pub(crate) fn in_vectors(kernel: impl VectorKernel) {
    struct Dispatched<K>(K);

    impl<K: VectorKernel> WithSimd for Dispatched<K> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            if S::F64_LANES == LANES { self.0.run(simd) } else { self.0.run(Scalar256b) }
        }
    }

    processor().dispatch(Dispatched(kernel));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_in_lanes_are_vectors_of_each_instant() {
        let number = |k: usize| std::array::from_fn(|lane| (0.37 * (k * LANES + lane + 1) as f64).sin());
        let vector =
            |k: usize| LaneVector { x: Lanes(number(k)), y: Lanes(number(k + 1)), z: Lanes(number(k + 2)) };
        let (a, b) = (vector(0), vector(5));
        let (cross, dot) = (a.cross(&b), a.dot(&b));
        let (sum, less, scaled) = (a + b, a - b, a * b.x);
        for lane in 0..LANES {
            let at = |of: &LaneVector| nalgebra::Vector3::new(of.x.0[lane], of.y.0[lane], of.z.0[lane]);
            let (u, v) = (at(&a), at(&b));
            assert!((at(&cross) - u.cross(&v)).norm() < 1e-15);
            assert!((dot.0[lane] - u.dot(&v)).abs() < 1e-15);
            assert_eq!((at(&sum), at(&less)), (u + v, u - v));
            assert_eq!(at(&scaled), u * b.x.0[lane]);
        }
    }

    #[test]
    fn series_of_any_length_have_their_sum_and_ends() {
        for length in [0, 1, 15, 16, 17, 100] {
            let a: Vec<f64> = (0..length).map(|k| f64::from(k * 7919 % 101) - 50.0).collect();
            let b: Vec<f64> = (0..length).map(|k| f64::from(k * 31 % 17)).collect();
            // whole numbers: the order of a sum does not matter
            assert_eq!(dot(&a, &b), a.iter().zip(&b).map(|(a, b)| a * b).sum::<f64>());
            let expected =
                a.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], x| [l.min(*x), h.max(*x)]);
            assert_eq!(extent(&a), expected);
            let with_nan: Vec<f64> = a.iter().flat_map(|x| [f64::NAN, *x]).collect();
            assert_eq!(extent(&with_nan), expected);
            let step = a.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
            assert_eq!(largest_step(&a), step);
            let count = |low: f64, high: f64| a.iter().filter(|x| (low..=high).contains(*x)).count();
            assert_eq!(counts_within(&a, [[-10.0, 0.0], [0.0, 49.0]]), [count(-10.0, 0.0), count(0.0, 49.0)]);
        }
    }

    #[test]
    fn a_kernel_runs_once_whatever_the_processor() {
        struct Sum<'a>(&'a [Lanes], &'a mut f64);
        impl Kernel for Sum<'_> {
            #[inline(always)]
            fn run(self) {
                *self.1 += self.0.iter().fold(Lanes::ZERO, |sum, of| sum + *of).sum();
            }
        }
        let numbers = [Lanes([1.0, 2.0, 3.0, 4.0]), Lanes([10.0, 20.0, 30.0, 40.0])];
        let (mut by_lanes, mut plainly) = (0.0, 0.0);
        wide(Sum(&numbers, &mut by_lanes));
        Sum(&numbers, &mut plainly).run();
        assert_eq!((by_lanes, plainly), (110.0, 110.0));
    }
}
