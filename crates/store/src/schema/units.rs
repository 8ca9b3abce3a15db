//! Units of quantities in views, from the list of the program.

use std::collections::BTreeMap;

use armwatch_model::anomaly::quantity::Quantity;

/// Placeholder for the unit of a quantity in the text of a view: `unit_of[EXPRESSION]`.
const UNIT_OF: &str = "unit_of[";

/// Replaces the placeholders by expressions.
pub(super) fn with_units(text: &str) -> String {
    let mut parts = text.split(UNIT_OF);
    let mut found = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (quantity, rest) = part.split_once(']').unwrap_or((part, ""));
        found.push_str(&unit_of(quantity));
        found.push_str(rest);
    }
    found
}

fn unit_of(quantity: &str) -> String {
    let mut by_unit: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for of in Quantity::ALL {
        if let Some(unit) = of.unit() {
            by_unit.entry(unit).or_default().push(format!("'{of}'"));
        }
    }
    let case = |(unit, names): (&str, Vec<String>)| {
        format!("\n           WHEN {quantity} IN ({}) THEN '{unit}'", names.join(", "))
    };
    format!("CASE{}\n       END", by_unit.into_iter().map(case).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_expression_has_the_unit_of_each_quantity() {
        let text = with_units("SELECT unit_of[coalesce(a, b)] AS unit, c FROM t");
        assert!(text.starts_with("SELECT CASE\n") && text.ends_with("END AS unit, c FROM t"), "{text}");
        assert!(
            text.contains("WHEN coalesce(a, b) IN ('load_kg', 'production_load_kg') THEN 'kg'"),
            "{text}"
        );
        assert_eq!(with_units("SELECT 1"), "SELECT 1");
    }
}
