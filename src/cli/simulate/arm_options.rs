//! Arguments for properties of the simulated arm, its controller and its signals beyond their description.

use clap::Args;

use crate::cli::context::CliError;
use armwatch_simulate::SimulationSettings;
use armwatch_simulate::arm::friction::RippleOrder;
use armwatch_simulate::arm::hall::{HallSettings, WorkingHours};
use armwatch_simulate::arm::unit::UnitSpread;
use armwatch_simulate::run::recording::{Heating, SensorSettings};
use armwatch_simulate::run::servo::ServoSettings;

/// Ratio of the spread of link parameters to the spread of friction.
const BODIES_OF_FRICTION: f64 = 0.05;

#[derive(Debug, Args)]
pub(in crate::cli) struct ArmOptions {
    /// Lag of joints at constant speed behind their plan, s, such as 0.02: a critically damped servo of second order
    #[arg(help_heading = "Controller", long, default_value_t = 0.0, value_name = "S")]
    following_lag_s: f64,
    /// Delay from plan and stage signals to the motion, s, such as 0.008
    #[arg(help_heading = "Controller", long, default_value_t = 0.0, value_name = "S")]
    command_delay_s: f64,
    /// Override: speed of all motions as a part of the planned one, above 0 to 1, such as 0.5
    #[arg(help_heading = "Controller", long, default_value_t = 1.0, value_name = "PART")]
    speed: f64,
    /// Standard deviation of position signals, rad (m) [default: 2e-5]
    #[arg(help_heading = "Signals", long, value_name = "RAD")]
    position_noise: Option<f64>,
    /// Resolution of position signals, rad (m); 0 for none [default: 5e-6]
    #[arg(help_heading = "Signals", long, value_name = "RAD")]
    position_step: Option<f64>,
    /// Standard deviation of velocity signals, rad/s (m/s) [default: 2e-3]
    #[arg(help_heading = "Signals", long, value_name = "RAD_S")]
    velocity_noise: Option<f64>,
    /// Resolution of velocity signals, rad/s (m/s); 0 for none [default: 5e-4]
    #[arg(help_heading = "Signals", long, value_name = "RAD_S")]
    velocity_step: Option<f64>,
    /// Resolution of torque signals, Nm (N); 0 for none
    #[arg(help_heading = "Signals", long, default_value_t = 0.0, value_name = "NM")]
    torque_step: f64,
    /// Correlation of the torque noise from row to row, 0 to below 1: an autoregression of first order; 0 is white
    /// noise
    #[arg(help_heading = "Signals", long, default_value_t = 0.0, value_name = "FRACTION")]
    torque_noise_correlation: f64,
    /// Hum of the torque signals: frequency, Hz, and amplitude, Nm (N), such as 50=0.2; each joint has its own phase.
    /// A frequency above half of --rate-hz appears as a lower one
    #[arg(help_heading = "Signals", long, value_name = "HZ=NM", value_parser = pair)]
    torque_hum: Option<[f64; 2]>,
    /// Ripples of the torque, instead of those of the friction shape: waves per turn of the motor and amplitude as a
    /// fraction of the Coulomb friction, such as 1=0.03,2=0.05; at most four; none for no ripple
    #[arg(help_heading = "Friction", long, value_name = "ORDER=FRACTION", value_parser = ripples)]
    ripple: Option<Ripples>,
    /// Fraction by which friction is larger in a joint's positive direction and smaller in its negative direction,
    /// such as 0.1
    #[arg(
        help_heading = "Friction",
        long,
        default_value_t = 0.0,
        allow_hyphen_values = true,
        value_name = "FRACTION"
    )]
    friction_direction: f64,
    /// Friction per Nm (N) of gear load, such as 0.03
    #[arg(help_heading = "Friction", long, default_value_t = 0.0, value_name = "FRACTION")]
    friction_load: f64,
    /// Fraction of its power that a gear transmits to the load at speed, 0.5 to 1, such as 0.93; smaller at low speed
    #[arg(help_heading = "Friction", long, default_value_t = 1.0, value_name = "FRACTION")]
    gear_efficiency: f64,
    /// Standard deviation of each joint's friction from run to run, such as 0.015
    #[arg(help_heading = "Friction", long, default_value_t = 0.0, value_name = "FRACTION")]
    friction_day: f64,
    /// Heat gears by the power of friction and cool them at rest, instead of by the time since the cold start
    #[arg(help_heading = "Friction", long)]
    heating_by_work: bool,
    /// Number of robots of the same model, with consecutive names from --name and individual differences
    #[arg(help_heading = "Fleet", long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(super) robots: u32,
    /// Differences between robots in friction, warm-up and noise: standard deviation of the logarithms, 0.2 is about
    /// 20 %. Masses and inertias differ by a twentieth of it
    #[arg(help_heading = "Fleet", long, default_value_t = 0.0, value_name = "FRACTION")]
    unit_spread: f64,
    /// Amplitude of the ambient temperature over the year, K; the maximum is in mid July
    #[arg(help_heading = "Temperatures", long, default_value_t = 0.0, value_name = "K")]
    season_k: f64,
    /// Amplitude of the ambient temperature over the day, K; the maximum is at 15:00 UTC
    #[arg(help_heading = "Temperatures", long, default_value_t = 0.0, value_name = "K")]
    day_k: f64,
    /// Shifts of production in addition to the tests, in hours UTC, such as 6-14,14-22. A test within a shift is as
    /// warm as the time since the start of the shift makes it; other tests are cold
    #[arg(
        help_heading = "Temperatures",
        long,
        value_name = "FROM-TO",
        value_delimiter = ',',
        value_parser = shift,
        conflicts_with = "initial_warm_s"
    )]
    shifts: Vec<[f64; 2]>,
    /// Number of days per week with shifts, from Monday
    #[arg(help_heading = "Temperatures", long, default_value_t = 7, value_name = "DAYS", value_parser = clap::value_parser!(i8).range(1..=7), requires = "shifts")]
    work_days: i8,
}

/// Ripples, perhaps none.
#[derive(Debug, Clone)]
struct Ripples(Vec<RippleOrder>);

impl ArmOptions {
    /// `settings` with all of these.
    pub(super) fn applied(&self, settings: SimulationSettings) -> SimulationSettings {
        let usual = settings.sensors;
        SimulationSettings {
            servo: ServoSettings { lag_s: self.following_lag_s, delay_s: self.command_delay_s },
            speed: self.speed,
            sensors: SensorSettings {
                position_noise: self.position_noise.unwrap_or(usual.position_noise),
                position_step: self.position_step.unwrap_or(usual.position_step),
                velocity_noise: self.velocity_noise.unwrap_or(usual.velocity_noise),
                velocity_step: self.velocity_step.unwrap_or(usual.velocity_step),
                torque_correlation: self.torque_noise_correlation,
                torque_step: self.torque_step,
                torque_hum: self.torque_hum,
            },
            ripples: self.ripple.clone().map(|ripples| ripples.0),
            friction_direction: self.friction_direction,
            friction_load: self.friction_load,
            gear_efficiency: self.gear_efficiency,
            friction_day: self.friction_day,
            heating: if self.heating_by_work { Heating::Work } else { Heating::Time },
            unit_spread: UnitSpread {
                friction: self.unit_spread,
                bodies: BODIES_OF_FRICTION * self.unit_spread,
            },
            hall: HallSettings { season_k: self.season_k, day_k: self.day_k },
            work: (!self.shifts.is_empty())
                .then(|| WorkingHours { shifts: self.shifts.clone(), days: self.work_days }),
            ..settings
        }
    }

    /// Names of the robots, from that of the first: `R01`, `R02`, ..
    pub(super) fn names(&self, first: &str) -> Result<Vec<String>, CliError> {
        if self.robots == 1 {
            return Ok(vec![first.to_owned()]);
        }
        let stem = first.trim_end_matches(|of: char| of.is_ascii_digit());
        let digits = &first[stem.len()..];
        let number: u32 = match digits {
            "" => 1,
            _ => digits.parse().map_err(|_| {
                CliError::Usage(format!("--name {first}: its number is too large for further names"))
            })?,
        };
        let width = if digits.is_empty() { 2 } else { digits.len() };
        Ok((0..self.robots).map(|k| format!("{stem}{:0width$}", u64::from(number) + u64::from(k))).collect())
    }
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|value: &f64| value.is_finite())
}

fn pair(text: &str) -> Result<[f64; 2], String> {
    let parsed = text.split_once('=').and_then(|(a, b)| Some([number(a)?, number(b)?]));
    parsed
        .filter(|[hertz, amplitude]| *hertz > 0.0 && *amplitude >= 0.0)
        .ok_or_else(|| "a frequency above 0 Hz and an amplitude, such as 50=0.2".into())
}

fn ripples(text: &str) -> Result<Ripples, String> {
    if text.trim() == "none" {
        return Ok(Ripples(Vec::new()));
    }
    let order = |text: &str| {
        let (order, part) = text.split_once('=')?;
        let (order, part) = (number(order)?, number(part)?);
        (order > 0.0 && part >= 0.0).then_some(RippleOrder { order, part })
    };
    let orders: Option<Vec<RippleOrder>> = text.split(',').map(order).collect();
    orders.map(Ripples).ok_or_else(|| {
        "waves per turn of the motor and a fraction of the Coulomb friction, such as 1=0.03,2=0.05, or none".into()
    })
}

fn shift(text: &str) -> Result<[f64; 2], String> {
    let parsed = text.split_once('-').and_then(|(from, to)| Some([number(from)?, number(to)?]));
    parsed
        .filter(|[from, to]| (0.0..24.0).contains(from) && from < to && *to <= 24.0)
        .ok_or_else(|| "hours from and to within a day, such as 6-14".into())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct ArmLine {
        #[command(flatten)]
        arm: ArmOptions,
        #[arg(long, default_value_t = 0.0)]
        initial_warm_s: f64,
    }

    fn read(text: &str) -> Result<ArmOptions, String> {
        let line = ArmLine::try_parse_from(std::iter::once("simulate").chain(text.split_whitespace()));
        line.map(|line| line.arm).map_err(|error| error.to_string())
    }

    #[test]
    fn options_change_what_they_name_and_nothing_else() {
        let plain = SimulationSettings::default();
        assert_eq!(read("").expect("none").applied(plain.clone()), plain);
        let text = "--ripple 1=0.03,2=0.05 --torque-hum 50=0.2 --shifts 6-14,14-22.5 --work-days 5 --unit-spread 0.2";
        let found = read(text).expect("options").applied(plain.clone());
        let orders = found.ripples.expect("ripples");
        assert_eq!((orders.len(), orders[1]), (2, RippleOrder { order: 2.0, part: 0.05 }));
        assert_eq!(found.sensors, SensorSettings { torque_hum: Some([50.0, 0.2]), ..plain.sensors });
        let work = found.work.expect("shifts");
        assert_eq!((work.shifts[1], work.days), ([14.0, 22.5], 5));
        assert_eq!(found.unit_spread, UnitSpread { friction: 0.2, bodies: BODIES_OF_FRICTION * 0.2 });
        assert_eq!(read("--ripple none").expect("none").applied(plain).ripples, Some(Vec::new()));
        for (wrong, said) in [
            ("--ripple 2", "such as 1=0.03,2=0.05"),
            ("--torque-hum 0=1", "such as 50=0.2"),
            ("--shifts 14-6", "such as 6-14"),
            ("--work-days 5", "--shifts"),
            ("--shifts 6-14 --initial-warm-s 5", "cannot be used with"),
        ] {
            let error = read(wrong).err().unwrap_or_default();
            assert!(error.contains(said), "{wrong}: {error}");
        }
    }

    #[test]
    fn robots_are_named_on_from_the_first() {
        let names = |count: u32, first: &str| {
            let arm = ArmOptions { robots: count, ..read("").expect("none") };
            arm.names(first).expect("names")
        };
        assert_eq!(names(3, "R09"), ["R09", "R10", "R11"]);
        assert_eq!(names(2, "Left"), ["Left01", "Left02"]);
        assert_eq!(names(2, "R9"), ["R9", "R10"]);
        assert_eq!(names(1, "Left"), ["Left"]);
    }
}
