//! The torque of an arm as expressions: Newton-Euler recursion in link frames, written out for one arm.
//!
//! Constants that are zero, and products with them, are left out. Base parameters have many zeros, which is why their
//! code is short.

mod load_friction;

use super::expression::{Expression, ExpressionGraph, Function, Node, Vector};
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_model::robot::{
    CouplingTerm, FrictionLaw, FrictionTerm, JointIndex, JointKind, ParameterId, ParameterKind, Robot,
    StandardParameters,
};

/// Entries of a rotation, and lengths in m, that are this near to 0, 1 or -1 are taken as such: a right angle in rad
/// has a cosine of 6e-17.
const GEOMETRY_ROUNDING: f64 = 1e-15;

/// Names of the three components.
pub(super) const AXES: [&str; 3] = ["x", "y", "z"];

/// A parameter of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelParameter {
    /// Which one.
    pub id: ParameterId,
    /// Value in the unit of [`ParameterId::unit`].
    pub value: f64,
    /// Standard error in the same unit, where it is known.
    pub std_error: Option<f64>,
    /// The sum of link parameters that it stands for, such as `J2_mPx + 0.27 J3_m`; `None` where it is itself.
    pub stands_for: Option<String>,
}

/// A constant of the code.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Constant {
    /// Name, in capitals.
    pub(super) name: String,
    /// Value, neither 0 nor 1 nor -1 where it is one of geometry.
    pub(super) value: f64,
    /// Unit and meaning.
    pub(super) about: String,
}

/// A stretch of nodes with a heading.
#[derive(Debug)]
pub(super) struct Section {
    /// First node.
    pub(super) start: usize,
    /// Heading.
    pub(super) title: String,
}

/// Nodes, what they yield for each joint, and headings.
#[derive(Debug)]
pub(super) struct Program {
    /// Joints of the arm.
    pub(super) joints: usize,
    pub(super) graph: ExpressionGraph,
    /// One a joint, Nm (N).
    pub(super) outputs: Vec<Expression>,
    pub(super) sections: Vec<Section>,
}

impl Program {
    fn new(joints: usize) -> Self {
        Self { joints, graph: ExpressionGraph::default(), outputs: Vec::new(), sections: Vec::new() }
    }

    fn section(&mut self, title: String) {
        self.sections.push(Section { start: self.graph.nodes().len(), title });
    }
}

/// Friction and torque of an arm as expressions, with their constants.
#[derive(Debug)]
pub(super) struct TorquePrograms {
    pub(super) constants: Vec<Constant>,
    /// Friction by joint: what losses take and what the torque signal has without motion.
    pub(super) friction: Program,
    /// Torque by joint; reads the friction.
    pub(super) torque: Program,
}

impl TorquePrograms {
    /// Friction and torque of `robot` with the given parameters; those that are missing are zero.
    pub(super) fn new(robot: &Robot, parameters: &[ModelParameter]) -> Self {
        let model = DynamicModel::from_parameters(robot, parameters.iter().map(|of| (of.id, of.value)));
        let grouped_motor_inertia = model.grouped_motor_inertia;
        let mut builder = Builder { robot, parameters, grouped_motor_inertia, constants: Vec::new() };
        let inertial: Vec<[Expression; 10]> = Vec::new();
        let mut torque = Program::new(robot.joint_count());
        let inertial = robot.joint_indices().fold(inertial, |mut all, joint| {
            all.push(builder.inertial(&mut torque.graph, joint));
            all
        });
        let friction = builder.friction();
        builder.motor_inertia(&mut torque.graph);
        let rigid = builder.rigid(&mut torque, &inertial);
        builder.motors(&mut torque, rigid, &friction);
        Self { constants: builder.constants, friction, torque }
    }

    /// Torque by joint at a state, from the expressions that the code is written from.
    pub(super) fn torque_at(&self, q: &[f64], qd: &[f64], qdd: &[f64]) -> Vec<f64> {
        let constant = |at: usize| self.constants[at].value;
        let friction = self.friction.graph.values(&self.friction.outputs, |leaf| match leaf {
            Node::Constant(at) => constant(at),
            Node::Speed(j) => qd[j],
            _ => f64::NAN,
        });
        self.torque.graph.values(&self.torque.outputs, |leaf| match leaf {
            Node::Constant(at) => constant(at),
            Node::Position(j) => q[j],
            Node::Speed(j) => qd[j],
            Node::Acceleration(j) => qdd[j],
            Node::Friction(j) => friction[j],
            _ => f64::NAN,
        })
    }
}

struct Builder<'a> {
    robot: &'a Robot,
    parameters: &'a [ModelParameter],
    /// As in [`DynamicModel::grouped_motor_inertia`].
    grouped_motor_inertia: Vec<f64>,
    constants: Vec<Constant>,
}

impl<'a> Builder<'a> {
    /// A number of the geometry.
    fn length(
        &mut self,
        graph: &mut ExpressionGraph,
        value: f64,
        name: impl FnOnce() -> (String, String),
    ) -> Expression {
        if value.abs() < GEOMETRY_ROUNDING {
            return Expression::Zero;
        }
        if (value.abs() - 1.0).abs() < GEOMETRY_ROUNDING {
            let one = graph.leaf(Node::Whole(1));
            return if value < 0.0 { one.negated() } else { one };
        }
        let (name, about) = name();
        self.constant(graph, name, value, about)
    }

    fn constant(
        &mut self,
        graph: &mut ExpressionGraph,
        name: String,
        value: f64,
        about: String,
    ) -> Expression {
        let at = self.constants.iter().position(|known| known.name == name).unwrap_or_else(|| {
            self.constants.push(Constant { name, value, about });
            self.constants.len() - 1
        });
        graph.leaf(Node::Constant(at))
    }

    /// A parameter of the model; zero where the model has none.
    fn parameter(&mut self, graph: &mut ExpressionGraph, id: ParameterId) -> Expression {
        let Some(found) = self.parameters.iter().find(|of| of.id == id && of.value != 0.0) else {
            return Expression::Zero;
        };
        let kind = self.robot.joints[id.joint.index()].kind;
        let mut about = id.unit(kind).to_owned();
        if let Some(error) = found.std_error.filter(|error| error.is_finite()) {
            about += &format!("; standard error {error:.2e}");
        }
        if let Some(formula) = &found.stands_for {
            about += &format!("; {formula}");
        }
        self.constant(graph, id.to_string().to_uppercase(), found.value, about)
    }

    fn inertial(&mut self, graph: &mut ExpressionGraph, joint: JointIndex) -> [Expression; 10] {
        std::array::from_fn(|k| {
            let kind = ParameterKind::Inertial(u8::try_from(k).unwrap_or(u8::MAX));
            debug_assert!(k < StandardParameters::COUNT);
            self.parameter(graph, ParameterId { joint, kind })
        })
    }

    /// Enters the inertias of all motors, so that they stand with the other parameters.
    fn motor_inertia(&mut self, graph: &mut ExpressionGraph) {
        let of_kind = |kind| move |of: &&ModelParameter| of.id.kind == kind;
        for kind in [ParameterKind::MotorInertia, ParameterKind::Coupling(CouplingTerm::Inertia)] {
            for of in self.parameters.iter().filter(of_kind(kind)) {
                self.parameter(graph, of.id);
            }
        }
    }

    /// Torque of the rigid links by joint.
    fn rigid(&mut self, program: &mut Program, inertial: &[[Expression; 10]]) -> Vec<Expression> {
        let robot = self.robot;
        let gravity = [0, 1, 2].map(|k| {
            let about = || {
                (format!("GRAVITY_{}", AXES[k].to_uppercase()), "m/s^2; gravity in the base frame".to_owned())
            };
            self.length(&mut program.graph, robot.gravity[k], about).negated()
        });
        let still = [Expression::Zero; 3];
        let mut motion = Motion { w: still, dw: still, a: gravity, u: [still; 3] };
        let mut links = Vec::new();
        for (i, parameters) in inertial.iter().enumerate() {
            let number = i + 1;
            program.section(format!("link {number}: motion, force and moment"));
            let place = self.place(&mut program.graph, i);
            motion = motion.next(&mut program.graph, &place, robot.joints[i].kind, i);
            let (force, moment) = link_wrench(&mut program.graph, parameters, &motion);
            links.push((place, force, moment));
        }
        let mut torque = vec![Expression::Zero; links.len()];
        let mut carried = (still, still);
        for (i, (place, force, moment)) in links.iter().enumerate().rev() {
            let number = i + 1;
            let graph = &mut program.graph;
            program.sections.push(Section {
                start: graph.nodes().len(),
                title: format!("joint {number}: what it carries"),
            });
            let force = graph.add_vectors(*force, carried.0);
            let moment = graph.add_vectors(*moment, carried.1);
            name_vector(graph, force, |axis| format!("f{number}{axis}"));
            name_vector(graph, moment, |axis| format!("n{number}{axis}"));
            torque[i] = match robot.joints[i].kind {
                JointKind::Revolute => moment[2],
                JointKind::Prismatic => force[2],
            };
            let outer_force = place.to_outer(graph, force);
            let outer_moment = place.to_outer(graph, moment);
            let lever = graph.cross(place.p, outer_force);
            carried = (outer_force, graph.add_vectors(outer_moment, lever));
        }
        torque
    }

    /// Place of joint `i` on the link before.
    fn place(&mut self, graph: &mut ExpressionGraph, i: usize) -> Place {
        let robot: &'a Robot = self.robot;
        let (joint, number) = (&robot.joints[i], i + 1);
        let placement = joint.geometry.placement();
        let r = [0, 1, 2].map(|row| {
            [0, 1, 2].map(|column| {
                let about = || {
                    (
                        format!("R{number}_{}{}", AXES[row], AXES[column]).to_uppercase(),
                        format!("turn of joint {number} at position 0 on the link before"),
                    )
                };
                self.length(graph, placement.rotation[(row, column)], about)
            })
        });
        let mut p = [0, 1, 2].map(|axis| {
            let about = || {
                (
                    format!("P{number}_{}", AXES[axis]).to_uppercase(),
                    format!("m; place of joint {number} on the link before"),
                )
            };
            self.length(graph, placement.translation[axis], about)
        });
        let turn = match joint.kind {
            JointKind::Revolute => {
                let q = graph.leaf(Node::Position(i));
                let (sine, cosine) = (graph.call(Function::Sine, q), graph.call(Function::Cosine, q));
                graph.name(sine, || format!("s{number}"));
                graph.name(cosine, || format!("c{number}"));
                Some((sine, cosine))
            }
            JointKind::Prismatic => {
                let q = graph.leaf(Node::Position(i));
                p = [0, 1, 2].map(|axis| {
                    let slide = graph.multiply(r[axis][2], q);
                    graph.add(p[axis], slide)
                });
                name_vector(graph, p, |axis| format!("p{number}{axis}"));
                None
            }
        };
        Place { r, p, turn }
    }

    /// Friction of each joint with the coupled motors' parts.
    fn friction(&mut self) -> Program {
        let mut program = Program::new(self.robot.joint_count());
        let graph = &mut program.graph;
        let mut outputs: Vec<Expression> =
            self.robot.joint_indices().map(|joint| self.joint_friction(graph, joint)).collect();
        for coupling in &self.robot.couplings {
            let (j, m) = (coupling.joint.index(), coupling.motor_joint.index());
            let ratio = self.ratio(graph, coupling.motor_joint, coupling.ratio);
            let of = |term| ParameterId { joint: coupling.motor_joint, kind: ParameterKind::Coupling(term) };
            let viscous = self.parameter(graph, of(CouplingTerm::Viscous));
            let coulomb = self.parameter(graph, of(CouplingTerm::Coulomb));
            let speed = [j, m].map(|k| graph.leaf(Node::Speed(k)));
            let turned = graph.multiply(ratio, speed[0]);
            let motor_speed = graph.add(turned, speed[1]);
            let law = self.robot.friction_of(coupling.motor_joint).law;
            let sign = self.sign(graph, coupling.motor_joint, law, motor_speed);
            let loss = graph.multiply(coulomb, sign);
            let shared = graph.multiply(viscous, ratio);
            for (joint, other, share) in [(j, speed[1], graph.multiply(ratio, loss)), (m, speed[0], loss)] {
                let drag = graph.multiply(shared, other);
                let sum = graph.add(drag, share);
                outputs[joint] = graph.add(outputs[joint], sum);
            }
        }
        program.outputs = outputs;
        program
    }

    fn joint_friction(&mut self, graph: &mut ExpressionGraph, joint: JointIndex) -> Expression {
        let model = self.robot.friction_of(joint);
        let v = graph.leaf(Node::Speed(joint.index()));
        let terms = model.terms();
        let parameters: Vec<Expression> = terms
            .iter()
            .map(|&term| self.parameter(graph, ParameterId { joint, kind: ParameterKind::Friction(term) }))
            .collect();
        let [a, b, c, d] = std::array::from_fn(|k| parameters.get(k).copied().unwrap_or(Expression::Zero));
        match (model.law, model.asymmetric) {
            (FrictionLaw::None, _) => Expression::Zero,
            (FrictionLaw::Polynomial, _) => {
                let sign = graph.call(Function::Sign, v);
                let speed = graph.call(Function::Magnitude, v);
                let (cubic, coulomb) = (graph.multiply(d, speed), graph.multiply(a, sign));
                let bend = graph.add(c, cubic);
                let bend = graph.multiply(bend, speed);
                let slope = graph.add(b, bend);
                let drag = graph.multiply(slope, v);
                graph.add(coulomb, drag)
            }
            (law, false) => {
                let sign = self.sign(graph, joint, law, v);
                let (coulomb, drag) = (graph.multiply(a, sign), graph.multiply(b, v));
                graph.sum([coulomb, drag, c])
            }
            (law, true) => {
                debug_assert_eq!(terms.first(), Some(&FrictionTerm::CoulombPositive));
                let sign = self.sign(graph, joint, law, v);
                let parts = [
                    (a, Function::PositivePart, sign),
                    (b, Function::NegativePart, sign),
                    (c, Function::PositivePart, v),
                    (d, Function::NegativePart, v),
                ];
                let parts = parts.map(|(parameter, part, of)| {
                    let part = graph.call(part, of);
                    graph.multiply(parameter, part)
                });
                graph.sum(parts)
            }
        }
    }

    /// What Coulomb friction is multiplied by at a speed.
    fn sign(
        &mut self,
        graph: &mut ExpressionGraph,
        joint: JointIndex,
        law: FrictionLaw,
        speed: Expression,
    ) -> Expression {
        match law {
            FrictionLaw::Smooth { speed: scale } => {
                let unit = match self.robot.joints[joint.index()].kind {
                    JointKind::Revolute => "rad/s",
                    JointKind::Prismatic => "m/s",
                };
                let name = format!("J{joint}_SMOOTH_SPEED");
                let about = format!("{unit}; friction turns over within a few of it");
                let scale = self.constant(graph, name, scale, about);
                let ratio = graph.divide(speed, scale);
                graph.call(Function::Tanh, ratio)
            }
            _ => graph.call(Function::Sign, speed),
        }
    }

    fn ratio(&mut self, graph: &mut ExpressionGraph, motor: JointIndex, ratio: f64) -> Expression {
        self.length(graph, ratio, || {
            (
                format!("J{motor}_COUPLING"),
                format!("turns of motor {motor} with the other joint, per own turn"),
            )
        })
    }

    /// Adds motor inertias, coupled motors and friction to the torque of the links.
    fn motors(&mut self, program: &mut Program, mut torque: Vec<Expression>, friction: &Program) {
        program.section("motors and friction".to_owned());
        let losses: Vec<Expression> = self
            .robot
            .joint_indices()
            .map(|joint| self.load_friction(&mut program.graph, joint, torque[joint.index()]))
            .collect();
        let graph = &mut program.graph;
        let accelerations: Vec<Expression> =
            (0..torque.len()).map(|j| graph.leaf(Node::Acceleration(j))).collect();
        if self.robot.has_motor_inertia() {
            for joint in self.robot.joint_indices() {
                let id = ParameterId { joint, kind: ParameterKind::MotorInertia };
                let inertia = self.parameter(graph, id);
                let own = graph.multiply(inertia, accelerations[joint.index()]);
                torque[joint.index()] = graph.add(torque[joint.index()], own);
            }
        }
        for coupling in &self.robot.couplings {
            let (j, m) = (coupling.joint.index(), coupling.motor_joint.index());
            let kind = ParameterKind::Coupling(CouplingTerm::Inertia);
            let inertia = self.parameter(graph, ParameterId { joint: coupling.motor_joint, kind });
            let ratio = self.ratio(graph, coupling.motor_joint, coupling.ratio);
            let shared = graph.multiply(inertia, ratio);
            for (joint, other) in [(j, m), (m, j)] {
                let part = graph.multiply(shared, accelerations[other]);
                torque[joint] = graph.add(torque[joint], part);
            }
        }
        for (j, loss) in friction.outputs.iter().enumerate().filter(|(_, of)| **of != Expression::Zero) {
            debug_assert!(*loss != Expression::Zero);
            let loss = graph.leaf(Node::Friction(j));
            torque[j] = graph.add(torque[j], loss);
        }
        for (torque, loss) in torque.iter_mut().zip(losses) {
            *torque = graph.add(*torque, loss);
        }
        program.outputs = torque;
    }
}

/// A joint's frame in the frame of the link before it.
struct Place {
    /// Rotation at position 0, row by row.
    r: [Vector; 3],
    /// Origin.
    p: Vector,
    /// Sine and cosine of the position of a joint that turns.
    turn: Option<(Expression, Expression)>,
}

impl Place {
    /// `R' v`: the constant turn first, which is often a mere exchange of axes.
    fn to_inner(&self, graph: &mut ExpressionGraph, v: Vector) -> Vector {
        let [x, y, z] = [0, 1, 2].map(|column| graph.dot([0, 1, 2].map(|row| self.r[row][column]), v));
        let Some((s, c)) = self.turn else { return [x, y, z] };
        let (cx, sy) = (graph.multiply(c, x), graph.multiply(s, y));
        let (cy, sx) = (graph.multiply(c, y), graph.multiply(s, x));
        [graph.add(cx, sy), graph.subtract(cy, sx), z]
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
struct Motion {
    /// Angular velocity.
    w: Vector,
    /// Angular acceleration.
    dw: Vector,
    /// Acceleration of the origin.
    a: Vector,
    /// `[dw] + [w][w]` row by row: what a point of the link is accelerated by, per metre from the origin.
    u: [Vector; 3],
}

impl Motion {
    fn next(&self, graph: &mut ExpressionGraph, place: &Place, kind: JointKind, i: usize) -> Self {
        let number = i + 1;
        let (qd, qdd) = (graph.leaf(Node::Speed(i)), graph.leaf(Node::Acceleration(i)));
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

/// Force and moment about the frame's origin: `m a + u mP` and `I dw + w x I w + mP x a`, the latter written with the
/// entries of `u`, whose products it shares.
fn link_wrench(
    graph: &mut ExpressionGraph,
    parameters: &[Expression; 10],
    motion: &Motion,
) -> (Vector, Vector) {
    let [m, px, py, pz, xx, xy, xz, yy, yz, zz] = *parameters;
    let (Motion { w, dw, a, u }, first_moment) = (motion, [px, py, pz]);
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

fn name_vector(graph: &mut ExpressionGraph, of: Vector, name: impl Fn(&str) -> String) {
    for (component, axis) in of.into_iter().zip(AXES) {
        graph.name(component, || name(axis));
    }
}
