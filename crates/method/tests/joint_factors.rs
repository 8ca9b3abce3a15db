//! Tests of joints' triangular factors against their rows.

#![expect(clippy::expect_used, reason = "functions that tests call")]

use armwatch_method::analyse::Method;
use armwatch_method::identify::cycle::identify_factors;
use armwatch_method::identify::filtered_columns::filtered_coulomb_columns;
use armwatch_method::identify::joint_factors::{
    FactorColumns, Factored, JointFactor, embedded, factor_cycle, joined, pack, unpack,
    used_for_identification,
};
use armwatch_method::identify::verify::{StageSums, torque_rmsd, warming_contrast};
use armwatch_method::pooled::pool::PooledFactors;
use armwatch_method::signal::filter::filter_signals;
use armwatch_model::analysis::Estimator;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::ParameterId;
use armwatch_model::run::Cycle;
use armwatch_testing::cycle::cycle;
use armwatch_testing::direct::{Direct, assert_equal, raw_parameters};
use armwatch_testing::er3a;

/// Tolerance for the rounding of a QR of some thousand rows, times the condition of the problem.
const EQUAL: f64 = 1e-9;

fn method() -> Method {
    Method::new(er3a(), AnalysisSettings::default()).expect("base parameters")
}

/// Factors and parameters of a cycle without checks, which its synthetic torque would not pass.
fn unjudged(method: &Method, cycle: &Cycle) -> (Factored, Vec<f64>) {
    let c = filter_signals(&cycle.samples, 12.0).expect("long enough");
    let (columns, kept) = (&method.columns, &method.base.kept_columns);
    let filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &c);
    let factored = factor_cycle(&method.robot, columns, kept, &c, &filtered_coulomb_columns, &cycle.samples);
    let factors =
        embedded(columns, factored.factors.iter().filter(|of| used_for_identification(of.stage, of.motion)));
    let shares = [c.independent_fraction(); 6];
    let found = identify_factors(&method.base.kept, &factors, &shares, Estimator::Ordinary);
    let found = found.expect("parameters");
    (factored, found.parameters.iter().map(|p| p.value).collect())
}

#[test]
fn a_joint_has_the_columns_of_its_own_and_the_outer_links() {
    let method = method();
    for (j, of_joint) in method.columns.by_joint().iter().enumerate() {
        assert!(of_joint.iter().all(|id| id.joint.index() >= j), "{of_joint:?}");
        let own = of_joint.iter().filter(|id| id.joint.index() == j && id.name().starts_with('f'));
        assert_eq!(own.count(), 4);
        let foreign = |id: &&ParameterId| id.joint.index() != j && id.name().starts_with('f');
        assert_eq!(of_joint.iter().filter(foreign).count(), 0);
    }
    // turning about the horizontal axes of joints 2 and 3 has no moment about the vertical joint 1
    let missing = |name: &str| method.columns.by_joint()[0].iter().all(|id| id.to_string() != name);
    assert!(missing("J2_Izz") && missing("J3_Izz"));
    let widths: Vec<usize> = method.columns.by_joint().iter().map(Vec::len).collect();
    assert_eq!(widths, [38, 39, 33, 26, 19, 12]);
}

#[test]
fn identification_from_factors_is_that_from_the_rows() {
    let method = method();
    let cycle = cycle(1, 2000);
    let (_, theta) = unjudged(&method, &cycle);
    assert_equal(&theta, &raw_parameters(&method, &[&cycle]));
}

#[test]
fn cycles_joined_from_what_is_stored_are_the_problem_of_all_their_rows() {
    let method = method();
    let cycles = [cycle(1, 1500), cycle(2, 1000)];
    let mut union: Option<PooledFactors> = None;
    for cycle in &cycles {
        let (stored, _) = pack(&method.columns, &unjudged(&method, cycle).0.factors);
        let columns = FactorColumns::of_stored(&stored.columns);
        let union = union.get_or_insert_with(|| PooledFactors::new(columns.clone()));
        union.add(&columns, &unpack(&stored).expect("sound"), &[0.24; 6]).expect("same columns");
    }
    let found = union.expect("cycles").identify().expect("parameters");
    let value = |id: &ParameterId| found.parameters.iter().find(|p| p.id == *id).expect("kept").value;
    let in_order: Vec<f64> = method.base.kept.iter().map(value).collect();
    assert_equal(&in_order, &raw_parameters(&method, &[&cycles[0], &cycles[1]]));
}

#[test]
fn rmsd_from_factors_is_that_of_inverse_dynamics_over_the_rows() {
    let method = method();
    let cycle = cycle(1, 2000);
    let (factored, theta) = unjudged(&method, &cycle);
    let direct = Direct::new(&method, &cycle, &theta);
    direct.assert_verification(&torque_rmsd(&method.columns, &factored.factors, &theta));
    let contrast = warming_contrast(&method.columns, &factored, &theta);
    // rows 1400 to 1999 are the warming stage; without the last six, a third has 198 rows
    assert_eq!(contrast.len(), 6);
    for found in &contrast {
        let j = found.joint.index();
        direct.assert_rmsd(j, found.start.all_rows, |row| (1400..1598).contains(&row));
        direct.assert_rmsd(j, found.end.all_rows, |row| row >= 1796);
    }
}

#[test]
fn joined_factors_are_those_of_all_rows_of_their_cycles() {
    let method = method();
    let cycles = [cycle(1, 1500), cycle(2, 1000), cycle(3, 700)];
    let of_each: Vec<Vec<JointFactor>> =
        cycles.iter().map(|cycle| unjudged(&method, cycle).0.factors).collect();
    let (_, theta) = unjudged(&method, &cycles[0]);
    // two at once and then the third, as a production log is joined part by part
    let first = joined(&method.columns, &of_each[..2].concat());
    let all = joined(&method.columns, &[first, of_each[2].clone()].concat());
    let parts = (all.iter()).map(|of| (of.joint, of.stage as usize, of.motion as usize));
    assert!(parts.is_sorted(), "one of each, in order");
    assert_eq!(
        all.iter().map(|of| of.factor.rows()).sum::<usize>(),
        of_each.iter().flatten().map(|of| of.factor.rows()).sum::<usize>()
    );
    // the other method: sums over the cycles, whose factors are compared with their rows above
    let mut sums = StageSums::default();
    of_each.iter().for_each(|factors| sums.add(&method.columns, factors, &theta));
    for (found, expected) in torque_rmsd(&method.columns, &all, &theta).iter().zip(sums.rmsd()) {
        assert_eq!((found.joint, found.scope), (expected.joint, expected.scope));
        for (found, expected) in
            [(found.all_rows, expected.all_rows), (found.moving_rows, expected.moving_rows)]
        {
            assert_eq!(found.samples, expected.samples);
            assert!((found.value - expected.value).abs() <= EQUAL * expected.value);
            assert!((found.relative - expected.relative).abs() <= EQUAL * expected.relative);
        }
    }
}

#[test]
fn columns_of_another_description_are_refused() {
    let method = method();
    let mut narrower: Vec<Vec<ParameterId>> = method.columns.by_joint().to_vec();
    narrower[5].pop();
    let narrower = FactorColumns::of_stored(&narrower.into());
    let mut union = PooledFactors::new(method.columns.clone());
    let error = union.add(&narrower, &[], &[1.0; 6]).expect_err("other columns");
    assert!(error.to_string().contains("different parameters"), "{error}");
    let error = method.columns.theta([]).expect_err("no values");
    assert!(error.to_string().contains("need parameter J1_Izz"), "{error}");
}
