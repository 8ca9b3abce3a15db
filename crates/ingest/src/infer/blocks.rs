//! The joints' columns of an export without names: positions, velocities and accelerations follow from each other by
//! derivation, and torques are in the remaining block.

use super::head::Head;
use super::joints::{ACCELERATION, Joints, QuantityColumns, is_derivative_of_all, is_still, rises, values};
use super::names::NameMeaning;
use super::proposal::Hints;
use super::sets::list;
use super::{stages, units};
use armwatch_model::robot::Robot;

/// Most columns from a position to its velocity.
const FARTHEST: usize = 64;

/// Most columns that are compared with each other: every pair costs a pass over the rows.
const MOST_COLUMNS: usize = 256;

/// Numbers that are compared over all pairs of columns.
const MOST_NUMBERS: usize = 200_000_000;

/// Blocks of positions and of their derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
struct MotionBlocks {
    position: usize,
    velocity: usize,
    joints: usize,
}

/// The joints' columns by their relations, otherwise by their position.
pub(super) fn by_motion<'h>(head: &'h Head, hints: Hints<'_>) -> Joints<'h> {
    let columns: Vec<Option<&[f64]>> = head.columns.iter().map(values).collect();
    let known = hints.robot.map(Robot::joint_count);
    if let Some(blocks) = blocks(&columns, head.rows, known) {
        return of_blocks(head, &columns, blocks, known.is_some());
    }
    known.map_or_else(Joints::default, |joints| by_place(head, &columns, joints))
}

/// Finds the blocks of positions and of their derivatives.
fn blocks(columns: &[Option<&[f64]>], rows: usize, known: Option<usize>) -> Option<MotionBlocks> {
    let width = columns.len().min(MOST_COLUMNS);
    let reach = FARTHEST.min(width.saturating_sub(1));
    let rows = rows.min(MOST_NUMBERS / (width * reach).max(1));
    let moves = |at: usize| columns[at].filter(|values| !rises(Some(values)) && !is_still(values));
    let follows = |at: usize, distance: usize| {
        let other = columns.get(at + distance)?;
        Some(match (columns[at], *other) {
            // a joint at rest contradicts nothing
            (Some(position), Some(velocity)) if is_still(position) && is_still(velocity) => Link::AtRest,
            _ => match moves(at).zip(moves(at + distance)) {
                Some((position, velocity))
                    if units::slope(&position[..rows], &velocity[..rows], None).is_some() =>
                {
                    Link::Derivative
                }
                _ => Link::None,
            },
        })
    };
    let mut best: Option<(usize, usize, MotionBlocks)> = None;
    for distance in 1..=reach {
        let links: Vec<Link> = (0..width).map_while(|at| follows(at, distance)).collect();
        for start in 0..links.len() {
            let run = links[start..].iter().take_while(|link| **link != Link::None).take(distance);
            // grippers that rest before or after the joints are not part of them
            let moving = run.enumerate().filter(|(_, link)| **link == Link::Derivative);
            let longest = moving.map(|(at, _)| at + 1).last().unwrap_or(0);
            if known.is_none() && links[start] != Link::Derivative {
                continue;
            }
            let joints = known.unwrap_or(longest);
            if joints < 2 || joints > distance || start + joints > links.len() {
                continue;
            }
            let of = &links[start..start + joints];
            let derivatives = of.iter().filter(|link| **link == Link::Derivative).count();
            let fitting = of.iter().filter(|link| **link != Link::None).count();
            let blocks = MotionBlocks { position: start, velocity: start + distance, joints };
            if 2 * derivatives >= joints.min(4)
                && 2 * fitting > joints
                && best.as_ref().is_none_or(|(most, links, _)| (fitting, derivatives) > (*most, *links))
            {
                best = Some((fitting, derivatives, blocks));
            }
        }
    }
    best.map(|(.., blocks)| blocks)
}

/// The relation of a column to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Link {
    None,
    AtRest,
    Derivative,
}

fn of_blocks<'h>(
    head: &'h Head,
    columns: &[Option<&'h [f64]>],
    blocks: MotionBlocks,
    is_count_known: bool,
) -> Joints<'h> {
    let n = blocks.joints;
    let block =
        |start: usize| -> Option<Vec<&'h [f64]>> { columns.get(start..start + n)?.iter().copied().collect() };
    let found = |start: usize, why: &str, question: Option<String>| -> Option<QuantityColumns<'h>> {
        let of: Vec<usize> = (start..start + n).collect();
        Some(QuantityColumns {
            key: ("columns", list(head, &of)),
            columns: of,
            said: NameMeaning::default(),
            values: block(start)?,
            why: why.to_owned(),
            question,
        })
    };
    let count = || {
        (!is_count_known).then(|| {
            format!(
                "{n} columns in a row have their derivatives in others. Are these exactly the joints? \
                --description gives their number"
            )
        })
    };
    let position = found(blocks.position, "no names; their derivatives are in other columns", count());
    let velocity = found(blocks.velocity, "they are the derivative of the positions", count());
    let mut taken: Vec<bool> = columns.iter().map(|values| !may_be_torque(*values)).collect();
    let mut take = |start: usize| taken[start..start + n].fill(true);
    take(blocks.position);
    take(blocks.velocity);
    let stride = blocks.velocity - blocks.position;
    let is_acceleration = |start: &usize| {
        velocity
            .as_ref()
            .zip(block(*start))
            .is_some_and(|(velocity, of)| is_derivative_of_all(&velocity.values, &of))
    };
    let free = |taken: &[bool], start: &usize| {
        start + n <= columns.len().min(MOST_COLUMNS) && !taken[*start..start + n].contains(&true)
    };
    let acceleration = (0..columns.len()).filter(|start| free(&taken, start)).find(is_acceleration);
    let mut others = Vec::new();
    if let Some(start) = acceleration {
        taken[start..start + n].fill(true);
        others = (start..start + n).map(|at| (at, ACCELERATION)).collect();
    }
    let still =
        |start: &usize| block(*start).map_or(n, |of| of.iter().filter(|values| is_still(values)).count());
    let expected = [acceleration.unwrap_or(blocks.velocity) + stride, blocks.velocity + n];
    let mut torques: Vec<usize> = (0..columns.len()).filter(|start| free(&taken, start)).collect();
    torques.sort_by_key(|start| (still(start), !expected.contains(start), *start));
    let torque = torques.split_first().and_then(|(best, rivals)| {
        let rivals: Vec<String> = rivals
            .iter()
            .filter(|start| still(start) <= still(best))
            .map(|start| format!("{} to {}", start + 1, start + n))
            .collect();
        let question = (!rivals.is_empty()).then(|| {
            format!(
                "columns {} to {} or {} may hold the torques. Which ones do?",
                best + 1,
                best + n,
                rivals.join(", ")
            )
        });
        found(*best, "no names; the remaining columns", question.or_else(count))
    });
    Joints { position, velocity, torque, count: n, others }
}

/// Returns true if a column may contain torques: no time, counter or stage.
fn may_be_torque(values: Option<&[f64]>) -> bool {
    values.is_some_and(|values| {
        let whole = stages::alphabet(values).is_some_and(|alphabet| alphabet.len() > 1);
        !rises(Some(values)) && !whole
    })
}

/// Positions first, then torques, if no column is the derivative of another. The position is the only evidence, so each
/// is a question.
fn by_place<'h>(head: &'h Head, columns: &[Option<&'h [f64]>], n: usize) -> Joints<'h> {
    let first = columns.iter().take(3).position(|values| values.is_some() && !rises(*values)).unwrap_or(0);
    let question = "no column is the derivative of another, so this follows only from their order: \
        positions first, then torques. Is this right?";
    let found = |start: usize| -> Option<QuantityColumns<'h>> {
        let of: Vec<usize> = (start..start + n).collect();
        Some(QuantityColumns {
            key: ("columns", list(head, &of)),
            values: columns.get(start..start + n)?.iter().copied().collect::<Option<_>>()?,
            columns: of,
            said: NameMeaning::default(),
            why: "no names: by their order".to_owned(),
            question: Some(question.to_owned()),
        })
    };
    let position = found(first);
    let speeds: Option<Vec<Vec<f64>>> = position.as_ref().map(|position| {
        let speed = |values: &&[f64]| values.windows(2).map(|pair| pair[1] - pair[0]).chain([0.0]).collect();
        position.values.iter().map(speed).collect()
    });
    let is_acceleration = speeds.zip(found(first + n)).is_some_and(|(speeds, next)| {
        let speeds: Vec<&[f64]> = speeds.iter().map(Vec::as_slice).collect();
        is_derivative_of_all(&speeds, &next.values)
    });
    let torque = found(first + if is_acceleration { 2 * n } else { n });
    Joints { position, torque, count: n, ..Joints::default() }
}
