//! Columns of temperatures: of motors, one per joint, and of the ambient air.

use super::head::Head;
use super::names::{self, ColumnKind, NameMeaning};
use super::section::{Section, TomlKey, quoted};
use super::sets::{ORDER_QUESTION, Order, Set};
use armwatch_config::TemperatureUnit;

/// Plausible values for deriving a unit, in any unit: codes of open sensors are outside.
const BELIEVED: std::ops::RangeInclusive<f64> = -60.0..=480.0;

/// Values from here on are kelvins: motors burn at 200 degC, and no winter reaches 200 K.
const KELVINS: f64 = 220.0;

/// Ambient temperatures from here on are in degrees Fahrenheit: no workplace reaches 50 degC.
const FAHRENHEIT_HALL: f64 = 50.0;

/// The section, and its columns.
#[derive(Debug, Default)]
pub(super) struct FoundTemperatures {
    pub(super) sections: Vec<Section>,
    pub(super) columns: Vec<usize>,
}

/// Temperatures of an export of an arm with `count` joints; `taken` excludes columns with another meaning.
pub(super) fn temperatures(
    head: &Head,
    sets: &[Set],
    count: usize,
    taken: impl Fn(usize) -> bool,
) -> FoundTemperatures {
    let mut found = FoundTemperatures::default();
    if !head.header {
        return found;
    }
    let motors = sets
        .iter()
        .filter(|set| count > 0 && set.columns.len() >= count && !set.columns.iter().any(|at| taken(*at)))
        .filter(|set| {
            let said = set.said;
            said.kind == Some(ColumnKind::Temperature) && said.intent.is_none() && !said.is_electronics
        })
        .min_by_key(|set| (!set.said.is_motor, set.columns.len() != count));
    if let Some(set) = motors {
        let (name, value) = set.key(head, count);
        let columns = &set.columns[..count];
        let key = TomlKey::decided(name, value).because("from the names: temperatures, one per joint");
        let key = match set.order {
            Order::Place => key.asked(ORDER_QUESTION),
            Order::Number | Order::Names => key,
        };
        let keys = vec![key, unit_key(head, columns, set.said, false)];
        found.sections.push(Section { title: Some("motor_temperature"), comments: Vec::new(), keys });
        found.columns.extend(columns);
    }
    let said = |at: &usize| names::said(&head.columns[*at].name, &head.columns[*at].under);
    let hall = (0..head.columns.len()).filter(|at| !taken(*at) && !found.columns.contains(at)).find(|at| {
        let said = said(at);
        said.kind == Some(ColumnKind::Temperature)
            && said.is_hall
            && said.intent.is_none()
            && !said.is_electronics
    });
    if let Some(at) = hall {
        let keys = vec![
            TomlKey::decided("column", head.reference(at)).because("from the name: ambient temperature"),
            unit_key(head, &[at], said(&at), true),
        ];
        found.sections.push(Section { title: Some("ambient_temperature"), comments: Vec::new(), keys });
        found.columns.push(at);
    }
    found
}

/// The unit by its name, otherwise by the numbers.
fn unit_key(head: &Head, columns: &[usize], said: NameMeaning, is_hall: bool) -> TomlKey {
    if let Some(unit) = TemperatureUnit::ALL.into_iter().find(|unit| Some(unit.name()) == said.unit) {
        return TomlKey::decided("unit", quoted(unit.name())).because("the name gives it");
    }
    let mut values: Vec<f64> = columns
        .iter()
        .flat_map(|at| &head.columns[*at].numbers)
        .copied()
        .filter(|v| BELIEVED.contains(v))
        .collect();
    values.sort_by(f64::total_cmp);
    let Some(median) = values.get(values.len() / 2).copied() else {
        return TomlKey::decided("unit", quoted("degC"))
            .because("the numbers do not decide; this is the usual one");
    };
    let unit = match median {
        median if median >= KELVINS => TemperatureUnit::Kelvin,
        median if is_hall && median >= FAHRENHEIT_HALL => TemperatureUnit::Fahrenheit,
        _ => TemperatureUnit::Celsius,
    };
    let reason = format!(
        "by the numbers, {:.1} to {:.1}, half of them below {median:.1}",
        values.first().copied().unwrap_or(median),
        values.last().copied().unwrap_or(median)
    );
    let doubt = match (unit, is_hall) {
        (TemperatureUnit::Celsius, false) if median >= FAHRENHEIT_HALL => {
            "; degF would fit too, but is less common"
        }
        _ => "",
    };
    TomlKey::decided("unit", quoted(unit.name())).because(&(reason + doubt))
}
