//! The torque of an arm as expressions: Newton-Euler recursion in link frames, written out for one arm.
//!
//! Constants that are zero, and products with them, are omitted. Base parameters have many zeros, so their code is
//! short.

mod load_friction;

use super::expression::{Expression, ExpressionGraph, Function, Node, Vector};
use super::rigid_body::{AXES, JointFrame, LinkMotion, about_axis, link_wrench, name_vector};
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_model::robot::{
    CouplingTerm, FrictionLaw, FrictionTerm, JointIndex, JointKind, Parallelogram, ParameterId,
    ParameterKind, Robot, Spring, SpringForm, StandardParameters,
};

/// Entries of a rotation, and lengths in m, that are this close to 0, 1 or -1 are rounded to it: a right angle in rad
/// has a cosine of 6e-17.
const GEOMETRY_ROUNDING: f64 = 1e-15;

/// A parameter of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct CodeParameter {
    /// Its identity.
    pub id: ParameterId,
    /// Value in the unit of [`ParameterId::unit`].
    pub value: f64,
    /// Standard error in the same unit, if known.
    pub std_error: Option<f64>,
    /// The sum of link parameters that it represents, such as `J2_mPx + 0.27 J3_m`; `None` if it is a link parameter
    /// itself.
    pub stands_for: Option<String>,
}

/// A constant of the code.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Constant {
    /// Name, in capitals.
    pub(super) name: String,
    /// Value; a geometric one is never 0, 1 or -1.
    pub(super) value: f64,
    /// Unit and meaning.
    pub(super) about: String,
}

/// A range of nodes with a heading.
#[derive(Debug)]
pub(super) struct CodeSection {
    /// First node.
    pub(super) start: usize,
    /// Heading.
    pub(super) title: String,
}

/// Nodes, their output for each joint, and headings.
#[derive(Debug)]
pub(super) struct Program {
    /// Joints of the arm.
    pub(super) joints: usize,
    pub(super) graph: ExpressionGraph,
    /// One per joint, Nm (N).
    pub(super) outputs: Vec<Expression>,
    pub(super) sections: Vec<CodeSection>,
}

impl Program {
    fn new(joints: usize) -> Self {
        Self { joints, graph: ExpressionGraph::default(), outputs: Vec::new(), sections: Vec::new() }
    }

    fn section(&mut self, title: String) {
        self.sections.push(CodeSection { start: self.graph.nodes().len(), title });
    }
}

/// Friction and torque of an arm as expressions, with their constants.
#[derive(Debug)]
pub(super) struct TorquePrograms {
    pub(super) constants: Vec<Constant>,
    /// Friction by joint: losses and the offset of the torque signal.
    pub(super) friction: Program,
    /// Torque by joint; reads the friction.
    pub(super) torque: Program,
}

impl TorquePrograms {
    /// Friction and torque of `robot` with the given parameters; those that are missing are zero.
    pub(super) fn new(robot: &Robot, parameters: &[CodeParameter]) -> Self {
        let model = DynamicModel::from_parameters(robot, parameters.iter().map(|of| (of.id, of.value)));
        let grouped_motor_inertia = model.grouped_motor_inertia;
        let mut builder = TorqueBuilder { robot, parameters, grouped_motor_inertia, constants: Vec::new() };
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

struct TorqueBuilder<'a> {
    robot: &'a Robot,
    parameters: &'a [CodeParameter],
    /// Same as in [`DynamicModel::grouped_motor_inertia`].
    grouped_motor_inertia: Vec<f64>,
    constants: Vec<Constant>,
}

impl<'a> TorqueBuilder<'a> {
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

    /// A parameter of the model; zero if the model does not have it.
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

    /// Adds the inertias of all motors, so that they are listed with the other parameters.
    fn motor_inertia(&mut self, graph: &mut ExpressionGraph) {
        let of_kind = |kind| move |of: &&CodeParameter| of.id.kind == kind;
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
        let mut motion = LinkMotion { w: still, dw: still, a: gravity, u: [still; 3] };
        let mut links = Vec::new();
        let mut cranks = Vec::new();
        for (i, parameters) in inertial.iter().enumerate() {
            let number = i + 1;
            program.section(format!("link {number}: motion, force and moment"));
            cranks.extend(self.cranks(&mut program.graph, i, &motion));
            let place = self.place(&mut program.graph, i, None);
            motion = motion.next(&mut program.graph, &place, robot.joints[i].kind, i, None);
            let (force, moment) = link_wrench(&mut program.graph, parameters, &motion);
            links.push((place, force, moment));
        }
        let mut torque = vec![Expression::Zero; links.len()];
        let mut carried = (still, still);
        for (i, (place, force, moment)) in links.iter().enumerate().rev() {
            let number = i + 1;
            let graph = &mut program.graph;
            program.sections.push(CodeSection {
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
            carried = place.carry(graph, (force, moment));
            for (of, place, force, moment) in cranks.iter().filter(|(of, ..)| of.upper_arm.index() == i) {
                let (of, m): (&Parallelogram, usize) = (of, of.forearm.index());
                let of_forearm = if of.sense < 0.0 { moment[2].negated() } else { moment[2] };
                torque[i] = graph.add(torque[i], moment[2]);
                torque[m] = graph.add(torque[m], of_forearm);
                let outer = place.carry(graph, (*force, *moment));
                carried = (graph.add_vectors(carried.0, outer.0), graph.add_vectors(carried.1, outer.1));
            }
        }
        torque
    }

    /// Cranks that turn about the axis of joint `i`, on a link with the motion `motion`: place, force and moment.
    fn cranks(
        &mut self,
        graph: &mut ExpressionGraph,
        i: usize,
        motion: &LinkMotion,
    ) -> Vec<(Parallelogram, JointFrame, Vector, Vector)> {
        let robot = self.robot;
        let own = robot.parallelograms.iter().filter(|of| of.upper_arm.index() == i);
        own.map(|of| {
            let phi = std::array::from_fn(|k| {
                let kind = ParameterKind::Crank(u8::try_from(k).unwrap_or(u8::MAX));
                self.parameter(graph, ParameterId { joint: of.forearm, kind })
            });
            let place = self.place(graph, i, Some(of));
            let motion = motion.next(graph, &place, JointKind::Revolute, i, Some(of));
            let (force, moment) = link_wrench(graph, &phi, &motion);
            (*of, place, force, moment)
        })
        .collect()
    }

    /// Place of joint `i` on the link before, or that of a crank about its axis.
    fn place(&mut self, graph: &mut ExpressionGraph, i: usize, crank: Option<&Parallelogram>) -> JointFrame {
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
                let (q, body) = about_axis(graph, Node::Position, i, crank);
                let (sine, cosine) = (graph.call(Function::Sine, q), graph.call(Function::Cosine, q));
                graph.name(sine, || format!("s{body}"));
                graph.name(cosine, || format!("c{body}"));
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
        JointFrame { r, p, turn }
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

    /// The factor of Coulomb friction at a speed.
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

    /// Torque of a spring; for a cylinder, with lever `a b sin p / l` and length `l`.
    fn spring(&mut self, graph: &mut ExpressionGraph, spring: &Spring) -> Expression {
        let joint = spring.joint;
        let q = graph.leaf(Node::Position(joint.index()));
        let [stiffness, preload] = spring
            .terms()
            .map(|term| self.parameter(graph, ParameterId { joint, kind: ParameterKind::Spring(term) }));
        let SpringForm::Cylinder { pins: [a, b], aligned } = spring.form else {
            let turned = graph.multiply(stiffness, q);
            return graph.add(turned, preload);
        };
        let mut number = |graph: &mut ExpressionGraph, name: &str, value: f64, about: &str| {
            self.length(graph, value, || {
                (format!("J{joint}_{name}"), format!("{about} of the counterbalance of joint {joint}"))
            })
        };
        let aligned = number(graph, "ALIGNED", aligned, "rad; position q at the shortest length");
        let squares =
            number(graph, "PIN_SQUARES", a * a + b * b, "m^2; squares of the distances of both pins");
        let product = number(graph, "PIN_PRODUCT", a * b, "m^2; product of the distances of both pins");
        let shortest = number(graph, "SHORTEST", (a - b).abs(), "m; shortest length");
        let p = graph.subtract(q, aligned);
        let (sine, cosine) = (graph.call(Function::Sine, p), graph.call(Function::Cosine, p));
        let two = graph.leaf(Node::Whole(2));
        let across = graph.multiply(product, cosine);
        let across = graph.multiply(two, across);
        let square = graph.subtract(squares, across);
        let length = graph.call(Function::SquareRoot, square);
        let lever = graph.multiply(product, sine);
        let lever = graph.divide(lever, length);
        let stretch = graph.subtract(length, shortest);
        let pull = graph.multiply(stiffness, stretch);
        let pull = graph.add(preload, pull);
        graph.multiply(pull, lever)
    }

    /// Adds springs, motor inertias, coupled motors and friction to the torque of the links.
    fn motors(&mut self, program: &mut Program, mut torque: Vec<Expression>, friction: &Program) {
        let springs = if self.robot.springs.is_empty() { "" } else { "springs, " };
        program.section(format!("{springs}motors and friction"));
        for spring in &self.robot.springs {
            let j = spring.joint.index();
            let pull = self.spring(&mut program.graph, spring);
            torque[j] = program.graph.add(torque[j], pull);
        }
        // the gear transmits the torque of the springs as well
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
