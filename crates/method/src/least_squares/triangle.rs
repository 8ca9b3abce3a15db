//! Householder QR of a block of rows below a triangle, which remains a triangle.
//!
//! A reflection that clears column `i` of the block changes row `i` of the triangle and the block, and leaves the
//! rest of the triangle unchanged. Its vector is `v = [v0; x]`, and `x` is the column of the block. Let
//! `b = -sign(a) |[a; x]|`, `v0 = a - b` and `h = 2 / |v|²`. Then `1 - h v vᵀ` maps `[a; x]` to `[b; 0]` (Golub &
//! Van Loan, Matrix Computations, 5.1).
//!
//! Four reflections make a panel before the later columns change, so that these are read and written a quarter as
//! often. Reflection `k` applies to a column `[a; y]` that the earlier ones have changed:
//! `f_k = h_k (v0_k a_k + x_k·y - Σ_{m<k} f_m x_m·x_k)`; then `a_k` becomes `a_k - f_k v0_k`, and `y` becomes
//! `y - Σ f_k x_k` at once.

use pulp::Simd;

use crate::lanes::{LANES, VectorKernel, in_vectors};

/// Number of reflections per panel.
const PANEL: usize = 4;

/// Number of columns that a panel processes at once: sums of two columns with four reflections take half of the sixteen
/// registers of a processor with 256 bits.
const COLUMNS: usize = 2;

/// Smallest sum of squares of a column of the block that is not zero. If there are few rows below a wide triangle, the
/// remainder shrinks by the rounding with each reflection, and squares near the smallest double have lost their digits.
/// A column of 1e-140 has no effect that a recording can show.
const NEGLIGIBLE_SQUARES: f64 = 1e-280;

/// Folds a block of rows into the upper triangle above them: `r` becomes the triangle of `[r; block]`.
pub(super) struct Fold<'a> {
    /// `width x width`, row by row; entries below the diagonal are neither read nor written.
    pub r: &'a mut [f64],
    /// `width` columns of `stride` numbers, the first `height` of each are rows; overwritten.
    pub block: &'a mut [f64],
    /// Number of columns.
    pub width: usize,
    /// Distance between columns, a multiple of [`LANES`].
    pub stride: usize,
    /// Number of rows in a column, a multiple of [`LANES`].
    pub height: usize,
}

impl Fold<'_> {
    pub(super) fn fold(self) {
        in_vectors(self);
    }
}

impl VectorKernel for Fold<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { r, block, width, stride, height } = self;
        let (block, _) = S::as_mut_simd_f64s(block);
        let (stride, height) = (stride / LANES, height / LANES);
        for i in (0..width).step_by(PANEL) {
            let count = PANEL.min(width - i);
            let (columns, behind) = block[i * stride..].split_at_mut(count * stride);
            let mut panel = ReflectionPanel::default();
            for k in 0..count {
                let (x, y) = columns.split_at_mut(k * stride);
                let above = &mut r[i * width + i + k..];
                let mut met = Met { x, stride, height, above, width };
                panel.products[k] = match k {
                    0 => panel.next_column::<S, 0>(simd, &mut met, y),
                    1 => panel.next_column::<S, 1>(simd, &mut met, y),
                    2 => panel.next_column::<S, 2>(simd, &mut met, y),
                    _ => panel.next_column::<S, 3>(simd, &mut met, y),
                };
                panel.reflections[k] = Reflection::of(&mut above[k * width], panel.products[k][k]);
            }
            let x = &*columns;
            let mut j = i + count;
            let mut groups = behind.chunks_exact_mut(COLUMNS * stride);
            for group in &mut groups {
                let above = &mut r[i * width + j..];
                panel.apply::<S, PANEL, COLUMNS>(simd, &mut Met { x, stride, height, above, width }, group);
                j += COLUMNS;
            }
            for column in groups.into_remainder().chunks_exact_mut(stride) {
                let above = &mut r[i * width + j..];
                panel.apply::<S, PANEL, 1>(simd, &mut Met { x, stride, height, above, width }, column);
                j += 1;
            }
        }
    }
}

/// Reflection `1 - h v vᵀ`; the rest of `v` is a column of the block.
#[derive(Clone, Copy, Default)]
struct Reflection {
    v0: f64,
    h: f64,
}

impl Reflection {
    /// Reflection that clears a column with this sum of squares below `a`, and updates `a`; no reflection for a zero
    /// column.
    #[inline(always)]
    fn of(a: &mut f64, squares: f64) -> Self {
        if squares < NEGLIGIBLE_SQUARES {
            return Self { v0: 0.0, h: 0.0 };
        }
        let b = -(*a * *a + squares).sqrt().copysign(*a);
        let v0 = *a - b;
        *a = b;
        Self { v0, h: 2.0 / (v0 * v0 + squares) }
    }
}

/// Data that reflections apply to: their columns `x` of the block, and the triangle.
struct Met<'a, V> {
    x: &'a [V],
    stride: usize,
    height: usize,
    /// Triangle from the row of the first reflection and the first changed column on.
    above: &'a mut [f64],
    width: usize,
}

/// Consecutive reflections, and the products `x_m·x_k` of their columns.
#[derive(Default)]
struct ReflectionPanel {
    reflections: [Reflection; PANEL],
    products: [[f64; PANEL]; PANEL],
}

impl ReflectionPanel {
    /// Applies the first `K` reflections to the next column. Returns its products with their columns, and its sum of
    /// squares.
    #[inline(always)]
    fn next_column<S: Simd, const K: usize>(
        &self,
        simd: S,
        met: &mut Met<'_, S::f64s>,
        y: &mut [S::f64s],
    ) -> [f64; PANEL] {
        if K > 0 {
            self.apply::<S, K, 1>(simd, met, y);
        }
        let y = &y[..met.height];
        let x: [&[S::f64s]; K] = std::array::from_fn(|k| &met.x[k * met.stride..][..met.height]);
        let (mut of_x, mut squares) = ([simd.splat_f64s(0.0); K], simd.splat_f64s(0.0));
        for row in 0..met.height {
            let y = y[row];
            for k in 0..K {
                of_x[k] = simd.add_f64s(of_x[k], simd.mul_f64s(x[k][row], y));
            }
            squares = simd.add_f64s(squares, simd.mul_f64s(y, y));
        }
        let mut products = [0.0; PANEL];
        for k in 0..K {
            products[k] = simd.reduce_sum_f64s(of_x[k]);
        }
        products[K] = simd.reduce_sum_f64s(squares);
        products
    }

    /// Applies the first `K` reflections to `N` columns.
    #[inline(always)]
    fn apply<S: Simd, const K: usize, const N: usize>(
        &self,
        simd: S,
        met: &mut Met<'_, S::f64s>,
        columns: &mut [S::f64s],
    ) {
        let Met { stride, height, width, .. } = *met;
        let x: [&[S::f64s]; K] = std::array::from_fn(|k| &met.x[k * stride..][..height]);
        let y: [&[S::f64s]; N] = std::array::from_fn(|n| &columns[n * stride..][..height]);
        let mut of_x = [[simd.splat_f64s(0.0); K]; N];
        for row in 0..height {
            for n in 0..N {
                let y = y[n][row];
                for k in 0..K {
                    of_x[n][k] = simd.add_f64s(of_x[n][k], simd.mul_f64s(x[k][row], y));
                }
            }
        }
        let mut factors = [[simd.splat_f64s(0.0); K]; N];
        for n in 0..N {
            let mut f = [0.0; K];
            for k in 0..K {
                let (Reflection { v0, h }, a) = (self.reflections[k], &mut met.above[k * width + n]);
                let mut along = v0 * *a + simd.reduce_sum_f64s(of_x[n][k]);
                for (f, product) in f.iter().zip(&self.products[k]).take(k) {
                    along -= f * product;
                }
                f[k] = h * along;
                *a -= f[k] * v0;
                factors[n][k] = simd.splat_f64s(f[k]);
            }
        }
        let mut columns = columns.chunks_exact_mut(stride);
        let y: [&mut [S::f64s]; N] =
            std::array::from_fn(|_| &mut columns.next().unwrap_or_default()[..height]);
        for row in 0..height {
            for n in 0..N {
                let mut left = y[n][row];
                for k in 0..K {
                    left = simd.sub_f64s(left, simd.mul_f64s(x[k][row], factors[n][k]));
                }
                y[n][row] = left;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use faer::Mat;
    use pulp::Scalar256b;

    use super::*;

    /// Rounding of reflections of some hundred rows, relative to the largest number.
    const ROUNDING: f64 = 1e-13;

    /// Length of a column below which it counts as zero; the effect of [`NEGLIGIBLE_SQUARES`] is far smaller.
    const NOTHING: f64 = 1e-120;

    fn number(k: usize) -> f64 {
        ((k * 7919 % 1009) as f64 / 504.0 - 1.0) * 10_f64.powi((k % 5) as i32 - 2)
    }

    /// Gram matrix of a triangle above a block, which reflections preserve.
    fn gram(r: &[f64], block: &[f64], width: usize, stride: usize, height: usize) -> Mat<f64> {
        let row = |i: usize, j: usize| if i <= j { r[i * width + j] } else { 0.0 };
        Mat::from_fn(width, width, |a, b| {
            let above: f64 = (0..width).map(|i| row(i, a) * row(i, b)).sum();
            let column = |k: usize| block[k * stride..][..height].iter();
            above + column(a).zip(column(b)).map(|(x, y)| x * y).sum::<f64>()
        })
    }

    fn folded(width: usize, stride: usize, height: usize, plainly: bool) -> Vec<f64> {
        let mut r: Vec<f64> = (0..width * width).map(|k| number(k + 17)).collect();
        let mut block: Vec<f64> = (0..width * stride).map(number).collect();
        let expected = gram(&r, &block, width, stride, height);
        let fold = Fold { r: &mut r, block: &mut block, width, stride, height };
        if plainly {
            fold.run(Scalar256b)
        } else {
            fold.fold()
        }
        let found = gram(&r, &[], width, 0, 0);
        for (a, b) in (0..width).flat_map(|a| (0..width).map(move |b| (a, b))) {
            let scale = (expected[(a, a)] * expected[(b, b)]).sqrt();
            assert!((found[(a, b)] - expected[(a, b)]).abs() < ROUNDING * scale, "{width} {height} {a} {b}");
        }
        r
    }

    /// Covers all remainders of columns and rows; entries below the triangle and beyond the rows are ignored.
    #[test]
    fn the_gram_matrix_stays() {
        for width in 1..=14 {
            for (stride, height) in [(4, 4), (8, 4), (20, 20), (32, 12), (128, 128)] {
                folded(width, stride, height, false);
            }
        }
        folded(40, 128, 128, false);
    }

    #[test]
    fn wide_registers_give_the_bits_of_narrow_ones() {
        for width in [1, 2, 7, 40] {
            assert_eq!(folded(width, 128, 128, false), folded(width, 128, 128, true));
        }
    }

    /// Four rows below a triangle of forty columns. After four reflections the block contains rounding, after eight the
    /// rounding of that, and so on until squares are below the smallest double.
    #[test]
    fn few_rows_beneath_a_wide_triangle_keep_the_gram_matrix() {
        let (width, height) = (40, LANES);
        let empty = vec![0.0; width * width];
        let slow: Vec<f64> = (0..width * width).map(|k| 1e-9 * number(k)).collect();
        // one row and repetitions of it: nothing remains after the first reflection
        let rows = number;
        let repeated = |k: usize| number(k / LANES);
        for above in [&empty, &slow] {
            for made in [&rows as &dyn Fn(usize) -> f64, &repeated] {
                for size in [1.0, 1e-100, 1e-150, 1e-160, 1e-200, 1e-310, f64::MIN_POSITIVE, 5e-324] {
                    let mut r = above.clone();
                    let mut block: Vec<f64> = (0..width * height).map(|k| made(k) * size).collect();
                    let expected = gram(&r, &block, width, height, height);
                    Fold { r: &mut r, block: &mut block, width, stride: height, height }.fold();
                    let found = gram(&r, &[], width, 0, 0);
                    for (a, b) in (0..width).flat_map(|a| (0..width).map(move |b| (a, b))) {
                        let length = |k: usize| expected[(k, k)].sqrt() + NOTHING;
                        let error = (found[(a, b)] - expected[(a, b)]).abs();
                        assert!(error <= ROUNDING * length(a) * length(b), "{size} {a} {b}: {error}");
                    }
                }
            }
        }
    }

    #[test]
    fn rows_of_zeros_change_nothing() {
        let mut r: Vec<f64> = (0..36).map(number).collect();
        let before = r.clone();
        let mut block = vec![0.0; 6 * 16];
        Fold { r: &mut r, block: &mut block, width: 6, stride: 16, height: 16 }.fold();
        assert_eq!(r, before);
    }
}
