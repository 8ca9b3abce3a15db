//! Plain form of a triangular factor: dense QR of many rows at once. The structured form ([`super::factor`]) is tested
//! against it, and `armwatch benchmark stages` compares with it.

use faer::Mat;

use super::factor::TriangularFactor;
use crate::NumericsError;

/// Number of rows that are factored at once, on top of the triangle of the earlier ones.
const ROWS: usize = 2048;

/// Factor of the rows of `[w | tau]`, given as `b + 1` columns of equal length.
///
/// # Errors
/// [`NumericsError::NotATriangle`] without columns, [`NumericsError::NotFinite`] if a number is not finite.
pub fn dense_factor(columns: &[Vec<f64>]) -> Result<TriangularFactor, NumericsError> {
    let width = columns.len();
    let rows = columns.first().map_or(0, Vec::len);
    let mut r = Mat::<f64>::zeros(width, width);
    for first in (0..rows).step_by(ROWS) {
        let taken = ROWS.min(rows - first);
        let entry = |i: usize, j: usize| if i < width { r[(i, j)] } else { columns[j][first + i - width] };
        r = Mat::from_fn(width + taken, width, entry).qr().thin_R().to_owned();
    }
    let packed: Vec<f64> = (0..width).flat_map(|j| (0..=j).map(move |i| (i, j))).map(|at| r[at]).collect();
    TriangularFactor::from_packed(width.saturating_sub(1), rows, &packed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_keeps_the_products_of_columns() {
        let value = |i: usize, j: usize| ((i * 7919 + j * 104_729) as f64 * 0.618_034).fract() - 0.5;
        for rows in [1, 3, ROWS - 1, ROWS + 5] {
            let columns: Vec<Vec<f64>> = (0..4).map(|j| (0..rows).map(|i| value(i, j)).collect()).collect();
            let found = dense_factor(&columns).expect("finite");
            assert_eq!((found.rows(), found.columns()), (rows, 3));
            let gram = found.upper().transpose() * found.upper();
            for (a, b) in (0..4).flat_map(|a| (0..4).map(move |b| (a, b))) {
                let expected: f64 = columns[a].iter().zip(&columns[b]).map(|(x, y)| x * y).sum();
                assert!((gram[(a, b)] - expected).abs() < 1e-12 * rows as f64, "{rows} {a} {b}");
            }
        }
        assert!(matches!(dense_factor(&[vec![f64::NAN]]), Err(NumericsError::NotFinite(_))));
        assert!(dense_factor(&[]).is_err());
    }
}
