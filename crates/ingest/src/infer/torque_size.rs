//! Whether numbers are as large as the torques of the arm: gravity alone asks for torques that a description with
//! masses tells, and a current is smaller by the drive gain.

use super::proposal::Hints;

/// Rows that are looked at, spread over the recording.
const ROWS: usize = 200;

/// Recorded over gravity's torque, as root mean squares of the joint that carries most: torques in Nm lie within, with
/// motion and friction added and masses known roughly; drive gains are 5 Nm/A and more.
const LIKE_TORQUE: std::ops::RangeInclusive<f64> = 0.2..=5.0;

/// Gravity torque below which nothing is told, Nm (N): an arm that moves in a plane has none.
const LEAST_GRAVITY: f64 = 0.5;

/// How the recorded numbers compare with gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    /// The joint that gravity asks most of, from 1.
    pub(super) joint: usize,
    /// Root mean square of its recorded numbers.
    pub(super) recorded: f64,
    /// Root mean square of what gravity asks of it, Nm (N).
    pub(super) gravity: f64,
}

impl Size {
    /// Whether the numbers may be torques.
    pub(super) fn is_like_torque(self) -> bool {
        LIKE_TORQUE.contains(&(self.recorded / self.gravity))
    }

    pub(super) fn text(self) -> String {
        format!(
            "joint {} has {:.3} (rms), but gravity alone needs {:.3} Nm",
            self.joint, self.recorded, self.gravity
        )
    }
}

/// Compares `recorded` `[n][rows]` with the gravity torques at `position` `[n][rows]`, rad (m) of the joints; `None`
/// where the description gives no masses or gravity asks for next to nothing.
pub(super) fn size(hints: Hints<'_>, position: &[Vec<f64>], recorded: &[&[f64]]) -> Option<Size> {
    let (robot, gravity_torques) = (hints.robot?, hints.gravity_torques?);
    let rows = position.iter().map(Vec::len).chain(recorded.iter().map(|column| column.len())).min()?;
    let n = robot.joint_count();
    if rows == 0 || position.len() != n || recorded.len() != n {
        return None;
    }
    let mut squares = vec![(0.0, 0.0); n];
    let mut count = 0.0;
    for row in (0..rows).step_by((rows / ROWS).max(1)) {
        let q: Vec<f64> = position.iter().map(|joint| joint[row]).collect();
        for ((squares, column), gravity) in squares.iter_mut().zip(recorded).zip(gravity_torques(robot, &q)?)
        {
            *squares = (squares.0 + column[row] * column[row], squares.1 + gravity * gravity);
        }
        count += 1.0;
    }
    let sizes = squares.into_iter().enumerate().map(|(joint, (recorded, gravity))| Size {
        joint: joint + 1,
        recorded: f64::sqrt(recorded / count),
        gravity: f64::sqrt(gravity / count),
    });
    sizes.max_by(|a, b| a.gravity.total_cmp(&b.gravity)).filter(|size| size.gravity >= LEAST_GRAVITY)
}
