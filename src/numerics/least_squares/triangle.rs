//! Householder QR of a block of rows beneath a triangle, which stays a triangle.
//!
//! A reflection that clears column `i` of the block touches row `i` of the triangle and the block, and no other row
//! of the triangle. Of its vector `v = [v0; x]`, `x` is the column of the block itself. Two reflections are made
//! before the columns behind them change, so that these are read and written half as often.
//!
//! With `b = -sign(a) |[a; x]|`, `v0 = a - b` and `h = 2 / |v|²`, `1 - h v vᵀ` takes `[a; x]` to `[b; 0]` (Golub & Van
//! Loan, Matrix Computations, 5.1).

use crate::numerics::lanes::{Kernel, Lanes, wide};

/// Columns that two reflections are applied to at once.
const COLUMNS: usize = 4;

/// A column of the block whose squares add up to less is zero: what is left of few rows beneath a wide triangle
/// becomes smaller by the rounding with each reflection, and squares near the smallest double have lost their digits.
/// A column so short, 1e-140, changes nothing that a recording can show.
const NEGLIGIBLE_SQUARES: f64 = 1e-280;

/// Folds a block of rows into the upper triangle above them: `r` becomes the triangle of `[r; block]`.
pub(super) struct Fold<'a> {
    /// `width x width`, row after row; below the diagonal nothing is read or written.
    pub r: &'a mut [f64],
    /// `width` columns of `stride` numbers, of which the first `height` are rows; holds nothing of use afterwards.
    pub block: &'a mut [Lanes],
    /// Columns.
    pub width: usize,
    /// Lanes from one column to the next.
    pub stride: usize,
    /// Lanes of a column that hold rows.
    pub height: usize,
}

impl Fold<'_> {
    pub(super) fn fold(self) {
        wide(self);
    }
}

impl Kernel for Fold<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { r, block, width, stride, height } = self;
        let mut i = 0;
        while i < width {
            let (left, right) = block.split_at_mut((i + 1) * stride);
            let x = &left[i * stride..][..height];
            let (above, below) = r.split_at_mut((i + 1) * width);
            let row = &mut above[i * width..];
            let first = Reflection::of(&mut row[i], x);
            if i + 1 == width {
                break;
            }
            let (z, behind) = right.split_at_mut(stride);
            let z = &mut z[..height];
            let next_row = &mut below[..width];
            first.apply(x, &mut row[i + 1], z);
            let second = Reflection::of(&mut next_row[i + 1], z);
            let z = &*z;
            let x_z = dot(x, z);
            let mut j = i + 2;
            let mut groups = behind.chunks_exact_mut(COLUMNS * stride);
            for columns in &mut groups {
                let (of_x, of_z) = dots(x, z, columns, stride);
                let (mut f, mut g) = ([0.0; COLUMNS], [0.0; COLUMNS]);
                for k in 0..COLUMNS {
                    f[k] = first.h * (first.v0 * row[j + k] + of_x[k]);
                    row[j + k] -= f[k] * first.v0;
                    // the first reflection has changed what the second one meets
                    g[k] = second.h * (second.v0 * next_row[j + k] + of_z[k] - f[k] * x_z);
                    next_row[j + k] -= g[k] * second.v0;
                }
                subtract(&f, &g, x, z, columns, stride);
                j += COLUMNS;
            }
            for column in groups.into_remainder().chunks_exact_mut(stride) {
                first.apply(x, &mut row[j], &mut column[..height]);
                second.apply(z, &mut next_row[j], &mut column[..height]);
                j += 1;
            }
            i += 2;
        }
    }
}

/// A reflection `1 - h v vᵀ`; the rest of `v` is a column of the block.
#[derive(Clone, Copy)]
struct Reflection {
    v0: f64,
    h: f64,
}

impl Reflection {
    /// The reflection that clears `x` beneath `a`, which becomes what is left of the column; none where `x` is zero.
    #[inline(always)]
    fn of(a: &mut f64, x: &[Lanes]) -> Self {
        let squares = dot(x, x);
        if squares < NEGLIGIBLE_SQUARES {
            return Self { v0: 0.0, h: 0.0 };
        }
        let b = -(*a * *a + squares).sqrt().copysign(*a);
        let v0 = *a - b;
        *a = b;
        Self { v0, h: 2.0 / (v0 * v0 + squares) }
    }

    #[inline(always)]
    fn apply(self, x: &[Lanes], above: &mut f64, column: &mut [Lanes]) {
        let f = self.h * (self.v0 * *above + dot(x, column));
        *above -= f * self.v0;
        for (y, x) in column.iter_mut().zip(x) {
            *y -= *x * f;
        }
    }
}

#[inline(always)]
fn dot(x: &[Lanes], y: &[Lanes]) -> f64 {
    let (pairs_x, last_x) = x.as_chunks::<2>();
    let (pairs_y, last_y) = y.as_chunks::<2>();
    let (mut even, mut odd) = (Lanes::ZERO, Lanes::ZERO);
    for (x, y) in pairs_x.iter().zip(pairs_y) {
        even += x[0] * y[0];
        odd += x[1] * y[1];
    }
    for (x, y) in last_x.iter().zip(last_y) {
        even += *x * *y;
    }
    (even + odd).sum()
}

/// Products of two vectors with each of [`COLUMNS`] columns.
#[inline(always)]
fn dots(x: &[Lanes], z: &[Lanes], columns: &[Lanes], stride: usize) -> ([f64; COLUMNS], [f64; COLUMNS]) {
    let height = x.len();
    let z = &z[..height];
    let (c0, c1) = (&columns[..height], &columns[stride..][..height]);
    let (c2, c3) = (&columns[2 * stride..][..height], &columns[3 * stride..][..height]);
    let (mut of_x, mut of_z) = ([Lanes::ZERO; COLUMNS], [Lanes::ZERO; COLUMNS]);
    for row in 0..height {
        let (x, z) = (x[row], z[row]);
        let of = [c0[row], c1[row], c2[row], c3[row]];
        for k in 0..COLUMNS {
            of_x[k] += x * of[k];
            of_z[k] += z * of[k];
        }
    }
    let sums = |of: [Lanes; COLUMNS]| [of[0].sum(), of[1].sum(), of[2].sum(), of[3].sum()];
    (sums(of_x), sums(of_z))
}

/// Takes `f` times `x` and `g` times `z` off each of [`COLUMNS`] columns.
#[inline(always)]
fn subtract(
    f: &[f64; COLUMNS],
    g: &[f64; COLUMNS],
    x: &[Lanes],
    z: &[Lanes],
    columns: &mut [Lanes],
    stride: usize,
) {
    let height = x.len();
    let z = &z[..height];
    let (c0, rest) = columns.split_at_mut(stride);
    let (c1, rest) = rest.split_at_mut(stride);
    let (c2, c3) = rest.split_at_mut(stride);
    let (c0, c1, c2, c3) = (&mut c0[..height], &mut c1[..height], &mut c2[..height], &mut c3[..height]);
    for row in 0..height {
        let (x, z) = (x[row], z[row]);
        c0[row] -= x * f[0] + z * g[0];
        c1[row] -= x * f[1] + z * g[1];
        c2[row] -= x * f[2] + z * g[2];
        c3[row] -= x * f[3] + z * g[3];
    }
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;
    use crate::numerics::lanes::LANES;

    /// Reflections of some hundred rows, against the largest number.
    const ROUNDING: f64 = 1e-13;

    /// A column shorter than this counts as zero: what [`NEGLIGIBLE_SQUARES`] leaves out is far less.
    const NOTHING: f64 = 1e-120;

    fn number(k: usize) -> f64 {
        ((k * 7919 % 1009) as f64 / 504.0 - 1.0) * 10_f64.powi((k % 5) as i32 - 2)
    }

    /// The Gram matrix of a triangle above a block, which reflections keep.
    fn gram(r: &[f64], block: &[Lanes], width: usize, stride: usize, height: usize) -> Mat<f64> {
        let row = |i: usize, j: usize| if i <= j { r[i * width + j] } else { 0.0 };
        Mat::from_fn(width, width, |a, b| {
            let above: f64 = (0..width).map(|i| row(i, a) * row(i, b)).sum();
            let lanes = |k: usize| block[k * stride..][..height].iter().flat_map(|of| of.0);
            above + lanes(a).zip(lanes(b)).map(|(x, y)| x * y).sum::<f64>()
        })
    }

    fn folded(width: usize, stride: usize, height: usize, plainly: bool) -> Vec<f64> {
        let mut r: Vec<f64> = (0..width * width).map(|k| number(k + 17)).collect();
        let mut block: Vec<Lanes> = (0..width * stride)
            .map(|k| Lanes(std::array::from_fn(|lane| number(LANES * k + lane))))
            .collect();
        let expected = gram(&r, &block, width, stride, height);
        let fold = Fold { r: &mut r, block: &mut block, width, stride, height };
        if plainly {
            fold.run()
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

    /// All remainders of columns and rows; what lies below the triangle and behind the rows is left out.
    #[test]
    fn the_gram_matrix_stays() {
        for width in 1..=14 {
            for (stride, height) in [(1, 1), (2, 1), (5, 5), (8, 3), (32, 32)] {
                folded(width, stride, height, false);
            }
        }
        folded(40, 32, 32, false);
    }

    #[test]
    fn wide_registers_give_the_bits_of_narrow_ones() {
        for width in [1, 2, 7, 40] {
            assert_eq!(folded(width, 32, 32, false), folded(width, 32, 32, true));
        }
    }

    /// Four rows beneath a triangle of forty columns: after four reflections the block holds rounding, after eight that
    /// of rounding, and so on until squares are below the smallest double.
    #[test]
    fn few_rows_beneath_a_wide_triangle_keep_the_gram_matrix() {
        let (width, height) = (40, 1);
        let empty = vec![0.0; width * width];
        let slow: Vec<f64> = (0..width * width).map(|k| 1e-9 * number(k)).collect();
        // one row, and others that repeat it: nothing is left after the first reflection
        let rows = |k: usize| Lanes(std::array::from_fn(|lane| number(LANES * k + lane)));
        let repeated = |k: usize| Lanes::splat(number(k));
        for above in [&empty, &slow] {
            for made in [&rows as &dyn Fn(usize) -> Lanes, &repeated] {
                for size in [1.0, 1e-100, 1e-150, 1e-160, 1e-200, 1e-310, f64::MIN_POSITIVE, 5e-324] {
                    let mut r = above.clone();
                    let mut block: Vec<Lanes> = (0..width).map(|k| made(k) * size).collect();
                    let expected = gram(&r, &block, width, 1, height);
                    Fold { r: &mut r, block: &mut block, width, stride: 1, height }.fold();
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
        let mut block = vec![Lanes::ZERO; 6 * 4];
        Fold { r: &mut r, block: &mut block, width: 6, stride: 4, height: 4 }.fold();
        assert_eq!(r, before);
    }
}
