//! `armwatch robot urdf`: from a recording to a file for other programs.

use std::fs;

use crate::support::{Workshop, reference};

/// Tolerance of poses, with frames that are written with all digits.
const EQUAL: f64 = 1e-9;

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).expect("JSON")
}

/// A description that reads a URDF file of the workshop.
fn describe(workshop: &Workshop, urdf: &str) -> String {
    let name = format!("{urdf}.toml");
    let description = format!(
        "model = \"again\"\nconvention = \"urdf\"\nurdf = \"{urdf}\"\n\
         gravity_m_s2 = [0, 0, -9.81]\nspeed_levels = [0.5]\n"
    );
    fs::write(workshop.path(&name), description).expect("written");
    name
}

fn assert_bodies(found: &serde_json::Value) {
    for link in found["links"].as_array().expect("links") {
        assert!(link["definiteness"].as_f64().expect("a number") > 1e-10, "{link}");
        assert!(link["body"]["mass_kg"]["value"].as_f64().expect("a mass") > 0.0, "{link}");
        assert!(link["motor_inertia_kg_m2"]["value"].as_f64().expect("an inertia") > 0.0, "{link}");
    }
}

#[test]
fn a_simulated_recording_becomes_a_file_that_is_the_same_arm() {
    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--cycles", "2", "--warming-s", "0"]);
    workshop.stdout(&["ingest", "inbox"], 0);
    let found = json(&workshop.stdout(&["robot", "urdf", "--run", "1", "-o", "arm.urdf", "--json"], 0));
    assert_eq!(found["links"].as_array().map(Vec::len), Some(6));
    assert_bodies(&found);
    for joint in found["price_of_physics"].as_array().expect("six joints") {
        let figure = |name: &str| joint[name].as_f64().expect("a figure");
        let (free, consistent) = (figure("unconstrained_rmsd_nm"), figure("consistent_rmsd_nm"));
        assert!((0.95 * free..1.05 * free).contains(&consistent), "{joint}");
    }
    // One joint may gain slightly at the cost of another, but not all together.
    let sum = |name: &str| found[name].as_f64().expect("a sum");
    assert!(sum("residual_sum_of_squares") >= sum("unconstrained_sum_of_squares"), "{found}");
    let written = fs::read_to_string(workshop.path("arm.urdf")).expect("the file");
    for said in [
        "robot R01, run 1, recorded 20",
        "cycles 1-2",
        "armwatch 0.",
        "not decided by data: all but link 2 centre_y",
    ] {
        assert!(written.contains(said), "{said}\n{written}");
    }
    // Read again, it has the poses of the description by Pinocchio; its torques are those of other bodies, and differ.
    let table = reference("er3a_inverse_dynamics.csv");
    let table = table.to_str().expect("a path");
    let again = describe(&workshop, "arm.urdf");
    let checked = json(&workshop.stdout(&["robot", "check", &again, "--reference", table, "--json"], 1));
    for figure in ["position", "rotation"] {
        assert!(checked["reference"][figure].as_f64().expect("a figure") < EQUAL, "{checked}");
    }
    assert!(checked["reference"]["torque"].as_f64().expect("a figure") < 0.5, "{checked}");

    let shown = workshop.stdout(&["robot", "urdf", "--run", "1", "--cycles", "2", "-o", "one.urdf"], 0);
    assert!(shown.contains("Price of physics") && shown.contains("Not decided by data"), "{shown}");

    workshop.stdout(&["identify", "--run", "1", "--save", "both"], 0);
    workshop.stdout(&["robot", "urdf", "--parameters", "both", "-o", "both.urdf"], 0);
    assert_eq!(fs::read_to_string(workshop.path("both.urdf")).expect("the file"), written);

    what_cannot_be_is_said(&workshop);
}

fn what_cannot_be_is_said(workshop: &Workshop) {
    let scara = concat!(env!("CARGO_MANIFEST_DIR"), "/config/robots/scara.toml");
    for (arguments, said) in [
        (&["--run", "9"][..], "there is no run 9; runs with cycles: 1"),
        (&["--run", "1", "--cycles", "7"], "no cycle 7"),
        (&["--parameters", "cold"], "not a saved parameter set"),
        (&["--run", "1", "--description", scara], "not the one that the cycles were analysed with"),
        (&[], "--run"),
    ] {
        let output = workshop.stderr(&[&["robot", "urdf", "-o", "none.urdf"], arguments].concat(), 2);
        assert!(output.contains(said), "{arguments:?}: {output}");
    }
    assert!(!workshop.path("none.urdf").exists());
}

#[test]
fn a_real_arm_with_a_coupled_wrist_and_no_known_weights_becomes_bodies() {
    let workshop = Workshop::new();
    let (export, config) = (reference("tx40/TX40_0000-4000ms_5kHz.csv.gz"), reference("tx40/armwatch.toml"));
    let [export, config] = [&export, &config].map(|path| path.to_str().expect("a path"));
    workshop.stdout(&["ingest", export, "--config", config], 0);
    let arguments = ["robot", "urdf", "--run", "1", "-o", "tx40.urdf", "--json", "--config", config];
    let found = json(&workshop.stdout(&arguments, 0));
    assert_bodies(&found);
    assert_eq!(found["links"][0]["assumption"], "uniform body");
    for joint in found["price_of_physics"].as_array().expect("six joints") {
        let figure = |name: &str| joint[name].as_f64().expect("a figure");
        // The unconstrained parameters of four seconds of one motion are no bodies; some bodies explain the torque
        // nearly as well.
        assert!(figure("consistent_rmsd_nm") < 1.1 * figure("unconstrained_rmsd_nm"), "{joint}");
    }
    let again = describe(&workshop, "tx40.urdf");
    workshop.stdout(&["robot", "check", &again], 0);
}

/// The bodies of the URDF file with armature, and friction at a stated temperature with its difference from a line.
#[test]
fn a_simulated_recording_becomes_a_mujoco_file() {
    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--cycles", "3", "--warming-s", "0", "--temperatures", "motor"]);
    workshop.stdout(&["ingest", "inbox"], 0);
    let cold = json(&workshop.stdout(&["robot", "mjcf", "--run", "1", "-o", "arm.xml", "--json"], 0));
    let written = fs::read_to_string(workshop.path("arm.xml")).expect("the file");
    for said in [
        "<mujoco model=\"er3a\">",
        "robot R01, run 1, recorded 20",
        "friction: the mean over the excitation of these cycles",
        "mean motor temperatures in these cycles, degC: ",
        "largest difference between friction and its line, Nm (N): ",
        "<option gravity=\"0.0 0.0 -9.8",
        "<site name=\"tool\"",
    ] {
        assert!(written.contains(said), "{said}\n{written}");
    }
    assert_eq!((written.matches("armature=").count(), written.matches("fullinertia=").count()), (6, 6));
    let urdf = json(&workshop.stdout(&["robot", "urdf", "--run", "1", "-o", "arm.urdf", "--json"], 0));
    let figure = |value: &serde_json::Value, name: &str| value[name].as_f64().expect("a figure");
    for (joint, link) in
        cold["joints"].as_array().expect("joints").iter().zip(urdf["links"].as_array().expect("links"))
    {
        assert_eq!(joint["damping_nm_s_rad"], link["damping_nm_s_rad"]);
        assert_eq!(joint["frictionloss_nm"], link["friction_nm"]);
        assert_eq!(joint["armature_kg_m2"], link["motor_inertia_kg_m2"]["value"]);
        let difference = figure(joint, "largest_difference_nm");
        assert!(difference > 0.0 && difference < 10.0, "{joint}");
    }
    let shown = workshop.stdout(&["robot", "mjcf", "--run", "1", "-o", "arm.xml"], 0);
    assert!(
        shown.contains("Friction as a straight line; the mean over")
            && shown.contains("largest_difference_nm"),
        "{shown}"
    );
}
