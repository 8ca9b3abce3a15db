//! The tables of ARCHITECTURE.md on the inside of rooms, and the sources held against them. A place is a
//! folder or a file that lies directly in a room.

use std::collections::BTreeSet;

use super::arrows::{Arrow, arrows};
use super::source::Code;
use super::table::{quoted, rows};

/// A row of a room's table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// `friction/` for a folder, `analyse.rs` for a file.
    pub name: String,
    pub does: String,
    /// Places of the same room that it may name.
    pub names: BTreeSet<String>,
}

/// The table of one room, or of a folder inside it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// `store`, or `numerics/detect` for a folder.
    pub room: String,
    /// In the order of the table.
    pub places: Vec<Place>,
}

/// Reads the section "Inside the rooms": a heading `### room` and a table for each room. A heading without a
/// table is a table without rows.
pub fn read(document: &str) -> Result<Vec<Table>, String> {
    let section = document
        .split("\n## ")
        .find(|section| section.starts_with("Inside the rooms\n"))
        .ok_or("ARCHITECTURE.md has no section \"Inside the rooms\"")?;
    section.split("\n### ").skip(1).map(Table::read).collect()
}

impl Table {
    fn read(text: &str) -> Result<Self, String> {
        let room = text.lines().next().unwrap_or_default().trim().to_owned();
        let mut places: Vec<Place> = Vec::new();
        for (header, row) in rows(text) {
            if header != ["place", "does", "may name"] {
                return Err(format!("the table of {room} has the columns {header:?}"));
            }
            let [name, does, may_name] = row.as_slice() else {
                return Err(format!("the table of {room}: not three cells: {row:?}"));
            };
            let name = quoted(name).into_iter().next();
            let name = name.ok_or(format!("the table of {room}: no place in backticks: {row:?}"))?;
            let mut names = quoted(may_name);
            if may_name.contains("all above") {
                names.extend(places.iter().map(|place| place.name.clone()));
            } else if names.is_empty() && !may_name.is_empty() {
                return Err(format!("{room}, {name}: {may_name:?} names no place in backticks"));
            }
            places.push(Place { name, does: does.clone(), names });
        }
        Ok(Self { room, places })
    }

    fn row(&self, place: &str) -> Option<&Place> {
        self.places.iter().find(|row| row.name == place)
    }

    /// What is wrong with the table itself: a place twice, or one that names a place which is not above it.
    fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let order: Vec<&str> = self.places.iter().map(|place| place.name.as_str()).collect();
        for (at, place) in self.places.iter().enumerate() {
            if order[..at].contains(&place.name.as_str()) {
                problems.push(format!("{}: {} has two rows", self.room, place.name));
            }
            for name in place.names.iter().filter(|name| !order[..at].contains(&name.as_str())) {
                let told = format!("{}: {} may name {name}, which is no row above it", self.room, place.name);
                problems.push(told);
            }
        }
        problems
    }
}

/// What breaks the rules of the tables; for each room with such a fault, also the table that fits its
/// sources.
pub fn violations(codes: &[Code], tables: &[Table]) -> Vec<String> {
    let arrows = arrows(codes);
    let mut found = Vec::new();
    for (at, table) in tables.iter().enumerate() {
        let mut problems = table.problems();
        if tables[..at].iter().any(|other| other.room == table.room) {
            problems.push(format!("{} has two tables", table.room));
        }
        let room = Room::of(&table.room, codes, &arrows);
        if room.places.is_empty() {
            problems.push(format!("{} has a table and is no room", table.room));
        } else {
            problems.extend(room.violations(table));
        }
        if !problems.is_empty() && !room.places.is_empty() {
            problems.push(room.proposal(table));
        }
        found.extend(problems);
    }
    found
}

/// A room as its sources have it.
struct Room<'a> {
    /// The file that declares the places. Each place may name it.
    own: String,
    /// Each place with what its documentation says that it does, in the order in which the sources declare
    /// them; the room's own file comes last.
    places: Vec<(String, &'a str)>,
    /// From one place to another; none of them to the room's own file.
    arrows: Vec<(String, String, &'a Arrow<'a>)>,
}

impl<'a> Room<'a> {
    /// A room, or with `room/place/place` one inside it.
    fn of(name: &str, codes: &'a [Code], arrows: &'a [Arrow<'a>]) -> Self {
        let path: Vec<&str> = name.split('/').collect();
        let depth = path.len();
        let is_inside = |code: &Code| code.module.iter().take(depth).eq(&path);
        let inside: Vec<&Code> = codes.iter().filter(|code| is_inside(code)).collect();
        let is_folder = |code: &&&Code| {
            let below = code.module.len() - depth;
            below > 1 || (below == 1 && code.file.ends_with("/mod.rs"))
        };
        let folders: BTreeSet<&str> =
            inside.iter().filter(is_folder).map(|code| code.module[depth].as_str()).collect();
        let place = |code: &Code| match code.module.get(depth) {
            Some(name) if folders.contains(name.as_str()) => format!("{name}/"),
            Some(name) => format!("{name}.rs"),
            None => code.file.rsplit('/').next().unwrap_or_default().to_owned(),
        };
        let heads = inside.iter().filter(|code| code.module.len() < depth + 2);
        let own = inside.iter().find(|code| code.module.len() == depth).map(|code| place(code));
        let own = own.unwrap_or_default();
        let arrows = arrows.iter().filter(|arrow| is_inside(arrow.from) && is_inside(arrow.to));
        let arrows = arrows.map(|arrow| (place(arrow.from), place(arrow.to), arrow));
        let arrows = arrows.filter(|(from, to, _)| from != to && *to != own).collect();
        Self { places: heads.map(|code| (place(code), code.about.as_str())).collect(), own, arrows }
    }

    fn about(&self, place: &str) -> Option<&'a str> {
        self.places.iter().find(|(name, _)| name == place).map(|(_, about)| *about)
    }

    /// Places that a place names.
    fn named_by(&self, place: &str) -> BTreeSet<&str> {
        let arrows = self.arrows.iter().filter(|(from, _, _)| from == place);
        arrows.map(|(_, to, _)| to.as_str()).collect()
    }

    /// Whether a place is to have a row: the room's own file only where it names a place.
    fn needs_row(&self, place: &str) -> bool {
        place != self.own || !self.named_by(place).is_empty()
    }

    fn violations(&self, table: &Table) -> Vec<String> {
        let room = &table.room;
        let gone = table.places.iter().filter(|row| self.about(&row.name).is_none());
        let mut found: Vec<String> =
            gone.map(|row| format!("{room}: {} has a row and is no place", row.name)).collect();
        let without = self.places.iter().map(|(place, _)| place).filter(|place| table.row(place).is_none());
        let without = without.filter(|place| self.needs_row(place));
        found.extend(without.map(|place| format!("{room}: {place} has no row")));
        for (from, to, arrow) in &self.arrows {
            if table.row(from).is_some_and(|row| !row.names.contains(to)) {
                found.push(format!("{}: {from} may not name {to}", arrow.told()));
            }
        }
        found
    }

    /// The table that fits the sources, to be pasted: known rows in their order as far as the arrows let
    /// them.
    fn proposal(&self, table: &Table) -> String {
        let known = table.places.iter().map(|row| row.name.as_str());
        let new = self.places.iter().map(|(place, _)| place.as_str());
        let new = new.filter(|place| table.row(place).is_none());
        let mut left: Vec<&str> = known.chain(new).collect();
        left.retain(|place| self.about(place).is_some() && self.needs_row(place));
        let mut order: Vec<&str> = Vec::new();
        let ready = |place: &str, order: &[&str]| self.named_by(place).iter().all(|to| order.contains(to));
        while let Some(at) = left.iter().position(|place| ready(place, &order)) {
            order.push(left.remove(at));
        }
        let mut lines = vec![format!("\n### {}\n\n| place | does | may name |\n|---|---|---|", table.room)];
        for place in order.iter().chain(&left) {
            let row = table.row(place).map(|row| row.does.as_str());
            let does = row.or(self.about(place)).unwrap_or_default();
            let named = self.named_by(place);
            let named = order.iter().chain(&left).filter(|place| named.contains(*place));
            let named: Vec<String> = named.map(|place| format!("`{place}`")).collect();
            let cells = [format!("`{place}`"), does.to_owned(), named.join(", ")];
            let cells = cells.map(|cell| if cell.is_empty() { cell } else { format!(" {cell}") });
            lines.push(format!("|{} |", cells.join(" |")));
        }
        if !left.is_empty() {
            lines.push(format!("\nNo order fits {}, of these arrows some lead back:", left.join(", ")));
            let between = self
                .arrows
                .iter()
                .filter(|(from, to, _)| left.contains(&from.as_str()) && left.contains(&to.as_str()));
            lines.extend(between.map(|(from, to, arrow)| format!("    {from} to {to}: {}", arrow.told())));
        }
        lines.join("\n")
    }
}
