//! The table of scenarios: possible events of a fleet's robots.

use armwatch_model::anomaly::AnomalyKind;

/// The event of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scenario {
    /// No event.
    Healthy,
    /// The ambient temperature changes by some kelvin from one day to the next, several times.
    Hall,
    /// The ambient temperature follows the seasons by several kelvin.
    Season,
    /// The robot rests over weekends and works on other days, so that tests begin cold or half warm.
    Weekend,
    /// Tests of three to seven cycles.
    ShortTests,
    /// Tests of 18 to 24 cycles.
    LongTests,
    /// A gearbox is replaced, with a maintenance entry, and is run in.
    Repair,
    /// Friction of a joint grows from test to test.
    Wear,
    /// Friction of a joint grows with every test by a fraction of its value, up to an increase of 60 %.
    WearByTest,
    /// Friction of a joint jumps between two tests.
    StepBetween,
    /// Friction of a joint jumps inside a test.
    StepInside,
    /// Friction of a joint jumps inside one of the first tests.
    StepInBaseline,
    /// The tool differs from that of the first tests.
    Payload,
    /// Friction of a joint varies from cycle to cycle.
    Jitter,
    /// The slow time constant of a joint's warm-up changes.
    WarmUp,
    /// A torque channel gets an offset.
    TorqueOffset,
    /// A torque channel gets another gain.
    TorqueGain,
    /// A torque channel gets more noise.
    TorqueNoise,
    /// The zero position of a joint is lost by some degrees.
    ZeroPosition,
    /// An external force pushes a joint for some seconds of one cycle.
    Contact,
    /// Friction of two joints varies from cycle to cycle, in the same cycles.
    CoupledJitter,
    /// A gear has backlash.
    Backlash,
    /// A torque channel keeps the first value of each recording.
    StuckTorque,
    /// A torque channel saturates at a fraction of its true range.
    SaturatedTorque,
    /// A torque channel is delayed.
    LateTorque,
    /// Short checks of one cycle, and a whole test after every three of them.
    MixedTests,
    /// The slow time constant of the warm-up of all joints changes.
    Lubricant,
    /// The Coulomb part of a joint's friction grows with every test.
    WearCoulomb,
    /// The part that depends on speed grows with every test.
    WearViscous,
    /// The constant and the linear part grow, the curvature does not.
    WearLinear,
    /// The ambient temperature follows the seasons from 5 to 35 °C.
    WideSeason,
    /// Tests carry no tool, a light one and a heavy one in turn, from the first test.
    ToolPlan,
    /// Tests are driven at several speeds and recorded at several rates.
    Override,
    /// Friction of each joint differs from test to test by more than usual.
    DayScatter,
    /// A ripple of a joint's torque grows with every test.
    Ripple,
}

/// The ways to simulate a scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Roads {
    /// Simulates test results.
    Figures,
    /// Simulates exports.
    Exports,
    /// Both.
    Both,
}

/// One row of the table of scenarios.
struct ScenarioRow {
    scenario: Scenario,
    name: &'static str,
    kind: Option<AnomalyKind>,
    size: &'static str,
    roads: Roads,
}

/// Unit text for wear of a part of friction.
const PART_BY_TEST: &str = "rise of the part with every test, fraction";

const ROWS: [ScenarioRow; 35] = {
    const fn row(
        scenario: Scenario,
        name: &'static str,
        kind: Option<AnomalyKind>,
        size: &'static str,
        roads: Roads,
    ) -> ScenarioRow {
        ScenarioRow { scenario, name, kind, size, roads }
    }
    use AnomalyKind::{Accuracy, Drift, Oscillation, Payload, Sensor, Step, Thermal};
    use Roads::{Both, Exports, Figures};
    [
        row(Scenario::Healthy, "healthy", None, "", Both),
        row(Scenario::Hall, "hall", None, "largest change, K", Both),
        row(Scenario::Season, "season", None, "amplitude, K", Both),
        row(Scenario::Weekend, "weekend", None, "", Figures),
        row(Scenario::ShortTests, "short-tests", None, "", Both),
        row(Scenario::LongTests, "long-tests", None, "", Both),
        row(Scenario::Repair, "repair", None, "friction of the new gearbox, fraction of the old", Figures),
        row(Scenario::Wear, "wear", Some(Drift), "rise of friction at the end, fraction", Figures),
        row(
            Scenario::WearByTest,
            "wear-by-test",
            Some(Drift),
            "rise of friction with every test, fraction",
            Both,
        ),
        row(Scenario::StepBetween, "step-between", Some(Step), "jump of friction, fraction", Both),
        row(Scenario::StepInside, "step-inside", Some(Step), "jump of friction, fraction", Both),
        row(Scenario::StepInBaseline, "step-in-baseline", Some(Step), "jump of friction, fraction", Both),
        row(Scenario::Payload, "payload", Some(Payload), "mass, kg", Both),
        row(Scenario::Jitter, "jitter", Some(Oscillation), "standard deviation, fraction of friction", Both),
        row(Scenario::WarmUp, "warm-up", Some(Thermal), "slow time constant, fraction of the old", Both),
        row(
            Scenario::TorqueOffset,
            "torque-offset",
            Some(Sensor),
            "offset, standard deviations of the channel's noise",
            Both,
        ),
        row(Scenario::TorqueGain, "torque-gain", Some(Sensor), "change of gain, fraction", Both),
        row(Scenario::TorqueNoise, "torque-noise", Some(Sensor), "noise, multiple of the old", Both),
        row(Scenario::ZeroPosition, "zero-position", Some(Sensor), "error, rad", Both),
        row(
            Scenario::Contact,
            "contact",
            Some(Accuracy),
            "push over the cycle, RMS, fraction of the joint's torque",
            Both,
        ),
        row(
            Scenario::CoupledJitter,
            "coupled-jitter",
            Some(Oscillation),
            "standard deviation of the first joint, fraction of friction",
            Figures,
        ),
        row(Scenario::Backlash, "backlash", Some(Accuracy), "play at the joint, rad", Exports),
        row(Scenario::StuckTorque, "stuck-torque", Some(Sensor), "", Exports),
        row(
            Scenario::SaturatedTorque,
            "saturated-torque",
            Some(Sensor),
            "largest value, fraction of the largest torque",
            Exports,
        ),
        row(Scenario::LateTorque, "late-torque", Some(Sensor), "delay, s", Exports),
        row(Scenario::MixedTests, "mixed-tests", None, "", Both),
        row(
            Scenario::Lubricant,
            "lubricant",
            Some(Thermal),
            "slow time constants, fraction of the old",
            Both,
        ),
        row(Scenario::WearCoulomb, "wear-coulomb", Some(Drift), PART_BY_TEST, Exports),
        row(Scenario::WearViscous, "wear-viscous", Some(Drift), PART_BY_TEST, Exports),
        row(Scenario::WearLinear, "wear-linear", Some(Drift), PART_BY_TEST, Exports),
        row(Scenario::WideSeason, "wide-season", None, "amplitude, K", Both),
        row(Scenario::ToolPlan, "tool-plan", None, "heaviest tool, kg", Both),
        row(Scenario::Override, "override", None, "lowest speed, fraction of the usual", Exports),
        row(Scenario::DayScatter, "day-scatter", None, "standard deviation, fraction of friction", Both),
        row(
            Scenario::Ripple,
            "ripple",
            Some(Accuracy),
            "rise of the amplitude with every test, fraction of Coulomb friction",
            Exports,
        ),
    ]
};

impl Scenario {
    /// All scenarios. A robot's random draws depend on the index of its scenario.
    pub const ALL: [Self; ROWS.len()] = {
        let mut all = [Self::Healthy; ROWS.len()];
        let mut at = 0;
        while at < all.len() {
            all[at] = ROWS[at].scenario;
            at += 1;
        }
        all
    };

    fn row(self) -> &'static ScenarioRow {
        // the table has a row for each scenario; a test checks that
        ROWS.iter().find(|row| row.scenario == self).unwrap_or(&ROWS[0])
    }

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// The kind of the right alarm; `None` if any alarm is false.
    pub fn kind(self) -> Option<AnomalyKind> {
        self.row().kind
    }

    /// Returns true if test `number`, from 0, is a short check.
    pub fn is_check(self, number: usize) -> bool {
        self == Self::MixedTests && number % 4 != 3
    }

    /// Fraction of the heaviest tool that test `number`, from 0, carries if tools change in turn.
    pub fn tool(self, number: usize) -> f64 {
        if self == Self::ToolPlan { [0.0, 0.4, 1.0][number % 3] } else { 0.0 }
    }

    /// Returns true if it can be simulated as test results.
    pub fn has_figures(self) -> bool {
        self.row().roads != Roads::Exports
    }

    /// Returns true if it can be simulated as exports.
    pub fn has_exports(self) -> bool {
        self.row().roads != Roads::Figures
    }

    /// Meaning of the event's drawn size, with its unit; empty if there is none.
    pub fn size(self) -> &'static str {
        self.row().size
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scenario_has_a_row_of_its_own() {
        for (scenario, row) in Scenario::ALL.into_iter().zip(&ROWS) {
            assert_eq!(scenario.name(), row.name);
        }
        let mut names: Vec<&str> = Scenario::ALL.map(Scenario::name).to_vec();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Scenario::ALL.len());
    }
}
