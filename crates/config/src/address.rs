//! A database with the address of a server instead of a file name.

use std::path::Path;

/// Schemes of addresses of a PostgreSQL server.
const SCHEMES: [&str; 2] = ["postgres", "postgresql"];

/// Remedy for a database that is neither a file nor on PostgreSQL.
pub const KINDS_OF_DATABASE: &str =
    "name a file, or a PostgreSQL server as in postgres://user@host:5432/name";

/// Returns true if a database is on a server: `postgres://user@host/name`, in upper or lower case.
pub fn is_on_server(database: &Path) -> bool {
    scheme(database).is_some_and(is_of_postgres)
}

/// The scheme of an address of another kind of server, such as `mysql`. Such an address is not used as a file name
/// either, because it may contain a password.
pub fn foreign_scheme(database: &Path) -> Option<&str> {
    scheme(database).filter(|scheme| !is_of_postgres(scheme))
}

/// The text before `://`; for PostgreSQL also before `:`, in case slashes are missing.
fn scheme(database: &Path) -> Option<&str> {
    let (scheme, rest) = database.to_str()?.trim_start().split_once(':')?;
    let is_scheme = scheme.starts_with(|first: char| first.is_ascii_alphabetic())
        && scheme.chars().all(|of| of.is_ascii_alphanumeric() || "+-.".contains(of));
    (is_scheme && (rest.starts_with("//") || is_of_postgres(scheme))).then_some(scheme)
}

fn is_of_postgres(scheme: &str) -> bool {
    SCHEMES.iter().any(|known| known.eq_ignore_ascii_case(scheme))
}

/// The database for display: an address without its password.
pub fn shown_database(database: &Path) -> String {
    let text = database.to_string_lossy();
    let (Some(scheme), Some((_, rest))) = (scheme(database), text.split_once(':')) else {
        return text.into_owned();
    };
    let rest = rest.strip_prefix("//").unwrap_or(rest.trim_start_matches('/'));
    let (place, parameters) = rest.split_once('?').map_or((rest, None), |(place, rest)| (place, Some(rest)));
    // a password may contain a slash that is not escaped
    let (user, place) = place.rsplit_once('@').map_or((None, place), |(user, place)| (Some(user), place));
    let user = user
        .map_or_else(String::new, |user| format!("{}@", user.split([':', '/']).next().unwrap_or_default()));
    let shown = parameters.unwrap_or_default().split('&');
    let shown: Vec<&str> =
        shown.filter(|one| !one.is_empty() && !one.to_ascii_lowercase().contains("pass")).collect();
    let parameters = if shown.is_empty() { String::new() } else { format!("?{}", shown.join("&")) };
    format!("{}://{user}{place}{parameters}", scheme.to_ascii_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_no_file() {
        for address in [
            "postgres://armwatch@db/fleet",
            "postgresql:///fleet?host=/run/postgresql",
            "POSTGRES://armwatch:secret@db/fleet",
            " PostgreSQL://db/fleet",
            "postgres:/armwatch:secret@db/fleet",
        ] {
            assert!(is_on_server(Path::new(address)), "{address}");
            assert_eq!(foreign_scheme(Path::new(address)), None, "{address}");
        }
        for file in ["armwatch.db", "/var/lib/armwatch/armwatch.db", "postgres.db", "a:b.db", "/a://b", ""] {
            assert!(!is_on_server(Path::new(file)), "{file}");
            assert_eq!(foreign_scheme(Path::new(file)), None, "{file}");
        }
        for (address, scheme) in [("mysql://a:b@db/fleet", "mysql"), ("SQLite://a.db", "SQLite")] {
            assert!(!is_on_server(Path::new(address)), "{address}");
            assert_eq!(foreign_scheme(Path::new(address)), Some(scheme));
        }
    }

    #[test]
    fn an_address_is_told_without_its_password() {
        for (address, told) in [
            ("postgres://armwatch:se@cret@db:5433/fleet", "postgres://armwatch@db:5433/fleet"),
            ("postgres://armwatch@db/fleet?sslmode=require", "postgres://armwatch@db/fleet?sslmode=require"),
            ("postgresql:///fleet?user=a&password=b&host=/run", "postgresql:///fleet?user=a&host=/run"),
            ("postgres://db", "postgres://db"),
            ("POSTGRES://a:se/cret@db/fleet?sslPassword=x", "postgres://a@db/fleet"),
            ("postgres:a:secret@db/fleet", "postgres://a@db/fleet"),
            ("mysql://a:secret@db/fleet", "mysql://a@db/fleet"),
            ("/data/fleet.db", "/data/fleet.db"),
        ] {
            assert_eq!(shown_database(Path::new(address)), told);
        }
    }
}
