//! `[alerts]`, `[[alerts.site]]` and `[[alerts.route]]`.

use std::collections::BTreeSet;
use std::time::Duration;

use jiff::civil::Time;
use jiff::tz::TimeZone;

use super::language::Language;
use super::receivers::read_receiver;
use super::settings::{AlertSettings, QuietHours, Route, Site};
use super::values::{given, texts};
use crate::toml::range::Limits;
use crate::toml::suggestion;
use crate::toml::table::{Table, Value};
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// A day: an alarm without an answer until the next shift of the same people was overlooked.
const DEFAULT_REMIND_AFTER_H: f64 = 24.0;

/// Three days: a receiver that fails on a Friday evening is repaired on Monday.
const DEFAULT_GIVE_UP_AFTER_H: f64 = 72.0;

const DEFAULT_RETRY_FIRST_S: f64 = 5.0;
const DEFAULT_RETRY_MOST_S: f64 = 900.0;

/// One every two minutes: more messages are not read individually.
const DEFAULT_MOST_PER_H: u32 = 30;

/// Bound on messages of an hour against a mistyped number.
const LARGEST_MOST_PER_H: i64 = 100_000;

/// Most routes; each has a separate task.
const MAX_ROUTES: usize = 64;

/// Longest pause that makes sense: a year.
const YEAR_H: f64 = 8766.0;

impl Default for AlertSettings {
    fn default() -> Self {
        Self {
            sites: Vec::new(),
            remind_after: Some(hours(DEFAULT_REMIND_AFTER_H)),
            give_up_after: hours(DEFAULT_GIVE_UP_AFTER_H),
            retry: (
                Duration::from_secs_f64(DEFAULT_RETRY_FIRST_S),
                Duration::from_secs_f64(DEFAULT_RETRY_MOST_S),
            ),
            language: Language::default(),
            link: None,
            routes: vec![Route::log()],
        }
    }
}

fn hours(hours: f64) -> Duration {
    Duration::from_secs_f64(3600.0 * hours)
}

/// Reads `[alerts]`; `None` after a problem.
pub(crate) fn read_alerts(table: &Table<'_>) -> Option<AlertSettings> {
    let remind =
        table.number_or("remind_after_h", &Limits::between(0.0, YEAR_H, "h"), DEFAULT_REMIND_AFTER_H);
    let give_up =
        table.number_or("give_up_after_h", &Limits::above(0.0, YEAR_H, "h"), DEFAULT_GIVE_UP_AFTER_H);
    let first = table.number_or("retry_first_s", &Limits::between(0.05, 3600.0, "s"), DEFAULT_RETRY_FIRST_S);
    let most = table.number_or("retry_most_s", &Limits::between(0.05, 86_400.0, "s"), DEFAULT_RETRY_MOST_S);
    let language = given(read_language(table));
    let link = table.optional("link").map(|value| value.text().map(str::to_owned));
    let sites = read_list(table, "site", read_site);
    let routes = read_routes(table);
    let (first, most) = (first?, most?);
    let (sites, routes) = (sites?, routes?);
    check_sites(table, &sites, &routes)?;
    let remind = remind?;
    Some(AlertSettings {
        sites,
        remind_after: (remind > 0.0).then(|| hours(remind)),
        give_up_after: hours(give_up?),
        retry: (Duration::from_secs_f64(first), Duration::from_secs_f64(most.max(first))),
        language: language?.unwrap_or_default(),
        link: match link {
            Some(link) => Some(link?),
            None => None,
        },
        routes,
    })
}

fn read_list<T>(table: &Table<'_>, key: &str, read: impl Fn(&Table<'_>) -> Option<T>) -> Option<Vec<T>> {
    let Some(value) = table.optional(key) else { return Some(Vec::new()) };
    let read: Vec<Option<T>> = value.sections()?.iter().map(|item| read(&item.table()?)).collect();
    read.into_iter().collect()
}

fn read_site(table: &Table<'_>) -> Option<Site> {
    let name = table.text("name").map(str::to_owned);
    let robots = table.required("robots").and_then(|value| texts(&value));
    Some(Site { name: name?, robots: robots? })
}

fn read_routes(table: &Table<'_>) -> Option<Vec<Route>> {
    let Some(value) = table.optional("route") else { return Some(vec![Route::log()]) };
    let items = value.sections()?;
    if items.len() > MAX_ROUTES {
        value.refuse(format!("has {} entries, must have at most {MAX_ROUTES}", items.len()), None);
        return None;
    }
    let mut names = BTreeSet::new();
    let routes: Vec<Option<Route>> = items
        .iter()
        .map(|item| {
            let table = item.table()?;
            let name = table.required("name").and_then(|value| {
                let name = value.text()?;
                if !names.insert(name.to_owned()) {
                    let hint = "deliveries are stored under this name; give each route its own name";
                    value.refuse("is the name of an earlier route".into(), Some(hint.into()));
                    return None;
                }
                Some(name.to_owned())
            });
            read_route(&table, name)
        })
        .collect();
    routes.into_iter().collect()
}

fn read_route(table: &Table<'_>, name: Option<String>) -> Option<Route> {
    let severity = match table.optional("severity") {
        Some(value) => one_of(&value, &Severity::ALL, |severity| severity.name()),
        None => Some(Severity::Warning),
    };
    let list = |key| table.optional(key).map(|value| texts(&value));
    let (robots, sites) = (list("robots"), list("sites"));
    let kinds = table.optional("kinds").map(|value| {
        let kinds: Vec<_> =
            value.items()?.iter().map(|item| one_of(item, &AnomalyKind::ALL, |kind| kind.name())).collect();
        kinds.into_iter().collect::<Option<Vec<_>>>()
    });
    let language = given(read_language(table));
    let zone = match table.optional("time_zone") {
        Some(value) => read_zone(&value),
        None => Some(TimeZone::UTC),
    };
    let quiet = table.optional("quiet").map(|value| read_quiet(&value));
    let digest_at = table.optional("digest_at").map(|value| read_time(&value, value.text()?.trim()));
    let most_per_h = match table.optional("most_per_h") {
        Some(value) => value.integer(1..=LARGEST_MOST_PER_H).and_then(|number| u32::try_from(number).ok()),
        None => Some(DEFAULT_MOST_PER_H),
    };
    let receiver = read_receiver(table);
    Some(Route {
        name: name?,
        severity: severity?,
        robots: given(robots)?,
        kinds: given(kinds)?,
        sites: given(sites)?,
        language: language?,
        zone: zone?,
        quiet: given(quiet)?,
        digest_at: given(digest_at)?,
        most_per_h: most_per_h?,
        receiver: receiver?,
    })
}

/// Refuses a site without a robot: it is a typing error, and its route would never send.
fn check_sites(table: &Table<'_>, sites: &[Site], routes: &[Route]) -> Option<()> {
    let named = |route: &Route| route.sites.clone().unwrap_or_default();
    let known = |name: &String| sites.iter().any(|site| site.name == *name);
    let mut is_sound = true;
    for (route, name) in
        routes.iter().flat_map(|route| named(route).into_iter().map(move |name| (route, name)))
    {
        if !known(&name) {
            let near = suggestion::nearest(&name, sites.iter().map(|site| site.name.as_str()));
            let hint = match near {
                Some(near) => format!("did you mean \"{near}\"?"),
                None => "write [[alerts.site]] with its name and robots".to_owned(),
            };
            table.refuse(format!("route {}: there is no site \"{name}\"", route.name), Some(hint));
            is_sound = false;
        }
    }
    is_sound.then_some(())
}

fn one_of<T: Copy>(value: &Value<'_>, all: &[T], name: impl Fn(T) -> &'static str) -> Option<T> {
    let text = value.text()?;
    let found = all.iter().copied().find(|item| name(*item) == text);
    if found.is_none() {
        let names: Vec<String> = all.iter().map(|item| format!("\"{}\"", name(*item))).collect();
        value.refuse("is not known here".into(), Some(format!("write one of {}", names.join(", "))));
    }
    found
}

/// Reads `language`; outer `None` if it is not given, inner after a problem.
fn read_language(table: &Table<'_>) -> Option<Option<Language>> {
    table.optional("language").map(|value| one_of(&value, &Language::ALL, |language| language.code()))
}

fn read_zone(value: &Value<'_>) -> Option<TimeZone> {
    let name = value.text()?;
    let zone = if name == "UTC" { Some(TimeZone::UTC) } else { TimeZone::get(name).ok() };
    if zone.is_none() {
        let hint = "write an IANA name such as \"Europe/Rome\" or \"UTC\"";
        value.refuse("is not a time zone known on this computer".into(), Some(hint.into()));
    }
    zone
}

fn read_time(value: &Value<'_>, text: &str) -> Option<Time> {
    let time = Time::strptime("%H:%M", text).ok();
    if time.is_none() {
        value
            .refuse("is not a time of day".into(), Some("write hours and minutes, such as \"07:00\"".into()));
    }
    time
}

fn read_quiet(value: &Value<'_>) -> Option<QuietHours> {
    let Some((from, to)) = value.text()?.split_once('-') else {
        let hint = "write two times of day, such as \"22:00-06:00\"";
        value.refuse("is not a period of the day".into(), Some(hint.into()));
        return None;
    };
    let (from, to) = (read_time(value, from.trim())?, read_time(value, to.trim())?);
    if from == to {
        value.refuse("is either a whole day or empty".into(), Some("give two different times".into()));
        return None;
    }
    Some(QuietHours { from, to })
}
