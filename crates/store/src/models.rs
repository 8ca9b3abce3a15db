//! Descriptions of arms, and the meaning of their parameters.

use std::collections::HashMap;

use sqlx::{QueryBuilder, Row};

use super::values::{ROWS_PER_STATEMENT, grouping_terms, joint_number, parameter};
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use armwatch_model::robot::{
    FrictionModel, GeometrySource, Joint, JointKind, ParameterId, Robot, SpringForm, TorqueSensors,
};

/// A parameter of a description in the database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelParameter {
    /// Unit of its values.
    pub unit: String,
    /// Sum of standard parameters that it represents; unknown until the description was analysed.
    pub grouping: Option<String>,
}

impl Store {
    /// Stores the sums of standard parameters that the base parameters of a description represent.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a parameter of a joint that the robot does not have.
    pub async fn describe_model(
        &self,
        robot: &Robot,
        groupings: &[(ParameterId, String)],
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let wanted: Vec<ParameterId> = groupings.iter().map(|(id, _)| *id).collect();
        let model = self.checked(robot_model_id(&mut transaction, robot).await)?;
        let keys = self.checked(ensure_parameters(&mut transaction, model, robot, &wanted).await)?;
        for (key, grouping) in groupings.iter().filter_map(|(id, text)| Some((keys.get(id)?, text))) {
            self.checked(set_grouping(&mut *transaction, *key, grouping).await)?;
        }
        self.commit(transaction).await
    }

    /// Unit and grouping of each parameter of a description.
    pub async fn model_parameters(
        &self,
        model: &StoredModel,
    ) -> Result<HashMap<ParameterId, ModelParameter>, StoreError> {
        self.checked(parameters(&self.readers, model.robot_model_id).await)
    }

    /// The sum of standard parameters that each parameter of a description represents, as coefficients and parameters.
    /// Parameters with an unknown sum are omitted.
    pub async fn model_groupings(
        &self,
        model: &StoredModel,
    ) -> Result<HashMap<ParameterId, Vec<(f64, ParameterId)>>, StoreError> {
        let parameters = self.model_parameters(model).await?.into_iter();
        Ok(parameters.filter_map(|(id, of)| Some((id, grouping_terms(&of.grouping?)))).collect())
    }
}

/// Unit and grouping of each parameter of a model.
pub(super) async fn parameters(
    executor: impl EngineExecutor<'_>,
    robot_model_id: i64,
) -> sqlx::Result<HashMap<ParameterId, ModelParameter>> {
    let rows =
        sqlx::query("SELECT joint, name, unit, grouping FROM model_parameter WHERE robot_model_id = $1")
            .bind(robot_model_id)
            .try_map(|row: EngineRow| {
                let of = ModelParameter { unit: row.try_get("unit")?, grouping: row.try_get("grouping")? };
                Ok((parameter(&row, "joint", "name")?, of))
            })
            .fetch_all(executor)
            .await?;
    Ok(rows.into_iter().collect())
}

/// Key of the description, which is inserted if it is new.
pub(super) async fn robot_model_id(connection: &mut EngineConnection, robot: &Robot) -> sqlx::Result<i64> {
    let hash = description_hash(robot);
    if let Some(id) = find_model(&mut *connection, &robot.model, &hash).await? {
        return Ok(id);
    }
    sqlx::query_scalar(
        "INSERT INTO robot_model (name, description_hash) VALUES ($1, $2) RETURNING robot_model_id",
    )
    .bind_all((&robot.model, &hash[..]))
    .fetch_one(connection)
    .await
}

/// Keys of the model's parameters; new ones among `wanted` are inserted.
pub(super) async fn ensure_parameters(
    connection: &mut EngineConnection,
    robot_model_id: i64,
    robot: &Robot,
    wanted: &[ParameterId],
) -> sqlx::Result<HashMap<ParameterId, i64>> {
    let known = parameter_keys(&mut *connection, robot_model_id).await?;
    let mut missing = Vec::new();
    for id in wanted.iter().filter(|id| !known.contains_key(id)) {
        missing.push((*id, unit(robot, *id)?));
    }
    if missing.is_empty() {
        return Ok(known);
    }
    for rows in missing.chunks(ROWS_PER_STATEMENT) {
        insert_parameters(&mut *connection, robot_model_id, rows).await?;
    }
    parameter_keys(connection, robot_model_id).await
}

/// Keys of the model's parameters.
pub(super) async fn parameter_keys(
    executor: impl EngineExecutor<'_>,
    robot_model_id: i64,
) -> sqlx::Result<HashMap<ParameterId, i64>> {
    let rows =
        sqlx::query("SELECT model_parameter_id, joint, name FROM model_parameter WHERE robot_model_id = $1")
            .bind(robot_model_id)
            .try_map(|row: EngineRow| {
                Ok((parameter(&row, "joint", "name")?, row.try_get("model_parameter_id")?))
            })
            .fetch_all(executor)
            .await?;
    Ok(rows.into_iter().collect())
}

/// Keys of the parameters of the description that a run was analysed with.
pub(super) async fn parameter_keys_of_run(
    connection: &mut EngineConnection,
    run_id: i64,
) -> sqlx::Result<HashMap<ParameterId, i64>> {
    let model: Option<i64> = sqlx::query_scalar("SELECT robot_model_id FROM run WHERE run_id = $1")
        .bind(run_id)
        .fetch_one(&mut *connection)
        .await?;
    match model {
        Some(model) => parameter_keys(connection, model).await,
        None => Ok(HashMap::new()),
    }
}

/// Stores the sum of standard parameters that a base parameter represents.
async fn set_grouping(
    executor: impl EngineExecutor<'_>,
    model_parameter_id: i64,
    grouping: &str,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE model_parameter SET grouping = $1 WHERE model_parameter_id = $2")
        .bind_all((grouping, model_parameter_id))
        .run(executor)
        .await
}

async fn find_model(
    executor: impl EngineExecutor<'_>,
    name: &str,
    hash: &[u8; 32],
) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar("SELECT robot_model_id FROM robot_model WHERE name = $1 AND description_hash = $2")
        .bind_all((name, &hash[..]))
        .fetch_optional(executor)
        .await
}

async fn insert_parameters(
    executor: impl EngineExecutor<'_>,
    robot_model_id: i64,
    rows: &[(ParameterId, &'static str)],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new("INSERT INTO model_parameter (robot_model_id, joint, name, unit) ")
        .push_values(rows, |mut row, (id, unit)| {
            row.bind_all((robot_model_id, joint_number(id.joint), id.name(), *unit));
        })
        .build()
        .run(executor)
        .await
}

fn unit(robot: &Robot, id: ParameterId) -> sqlx::Result<&'static str> {
    let joint = robot.joints.get(id.joint.index()).ok_or_else(|| {
        sqlx::Error::Encode(format!("parameter {id} of a robot with {} joints", robot.joint_count()).into())
    })?;
    Ok(id.unit(joint.kind))
}

/// Resolution of placements, in metres or components of unit vectors. Placements of URDF joints are products of many
/// steps, which another machine may round differently; for an arm this difference is irrelevant.
const PLACEMENT_GRAIN: f64 = 1e-9;

/// Hash that distinguishes descriptions in the database. It includes everything that determines the meaning of base
/// parameters: joint kinds, geometry, gravity, friction columns, couplings, springs and parallelograms. Compare
/// [`StoredModel::description_hash`].
pub fn description_hash(robot: &Robot) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    let mut add = |value: f64| {
        hasher.update(&value.to_le_bytes());
    };
    robot.gravity.iter().copied().for_each(&mut add);
    for joint in &robot.joints {
        add_joint(joint, &mut add);
    }
    // The default friction columns add nothing, so that the hashes of older descriptions stay the same.
    if robot.friction != FrictionModel::POLYNOMIAL {
        robot.friction.numbers().into_iter().for_each(&mut add);
    }
    for joint in robot.joint_indices() {
        let model = robot.friction_of(joint);
        if model != robot.friction {
            let number = -(joint.number() as f64);
            [number].into_iter().chain(model.numbers()).for_each(&mut add);
        }
    }
    if robot.torque_sensors == TorqueSensors::Link {
        add(f64::from(u8::MAX));
    }
    for coupling in &robot.couplings {
        let joints = [coupling.joint, coupling.motor_joint].map(|joint| joint.number() as f64);
        joints.into_iter().chain([coupling.ratio]).for_each(&mut add);
    }
    // Numbers that begin nothing above distinguish springs and cranks from couplings.
    for spring in &robot.springs {
        let form = match spring.form {
            SpringForm::Direct => [0.0; 3],
            SpringForm::Cylinder { pins: [a, b], aligned } => [a, b, aligned],
        };
        [0.25, spring.joint.number() as f64].into_iter().chain(form).for_each(&mut add);
    }
    for of in &robot.parallelograms {
        [0.5, of.forearm.number() as f64].into_iter().for_each(&mut add);
    }
    *hasher.finalize().as_bytes()
}

/// Hash of all parts of a description that the results of a run depend on: [`description_hash`], and the conversion of
/// recorded rows to positions, speeds, torques and friction levels. Tests with different hashes are not comparable.
pub(super) fn figures_hash(robot: &Robot) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&description_hash(robot));
    let mut add = |value: f64| {
        hasher.update(&value.to_le_bytes());
    };
    // an unknown constant differs from any known one
    let known = |value: Option<f64>| value.unwrap_or(f64::NAN);
    for joint in &robot.joints {
        let constants =
            [joint.drive_gain, joint.motor_torque_constant, joint.rated_motor_torque, joint.rated_torque];
        let scales = [joint.gear_ratio, joint.position_offset, joint.limits.velocity, joint.low_speed];
        scales.into_iter().chain(constants.map(known)).for_each(&mut add);
    }
    robot.transmission.iter().copied().for_each(&mut add);
    robot.speed_levels.iter().copied().for_each(&mut add);
    *hasher.finalize().as_bytes()
}

fn add_joint(joint: &Joint, add: &mut impl FnMut(f64)) {
    let kind = match joint.kind {
        JointKind::Revolute => 0.0,
        JointKind::Prismatic => 1.0,
    };
    match joint.geometry.source() {
        GeometrySource::ModifiedDh(row) => {
            [kind, row.a, row.alpha, row.d, row.theta_offset].into_iter().for_each(add);
        }
        GeometrySource::StandardDh(row) => {
            [kind + 2.0, row.a, row.alpha, row.d, row.theta_offset].into_iter().for_each(add);
        }
        GeometrySource::Urdf(_) => {
            let placement = joint.geometry.placement();
            let numbers = placement.rotation.iter().chain(placement.translation.iter());
            add(kind + 4.0);
            // Adding zero makes a negative zero positive.
            numbers.for_each(|x| add((x / PLACEMENT_GRAIN).round() + 0.0));
        }
    }
}

/// A description in the database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredModel {
    /// Database key.
    pub robot_model_id: i64,
    /// Name of the model, such as `er3a`.
    pub name: String,
    /// Result of [`description_hash`].
    pub description_hash: Vec<u8>,
}

impl StoredModel {
    /// Returns true if `robot` agrees in everything that determines base parameters, so that both have the same base
    /// parameters.
    pub fn describes(&self, robot: &Robot) -> bool {
        self.description_hash == description_hash(robot)
    }
}
