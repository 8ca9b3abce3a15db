//! The tables of ARCHITECTURE.md on rooms and on crates, read as the rules that the sources are held against.

use std::collections::BTreeSet;

/// A row of the table of rooms.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Room {
    pub name: String,
    /// Rooms that it may name.
    pub names: BTreeSet<String>,
    /// Outside crates that it may name, with `_` for `-`.
    pub crates: BTreeSet<String>,
}

/// Outside crates that more rooms name than have a door to them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Open {
    pub crates: BTreeSet<String>,
    pub closed_to: BTreeSet<String>,
}

/// What ARCHITECTURE.md says on who may name what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rules {
    /// In the order of the table.
    pub rooms: Vec<Room>,
    pub open: Vec<Open>,
}

impl Rules {
    /// Reads the section "Rooms". A cell lists names in backticks; `all above` stands for the rooms of all rows
    /// before.
    pub fn read(document: &str) -> Result<Self, String> {
        let section = document
            .split("\n## ")
            .find(|section| section.starts_with("Rooms\n"))
            .ok_or("ARCHITECTURE.md has no section \"Rooms\"")?;
        let mut rules = Self { rooms: Vec::new(), open: Vec::new() };
        for (header, row) in rows(section) {
            match header[0].as_str() {
                "room" => rules.room(&row)?,
                "crates open to several rooms" => rules.opened(&row)?,
                other => {
                    return Err(format!("a table of \"Rooms\" begins with the unknown column {other:?}"));
                }
            }
        }
        if rules.rooms.is_empty() { Err("the section \"Rooms\" has no table".into()) } else { Ok(rules) }
    }

    fn room(&mut self, row: &[String]) -> Result<(), String> {
        let [name, _, may_name, crates] = row else {
            return Err(format!("not four cells: {row:?}"));
        };
        let name = quoted(name).into_iter().next().ok_or(format!("no room in backticks: {row:?}"))?;
        let mut names = quoted(may_name);
        if may_name.contains("all above") {
            names.extend(self.rooms.iter().map(|room| room.name.clone()));
        } else if names.is_empty() && !may_name.is_empty() {
            return Err(format!("room {name}: {may_name:?} names no room in backticks"));
        }
        let crates = quoted(crates).into_iter().map(|name| name.replace('-', "_")).collect();
        self.rooms.push(Room { name, names, crates });
        Ok(())
    }

    fn opened(&mut self, row: &[String]) -> Result<(), String> {
        let [crates, to] = row else { return Err(format!("not two cells: {row:?}")) };
        if !to.starts_with("every room") {
            return Err(format!("{to:?} does not begin with \"every room\""));
        }
        let crates = quoted(crates).into_iter().map(|name| name.replace('-', "_")).collect();
        self.open.push(Open { crates, closed_to: quoted(to) });
        Ok(())
    }

    /// Whether a room may name an outside crate.
    pub fn opens(&self, outside: &str, room: &Room) -> bool {
        room.crates.contains(outside)
            || self
                .open
                .iter()
                .any(|open| open.crates.contains(outside) && !open.closed_to.contains(&room.name))
    }

    /// Outside crates in either table.
    pub fn crates(&self) -> BTreeSet<String> {
        let doors = self.rooms.iter().flat_map(|room| room.crates.clone());
        doors.chain(self.open.iter().flat_map(|open| open.crates.clone())).collect()
    }

    /// What is wrong with the table itself: a room twice, an unknown one, or one that names a room below it, which
    /// would let data flow in a circle.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let order: Vec<&str> = self.rooms.iter().map(|room| room.name.as_str()).collect();
        for (at, room) in self.rooms.iter().enumerate() {
            if order[..at].contains(&room.name.as_str()) {
                problems.push(format!("room {} has two rows", room.name));
            }
            for name in room.names.iter().filter(|name| !order[..at].contains(&name.as_str())) {
                problems.push(format!("room {} may name {name}, which is no row above it", room.name));
            }
        }
        let closed = self.open.iter().flat_map(|open| &open.closed_to);
        problems.extend(
            closed.filter(|name| !order.contains(&name.as_str())).map(|name| format!("no room {name}")),
        );
        problems
    }

    /// Rooms that a room names, and those that they name, and so on.
    pub fn reach(&self, room: &str) -> BTreeSet<String> {
        let mut reached = BTreeSet::new();
        let mut next = vec![room.to_owned()];
        while let Some(name) = next.pop() {
            let row = self.rooms.iter().find(|row| row.name == name);
            for named in row.into_iter().flat_map(|row| &row.names) {
                if reached.insert(named.clone()) {
                    next.push(named.clone());
                }
            }
        }
        reached
    }
}

/// Rows of all tables of a text, each with the header of its table.
pub fn rows(text: &str) -> Vec<(Vec<String>, Vec<String>)> {
    let mut found = Vec::new();
    let mut header: Option<Vec<String>> = None;
    for line in text.lines() {
        let Some(row) = line.strip_prefix('|').and_then(|line| line.trim_end().strip_suffix('|')) else {
            header = None;
            continue;
        };
        let cells: Vec<String> = row.split('|').map(|cell| cell.trim().to_owned()).collect();
        match &header {
            None => header = Some(cells),
            Some(_) if cells.iter().all(|cell| cell.chars().all(|c| c == '-')) => {}
            Some(header) => found.push((header.clone(), cells)),
        }
    }
    found
}

/// What stands in backticks.
pub fn quoted(cell: &str) -> BTreeSet<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}
