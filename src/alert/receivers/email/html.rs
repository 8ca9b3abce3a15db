//! The HTML part of a mail: the same words as in the text part, with a curve of each alarm.

use std::fmt::Write;

use crate::alert::message::{Alarm, Message};
use crate::alert::picture;
use armwatch_model::anomaly::quantity::{Form, Quantity};
use armwatch_model::text::xml;

/// Most curves in a mail: a digest of a bad day still passes the limits of servers.
const MOST_PICTURES: usize = 10;

/// Without a style sheet, which many mail programs delete.
const CARD: &str = "border-left:4px solid";
const FACT: &str = "padding:2px 16px 2px 0;color:#5a6570;vertical-align:top";

/// A picture of a mail.
pub(super) struct Picture {
    /// Content-ID, for references of the page.
    pub(super) id: String,
    /// PNG file.
    pub(super) png: Vec<u8>,
}

/// The page of a message, and its pictures.
pub(super) fn page(message: &Message, domain: &str) -> (String, Vec<Picture>) {
    let mut pictures = Vec::new();
    let mut body = String::new();
    for (place, alarm) in message.alarms.iter().enumerate() {
        let png = if pictures.len() < MOST_PICTURES { curve(alarm) } else { None };
        let picture = png.map(|png| Picture { id: format!("{}-{place}@{domain}", message.key), png });
        write_alarm(&mut body, alarm, message, picture.as_ref());
        pictures.extend(picture);
    }
    let (language, title) = (message.language().code(), xml(&message.title()));
    let page = format!(
        "<!DOCTYPE html>\n<html lang=\"{language}\">\n<head><meta charset=\"utf-8\"><title>{title}</title></head>\n\
         <body style=\"font-family:sans-serif;color:#1c2733\">\n{body}<p style=\"color:#5a6570\">key: {}</p>\n</body>\n</html>\n",
        xml(&message.key)
    );
    (page, pictures)
}

fn write_alarm(body: &mut String, alarm: &Alarm, message: &Message, picture: Option<&Picture>) {
    let colour = match alarm.is_closed() {
        true => "#2a7d46",
        false => "#c03a00",
    };
    let title = xml(&alarm.title());
    let _ = writeln!(
        body,
        "<div style=\"{CARD} {colour};padding:0 0 0 16px;margin:0 0 24px\">\n<h2>{title}</h2>"
    );
    let _ = writeln!(body, "<p>{}</p>", xml(&alarm.sentence()));
    if let Some(picture) = picture {
        let id = xml(&picture.id);
        let _ = writeln!(body, "<p><img src=\"cid:{id}\" alt=\"{title}\" width=\"480\" height=\"160\"></p>");
    }
    body.push_str("<table>\n");
    for (name, text) in alarm.facts() {
        let _ = writeln!(body, "<tr><td style=\"{FACT}\">{}</td><td>{}</td></tr>", xml(&name), xml(&text));
    }
    body.push_str("</table>\n");
    if let Some(page) = message.origin.page_of(alarm.event.anomaly_id) {
        let page = xml(&page);
        let _ = writeln!(body, "<p><a href=\"{page}\">{page}</a></p>");
    }
    body.push_str("</div>\n");
}

/// Values over the tests, with the expected value and the limits that the quantity has.
fn curve(alarm: &Alarm) -> Option<Vec<u8>> {
    let event = &alarm.event;
    let limits = match (event.threshold.filter(|limit| *limit != 0.0), event.quantity.score_form()) {
        // a limit of a change is a distance from the expected value, to the side of this one
        (Some(limit), Form::Fraction) if event.quantity.value_form() == Form::Ratio => {
            let expected = event.baseline.unwrap_or(1.0);
            vec![expected + limit.copysign(event.value.unwrap_or(f64::INFINITY) - expected)]
        }
        (Some(limit), Form::Fraction) if event.quantity == Quantity::MovingRelativeRmsd => vec![limit],
        _ => Vec::new(),
    };
    picture::curve(&event.series, event.baseline, &limits)
}
