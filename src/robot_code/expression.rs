//! Expressions of a motion: sums and products. Equal parts are one node, and zero parts are omitted.

use std::collections::HashMap;

/// A node of an [`ExpressionGraph`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct NodeId(pub(super) usize);

/// Kind of a node. Operands precede it in the graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Node {
    /// A small whole number above 0.
    Whole(u8),
    /// Named constant, by its index in the list of constants.
    Constant(usize),
    /// Position of a joint, rad (m).
    Position(usize),
    /// Its speed, rad/s (m/s).
    Speed(usize),
    /// Its acceleration, rad/s² (m/s²).
    Acceleration(usize),
    /// Friction of a joint, Nm (N), from the function of friction.
    Friction(usize),
    /// Sum.
    Add(NodeId, NodeId),
    /// Difference.
    Subtract(NodeId, NodeId),
    /// Product.
    Multiply(NodeId, NodeId),
    /// Quotient.
    Divide(NodeId, NodeId),
    /// Function of one number.
    Call(Function, NodeId),
}

impl Node {
    /// The nodes that it is computed from.
    pub(super) fn operands(self) -> impl Iterator<Item = NodeId> {
        let of = match self {
            Self::Add(a, b) | Self::Subtract(a, b) | Self::Multiply(a, b) | Self::Divide(a, b) => {
                [Some(a), Some(b)]
            }
            Self::Call(_, a) => [Some(a), None],
            _ => [None, None],
        };
        of.into_iter().flatten()
    }

    /// Returns true if the node is read instead of computed.
    pub(super) fn is_leaf(self) -> bool {
        self.operands().next().is_none()
    }
}

/// Functions that expressions use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Function {
    /// Sine of rad.
    Sine,
    /// Cosine of rad.
    Cosine,
    /// Hyperbolic tangent.
    Tanh,
    /// `exp(-x²)`.
    Bell,
    /// Square root.
    SquareRoot,
    /// Magnitude.
    Magnitude,
    /// -1, 0 or 1.
    Sign,
    /// The number if it is above 0, otherwise 0.
    PositivePart,
    /// The number if it is below 0, otherwise 0.
    NegativePart,
}

impl Function {
    fn value(self, x: f64) -> f64 {
        match self {
            Self::Sine => x.sin(),
            Self::Cosine => x.cos(),
            Self::Tanh => x.tanh(),
            Self::Bell => (-x * x).exp(),
            Self::SquareRoot => x.sqrt(),
            Self::Magnitude => x.abs(),
            Self::Sign if x == 0.0 => 0.0,
            Self::Sign => x.signum(),
            Self::PositivePart => x.max(0.0),
            Self::NegativePart => x.min(0.0),
        }
    }
}

/// A node with a sign, or zero. No node is a negation: signs move outwards and then need no operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Expression {
    /// Zero; nothing is computed.
    Zero,
    /// The node, or its negative.
    Signed {
        /// The node.
        node: NodeId,
        /// True if it is subtracted.
        negative: bool,
    },
}

impl Expression {
    /// The expression with the opposite sign.
    pub(super) fn negated(self) -> Self {
        match self {
            Self::Zero => Self::Zero,
            Self::Signed { node, negative } => Self::Signed { node, negative: !negative },
        }
    }
}

/// Three components.
pub(super) type Vector = [Expression; 3];

/// Nodes in the order of their computation. Equal nodes are one.
#[derive(Debug, Default)]
pub(super) struct ExpressionGraph {
    nodes: Vec<Node>,
    places: HashMap<Node, NodeId>,
    names: HashMap<NodeId, String>,
}

impl ExpressionGraph {
    /// All nodes, each after its operands.
    pub(super) fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Kind of the node.
    pub(super) fn node(&self, id: NodeId) -> Node {
        self.nodes[id.0]
    }

    /// The node's name, if it has one.
    pub(super) fn name_of(&self, id: NodeId) -> Option<&str> {
        self.names.get(&id).map(String::as_str)
    }

    /// Names an expression for readers of the code; a name for its negative ends in `_neg`. A leaf, or a node with a
    /// name, keeps its name.
    pub(super) fn name(&mut self, of: Expression, name: impl FnOnce() -> String) {
        if let Expression::Signed { node, negative } = of
            && !self.node(node).is_leaf()
        {
            let named = || if negative { format!("{}_neg", name()) } else { name() };
            self.names.entry(node).or_insert_with(named);
        }
    }

    /// The node as an expression.
    pub(super) fn leaf(&mut self, node: Node) -> Expression {
        Expression::Signed { node: self.place(node), negative: false }
    }

    fn place(&mut self, node: Node) -> NodeId {
        *self.places.entry(node).or_insert_with(|| {
            self.nodes.push(node);
            NodeId(self.nodes.len() - 1)
        })
    }

    /// `a + b`.
    pub(super) fn add(&mut self, a: Expression, b: Expression) -> Expression {
        use Expression::{Signed, Zero};
        match (a, b) {
            (Zero, other) | (other, Zero) => other,
            (Signed { node: x, negative }, Signed { node: y, negative: other }) if negative == other => {
                let (first, second) = (x.min(y), x.max(y));
                Signed { node: self.place(Node::Add(first, second)), negative }
            }
            (Signed { node: x, .. }, Signed { node: y, .. }) if x == y => Zero,
            (Signed { node: x, negative }, Signed { node: y, .. }) => {
                let (plus, minus) = if negative { (y, x) } else { (x, y) };
                match self.places.get(&Node::Subtract(minus, plus)) {
                    Some(&known) => Signed { node: known, negative: true },
                    None => Signed { node: self.place(Node::Subtract(plus, minus)), negative: false },
                }
            }
        }
    }

    /// `a - b`.
    pub(super) fn subtract(&mut self, a: Expression, b: Expression) -> Expression {
        self.add(a, b.negated())
    }

    /// Sum of all terms.
    pub(super) fn sum(&mut self, terms: impl IntoIterator<Item = Expression>) -> Expression {
        terms.into_iter().fold(Expression::Zero, |sum, term| self.add(sum, term))
    }

    /// `a b`.
    pub(super) fn multiply(&mut self, a: Expression, b: Expression) -> Expression {
        use Expression::{Signed, Zero};
        let (Signed { node: x, negative: s }, Signed { node: y, negative: t }) = (a, b) else { return Zero };
        let negative = s != t;
        match (self.node(x), self.node(y)) {
            (Node::Whole(1), _) => Signed { node: y, negative },
            (_, Node::Whole(1)) => Signed { node: x, negative },
            _ => Signed { node: self.place(Node::Multiply(x.min(y), x.max(y))), negative },
        }
    }

    /// `a / b`; `b` is not zero.
    pub(super) fn divide(&mut self, a: Expression, b: Expression) -> Expression {
        use Expression::{Signed, Zero};
        let (Signed { node: x, negative: s }, Signed { node: y, negative: t }) = (a, b) else { return Zero };
        Signed { node: self.place(Node::Divide(x, y)), negative: s != t }
    }

    /// The function of an expression that is not zero for all motions.
    pub(super) fn call(&mut self, function: Function, of: Expression) -> Expression {
        use Expression::{Signed, Zero};
        let Signed { node, negative } = of else { return Zero };
        let mirrored = match function {
            Function::PositivePart if negative => Function::NegativePart,
            Function::NegativePart if negative => Function::PositivePart,
            other => other,
        };
        let is_even = matches!(function, Function::Cosine | Function::Bell | Function::Magnitude);
        Signed { node: self.place(Node::Call(mirrored, node)), negative: negative && !is_even }
    }

    /// `a b` of two vectors.
    pub(super) fn dot(&mut self, a: Vector, b: Vector) -> Expression {
        let terms = [0, 1, 2].map(|k| self.multiply(a[k], b[k]));
        self.sum(terms)
    }

    /// `a + b` of two vectors.
    pub(super) fn add_vectors(&mut self, a: Vector, b: Vector) -> Vector {
        [0, 1, 2].map(|k| self.add(a[k], b[k]))
    }

    /// `a x b`.
    pub(super) fn cross(&mut self, a: Vector, b: Vector) -> Vector {
        [(1, 2), (2, 0), (0, 1)].map(|(j, k)| {
            let (plus, minus) = (self.multiply(a[j], b[k]), self.multiply(a[k], b[j]));
            self.subtract(plus, minus)
        })
    }

    /// The nodes that the expressions need, as true.
    pub(super) fn needed(&self, outputs: &[Expression]) -> Vec<bool> {
        let mut needed = vec![false; self.nodes.len()];
        for output in outputs {
            if let Expression::Signed { node, .. } = output {
                needed[node.0] = true;
            }
        }
        for at in (0..self.nodes.len()).rev() {
            if needed[at] {
                self.nodes[at].operands().for_each(|operand| needed[operand.0] = true);
            }
        }
        needed
    }

    /// Values of `outputs`; `leaf` gives the values of leaves.
    pub(super) fn values(&self, outputs: &[Expression], leaf: impl Fn(Node) -> f64) -> Vec<f64> {
        let mut values = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let value = |id: &NodeId| -> f64 { values[id.0] };
            values.push(match node {
                Node::Whole(number) => f64::from(*number),
                Node::Add(a, b) => value(a) + value(b),
                Node::Subtract(a, b) => value(a) - value(b),
                Node::Multiply(a, b) => value(a) * value(b),
                Node::Divide(a, b) => value(a) / value(b),
                Node::Call(function, a) => function.value(value(a)),
                read => leaf(*read),
            });
        }
        let of = |output: &Expression| match output {
            Expression::Zero => 0.0,
            Expression::Signed { node, negative: false } => values[node.0],
            Expression::Signed { node, negative: true } => -values[node.0],
        };
        outputs.iter().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs(graph: &mut ExpressionGraph) -> (Expression, Expression) {
        (graph.leaf(Node::Speed(0)), graph.leaf(Node::Speed(1)))
    }

    #[test]
    fn equal_parts_are_one_node_whatever_their_order_and_sign() {
        let mut graph = ExpressionGraph::default();
        let (a, b) = inputs(&mut graph);
        let product = graph.multiply(a, b);
        assert_eq!(graph.multiply(b, a), product);
        assert_eq!(graph.multiply(b.negated(), a), product.negated());
        let difference = graph.subtract(a, b);
        assert_eq!(graph.subtract(b, a), difference.negated());
        assert_eq!(graph.nodes().len(), 4);
        assert_eq!(graph.subtract(a, a), Expression::Zero);
    }

    #[test]
    fn zeros_and_ones_cost_nothing() {
        let mut graph = ExpressionGraph::default();
        let (a, _) = inputs(&mut graph);
        let one = graph.leaf(Node::Whole(1));
        assert_eq!(graph.multiply(a, one.negated()), a.negated());
        assert_eq!(graph.multiply(a, Expression::Zero), Expression::Zero);
        assert_eq!(graph.add(Expression::Zero, a.negated()), a.negated());
        assert_eq!(graph.call(Function::Sign, Expression::Zero), Expression::Zero);
    }

    #[test]
    fn values_follow_the_signs() {
        let mut graph = ExpressionGraph::default();
        let (a, b) = inputs(&mut graph);
        let difference = graph.subtract(b, a);
        let outputs = [
            Function::Sine,
            Function::Cosine,
            Function::Tanh,
            Function::Bell,
            Function::Magnitude,
            Function::Sign,
            Function::PositivePart,
            Function::NegativePart,
        ]
        .map(|function| graph.call(function, difference.negated()));
        let (x, y) = (0.3, 1.5);
        let values = graph.values(&outputs, |leaf| if leaf == Node::Speed(0) { x } else { y });
        let d: f64 = x - y;
        assert_eq!(values, [d.sin(), d.cos(), d.tanh(), (-d * d).exp(), d.abs(), -1.0, 0.0, d]);
        let sides = [graph.cross([a, b, Expression::Zero], [b, a, Expression::Zero])[2], graph.divide(a, b)];
        let values = graph.values(&sides, |leaf| if leaf == Node::Speed(0) { x } else { y });
        assert_eq!(values, [x * x - y * y, x / y]);
    }
}
