//! Compares numbers with the arm's torques: a description with masses gives the torques of gravity, and a current is
//! smaller by the drive gain.

use super::proposal::Hints;

/// Examined rows, spread over the recording.
const ROWS: usize = 200;

/// Ratio of recorded torque to gravity's torque, as root mean squares of the joint with the largest load: torques in Nm
/// are within, including motion and friction and with roughly known masses; drive gains are 5 Nm/A and more.
const LIKE_TORQUE: std::ops::RangeInclusive<f64> = 0.2..=5.0;

/// Least gravity torque for a comparison, Nm (N): an arm that moves in a horizontal plane has none.
const LEAST_GRAVITY: f64 = 0.5;

/// Comparison of the recorded numbers with gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    /// The joint with the largest gravity torque, from 1.
    pub(super) joint: usize,
    /// Root mean square of its recorded numbers.
    pub(super) recorded: f64,
    /// Root mean square of its gravity torque, Nm (N).
    pub(super) gravity: f64,
}

impl Size {
    /// Returns true if the numbers may be torques.
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

/// Compares `recorded` `[n][rows]` with the gravity torques at `position` `[n][rows]`, rad (m) of the joints; `None` if
/// the description gives no masses or gravity is almost zero.
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
