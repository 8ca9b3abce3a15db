//! Mean temperatures of a cycle, without values that a working sensor cannot report.

use armwatch_model::analysis::CycleTemperatures;
use armwatch_model::run::Samples;
use armwatch_model::run::temperature::{TemperatureTrack, ZERO_CELSIUS};

/// Accepted temperatures of a motor, K: -40 degC, colder than the specification of any arm, to 200 degC, the limit of
/// the best insulation. Codes of open or broken sensors are outside: -273, -200, 850, 1372, 3276.7 degC.
const MOTOR: [f64; 2] = [ZERO_CELSIUS - 40.0, ZERO_CELSIUS + 200.0];

/// Accepted ambient temperatures, K: -40 to 70 degC.
const AMBIENT: [f64; 2] = [ZERO_CELSIUS - 40.0, ZERO_CELSIUS + 70.0];

/// Zero of the Celsius and Fahrenheit scales, K. An unconnected sensor reads only zero.
const ZEROS: [f64; 2] = [ZERO_CELSIUS, ZERO_CELSIUS - 32.0 / 1.8];

/// Distance from a zero below which a value equals it, K: tracks have a resolution of 0.01 K.
const SAME: f64 = 0.006;

/// Smallest share of measured rows with accepted values for a valid mean: a bad contact also gives false values between
/// its codes.
const LEAST_BELIEVED: f64 = 0.9;

/// Mean temperatures over the rows of a cycle that have one, K, and remarks about temperatures that are not used.
///
/// A row counts if its cell holds a number. Each of its temperatures counts separately.
#[must_use]
pub fn cycle_temperatures(samples: &Samples) -> (CycleTemperatures, Vec<String>) {
    let Some(recorded) = &samples.temperatures else { return Default::default() };
    let mut remarks = Vec::new();
    let mut mean = |track: &Option<TemperatureTrack>, limits, name: String| {
        let (mean, remark) = believed_mean(track.as_ref()?, limits);
        remarks.extend(remark.map(|remark| format!("{name} {remark}")));
        mean
    };
    let motors = (1..).zip(&recorded.motor);
    let motor =
        motors.map(|(j, track)| mean(track, MOTOR, format!("the motor temperature of joint {j}"))).collect();
    let ambient = mean(&recorded.ambient, AMBIENT, "the ambient temperature".to_owned());
    (CycleTemperatures { motor, ambient }, remarks)
}

/// Mean of the values inside the limits, K, unless too many are outside, and a remark.
fn believed_mean(track: &TemperatureTrack, [low, high]: [f64; 2]) -> (Option<f64>, Option<String>) {
    let (mut rows, mut believed, mut sum) = (0.0, 0.0, 0.0);
    let mut odd = None;
    let mut zero = true;
    for (of, kelvin) in track.measured() {
        let of = of as f64;
        rows += of;
        zero &= ZEROS.iter().any(|zero| (kelvin - zero).abs() < SAME);
        if (low..=high).contains(&kelvin) {
            believed += of;
            sum += of * kelvin;
        } else {
            odd = Some(kelvin);
        }
    }
    if rows == 0.0 {
        return (None, Some("has a column and no number in it".to_owned()));
    }
    if zero {
        return (None, Some("is zero in every row: a sensor that is not connected; not used".to_owned()));
    }
    let share = 100.0 * (1.0 - believed / rows);
    let said = odd.map(|kelvin| {
        let verdict = if believed < LEAST_BELIEVED * rows { "the cycle's are" } else { "these rows are" };
        let celsius = kelvin - ZERO_CELSIUS;
        let [low, high] = [low, high].map(|limit| limit - ZERO_CELSIUS);
        format!(
            "reads {celsius:.1} degC, and in {share:.1} % of its rows what none has ({low:.0} to {high:.0} degC are \
             believed): an open or broken sensor, or another unit in the layout; {verdict} not used"
        )
    });
    ((believed >= LEAST_BELIEVED * rows).then(|| sum / believed), said)
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::run::temperature::Temperatures;

    /// Tolerance: tracks have a resolution of 0.01 K.
    const STEP: f64 = 0.006;

    fn track(celsius: &[(usize, Option<f64>)]) -> Option<TemperatureTrack> {
        let mut track = TemperatureTrack::default();
        for (rows, value) in celsius {
            (0..*rows).for_each(|_| track.push(value.map(|value| value + ZERO_CELSIUS)));
        }
        Some(track)
    }

    fn samples(motor: Vec<Option<TemperatureTrack>>, ambient: Option<TemperatureTrack>) -> Samples {
        Samples { temperatures: Some(Temperatures { motor, ambient }), ..Samples::default() }
    }

    #[test]
    fn rows_without_a_value_do_not_count() {
        let sparse = track(&[(1, Some(40.0)), (99, None), (1, Some(50.0)), (99, None)]);
        let held = track(&[(100, Some(40.0)), (100, Some(50.0))]);
        let (found, remarks) =
            cycle_temperatures(&samples(vec![sparse, None, held], track(&[(7, Some(21.5))])));
        let celsius: Vec<_> = found.motor.iter().map(|mean| mean.map(|mean| mean - ZERO_CELSIUS)).collect();
        assert!(remarks.is_empty(), "{remarks:?}");
        assert!((celsius[0].expect("a mean") - 45.0).abs() < STEP && celsius[1].is_none(), "{celsius:?}");
        assert!((celsius[2].expect("a mean") - 45.0).abs() < STEP);
        assert!((found.ambient.expect("a mean") - ZERO_CELSIUS - 21.5).abs() < STEP);
        assert_eq!(cycle_temperatures(&Samples::default()), (CycleTemperatures::default(), Vec::new()));
    }

    #[test]
    fn codes_of_open_sensors_are_not_used_and_said() {
        for code in [0.0, -32.0 / 1.8, -273.15, -200.0, 850.0, 1372.0, 3276.7, -3276.8, 6553.5] {
            let (found, remarks) = cycle_temperatures(&samples(vec![track(&[(50, Some(code))])], None));
            assert_eq!(found.motor, [None], "{code}");
            assert!(
                remarks.len() == 1 && remarks[0].contains("joint 1") && remarks[0].contains("not used"),
                "{remarks:?}"
            );
        }
        let (found, remarks) =
            cycle_temperatures(&samples(vec![track(&[(50, None)])], track(&[(9, Some(90.0))])));
        assert_eq!((found.motor.as_slice(), found.ambient), (&[None][..], None));
        assert!(remarks[0].contains("no number") && remarks[1].contains("90.0 degC"), "{remarks:?}");
    }

    #[test]
    fn a_code_now_and_then_is_left_out_and_many_are_no_measurement() {
        let few = track(&[(95, Some(40.0)), (5, Some(850.0))]);
        let many = track(&[(80, Some(40.0)), (20, Some(850.0))]);
        // the air may be at zero for some time
        let winter = track(&[(50, Some(0.0)), (50, Some(0.5))]);
        let (found, remarks) = cycle_temperatures(&samples(vec![few, many], winter));
        assert!(
            (found.motor[0].expect("a mean") - ZERO_CELSIUS - 40.0).abs() < STEP && found.motor[1].is_none()
        );
        assert!(found.ambient.is_some() && remarks.len() == 2, "{remarks:?}");
        assert!(
            remarks[0].contains("these rows are not used") && remarks[1].contains("20.0 %"),
            "{remarks:?}"
        );
    }
}
