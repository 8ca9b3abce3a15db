use jiff::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::cause::WorkCause;
use super::odds::Asked;
use super::{LogCauses, causes};
use armwatch_model::analysis::work_evidence::{DEVIATION, JointEvidence, PRODUCTS, WorkDirection};
use armwatch_model::anomaly::ProductionSummary;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::JointIndex;

const JOINTS: usize = 6;

/// Effect on a joint's torque: the size of each direction.
type Effect<'a> = &'a dyn Fn(usize) -> [f64; DEVIATION];

/// A log of random torques. The joints' torques are some ten Nm, and the test leaves 2 % unexplained.
fn log(seed: u64, effect: Effect<'_>) -> ProductionSummary {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = move || rng.sample::<f64, _>(StandardNormal);
    let warmth = (0.1 * draw(), 0.3 * draw());
    let joint = |j: usize| {
        let mut products = [0.0; PRODUCTS];
        let sizes = effect(j);
        let own = (warmth.0 + 0.03 * draw(), warmth.1 + 0.08 * draw());
        for _ in 0..2000 {
            let (sign, speed) = (draw().signum(), draw());
            // outer joints carry less of a load
            let reach = 1.0 - 0.15 * j as f64;
            let load = [3.0 * draw() * reach, 9.0 * draw(), 9.0 * draw(), 9.0 * draw()];
            let mut along = [0.0; DEVIATION + 1];
            along[0] = 2.0 * sign;
            along[1] = 3.0 * speed;
            along[2] = 8.0 * draw() + along[0] + along[1];
            along[3] = 1.0;
            along[4..8].copy_from_slice(&load);
            let effect: f64 = along.iter().zip(sizes).map(|(torque, size)| torque * size).sum();
            along[DEVIATION] = effect + own.0 * along[0] + own.1 * along[1] + 0.2 * draw();
            for (a, of_a) in along.iter().enumerate() {
                for (b, of_b) in along.iter().enumerate().skip(a) {
                    products[JointEvidence::index(a, b)] += of_a * of_b / 2000.0;
                }
            }
        }
        JointEvidence { joint: JointIndex::new(j), windows: 30, samples: 60_000, products }
    };
    let evidence = (0..JOINTS).map(joint).collect();
    ProductionSummary {
        run_id: 1,
        started_at: Timestamp::UNIX_EPOCH,
        reference_run_id: 2,
        joints: Vec::new(),
        evidence,
    }
}

fn found(seed: u64, effect: Effect<'_>) -> LogCauses {
    let found = causes(&[log(seed, effect)], &DetectSettings::default()).remove(0);
    found.expect("evidence")
}

fn of(direction: WorkDirection, size: f64) -> [f64; DEVIATION] {
    let mut sizes = [0.0; DEVIATION];
    sizes[direction.place()] = size;
    sizes
}

#[test]
fn warmth_of_the_arm_is_no_cause() {
    for seed in 0..20 {
        let found = found(seed, &|_| [0.0; DEVIATION]);
        assert_eq!((found.load(), found.cause()), (None, WorkCause::None), "{seed}: {found:?}");
    }
}

#[test]
fn each_cause_is_named_with_its_joint_and_size() {
    for seed in 20..26 {
        let at = |joint: usize| JointIndex::new(joint);
        let joint = usize::try_from(seed).expect("small") % JOINTS;
        let one = |direction: WorkDirection, size: f64| {
            found(seed, &|j| if j == joint { of(direction, size) } else { [0.0; DEVIATION] })
        };
        let worn = found(seed, &|j| match j == joint {
            true => [0.6, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            false => [0.0; DEVIATION],
        });
        assert!(
            matches!(worn.cause(), WorkCause::Friction(of, size) if of == at(joint) && (size - 0.6).abs() < 0.15),
            "{worn:?}"
        );
        let gain = one(WorkDirection::Gain, 0.08);
        assert!(
            matches!(gain.cause(), WorkCause::Gain(of, size) if of == at(joint) && (size - 0.08).abs() < 0.02),
            "{gain:?}"
        );
        let offset = one(WorkDirection::Offset, -1.0);
        assert!(
            matches!(offset.cause(), WorkCause::Offset(of, size) if of == at(joint) && (size + 1.0).abs() < 0.1),
            "{offset:?}"
        );
        for found in [worn, gain, offset] {
            let why = found.why(Asked::Cause);
            assert!(why.odds.is_some_and(|odds| odds > 100.0) && why.alternatives.len() == 3, "{why:?}");
            assert_eq!(found.load(), None);
        }
    }
}

#[test]
fn a_load_is_one_cause_of_the_arm_and_hides_no_other() {
    for seed in 30..36 {
        let load = |also: Option<usize>| {
            found(seed, &|j| {
                let mut sizes = [0.0, 0.0, 0.0, 0.0, 0.8, 0.01, 0.0, 0.05];
                sizes[WorkDirection::Gain.place()] = if also == Some(j) { 0.08 } else { 0.0 };
                sizes
            })
        };
        let alone = load(None);
        let mass = alone.load().expect("a load").mass;
        assert!((mass / 0.8 - 1.0).abs() < 0.15 && alone.cause() == WorkCause::None, "{alone:?}");
        assert!(alone.joints.iter().all(|of| of.left < 0.05), "{alone:?}");
        let both = load(Some(2));
        assert!(both.load().is_some(), "{both:?}");
        assert!(matches!(both.cause(), WorkCause::Gain(joint, _) if joint.index() == 2), "{both:?}");
    }
}

#[test]
fn a_rarer_alarm_needs_more_evidence_and_a_log_without_any_has_no_causes() {
    let at = |rate: f64| {
        let settings = DetectSettings { false_alarms_per_robot_year: rate, ..DetectSettings::default() };
        causes(&[log(1, &|_| [0.0; DEVIATION])], &settings).remove(0).expect("evidence").least
    };
    assert!((at(0.2) - at(20.0) - 2.0 * 100.0_f64.ln()).abs() < 1e-9);
    let without = ProductionSummary { evidence: Vec::new(), ..log(1, &|_| [0.0; DEVIATION]) };
    assert_eq!(causes(&[without], &DetectSettings::default()), [None]);
}

#[test]
fn a_joint_without_torque_hides_no_cause_of_the_others() {
    let gain = |j: usize| if j == 1 { of(WorkDirection::Gain, 0.08) } else { [0.0; DEVIATION] };
    let mut dead = log(40, &gain);
    dead.evidence[JOINTS - 1].products = [0.0; PRODUCTS];
    let found = causes(&[dead], &DetectSettings::default()).remove(0).expect("evidence");
    assert!(matches!(found.cause(), WorkCause::Gain(joint, _) if joint.index() == 1), "{found:?}");
}
