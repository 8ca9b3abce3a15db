use faer::Mat;
use proptest::prelude::*;

use super::*;

/// Rounding of a QR of a few thousand rows.
const ROUNDING: f64 = 1e-10;

fn value(i: usize, j: usize) -> f64 {
    // badly scaled on purpose: columns differ by six decades
    let x = (i as f64) * 0.01;
    [x.sin(), (1.7 * x).cos(), x, 1.0][j] * decade(j)
}

fn decade(j: usize) -> f64 {
    10f64.powi(2 * i32::try_from(j).expect("small") - 3)
}

fn problem(rows: usize) -> Mat<f64> {
    let theta = [3.0, -2.0, 0.5, 7.0];
    Mat::from_fn(rows, 5, |i, j| {
        if j < 4 {
            value(i, j)
        } else {
            (0..4).map(|k| value(i, k) * theta[k] / decade(k)).sum::<f64>()
                + 1e-3 * ((i * 7919 % 101) as f64 - 50.0)
        }
    })
}

/// The same problem by another method: normal equations of the columns, scaled to one size.
fn by_normal_equations(all: &Mat<f64>) -> Vec<f64> {
    use faer::linalg::solvers::Solve;
    let whole = Mat::from_fn(all.nrows(), 4, |i, j| all[(i, j)] / decade(j));
    let rhs = all.as_ref().subcols(4, 1);
    let normal = whole.transpose() * &whole;
    let solved = normal.llt(faer::Side::Lower).expect("positive definite").solve(whole.transpose() * rhs);
    (0..4).map(|j| solved[(j, 0)] / decade(j)).collect()
}

#[test]
fn blocks_in_any_size_give_the_solution_of_the_whole() {
    let all = problem(5000);
    let expected = by_normal_equations(&all);
    for block in [1, 7, 100, 5000] {
        let mut factor = TriangularFactor::new(4);
        let mut at = 0;
        while at < 5000 {
            let n = block.min(5000 - at);
            factor.fold(all.as_ref().subrows(at, n));
            at += n;
        }
        let solved = factor.solve(1e8, |i| i.to_string()).expect("solves");
        for (found, expected) in solved.theta.iter().zip(&expected) {
            assert!((found - expected).abs() < ROUNDING * expected.abs());
        }
        let residual: f64 = (0..5000)
            .map(|i| ((0..4).map(|k| all[(i, k)] * solved.theta[k]).sum::<f64>() - all[(i, 4)]).powi(2))
            .sum();
        assert!((solved.residual_sum_of_squares - residual).abs() < ROUNDING * residual);
    }
}

#[test]
fn joining_two_factors_equals_folding_all_rows() {
    let all = problem(2000);
    let mut one = TriangularFactor::new(4);
    one.fold(all.as_ref());
    let mut left = TriangularFactor::new(4);
    left.fold(all.as_ref().subrows(0, 700));
    let mut right = TriangularFactor::new(4);
    right.fold(all.as_ref().subrows(700, 1300));
    left.join(&right);
    assert_eq!(left.rows(), 2000);
    let (a, b) = (one.solve(1e8, |i| i.to_string()), left.solve(1e8, |i| i.to_string()));
    let (a, b) = (a.expect("solves"), b.expect("solves"));
    for i in 0..4 {
        assert!((a.theta[i] - b.theta[i]).abs() < ROUNDING * a.theta[i].abs());
    }
}

/// Reference for the factor in blocks: one QR of all rows.
fn dense(all: &Mat<f64>) -> Mat<f64> {
    all.qr().thin_R().to_owned()
}

/// Rounding of either QR, relative to the lengths of the columns.
const EQUAL: f64 = 1e-12;

/// Length of a column below which it is zero except for underflow.
const NOTHING: f64 = 1e-120;

/// Compares a factor with dense QR: the products of its columns, and the residual.
///
/// The residual of `[w | tau]` is `tau` minus its part in the columns' space. Either QR is the exact one of columns
/// with changes of the size of their rounding (Higham, Accuracy and Stability of Numerical Algorithms, 19.4). So each
/// gives the residual only to rounding of `|tau| + sum |w_k theta_k|`; with few rows the residual is much smaller than
/// these. If it is a hundredth of the torque, as in any recording, the relative error is 1e-10.
fn assert_factor_of(found: &TriangularFactor, all: &Mat<f64>) {
    let (r, expected) = (found.upper(), dense(all));
    let (gram, dense_gram) = (r.transpose() * r, expected.transpose() * &expected);
    let length = |k: usize| dense_gram[(k, k)].sqrt() + NOTHING;
    for (i, j) in (0..r.ncols()).flat_map(|i| (0..r.ncols()).map(move |j| (i, j))) {
        let error = (gram[(i, j)] - dense_gram[(i, j)]).abs();
        assert!(error <= EQUAL * length(i) * length(j), "{i} {j}: {error}");
        assert!(i <= j || r[(i, j)] == 0.0);
    }
    let last = r.ncols() - 1;
    // with dependent columns, each QR may assign any part of the torque to them
    let Ok(solved) = found.solve(1e8, |i| i.to_string()) else { return };
    let parts: f64 = (0..last).map(|k| solved.theta[k].abs() * length(k)).sum();
    let error = (r[(last, last)].abs() - expected[(last, last)].abs()).abs();
    assert!(error <= EQUAL * (length(last) + parts), "{error}");
}

#[test]
fn the_factor_is_that_of_a_dense_qr() {
    for rows in [5, 127, 128, 129, 1000, 5000] {
        let all = problem(rows);
        let (mut one_by_one, mut in_lanes) = (FactorBuilder::new(4), FactorBuilder::new(4));
        (0..rows).for_each(|i| one_by_one.push((0..5).map(|j| all[(i, j)])));
        for first in (0..rows).step_by(LANES) {
            let at = |lane: usize, j: usize| {
                if first + lane < rows { all[(first + lane, j)] } else { f64::NAN }
            };
            let row = (0..5).map(|j| Lanes(std::array::from_fn(|lane| at(lane, j))));
            in_lanes.push_lanes(row, std::array::from_fn(|lane| first + lane < rows));
        }
        let mut whole = TriangularFactor::new(4);
        whole.fold(all.as_ref());
        for found in [one_by_one.take(), in_lanes.take(), whole] {
            assert_eq!(found.rows(), rows);
            assert_factor_of(&found, &all);
        }
    }
}

/// Rows of lanes that go alternately to two builders: each receives exactly the chosen ones, in any pattern.
#[test]
fn lanes_that_are_not_chosen_leave_nothing() {
    let all = problem(1500);
    let mut builders = [FactorBuilder::new(4), FactorBuilder::new(4)];
    let side = |i: usize| usize::from(i * 7919 % 11 < 4 + i / 300);
    for first in (0..1500).step_by(LANES) {
        for (of, builder) in builders.iter_mut().enumerate() {
            let row = (0..5).map(|j| Lanes(std::array::from_fn(|lane| all[(first + lane, j)])));
            builder.push_lanes(row, std::array::from_fn(|lane| side(first + lane) == of));
        }
    }
    for (of, builder) in builders.iter_mut().enumerate() {
        let rows: Vec<usize> = (0..1500).filter(|i| side(*i) == of).collect();
        let chosen = Mat::from_fn(rows.len(), 5, |i, j| all[(rows[i], j)]);
        assert_factor_of(&builder.take(), &chosen);
    }
}

#[test]
fn rows_pushed_one_by_one_make_the_factor_of_the_blocks() {
    let all = problem(5000);
    let mut expected = TriangularFactor::new(4);
    expected.fold(all.as_ref());
    let mut folder = FactorBuilder::new(4);
    for _twice in 0..2 {
        (0..5000).for_each(|i| folder.push((0..5).map(|j| all[(i, j)])));
        let found = folder.take();
        assert_eq!(found.rows(), 5000);
        // reflections do not determine the sign of a row
        for (a, b) in found.packed().iter().zip(expected.packed()) {
            assert!((a.abs() - b.abs()).abs() < ROUNDING * all.norm_max() * 5000.0_f64.sqrt(), "{a} {b}");
        }
        let again = TriangularFactor::from_packed(4, 5000, &found.packed()).expect("a triangle");
        assert_eq!(again, found);
    }
    assert_eq!(folder.take(), TriangularFactor::new(4));
}

#[test]
fn a_factor_gives_the_sums_of_squares_of_its_rows() {
    let all = problem(3000);
    let mut factor = TriangularFactor::new(4);
    factor.fold(all.as_ref());
    // any parameters, not only the best-fitting ones
    for theta in [[0.0; 4], [100.0, -3.0, 0.25, 0.001]] {
        let deviation = |i: usize| (0..4).map(|k| all[(i, k)] * theta[k]).sum::<f64>() - all[(i, 4)];
        let expected: f64 = (0..3000).map(|i| deviation(i).powi(2)).sum();
        let found = factor.residual_sum_of_squares(&theta);
        assert!((found - expected).abs() < ROUNDING * expected, "{found} {expected}");
    }
    let measured: f64 = (0..3000).map(|i| all[(i, 4)].powi(2)).sum();
    assert!((factor.torque_sum_of_squares() - measured).abs() < ROUNDING * measured);
}

#[test]
fn columns_that_are_zero_at_first_lose_nothing() {
    // the first column is zero at first, as for a joint that rests at first
    let all = Mat::from_fn(3000, 5, |i, j| match j {
        0 if i < 2500 => 0.0,
        _ => problem_entry(i, j),
    });
    let mut factor = TriangularFactor::new(4);
    for at in [0, 3, 1000, 2000] {
        let end = [3, 1000, 2000, 3000].into_iter().find(|&end| end > at).expect("a block");
        factor.fold(all.as_ref().subrows(at, end - at));
    }
    let theta = [2.0 / decade(0), 1.0 / decade(1), -1.0 / decade(2), 3.0 / decade(3)];
    let deviation = |i: usize| (0..4).map(|k| all[(i, k)] * theta[k]).sum::<f64>() - all[(i, 4)];
    let expected: f64 = (0..3000).map(|i| deviation(i).powi(2)).sum();
    let found = factor.residual_sum_of_squares(&theta);
    assert!((found - expected).abs() < ROUNDING * expected, "{found} {expected}");
}

fn problem_entry(i: usize, j: usize) -> f64 {
    if j < 4 { value(i, j) } else { (i * 7919 % 101) as f64 - 50.0 }
}

#[test]
fn what_is_no_triangle_is_refused() {
    assert!(matches!(
        TriangularFactor::from_packed(2, 10, &[1.0; 5]),
        Err(NumericsError::NotATriangle { numbers: 5, columns: 2 })
    ));
    let error = TriangularFactor::from_packed(1, 10, &[1.0, f64::NAN, 1.0]).expect_err("not finite");
    assert!(matches!(error, NumericsError::NotFinite(_)));
}

#[test]
fn a_column_that_repeats_another_is_named() {
    let all = Mat::from_fn(500, 4, |i, j| match j {
        2 => 2.0 * value(i, 0) - value(i, 1),
        3 => 1.0,
        _ => value(i, j),
    });
    let mut factor = TriangularFactor::new(3);
    factor.fold(all.as_ref());
    let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank two of three");
    assert!(matches!(error, NumericsError::RankDeficient { count: 1, columns: 3, .. }), "{error}");
}

#[test]
fn all_that_a_motion_hides_is_named_and_nothing_else() {
    // two zero columns, one that repeats another, and one independent column
    let all = Mat::from_fn(500, 6, |i, j| match j {
        1 | 3 => 0.0,
        4 => 3.0 * value(i, 0),
        _ => value(i, j.min(2)),
    });
    let mut factor = TriangularFactor::new(5);
    factor.fold(all.as_ref());
    let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank two of five");
    let NumericsError::RankDeficient { count, columns, names } = error else { panic!("{error}") };
    assert_eq!((count, columns), (3, 5));
    // either p0 or p4 may represent the pair
    assert!(["p0, p1, p3", "p1, p3, p4"].contains(&names.as_str()), "{names}");
}

#[test]
fn a_column_of_zeros_is_named() {
    let all = Mat::from_fn(500, 3, |i, j| if j == 1 { 0.0 } else { value(i, j) });
    let mut factor = TriangularFactor::new(2);
    factor.fold(all.as_ref());
    let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank one of two");
    assert!(error.to_string().contains("p1"), "{error}");
}

/// Rows of every kind that recordings contain: zero columns, columns that repeat others or are constant, lengths over
/// many decades, numbers below the smallest normal one; fewer rows than columns and many more.
fn rows_of_any_kind() -> impl Strategy<Value = Mat<f64>> {
    let column = (0..5_u8, -9..9_i32, any::<u64>());
    (prop::collection::vec(column, 2..41), 1..300_usize).prop_map(|(columns, rows)| {
        let random = |seed: u64, i: usize| {
            // xorshift of a product: any two rows differ
            let mut x = (seed | 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(i as u64 + 1);
            x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((x >> 11) as f64) / (1_u64 << 52) as f64 - 1.0
        };
        Mat::from_fn(rows, columns.len(), |i, j| {
            let (kind, decade, seed) = columns[j];
            match kind {
                0 => 0.0,
                1 => 10_f64.powi(decade),
                2 => random(columns[0].2, i),
                3 if decade < -6 => random(seed, i) * 1e-308,
                _ => random(seed, i) * 10_f64.powi(decade),
            }
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_rows_have_the_factor_of_a_dense_qr(all in rows_of_any_kind(), cut in 0.0..1.0_f64) {
        let (rows, width) = (all.nrows(), all.ncols());
        let mut builder = FactorBuilder::new(width - 1);
        (0..rows).for_each(|i| builder.push((0..width).map(|j| all[(i, j)])));
        // the same in two parts; one may be small below a wide triangle
        let first = (rows as f64 * cut) as usize;
        let mut parts = TriangularFactor::new(width - 1);
        parts.fold(all.as_ref().subrows(0, first));
        parts.fold(all.as_ref().subrows(first, rows - first));
        for found in [builder.take(), parts] {
            prop_assert!(found.is_finite());
            assert_factor_of(&found, &all);
        }
    }
}

#[test]
fn a_column_of_rounding_has_no_direction_and_no_parameter() {
    let mut builder = FactorBuilder::new(2);
    for i in 0..50 {
        let t = 0.1 * f64::from(i);
        builder.push([t.sin(), 1e-16 * t.cos(), 2.0 * t.sin() + 0.1 * (3.0 * t).cos()].into_iter());
    }
    let factor = builder.take();
    assert_eq!(factor.independent_columns(2, 1e-7), [0]);
    let theta = factor.basic_solution(1e-7);
    assert!((theta[0] - 2.0).abs() < 0.05 && theta[1] == 0.0, "{theta:?}");
}
