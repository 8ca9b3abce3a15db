//! Tests of similar length, which are compared with each other. Parameters of a short check of a cold arm differ from
//! those of a whole test by more than chance, since friction changes while an arm warms.

use armwatch_model::anomaly::RunSummary;

/// Factor that the length of a test differs from the first one of its group by, at most.
const LIKE: u32 = 2;

/// Returns true if inertial parameters were identified from a test.
pub(in crate::detect::runs) fn has_parameters(run: &RunSummary) -> bool {
    !run.parameters.is_empty()
}

/// Number of cycles in the identification; all of the test without parameters.
pub(in crate::detect::runs) fn length(run: &RunSummary) -> u32 {
    run.parameters.iter().map(|of| of.cycles).max().unwrap_or(run.cycles)
}

/// Places of the tests of each group, both in the order of the history.
pub(in crate::detect::runs) fn of_like_length<'h>(
    history: impl IntoIterator<Item = &'h RunSummary>,
) -> Vec<Vec<usize>> {
    let mut groups: Vec<(u32, Vec<usize>)> = Vec::new();
    for (place, run) in history.into_iter().enumerate() {
        let own = length(run);
        let is_like = |first: u32| own == first || (own < LIKE * first && first < LIKE * own);
        match groups.iter_mut().find(|(first, _)| is_like(*first)) {
            Some((_, places)) => places.push(place),
            None => groups.push((own, vec![place])),
        }
    }
    groups.into_iter().map(|(_, places)| places).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_checks_stand_apart_from_whole_tests_and_a_shortened_test_does_not() {
        let run = |cycles: u32| RunSummary { cycles, ..RunSummary::default() };
        let history: Vec<RunSummary> = [8, 1, 1, 5, 8, 2, 15, 16, 1, 0, 3, 0].map(run).into();
        let groups: [&[usize]; 5] = [&[0, 3, 4, 6], &[1, 2, 8], &[5, 10], &[7], &[9, 11]];
        assert_eq!(of_like_length(&history), groups);
    }
}
