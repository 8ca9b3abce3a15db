//! Measured and estimated torque of a cycle over time, and their difference on a separate strip: one panel per joint.

use super::figure::{Band, ESTIMATED, Figure, Key, Look, MEASURED, Mark, Panel, RESIDUAL, Series, Strip};
use armwatch_method::identify::torque_series::{JointTorqueSeries, TorqueSeries, peaks};
use armwatch_method::signal::time_grid::median_step;
use armwatch_model::analysis::{Rmsd, RmsdScope};
use armwatch_model::robot::{JointIndex, JointKind, Robot};
use armwatch_model::run::Stage;

/// Most points per line: a bucket for about every third pixel of a panel; [`peaks`] keeps six rows of each.
const POINTS_PER_LINE: usize = 1800;

/// A time step longer than this many usual ones is a gap, and no line is drawn across it.
const GAP_STEPS: f64 = 2.5;

/// The drawn part of a cycle's torques.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueView {
    /// Stage, or the whole cycle.
    pub scope: RmsdScope,
    /// Points per line, if fewer are wanted than a panel shows.
    pub points: Option<usize>,
    /// Only this joint.
    pub joint: Option<JointIndex>,
    /// True if the estimate is also drawn for a slow or resting joint: no friction column is valid there, and its sign
    /// changes with the noise of the velocity.
    pub slow: bool,
}

/// Draws the part of a cycle's torques that `view` selects. The RMSD in the titles covers all counted rows of the
/// scope.
pub fn torque_figure(
    robot: &Robot,
    series: &TorqueSeries,
    view: TorqueView,
    title: String,
    subtitle: String,
) -> Figure {
    let rows = series.rows_of(view.scope);
    let bands = stage_bands(series, &rows);
    let joints = robot.joint_indices().zip(&series.joints);
    let panels =
        joints.filter(|(joint, _)| view.joint.is_none_or(|only| only == *joint)).map(|(joint, of_joint)| {
            let (torque, residual) = match robot.joints[joint.index()].kind {
                JointKind::Revolute => ("torque, Nm", "residual, Nm"),
                JointKind::Prismatic => ("force, N", "residual, N"),
            };
            let (lines, difference) = joint_lines(series, of_joint, &rows, view);
            Panel {
                title: panel_title(series, joint, view.scope),
                x_label: "time since the start of the recording, s".into(),
                y_label: torque.into(),
                with_zero: true,
                bands: bands.clone(),
                series: lines,
                strip: Some(Strip { y_label: residual.into(), series: difference }),
                ..Panel::default()
            }
        });
    Figure { title, subtitle, legend: legend(&bands, view.slow), panels: panels.collect(), columns: 1 }
}

/// A title with the RMSD of the moving rows first: at rest a joint holds any torque up to breakaway, which no model
/// predicts.
fn panel_title(series: &TorqueSeries, joint: JointIndex, scope: RmsdScope) -> String {
    let rmsd = series.rmsd(joint, scope);
    let shown = |of: Rmsd| match of.samples {
        0 => "no rows".to_string(),
        _ => format!("{:.3} Nm = {:.2} %", of.value, 100.0 * of.relative),
    };
    format!("joint {joint}: RMSD in motion {}, with rest {}", shown(rmsd.moving_rows), shown(rmsd.all_rows))
}

/// Lines of the torques of one joint, from the lowest layer up, and those of the residual.
fn joint_lines(
    series: &TorqueSeries,
    joint: &JointTorqueSeries,
    rows: &[usize],
    view: TorqueView,
) -> (Vec<Series>, Vec<Series>) {
    let most = view.points.unwrap_or(POINTS_PER_LINE).min(POINTS_PER_LINE);
    let times: Vec<f64> = rows.iter().map(|&row| series.time[row]).collect();
    let step = median_step(&times).unwrap_or(f64::INFINITY);
    let mut measured = Vec::new();
    let mut estimated = SplitLine::default();
    let mut residual = SplitLine::default();
    // sections are thinned separately, so that each keeps its ends
    for stretch in rows.chunk_by(|a, b| series.time[*b] - series.time[*a] <= GAP_STEPS * step) {
        let kept = peaks(joint, stretch, most * stretch.len() / rows.len());
        for (place, &row) in kept.iter().enumerate() {
            let moving = joint.moving[row];
            let beside = |other: Option<&usize>| other.is_some_and(|&other| joint.moving[other] != moving);
            let border = beside(place.checked_sub(1).and_then(|before| kept.get(before)))
                || beside(kept.get(place + 1));
            let time = series.time[row];
            measured.push([time, joint.measured[row]]);
            estimated.push([time, joint.estimated[row]], moving, border && view.slow);
            residual.push([time, joint.residual(row)], moving, border && view.slow);
        }
        measured.push(BREAK);
        estimated.end();
        residual.end();
    }
    let line = |name: &str, colour, mark, points| Series { name: name.into(), colour, mark, points };
    let mut torques = vec![line("measured", MEASURED, Mark::Broad, measured)];
    let mut difference = Vec::new();
    if view.slow {
        torques.push(line("estimated, joint slow", ESTIMATED, Mark::Pale, estimated.slow));
        difference.push(line("residual, joint slow", RESIDUAL, Mark::Pale, residual.slow));
    }
    // a thin line on a broad pale one: both are visible, whether they agree or not
    torques.push(line("estimated", ESTIMATED, Mark::Line, estimated.moving));
    difference.push(line("residual", RESIDUAL, Mark::Thin, residual.moving));
    (torques, difference)
}

/// A break in a line.
const BREAK: [f64; 2] = [f64::NAN; 2];

/// A line with different styles for motion and rest; both styles meet when the joint starts or stops.
#[derive(Debug, Default)]
struct SplitLine {
    moving: Vec<[f64; 2]>,
    slow: Vec<[f64; 2]>,
}

impl SplitLine {
    fn push(&mut self, point: [f64; 2], moving: bool, border: bool) {
        self.moving.push(if moving || border { point } else { BREAK });
        self.slow.push(if moving { BREAK } else { point });
    }

    fn end(&mut self) {
        self.moving.push(BREAK);
        self.slow.push(BREAK);
    }
}

/// Stages as bands; rows between stages are not shaded.
fn stage_bands(series: &TorqueSeries, rows: &[usize]) -> Vec<Band> {
    let tint = |stage: Stage| Stage::ANALYSED.iter().position(|of| *of == stage).map(|place| place + 1);
    let stretches = rows.chunk_by(|a, b| series.stage[*a] == series.stage[*b]);
    stretches
        .filter_map(|stretch| {
            let (first, last) = (*stretch.first()?, *stretch.last()?);
            Some(Band { from: series.time[first], to: series.time[last], tint: tint(series.stage[first])? })
        })
        .collect()
}

fn legend(bands: &[Band], slow: bool) -> Vec<Key> {
    let key = |label: &str, look| Key { label: label.into(), look };
    let mut keys = vec![
        key("measured, low-passed", Look::Series(MEASURED, Mark::Broad)),
        key("estimated", Look::Series(ESTIMATED, Mark::Line)),
        key("residual", Look::Series(RESIDUAL, Mark::Thin)),
    ];
    if slow {
        keys.push(key("estimated where the joint is slow", Look::Series(ESTIMATED, Mark::Pale)));
        keys.push(key("residual there", Look::Series(RESIDUAL, Mark::Pale)));
    }
    let stages = Stage::ANALYSED.iter().enumerate().map(|(place, stage)| (place + 1, stage.name()));
    keys.extend(
        stages
            .filter(|(tint, _)| bands.iter().any(|band| band.tint == *tint))
            .map(|(tint, name)| key(&format!("{name} stage"), Look::Band(tint))),
    );
    keys
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    /// Two stages with a pause without rows between them.
    fn series() -> TorqueSeries {
        let mut series =
            TorqueSeries { joints: vec![JointTorqueSeries::default(); 6], ..TorqueSeries::default() };
        for i in 0..4000 {
            let t = 0.01 * f64::from(i) + if i < 2000 { 0.0 } else { 30.0 };
            series.time.push(t);
            series.stage.push(if i < 2000 { Stage::Excitation } else { Stage::Warming });
            series.counted.push(true);
            for joint in &mut series.joints {
                joint.q.push(0.0);
                joint.qd.push(1.0);
                joint.measured.push(t.sin() + if i == 777 { 40.0 } else { 0.0 });
                joint.estimated.push(t.sin());
                joint.moving.push(!(1000..1100).contains(&i));
            }
        }
        series
    }

    fn view(scope: RmsdScope) -> TorqueView {
        TorqueView { scope, points: None, joint: None, slow: false }
    }

    fn drawn(view: TorqueView) -> Figure {
        torque_figure(&er3a(), &series(), view, "run 1".into(), String::new())
    }

    fn times(series: &Series) -> impl Iterator<Item = f64> {
        series.points.iter().map(|point| point[0]).filter(|time| time.is_finite())
    }

    #[test]
    fn a_panel_a_joint_with_stages_peaks_and_gaps() {
        let of = |scope| drawn(view(scope));
        let figure = of(RmsdScope::WholeCycle);
        assert_eq!(figure.panels.len(), 6);
        assert_eq!(figure.panels[0].bands.len(), 2);
        assert_eq!(figure.legend.len(), 5);
        let measured = &figure.panels[2].series[0].points;
        assert!(measured.len() < POINTS_PER_LINE + 20, "{}", measured.len());
        assert!(measured.iter().any(|point| point[1] > 40.0), "the peak is lost");
        assert_eq!(measured.iter().filter(|point| point[0].is_nan()).count(), 2);
        // one row of 2000 is off by 40, of 4000 in the whole cycle
        assert!(figure.panels[0].title.contains("with rest 0.632 Nm"), "{}", figure.panels[0].title);
        let excitation = of(RmsdScope::Stage(Stage::Excitation));
        assert!(excitation.panels[0].title.contains("with rest 0.894 Nm"), "{}", excitation.panels[0].title);
        assert_eq!(excitation.legend.len(), 4);
        assert!(of(RmsdScope::Stage(Stage::Friction)).svg().contains("no data"));
    }

    #[test]
    fn the_estimate_is_left_out_where_the_joint_is_slow_unless_it_is_asked_for() {
        let without = drawn(view(RmsdScope::WholeCycle));
        let panel = &without.panels[2];
        let strip = panel.strip.as_ref().expect("a strip");
        assert_eq!((panel.series.len(), strip.series.len()), (2, 1));
        assert!(times(&panel.series[0]).any(|time| (10.0..11.0).contains(&time)), "measured all the same");
        for line in [&panel.series[1], &strip.series[0]] {
            assert!(times(line).all(|time| !(10.0..10.99).contains(&time)));
        }
        let slow = drawn(TorqueView { slow: true, ..view(RmsdScope::WholeCycle) });
        let panel = &slow.panels[2];
        assert_eq!(panel.series.len(), 3);
        assert!(times(&panel.series[1]).all(|time| (10.0..11.0).contains(&time)));
        assert!(times(&panel.series[1]).count() > 10);
        let alone = drawn(TorqueView { joint: JointIndex::from_number(3), ..view(RmsdScope::WholeCycle) });
        assert_eq!(alone.panels.len(), 1);
        assert!(alone.panels[0].title.starts_with("joint 3"));
    }
}
