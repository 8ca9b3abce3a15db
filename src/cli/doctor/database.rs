//! Checks the database: readable, of this program's version, and intact.

use jiff::Timestamp;

use super::finding::DoctorFinding;
use armwatch_config::{Config, is_on_server, shown_database};
use armwatch_store::{DaemonState, HostRow, HostState, Store, StoreError, lock_file_of};

const CHECK: &str = "database";

pub(super) async fn check(config: &Config, quick: bool) -> Vec<DoctorFinding> {
    let path = shown_database(&config.database);
    let store = match Store::open_existing_as(&config.database, &config.cluster).await {
        Ok(Some(store)) => store,
        Ok(None) if lock_file_of(&config.database).exists() => {
            let said =
                format!("{path} does not exist, and a daemon has worked on it: it was deleted or moved");
            let remedy = "restore a backup before the daemon starts, which would create an empty database";
            return vec![DoctorFinding::problem(CHECK, said, remedy)];
        }
        Ok(None) => {
            return vec![DoctorFinding::ok(
                CHECK,
                format!("{path} does not exist yet; the daemon creates it"),
            )];
        }
        Err(error @ StoreError::Older { .. }) => {
            let mut found =
                vec![DoctorFinding::warning(CHECK, error, "`armwatch backup FILE` copies it before")];
            if let (false, Ok(Some(store))) =
                (quick, Store::open_any_schema(&config.database, &config.cluster).await)
            {
                found.extend(looked_through(&store).await);
            }
            return found;
        }
        Err(error) => return vec![DoctorFinding::problem(CHECK, error, "docs/operations.md, Full disk")],
    };
    let mut found = vec![DoctorFinding::ok(CHECK, format!("{path} has the schema of this program"))];
    found.extend(entered(store.last_entered_at().await));
    found.extend(hosts(store.hosts().await));
    if is_on_server(&config.database) {
        let said = "the server is responsible for pages: data checksums, pg_amcheck, pg_dump";
        found.push(DoctorFinding::ok("integrity", said));
    } else {
        found.push(daemon(store.daemon().await));
        if !quick {
            found.extend(looked_through(&store).await);
        }
    }
    if let Err(error) = store.close().await {
        found.push(DoctorFinding::warning(CHECK, error, "look again"));
    }
    found
}

async fn looked_through(store: &Store) -> Vec<DoctorFinding> {
    let remedy = "move it away and restore a backup, or start without one: existing exports are read again";
    let damages = match store.damages().await {
        Ok(damages) => damages,
        Err(error) => return vec![DoctorFinding::problem("integrity", error, remedy)],
    };
    if !damages.is_empty() {
        return damages
            .iter()
            .map(|damage| DoctorFinding::problem("integrity", damage.trim(), remedy))
            .collect();
    }
    match store.broken_references().await {
        Ok(tables) if tables.is_empty() => {
            vec![DoctorFinding::ok("integrity", "pages and references are intact")]
        }
        Ok(tables) => {
            let said = format!("rows of {} refer to missing rows", tables.join(", "));
            vec![DoctorFinding::problem("integrity", said, remedy)]
        }
        Err(error) => vec![DoctorFinding::problem("integrity", error, remedy)],
    }
}

/// The daemon of a database in a file.
fn daemon(state: Result<DaemonState, StoreError>) -> DoctorFinding {
    const CHECK: &str = "daemon";
    match state {
        Ok(DaemonState::AtWork) => DoctorFinding::ok(CHECK, "a daemon works on the database"),
        Ok(DaemonState::Absent) => DoctorFinding::ok(CHECK, "no daemon runs on the database"),
        Ok(DaemonState::SilentSince(at)) => DoctorFinding::problem(
            CHECK,
            format!("the daemon has shown no sign of life since {}", at.strftime("%Y-%m-%d %H:%MZ")),
            "continue its process if it was stopped; otherwise end it and start it again",
        ),
        Err(error) => DoctorFinding::problem(CHECK, error, "check the database"),
    }
}

/// Daemons that share the database and have vanished without a regular stop.
fn hosts(hosts: Result<Vec<HostRow>, StoreError>) -> Vec<DoctorFinding> {
    let hosts = match hosts {
        Ok(hosts) => hosts,
        Err(error) => return vec![DoctorFinding::problem("hosts", error, "check the database")],
    };
    let lost = hosts.iter().filter(|row| row.is_lost()).map(|row| {
        let said = format!("the daemon of {:?} has been silent since {}", row.host, row.seen_at);
        DoctorFinding::warning(
            "hosts",
            said,
            "start it again there; its exports wait for it, or another daemon has taken them over",
        )
    });
    let lost: Vec<DoctorFinding> = lost.collect();
    let at_work = hosts.iter().filter(|row| row.state == HostState::AtWork).count();
    match (lost.is_empty(), at_work) {
        (false, _) => lost,
        (true, 0) => Vec::new(),
        (true, at_work) => {
            vec![DoctorFinding::ok("hosts", format!("daemons at work on the database: {at_work}"))]
        }
    }
}

/// Compares the clock with the latest entry.
fn entered(latest: Result<Option<Timestamp>, StoreError>) -> Vec<DoctorFinding> {
    match latest {
        Ok(Some(at)) if at > Timestamp::now() => vec![DoctorFinding::problem(
            "clock",
            format!("the last run was stored at {at}, which is in the future"),
            "correct the clock of this computer",
        )],
        Ok(Some(at)) => vec![DoctorFinding::ok("clock", format!("the last run was stored at {at}"))],
        Ok(None) => Vec::new(),
        Err(error) => vec![DoctorFinding::problem("clock", error, "check the database")],
    }
}
