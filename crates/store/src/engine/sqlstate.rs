//! Meaning of PostgreSQL's errors for the store.

use sqlx::postgres::PgDatabaseError;

/// Kind of a server's error, by its remedy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ServerFault {
    /// Another transaction conflicted, or the server has no connection left.
    Busy,
    /// The server is stopping or starting, or has ended the connection.
    Unreachable,
    /// The user cannot log in.
    Login,
    /// There is no such database.
    NoDatabase,
    /// The user lacks a right.
    Rights,
    /// Nothing can be written: the server is a replica, or the session is read-only.
    ReadOnly,
    /// The server's disk or memory is full.
    Full,
    /// A rule of the schema refuses the values.
    Refused,
    /// The statement took too long, or a person cancelled it.
    Cancelled,
    /// The statement is wrong.
    Statement,
    /// Pages or indices of the server are damaged.
    Corrupt,
    /// Any other error.
    Other,
}

/// The fault of an error of the driver; `None` if it is not an error of a server.
pub(crate) fn fault_of(error: &sqlx::Error) -> Option<ServerFault> {
    let sqlx::Error::Database(error) = error else { return None };
    error.try_downcast_ref::<PgDatabaseError>().map(|error| of_code(error.code()))
}

/// Codes: <https://www.postgresql.org/docs/15/errcodes-appendix.html>; the first two characters are the class.
fn of_code(code: &str) -> ServerFault {
    match code {
        "25006" => ServerFault::ReadOnly,
        "25P03" | "57P01" | "57P02" | "57P03" | "57P05" => ServerFault::Unreachable,
        "28000" | "28P01" => ServerFault::Login,
        "3D000" => ServerFault::NoDatabase,
        "40001" | "40P01" | "53300" | "55006" | "55P03" => ServerFault::Busy,
        "42501" => ServerFault::Rights,
        "57014" => ServerFault::Cancelled,
        "58030" => ServerFault::Full,
        "XX001" | "XX002" => ServerFault::Corrupt,
        code => match code.get(..2) {
            Some("08") => ServerFault::Unreachable,
            Some("22" | "23") => ServerFault::Refused,
            // a statement that the server refuses for its form, its state or its demand
            Some(
                "0A" | "0L" | "0P" | "20" | "21" | "24" | "25" | "26" | "2B" | "2F" | "34" | "38" | "39"
                | "3B" | "3F" | "42" | "44" | "54" | "55" | "P0",
            ) => ServerFault::Statement,
            Some("53") => ServerFault::Full,
            _ => ServerFault::Other,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_told_apart_by_what_can_be_done() {
        for (code, fault) in [
            ("23505", ServerFault::Refused),
            ("22003", ServerFault::Refused),
            ("40P01", ServerFault::Busy),
            ("55P03", ServerFault::Busy),
            ("53100", ServerFault::Full),
            ("53300", ServerFault::Busy),
            ("57P01", ServerFault::Unreachable),
            ("08006", ServerFault::Unreachable),
            ("28P01", ServerFault::Login),
            ("42601", ServerFault::Statement),
            ("25001", ServerFault::Statement),
            ("25006", ServerFault::ReadOnly),
            ("0A000", ServerFault::Statement),
            ("54001", ServerFault::Statement),
            ("55000", ServerFault::Statement),
            ("P0001", ServerFault::Statement),
            ("42501", ServerFault::Rights),
            ("F0000", ServerFault::Other),
            ("", ServerFault::Other),
        ] {
            assert_eq!(of_code(code), fault, "{code}");
        }
    }
}
