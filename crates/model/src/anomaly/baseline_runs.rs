//! Runs that friction baselines and maps are learnt from.

/// Fewest points of a level in a run of a baseline. A run with fewer cycles shows too little of its own warm-up to
/// determine its thermal state.
pub const FULL_RUN_POINTS: usize = 6;

/// Duration of an effect of motion on the thermal state, s: a week. The slowest gearboxes cool within half a day.
pub const REMEMBERED_S: f64 = 7.0 * 86_400.0;

/// Most runs of a baseline.
pub const MOST_BASELINE_RUNS: usize = 40;

/// Most runs that a map is learnt from unless the baseline has more, which bounds the work of a fit.
const MOST_LEARNT: usize = 36;

/// Numbers of a joint's full runs that cause a fit of its map: that of the baseline, and each doubling of it. `full` is
/// the present number.
pub fn stages(baseline_runs: usize, full: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(baseline_runs.max(1)), |runs| runs.checked_mul(2))
        .take_while(move |runs| *runs <= full)
}

/// The runs that a map is learnt from if the joint has the full runs `full`, ascending: those of the baseline, the
/// first `baseline_runs`, and as many others as the limit allows, evenly spread and including the latest.
#[must_use]
pub fn learnt_runs(full: &[usize], baseline_runs: usize) -> Vec<usize> {
    let (baseline, later) = full.split_at(baseline_runs.min(full.len()));
    let room = MOST_LEARNT.saturating_sub(baseline.len()).min(later.len());
    let spread = (1..=room).map(|k| later[k * later.len() / room - 1]);
    baseline.iter().copied().chain(spread).collect()
}
