//! Expressions as lines of text: one assignment for every part that is used more than once or has a name.

use super::expression::{Expression, Function, Node, NodeId};
use super::torque::{Constant, Program};

/// Longest line of generated code.
pub(super) const LINE_WIDTH: usize = 110;

/// A line of a function's body.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum CodeLine {
    /// Heading of the following lines.
    Title(String),
    /// A new variable and its value.
    Assignment { name: String, value: String },
}

/// Body of a function.
#[derive(Debug)]
pub(super) struct Listing {
    /// Assignments in the order of computation.
    pub(super) lines: Vec<CodeLine>,
    /// Value of each output.
    pub(super) outputs: Vec<String>,
    /// The positions that it needs, by joint.
    pub(super) positions: Vec<bool>,
    /// Speeds by joint.
    pub(super) speeds: Vec<bool>,
    /// Accelerations by joint.
    pub(super) accelerations: Vec<bool>,
    /// Functions that it calls, in order.
    pub(super) functions: Vec<Function>,
    /// Constants that it reads.
    pub(super) constants: Vec<bool>,
    /// Sums, differences, products and quotients.
    pub(super) operations: usize,
}

/// Precedence of an expression.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Binding {
    Sum,
    Product,
    Single,
}

/// Writes a program; `function_name` gives the language's name of a function.
pub(super) fn listing(
    program: &Program,
    constants: &[Constant],
    function_name: fn(Function) -> &'static str,
) -> Listing {
    let needed = program.graph.needed(&program.outputs);
    let mut uses = vec![0_usize; needed.len()];
    let nodes = program.graph.nodes();
    for (node, _) in nodes.iter().zip(&needed).filter(|(_, needed)| **needed) {
        node.operands().for_each(|operand| uses[operand.0] += 1);
    }
    for output in &program.outputs {
        if let Expression::Signed { node, .. } = output {
            uses[node.0] += 1;
        }
    }
    let mut writer = Writer { program, constants, function_name, names: vec![None; nodes.len()] };
    let mut found = writer.inputs(&needed);
    let mut sections = program.sections.iter().peekable();
    let (mut title, mut unnamed) = (None, 0_usize);
    for (at, node) in nodes.iter().enumerate() {
        while let Some(section) = sections.next_if(|section| section.start <= at) {
            title = Some(&section.title);
        }
        if !needed[at] || node.is_leaf() {
            continue;
        }
        let name = match program.graph.name_of(NodeId(at)) {
            Some(name) => name.to_owned(),
            None if uses[at] > 1 => {
                unnamed += 1;
                format!("t{unnamed}")
            }
            None => continue,
        };
        if let Some(title) = title.take() {
            found.lines.push(CodeLine::Title(title.clone()));
        }
        let (value, _) = writer.spelled(NodeId(at));
        found.lines.push(CodeLine::Assignment { name: name.clone(), value });
        writer.names[at] = Some(name);
    }
    found.outputs = program.outputs.iter().map(|output| writer.output(*output)).collect();
    found
}

struct Writer<'a> {
    program: &'a Program,
    constants: &'a [Constant],
    function_name: fn(Function) -> &'static str,
    names: Vec<Option<String>>,
}

impl Writer<'_> {
    fn inputs(&self, needed: &[bool]) -> Listing {
        let joints = self.program.joints;
        let mut found = Listing {
            lines: Vec::new(),
            outputs: Vec::new(),
            positions: vec![false; joints],
            speeds: vec![false; joints],
            accelerations: vec![false; joints],
            functions: Vec::new(),
            constants: vec![false; self.constants.len()],
            operations: 0,
        };
        for (node, _) in self.program.graph.nodes().iter().zip(needed).filter(|(_, needed)| **needed) {
            match *node {
                Node::Position(j) => found.positions[j] = true,
                Node::Speed(j) => found.speeds[j] = true,
                Node::Acceleration(j) => found.accelerations[j] = true,
                Node::Constant(at) => found.constants[at] = true,
                Node::Call(function, _) => found.functions.push(function),
                Node::Whole(_) | Node::Friction(_) => {}
                Node::Add(..) | Node::Subtract(..) | Node::Multiply(..) | Node::Divide(..) => {
                    found.operations += 1;
                }
            }
        }
        found.functions.sort_unstable();
        found.functions.dedup();
        found
    }

    fn output(&self, of: Expression) -> String {
        match of {
            Expression::Zero => "0.0".to_owned(),
            Expression::Signed { node, negative: false } => self.text(node).0,
            Expression::Signed { node, negative: true } => format!("-{}", self.bound(node, Binding::Single)),
        }
    }

    /// The node's name if it has one, otherwise its expression.
    fn text(&self, id: NodeId) -> (String, Binding) {
        match &self.names[id.0] {
            Some(name) => (name.clone(), Binding::Single),
            None => self.spelled(id),
        }
    }

    /// The node, in parentheses if its precedence is lower than `binding`.
    fn bound(&self, id: NodeId, binding: Binding) -> String {
        match self.text(id) {
            (text, own) if own < binding => format!("({text})"),
            (text, _) => text,
        }
    }

    /// Expression of the node. Sums and products are written in the order of computation. The order of two operands
    /// does not matter: the operand that would need parentheses on the right comes first.
    fn spelled(&self, id: NodeId) -> (String, Binding) {
        let is_sum = |id: NodeId| {
            self.names[id.0].is_none()
                && matches!(self.program.graph.node(id), Node::Add(..) | Node::Subtract(..))
        };
        let is_product = |id: NodeId| {
            self.names[id.0].is_none()
                && matches!(self.program.graph.node(id), Node::Multiply(..) | Node::Divide(..))
        };
        match self.program.graph.node(id) {
            Node::Whole(number) => (format!("{number}.0"), Binding::Single),
            Node::Constant(at) => (self.constants[at].name.clone(), Binding::Single),
            Node::Position(j) => (format!("q{}", j + 1), Binding::Single),
            Node::Speed(j) => (format!("qd{}", j + 1), Binding::Single),
            Node::Acceleration(j) => (format!("qdd{}", j + 1), Binding::Single),
            Node::Friction(j) => (format!("loss[{j}]"), Binding::Single),
            Node::Add(a, b) => {
                let (a, b) = if is_sum(b) && !is_sum(a) { (b, a) } else { (a, b) };
                (format!("{} + {}", self.text(a).0, self.bound(b, Binding::Product)), Binding::Sum)
            }
            Node::Subtract(a, b) => {
                (format!("{} - {}", self.text(a).0, self.bound(b, Binding::Product)), Binding::Sum)
            }
            Node::Multiply(a, b) => {
                let swaps = is_product(b) && !is_product(a) || self.is_constant(b) && !is_product(a);
                let (a, b) = if swaps { (b, a) } else { (a, b) };
                (
                    format!("{} * {}", self.bound(a, Binding::Product), self.bound(b, Binding::Single)),
                    Binding::Product,
                )
            }
            Node::Divide(a, b) => (
                format!("{} / {}", self.bound(a, Binding::Product), self.bound(b, Binding::Single)),
                Binding::Product,
            ),
            Node::Call(function, a) => {
                (format!("{}({})", (self.function_name)(function), self.text(a).0), Binding::Single)
            }
        }
    }

    fn is_constant(&self, id: NodeId) -> bool {
        matches!(self.program.graph.node(id), Node::Constant(_))
    }
}

/// Breaks a long text at spaces. A single line if it fits.
pub(super) fn wrapped(text: &str, width: usize) -> Vec<String> {
    filled(text.split(' ').map(str::to_owned), width, width)
}

/// Breaks a long expression before `+` and `-`, or a list after its commas.
pub(super) fn wrapped_code(text: &str, first_width: usize, width: usize) -> Vec<String> {
    let mut pieces: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let begins = matches!(word, "+" | "-") || pieces.last().is_none_or(|piece| piece.ends_with(','));
        match pieces.last_mut() {
            Some(piece) if !begins => {
                piece.push(' ');
                piece.push_str(word);
            }
            _ => pieces.push(word.to_owned()),
        }
    }
    filled(pieces.into_iter(), first_width, width)
}

/// Joins as many pieces per line as fit.
fn filled(pieces: impl Iterator<Item = String>, first_width: usize, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut line = String::new();
    for word in pieces {
        let limit = if lines.is_empty() { first_width } else { width };
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > limit {
            lines.push(std::mem::take(&mut line));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(&word);
    }
    lines.push(line);
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot_code::expression::ExpressionGraph;

    fn name(_: Function) -> &'static str {
        "sin"
    }

    #[test]
    fn text_computes_in_the_order_of_the_graph() {
        let mut graph = ExpressionGraph::default();
        let [a, b, c] = [0, 1, 2].map(|j| graph.leaf(Node::Speed(j)));
        let sum = graph.add(b, c);
        let nested = graph.add(a, sum);
        let product = graph.multiply(nested, c);
        let once = graph.multiply(a, product);
        let difference = graph.subtract(a, sum);
        let outputs = vec![once.negated(), difference];
        let program = Program { joints: 3, graph, outputs, sections: Vec::new() };
        let found = listing(&program, &[], name);
        let assigned = CodeLine::Assignment { name: "t1".into(), value: "qd2 + qd3".into() };
        assert_eq!(found.lines, [assigned]);
        assert_eq!(found.outputs, ["-(qd3 * (qd1 + t1) * qd1)", "qd1 - t1"]);
        assert_eq!(found.speeds, [true; 3]);
        assert_eq!(found.operations, 5);
    }

    #[test]
    fn long_lines_break_at_spaces() {
        assert_eq!(wrapped("one two  three", 20), ["one two  three"]);
        assert_eq!(wrapped("one two three", 8), ["one two", "three"]);
        assert_eq!(wrapped_code("a + b * (c - d)", 20, 20), ["a + b * (c - d)"]);
        assert_eq!(wrapped_code("a + b * (c - d)", 4, 8), ["a", "+ b * (c", "- d)"]);
        assert_eq!(wrapped_code("a = 1, b = 2", 8, 8), ["a = 1,", "b = 2"]);
    }
}
