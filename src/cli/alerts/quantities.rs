//! `armwatch alerts quantities`: the quantities that anomalies are about.

use serde::Serialize;

use crate::cli::context::{EXIT_DONE, Global};
use crate::cli::shared::output;
use armwatch_model::anomaly::quantity::{FaultDirection, Quantity};
use armwatch_model::run::RunKind;

#[derive(Serialize)]
struct QuantityJson {
    quantity: Quantity,
    unit: Option<&'static str>,
    history: RunKind,
    direction: FaultDirection,
    label: &'static str,
}

pub(super) fn quantities(global: &Global) -> u8 {
    if global.json {
        for of in Quantity::ALL {
            output::json(&QuantityJson {
                quantity: of,
                unit: of.unit(),
                history: of.history(),
                direction: of.direction(),
                label: of.label(),
            });
        }
        return EXIT_DONE;
    }
    let cells = |of: Quantity| {
        [of.name(), of.unit().unwrap_or("-"), of.history().name(), of.direction().words(), of.label()]
            .map(str::to_owned)
            .to_vec()
    };
    let header = ["quantity", "unit", "history", "alarm on", "meaning"];
    output::block(&output::table(&header, &Quantity::ALL.map(cells)));
    EXIT_DONE
}
