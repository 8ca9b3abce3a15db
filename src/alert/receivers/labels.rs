//! An alarm in the form of Alertmanager and its webhooks: identifying labels, explaining annotations.

use jiff::Timestamp;
use serde_json::{Map, Value, json};

use crate::alert::message::{Alarm, Message, Origin};
use armwatch_model::text;

/// Name of all alarms of this program, for matching in Alertmanager's routes.
const ALERT_NAME: &str = "RobotArmAlarm";

/// Labels, with the given kind and severity. The identity of the anomaly does not change; kind and severity may, and
/// Alertmanager then treats the alarm as another alert.
pub(super) fn labels(alarm: &Alarm, origin: &Origin, kind: &str, severity: &str) -> Value {
    let event = &alarm.event;
    let mut labels = Map::new();
    let mut label = |name: &str, value: Option<String>| {
        labels.extend(value.map(|value| (name.to_owned(), Value::String(value))));
    };
    label("alertname", Some(ALERT_NAME.into()));
    label("alarm", Some(origin.anomaly(event.anomaly_id)));
    label("robot", Some(text::distinct(&event.robot).into_owned()));
    label("joint", event.joint.map(|joint| joint.to_string()));
    label("kind", Some(kind.into()));
    label("severity", Some(severity.into()));
    label("site", alarm.site.clone());
    Value::Object(labels)
}

/// Annotations that explain an alarm; all values are text.
pub(super) fn annotations(alarm: &Alarm, message: &Message) -> Value {
    let told = alarm.json(&message.origin);
    let mut annotations = Map::new();
    annotations.insert("summary".into(), Value::String(alarm.title()));
    annotations.insert("description".into(), Value::String(alarm.details().join("\n")));
    let Value::Object(told) = told else { return Value::Object(annotations) };
    let in_labels = ["robot", "joint", "kind", "severity", "site", "alarm", "title", "message", "status"];
    for (name, value) in told {
        let text = match value {
            Value::Null => continue,
            Value::String(text) => text::shown(&text).into_owned(),
            other => other.to_string(),
        };
        if !in_labels.contains(&name.as_str()) {
            annotations.insert(name, Value::String(text));
        }
    }
    Value::Object(annotations)
}

/// An alert of the API, with `ends_at` if given.
pub(super) fn alert(
    alarm: &Alarm,
    message: &Message,
    (kind, severity): (&str, &str),
    ends_at: Option<Timestamp>,
) -> Value {
    let mut alert = json!({
        "labels": labels(alarm, &message.origin, kind, severity),
        "annotations": annotations(alarm, message),
        "startsAt": alarm.event.first_seen_at.to_string(),
    });
    if let Some(ends_at) = ends_at {
        alert["endsAt"] = Value::String(ends_at.to_string());
    }
    if let Some(page) = message.origin.page_of(alarm.event.anomaly_id) {
        alert["generatorURL"] = Value::String(page);
    }
    alert
}
