//! Tests of descriptions against torques with known truth.

use super::alternatives::{alternatives, lowest};
use super::delay::torque_delays;
use super::description::{DescriptionTest, JudgedRows, test_description};
use super::friction_shapes::friction_shapes;
use super::numbers::{DescribedNumber, PlaceNumber};
use crate::analyse::Method;
use crate::identify::cycle::identify_factors;
use crate::identify::filtered_columns::{FilteredColumn, filtered_coulomb_columns};
use crate::identify::joint_factors::{embedded, factor_cycle, used_for_identification};
use crate::identify::verify::torque_rmsd;
use crate::signal::filter::{FilteredSignals, filter_signals};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{Estimator, Identification, RmsdScope};
use armwatch_model::robot::{DhParameters, JointGeometry, JointIndex, Robot};
use armwatch_model::run::{Samples, Stage};
use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
use armwatch_testing::er3a;

/// Recording that differs from the model only by noise; the torque noise is a tenth of the usual.
fn recording(robot: &Robot, seed: u64) -> Samples {
    let settings = ExactSettings { seed, torque_noise_scale: 0.1, ..ExactSettings::default() };
    record_excitation(robot, &settings).expect("a recording")
}

/// Recording with the model of a description, without findings.
struct Explained {
    method: Method,
    filtered: FilteredSignals,
    filtered_coulomb_columns: Vec<FilteredColumn>,
    rows: Vec<usize>,
    identified: Identification,
    noise: Vec<f64>,
    shapes: Vec<Vec<Vec<f64>>>,
}

impl Explained {
    fn new(described: &Robot, samples: &Samples) -> Self {
        let method = Method::new(described.clone(), AnalysisSettings::default()).expect("base parameters");
        let filtered = filter_signals(samples, 12.0).expect("conditions");
        let (columns, kept) = (&method.columns, &method.base.kept_columns);
        let filtered_coulomb_columns = filtered_coulomb_columns(described, &filtered);
        let factored = factor_cycle(described, columns, kept, &filtered, &filtered_coulomb_columns, samples);
        let factors = embedded(
            columns,
            factored.factors.iter().filter(|of| used_for_identification(of.stage, of.motion)),
        );
        let shares = vec![filtered.independent_fraction(); described.joint_count()];
        let identified =
            identify_factors(&method.base.kept, &factors, &shares, Estimator::Ordinary).expect("parameters");
        let theta: Vec<f64> = identified.parameters.iter().map(|p| p.value).collect();
        let noise = torque_rmsd(columns, &factored.factors, &theta)
            .iter()
            .filter(|of| of.scope == RmsdScope::Stage(Stage::Excitation))
            .map(|of| of.moving_rows.value)
            .collect();
        let rows = filtered.usable.iter().flat_map(Clone::clone);
        let rows = rows.filter(|&row| samples.stage[row] == Stage::Excitation).collect();
        let shapes = friction_shapes(&filtered);
        Self { method, filtered, filtered_coulomb_columns, rows, identified, noise, shapes }
    }

    fn judged_rows(&self) -> JudgedRows<'_> {
        JudgedRows::new(&self.filtered, &self.rows, self.noise.clone(), &self.shapes, &[])
    }

    fn test(&self) -> DescriptionTest {
        let kept = &self.method.base.kept_columns;
        test_description(
            &self.method.robot,
            kept,
            &self.identified,
            &self.judged_rows(),
            &self.filtered_coulomb_columns,
        )
        .expect("rows enough")
    }
}

#[test]
fn a_length_that_is_a_little_off_is_found_with_its_size() {
    let robot = er3a();
    let length = DescribedNumber::Place(JointIndex::new(2), PlaceNumber::A);
    // 8 mm of 270: the slope at the wrong length costs the square of 3 %
    const OFF: f64 = 0.008;
    let samples = recording(&robot, 1);
    let test = Explained::new(&length.changed(&robot, OFF), &samples).test();
    let score = test.scores.iter().find(|score| score.number == length).expect("the length shows");
    assert!((score.change + OFF).abs() < 4.0 * score.std_error + 0.06 * OFF, "{score:?}");
    assert!(score.change.abs() > 10.0 * score.std_error, "{score:?}");
    let right = Explained::new(&robot, &samples).test();
    assert!(test.share > 4.0 * right.share && test.f > 4.0 * right.f, "{test:?} {right:?}");
}

#[test]
fn numbers_of_the_base_are_absorbed() {
    // the position of the base and its rotation about a vertical axis do not change the torque
    let test = Explained::new(&er3a(), &recording(&er3a(), 2)).test();
    for place in [PlaceNumber::A, PlaceNumber::D, PlaceNumber::ThetaOffset] {
        let number = DescribedNumber::Place(JointIndex::new(0), place);
        assert!(test.absorbed.contains(&number), "{number}: {:?}", test.absorbed);
    }
}

#[test]
fn a_mounting_that_is_wrong_is_named() {
    let samples = recording(&er3a(), 3);
    let described = Robot { gravity: -er3a().gravity, ..er3a() };
    let explained = Explained::new(&described, &samples);
    let best = alternatives(&described, &explained.judged_rows(), &explained.test()).change.expect("one");
    assert!(best.words.starts_with("gravity_m_s2 = [0.00, 0.00, -9.81]"), "{best:?}");
    assert!(best.residual_ratio < 0.05, "{best:?}");
    // no change explains a right description's torques much better
    let explained = Explained::new(&er3a(), &samples);
    let best = alternatives(&er3a(), &explained.judged_rows(), &explained.test()).change.expect("one");
    assert!(best.residual_ratio > 0.9, "{best:?}");
}

#[test]
fn late_torques_are_found_with_their_delay() {
    let mut samples = recording(&er3a(), 4);
    let delays = |samples: &Samples, shaped: bool| {
        let explained = Explained::new(&er3a(), samples);
        let (columns, kept) = (&explained.method.columns, &explained.method.base.kept_columns);
        let shapes = if shaped { &explained.shapes[..] } else { &[] };
        let channels = (&explained.filtered, &explained.filtered_coulomb_columns[..]);
        torque_delays(&er3a(), columns, kept, channels, &explained.rows, shapes).expect("rows enough")
    };
    // error of the parabola between steps of 10 ms, and noise
    const WITHIN: f64 = 0.003;
    for shaped in [false, true] {
        let found = delays(&recording(&er3a(), 4), shaped);
        assert!(found.delay.abs() < WITHIN && found.judged == 6, "{found:?}");
    }
    // 100 Hz: three rows later
    for torque in &mut samples.torque {
        torque.rotate_right(3);
    }
    for shaped in [false, true] {
        let found = delays(&samples, shaped);
        assert!((found.delay - 0.03).abs() < WITHIN && found.residual_ratio < 0.3, "{found:?}");
        assert_eq!(found.joints.len(), 6);
        assert!(found.joints.iter().all(|of| (of.delay - 0.03).abs() < WITHIN), "{found:?}");
    }
}

#[test]
fn a_changed_number_is_changed_in_every_convention() {
    let rows: Vec<DhParameters> =
        er3a().joints.iter().map(|joint| joint.geometry.dh_row().expect("a table")).collect();
    let mut standard = er3a();
    let (places, _) = JointGeometry::standard_dh(&rows);
    standard.joints.iter_mut().zip(places).for_each(|(joint, place)| joint.geometry = place);
    for robot in [er3a(), standard] {
        for number in DescribedNumber::all(&robot) {
            let (DescribedNumber::Place(..) | DescribedNumber::Gravity(_)) = number else { continue };
            let changed = number.changed(&robot, 0.25);
            let (before, after) =
                (number.value(&robot).expect("a value"), number.value(&changed).expect("a value"));
            assert!((after - before - 0.25).abs() < 1e-12, "{number}");
            let back = number.changed(&changed, -0.25);
            let off = |(a, b): (&armwatch_model::robot::Joint, &armwatch_model::robot::Joint)| {
                (a.geometry.placement().translation - b.geometry.placement().translation).norm()
                    + (a.geometry.placement().rotation - b.geometry.placement().rotation).norm()
            };
            assert!(robot.joints.iter().zip(&back.joints).map(off).fold(0.0, f64::max) < 1e-12, "{number}");
        }
    }
}

#[test]
fn a_number_far_from_the_change_that_is_asked_for_is_settled() {
    // as nonlinear as a length that is wrong by half: the first change is a quarter of it
    let left = |change: f64| 1.0 + (change - 0.4).powi(2) * (1.0 + change);
    let (change, least) = lowest(left, left(0.0), 0.1);
    assert!((change - 0.4).abs() < 0.02 && (least - 1.0).abs() < 1e-3, "{change} {least}");
}
