//! Python 3.

use super::body::{Functions, Syntax, assignments, constants, names_read, safe, value_lines};
use crate::robot_code::expression::Function;
use crate::robot_code::language::SourceFile;
use crate::robot_code::listing::Listing;
use crate::robot_code::torque::TorquePrograms;

const SYNTAX: Syntax = Syntax {
    function_name,
    comment: "# ",
    comment_end: "",
    comment_gap: "  ",
    variable: "",
    constant: "",
    is: " = ",
    end: "",
    parentheses: ["(", ")"],
};

fn function_name(function: Function) -> &'static str {
    match function {
        Function::Sine => "sin",
        Function::Cosine => "cos",
        Function::Tanh => "tanh",
        Function::Bell => "_bell",
        Function::SquareRoot => "sqrt",
        Function::Magnitude => "fabs",
        Function::Sign => "_sign",
        Function::PositivePart => "_positive_part",
        Function::NegativePart => "_negative_part",
    }
}

pub(super) fn files(name: &str, header: &[String], programs: &TorquePrograms) -> Vec<SourceFile> {
    let functions = Functions::of(programs, &SYNTAX);
    let joints = programs.torque.joints;
    let comment: Vec<String> = header.iter().map(|line| safe(line)).collect();
    let mut source = format!("\"\"\"{}\n\"\"\"\n\n", comment.join("\n"));
    let imported =
        [Function::Cosine, Function::Magnitude, Function::Sine, Function::SquareRoot, Function::Tanh];
    let mut imported: Vec<&str> =
        imported.into_iter().filter(|of| functions.calls(*of)).map(function_name).collect();
    imported.extend(functions.calls(Function::Bell).then_some("exp"));
    if !imported.is_empty() {
        source += &format!("from math import {}\n\n", imported.join(", "));
    }
    source += &format!("JOINTS = {joints}\n\n");
    source += &constants(&functions.constants, &SYNTAX);
    let helpers = [
        (Function::Sign, "\n\ndef _sign(x):\n    return 1.0 if x > 0.0 else -1.0 if x < 0.0 else 0.0\n"),
        (Function::Bell, "\n\ndef _bell(x):\n    return exp(-x * x)\n"),
        (Function::PositivePart, "\n\ndef _positive_part(x):\n    return x if x > 0.0 else 0.0\n"),
        (Function::NegativePart, "\n\ndef _negative_part(x):\n    return x if x < 0.0 else 0.0\n"),
    ];
    source += &functions.definitions(helpers);
    source += "\n\ndef friction(qd):\n    \"\"\"What of the torque is friction at the speeds qd, Nm (N).\n\n    \
               A joint that is colder: tau + (s - 1) friction, s the friction at its temperature against that of this code.\n    \
               \"\"\"\n";
    source += &inputs(&functions.friction, &["qd"]);
    source += &assignments(&functions.friction, &SYNTAX);
    source += &outputs(&functions.friction);
    source += "\n\ndef torque(q, qd, qdd):\n    \"\"\"Torque of each joint, Nm (N), as a list.\"\"\"\n";
    source += &inputs(&functions.torque, &["q", "qd", "qdd"]);
    if functions.has_friction {
        source += "    loss = friction(qd)\n";
    }
    source += &assignments(&functions.torque, &SYNTAX);
    source += "\n";
    source += &outputs(&functions.torque);
    let check = include_str!("self_check_python.txt").replace("NAME", name);
    vec![
        SourceFile { name: format!("{name}_torque.py"), text: source },
        SourceFile { name: "self_check.py".to_owned(), text: check },
    ]
}

fn inputs(of: &Listing, which: &[&str]) -> String {
    let mut text = String::new();
    for (prefix, read) in [("q", &of.positions), ("qd", &of.speeds), ("qdd", &of.accelerations)] {
        if which.contains(&prefix) && read.contains(&true) {
            let names = names_read(prefix, read);
            let names: Vec<String> =
                names.into_iter().map(|name| name.unwrap_or_else(|| "_".into())).collect();
            text += &format!("    [{}] = {prefix}\n", names.join(", "));
        }
    }
    text
}

fn outputs(of: &Listing) -> String {
    let lines: String = of.outputs.iter().map(|value| value_lines("    ", value, ",", &SYNTAX)).collect();
    format!("    return [\n{lines}    ]\n")
}
