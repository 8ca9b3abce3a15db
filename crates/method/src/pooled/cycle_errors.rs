//! Standard errors from the scatter between whole cycles, exact from their factors.
//!
//! Rows of a cycle share whatever the model leaves out: ripple, temperature, the path of the motion.
//! Cycles are recorded minutes or days apart, so only they are taken as independent: the score of cycle
//! `c` is `sum over joints of R_cjᵀ (z_cj - R_cj theta)` for its factors `[R_cj z_cj]`, since reflections
//! keep products of columns.
//!
//! What the model leaves out is partly the same in each cycle, since all cycles have one motion: ripple, another friction law,
//! gears that bend. That part does not scatter, and more cycles do not reduce it. It shows within a cycle, whose rows it
//! correlates ([`over_cycles`]).

use faer::{Mat, Side};

use super::loaded_rows::is_friction;
use super::pool::{CycleParts, RowWeights};
use crate::NumericsError;
use crate::identify::joint_factors::FactorColumns;
use crate::statistics::descriptive::median;
use armwatch_model::robot::{JointIndex, ParameterId};

/// Smallest number of cycles whose scatter is used. If there are fewer, Student's quantile for the few degrees of
/// freedom makes intervals so wide and uncertain that the noise of the rows gives better ones.
pub const FEWEST_CYCLES: usize = 8;

/// Largest leverage of a cycle, so that a cycle that alone decides a parameter gives a large, but finite error.
const MAX_LEVERAGE: f64 = 0.99;

/// Columns of a problem, and the indices of each joint's columns among them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProblemColumns {
    width: usize,
    /// `[n][columns of the joint]`; `None` for a column that the problem omits.
    places: Vec<Vec<Option<usize>>>,
}

impl ProblemColumns {
    /// All joints stacked [3.22] over the columns `kept`, ascending indices among all.
    #[must_use]
    pub fn stacked(columns: &FactorColumns, kept: &[usize]) -> Self {
        let place = |all: &usize| kept.binary_search(all).ok();
        let of_joint = |j: usize| columns.places(JointIndex::new(j)).iter().map(place).collect();
        Self { width: kept.len(), places: (0..columns.joint_count()).map(of_joint).collect() }
    }

    /// One joint alone [3.21] over the columns `kept` of this joint, ascending.
    #[must_use]
    pub fn of_joint(columns: &FactorColumns, joint: JointIndex, kept: &[usize]) -> Self {
        let mut places: Vec<Vec<Option<usize>>> =
            columns.by_joint().iter().map(|of| vec![None; of.len()]).collect();
        if let Some(own) = places.get_mut(joint.index()) {
            for (place, &column) in kept.iter().enumerate() {
                own[column] = Some(place);
            }
        }
        Self { width: kept.len(), places }
    }

    /// Number of cycles with rows of this problem.
    #[must_use]
    pub fn cycles(&self, cycles: &[CycleParts]) -> usize {
        cycles.iter().filter(|cycle| self.has_rows(cycle)).count()
    }

    fn has_rows(&self, cycle: &CycleParts) -> bool {
        (0..self.places.len()).any(|j| self.takes(cycle, j))
    }

    fn takes(&self, cycle: &CycleParts, j: usize) -> bool {
        self.places[j].iter().any(Option::is_some) && cycle.by_joint[j].rows() > 0
    }
}

/// Covariance of `theta` `[width]` with the cycles as clusters, and the degrees of freedom of each parameter. `inverse`
/// `[width x width]` is the inverse triangular factor of the weighted problem, including prior rows if there are any.
/// Scores are corrected for leverage, as in leaving the cycle out (CR3): with the factor `(C - 1) / C` of the sum this
/// is the jackknife over cycles.
///
/// # Errors
/// [`NumericsError::TooShort`] for fewer than two cycles, [`NumericsError::NotFinite`] if a leverage cannot be
/// computed.
pub(super) fn between_cycles(
    cycles: &[CycleParts],
    design: &ProblemColumns,
    weights: &RowWeights,
    theta: &[f64],
    inverse: &Mat<f64>,
) -> Result<Sandwich, NumericsError> {
    let taking_part = design.cycles(cycles);
    if taking_part < 2 {
        return Err(NumericsError::TooShort { what: "the choice of cycles", rows: taking_part, needed: 2 });
    }
    let with_rows = cycles.iter().enumerate().filter(|(_, cycle)| design.has_rows(cycle));
    let blocks = with_rows.map(|(c, cycle)| {
        let of_joint = |j| weights.of(c, j);
        block(cycle, design, of_joint, theta, inverse)
    });
    sandwich(inverse, blocks)
}

fn block(
    cycle: &CycleParts,
    design: &ProblemColumns,
    weight: impl Fn(usize) -> f64,
    theta: &[f64],
    inverse: &Mat<f64>,
) -> CycleBlock {
    let joints: Vec<usize> = (0..cycle.by_joint.len()).filter(|&j| design.takes(cycle, j)).collect();
    let rows = joints.iter().map(|&j| cycle.by_joint[j].columns() + 1).sum();
    let mut w = Mat::<f64>::zeros(rows, design.width);
    let mut e = Mat::<f64>::zeros(rows, 1);
    let mut at = 0;
    for j in joints {
        let (r, places) = (cycle.by_joint[j].upper(), &design.places[j]);
        let (root, b) = (weight(j).sqrt(), places.len());
        for i in 0..=b {
            let mut residual = r[(i, b)];
            for (k, place) in places.iter().enumerate().skip(i) {
                if let Some(place) = *place {
                    w[(at + i, place)] = root * r[(i, k)];
                    residual -= r[(i, k)] * theta[place];
                }
            }
            e[(at + i, 0)] = root * residual;
        }
        at += b + 1;
    }
    let w = w * inverse;
    CycleBlock { information: w.transpose() * &w, score: w.transpose() * e }
}

/// Variance of a parameter and its degrees of freedom.
pub(super) type Variance = (f64, f64);

/// Variance of each parameter of an estimate over `count` cycles, at least two, and the part of the variance within cycles that
/// all of them repeat, 0 to 1. `within` is the variance of the estimate if the errors of cycles were independent of each other,
/// `between` what their scatter says of it; parameters stand as in `ids`.
///
/// A repeated error is in each cycle and in their mean, so that the mean has `count` times the part of `within` that it
/// contributes. Friction falls while an arm warms and scatters for that reason, so the other parameters show the part.
pub(super) fn over_cycles(
    within: &[Variance],
    between: &Sandwich,
    ids: &[ParameterId],
    count: usize,
) -> (Vec<Variance>, f64) {
    let cycles = count as f64;
    let scatter = |k: usize| between.matrix[(k, k)];
    let ratios = |takes: &dyn Fn(&ParameterId) -> bool| -> Vec<f64> {
        let shown = (0..ids.len()).filter(|&k| takes(&ids[k]) && within[k].0 > 0.0);
        shown.map(|k| scatter(k) / within[k].0).collect()
    };
    let ratio = median(&ratios(&|id| !is_friction(id.kind))).or_else(|| median(&ratios(&|_| true)));
    // median of a chi² variable over its degrees of freedom (Wilson & Hilferty 1931)
    let of_chance = (1.0 - 2.0 / (9.0 * (cycles - 1.0))).powi(3);
    let share = ratio.map_or(0.0, |ratio| (1.0 - ratio / of_chance).clamp(0.0, 1.0));
    let variance = |k: usize| {
        let (rows, rows_freedom) = within[k];
        let repeated = share * cycles * rows;
        let (single, freedom) = match count >= FEWEST_CYCLES {
            true => (scatter(k), between.freedom[k]),
            false => ((1.0 - share) * rows, rows_freedom),
        };
        let sum = repeated + single;
        // Satterthwaite (1946)
        let of_sum = sum * sum / (repeated * repeated / rows_freedom + single * single / freedom);
        (sum, if sum > 0.0 { of_sum } else { freedom })
    };
    ((0..ids.len()).map(variance).collect(), share)
}

/// What blocks say of an estimate's scatter.
pub(super) struct Sandwich {
    /// Covariance, `[b x b]`.
    pub(super) matrix: Mat<f64>,
    /// Degrees of freedom of each parameter, `[b]`.
    pub(super) freedom: Vec<f64>,
}

/// Covariance of an estimate from at least two blocks. `inverse` is `r11⁻¹` of the factor that gave the estimate.
fn sandwich(
    inverse: &Mat<f64>,
    blocks: impl IntoIterator<Item = CycleBlock>,
) -> Result<Sandwich, NumericsError> {
    let b = inverse.ncols();
    let mut matrix = Mat::<f64>::zeros(b, b);
    let (mut total, mut squares, mut count) = (vec![0.0; b], vec![0.0; b], 0.0);
    for block in blocks {
        let score = corrected(&block)?;
        let moved = inverse * score;
        matrix += &moved * moved.transpose();
        let spread = inverse * &block.information;
        for k in 0..b {
            let share: f64 = (0..b).map(|i| spread[(k, i)] * inverse[(k, i)]).sum();
            total[k] += share;
            squares[k] += share * share;
        }
        count += 1.0;
    }
    matrix *= faer::Scale((count - 1.0) / count);
    let freedom = (0..b).map(|k| (total[k] * total[k] / squares[k] - 1.0).max(1.0)).collect();
    Ok(Sandwich { matrix, freedom })
}

/// Sums over one block, in coordinates that make `wᵀw` the identity.
struct CycleBlock {
    /// `wᵀw` of the block, `[b x b]`: its eigenvalues are leverages.
    information: Mat<f64>,
    /// `wᵀe` of the block, `[b x 1]`.
    score: Mat<f64>,
}

/// Score of the block with its residuals corrected for the fit, as in leaving the block out:
/// `w_bᵀ (1 - w_b w_bᵀ)⁻¹ = (1 - w_bᵀ w_b)⁻¹ w_bᵀ`, so a matrix of `b` rows is enough.
fn corrected(block: &CycleBlock) -> Result<Mat<f64>, NumericsError> {
    let eigen = block
        .information
        .self_adjoint_eigen(Side::Lower)
        .map_err(|_| NumericsError::NotFinite("the leverage of a block"))?;
    let leverage = eigen.S().column_vector();
    let along = eigen.U().transpose() * &block.score;
    let scaled =
        Mat::from_fn(along.nrows(), 1, |i, _| along[(i, 0)] / (1.0 - leverage[i].clamp(0.0, MAX_LEVERAGE)));
    Ok(eigen.U() * scaled)
}
