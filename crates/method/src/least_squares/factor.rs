//! Growing triangular factor: least squares without the whole observation matrix in memory.
//!
//! For an observation matrix `w` and a right-hand side `tau`, the factor `r` of
//! `[w | tau] = q r` holds all that least squares needs: `r = [r11 r12; 0 r22]` gives
//! `theta = r11⁻¹ r12`, the residual sum of squares `r22²`, and the singular values of `w`. New rows are folded in
//! by factoring `[r; rows]` again (Golub & Van Loan, Matrix Computations, 6.5; the sequential form of TSQR, Demmel
//! et al. 2012), one block at a time (`triangle.rs`).

use faer::{Mat, MatRef};

use super::triangle::Fold;
use crate::NumericsError;
use crate::lanes::{LANES, Lanes};

/// Length of a column, relative to the longest, below which it is zero except for rounding.
pub(crate) const ZERO_COLUMN_THRESHOLD: f64 = 1e-12;

/// Rows that a [`FactorBuilder`] collects before it folds them: forty columns of them fit in a core's first-level
/// cache.
pub const BLOCK_ROWS: usize = 128;

/// Triangular factor of all rows of `[w | tau]` seen so far; `(b+1) x (b+1)`.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangularFactor {
    r: Mat<f64>,
    rows: usize,
}

impl TriangularFactor {
    /// Creates a factor without rows for `columns` columns of `w`.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self { r: Mat::zeros(columns + 1, columns + 1), rows: 0 }
    }

    /// Number of columns `b` of `w`, without the right-hand side.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.r.ncols() - 1
    }

    /// Number of rows folded in so far.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Sets the number of rows.
    pub(super) fn of_rows(self, rows: usize) -> Self {
        Self { rows, ..self }
    }

    /// Upper triangular factor, `[(b+1) x (b+1)]`; the last column is that of the torque.
    #[must_use]
    pub fn upper(&self) -> MatRef<'_, f64> {
        self.r.as_ref()
    }

    /// Upper triangle column by column, `r[0,0], r[0,1], r[1,1], r[0,2]..`: `(b+1) (b+2) / 2` numbers.
    /// [`TriangularFactor::from_packed`] needs these and the number of rows.
    #[must_use]
    pub fn packed(&self) -> Vec<f64> {
        (0..self.r.ncols()).flat_map(|j| (0..=j).map(move |i| self.r[(i, j)])).collect()
    }

    /// Restores a factor from the result of [`TriangularFactor::packed`].
    ///
    /// # Errors
    /// [`NumericsError::NotATriangle`] if there are not `(b+1) (b+2) / 2` numbers, [`NumericsError::NotFinite`] if one
    /// is not finite.
    pub fn from_packed(columns: usize, rows: usize, packed: &[f64]) -> Result<Self, NumericsError> {
        let k = columns + 1;
        if packed.len() != k * (k + 1) / 2 {
            return Err(NumericsError::NotATriangle { numbers: packed.len(), columns });
        }
        if !packed.iter().all(|x| x.is_finite()) {
            return Err(NumericsError::NotFinite("a triangular factor"));
        }
        let r = Mat::from_fn(k, k, |i, j| if i <= j { packed[j * (j + 1) / 2 + i] } else { 0.0 });
        Ok(Self { r, rows })
    }

    /// Returns true if every number of the factor is finite. An absurd value in a row makes it not finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.r.is_all_finite()
    }

    /// Sum of squares of `w theta - tau` over all rows, for any `theta` `[b]`. Reflections keep lengths, so it equals
    /// that of `r [theta; -1]`.
    ///
    /// # Panics
    /// If `theta` has fewer than `b` entries.
    #[must_use]
    pub fn residual_sum_of_squares(&self, theta: &[f64]) -> f64 {
        let b = self.columns();
        (0..=b)
            .map(|i| {
                let estimated: f64 = (i..b).map(|j| self.r[(i, j)] * theta[j]).sum();
                (estimated - self.r[(i, b)]).powi(2)
            })
            .sum()
    }

    /// `r11⁻¹` of the columns of `w`, upper triangular, `[b x b]`: with it `(wᵀw)⁻¹ = r11⁻¹ r11⁻ᵀ`.
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] if the columns are dependent.
    pub fn inverse_of_upper(&self) -> Result<Mat<f64>, NumericsError> {
        let b = self.columns();
        let mut inverse = Mat::<f64>::identity(b, b);
        let r11 = self.r.as_ref().submatrix(0, 0, b, b);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            r11,
            inverse.as_mut(),
            faer::Par::Seq,
        );
        if inverse.is_all_finite() {
            Ok(inverse)
        } else {
            Err(NumericsError::NotFinite("the observation matrix"))
        }
    }

    /// Independent columns of `w`: those with a new part of more than `dependent`. Columns that are zero except for
    /// rounding have no direction, and their parameters would be infinite.
    #[must_use]
    pub fn independent_columns(&self, columns: usize, dependent: f64) -> Vec<usize> {
        let length = |k: usize| (0..=k).map(|i| self.r[(i, k)].powi(2)).sum::<f64>().sqrt();
        let lengths: Vec<f64> = (0..columns).map(length).collect();
        let zero = ZERO_COLUMN_THRESHOLD * lengths.iter().copied().fold(0.0, f64::max);
        let is_new = |k: &usize| self.r[(*k, *k)].abs() > (dependent * lengths[*k]).max(zero);
        (0..columns).filter(is_new).collect()
    }

    /// Least-squares solution `[b]`, zero for columns whose new part is `dependent` or less.
    #[must_use]
    pub fn basic_solution(&self, dependent: f64) -> Vec<f64> {
        let kept = self.independent_columns(self.columns(), dependent);
        let own = self.restricted(&kept);
        let k = kept.len();
        let mut theta = vec![0.0; self.columns()];
        for at in (0..k).rev() {
            let known: f64 = (at + 1..k).map(|i| own.r[(at, i)] * theta[kept[i]]).sum();
            theta[kept[at]] = (own.r[(at, k)] - known) / own.r[(at, at)];
        }
        theta
    }

    /// Sum of squares of `tau` over all rows.
    #[must_use]
    pub fn torque_sum_of_squares(&self) -> f64 {
        self.r.col(self.columns()).iter().map(|x| x * x).sum()
    }

    /// Folds in `block`, rows of `[w | tau]`, `[any x (b+1)]`.
    pub fn fold(&mut self, block: MatRef<'_, f64>) {
        let k = self.r.ncols();
        let mut builder = FactorBuilder::with_block(self.columns(), block.nrows().min(BLOCK_ROWS));
        for i in 0..k {
            (i..k).for_each(|j| builder.r[i * k + j] = self.r[(i, j)]);
        }
        builder.push_rows(block);
        self.rows += block.nrows();
        self.r = builder.take().r;
    }

    /// Folds in the rows of `other`.
    pub fn join(&mut self, other: &Self) {
        let rows = self.rows + other.rows;
        self.fold(other.r.as_ref());
        self.rows = rows;
    }

    /// Factor of the same rows, each multiplied by `by`; the weight of their squares is `by²`.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Self {
        Self { r: &self.r * faer::Scale(by), rows: self.rows }
    }

    /// Factor of the same rows with only the columns `kept` of `w`, in that order.
    ///
    /// # Panics
    /// If `kept` contains a column that does not exist.
    #[must_use]
    pub fn restricted(&self, kept: &[usize]) -> Self {
        self.selected(kept, self.columns())
    }

    /// Same as `restricted`, with the column `right` of `[w | tau]` in place of the torque.
    ///
    /// # Panics
    /// If a column does not exist.
    #[must_use]
    pub fn selected(&self, kept: &[usize], right: usize) -> Self {
        let columns: Vec<usize> = kept.iter().copied().chain([right]).collect();
        let mut own = Self::new(kept.len());
        own.fold(Mat::from_fn(self.r.nrows(), columns.len(), |i, k| self.r[(i, columns[k])]).as_ref());
        own.rows = self.rows;
        own
    }

    /// Joint factor of several parts, each with its columns at `places` of a wider `w` with `columns` columns that are
    /// zero elsewhere. This stacks the rows of single joints into one problem [3.22].
    ///
    /// # Panics
    /// If `places` of a part has fewer entries than the part columns, or one beyond `columns`.
    #[must_use]
    pub fn embedded<'a>(columns: usize, parts: impl IntoIterator<Item = (&'a Self, &'a [usize])>) -> Self {
        let parts: Vec<(&Self, &[usize])> = parts.into_iter().collect();
        if let [(part, places)] = parts[..]
            && places[..part.columns()].is_sorted_by(|a, b| a < b)
        {
            return part.spread(columns, places);
        }
        let (mut folder, mut rows) = (FactorBuilder::new(columns), 0);
        for (part, places) in parts {
            let b = part.columns();
            for i in 0..=b {
                let place = |j: usize| if j < b { places[j] } else { columns };
                folder.push_at((i..=b).map(|j| (place(j), part.r[(i, j)])));
            }
            rows += part.rows;
        }
        let mut factor = folder.take();
        factor.rows = rows;
        factor
    }

    /// Factor with its columns at ascending places of a wider `w`, and its rows at the same places, which keeps it
    /// triangular.
    fn spread(&self, columns: usize, places: &[usize]) -> Self {
        let b = self.columns();
        let place = |k: usize| if k < b { places[k] } else { columns };
        let mut wide = Self { rows: self.rows, ..Self::new(columns) };
        for j in 0..=b {
            (0..=j).for_each(|i| wide.r[(place(i), place(j))] = self.r[(i, j)]);
        }
        wide
    }
}

/// Collects rows of `[w | tau]` and folds them, one block at a time, into a triangular factor. Adding rows copies and
/// allocates nothing.
pub struct FactorBuilder {
    /// Factor, `[width x width]` row by row.
    r: Vec<f64>,
    /// Rows that are not folded yet: `width` columns of `stride` numbers. Entries beyond the rows are stale.
    block: Vec<f64>,
    /// Rows per block, a multiple of [`LANES`].
    stride: usize,
    width: usize,
    filled: usize,
    rows: usize,
}

impl FactorBuilder {
    /// Creates an empty builder for `columns` columns of `w`.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self::with_block(columns, BLOCK_ROWS)
    }

    fn with_block(columns: usize, rows: usize) -> Self {
        let (width, stride) = (columns + 1, rows.max(1).next_multiple_of(LANES));
        let block = vec![0.0; stride * width];
        Self { r: vec![0.0; width * width], block, stride, width, filled: 0, rows: 0 }
    }

    /// Adds one row: its `b` entries of `w`, then its torque.
    ///
    /// # Panics
    /// If there are more than `b + 1` numbers; missing ones count as zero.
    #[inline]
    pub fn push(&mut self, row: impl Iterator<Item = f64>) {
        let mut columns = 0;
        for value in row {
            self.block[columns * self.stride + self.filled] = value;
            columns += 1;
        }
        for column in columns..self.width {
            self.block[column * self.stride + self.filled] = 0.0;
        }
        self.took(1);
    }

    /// Adds the rows of a block except zero rows, which change nothing.
    pub(super) fn push_rows(&mut self, block: MatRef<'_, f64>) {
        for i in 0..block.nrows() {
            let row = block.row(i);
            if row.iter().any(|x| *x != 0.0) {
                self.push(row.iter().copied());
            }
        }
    }

    /// Adds one row by its places and numbers. All other places are zero; the place of the torque is `b`.
    fn push_at(&mut self, entries: impl Iterator<Item = (usize, f64)>) {
        (0..self.width).for_each(|column| self.block[column * self.stride + self.filled] = 0.0);
        for (column, value) in entries {
            self.block[column * self.stride + self.filled] = value;
        }
        self.took(1);
    }

    /// Adds the rows of several instants: for each column in order the numbers of all lanes. Only the chosen lanes
    /// count.
    ///
    /// The caller must provide exactly `b + 1` columns.
    #[inline]
    pub fn push_lanes(&mut self, row: impl Iterator<Item = Lanes>, chosen: [bool; LANES]) {
        let count = chosen.iter().filter(|chosen| **chosen).count();
        if count == 0 {
            return;
        }
        // fold first unless the block has room for all, so that rows of one instant stay together
        if self.filled + count > self.stride {
            self.fold();
        }
        let Self { block, stride, filled, .. } = self;
        let places = *filled..*filled + count;
        let columns = block.chunks_exact_mut(*stride).map(|column| &mut column[places.clone()]);
        if count == LANES {
            columns.zip(row).for_each(|(column, value)| column.copy_from_slice(&value.0));
        } else {
            columns.zip(row).for_each(|(column, value)| {
                let values = value.0.into_iter().zip(chosen).filter(|(_, chosen)| *chosen);
                column.iter_mut().zip(values).for_each(|(place, (value, _))| *place = value);
            });
        }
        self.took(count);
    }

    /// Factor of all rows so far. The builder is empty afterwards and can be reused.
    #[must_use]
    pub fn take(&mut self) -> TriangularFactor {
        self.fold();
        let width = self.width;
        let r = Mat::from_fn(width, width, |i, j| self.r[i * width + j]);
        self.r.fill(0.0);
        TriangularFactor { r, rows: std::mem::take(&mut self.rows) }
    }

    #[inline]
    fn took(&mut self, rows: usize) {
        self.filled += rows;
        self.rows += rows;
        if self.filled == self.stride {
            self.fold();
        }
    }

    #[inline(never)]
    fn fold(&mut self) {
        if self.filled == 0 {
            return;
        }
        let Self { r, block, stride, width, filled, .. } = self;
        let (stride, width) = (*stride, *width);
        let height = filled.next_multiple_of(LANES);
        block.chunks_exact_mut(stride).for_each(|column| column[*filled..height].fill(0.0));
        Fold { r, block, width, stride, height }.fold();
        *filled = 0;
    }
}

#[cfg(test)]
mod tests;
