//! Space of a description's links: `[[capsule]]` and `self_collision`.

use nalgebra::Vector3;

use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::robot::{ArmShape, Capsule};

/// Positions of capsules and obstacles.
pub(super) const PLACE: Limits = Limits::within(20.0, "m");
/// Radii of capsules and obstacles.
pub(super) const RADIUS: Limits = Limits::above(0.0, 10.0, "m");

/// Most capsules of an arm, and most pairs of links.
const MOST: usize = 64;

/// Reads the capsules of an arm with `joints` joints, and the pairs of links that must not touch.
pub(crate) fn read(root: &Table<'_>, joints: Option<usize>) -> Option<ArmShape> {
    let links = joints.unwrap_or(armwatch_model::robot::MAX_JOINTS);
    let capsules = match root.optional("capsule") {
        None => Some(Vec::new()),
        Some(value) => {
            let sections = few(&value, value.sections()?)?;
            let all: Vec<Option<Capsule>> =
                sections.iter().map(|section| read_capsule(&section.table()?, links)).collect();
            all.into_iter().collect()
        }
    };
    let pairs = match root.optional("self_collision") {
        None => Some(Vec::new()),
        Some(value) => {
            let items = few(&value, value.items()?)?;
            let all: Vec<Option<[usize; 2]>> = items.iter().map(|item| read_pair(item, links)).collect();
            all.into_iter().collect::<Option<Vec<_>>>().map(|pairs| (value, pairs)).and_then(
                |(value, pairs)| {
                    let known = capsules.as_ref()?;
                    let has_capsule = |link: &usize| known.iter().any(|capsule| capsule.link == *link);
                    match pairs.iter().flatten().find(|link| !has_capsule(link)) {
                        None => Some(pairs),
                        Some(link) => {
                            value.refuse(
                                format!("names link {link}, which has no capsule"),
                                Some(format!("add a [[capsule]] with link = {link}")),
                            );
                            None
                        }
                    }
                },
            )
        }
    };
    Some(ArmShape { capsules: capsules?, pairs: pairs? })
}

fn few<'d>(value: &Value<'d>, items: Vec<Value<'d>>) -> Option<Vec<Value<'d>>> {
    if items.len() > MOST {
        value.refuse(format!("has {} entries, must have at most {MOST}", items.len()), None);
        return None;
    }
    Some(items)
}

fn read_capsule(table: &Table<'_>, links: usize) -> Option<Capsule> {
    let link = table.required("link").and_then(|value| read_link(&value, links));
    let ends = read_ends(table);
    let radius = table.number("radius_m", &RADIUS);
    Some(Capsule { link: link?, ends: ends?, radius: radius? })
}

/// Two points, `from_m` and `to_m`.
pub(super) fn read_ends(table: &Table<'_>) -> Option<[Vector3<f64>; 2]> {
    let (from, to) = (read_point(table, "from_m"), read_point(table, "to_m"));
    Some([from?, to?])
}

/// A point, m.
pub(super) fn read_point(table: &Table<'_>, key: &str) -> Option<Vector3<f64>> {
    let point: [f64; 3] = table.numbers(key, Some(3), &PLACE)?.try_into().ok()?;
    Some(point.into())
}

fn read_pair(item: &Value<'_>, links: usize) -> Option<[usize; 2]> {
    let both: Vec<Option<usize>> = item.items()?.iter().map(|value| read_link(value, links)).collect();
    match both.into_iter().collect::<Option<Vec<usize>>>()?[..] {
        [a, b] if a != b => Some([a.min(b), a.max(b)]),
        _ => {
            item.refuse("must be two different links, such as [1, 4]".into(), None);
            None
        }
    }
}

fn read_link(value: &Value<'_>, links: usize) -> Option<usize> {
    usize::try_from(value.integer(0..=i64::try_from(links).ok()?)?).ok()
}
