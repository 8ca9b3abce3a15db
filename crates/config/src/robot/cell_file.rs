//! The surroundings of an arm: a TOML file with `[[plane]]`, `[[box]]` and `[[cylinder]]`, in the arm's base frame.

use std::path::Path;

use nalgebra::Vector3;

use super::shape::{RADIUS, read_ends, read_point};
use crate::toml::files;
use crate::toml::problem::ConfigErrors;
use crate::toml::range::Limits;
use crate::toml::table::{Table, read_document};
use armwatch_model::robot::{Cell, Obstacle, ObstacleForm, Transform};

/// Edges of a box.
const EDGE: Limits = Limits::above(0.0, 100.0, "m");

/// Reads the surroundings of an arm from the file at `path`.
///
/// # Errors
///
/// Every problem of the file at once, or a failed read.
pub fn read_cell(path: &Path) -> Result<Cell, ConfigErrors> {
    parse_cell(&path.display().to_string(), &files::read_text(path)?)
}

/// Reads the surroundings of an arm from `text`; `file_name` is used in problems.
fn parse_cell(file_name: &str, text: &str) -> Result<Cell, ConfigErrors> {
    read_document(file_name, text, |root| {
        let planes = read_all(root, "plane", read_plane);
        let boxes = read_all(root, "box", read_box);
        let cylinders = read_all(root, "cylinder", read_cylinder);
        let obstacles: Vec<Obstacle> = [planes?, boxes?, cylinders?].concat();
        if obstacles.is_empty() {
            root.refuse(
                "has no obstacle".into(),
                Some("write one [[plane]], [[box]] or [[cylinder]] per obstacle".into()),
            );
            return None;
        }
        Some(Cell { obstacles })
    })
}

fn read_all(
    root: &Table<'_>,
    key: &str,
    read_form: impl Fn(&Table<'_>) -> Option<ObstacleForm>,
) -> Option<Vec<Obstacle>> {
    let Some(value) = root.optional(key) else { return Some(Vec::new()) };
    let read = |(number, section): (usize, &crate::toml::table::Value<'_>)| {
        let table = section.table()?;
        let name = match table.optional("name") {
            Some(value) => value.text().map(str::to_owned),
            None => Some(format!("{key} {number}")),
        };
        let form = read_form(&table);
        Some(Obstacle { name: name?, form: form? })
    };
    let all: Vec<Option<Obstacle>> = (1..).zip(&value.sections()?).map(read).collect();
    all.into_iter().collect()
}

fn read_plane(table: &Table<'_>) -> Option<ObstacleForm> {
    let point = read_point(table, "point_m");
    let value = table.required("normal")?;
    let normal: [f64; 3] = value.numbers(Some(3), &Limits::within(1e3, ""))?.try_into().ok()?;
    let normal = Vector3::from(normal).try_normalize(1e-9);
    if normal.is_none() {
        value.refuse("has no direction".into(), Some("a floor has normal = [0, 0, 1]".into()));
    }
    Some(ObstacleForm::Plane { point: point?, normal: normal? })
}

fn read_box(table: &Table<'_>) -> Option<ObstacleForm> {
    let centre = read_point(table, "centre_m");
    let edges = table.numbers("size_m", Some(3), &EDGE);
    let turned = match table.optional("rpy_deg") {
        None => Some(vec![0.0; 3]),
        Some(value) => value.numbers(Some(3), &Limits::within(360.0, "deg")),
    };
    let turned: [f64; 3] = turned?.try_into().ok()?;
    let edges: [f64; 3] = edges?.try_into().ok()?;
    Some(ObstacleForm::Box {
        place: Transform::from_xyz_rpy(centre?.into(), turned.map(f64::to_radians)),
        half_edges: 0.5 * Vector3::from(edges),
    })
}

fn read_cylinder(table: &Table<'_>) -> Option<ObstacleForm> {
    let ends = read_ends(table);
    let radius = table.number("radius_m", &RADIUS);
    let ends = ends?;
    if (ends[1] - ends[0]).norm() < 1e-6 {
        table.refuse("from_m and to_m are the same point".into(), None);
        return None;
    }
    Some(ObstacleForm::Cylinder { ends, radius: radius? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::robot_file::parse_robot;

    #[test]
    fn obstacles_are_read_with_their_names_and_faults_with_their_places() {
        let text = "[[plane]]\nname = \"floor\"\npoint_m = [0, 0, -0.1]\nnormal = [0, 0, 2]\n\
                    [[box]]\ncentre_m = [0.5, 0, 0.2]\nsize_m = [0.2, 0.4, 0.6]\nrpy_deg = [0, 0, 90]\n\
                    [[cylinder]]\nfrom_m = [1, 0, 0]\nto_m = [1, 0, 1]\nradius_m = 0.1\n";
        let cell = parse_cell("cell.toml", text).unwrap_or_else(|errors| panic!("{errors}"));
        let names: Vec<&str> = cell.obstacles.iter().map(|obstacle| obstacle.name.as_str()).collect();
        assert_eq!(names, ["floor", "box 1", "cylinder 1"]);
        let up = ObstacleForm::Plane { point: Vector3::new(0.0, 0.0, -0.1), normal: Vector3::z() };
        assert_eq!(cell.obstacles[0].form, up);
        let ObstacleForm::Box { half_edges, .. } = cell.obstacles[1].form else { panic!("a box") };
        assert_eq!(half_edges, Vector3::new(0.1, 0.2, 0.3));
        for (from, to, expected) in [
            ("normal = [0, 0, 2]", "normal = [0, 0, 0]", "no direction"),
            ("radius_m = 0.1", "radius_m = 0", "cylinder[1].radius_m"),
            ("to_m = [1, 0, 1]", "to_m = [1, 0, 0]", "same point"),
            ("[[plane]]", "[[plain]]", "plain"),
        ] {
            let problem = parse_cell("cell.toml", &text.replace(from, to)).expect_err(expected).to_string();
            assert!(problem.contains(expected), "{problem}");
        }
        assert!(parse_cell("cell.toml", "").expect_err("nothing").to_string().contains("no obstacle"));
    }

    #[test]
    fn capsules_and_pairs_of_links_belong_to_the_description() {
        let scara = include_str!("../../../../config/robots/scara.toml");
        let (head, joints) = scara.split_once("[[joint]]").expect("a joint");
        let with = |pairs: &str, link: &str| {
            let capsule = format!(
                "[[capsule]]\nlink = {link}\nfrom_m = [0, 0, 0]\nto_m = [0.3, 0, 0]\nradius_m = 0.05\n\
                 [[capsule]]\nlink = 0\nfrom_m = [0, 0, 0]\nto_m = [0, 0, 0.3]\nradius_m = 0.08\n"
            );
            parse_robot("a.toml", &format!("{head}self_collision = [{pairs}]\n{capsule}[[joint]]{joints}"))
        };
        let shape = with("[2, 0]", "2").unwrap_or_else(|errors| panic!("{errors}")).shape;
        assert_eq!((shape.capsules.len(), &shape.pairs[..]), (2, &[[0, 2]][..]));
        for (pairs, link, expected) in [
            ("[2, 2]", "2", "two different links"),
            ("[0, 3]", "2", "link 3, which has no capsule"),
            ("[0, 2]", "9", "capsule[1].link"),
        ] {
            let problem = with(pairs, link).expect_err(expected).to_string();
            assert!(problem.contains(expected), "{problem}");
        }
    }
}
