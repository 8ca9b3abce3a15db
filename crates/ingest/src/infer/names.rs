//! Analyses the name of a column: joint, quantity, unit, and hints that it was measured or not.

use super::name_words::{ELECTRONICS, HALL, INTENT, KINDS, MEASURED, MOTOR, PRESENT, TEMPERATURES, UNITS};

/// Quantity of a column, or of the columns of all joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColumnKind {
    Time,
    Position,
    Velocity,
    Torque,
    Current,
    Stage,
    Cycle,
    FrictionJoint,
    FrictionLevel,
    Temperature,
    /// Known, but unused by a layout.
    Other(&'static str),
}

/// Result of analysing a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct NameMeaning {
    pub(super) kind: Option<ColumnKind>,
    /// Unit in the notation of layouts.
    pub(super) unit: Option<&'static str>,
    /// The unit comes from a shipped layout, and may be missing in the name.
    pub(super) is_unit_shipped: bool,
    /// The word for a value that no sensor measured.
    pub(super) intent: Option<&'static str>,
    /// A word for a measured value.
    pub(super) is_measured: bool,
    /// On the motor side of the gears.
    pub(super) is_motor: bool,
    /// Refers to the ambient air.
    pub(super) is_hall: bool,
    /// Refers to a part other than motor and gearbox.
    pub(super) is_electronics: bool,
}

/// Analyses the name of a column, with the text below it; `{joint}` may replace the joint's number.
pub(super) fn said(name: &str, under: &str) -> NameMeaning {
    let text = name.replace("{joint}", " 1 ");
    let words = words(&text);
    let has = |list: &'static str| words.iter().find_map(|word| listed(list, word));
    let unit = unit_of(under.trim_matches(['[', ']', '(', ')', ' '])).or_else(|| unit_in(&text));
    let compound = words.iter().any(|word| TEMPERATURES.iter().any(|part| word.contains(part)));
    let by_words = match compound {
        true => Some(ColumnKind::Temperature),
        false => KINDS.iter().find(|(_, list)| has(list).is_some()).map(|(kind, _)| *kind),
    };
    // the current position is no current
    let by_words = match by_words {
        Some(ColumnKind::Current) => at_present(&words).or(by_words),
        _ => by_words,
    };
    let kind = match (by_words, unit) {
        // A word for the joint alone is weaker evidence than a unit.
        (None | Some(ColumnKind::FrictionJoint | ColumnKind::Position), Some(unit)) => {
            kind_of_unit(unit).or(by_words)
        }
        _ => by_words,
    };
    // `q_d` is a desired position; after `pos_a`, `pos_d` would be a joint called d
    let desired =
        || (name.contains("{joint}") && words.iter().skip(1).any(|word| word == "d")).then_some("d");
    NameMeaning {
        kind,
        unit,
        is_unit_shipped: false,
        intent: has(INTENT).or_else(desired),
        is_measured: has(MEASURED).is_some(),
        is_motor: has(MOTOR).is_some() || (compound && words.iter().any(|word| word.starts_with("motor"))),
        is_hall: has(HALL).is_some(),
        is_electronics: has(ELECTRONICS).is_some(),
    }
}

/// The quantity that a name gives if its word for a current means the present value.
fn at_present(words: &[String]) -> Option<ColumnKind> {
    let is_current = |word: &String| listed(PRESENT, word).is_some();
    let others = words.iter().filter(|word| !is_current(word) && listed(MEASURED, word).is_none());
    // `cur_q` is a current across the field
    let long: Vec<&String> = others.filter(|word| word.chars().count() > 2).collect();
    let lists =
        || KINDS.iter().filter(|(kind, _)| matches!(kind, ColumnKind::Velocity | ColumnKind::Position));
    let kind = |word: &&String| lists().find(|(_, list)| listed(list, word).is_some()).map(|(kind, _)| *kind);
    words.iter().any(is_current).then(|| long.iter().find_map(kind)).flatten()
}

/// What a unit is one of; `None` for those of several quantities.
fn kind_of_unit(unit: &str) -> Option<ColumnKind> {
    match unit {
        "rad" | "deg" | "rev" => Some(ColumnKind::Position),
        "rad/s" | "deg/s" | "rpm" | "rev/s" | "m/s" => Some(ColumnKind::Velocity),
        "Nm" | "N" | "permille" => Some(ColumnKind::Torque),
        "A" | "mA" => Some(ColumnKind::Current),
        "degC" | "degF" | "K" => Some(ColumnKind::Temperature),
        _ => None,
    }
}

/// A unit in the notation of layouts.
fn unit_of(text: &str) -> Option<&'static str> {
    let text = text.trim().to_lowercase();
    UNITS.iter().find(|(_, spellings)| spellings.contains(&text.as_str())).map(|(unit, _)| *unit)
}

/// The unit in brackets, or after `_`, a blank or "in" at the end of a name.
fn unit_in(name: &str) -> Option<&'static str> {
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let (Some(start), Some(end)) = (name.rfind(open), name.rfind(close))
            && start < end
            && let Some(unit) = unit_of(&name[start + open.len_utf8()..end])
        {
            return Some(unit);
        }
    }
    // Single letters at the end of a name are more often joints than units.
    let ending = |at: usize| unit_of(&name[at + 1..]).filter(|unit| unit.len() > 1 && *unit != "min");
    let places: Vec<usize> = name.match_indices(['_', ' ']).map(|(at, _)| at).collect();
    places.into_iter().find_map(ending)
}

/// The words and numbers of a name without those for its quantity: the joint, if the names of a set differ.
pub(super) fn label(name: &str, said: NameMeaning) -> Vec<String> {
    let list = KINDS.iter().find(|(kind, _)| Some(*kind) == said.kind).map_or("", |(_, list)| *list);
    let is_kind = |token: &String| parts(token).iter().any(|part| listed(list, part).is_some());
    tokens(name).into_iter().filter(|token| !is_kind(token)).collect()
}

/// Words of a name, like [`tokens`] without the numbers; compound words are split.
fn words(name: &str) -> Vec<String> {
    let tokens = tokens(name).into_iter().filter(|token| token.chars().all(char::is_alphabetic));
    tokens.flat_map(|token| parts(&token)).collect()
}

/// Words and numbers of a name in lower case: split at other characters, and between lower and upper case.
pub(super) fn tokens(name: &str) -> Vec<String> {
    let characters: Vec<char> = name.chars().collect();
    let mut tokens = vec![String::new()];
    for (at, c) in characters.iter().enumerate() {
        let before = at.checked_sub(1).map_or(' ', |at| characters[at]);
        let is_next_small = characters.get(at + 1).is_some_and(|next| next.is_lowercase());
        // `qRef`, and `FFTorque`
        let is_capital =
            c.is_uppercase() && (before.is_lowercase() || (before.is_uppercase() && is_next_small));
        let is_other_script = is_chinese(*c) != is_chinese(before);
        if is_capital
            || is_other_script
            || !c.is_alphanumeric()
            || c.is_alphabetic() != before.is_alphabetic()
        {
            tokens.push(String::new());
        }
        if c.is_alphanumeric()
            && let Some(token) = tokens.last_mut()
        {
            token.extend(c.to_lowercase());
        }
    }
    tokens.retain(|token| !token.is_empty());
    tokens
}

fn is_chinese(c: char) -> bool {
    c >= '\u{4e00}'
}

/// The parts of a compound word, as in `Sollmoment` or `qref`; the word itself if it is not a compound.
fn parts(word: &str) -> Vec<String> {
    if is_known(word) {
        return vec![word.to_owned()];
    }
    let two = |at: usize| {
        let (first, second) = word.split_at(at);
        // `Reibungsmoment`
        let second = match second.strip_prefix('s') {
            Some(rest) if first.len() > 3 && !is_known(second) => rest,
            _ => second,
        };
        let long = first.len().max(second.len()) >= LEAST_PART && second.len() > 1;
        let known = (first.len() > 1 || first == "q") && is_known(first) && is_known(second);
        (long && known).then(|| vec![first.to_owned(), second.to_owned()])
    };
    // The longest first word, so that `istwert` is not split into `ist` and the rest.
    let cuts: Vec<usize> = word.char_indices().skip(1).map(|(at, _)| at).collect();
    cuts.into_iter().rev().find_map(two).unwrap_or_else(|| vec![word.to_owned()])
}

/// Least length of the longer part of a compound, bytes: two shorter ones are more often another word.
const LEAST_PART: usize = 3;

/// Least length of a word with an ending, letters.
const LEAST_STEM: usize = 5;

/// Endings of adjectives and plurals.
const ENDINGS: [&str; 14] = ["e", "en", "er", "es", "em", "n", "s", "a", "o", "i", "te", "ed", "r", "d"];

fn is_known(word: &str) -> bool {
    let lists = KINDS.iter().map(|(_, list)| *list).chain([INTENT, MEASURED, MOTOR]);
    lists.into_iter().any(|list| listed(list, word).is_some())
}

/// The entry of a list that a word matches, with or without an ending. Chinese is written without blanks, so its words
/// are searched within the text.
fn listed(list: &'static str, word: &str) -> Option<&'static str> {
    list.split_ascii_whitespace().find(|known| {
        let ending = word.strip_prefix(known);
        ending.is_some_and(|rest| {
            rest.is_empty() || (known.chars().count() >= LEAST_STEM && ENDINGS.contains(&rest))
        }) || (known.chars().all(is_chinese) && word.contains(known))
    })
}

/// Columns whose names are equal except for a number, one per joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Group {
    /// The name with `{joint}` instead of the number.
    pub(super) template: String,
    /// Number of the first joint.
    pub(super) first: usize,
    /// Column indices, from the base outwards.
    pub(super) columns: Vec<usize>,
}

/// Groups of columns whose names differ in a number that increases by one; each column is in one group at most, and the
/// largest groups are chosen first.
pub(super) fn groups(names: &[&str]) -> Vec<Group> {
    let mut found: Vec<Group> = Vec::new();
    for (at, name) in names.iter().enumerate() {
        for (template, number) in templates(name) {
            match found.iter_mut().find(|group| group.template == template) {
                Some(group) if group.first + group.columns.len() == number => group.columns.push(at),
                Some(_) => {}
                None => found.push(Group { template, first: number, columns: vec![at] }),
            }
        }
    }
    found.retain(|group| group.columns.len() > 1);
    found.sort_by_key(|group| std::cmp::Reverse(group.columns.len()));
    let mut taken = vec![false; names.len()];
    found.retain(|group| {
        let free = group.columns.iter().all(|column| !taken[*column]);
        if free {
            group.columns.iter().for_each(|column| taken[*column] = true);
        }
        free
    });
    found.sort_by_key(|group| group.columns.first().copied());
    found
}

/// A name with each of its numbers in turn replaced.
fn templates(name: &str) -> Vec<(String, usize)> {
    let bytes = name.as_bytes();
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let digits = bytes[at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
        // Joints have one digit or two. Zeros before them, as in `Axis01`, stay in the name.
        let zeros =
            bytes[at..].iter().take(digits.saturating_sub(1)).take_while(|byte| **byte == b'0').count();
        if (1..=2).contains(&(digits - zeros))
            && let Ok(number) = name[at + zeros..at + digits].parse()
        {
            found.push((format!("{}{{joint}}{}", &name[..at + zeros], &name[at + digits..]), number));
        }
        at += digits.max(1);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_houses_are_understood() {
        for (name, kind, unit) in [
            ("pos_{joint}", ColumnKind::Position, None),
            ("Position_{joint}", ColumnKind::Position, None),
            ("q{joint}", ColumnKind::Position, None),
            ("J{joint} pos [deg]", ColumnKind::Position, Some("deg")),
            ("Achse {joint} Istwert", ColumnKind::Position, None),
            ("Achse {joint} Istwert [°]", ColumnKind::Position, Some("deg")),
            ("axis{joint}_torque", ColumnKind::Torque, None),
            ("axis{joint}_torque_nm", ColumnKind::Torque, Some("Nm")),
            ("A{joint}_Strom", ColumnKind::Current, None),
            ("A{joint}_Strom [A]", ColumnKind::Current, Some("A")),
            ("Drehmoment A{joint} in Nm", ColumnKind::Torque, Some("Nm")),
            ("Drehzahl Achse {joint} (U/min)", ColumnKind::Velocity, Some("rpm")),
            ("actual_qd_{joint}", ColumnKind::Velocity, None),
            ("Couple axe {joint} [N.m]", ColumnKind::Torque, Some("Nm")),
            ("Vitesse axe {joint} (°/s)", ColumnKind::Velocity, Some("deg/s")),
            ("velocità asse {joint}", ColumnKind::Velocity, None),
            ("coppia_{joint}", ColumnKind::Torque, None),
            ("posición eje {joint} [rad]", ColumnKind::Position, Some("rad")),
            ("关节{joint}位置", ColumnKind::Position, None),
            ("关节{joint}力矩[Nm]", ColumnKind::Torque, Some("Nm")),
            ("轴{joint}速度", ColumnKind::Velocity, None),
            ("axis {joint} [deg]", ColumnKind::Position, Some("deg")),
            ("J{joint} current position", ColumnKind::Position, None),
            ("current_speed_{joint}", ColumnKind::Velocity, None),
            ("position courante {joint}", ColumnKind::Position, None),
            ("$SCR_GRP[1].$CUR_ANG[{joint}]", ColumnKind::Position, None),
            ("J{joint} motor current", ColumnKind::Current, None),
            ("cur_q_{joint}", ColumnKind::Current, None),
            ("actual current {joint}", ColumnKind::Current, None),
            ("mtrq_{joint}", ColumnKind::Torque, None),
            ("JointPos{joint}", ColumnKind::Position, None),
            ("Zeit [ms]", ColumnKind::Time, Some("ms")),
            ("time_us", ColumnKind::Time, Some("us")),
            ("stage", ColumnKind::Stage, None),
            ("Zyklus", ColumnKind::Cycle, None),
            ("joint", ColumnKind::FrictionJoint, None),
            ("Stufe", ColumnKind::FrictionLevel, None),
        ] {
            let said = said(name, "");
            assert_eq!((said.kind, said.unit), (Some(kind), unit), "{name}");
        }
        assert!(said("pos_soll_{joint}", "").intent.is_some() && said("mpos_{joint}", "").is_motor);
        assert_eq!(said("q{joint}", "[deg]").unit, Some("deg"));
        assert_eq!(said("temp_motor_{joint}", "").kind, Some(ColumnKind::Temperature));
        assert_eq!(said("note", "").kind, None);
    }

    #[test]
    fn temperatures_are_known_in_many_languages_and_nothing_else_is_taken_for_one() {
        for (name, unit, is_motor, is_hall) in [
            ("motor_temperature_{joint}_degc", Some("degC"), true, false),
            ("ambient_temperature_degc", Some("degC"), false, true),
            ("Motortemperatur A{joint} [°C]", Some("degC"), true, false),
            ("Temp Motor {joint}", None, true, false),
            ("motor_temp_{joint} (K)", Some("K"), true, false),
            ("Température moteur axe {joint} (°C)", Some("degC"), true, false),
            ("temperatura motore {joint}", None, true, false),
            ("电机{joint}温度", None, true, false),
            ("Umgebungstemperatur", None, false, true),
            ("Raumtemperatur [°C]", Some("degC"), false, true),
            ("Hall temperature [°F]", Some("degF"), false, true),
            ("环境温度", None, false, true),
            ("A{joint} [°C]", Some("degC"), false, false),
        ] {
            let said = said(name, "");
            assert_eq!((said.kind, said.unit), (Some(ColumnKind::Temperature), unit), "{name}");
            assert_eq!((said.is_motor, said.is_hall), (is_motor, is_hall), "{name}");
        }
        assert!(said("drive temperature {joint}", "").is_electronics);
        for (name, kind) in [
            ("temps [s]", ColumnKind::Time),
            ("tempo", ColumnKind::Time),
            ("Couple moteur {joint} [N.m]", ColumnKind::Torque),
            ("pos_{joint} [°]", ColumnKind::Position),
            ("motor_torque_{joint}", ColumnKind::Torque),
        ] {
            assert_eq!(said(name, "").kind, Some(kind), "{name}");
        }
    }

    #[test]
    fn words_of_intent_are_found_however_they_are_written() {
        for name in [
            "target_moment_{joint}",
            "tau_J_d_{joint}",
            "q_d{joint}",
            "tau_ext_hat_filtered_{joint}",
            "tau_ff{joint}",
            "Sollmoment A{joint}",
            "Reibungsmoment {joint}",
            "FFTorque{joint}",
            "torqueCmd{joint}",
            "qref{joint}",
            "J{joint}maxTorque",
            "coppia stimata {joint}",
            "berechnetes Drehmoment {joint}",
            "qd_des_{joint}",
            "Schwerkraftmoment_{joint}",
            "posizione desiderata {joint}",
            "关节{joint}目标位置",
            "effort_limit_{joint}",
        ] {
            assert!(said(name, "").intent.is_some() && said(name, "").kind.is_some(), "{name}");
        }
        for name in [
            "q{joint}",
            "qd_{joint}",
            "tau_J_{joint}",
            "Istmoment A{joint}",
            "measured torque {joint}",
            "effort_{joint}",
            "Drehmoment A{joint} in Nm",
            "motor_torque_{joint}",
            "vel_{joint}",
            "qdot{joint}",
            "dq_{joint}",
            "coppia misurata {joint}",
            "关节{joint}实际位置",
            "position_actual_{joint}",
            "Achse {joint} Istwert",
        ] {
            assert!(said(name, "").intent.is_none() && said(name, "").kind.is_some(), "{name}");
        }
        assert!(said("Istmoment A{joint}", "").is_measured && said("tauFbk{joint}", "").is_measured);
        assert_eq!(said("pos_d", "").intent, None, "a joint called d");
        assert_eq!(tokens("/joint_states/wrist2JointPos"), ["joint", "states", "wrist", "2", "joint", "pos"]);
    }

    #[test]
    fn columns_that_count_on_are_joints() {
        let names =
            ["time", "q1", "q2", "q3", "A1_Strom", "A2_Strom", "A3_Strom", "stage", "x2", "tcp_0", "tcp_1"];
        let found: Vec<_> =
            groups(&names).into_iter().map(|g| (g.template, g.first, g.columns.len())).collect();
        let expected = [("q{joint}", 1, 3), ("A{joint}_Strom", 1, 3), ("tcp_{joint}", 0, 2)];
        assert_eq!(found, expected.map(|(template, first, n)| (template.to_owned(), first, n)));
    }

    #[test]
    fn zeros_before_a_number_belong_to_the_name() {
        let found = groups(&["gAxis01.pos", "gAxis02.pos", "gAxis03.pos", "J001", "J002"]);
        let found: Vec<_> = found.into_iter().map(|g| (g.template, g.first, g.columns.len())).collect();
        let expected = [("gAxis0{joint}.pos", 1, 3), ("J00{joint}", 1, 2)];
        assert_eq!(found, expected.map(|(template, first, n)| (template.to_owned(), first, n)));
    }

    #[test]
    fn the_number_that_counts_is_the_joints() {
        let names = ["robot1_q1", "robot1_q2", "robot1_q3"];
        let found = groups(&names);
        assert_eq!((found.len(), found[0].template.as_str()), (1, "robot1_q{joint}"));
    }
}
