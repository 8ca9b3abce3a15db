//! Tilt of the base. Floors are rarely level, and the resulting error is no fault of a channel, a length or a joint.

use nalgebra::Vector3;

use super::alternatives::gravity_text;
use super::channels::{COARSE_INSTANTS, Channels, OwnFit};
use super::readings::{ChannelReading, INDEPENDENT, ReadingComparison};
use crate::identify::joint_factors::FactorColumns;
use crate::model::base_parameters::{BaseParameters, base_parameters};
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::Robot;

/// Evidence of a tilt of the base, rad.
pub(crate) const TILT: &str = "tilt_rad";
/// Evidence of a change that explains more: the part of the squares that remains.
pub(crate) const RESIDUAL_RATIO: &str = "residual_ratio";
/// Instants for the comparison of readings.
pub(super) const INSTANTS: usize = 300;
/// Largest tilt of a floor, rad, that is only a remark: a tenth of gravity acts across.
pub(super) const FLOOR: f64 = 0.1;
/// Squares that a tilt must explain, relative to those that remain after the fit of one joint. With [`INDEPENDENT`]
/// values this is a chi-square of 12 with two degrees of freedom.
const SHOWN: f64 = 12.0 / INDEPENDENT;

/// Description with the most likely tilt of its base.
#[derive(Debug, Clone)]
pub(crate) struct BaseTilt {
    /// Recording with gravity in this direction.
    pub(super) reading: ChannelReading,
    /// Base parameters with the tilt. They include the first moments of link 1.
    pub(crate) base: BaseParameters,
    /// Columns of each joint's factor.
    pub(crate) columns: FactorColumns,
    /// Gravity of the description, m/s².
    pub(super) described: Vector3<f64>,
    /// Weighted squares that remain with the tilted description.
    pub(super) misfit: f64,
    described_misfit: f64,
    pub(super) own_misfit: f64,
    own: Vec<OwnFit>,
    /// Standard deviation of the error of each torque, Nm (N).
    sigma: Vec<f64>,
    rows: Vec<usize>,
}

impl BaseTilt {
    /// Estimates the most likely tilt; `None` with too few rows, or if the base parameters with it are unclear.
    pub(crate) fn of(channels: &Channels<'_>) -> Option<Self> {
        let rows = channels.rows(INSTANTS);
        let sigma = channels.errors(&channels.factors(&rows)).least();
        if sigma.iter().any(|sigma| !sigma.is_finite()) {
            return None;
        }
        let described = ChannelReading::of(channels.robot);
        let first = ReadingComparison::new(*channels, rows.clone(), sigma);
        let (tilted, _) = first.thinned(COARSE_INSTANTS).levelled(&described, &channels.robot.gravity);
        let base = base_parameters(&tilted.robot).ok()?;
        let columns = FactorColumns::new(&tilted.robot, &base);
        let under = Channels {
            robot: &tilted.robot,
            columns: &columns,
            kept_columns: &base.kept_columns,
            ..*channels
        };
        // without the tilt, its own effect would reduce the weight of a joint about a vertical axis
        let errors = under.errors(&under.factors(&rows));
        let own: Vec<OwnFit> = errors.own()?;
        let compared = ReadingComparison::new(*channels, rows, errors.least());
        let (reading, misfit) = compared.levelled(&tilted, &channels.robot.gravity);
        let described_misfit = compared.misfit(&described);
        Some(Self {
            reading,
            described: described.robot.gravity,
            misfit: misfit.min(described_misfit),
            described_misfit,
            own_misfit: own.iter().map(|of| of.misfit).sum(),
            own,
            sigma: compared.sigma,
            rows: compared.rows,
            base,
            columns,
        })
    }

    /// Tilted robot.
    pub(crate) fn robot(&self) -> &Robot {
        &self.reading.robot
    }

    /// Returns true if the fit of some joint leaves more than this part of its torque.
    pub(super) fn is_foreign(&self, part: f64) -> bool {
        self.own.iter().any(|of| of.relative > part)
    }

    /// Rows and weights for comparing readings.
    pub(super) fn compared<'a>(&'a self, channels: &Channels<'a>) -> ReadingComparison<'a> {
        let channels = Channels {
            robot: self.robot(),
            columns: &self.columns,
            kept_columns: &self.base.kept_columns,
            ..*channels
        };
        ReadingComparison::new(channels, self.rows.clone(), self.sigma.clone())
    }

    fn angle(&self) -> f64 {
        self.described.angle(&self.robot().gravity)
    }

    /// Returns true if the torques show a tilted floor.
    pub(crate) fn is_shown(&self) -> bool {
        let explained = self.described_misfit - self.misfit;
        (f64::MIN_POSITIVE..=FLOOR).contains(&self.angle()) && explained >= SHOWN * self.rows.len() as f64
    }

    /// Remark that reports the tilt.
    pub(crate) fn remark(&self) -> Finding {
        let (angle, ratio) = (self.angle(), self.misfit / self.described_misfit);
        Finding {
            kind: FindingKind::Description,
            severity: FindingSeverity::Warn,
            joint: None,
            sentence: format!(
                "the torques contradict the description: with {} (the base tilted by {:.1} deg) the torque error would be \
                 {:.0} % of what it is: check that first",
                gravity_text(&self.robot().gravity),
                angle.to_degrees(),
                100.0 * ratio.sqrt()
            ),
            evidence: vec![
                Evidence { name: RESIDUAL_RATIO, value: ratio },
                Evidence { name: TILT, value: angle },
            ],
        }
    }
}
