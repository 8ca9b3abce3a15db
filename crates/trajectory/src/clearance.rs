//! Distances between the links of an arm, and between links and obstacles.
//!
//! Links are capsules, so that a distance is that between two lines, or a line and an obstacle, minus the radii. If two
//! lines cross, the distance is that of touching lines: a deeper overlap than the radii is not measured.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::query::details::closest_points_segment_segment;
use parry3d_f64::query::{ClosestPoints, closest_points};
use parry3d_f64::shape::{Cuboid, Cylinder, Segment, Shape};

use super::limits::extremes;
use super::series::state_at;
use armwatch_method::model::kinematics::joint_transform;
use armwatch_model::robot::{
    Capsule, Cell, FourierExcitation, JointKind, MAX_JOINTS, ObstacleForm, Robot, Transform,
};

/// Instants per second at which a motion is checked.
const CHECK_RATE_HZ: f64 = 1000.0;

/// Largest travel of a joint between two checked postures, between samples: rad (m).
const LARGEST_STEP: f64 = 0.005;

/// Distances beyond this are ignored, m.
const FAR_M: f64 = 100.0;

/// Lines closer than this cross, m.
const CROSSING_M: f64 = 1e-9;

/// A distance that a motion must keep.
#[derive(Debug, Clone)]
pub struct ClearanceLimit {
    /// The pairs that must keep it.
    pub clearance: Clearance,
    /// Least distance, m.
    pub distance: f64,
}

/// Pairs of an arm's links, and of links and obstacles, that must keep a distance.
#[derive(Debug, Clone, Default)]
pub struct Clearance {
    capsules: Vec<Capsule>,
    obstacles: Vec<Solid>,
    pairs: Vec<Pair>,
}

/// An obstacle, prepared for distance queries.
#[derive(Debug, Clone)]
struct Solid {
    name: String,
    form: SolidForm,
}

#[derive(Debug, Clone)]
enum SolidForm {
    /// A point of the plane and its unit normal.
    Plane(Vector3<f64>, Vector3<f64>),
    Cuboid(Pose, Cuboid),
    Cylinder(Pose, Cylinder),
}

/// A capsule and its counterpart.
#[derive(Debug, Clone, Copy)]
struct Pair {
    capsule: usize,
    other: Other,
}

#[derive(Debug, Clone, Copy)]
enum Other {
    Capsule(usize),
    Obstacle(usize),
}

/// A pair at one posture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Near {
    /// Its index: see [`Clearance::name`].
    pub pair: usize,
    /// Distance between surfaces, m; negative where they intersect.
    pub distance: f64,
    /// Its derivative with respect to the joints' positions, m/rad (1 for a prismatic joint).
    pub slope: [f64; MAX_JOINTS],
}

/// The smallest distance of a pair during a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Its index: see [`Clearance::name`].
    pub pair: usize,
    /// Distance, m.
    pub distance: f64,
    /// Lower bound of the distance that also holds between the checked instants, m.
    pub at_least: f64,
    /// Time of the smallest distance, s.
    pub time: f64,
}

impl Clearance {
    /// Pairs from the description of `robot` and its `cell`: pairs of links, and every moving link with every obstacle.
    pub fn new(robot: &Robot, cell: &Cell) -> Self {
        let capsules = &robot.shape.capsules;
        let of_link = |link: usize| (0..capsules.len()).filter(move |&k| capsules[k].link == link);
        let mut pairs = Vec::new();
        for &[a, b] in &robot.shape.pairs {
            for capsule in of_link(a) {
                pairs.extend(of_link(b).map(|other| Pair { capsule, other: Other::Capsule(other) }));
            }
        }
        for obstacle in 0..cell.obstacles.len() {
            let moving = (0..capsules.len()).filter(|&k| capsules[k].link > 0);
            pairs.extend(moving.map(|capsule| Pair { capsule, other: Other::Obstacle(obstacle) }));
        }
        let solid = |obstacle: &armwatch_model::robot::Obstacle| Solid {
            name: obstacle.name.clone(),
            form: SolidForm::of(&obstacle.form),
        };
        Self { capsules: capsules.clone(), obstacles: cell.obstacles.iter().map(solid).collect(), pairs }
    }

    /// Returns true if there are no pairs.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Name of a pair, such as `link 2 and link 5`, `link 3 and floor`.
    ///
    /// # Panics
    /// If there is no such pair.
    pub fn name(&self, pair: usize) -> String {
        let Pair { capsule, other } = self.pairs[pair];
        let link = |k: usize| match self.capsules[k].link {
            0 => "the base".to_owned(),
            link => format!("link {link}"),
        };
        match other {
            Other::Capsule(other) => format!("{} and {}", link(capsule), link(other)),
            Other::Obstacle(obstacle) => format!("{} and {}", link(capsule), self.obstacles[obstacle].name),
        }
    }

    /// Pairs nearer than `within`, m, at the posture `q` `[n]`, rad (m).
    ///
    /// # Panics
    /// If there are fewer positions than joints.
    pub fn distances(&self, robot: &Robot, q: &[f64], within: f64, mut found: impl FnMut(Near)) {
        let frames = frames(robot, q);
        let segments: Vec<[Vector3<f64>; 2]> = self
            .capsules
            .iter()
            .map(|capsule| {
                let frame = &frames[capsule.link];
                capsule.ends.map(|end| frame.translation + frame.to_outer(&end))
            })
            .collect();
        for (pair, &Pair { capsule: k, other }) in self.pairs.iter().enumerate() {
            let (capsule, ends) = (&self.capsules[k], &segments[k]);
            let (distance, points, normal, link) = match other {
                Other::Capsule(other) => {
                    let radii = capsule.radius + self.capsules[other].radius;
                    let Some((points, normal)) = between_lines(ends, &segments[other], within + radii) else {
                        continue;
                    };
                    let apart = normal.dot(&(points[1] - points[0]));
                    (apart - radii, points, normal, self.capsules[other].link)
                }
                Other::Obstacle(obstacle) => {
                    let form = &self.obstacles[obstacle].form;
                    let Some((apart, points, normal)) = form.nearest(ends, within + capsule.radius) else {
                        continue;
                    };
                    (apart - capsule.radius, points, normal, 0)
                }
            };
            if distance >= within {
                continue;
            }
            let mut slope = [0.0; MAX_JOINTS];
            for (j, slope) in slope.iter_mut().enumerate().take(robot.joint_count()) {
                let moved = |point: &Vector3<f64>, link: usize| {
                    if link <= j { Vector3::zeros() } else { point_slope(robot, &frames[j + 1], j, point) }
                };
                *slope = normal.dot(&(moved(&points[1], link) - moved(&points[0], capsule.link)));
            }
            found(Near { pair, distance, slope });
        }
    }

    /// Largest distance of any capsule from each joint's axis, m; 1 for a prismatic joint: the largest speed of its
    /// points at a joint speed of 1.
    fn levers(&self, robot: &Robot) -> Vec<f64> {
        let lengths: Vec<f64> = robot
            .joints
            .iter()
            .map(|joint| {
                let slide = match joint.kind {
                    JointKind::Revolute => 0.0,
                    JointKind::Prismatic => {
                        joint.limits.position_min.abs().max(joint.limits.position_max.abs())
                    }
                };
                joint.geometry.placement().translation.norm() + slide
            })
            .collect();
        let lever = |j: usize| {
            if robot.joints[j].kind == JointKind::Prismatic {
                return 1.0;
            }
            let of_capsule = |capsule: &Capsule| {
                let way: f64 = lengths[(j + 1).min(capsule.link)..capsule.link].iter().sum();
                way + capsule.ends.iter().map(Vector3::norm).fold(0.0, f64::max)
            };
            let beyond = self.capsules.iter().filter(|capsule| capsule.link > j);
            beyond.map(of_capsule).fold(0.0, f64::max)
        };
        (0..robot.joint_count()).map(lever).collect()
    }
}

impl SolidForm {
    fn of(form: &ObstacleForm) -> Self {
        match form {
            ObstacleForm::Plane { point, normal } => Self::Plane(*point, *normal),
            ObstacleForm::Box { place, half_edges } => {
                Self::Cuboid(pose(place), Cuboid::new(to_parry(half_edges)))
            }
            ObstacleForm::Cylinder { ends, radius } => {
                let axis = ends[1] - ends[0];
                // the library's cylinder lies along y: first y is rotated to z, then z to the axis
                let upright =
                    Transform::z_to(&axis.normalize()).then(&Transform::about_x(std::f64::consts::FRAC_PI_2));
                let place = Transform { translation: 0.5 * (ends[0] + ends[1]), ..upright };
                Self::Cylinder(pose(&place), Cylinder::new(0.5 * axis.norm(), *radius))
            }
        }
    }

    /// Distance of a line's nearest point, that point with the obstacle's, and the unit vector from the line to the
    /// obstacle; `None` beyond `within`.
    fn nearest(
        &self,
        ends: &[Vector3<f64>; 2],
        within: f64,
    ) -> Option<(f64, [Vector3<f64>; 2], Vector3<f64>)> {
        let (place, shape): (&Pose, &dyn Shape) = match self {
            Self::Plane(point, normal) => {
                let [a, b] = ends.map(|end| normal.dot(&(end - point)));
                let (apart, end) = if a <= b { (a, ends[0]) } else { (b, ends[1]) };
                return (apart < within).then_some((apart, [end, end - normal * apart], -normal));
            }
            Self::Cuboid(place, cuboid) => (place, cuboid),
            Self::Cylinder(place, cylinder) => (place, cylinder),
        };
        let segment = Segment::new(to_parry(&ends[0]), to_parry(&ends[1]));
        match closest_points(&Pose::IDENTITY, &segment, place, shape, within) {
            Ok(ClosestPoints::WithinMargin(own, other)) => {
                let points = [from_parry(own), from_parry(other)];
                let between = points[1] - points[0];
                let apart = between.norm();
                if apart > CROSSING_M {
                    return Some((apart, points, between / apart));
                }
                Some(crossing(ends, place))
            }
            Ok(ClosestPoints::Intersecting) => Some(crossing(ends, place)),
            Ok(ClosestPoints::Disjoint) | Err(_) => None,
        }
    }
}

/// A line that crosses an obstacle: the distance is zero, and the direction leads away from the obstacle's middle.
fn crossing(ends: &[Vector3<f64>; 2], place: &Pose) -> (f64, [Vector3<f64>; 2], Vector3<f64>) {
    let middle = 0.5 * (ends[0] + ends[1]);
    let inwards = from_parry(place.translation) - middle;
    let normal = inwards.try_normalize(CROSSING_M).unwrap_or_else(Vector3::z);
    (0.0, [middle, middle], normal)
}

/// Nearest points of two lines and the unit vector from the first to the second; `None` beyond `within`.
fn between_lines(
    a: &[Vector3<f64>; 2],
    b: &[Vector3<f64>; 2],
    within: f64,
) -> Option<([Vector3<f64>; 2], Vector3<f64>)> {
    let segment = |ends: &[Vector3<f64>; 2]| Segment::new(to_parry(&ends[0]), to_parry(&ends[1]));
    let points = match closest_points_segment_segment(&Pose::IDENTITY, &segment(a), &segment(b), within) {
        ClosestPoints::WithinMargin(own, other) => [from_parry(own), from_parry(other)],
        ClosestPoints::Intersecting => [0.5 * (a[0] + a[1]); 2],
        ClosestPoints::Disjoint => return None,
    };
    let between = points[1] - points[0];
    // crossing lines are separated along their middles
    let middles = (b[0] + b[1] - a[0] - a[1]).try_normalize(CROSSING_M).unwrap_or_else(Vector3::z);
    Some((points, between.try_normalize(CROSSING_M).unwrap_or(middles)))
}

/// Frames of the base and of all links in the base frame, `[n + 1]`.
fn frames(robot: &Robot, q: &[f64]) -> Vec<Transform> {
    let mut frames = vec![Transform::IDENTITY];
    for (joint, &q) in robot.joints.iter().zip(q) {
        let next = frames[frames.len() - 1].then(&joint_transform(joint, q));
        frames.push(next);
    }
    frames
}

/// Derivative of the position of a point of a link beyond the joint `j` with respect to that joint, m/rad (1); `frame`
/// is that joint's.
fn point_slope(robot: &Robot, frame: &Transform, j: usize, point: &Vector3<f64>) -> Vector3<f64> {
    let axis = frame.rotation.column(2).into_owned();
    match robot.joints[j].kind {
        JointKind::Revolute => axis.cross(&(point - frame.translation)),
        JointKind::Prismatic => axis,
    }
}

/// Smallest distance of each pair over one period of a series.
///
/// Between instants a joint `j` travels at most `|qd_j| h + a_j h² / 2` from the nearer one, with its largest
/// acceleration `a_j` and `h` half a step, and no point moves more than the sum of that times its lever.
pub fn nearest_of_series(robot: &Robot, clearance: &Clearance, series: &FourierExcitation) -> Vec<Nearest> {
    let period = 1.0 / series.base_frequency;
    let instants = (period * CHECK_RATE_HZ).ceil();
    let half_step = 0.5 * period / instants;
    let accelerations: Vec<f64> =
        (0..robot.joint_count()).map(|j| extremes(series, j).acceleration.value.abs()).collect();
    let levers = clearance.levers(robot);
    let states = (0..instants as u64).map(|k| {
        let time = period * k as f64 / instants;
        let state = state_at(series, time);
        let travel =
            |j: usize| state[j][1].abs() * half_step + 0.5 * accelerations[j] * half_step * half_step;
        let moved: f64 = levers.iter().enumerate().map(|(j, lever)| lever * travel(j)).sum();
        (time, state.iter().map(|of| of[0]).collect::<Vec<f64>>(), moved)
    });
    nearest(robot, clearance, states)
}

/// Smallest distance of each pair in a motion of times, s, and postures `[n]`, joined by straight lines. The motion is
/// checked so often between two postures that no joint moves more than a few mrad (mm).
pub fn nearest_of_postures(
    robot: &Robot,
    clearance: &Clearance,
    motion: impl Iterator<Item = (f64, Vec<f64>)>,
) -> Vec<Nearest> {
    let levers = clearance.levers(robot);
    let mut before: Option<(f64, Vec<f64>)> = None;
    let states = motion.flat_map(|(time, posture)| {
        let (from_time, from) = before.replace((time, posture.clone())).unwrap_or((time, posture.clone()));
        let travel: Vec<f64> = from.iter().zip(&posture).map(|(from, to)| (to - from).abs()).collect();
        let steps = (travel.iter().copied().fold(0.0, f64::max) / LARGEST_STEP).ceil().max(1.0);
        let moved: f64 = levers.iter().zip(&travel).map(|(lever, of)| 0.5 * lever * of / steps).sum();
        (1..=steps as u64).map(move |step| {
            let part = step as f64 / steps;
            let between = from.iter().zip(&posture).map(|(from, to)| from + part * (to - from)).collect();
            (from_time + part * (time - from_time), between, moved)
        })
    });
    nearest(robot, clearance, states)
}

/// Smallest distances of each pair among states: time, posture, and the possible decrease of a distance nearby.
fn nearest(
    robot: &Robot,
    clearance: &Clearance,
    states: impl Iterator<Item = (f64, Vec<f64>, f64)>,
) -> Vec<Nearest> {
    let mut found: Vec<Option<Nearest>> = vec![None; clearance.pairs.len()];
    for (time, posture, moved) in states {
        clearance.distances(robot, &posture, FAR_M, |near| {
            let now =
                Nearest { pair: near.pair, distance: near.distance, at_least: near.distance - moved, time };
            let known = &mut found[near.pair];
            if known.is_none_or(|known| now.at_least < known.at_least) {
                *known = Some(now);
            }
        });
    }
    found.into_iter().flatten().collect()
}

fn to_parry(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

fn from_parry(v: Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

fn pose(place: &Transform) -> Pose {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(place.rotation));
    let rotation = Rotation::from_xyzw(turn.i, turn.j, turn.k, turn.w);
    Pose::from_parts(to_parry(&place.translation), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::{ArmShape, Obstacle};
    use armwatch_testing::er3a;

    /// Differences of 1e-6 m of distances of some metres, for derivatives.
    const DIFFERENCES: f64 = 1e-6;

    /// The ER3A with capsules of round dimensions along its links.
    fn with_capsules() -> Robot {
        let capsule = |link: usize, from: [f64; 3], to: [f64; 3], radius: f64| Capsule {
            link,
            ends: [from.into(), to.into()],
            radius,
        };
        let shape = ArmShape {
            capsules: vec![
                capsule(0, [0.0, 0.0, 0.0], [0.0, 0.0, 0.2], 0.12),
                capsule(2, [0.0, 0.0, 0.0], [0.27, 0.0, 0.0], 0.06),
                capsule(4, [0.0, 0.0, -0.3], [0.0, 0.0, 0.0], 0.05),
                capsule(6, [0.0, 0.0, 0.0], [0.0, 0.0, 0.1], 0.04),
            ],
            pairs: vec![[0, 6], [2, 6]],
        };
        Robot { shape, ..er3a() }
    }

    fn cell() -> Cell {
        let form = |name: &str, form: ObstacleForm| Obstacle { name: name.into(), form };
        let place = Transform::from_xyz_rpy([0.6, 0.1, 0.3], [0.2, -0.4, 1.0]);
        let ends = [Vector3::new(-0.4, 0.5, 0.0), Vector3::new(-0.3, 0.4, 0.9)];
        let normal = Vector3::new(0.1, 0.0, 1.0).normalize();
        Cell {
            obstacles: vec![
                form("floor", ObstacleForm::Plane { point: Vector3::new(0.0, 0.0, -0.1), normal }),
                form("crate", ObstacleForm::Box { place, half_edges: Vector3::new(0.1, 0.2, 0.15) }),
                form("post", ObstacleForm::Cylinder { ends, radius: 0.08 }),
            ],
        }
    }

    fn postures() -> impl Iterator<Item = Vec<f64>> {
        (0..40).map(|k| (0..6).map(|j| (0.7 * f64::from(k * 6 + j)).sin()).collect())
    }

    fn all_distances(robot: &Robot, clearance: &Clearance, q: &[f64]) -> Vec<Near> {
        let mut found = Vec::new();
        clearance.distances(robot, q, FAR_M, |near| found.push(near));
        found
    }

    /// Distance of a point from a solid, by its own coordinates.
    fn from_solid(form: &ObstacleForm, point: &Vector3<f64>) -> f64 {
        match form {
            ObstacleForm::Plane { point: of_plane, normal } => normal.dot(&(point - of_plane)),
            ObstacleForm::Box { place, half_edges } => {
                let inner = place.to_inner(&(point - place.translation));
                (inner.abs() - half_edges).map(|beyond| beyond.max(0.0)).norm()
            }
            ObstacleForm::Cylinder { ends, radius } => {
                let axis = ends[1] - ends[0];
                let along = axis.normalize().dot(&(point - ends[0]));
                let aside = (point - ends[0] - axis.normalize() * along).norm();
                let beyond = (along - axis.norm()).max(-along).max(0.0);
                beyond.hypot((aside - radius).max(0.0))
            }
        }
    }

    /// The smallest distance between many points of a line and another object is that of the line.
    #[test]
    fn distances_are_those_of_many_points_of_the_lines() {
        let (robot, cell) = (with_capsules(), cell());
        let clearance = Clearance::new(&robot, &cell);
        assert_eq!(clearance.name(0), "the base and link 6");
        assert_eq!(clearance.pairs.len(), 2 + 3 * 3);
        const POINTS: u32 = 400;
        for q in postures() {
            let frames = frames(&robot, &q);
            let point = |capsule: &Capsule, part: f64| {
                let frame = &frames[capsule.link];
                let inner = capsule.ends[0] + part * (capsule.ends[1] - capsule.ends[0]);
                frame.translation + frame.to_outer(&inner)
            };
            let along = |capsule: Capsule| {
                (0..=POINTS)
                    .map(move |k| f64::from(k) / f64::from(POINTS))
                    .map(move |part| point(&capsule, part))
            };
            for near in all_distances(&robot, &clearance, &q) {
                let Pair { capsule, other } = clearance.pairs[near.pair];
                let capsule = clearance.capsules[capsule];
                let (by_points, radii) = match other {
                    Other::Capsule(other) => {
                        let other = clearance.capsules[other];
                        let points: Vec<_> = along(other).collect();
                        let nearest = along(capsule)
                            .flat_map(|p| points.iter().map(move |other| (p - other).norm()))
                            .fold(f64::INFINITY, f64::min);
                        (nearest, capsule.radius + other.radius)
                    }
                    Other::Obstacle(k) => {
                        let form = &cell.obstacles[k].form;
                        (
                            along(capsule).map(|p| from_solid(form, &p)).fold(f64::INFINITY, f64::min),
                            capsule.radius,
                        )
                    }
                };
                // points are 1 mm apart, so that the nearest one is at most half of that from the true one
                let found = near.distance + radii;
                assert!(
                    found <= by_points + 1e-6 && by_points - found < 1e-3,
                    "{near:?} {by_points} {found}"
                );
            }
        }
    }

    #[test]
    fn slopes_are_those_of_differences() {
        let robot = with_capsules();
        let clearance = Clearance::new(&robot, &cell());
        let mut compared = 0;
        for q in postures() {
            for near in all_distances(&robot, &clearance, &q) {
                for j in 0..6 {
                    let at = |step: f64| {
                        let mut moved = q.clone();
                        moved[j] += step;
                        all_distances(&robot, &clearance, &moved)[near.pair].distance
                    };
                    let (before, after) = (at(-1e-4), at(1e-4));
                    let bend = (after + before - 2.0 * near.distance).abs();
                    // no derivative exists where the nearest points jump or lines cross
                    if near.distance > 0.0 && bend < 1e-8 {
                        compared += 1;
                        let slope = (after - before) / 2e-4;
                        assert!((slope - near.slope[j]).abs() < 1e2 * DIFFERENCES, "{slope} {near:?} {j}");
                    }
                }
            }
        }
        assert!(compared > 1000, "{compared}");
    }

    #[test]
    fn a_motion_is_nowhere_nearer_than_what_is_said() {
        let robot = with_capsules();
        let clearance = Clearance::new(&robot, &cell());
        let series = robot.excitation.clone().expect("Table 4.1");
        let found = nearest_of_series(&robot, &clearance, &series);
        assert_eq!(found.len(), clearance.pairs.len());
        let mut least = vec![f64::INFINITY; found.len()];
        for k in 0..40_000 {
            let state = state_at(&series, f64::from(k) * 10.0 / 40_000.0);
            let q: Vec<f64> = state.iter().map(|of| of[0]).collect();
            clearance
                .distances(&robot, &q, FAR_M, |near| least[near.pair] = least[near.pair].min(near.distance));
        }
        for near in &found {
            assert!(near.at_least <= least[near.pair], "{near:?} {}", least[near.pair]);
            assert!(least[near.pair] - near.at_least < 0.01, "{near:?} {}", least[near.pair]);
        }
        let samples = (0..=500).map(|k| {
            let time = f64::from(k) * 0.02;
            (time, state_at(&series, time).iter().map(|of| of[0]).collect())
        });
        for (sampled, exact) in nearest_of_postures(&robot, &clearance, samples).iter().zip(&found) {
            assert!((sampled.distance - exact.distance).abs() < 0.01, "{sampled:?} {exact:?}");
        }
    }
}
