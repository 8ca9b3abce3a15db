//! Rust.

use super::body::{Functions, Syntax, assignments, constants, names_read, safe, value_lines};
use crate::robot_code::expression::Function;
use crate::robot_code::language::SourceFile;
use crate::robot_code::listing::Listing;
use crate::robot_code::torque::TorquePrograms;

const SYNTAX: Syntax = Syntax {
    function_name,
    comment: "// ",
    comment_end: "",
    comment_gap: " ",
    variable: "let ",
    constant: "const ",
    is: ": f64 = ",
    end: ";",
    parentheses: ["", ""],
};

fn function_name(function: Function) -> &'static str {
    match function {
        Function::Sine => "f64::sin",
        Function::Cosine => "f64::cos",
        Function::Tanh => "f64::tanh",
        Function::Bell => "bell",
        Function::SquareRoot => "f64::sqrt",
        Function::Magnitude => "f64::abs",
        Function::Sign => "sign",
        Function::PositivePart => "positive_part",
        Function::NegativePart => "negative_part",
    }
}

pub(super) fn files(name: &str, header: &[String], programs: &TorquePrograms) -> Vec<SourceFile> {
    let functions = Functions::of(programs, &SYNTAX);
    let joints = programs.torque.joints;
    let mut source = format!("//! {}\n//!\n//! ```text\n", safe(&header[0]));
    let rest = header[1..].iter().skip_while(|line| line.is_empty());
    source.extend(rest.map(|line| format!("//! {}", safe(line)).trim_end().to_owned() + "\n"));
    source += &format!("//! ```\n\n/// Joints of the arm.\npub const JOINTS: usize = {joints};\n\n");
    source += &constants(&functions.constants, &SYNTAX);
    source += "\n";
    let helpers = [
        (
            Function::Sign,
            "fn sign(x: f64) -> f64 {\n    f64::from(i8::from(x > 0.0) - i8::from(x < 0.0))\n}\n\n",
        ),
        (Function::Bell, "fn bell(x: f64) -> f64 {\n    (-x * x).exp()\n}\n\n"),
        (Function::PositivePart, "fn positive_part(x: f64) -> f64 {\n    x.max(0.0)\n}\n\n"),
        (Function::NegativePart, "fn negative_part(x: f64) -> f64 {\n    x.min(0.0)\n}\n\n"),
    ];
    source += &functions.definitions(helpers);
    source += "/// What of the torque is friction at the speeds `qd`, Nm (N). A joint that is colder: `tau + (s - 1) friction`,\n\
               /// `s` the friction at its temperature against that of this code.\n\
               #[must_use]\n";
    let (reads, friction_inputs) = inputs(&functions.friction, &["qd"]);
    source +=
        &format!("pub fn friction({}: &[f64; JOINTS]) -> [f64; JOINTS] {{\n{friction_inputs}", reads[0]);
    source += &assignments(&functions.friction, &SYNTAX);
    source += &outputs(&functions.friction);
    source += "}\n\n/// Torque of each joint, Nm (N).\n#[must_use]\n";
    let (reads, torque_inputs) = inputs(&functions.torque, &["q", "qd", "qdd"]);
    let speeds = if functions.has_friction { "qd" } else { &reads[1] };
    source += &format!(
        "pub fn torque({}: &[f64; JOINTS], {speeds}: &[f64; JOINTS], {}: &[f64; JOINTS]) -> [f64; JOINTS] {{\n{torque_inputs}",
        reads[0], reads[2]
    );
    if functions.has_friction {
        source += "    let loss = friction(qd);\n";
    }
    source += &assignments(&functions.torque, &SYNTAX);
    source += "\n";
    source += &outputs(&functions.torque);
    source += "}\n";
    let check = include_str!("self_check_rust.txt").replace("NAME", name);
    vec![
        SourceFile { name: format!("{name}_torque.rs"), text: source },
        SourceFile { name: "self_check.rs".to_owned(), text: check },
    ]
}

/// Names of the arguments, and what takes them apart.
fn inputs(of: &Listing, which: &[&str]) -> (Vec<String>, String) {
    let (mut arguments, mut text) = (Vec::new(), String::new());
    for (prefix, read) in [("q", &of.positions), ("qd", &of.speeds), ("qdd", &of.accelerations)] {
        if !which.contains(&prefix) {
            continue;
        }
        let is_read = read.contains(&true);
        arguments.push(if is_read { prefix.to_owned() } else { format!("_{prefix}") });
        if is_read {
            let names = names_read(prefix, read);
            let names: Vec<String> =
                names.into_iter().map(|name| name.unwrap_or_else(|| "_".into())).collect();
            text += &format!("    let [{}] = *{prefix};\n", names.join(", "));
        }
    }
    (arguments, text)
}

fn outputs(of: &Listing) -> String {
    let lines: String = of.outputs.iter().map(|value| value_lines("    ", value, ",", &SYNTAX)).collect();
    format!("    [\n{lines}    ]\n")
}
