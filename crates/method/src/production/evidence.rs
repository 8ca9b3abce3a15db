//! Deviation of windows of production from the torque of a test's parameters, along the direction of each cause.
//!
//! Every direction is a change of the parameters in the torque of one joint, so its torque over the rows is `w delta`.
//! With
//! the triangular factor `R` of `[w | tau]` over these rows, products of `w delta` and of the deviation `tau - w theta`
//! are those of `R [delta; 0]` and `R [-theta; 1]`.

use nalgebra::DMatrix;

use super::reference::Reference;
use crate::NumericsError;
use crate::identify::joint_factors::{FactorColumns, JointFactor};
use armwatch_model::analysis::Motion;
use armwatch_model::analysis::work_evidence::{DEVIATION, JointEvidence, PRODUCTS, WorkDirection};
use armwatch_model::robot::{FrictionTerm, JointIndex, ParameterId, ParameterKind};

/// Evidence of the joints that move in the rows of `factors`, against the parameters of `reference`.
///
/// # Errors
/// [`NumericsError::ColumnsDiffer`] unless the parameters are exactly those of the columns.
pub fn window_evidence(
    columns: &FactorColumns,
    factors: &[JointFactor],
    reference: &Reference,
) -> Result<Vec<JointEvidence>, NumericsError> {
    let theta = columns.theta(reference.parameters.iter().copied())?;
    let of = |joint| {
        let own = columns.select(joint, &theta);
        let ids = columns.by_joint().get(joint.index())?;
        let moving =
            factors.iter().filter(|of| of.joint == joint && of.motion == Motion::Moving).collect::<Vec<_>>();
        joint_evidence(joint, &directions(joint, ids, &own, reference), &moving)
    };
    Ok((0..columns.joint_count()).map(JointIndex::new).filter_map(of).collect())
}

/// Changes of a joint's parameters by the directions. The last column is the parameters themselves, which are
/// subtracted in the deviation: `[b x (directions + 1)]`.
fn directions(joint: JointIndex, ids: &[ParameterId], theta: &[f64], reference: &Reference) -> DMatrix<f64> {
    use FrictionTerm::{Coulomb, CoulombNegative, CoulombPositive, F1, Offset};
    let entry = |row: usize, column: usize| {
        let (id, value) = (ids[row], theta[row]);
        let friction = match id.kind {
            ParameterKind::Friction(term) if id.joint == joint => Some(term),
            _ => None,
        };
        let Some(direction) = WorkDirection::ALL.get(column) else { return value };
        match (direction, friction) {
            (WorkDirection::Gain, _) => value,
            (WorkDirection::Coulomb, Some(F1 | Coulomb | CoulombPositive | CoulombNegative)) => value,
            (WorkDirection::Viscous, Some(F1 | Coulomb | CoulombPositive | CoulombNegative | Offset)) => 0.0,
            (WorkDirection::Viscous, Some(_)) => value,
            // the column of the negative direction is negative
            (WorkDirection::Offset, Some(Offset | CoulombPositive)) => 1.0,
            (WorkDirection::Offset, Some(CoulombNegative)) => -1.0,
            (WorkDirection::Load(of), None) => reference.of_last_link(id)[usize::from(*of)],
            _ => 0.0,
        }
    };
    DMatrix::from_fn(ids.len(), DEVIATION + 1, entry)
}

fn joint_evidence(
    joint: JointIndex,
    directions: &DMatrix<f64>,
    factors: &[&JointFactor],
) -> Option<JointEvidence> {
    let b = directions.nrows();
    let mut products = [0.0; PRODUCTS];
    let samples: usize = factors.iter().map(|of| of.factor.rows()).sum();
    for of in factors {
        let r = of.factor.upper();
        for row in 0..r.nrows() {
            let mut along = [0.0; DEVIATION + 1];
            for (place, along) in along.iter_mut().enumerate() {
                *along = (row..b).map(|k| r[(row, k)] * directions[(k, place)]).sum();
            }
            along[DEVIATION] = r[(row, b)] - along[DEVIATION];
            for (a, of_a) in along.iter().enumerate() {
                for (b, of_b) in along.iter().enumerate().skip(a) {
                    products[JointEvidence::index(a, b)] += of_a * of_b;
                }
            }
        }
    }
    products.iter_mut().for_each(|of| *of /= samples.max(1) as f64);
    let is_sound = samples > 0 && products.iter().all(|of| of.is_finite());
    is_sound.then_some(JointEvidence { joint, windows: 1, samples, products })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Method;
    use crate::identify::joint_factors::unpack;
    use crate::production::reference::last_link_shares;
    use crate::production::window::{analyse_window, check_window};
    use armwatch_model::analysis::log_summary::log_evidence;
    use armwatch_model::analysis::settings::AnalysisSettings;
    use armwatch_model::analysis::{Estimator, ProductionCheck};
    use armwatch_testing::cycle::cycle;
    use armwatch_testing::er3a;

    /// Sums of some hundred squares of triangular factors.
    const EQUAL: f64 = 1e-8;

    struct Window {
        method: Method,
        reference: Reference,
        factors: Vec<JointFactor>,
    }

    impl Window {
        fn new() -> Self {
            let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
            let base = &method.base;
            let value = |k: usize| 1.0 + (k * 7919 % 13) as f64;
            let parameters = base.kept.iter().enumerate().map(|(k, id)| (*id, value(k))).collect();
            let terms = |index: usize| {
                let others = base.grouping[index].iter().map(|of| (of.coefficient, of.id));
                std::iter::once((1.0, base.kept[index])).chain(others).collect::<Vec<_>>()
            };
            let terms: Vec<_> = (0..base.kept.len()).map(|index| (base.kept[index], terms(index))).collect();
            let last_link = last_link_shares(terms.iter().map(|(id, terms)| (*id, &terms[..])));
            let reference = Reference { run_id: 1, estimator: Estimator::Weighted, parameters, last_link };
            let factors = unpack(&analyse_window(&method, &cycle(3, 1200), None).factors).expect("factors");
            Self { method, reference, factors }
        }

        fn check(&self, change: impl Fn(usize, ParameterId, f64) -> f64) -> ProductionCheck {
            let changed = self.reference.parameters.iter().enumerate();
            let parameters = changed.map(|(k, (id, value))| (*id, value + change(k, *id, *value))).collect();
            let reference = Reference { parameters, ..self.reference.clone() };
            check_window(&self.method.columns, &self.factors, &reference).expect("the same columns")
        }
    }

    fn square(check: &ProductionCheck, joint: JointIndex) -> f64 {
        check.joints[joint.index()].rmsd.moving_rows.value.powi(2)
    }

    #[test]
    fn products_are_those_of_deviations_from_changed_parameters() {
        let window = Window::new();
        let usual = window.check(|_, _, _| 0.0);
        let joint = JointIndex::new(3);
        let friction = |id: ParameterId| matches!(id.kind, ParameterKind::Friction(_)) && id.joint == joint;
        let f1 = |id: ParameterId| id.kind == ParameterKind::Friction(FrictionTerm::F1);
        // one kilogram at (0.1, -0.2, 0.3) m of the last link, by its standard parameters
        let mut phi = vec![0.0; ParameterId::natural_order(&window.method.robot).len()];
        let (last, body) = (10 * (window.method.robot.joint_count() - 1), [1.0, 0.1, -0.2, 0.3]);
        phi[last..last + 4].copy_from_slice(&body);
        let load = window.method.base.group(&phi);
        let coulomb = window.check(|_, id, value| if friction(id) && f1(id) { -value } else { 0.0 });
        let viscous = window.check(|_, id, value| if friction(id) && !f1(id) { -value } else { 0.0 });
        let loaded = window.check(|k, _, _| -load[k]);
        let own = usual.evidence.iter().find(|of| of.joint == joint).expect("it moves");
        assert!((own.product(DEVIATION, DEVIATION) / square(&usual, joint) - 1.0).abs() < EQUAL);
        let one = |place: usize, size: f64| vec![(place, size)];
        let first = WorkDirection::Load(0).place();
        for (changed, along) in [
            (&coulomb, one(WorkDirection::Coulomb.place(), 1.0)),
            (&viscous, one(WorkDirection::Viscous.place(), 1.0)),
            (&loaded, body.iter().enumerate().map(|(k, size)| (first + k, *size)).collect()),
        ] {
            let mut expected = own.product(DEVIATION, DEVIATION);
            for (a, size) in &along {
                expected += 2.0 * size * own.product(*a, DEVIATION);
                expected += along.iter().map(|(b, other)| size * other * own.product(*a, *b)).sum::<f64>();
            }
            let found = square(changed, joint);
            assert!((found / expected - 1.0).abs() < EQUAL, "{found} {expected}");
            assert!((expected / square(&usual, joint) - 1.0).abs() > 1e-6, "it changes something");
        }
        // the sum of model torque and deviation is the measured torque
        let gain = WorkDirection::Gain.place();
        let measured =
            own.product(gain, gain) + 2.0 * own.product(gain, DEVIATION) + own.product(DEVIATION, DEVIATION);
        let rmsd = usual.joints[joint.index()].rmsd.moving_rows;
        assert!((measured.sqrt() / (rmsd.value / rmsd.relative) - 1.0).abs() < EQUAL);
        // a polynomial has no constant
        let offset = WorkDirection::Offset.place();
        assert!(own.product(offset, offset) <= 0.0);
    }

    #[test]
    fn a_log_is_the_mean_over_rows_of_windows_that_are_not_odd() {
        let of = |samples: usize, deviation: f64| {
            let mut products = [1.0; PRODUCTS];
            products[JointEvidence::index(DEVIATION, DEVIATION)] = deviation;
            vec![JointEvidence { joint: JointIndex::new(2), windows: 1, samples, products }]
        };
        let found = log_evidence(&[of(100, 1.0), of(300, 2.0), of(100, 90.0)]);
        let [own] = &found[..] else { panic!("one joint: {found:?}") };
        assert_eq!((own.joint.index(), own.windows, own.samples), (2, 2, 400));
        assert!((own.product(DEVIATION, DEVIATION) - 1.75).abs() < 1e-12);
        assert_eq!(log_evidence(&[]), vec![]);
    }
}
