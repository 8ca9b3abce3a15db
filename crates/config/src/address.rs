//! A database that is named by the address of a server instead of a file.

use std::path::Path;

/// How addresses of a PostgreSQL server begin.
const SCHEMES: [&str; 2] = ["postgres://", "postgresql://"];

/// Whether a database is on a server: `postgres://user@host/name`.
#[must_use]
pub fn is_on_server(database: &Path) -> bool {
    database.to_str().is_some_and(|text| SCHEMES.iter().any(|scheme| text.starts_with(scheme)))
}

/// The database as it is told to people: an address without its password.
#[must_use]
pub fn shown_database(database: &Path) -> String {
    let text = database.to_string_lossy();
    let Some((scheme, rest)) = text.split_once("://").filter(|_| is_on_server(database)) else {
        return text.into_owned();
    };
    let (place, parameters) = rest.split_once('?').map_or((rest, None), |(place, rest)| (place, Some(rest)));
    let (authority, name) = place.split_once('/').map_or((place, None), |(of, name)| (of, Some(name)));
    let authority = match authority.rsplit_once('@') {
        Some((user, host)) => format!("{}@{host}", user.split(':').next().unwrap_or_default()),
        None => authority.to_owned(),
    };
    let name = name.map_or_else(String::new, |name| format!("/{name}"));
    let told = parameters.unwrap_or_default().split('&');
    let told: Vec<&str> = told.filter(|one| !one.is_empty() && !one.starts_with("password=")).collect();
    let parameters = if told.is_empty() { String::new() } else { format!("?{}", told.join("&")) };
    format!("{scheme}://{authority}{name}{parameters}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_no_file() {
        for address in ["postgres://armwatch@db/fleet", "postgresql:///fleet?host=/run/postgresql"] {
            assert!(is_on_server(Path::new(address)), "{address}");
        }
        for file in ["armwatch.db", "/var/lib/armwatch/armwatch.db", "postgres.db", "sqlite://a.db", ""] {
            assert!(!is_on_server(Path::new(file)), "{file}");
        }
    }

    #[test]
    fn an_address_is_told_without_its_password() {
        for (address, told) in [
            ("postgres://armwatch:se@cret@db:5433/fleet", "postgres://armwatch@db:5433/fleet"),
            ("postgres://armwatch@db/fleet?sslmode=require", "postgres://armwatch@db/fleet?sslmode=require"),
            ("postgresql:///fleet?user=a&password=b&host=/run", "postgresql:///fleet?user=a&host=/run"),
            ("postgres://db", "postgres://db"),
            ("/data/fleet.db", "/data/fleet.db"),
        ] {
            assert_eq!(shown_database(Path::new(address)), told);
        }
    }
}
