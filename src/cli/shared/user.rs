//! The user at the command line.

use std::fs;

/// The system's list of users, one per line: name, password, number, and more, separated by colons.
const USERS: &str = "/etc/passwd";

/// The name of the user: from the environment, otherwise from the system, as for a systemd timer or cron, which sets
/// none. A number without a name is returned as it is.
pub(in crate::cli) fn user() -> String {
    let named = ["USER", "LOGNAME"].into_iter().filter_map(|name| std::env::var(name).ok());
    let mut named = named.map(|name| name.trim().to_owned()).filter(|name| !name.is_empty());
    named.next().unwrap_or_else(|| {
        let number = rustix::process::getuid().as_raw();
        let users = fs::read_to_string(USERS).unwrap_or_default();
        name_of(number, &users).unwrap_or_else(|| format!("user {number}"))
    })
}

/// The name of the user of this number among `users`, lines as in [`USERS`].
fn name_of(number: u32, users: &str) -> Option<String> {
    let number = number.to_string();
    users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        // skips the password
        (fields.nth(1)? == number && !name.is_empty()).then(|| name.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_the_name_that_the_system_gives_it() {
        let users =
            "root:x:0:0:root:/root:/bin/bash\n# none\nmueller:x:1000:1000::/home/mueller:/bin/sh\n:x:7:7\n";
        assert_eq!(name_of(1000, users).as_deref(), Some("mueller"));
        assert_eq!(name_of(0, users).as_deref(), Some("root"));
        assert_eq!((name_of(7, users), name_of(100, users), name_of(0, "")), (None, None, None));
    }
}
