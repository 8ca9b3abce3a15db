//! Frames, motion and torque of rigid bodies as expressions.

use super::expression::{Expression, ExpressionGraph, Node, Vector};
use armwatch_model::robot::{JointKind, Parallelogram};

/// Names of the three components.
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// A joint's frame in the frame of the link before it.
pub(super) struct JointFrame {
    /// Rotation at position 0, row by row.
    pub(super) r: [Vector; 3],
    /// Origin.
    pub(super) p: Vector,
    /// Sine and cosine of the position of a joint that turns.
    pub(super) turn: Option<(Expression, Expression)>,
}

impl JointFrame {
    /// `R' v`: the constant rotation first, which is often a mere exchange of axes.
    fn to_inner(&self, graph: &mut ExpressionGraph, v: Vector) -> Vector {
        let [x, y, z] = [0, 1, 2].map(|column| graph.dot([0, 1, 2].map(|row| self.r[row][column]), v));
        let Some((s, c)) = self.turn else { return [x, y, z] };
        let (cx, sy) = (graph.multiply(c, x), graph.multiply(s, y));
        let (cy, sx) = (graph.multiply(c, y), graph.multiply(s, x));
        [graph.add(cx, sy), graph.subtract(cy, sx), z]
    }

    /// Force and moment on the link before, about its own origin.
    pub(super) fn carry(
        &self,
        graph: &mut ExpressionGraph,
        (force, moment): (Vector, Vector),
    ) -> (Vector, Vector) {
        let (force, moment) = (self.to_outer(graph, force), self.to_outer(graph, moment));
        let lever = graph.cross(self.p, force);
        (force, graph.add_vectors(moment, lever))
    }

    /// `R v`.
    fn to_outer(&self, graph: &mut ExpressionGraph, v: Vector) -> Vector {
        let turned = match self.turn {
            None => v,
            Some((s, c)) => {
                let (cx, sy) = (graph.multiply(c, v[0]), graph.multiply(s, v[1]));
                let (cy, sx) = (graph.multiply(c, v[1]), graph.multiply(s, v[0]));
                [graph.subtract(cx, sy), graph.add(cy, sx), v[2]]
            }
        };
        [0, 1, 2].map(|row| graph.dot(self.r[row], turned))
    }
}

/// Motion of a link in its own frame, with gravity as an acceleration of the base.
pub(super) struct LinkMotion {
    /// Angular velocity.
    pub(super) w: Vector,
    /// Angular acceleration.
    pub(super) dw: Vector,
    /// Acceleration of the origin.
    pub(super) a: Vector,
    /// `[dw] + [w][w]` row by row: acceleration of a point of the link per metre from the origin.
    pub(super) u: [Vector; 3],
}

impl LinkMotion {
    pub(super) fn next(
        &self,
        graph: &mut ExpressionGraph,
        place: &JointFrame,
        kind: JointKind,
        i: usize,
        crank: Option<&Parallelogram>,
    ) -> Self {
        let (qd, number) = about_axis(graph, Node::Speed, i, crank);
        let (qdd, _) = about_axis(graph, Node::Acceleration, i, crank);
        let lever = [0, 1, 2].map(|row| graph.dot(self.u[row], place.p));
        let at_joint = graph.add_vectors(self.a, lever);
        let carried = place.to_inner(graph, self.w);
        let mut dw = place.to_inner(graph, self.dw);
        let mut a = place.to_inner(graph, at_joint);
        let (along_x, along_y) = (graph.multiply(carried[1], qd), graph.multiply(carried[0], qd).negated());
        let mut w = carried;
        match kind {
            JointKind::Revolute => {
                w[2] = graph.add(carried[2], qd);
                dw = graph.add_vectors(dw, [along_x, along_y, qdd]);
            }
            JointKind::Prismatic => {
                let two = graph.leaf(Node::Whole(2));
                let twice = [along_x, along_y].map(|part| graph.multiply(two, part));
                a = graph.add_vectors(a, [twice[0], twice[1], qdd]);
            }
        }
        name_vector(graph, w, |axis| format!("w{number}{axis}"));
        name_vector(graph, dw, |axis| format!("dw{number}{axis}"));
        name_vector(graph, a, |axis| format!("a{number}{axis}"));
        let u = accelerations_per_metre(graph, w, dw);
        for (row, of_row) in u.iter().enumerate() {
            name_vector(graph, *of_row, |axis| format!("u{number}{}{axis}", AXES[row]));
        }
        Self { w, dw, a, u }
    }
}

/// Position, speed or acceleration of joint `i`, or of a crank about its axis, and the suffix of the body's names.
pub(super) fn about_axis(
    graph: &mut ExpressionGraph,
    node: impl Fn(usize) -> Node,
    i: usize,
    crank: Option<&Parallelogram>,
) -> (Expression, String) {
    let own = graph.leaf(node(i));
    let Some(of) = crank else { return (own, format!("{}", i + 1)) };
    let forearm = graph.leaf(node(of.forearm.index()));
    let sum = if of.sense < 0.0 { graph.subtract(own, forearm) } else { graph.add(own, forearm) };
    (sum, format!("_crank{}", of.forearm))
}

/// `[dw] + [w][w]`, row by row.
fn accelerations_per_metre(graph: &mut ExpressionGraph, w: Vector, dw: Vector) -> [Vector; 3] {
    let [xx, yy, zz] = [0, 1, 2].map(|k| graph.multiply(w[k], w[k]));
    let (xy, xz, yz) = (graph.multiply(w[0], w[1]), graph.multiply(w[0], w[2]), graph.multiply(w[1], w[2]));
    [
        [graph.add(yy, zz).negated(), graph.subtract(xy, dw[2]), graph.add(xz, dw[1])],
        [graph.add(xy, dw[2]), graph.add(xx, zz).negated(), graph.subtract(yz, dw[0])],
        [graph.subtract(xz, dw[1]), graph.add(yz, dw[0]), graph.add(xx, yy).negated()],
    ]
}

/// Force and moment about the frame's origin: `m a + u mP` and `I dw + w x I w + mP x a`, the latter expressed by the
/// entries of `u`, whose products it shares.
pub(super) fn link_wrench(
    graph: &mut ExpressionGraph,
    parameters: &[Expression; 10],
    motion: &LinkMotion,
) -> (Vector, Vector) {
    let [m, px, py, pz, xx, xy, xz, yy, yz, zz] = *parameters;
    let (LinkMotion { w, dw, a, u }, first_moment) = (motion, [px, py, pz]);
    let force = [0, 1, 2].map(|row| {
        let (weight, swing) = (graph.multiply(m, a[row]), graph.dot(u[row], first_moment));
        graph.add(weight, swing)
    });
    // u_yy - u_zz = w_y^2 - w_z^2, and so on; one of the moment's products of inertia takes each
    let spread = [(1, 2), (2, 0), (0, 1)].map(|(j, k)| graph.subtract(u[j][j], u[k][k]));
    let gyration = [(1, 2), (2, 0), (0, 1)].map(|(j, k)| graph.multiply(w[j], w[k]));
    let turn = [
        [(xx, dw[0]), (xz, u[1][0]), (xy, u[2][0].negated()), (yz, spread[0])],
        [(yy, dw[1]), (xy, u[2][1]), (yz, u[0][1].negated()), (xz, spread[1])],
        [(zz, dw[2]), (yz, u[0][2]), (xz, u[1][2].negated()), (xy, spread[2])],
    ];
    let differences = [graph.subtract(zz, yy), graph.subtract(xx, zz), graph.subtract(yy, xx)];
    let lever = graph.cross(first_moment, *a);
    let moment = [0, 1, 2].map(|row| {
        let mut terms = turn[row].map(|(inertia, of)| graph.multiply(inertia, of)).to_vec();
        terms.push(graph.multiply(differences[row], gyration[row]));
        terms.push(lever[row]);
        graph.sum(terms)
    });
    (force, moment)
}

pub(super) fn name_vector(graph: &mut ExpressionGraph, of: Vector, name: impl Fn(&str) -> String) {
    for (component, axis) in of.into_iter().zip(AXES) {
        graph.name(component, || name(axis));
    }
}
