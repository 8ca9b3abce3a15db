//! Number of first tests for a baseline, if some of them lack a required property.

/// Number of tests, from the first on, until each of some properties occurred `count` times, or in all tests that have
/// it. `may` returns the properties that a test can have at most, `does` those that it has; both in the same order.
pub(in crate::detect::runs) fn first_tests(
    tests: usize,
    count: usize,
    may: impl Fn(usize) -> Vec<bool>,
    mut does: impl FnMut(usize) -> Vec<bool>,
) -> usize {
    let possible: Vec<Vec<bool>> = (0..tests).map(may).collect();
    let properties = possible.first().map_or(0, Vec::len);
    let mut left = vec![0_usize; properties];
    for of_test in &possible {
        left.iter_mut().zip(of_test).for_each(|(left, may)| *left += usize::from(*may));
    }
    let mut found = vec![0_usize; properties];
    for (test, of_test) in possible.iter().enumerate() {
        if found.iter().zip(&left).all(|(found, left)| *found >= count || *left == 0) {
            return test;
        }
        for (property, has) in does(test).into_iter().enumerate() {
            found[property] += usize::from(has);
            left[property] -= usize::from(of_test[property]);
        }
    }
    tests
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_tests_as_have_each_property_often_enough_or_can_have_it() {
        let of = |columns: [&[u8]; 2], count: usize| {
            let has = |test: usize| columns.map(|column| column[test] == 1).to_vec();
            first_tests(columns[0].len(), count, has, has)
        };
        assert_eq!(of([&[1, 1, 1, 1], &[1, 1, 1, 1]], 2), 2);
        assert_eq!(of([&[1, 1, 1, 1, 1], &[0, 1, 0, 1, 1]], 2), 4);
        assert_eq!(of([&[1, 1, 1, 1, 1], &[0, 0, 0, 1, 0]], 2), 4, "the only one");
        assert_eq!(of([&[1, 1, 1], &[0, 0, 0]], 2), 2, "none has it");
        assert_eq!(of([&[1, 0, 0], &[0, 0, 0]], 5), 1);
        assert_eq!(of([&[], &[]], 5), 0);
        // one that can have it and does not
        assert_eq!(first_tests(4, 2, |_| vec![true], |test| vec![test != 0]), 3);
    }
}
