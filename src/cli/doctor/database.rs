//! Checks the database: readable, of this program's version, and intact.

use jiff::Timestamp;

use super::finding::DoctorFinding;
use armwatch_config::{Config, is_on_server, shown_database};
use armwatch_store::{HostRow, HostState, Store, StoreError};

const CHECK: &str = "database";

pub(super) async fn check(config: &Config, quick: bool) -> Vec<DoctorFinding> {
    let path = shown_database(&config.database);
    let store = match Store::open_existing_as(&config.database, &config.cluster).await {
        Ok(Some(store)) => store,
        Ok(None) => {
            return vec![DoctorFinding::ok(CHECK, format!("{path} is not there yet; the daemon makes it"))];
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
    let mut found = vec![DoctorFinding::ok(CHECK, format!("{path} is of this program's schema"))];
    found.extend(entered(store.last_entered_at().await));
    found.extend(hosts(store.hosts().await));
    if is_on_server(&config.database) {
        let said = "pages are looked after by the server: data checksums, pg_amcheck, pg_dump";
        found.push(DoctorFinding::ok("integrity", said));
    } else if !quick {
        found.extend(looked_through(&store).await);
    }
    if let Err(error) = store.close().await {
        found.push(DoctorFinding::warning(CHECK, error, "look again"));
    }
    found
}

async fn looked_through(store: &Store) -> Vec<DoctorFinding> {
    let remedy =
        "move it away and restore a backup, or start without: exports that are still there are read again";
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
            vec![DoctorFinding::ok("integrity", "pages and references are whole")]
        }
        Ok(tables) => {
            let said = format!("rows of {} refer to rows that are not there", tables.join(", "));
            vec![DoctorFinding::problem("integrity", said, remedy)]
        }
        Err(error) => vec![DoctorFinding::problem("integrity", error, remedy)],
    }
}

/// Daemons that share the database and have vanished without a regular stop.
fn hosts(hosts: Result<Vec<HostRow>, StoreError>) -> Vec<DoctorFinding> {
    let hosts = match hosts {
        Ok(hosts) => hosts,
        Err(error) => return vec![DoctorFinding::problem("hosts", error, "look at the database")],
    };
    let lost = hosts.iter().filter(|row| row.is_lost()).map(|row| {
        let said = format!("nothing was heard of the daemon of {:?} since {}", row.host, row.seen_at);
        DoctorFinding::warning(
            "hosts",
            said,
            "start it again there; what it was reading waits for it or was taken over",
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
            format!("the last run was entered at {at}, which is later than now"),
            "set the clock; until then it stood before",
        )],
        Ok(Some(at)) => vec![DoctorFinding::ok("clock", format!("the last run was entered at {at}"))],
        Ok(None) => Vec::new(),
        Err(error) => vec![DoctorFinding::problem("clock", error, "look at the database")],
    }
}
