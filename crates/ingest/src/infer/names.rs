//! What the name of a column says: which joint, which quantity, which unit.

/// What a column, or the columns of all joints, may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
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
    /// Known, and of no use for a layout.
    Other(&'static str),
}

/// Words of people and vendors for what a column holds, in lower case: English, German, French, Italian,
/// Spanish, Chinese. The first group with a word in a name decides, so words with a narrower meaning stand
/// first.
const WORDS: &[(Kind, &[&str])] = &[
    (
        Kind::Other("an acceleration, which is derived from velocity"),
        &[
            "acc",
            "accel",
            "acceleration",
            "qdd",
            "ddq",
            "beschleunigung",
            "accélération",
            "accelerazione",
            "aceleración",
            "加速度",
        ],
    ),
    (
        Kind::Temperature,
        &["temp", "tmp", "temperature", "temperatur", "température", "temperatura", "温度", "室温", "温升"],
    ),
    (
        Kind::Torque,
        &[
            "trq",
            "torque",
            "tau",
            "drehmoment",
            "moment",
            "couple",
            "coppia",
            "par",
            "momento",
            "effort",
            "mtrq",
            "tq",
            "torq",
            "力矩",
            "扭矩",
            "转矩",
        ],
    ),
    (
        Kind::Current,
        &["current", "strom", "cur", "curr", "courant", "corrente", "corriente", "amps", "iq", "电流"],
    ),
    (
        Kind::Velocity,
        &[
            "vel",
            "velocity",
            "speed",
            "qd",
            "dq",
            "qdot",
            "geschwindigkeit",
            "geschw",
            "drehzahl",
            "vitesse",
            "velocità",
            "velocita",
            "velocidad",
            "omega",
            "mvel",
            "spd",
            "速度",
            "转速",
        ],
    ),
    (Kind::Stage, &["stage", "phase", "etappe", "étape", "etape", "fase", "etapa", "abschnitt", "阶段"]),
    (
        Kind::Cycle,
        &["cycle", "cycles", "zyklus", "zyklen", "ciclo", "wiederholung", "iteration", "循环", "周期"],
    ),
    (Kind::FrictionLevel, &["level", "stufe", "niveau", "livello", "nivel", "等级", "级别"]),
    (
        Kind::Position,
        &[
            "pos",
            "position",
            "posn",
            "q",
            "angle",
            "winkel",
            "angolo",
            "ángulo",
            "angulo",
            "posizione",
            "posición",
            "posicion",
            "lage",
            "lageist",
            "theta",
            "mpos",
            "istwert",
            "ist",
            "位置",
            "角度",
            "关节角",
        ],
    ),
    (
        Kind::Time,
        &[
            "time",
            "t",
            "zeit",
            "timestamp",
            "temps",
            "tempo",
            "tiempo",
            "zeitstempel",
            "ts",
            "clock",
            "ticks",
            "tick",
            "uhrzeit",
            "datum",
            "date",
            "时间",
            "时间戳",
        ],
    ),
    (
        Kind::FrictionJoint,
        &["joint", "axis", "achse", "gelenk", "axe", "asse", "eje", "articulation", "关节", "轴"],
    ),
];

/// Words for what was wanted and not what was measured.
const TARGETS: &[&str] = &[
    "soll",
    "sollwert",
    "target",
    "cmd",
    "command",
    "commanded",
    "desired",
    "ref",
    "reference",
    "setpoint",
    "consigne",
    "des",
    "目标",
    "指令",
    "error",
    "err",
    "fehler",
    "abweichung",
];

/// Words for the side before the gears.
const MOTOR: &[&str] = &["motor", "mot", "mpos", "mtrq", "mvel", "moteur", "motore", "电机"];

/// Parts of words for a temperature, for languages that write words together.
const TEMPERATURES: &[&str] = &["temperatur", "températur"];

/// Words for the air around the robot.
const HALL: &[&str] = &[
    "ambient",
    "amb",
    "room",
    "hall",
    "environment",
    "umgebung",
    "umgebungstemperatur",
    "raum",
    "raumtemperatur",
    "halle",
    "hallentemperatur",
    "ambiante",
    "salle",
    "ambiente",
    "sala",
    "nave",
    "环境",
    "室温",
    "室内",
];

/// Words for what has a temperature and is neither a motor nor a gearbox.
const ELECTRONICS: &[&str] = &[
    "drive",
    "inverter",
    "amplifier",
    "controller",
    "cabinet",
    "cpu",
    "board",
    "encoder",
    "umrichter",
    "regler",
    "verstärker",
    "schaltschrank",
    "variateur",
    "armoire",
    "驱动器",
    "控制柜",
];

/// Units of columns in many spellings, and as layouts name them.
const UNITS: &[(&str, &[&str])] = &[
    ("rad/s", &["rad/s", "rads", "rad/sec", "rad_s"]),
    ("deg/s", &["deg/s", "°/s", "grad/s", "deg/sec", "deg_s", "度/秒"]),
    ("rpm", &["rpm", "u/min", "1/min", "min-1", "tr/min", "giri/min", "rev/min", "r/min", "转/分"]),
    ("rev/s", &["rev/s", "u/s"]),
    ("m/s", &["m/s"]),
    ("rad", &["rad"]),
    ("deg", &["deg", "°", "grad", "degree", "degrees", "gradi", "grados", "degrés", "度"]),
    ("rev", &["rev", "turns", "umdr", "u"]),
    ("Nm", &["nm", "n.m", "n·m", "n*m", "n m", "newtonmeter"]),
    ("N", &["n"]),
    ("mA", &["ma"]),
    ("A", &["a", "amp", "ampere", "arms"]),
    ("%", &["%", "percent", "prozent", "pct"]),
    ("permille", &["permille", "‰", "promille"]),
    ("min", &["min", "minutes", "minuten", "minuti"]),
    ("h", &["h", "hours", "stunden", "ore"]),
    ("d", &["d", "days", "tage", "giorni"]),
    ("us", &["us", "µs", "μs"]),
    ("ns", &["ns"]),
    ("ms", &["ms", "msec", "毫秒"]),
    ("s", &["s", "sec", "sek", "seconds", "sekunden", "秒"]),
    ("m", &["m"]),
    ("degC", &["°c", "degc", "deg c", "celsius", "grad c", "℃", "c", "摄氏度"]),
    ("degF", &["°f", "degf", "deg f", "fahrenheit", "℉", "f"]),
    ("K", &["k", "kelvin"]),
];

/// What a name says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Said {
    pub(super) kind: Option<Kind>,
    /// Unit, as layouts name it.
    pub(super) unit: Option<&'static str>,
    /// The value is a target.
    pub(super) is_target: bool,
    /// Before the gears.
    pub(super) is_motor: bool,
    /// Of the air around the robot.
    pub(super) is_hall: bool,
    /// Of something that is neither motor nor gearbox.
    pub(super) is_electronics: bool,
}

/// What the name of a column says, with what stands under it; `{joint}` may stand for the joint's number.
pub(super) fn said(name: &str, under: &str) -> Said {
    let text = name.replace("{joint}", " 1 ");
    let words = words(&text);
    let has =
        |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()) || is_chinese(word, list));
    let unit = unit_of(under.trim_matches(['[', ']', '(', ')', ' '])).or_else(|| unit_in(&text));
    let compound = words.iter().any(|word| TEMPERATURES.iter().any(|part| word.contains(part)));
    let by_words = match compound {
        true => Some(Kind::Temperature),
        false => WORDS.iter().find(|(_, list)| has(list)).map(|(kind, _)| *kind),
    };
    let kind = match (by_words, unit) {
        // A word for the joint alone says less than a unit.
        (None | Some(Kind::FrictionJoint | Kind::Position), Some(unit)) => kind_of_unit(unit).or(by_words),
        _ => by_words,
    };
    Said {
        kind,
        unit,
        is_target: has(TARGETS),
        is_motor: has(MOTOR) || (compound && words.iter().any(|word| word.starts_with("motor"))),
        is_hall: has(HALL),
        is_electronics: has(ELECTRONICS),
    }
}

/// What a unit is one of; `None` for those of several quantities.
fn kind_of_unit(unit: &str) -> Option<Kind> {
    match unit {
        "rad" | "deg" | "rev" => Some(Kind::Position),
        "rad/s" | "deg/s" | "rpm" | "rev/s" | "m/s" => Some(Kind::Velocity),
        "Nm" | "N" | "permille" => Some(Kind::Torque),
        "A" | "mA" => Some(Kind::Current),
        "degC" | "degF" | "K" => Some(Kind::Temperature),
        _ => None,
    }
}

/// A unit as layouts name it.
fn unit_of(text: &str) -> Option<&'static str> {
    let text = text.trim().to_lowercase();
    UNITS.iter().find(|(_, spellings)| spellings.contains(&text.as_str())).map(|(unit, _)| *unit)
}

/// The unit in brackets, or behind `_`, a blank or "in" at the end of a name.
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

/// Words of a name in lower case: cut at what is no letter, and where small letters turn capital.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = ' ';
    for c in name.chars() {
        if (before.is_lowercase() && c.is_uppercase()) || !c.is_alphabetic() {
            words.push(String::new());
        }
        if c.is_alphabetic()
            && let Some(word) = words.last_mut()
        {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Chinese is written without blanks, so words are looked for inside.
fn is_chinese(word: &str, list: &[&str]) -> bool {
    !word.is_ascii()
        && list
            .iter()
            .any(|known| !known.is_ascii() && known.chars().all(|c| c >= '\u{4e00}') && word.contains(known))
}

/// Columns of one name but for a number, one a joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Group {
    /// The name with `{joint}` in the number's place.
    pub(super) template: String,
    /// Number of the first joint.
    pub(super) first: usize,
    /// Column indices, from the base outwards.
    pub(super) columns: Vec<usize>,
}

/// Groups of columns whose names differ in a number that counts on by one; each column is in one group at most,
/// and the largest groups are taken first.
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
        // Joints have one digit or two, without zeros before them.
        if (1..=2).contains(&digits)
            && !(digits == 2 && bytes[at] == b'0')
            && let Ok(number) = name[at..at + digits].parse()
        {
            found.push((format!("{}{{joint}}{}", &name[..at], &name[at + digits..]), number));
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
            ("pos_{joint}", Kind::Position, None),
            ("Position_{joint}", Kind::Position, None),
            ("q{joint}", Kind::Position, None),
            ("J{joint} pos [deg]", Kind::Position, Some("deg")),
            ("Achse {joint} Istwert", Kind::Position, None),
            ("Achse {joint} Istwert [°]", Kind::Position, Some("deg")),
            ("axis{joint}_torque", Kind::Torque, None),
            ("axis{joint}_torque_nm", Kind::Torque, Some("Nm")),
            ("A{joint}_Strom", Kind::Current, None),
            ("A{joint}_Strom [A]", Kind::Current, Some("A")),
            ("Drehmoment A{joint} in Nm", Kind::Torque, Some("Nm")),
            ("Drehzahl Achse {joint} (U/min)", Kind::Velocity, Some("rpm")),
            ("actual_qd_{joint}", Kind::Velocity, None),
            ("Couple axe {joint} [N.m]", Kind::Torque, Some("Nm")),
            ("Vitesse axe {joint} (°/s)", Kind::Velocity, Some("deg/s")),
            ("velocità asse {joint}", Kind::Velocity, None),
            ("coppia_{joint}", Kind::Torque, None),
            ("posición eje {joint} [rad]", Kind::Position, Some("rad")),
            ("关节{joint}位置", Kind::Position, None),
            ("关节{joint}力矩[Nm]", Kind::Torque, Some("Nm")),
            ("轴{joint}速度", Kind::Velocity, None),
            ("axis {joint} [deg]", Kind::Position, Some("deg")),
            ("mtrq_{joint}", Kind::Torque, None),
            ("JointPos{joint}", Kind::Position, None),
            ("Zeit [ms]", Kind::Time, Some("ms")),
            ("time_us", Kind::Time, Some("us")),
            ("stage", Kind::Stage, None),
            ("Zyklus", Kind::Cycle, None),
            ("joint", Kind::FrictionJoint, None),
            ("Stufe", Kind::FrictionLevel, None),
        ] {
            let said = said(name, "");
            assert_eq!((said.kind, said.unit), (Some(kind), unit), "{name}");
        }
        assert!(said("pos_soll_{joint}", "").is_target && said("mpos_{joint}", "").is_motor);
        assert_eq!(said("q{joint}", "[deg]").unit, Some("deg"));
        assert_eq!(said("temp_motor_{joint}", "").kind, Some(Kind::Temperature));
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
            assert_eq!((said.kind, said.unit), (Some(Kind::Temperature), unit), "{name}");
            assert_eq!((said.is_motor, said.is_hall), (is_motor, is_hall), "{name}");
        }
        assert!(said("drive temperature {joint}", "").is_electronics);
        for (name, kind) in [
            ("temps [s]", Kind::Time),
            ("tempo", Kind::Time),
            ("Couple moteur {joint} [N.m]", Kind::Torque),
            ("pos_{joint} [°]", Kind::Position),
            ("motor_torque_{joint}", Kind::Torque),
        ] {
            assert_eq!(said(name, "").kind, Some(kind), "{name}");
        }
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
    fn the_number_that_counts_is_the_joints() {
        let names = ["robot1_q1", "robot1_q2", "robot1_q3"];
        let found = groups(&names);
        assert_eq!((found.len(), found[0].template.as_str()), (1, "robot1_q{joint}"));
    }
}
