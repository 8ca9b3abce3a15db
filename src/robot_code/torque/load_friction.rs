//! Friction that depends on the torque that a gear carries.

use super::TorqueBuilder;
use crate::robot_code::expression::{Expression, ExpressionGraph, Function, Node};
use armwatch_model::robot::{JointIndex, LoadFriction, ParameterId, ParameterKind};

impl TorqueBuilder<'_> {
    /// Friction of a joint from the torque that its gear carries; `links` is that of the links with the motor's inertia
    /// where base parameters have it in them.
    pub(super) fn load_friction(
        &mut self,
        graph: &mut ExpressionGraph,
        joint: JointIndex,
        links: Expression,
    ) -> Expression {
        let model = self.robot.friction_of(joint);
        let i = joint.index();
        let values =
            model.load.terms().iter().map(|&term| {
                self.parameter(graph, ParameterId { joint, kind: ParameterKind::Friction(term) })
            });
        let values: Vec<Expression> = values.collect();
        if values.iter().all(|value| *value == Expression::Zero) {
            return Expression::Zero;
        }
        let [first, second] = std::array::from_fn(|k| values.get(k).copied().unwrap_or(Expression::Zero));
        let mut load = links;
        let grouped = self.grouped_motor_inertia[i];
        if grouped != 0.0 {
            let name = format!("J{joint}_I_M_IN_LINKS");
            let about =
                "motor inertia that the parameters of the links contain, by the description".to_owned();
            let inertia = self.constant(graph, name, grouped, about);
            let acceleration = graph.leaf(Node::Acceleration(i));
            let own = graph.multiply(inertia, acceleration);
            load = graph.subtract(load, own);
        }
        let v = graph.leaf(Node::Speed(i));
        let sign = self.sign(graph, joint, model.law, v);
        let magnitude = graph.call(Function::Magnitude, load);
        if model.load == LoadFriction::Directional {
            let moves = graph.call(Function::Magnitude, sign);
            let (both, difference) = (graph.multiply(magnitude, sign), graph.multiply(load, moves));
            let (both, difference) = (graph.multiply(first, both), graph.multiply(second, difference));
            return graph.add(both, difference);
        }
        let more = match model.load {
            LoadFriction::Stribeck { speed } => {
                let name = format!("J{joint}_LOAD_SPEED");
                let about =
                    "friction under load falls within a few of it from that at a standstill".to_owned();
                let scale = self.constant(graph, name, speed, about);
                let ratio = graph.divide(v, scale);
                graph.call(Function::Bell, ratio)
            }
            _ => magnitude,
        };
        let more = graph.multiply(second, more);
        let friction = graph.add(first, more);
        let along = graph.multiply(magnitude, sign);
        graph.multiply(friction, along)
    }
}
