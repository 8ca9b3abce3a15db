//! What the parameters and torque signals of the whole arm show: a load (`payload`), a torque signal that reads wrong
//! (`sensor`), torque of a joint that neither its model nor its signal's noise explains, and a change of the arm that nothing
//! explains (`accuracy`).
//!
//! Each run is compared with the robot's first runs ([`crate::detect::runs::arm`]). A run is out if the
//! likeliest cause is clear: a warning if it is plain or the run before shows it too, else worth knowing.

use jiff::Timestamp;

use crate::detect::episodes::episodes;
use crate::detect::load_message::load_message;
use crate::detect::runs::arm::baseline::{LEAST_NOISE_RATIO, LEAST_RMSD_RATIO};
use crate::detect::runs::arm::cause::{ArmCause, Load, SignalFault};
use crate::detect::runs::arm::{ArmEvidence, LEAST_GAIN, LEAST_POSITION_OFFSET};
use crate::detect::verdict::{MOST_ODDS, Verdict, Why};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Alternative, Anomaly, AnomalyKind, Severity};
use armwatch_model::robot::JointIndex;

/// Advantage of a cause over none, in units of chi², that no second test has to confirm.
const PLAIN: f64 = 1000.0;
/// The same of torque that no model explains: neither noise nor play comes by a test's chance.
const PLAIN_REST: f64 = 300.0;
/// Least advantage of a change that is not known, for a warning: seasons move parameters by some standard deviations.
const LEAST_UNKNOWN: f64 = 4000.0;

/// Anomalies of the arm and its torque signals. `faults` has what
/// [`faults`](crate::detect::runs::arm::faults) says of the evidence, `runs` key and start of each run.
pub(in crate::detect::runs) fn arm_changes(
    evidence: &[Option<ArmEvidence>],
    faults: &[Option<ArmCause>],
    joints: usize,
    runs: &[(i64, Timestamp)],
) -> Vec<Anomaly> {
    let verdicts = |least: f64, judge: &dyn Fn(ArmCause) -> Option<ArmFigure>| -> Vec<Verdict> {
        let mut before = false;
        let one = |(of, fault): (&Option<ArmEvidence>, &Option<ArmCause>)| match (of, fault) {
            (Some(of), Some(fault)) => {
                let figure = judge(*fault);
                // one odd test alone is worth knowing
                let is_rest = matches!(
                    fault,
                    ArmCause::TorqueSignal { fault: SignalFault::Noise(_), .. }
                        | ArmCause::NoiseOfAll(_)
                        | ArmCause::UnexplainedTorque { .. }
                );
                let plain = if is_rest { PLAIN_REST } else { PLAIN };
                let confirmed = std::mem::replace(&mut before, figure.is_some()) || of.advantage() >= plain;
                let confirmed = confirmed && of.advantage() >= least;
                figure.map_or(Verdict::Quiet, |figure| figure.verdict(of, fault, confirmed))
            }
            _ => Verdict::Unknown,
        };
        evidence.iter().zip(faults).map(one).collect()
    };
    let load = verdicts(0.0, &|cause| match cause {
        ArmCause::Load(load) => Some(of_load(&load)),
        _ => None,
    });
    let mut found = episodes(runs, None, AnomalyKind::Payload, Quantity::Load, load);
    let noise = verdicts(0.0, &|cause| match cause {
        ArmCause::NoiseOfAll(ratio) => Some(of_noise_of_all(ratio)),
        _ => None,
    });
    found.extend(episodes(runs, None, AnomalyKind::Sensor, Quantity::TorqueNoiseRatio, noise));
    for joint in (0..joints).map(JointIndex::new) {
        let signal = verdicts(0.0, &|cause| match cause {
            ArmCause::TorqueSignal { joint: of, fault } if of == joint => Some(of_signal(fault)),
            _ => None,
        });
        found.extend(episodes(runs, Some(joint), AnomalyKind::Sensor, Quantity::TorqueOffset, signal));
        let position = verdicts(0.0, &|cause| match cause {
            ArmCause::PositionSignal { joint: of, offset } if of == joint => Some(of_position(offset)),
            _ => None,
        });
        found.extend(episodes(runs, Some(joint), AnomalyKind::Sensor, Quantity::PositionOffset, position));
        let rest = verdicts(0.0, &|cause| match cause {
            ArmCause::UnexplainedTorque { joint: of, ratio } if of == joint => Some(of_rest(ratio)),
            _ => None,
        });
        found.extend(episodes(runs, Some(joint), AnomalyKind::Accuracy, Quantity::UnexplainedTorque, rest));
    }
    let unknown = verdicts(LEAST_UNKNOWN, &|cause| (cause == ArmCause::Unknown).then(of_unknown));
    found.extend(episodes(runs, None, AnomalyKind::Accuracy, UNKNOWN_CHANGE, unknown));
    found
}

/// Quantity of a change of no known cause.
pub(in crate::detect::runs) const UNKNOWN_CHANGE: Quantity = Quantity::InertialParameters;

struct ArmFigure {
    /// The quantity, if the cause decides which it is.
    quantity: Option<Quantity>,
    score: f64,
    threshold: f64,
    value: f64,
    baseline: f64,
    message: String,
}

impl ArmFigure {
    /// Of a change that no figure measures.
    fn without_value() -> Self {
        Self {
            quantity: None,
            score: 1.0,
            threshold: 1.0,
            value: f64::NAN,
            baseline: f64::NAN,
            message: String::new(),
        }
    }

    fn verdict(self, evidence: &ArmEvidence, fault: &ArmCause, is_confirmed: bool) -> Verdict {
        let (own, others): (Vec<_>, Vec<_>) =
            evidence.odds(fault).into_iter().partition(|(of, _)| of == fault);
        // a fault that continues although another cause is likelier now has no odds from this test
        let own = own.first().map(|(_, odds)| odds.min(MOST_ODDS)).filter(|odds| *odds >= 1.0);
        let others = others.into_iter().take(if own.is_some() { 3 } else { 0 });
        Verdict::Out {
            severity: if is_confirmed { Severity::Warning } else { Severity::Info },
            score: self.score,
            threshold: self.threshold,
            value: self.value,
            baseline: self.baseline,
            message: self.message,
            why: Why {
                quantity: self.quantity,
                onset: None,
                odds: own,
                alternatives: others
                    .map(|(cause, odds)| Alternative { cause: cause.words(), odds })
                    .collect(),
            },
        }
    }
}

fn of_load(load: &Load) -> ArmFigure {
    if !load.has_seen_mass() {
        return ArmFigure {
            message: "the arm's parameters have changed as a body at the last link changes them, more or less than in \
                      its first tests; these motions do not show its mass. Let it carry in tests what it carried in the \
                      first ones, or record the new tool as maintenance"
                .into(),
            ..ArmFigure::without_value()
        };
    }
    ArmFigure {
        quantity: None,
        score: load.mass.abs() / load.std_error,
        threshold: 5.0,
        value: load.mass,
        baseline: 0.0,
        message: load_message(
            load.mass,
            &format!("standard error {:.3} kg", load.std_error),
            Some((load.centre, "last link")),
        ),
    }
}

fn of_signal(fault: SignalFault) -> ArmFigure {
    match fault {
        SignalFault::Offset(torque) => ArmFigure {
            quantity: Some(Quantity::TorqueOffset),
            score: torque.abs(),
            threshold: 0.0,
            value: torque,
            baseline: 0.0,
            message: format!(
                "the torque signal has an offset of {torque:+.2} Nm beyond the usual; friction in both directions, the arm's \
                 parameters and the torque that they leave unexplained show it; check the zero of the torque sensor or of \
                 the motor current, and look for a cable, a hose or a seal that pulls to one side"
            ),
        },
        SignalFault::Noise(ratio) => ArmFigure {
            quantity: Some(Quantity::TorqueNoiseRatio),
            score: ratio,
            threshold: LEAST_NOISE_RATIO,
            value: ratio,
            baseline: 1.0,
            message: format!(
                "the torque signal has {ratio:.1} times the usual noise; check sensor, cable and shield"
            ),
        },
        SignalFault::Gain(part) => ArmFigure {
            quantity: Some(Quantity::TorqueGainRatio),
            score: part.abs(),
            threshold: LEAST_GAIN,
            value: 1.0 + part,
            baseline: 1.0,
            message: format!(
                "the torque signal reads {:.1} % {} than in the first tests: the arm's parameters have changed as that \
                 would change them; check the torque sensor's calibration or the motor's torque constant",
                100.0 * part.abs(),
                if part > 0.0 { "more" } else { "less" }
            ),
        },
    }
}

fn of_noise_of_all(ratio: f64) -> ArmFigure {
    ArmFigure {
        quantity: None,
        score: ratio,
        threshold: LEAST_NOISE_RATIO,
        value: ratio,
        baseline: 1.0,
        message: format!(
            "the torque signals of most joints have {ratio:.1} times the usual noise on average; check what they share: the \
             supply, the ground, cables next to power lines, the settings of the recording"
        ),
    }
}

fn of_rest(ratio: f64) -> ArmFigure {
    ArmFigure {
        quantity: None,
        score: ratio,
        threshold: LEAST_RMSD_RATIO,
        value: ratio,
        baseline: 1.0,
        message: format!(
            "the model leaves {ratio:.1} times as much of this joint's torque unexplained as usual, which noise of the signal does \
             not account for; look for play in gear and coupling, a loose or damaged part, something that rubs"
        ),
    }
}

fn of_position(offset: f64) -> ArmFigure {
    ArmFigure {
        quantity: None,
        score: offset.abs(),
        threshold: LEAST_POSITION_OFFSET,
        value: offset,
        baseline: 0.0,
        message: format!(
            "the position reads {:.4} rad (m) {} than in the first tests: gravity and inertia fit an arm in another \
             position than it reports; check the zero position (mastering) and the encoder's coupling",
            offset.abs(),
            if offset > 0.0 { "more" } else { "less" }
        ),
    }
}

fn of_unknown() -> ArmFigure {
    ArmFigure {
        message: "the arm's inertial parameters have changed, and neither a load nor one torque signal explains it; \
                  check the mounting, the zero positions and the robot's description"
            .into(),
        ..ArmFigure::without_value()
    }
}
