//! A known load on the command line.

use clap::Args;
use nalgebra::{Matrix3, Vector3};

use crate::cli::context::CliError;

/// Heaviest load, kg; the largest arms carry 2300.
const MAX_MASS_KG: f64 = 1e4;

/// A body at the tool frame.
#[derive(Debug, Args)]
pub(in crate::cli) struct LoadArgs {
    /// Mass of the load at the tool frame, kg
    #[arg(help_heading = "Load", long, value_name = "KG", requires = "load_centre_m")]
    load_mass_kg: Option<f64>,
    /// Centre of mass of the load in the tool frame (without a tool, in the frame of the last joint), m
    #[arg(
        help_heading = "Load",
        long,
        value_name = "X,Y,Z",
        allow_hyphen_values = true,
        requires = "load_mass_kg"
    )]
    load_centre_m: Option<String>,
    /// Inertia of the load about its centre of mass, axes of the tool frame, kg m² [default: a point mass]
    #[arg(
        help_heading = "Load",
        long,
        value_name = "XX,XY,XZ,YY,YZ,ZZ",
        allow_hyphen_values = true,
        requires = "load_mass_kg"
    )]
    load_inertia_kg_m2: Option<String>,
}

/// The load: kg, m, kg m² about the centre of mass, axes of the tool frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::cli) struct GivenLoad {
    pub(in crate::cli) mass: f64,
    pub(in crate::cli) centre: Vector3<f64>,
    pub(in crate::cli) inertia: Matrix3<f64>,
}

impl LoadArgs {
    /// The load, if one is given.
    pub(in crate::cli) fn given(&self) -> Result<Option<GivenLoad>, CliError> {
        let Some((mass, centre)) = self.load_mass_kg.zip(self.load_centre_m.as_deref()) else {
            return Ok(None);
        };
        if !(mass > 0.0 && mass <= MAX_MASS_KG) {
            return Err(CliError::Usage(format!(
                "--load-mass-kg {mass}: must be above 0 and at most {MAX_MASS_KG} kg"
            )));
        }
        let [x, y, z] = numbers("--load-centre-m", centre)?;
        let [xx, xy, xz, yy, yz, zz] = match &self.load_inertia_kg_m2 {
            Some(text) => numbers("--load-inertia-kg-m2", text)?,
            None => [0.0; 6],
        };
        let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        // a body's second moment about any axis is not negative: no moment exceeds the other two
        let second = Matrix3::identity() * (0.5 * inertia.trace()) - inertia;
        let smallest = second.symmetric_eigenvalues().min();
        if smallest < -1e-9 * inertia.norm() {
            return Err(CliError::Usage(
                "--load-inertia-kg-m2: no body has this inertia about its centre of mass; the sum of any \
                two principal moments must be at least the third, and products of inertia are entries of \
                the matrix"
                    .into(),
            ));
        }
        Ok(Some(GivenLoad { mass, centre: Vector3::new(x, y, z), inertia }))
    }
}

/// Reads `N` numbers between commas.
fn numbers<const N: usize>(option: &str, text: &str) -> Result<[f64; N], CliError> {
    let read: Option<Vec<f64>> =
        text.split(',').map(|cell| cell.trim().parse::<f64>().ok().filter(|x| x.is_finite())).collect();
    read.and_then(|numbers| <[f64; N]>::try_from(numbers).ok())
        .ok_or_else(|| CliError::Usage(format!("{option} {text}: must be {N} numbers between commas")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(mass: f64, centre: &str, inertia: Option<&str>) -> Result<Option<GivenLoad>, CliError> {
        let args = LoadArgs {
            load_mass_kg: Some(mass),
            load_centre_m: Some(centre.into()),
            load_inertia_kg_m2: inertia.map(str::to_owned),
        };
        args.given()
    }

    #[test]
    fn a_load_is_read_whole_or_refused_with_its_option() {
        let given =
            load(5.0, "-0.1, 0,0.05", Some("0.02,0,0,0.02,0.001,0.03")).expect("a body").expect("given");
        assert_eq!((given.mass, given.centre), (5.0, Vector3::new(-0.1, 0.0, 0.05)));
        assert_eq!(
            (given.inertia[(2, 1)], given.inertia[(1, 2)], given.inertia[(2, 2)]),
            (0.001, 0.001, 0.03)
        );
        for (mass, centre, inertia, option) in [
            (0.0, "0,0,0", None, "--load-mass-kg"),
            (f64::NAN, "0,0,0", None, "--load-mass-kg"),
            (1.0, "0,0", None, "--load-centre-m"),
            (1.0, "0,0,inf", None, "--load-centre-m"),
            (1.0, "0,0,0", Some("1,0,0,1,0"), "--load-inertia-kg-m2"),
            (1.0, "0,0,0", Some("1,0,0,1,0,3"), "--load-inertia-kg-m2"),
        ] {
            let error = load(mass, centre, inertia).expect_err("no load").to_string();
            assert!(error.contains(option), "{error}");
        }
    }
}
