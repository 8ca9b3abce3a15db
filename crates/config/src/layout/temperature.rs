//! Columns of temperatures: of each joint's motor and of the ambient air.

use super::column::{Column, JointColumns};
use super::column_names::ColumnNames;
use crate::toml::table::Table;
use armwatch_model::run::temperature::ZERO_CELSIUS;

armwatch_model::named_enum! {
    /// A unit of temperature in exports.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum TemperatureUnit {
        /// Degrees Celsius.
        Celsius = "degC",
        /// Kelvin.
        Kelvin = "K",
        /// Degrees Fahrenheit.
        Fahrenheit = "degF",
    }
}

impl TemperatureUnit {
    /// Converts `value` in this unit to K.
    pub fn kelvin(self, value: f64) -> f64 {
        match self {
            Self::Celsius => value + ZERO_CELSIUS,
            Self::Kelvin => value,
            Self::Fahrenheit => (value - 32.0) / 1.8 + ZERO_CELSIUS,
        }
    }

    /// Converts `kelvin` to this unit.
    pub fn of_kelvin(self, kelvin: f64) -> f64 {
        match self {
            Self::Celsius => kelvin - ZERO_CELSIUS,
            Self::Kelvin => kelvin,
            Self::Fahrenheit => (kelvin - ZERO_CELSIUS) * 1.8 + 32.0,
        }
    }
}

/// Columns of the motors' temperatures; those that the export has are used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MotorTemperature {
    /// The columns.
    pub columns: JointColumns,
    /// Their unit.
    pub unit: TemperatureUnit,
}

/// Column of the ambient temperature; used if the export has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AmbientTemperature {
    /// The column.
    pub column: Column,
    /// Its unit.
    pub unit: TemperatureUnit,
}

/// Reads `[motor_temperature]`.
pub(crate) fn read_motor(table: &Table<'_>, names: &mut ColumnNames) -> Option<MotorTemperature> {
    let columns = names.take_joints(table);
    let unit = read_unit(table);
    Some(MotorTemperature { columns: columns?, unit: unit? })
}

/// Reads `[ambient_temperature]`.
pub(crate) fn read_ambient(table: &Table<'_>, names: &mut ColumnNames) -> Option<AmbientTemperature> {
    let column = table.required("column").and_then(|value| names.take(&value));
    let unit = read_unit(table);
    Some(AmbientTemperature { column: column?, unit: unit? })
}

fn read_unit(table: &Table<'_>) -> Option<TemperatureUnit> {
    let value = table.required("unit")?;
    let given = value.text()?;
    let unit = TemperatureUnit::ALL.into_iter().find(|unit| unit.name() == given);
    if unit.is_none() {
        let known = TemperatureUnit::ALL.map(TemperatureUnit::name).join(", ");
        value.refuse(format!("unknown unit, must be one of {known}"), None);
    }
    unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::layout_file::parse_layout;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    /// Tolerance of temperatures of some hundred kelvin after two operations.
    const ROUNDING: f64 = 1e-12;

    #[test]
    fn fixed_points_are_the_same_temperature_in_every_unit_and_back() {
        for (celsius, fahrenheit, kelvin) in
            [(0.0, 32.0, 273.15), (100.0, 212.0, 373.15), (-40.0, -40.0, 233.15)]
        {
            for (unit, value) in TemperatureUnit::ALL.into_iter().zip([celsius, kelvin, fahrenheit]) {
                assert!((unit.kelvin(value) / kelvin - 1.0_f64).abs() < ROUNDING, "{value} {}", unit.name());
                assert!(
                    (unit.of_kelvin(kelvin) - value).abs() < 1000.0 * ROUNDING,
                    "{value} {}",
                    unit.name()
                );
            }
        }
    }

    #[test]
    fn the_native_layout_names_temperatures_and_a_layout_may_leave_them_out() {
        let layout = parse_layout("native.toml", NATIVE).expect("no problems");
        let motor = layout.motor_temperature.expect("named");
        assert_eq!(motor.columns.of_joint(2), Some(Column::Name("motor_temperature_2_degc".into())));
        let ambient = layout.ambient_temperature.expect("named");
        assert_eq!(
            (ambient.column.to_string().as_str(), ambient.unit.name()),
            ("ambient_temperature_degc", "degC")
        );
        let start = NATIVE.find("[motor_temperature]").expect("a section");
        let end = NATIVE.find("[stage]").expect("what follows");
        let without =
            parse_layout("a.toml", &format!("{}{}", &NATIVE[..start], &NATIVE[end..])).expect("fine");
        assert_eq!((without.motor_temperature, without.ambient_temperature), (None, None));
    }

    #[test]
    fn wrong_units_and_columns_are_named_with_their_place() {
        let text = NATIVE.replace("motor_temperature_{joint}_degc", "motor_temperature").replace(
            "column = \"ambient_temperature_degc\"\nunit = \"degC\"",
            "column = 7\nunit = \"celsius\"",
        );
        let errors = parse_layout("wrong.toml", &text).expect_err("two problems");
        let keys: Vec<_> = errors.0.iter().map(|problem| problem.key.as_str()).collect();
        assert_eq!(keys, ["motor_temperature.column", "ambient_temperature.unit"], "{errors}");
        assert!(errors.0[1].problem.contains("degC, K, degF"), "{errors}");
    }
}
