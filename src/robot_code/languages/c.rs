//! C99.

use super::body::{Functions, Syntax, assignments, constants, names_read, safe, value_lines};
use crate::robot_code::expression::Function;
use crate::robot_code::language::SourceFile;
use crate::robot_code::listing::Listing;
use crate::robot_code::torque::TorquePrograms;

const SYNTAX: Syntax = Syntax {
    function_name,
    comment: "/* ",
    comment_end: " */",
    comment_gap: " ",
    variable: "const double ",
    constant: "static const double ",
    is: " = ",
    end: ";",
    parentheses: ["", ""],
};

fn function_name(function: Function) -> &'static str {
    match function {
        Function::Sine => "sin",
        Function::Cosine => "cos",
        Function::Tanh => "tanh",
        Function::Bell => "bell",
        Function::SquareRoot => "sqrt",
        Function::Magnitude => "fabs",
        Function::Sign => "sign",
        Function::PositivePart => "positive_part",
        Function::NegativePart => "negative_part",
    }
}

pub(super) fn files(name: &str, header: &[String], programs: &TorquePrograms) -> Vec<SourceFile> {
    let functions = Functions::of(programs, &SYNTAX);
    let joints = programs.torque.joints;
    let capitals = name.to_uppercase();
    let signature = format!(
        "void {name}_torque(const double q[{joints}], const double qd[{joints}], const double qdd[{joints}], double tau[{joints}])"
    );
    let friction_signature =
        format!("void {name}_friction(const double qd[{joints}], double friction[{joints}])");
    let comment: String =
        header.iter().map(|line| format!(" * {}", safe(line)).trim_end().to_owned() + "\n").collect();
    let interface = format!(
        "/*\n{comment} */\n#ifndef {capitals}_TORQUE_H\n#define {capitals}_TORQUE_H\n\n#define {capitals}_JOINTS {joints}\n\n\
         #ifdef __cplusplus\nextern \"C\" {{\n#endif\n\n\
         /* Torque of each joint, Nm (N). */\n{signature};\n\n\
         /* What of it is friction at the speeds qd, Nm (N). A joint that is colder: tau + (s - 1) friction, s the\n \
         * friction at its temperature against that of this code. */\n{friction_signature};\n\n\
         #ifdef __cplusplus\n}}\n#endif\n\n#endif\n"
    );
    let mut source = format!(
        "/* {} */\n/* {name}_torque.h says what it is. */\n#include \"{name}_torque.h\"\n\n#include <math.h>\n\n",
        safe(&header[0])
    );
    source += &constants(&functions.constants, &SYNTAX);
    source += "\n";
    let helpers = [
        (Function::Sign, "static double sign(double x) { return (double)((x > 0.0) - (x < 0.0)); }\n\n"),
        (Function::Bell, "static double bell(double x) { return exp(-x * x); }\n\n"),
        (Function::PositivePart, "static double positive_part(double x) { return x > 0.0 ? x : 0.0; }\n\n"),
        (Function::NegativePart, "static double negative_part(double x) { return x < 0.0 ? x : 0.0; }\n\n"),
    ];
    source += &functions.definitions(helpers);
    source += &format!("{friction_signature}\n{{\n{}", inputs(&functions.friction, &["qd"]));
    source += &assignments(&functions.friction, &SYNTAX);
    source += &outputs(&functions.friction, "friction");
    source += &format!("}}\n\n{signature}\n{{\n");
    source += &inputs(&functions.torque, &["q", "qd", "qdd"]);
    if functions.has_friction {
        source += &format!("    double loss[{joints}];\n    {name}_friction(qd, loss);\n");
    }
    source += &assignments(&functions.torque, &SYNTAX);
    source += "\n";
    source += &outputs(&functions.torque, "tau");
    source += "}\n";
    let check = include_str!("self_check_c.txt").replace("NAME", name).replace("CAPITALS", &capitals);
    vec![
        SourceFile { name: format!("{name}_torque.h"), text: interface },
        SourceFile { name: format!("{name}_torque.c"), text: source },
        SourceFile { name: "self_check.c".to_owned(), text: check },
    ]
}

fn inputs(of: &Listing, which: &[&str]) -> String {
    let mut text = String::new();
    for (prefix, read) in [("q", &of.positions), ("qd", &of.speeds), ("qdd", &of.accelerations)] {
        if !which.contains(&prefix) {
            continue;
        }
        let names = names_read(prefix, read);
        let read: Vec<String> = names
            .iter()
            .enumerate()
            .filter_map(|(j, name)| Some(format!("{} = {prefix}[{j}]", name.as_ref()?)))
            .collect();
        text += &match read.is_empty() {
            true => format!("    (void){prefix};\n"),
            false => value_lines("const double ", &read.join(", "), ";", &SYNTAX),
        };
    }
    text
}

fn outputs(of: &Listing, name: &str) -> String {
    let line = |(j, value): (usize, &String)| value_lines(&format!("{name}[{j}] = "), value, ";", &SYNTAX);
    of.outputs.iter().enumerate().map(line).collect()
}
